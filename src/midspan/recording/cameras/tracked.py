"""The cameras of a calibrated recording: tracked to their end with one filter's predictions, each as a displacement."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from midspan.fusion.streams import KalmanSettings
from midspan.recording.fusing.fuse import CourseError
from midspan.recording.fusing.one_clock import OneClock, one_clock
from midspan.recording.stored.calibration import Calibration
from midspan.recording.stored.camera import CameraCalibration
from midspan.recording.streams.acceleration import PreparedAcceleration, still
from midspan.recording.streams.progress import Progress
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import window_ends
from midspan.recording.tracking.daylight import where_it_sees
from midspan.recording.tracking.one_displacement import Together, camera_blocks, filter_settings, together
from midspan.recording.tracking.opening import open_tracking
from midspan.recording.tracking.temperatures import in_words_of
from midspan.recording.tracking.tracking import CameraTracking
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
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


@dataclass(frozen=True, slots=True)
class Seen:
    """One camera's displacement along an axis: how its targets agreed, its clock, what its reference frames may be off
    by, and warnings.
    """

    eye: Eye
    together: Together
    clock: OneClock
    clock_std_s: float
    relative_std: float
    wandering: CourseError | None
    warnings: tuple[str, ...]

    @property
    def measured(self) -> Displacement:
        """The measurements on the accelerometer's clock."""
        return self.clock.measured


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


def track_all(eyes: Sequence[Eye]) -> None:
    """Track the frames that are left of all cameras, in the order of their times."""
    while (number := _next(eyes)) is not None:
        tracking = eyes[number].tracking
        frame = tracking.take()
        if frame is None:
            tracking.ended = True
            continue
        with in_words_of(eyes[number].sensor):
            tracking.push(frame)
    for eye in eyes:
        eye.tracking.close()


def _next(eyes: Sequence[Eye]) -> int | None:
    """Number of the camera with the earliest frame that has not been tracked, on one clock; None at the end."""
    due = []
    for number, eye in enumerate(eyes):
        tracking = eye.tracking
        if not tracking.ended and tracking.done < len(tracking.time_ns):
            late_ns = round(NANOSECONDS * eye.calibrations[0].offset.value_s)
            due.append((int(tracking.time_ns[tracking.done]) + late_ns, number))
    return min(due)[1] if due else None


def _together(side: Side, number: int, eye: Eye) -> Together:
    """The camera's displacement along one axis, out of what was tracked so far."""
    camera = eye.calibrations[number]
    blocks = camera_blocks(eye.tracking.targets, camera, eye.view.exposure_s, side.acceleration)
    return together(blocks, camera.mappings(), side.acceleration, side.kalman, window_ends(eye.view))


def seen_along(side: Side, number: int, eye: Eye, clock: OneClock | None = None) -> Seen:
    """What a camera says along the axis with this number, all frames tracked.

    clock: as it was learnt along the main axis; None learns it.
    """
    camera = eye.calibrations[number]
    found = _together(side, number, eye)
    clock = (
        one_clock(found.measured, side.acceleration, side.kalman, eye.sensor, std_s=clock_std_s(camera.offset))
        if clock is None
        else clock.also(found.measured)
    )
    warnings = (*_drops(found, eye.tracking, camera.direction), *clock.warnings)
    clock_std = clock_std_s(camera.offset) if clock.std_s is None else clock.std_s
    return Seen(eye, found, clock, clock_std, camera.relative_std, _wandering(eye, camera, clock.measured), warnings)


def _wandering(eye: Eye, camera: CameraCalibration, measured: Displacement) -> CourseError | None:
    """What the reference frames may be off by, by the best target's tracker; None where the reference is the first."""
    target = eye.tracking.targets[eye.best]
    variance = target.reference_px2[:, "xy".index(camera.direction)]
    if not variance.any():
        return None
    seen = np.isfinite(measured.value_m)
    std_m = abs(camera.scale.value_m_per_px) * np.sqrt(variance[seen])
    return CourseError(eye.source, measured.time_ns[seen], std_m)


def zero_of(seen: Sequence[Seen], first: Displacement) -> int:
    """The instant (ns) that the displacement counts from: the first frame used of the first sensor, else of `first`.

    Of two cameras the first one's; where that one was dark when it began, the earliest frame of `first`, which holds
    both, in which a target was seen.
    """
    if not seen:
        return int(first.time_ns[0])
    dark = seen[0].eye.begins_dark
    measured = first.time_ns[np.isfinite(first.value_m)] if dark else seen[0].measured.time_ns
    return int(measured[0] if len(measured) else first.time_ns[0])


def _drops(found: Together, tracking: CameraTracking, direction: str) -> list[str]:
    """A sentence for each target that was left out of many frames in which it was seen."""
    told = []
    for target, used in zip(tracking.targets, found.used, strict=True):
        seen = np.isfinite(target.track.along(direction)[0])
        share = float(np.mean(~used[seen])) if seen.any() else 0.0
        if share > NOTABLE_DROPPED:
            told.append(
                f"Target {target.name}: {100 * share:.2g} % of its frames disagree with the other targets along "
                f"{direction} and were left out; look at its region."
            )
    return told


def clock_std_s(offset: TimeOffset) -> float:
    """Standard deviation (s) of a clock offset; one that the motion does not tell has no effect either."""
    return float(np.sqrt(offset.variance)) if np.isfinite(offset.variance) else 0.0
