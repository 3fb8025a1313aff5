"""The temperature range for trackers that were made for grey levels: chosen on the frames of the calibration."""

import math
from collections.abc import Sequence
from itertools import islice

import numpy as np

from midspan.errors import UntrustedError
from midspan.fusion.path import at
from midspan.fusion.smoother import smooth
from midspan.recording.camera_calibration.camera import CameraFit
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import window_ends
from midspan.recording.tracking.one_displacement import camera_blocks, filter_settings
from midspan.recording.tracking.temperatures import IN_GREY, is_grey
from midspan.recording.tracking.tracking import CameraTracking
from midspan.records import NANOSECONDS, Floats, Frame, Nanoseconds, PixelTrack, Region
from midspan.settings.camera import InfraredSettings
from midspan.thermal.temperature_range import Expected, RangeSurface, optimise_range
from midspan.vision.reference.strength import open_counting

# So many frames of the calibration are compared; displacement is let in so much more weakly than it is known, that the
# accelerometer makes what is compared.
FRAMES, WEAKER = 90, 1e4
LEAST_FRAMES = 8
SLOWEST_HZ, FASTEST_SHARE = 0.5, 0.45


def wants_range(view: Recording) -> bool:
    """Whether a range has to be found: a tracker made for grey levels, temperatures, and none given."""
    camera = view.settings.camera
    return (
        isinstance(camera, InfraredSettings)
        and camera.temperature_range_c is None
        and camera.tracker in IN_GREY
        and not is_grey(view)
    )


def best_range(view: Recording, tracking: CameraTracking, fit: CameraFit) -> RangeSurface:
    """The errors of all ranges on frames from the reference frame on, against the accelerometer.

    tracking, fit: of the temperatures as they are, which gave the scale factor. Raises UntrustedError where nothing
    decides, with the reason.
    """
    settings, region = tracking.settings, fit.calibration.region
    first = settings.first
    last = int(np.searchsorted(view.frames.times_ns(), window_ends(view)[1], side="right"))
    frames = list(islice(view.frames.frames(first, min(last, first + FRAMES)), FRAMES))
    time_s = [frame.time_ns / NANOSECONDS for frame in frames]
    rate = 1.0 / float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    band = view.settings.calibration.band_hz or (SLOWEST_HZ, math.inf)
    band = (band[0], min(band[1], FASTEST_SHARE * rate))
    if len(frames) < LEAST_FRAMES:
        raise UntrustedError(
            f"The calibration holds {len(frames)} frames from the reference frame on; at least {LEAST_FRAMES} are "
            "needed. Choose a longer calibration.window_s."
        )
    if band[0] >= band[1]:
        raise UntrustedError(
            f"Frames at {rate:.3g} Hz show no motion above {band[0]:g} Hz, where ranges are compared. Use more frames "
            "a second, or a lower calibration.band_hz."
        )
    expected = _expected_px(view, tracking, fit, np.array([frame.time_ns for frame in frames], dtype=np.int64))

    def follow(greys: Sequence[Frame]) -> PixelTrack:
        return _followed(greys, region, settings.tracker, settings.tracker_settings)

    return optimise_range(frames, region, follow, Expected(expected, view.axis, band))


def _followed(frames: Sequence[Frame], region: Region, name: str, settings: object) -> PixelTrack:
    tracker = open_counting(name, frames[0], region, settings)
    return PixelTrack.stack([tracker.push(frame) for frame in frames])


def _expected_px(view: Recording, tracking: CameraTracking, fit: CameraFit, frames_ns: Nanoseconds) -> Floats:
    """The translation (n,) in px that the accelerometer says at frames' stamps on the camera's clock."""
    camera = fit.calibration
    acceleration = view.prepared.with_noise(fit.input_density)
    used = [target for target in tracking.targets if target.region == camera.region]
    block = camera_blocks(used, camera, view.exposure_s, acceleration)[0]
    kalman = filter_settings(view.prepared, fit.input_density)
    weak = type(block)(block.time_ns, block.value_m, WEAKER * block.variance_m2, block.source)
    path = smooth(acceleration, weak, kalman).estimate
    stamps = frames_ns + round(NANOSECONDS * camera.offset.value_s)
    return at(path, stamps)[0] / camera.scale.value_m_per_px
