"""The temperature range for trackers that were made for grey levels, and a translation by the accelerometer."""

import math
from collections.abc import Sequence

import numpy as np

from midspan.calibration.camera.calibrate import CameraFit
from midspan.calibration.camera.view import SeenTarget, View, camera_blocks, filter_settings
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.errors import UntrustedError
from midspan.fusion.path import at
from midspan.fusion.streams import smooth
from midspan.records import NANOSECONDS, Floats, Frame, Nanoseconds, PixelTrack, seconds
from midspan.signals.acceleration import GRAVITY_M_S2, PreparedAcceleration
from midspan.signals.integrate import path
from midspan.thermal.temperature_range import DIVISIONS, ROUGH, THINNED, Expected, RangeSurface, optimise_range
from midspan.vision.tracker import open_tracker

# The band as printed ends at a tenth of the frame rate; it begins at 0.3 Hz (Choi et al. 2023, section 3.1.1), at slow
# frame rates at a third of its end.
TOP_SHARE, BOTTOM_HZ, BOTTOM_SHARE = 0.1, 0.3, 1.0 / 3.0
# The integral's drift that is taken off: of a bias and of a start in motion.
DRIFT_DEGREE = 2
# This many frames of the calibration are compared; displacement is let in so much more weakly than it is known, that
# the accelerometer makes what is compared.
FRAMES, WEAKER = 90, 1e4
MIN_FRAMES = 8
SLOWEST_HZ, FASTEST_SHARE = 0.5, 0.45
# Thinned frames, some of them lost, show what lies above this share of the frame rate apart from what is slower; as
# many as are compared without thinning show it up to the second share.
SHOWN_SHARE, NOT_THINNED, SHOWN_NOT_THINNED = 0.05, ROUGH * THINNED - 1, 0.18


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


def best_range(
    frames: Sequence[Frame], view: View, targets: Sequence[SeenTarget], fit: CameraFit, divisions: int = DIVISIONS
) -> RangeSurface:
    """The errors of all ranges on frames from the reference frame on, against the accelerometer.

    frames: FRAMES at most; targets, fit: of the temperatures as they are, which gave the scale factor; divisions: M.
    Raises UntrustedError where nothing decides, with the reason.
    """
    if len(frames) < MIN_FRAMES:
        raise UntrustedError(
            f"The calibration holds {len(frames)} frames from the reference frame on; at least {MIN_FRAMES} are "
            "needed. Choose a longer calibration.window_s."
        )
    rate = NANOSECONDS / float(np.median(np.diff([frame.time_ns for frame in frames])))
    band, count = compared_band(view.band_hz, rate)
    frames, region = frames[:count], fit.calibration.region
    expected = _expected_px(view, targets, fit, np.array([frame.time_ns for frame in frames], dtype=np.int64))

    def follow(greys: Sequence[Frame]) -> PixelTrack:
        tracker = open_tracker(fit.calibration.tracker, greys[0], region, targets[0].tracker_settings)
        return PixelTrack.stack([tracker.push(frame) for frame in greys])

    return optimise_range(frames, region, follow, Expected(expected, view.axis, band), divisions)


def compared_band(given: tuple[float, float] | None, rate: float) -> tuple[tuple[float, float], int]:
    """The band (Hz) that ranges are compared in at a frame rate (Hz), and on how many frames at most.

    given: calibration.band_hz. Raises UntrustedError where the frames are too slow for it.
    """
    low, high = given or (min(SLOWEST_HZ, SHOWN_SHARE * rate), math.inf)
    high = min(high, FASTEST_SHARE * rate)
    if low <= SHOWN_SHARE * rate and low < high:
        return (low, high), FRAMES
    if low <= SHOWN_NOT_THINNED * rate and low < high:
        return (low, high), NOT_THINNED
    raise UntrustedError(
        f"calibration.band_hz must begin at {SHOWN_NOT_THINNED * rate:.2g} Hz or lower for frames at {rate:.3g} Hz, "
        f"to separate the errors of temperature ranges from drift; received {low:g} Hz. Use a higher frame rate or a "
        "lower band."
    )


def _expected_px(view: View, targets: Sequence[SeenTarget], fit: CameraFit, frames_ns: Nanoseconds) -> Floats:
    camera = fit.calibration
    acceleration = view.prepared.with_noise(fit.input_noise.density, fit.input_noise.motion_s)
    used = [target for target in targets if target.region == camera.region]
    block = camera_blocks(used, camera, acceleration)[0]
    kalman = filter_settings(view.prepared, fit.input_noise.density, lean=GRAVITY_M_S2 * fit.slope)
    weak = type(block)(block.time_ns, block.value_m, WEAKER * block.variance_m2, block.source)
    path = smooth(acceleration, weak, kalman).estimate
    stamps = frames_ns + round(NANOSECONDS * camera.offset.value_s)
    return at(path, stamps)[0] / camera.scale.value_m_per_px
