"""The cameras of a calibrated recording: tracked to their end with one filter's predictions, each as a displacement."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from midspan.fusion.streams import KalmanSettings
from midspan.recording.stored.calibration import Calibration
from midspan.recording.stored.camera import CameraCalibration
from midspan.recording.streams.acceleration import PreparedAcceleration, still
from midspan.recording.streams.progress import Progress
from midspan.recording.streams.recording import Recording
from midspan.recording.tracking.daylight import where_it_sees
from midspan.recording.tracking.one_displacement import filter_settings
from midspan.recording.tracking.opening import open_tracking
from midspan.recording.tracking.temperatures import in_words_of
from midspan.recording.tracking.tracking import CameraTracking
from midspan.records import (
    Acceleration,
    Floats,
    Region,
    Source,
    TimeOffset,
)

# A target left out of more than this share of its frames is worth telling.
NOTABLE_DROPPED = 0.1


@dataclass(frozen=True, slots=True)
class Side:
    """One image axis of a recording, or all of one without a camera: its acceleration and the filter's settings."""

    recording: Recording
    calibration: Calibration
    prepared: PreparedAcceleration
    acceleration: Acceleration
    kalman: KalmanSettings


@dataclass(frozen=True, slots=True)
class Eye:
    """One camera of a recording, its tracking, and what was learnt of it along each axis, the main one first."""

    view: Recording
    tracking: CameraTracking
    calibrations: tuple[CameraCalibration, ...]

    @property
    def sensor(self) -> str:
        """The section that the camera stands in."""
        return self.view.sensor

    @property
    def source(self) -> Source:
        """How its rows are marked."""
        return self.calibrations[0].source

    @property
    def best(self) -> int:
        """Number of the best target along the main axis, in the tracking's."""
        regions = [target.region for target in self.tracking.targets]
        return regions.index(best_region(self.tracking, self.calibrations[0]))

    @property
    def begins_dark(self) -> bool:
        """Whether frames before the first one used were dark or not usable."""
        began_ns = self.view.sees_from_ns
        return self.tracking.skipped > 0 or (began_ns is not None and began_ns > self.view.frames.times_ns()[0])

    @property
    def strength(self) -> Floats:
        """Good matches of the best target in each frame (n,), of trackers without matches the quality in percent."""
        return self.tracking.targets[self.best].strengths


def side_of(recording: Recording, calibration: Calibration) -> Side:
    """A recording's axis with its calibration; without an accelerometer there its acceleration is zero."""
    camera = calibration.first_camera
    prepared = recording.prepared if camera is None or camera.fused else still(recording.prepared)
    density = calibration.noise_density(prepared.rate_hz)
    kalman = filter_settings(prepared, density, calibration.bias_m_s2)
    return Side(recording, calibration, prepared, prepared.with_noise(density), kalman)


def open_eyes(sides: Sequence[Side], tracking: CameraTracking | None, progress: Progress) -> tuple[Eye, ...]:
    """The calibrated cameras of a recording, the one whose zero counts first.

    tracking: what calibrating left, with that of a second camera beside it; None: each is opened.
    """
    opened = {one.settings.sensor: one for one in (tracking, tracking and tracking.beside) if one is not None}
    eyes = []
    for view in sides[0].recording.cameras:
        known = tuple(camera for side in sides if (camera := side.calibration.camera_of(view.sensor)) is not None)
        if not known:
            continue
        view, _ = where_it_sees(view)
        with in_words_of(view.sensor):
            own = opened.get(view.sensor) or open_tracking(view, known[0], progress)
        eyes.append(Eye(view, own, known))
    return tuple(eyes)


def best_region(tracking: CameraTracking, camera: CameraCalibration) -> Region:
    """The region of the best target, as it is tracked: one alone may have been moved a little by the recording."""
    regions = [target.region for target in tracking.targets]
    return camera.region if camera.region in regions else regions[0]


def clock_std_s(offset: TimeOffset) -> float:
    """Standard deviation (s) of a clock offset; one that the motion does not tell has no effect either."""
    return float(np.sqrt(offset.variance)) if np.isfinite(offset.variance) else 0.0
