"""A target's translation as the accelerometer shows it: double integral over the scale factor, at frames' stamps."""

import numpy as np

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.records import NANOSECONDS, Nanoseconds, seconds
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.integrate import path
from midspan.thermal.temperature_range import Expected

# The band as printed ends at a tenth of the frame rate; it begins at 0.3 Hz (Choi et al. 2023, section 3.1.1), at slow
# frame rates at a third of its end.
TOP_SHARE, BOTTOM_HZ, BOTTOM_SHARE = 0.1, 0.3, 1.0 / 3.0
# The integral's drift that is taken off: of a bias and of a start in motion.
DRIFT_DEGREE = 2


def felt_motion(
    prepared: PreparedAcceleration,
    window: slice,
    camera: CameraCalibration,
    frames_ns: Nanoseconds,
    band_hz: tuple[float, float] | None = None,
) -> Expected:
    """The translation (n,) in px at frames' stamps (n,) on the camera's clock, and the band that it holds in.

    window: the samples of the calibration; NaN outside. band_hz: calibration.band_hz; left out: as printed.
    """
    stamps = frames_ns + round(NANOSECONDS * camera.offset.value_s)
    origin_ns = int(prepared.time_ns[window.start])
    sampled_s, time_s = seconds(prepared.time_ns[window], origin_ns), seconds(stamps, origin_ns)
    moved_m = path(sampled_s, sampled_s, prepared.value_m_s2[window])
    moved_m = moved_m - np.polynomial.Polynomial.fit(sampled_s, moved_m, DRIFT_DEGREE)(sampled_s)
    moved_m = np.interp(time_s, sampled_s, moved_m, left=np.nan, right=np.nan)
    band = band_hz or printed_band(float(np.median(np.diff(time_s))))
    return Expected(moved_m / camera.scale.value_m_per_px, camera.direction, band)


def printed_band(frame_s: float) -> tuple[float, float]:
    """The band (Hz) for frames every `frame_s` s."""
    top = TOP_SHARE / frame_s
    return min(BOTTOM_HZ, BOTTOM_SHARE * top), top
