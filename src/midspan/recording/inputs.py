"""From an opened, calibrated recording to what is fused: tracking to its end, displacement in metres, first guesses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.engine.monitor import AxisLoop, Monitor
from midspan.errors import DataError, UsageError
from midspan.fusion.kalman import KalmanFilter, KalmanSettings
from midspan.fusion.smoother import smooth
from midspan.recording.acceleration import PreparedAcceleration, still, unknown_density
from midspan.recording.calibrate import open_tracking
from midspan.recording.calibrate_camera import window_ends
from midspan.recording.calibration import Calibration, CameraCalibration
from midspan.recording.fuse import FusionInputs, SensorError
from midspan.recording.progress import Progress
from midspan.recording.recording import Recording
from midspan.recording.running_clock import RunningClock, on_one_clock
from midspan.recording.span import inside, require_overlap
from midspan.recording.targets import Together, camera_blocks, filter_settings, together
from midspan.recording.tracking import CameraTracking
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    PixelTrack,
    PixelTranslation,
    Region,
    Source,
    TimeOffset,
    joined,
    part,
)
from midspan.signals.health import dominant_frequency

# A target left out of more than this share of its frames is worth telling.
NOTABLE_DROPPED = 0.1
# Rows are `coasting` when the last accepted measurement is older than this many of the sensor's usual intervals.
COASTING_INTERVALS = 2.5


@dataclass(frozen=True, slots=True)
class Gathered:
    """The inputs of the fusion, the camera's best track and its tracking (None without one), and warnings.

    across: the inputs along the second image axis; together: how the targets agreed along the main one.
    """

    inputs: FusionInputs
    track: PixelTrack | None
    tracking: CameraTracking | None
    warnings: tuple[str, ...]
    across: FusionInputs | None = None
    together: Together | None = None


def gather(
    recording: Recording, calibration: Calibration, tracking: CameraTracking | None, progress: Progress
) -> Gathered:
    """Track what is left of the camera's frames with the filters' predictions, and bring all sensors together."""
    sides = [side_of(recording, calibration)]
    if recording.across is not None and calibration.across is not None:
        sides.append(side_of(recording.across, calibration.across))
    if calibration.camera is not None and recording.has("camera"):
        tracking = tracking or open_tracking(recording, calibration, progress)
        track_all(tracking, _monitor(tracking, sides), [side.acceleration for side in sides])
    inputs, together, warnings, clock = _inputs(sides[0], tracking)
    across = None
    if len(sides) > 1:
        across, _, more, _ = _inputs(sides[1], tracking, clock)
        warnings += more
    place = 0
    if tracking is not None and calibration.camera is not None:
        place = [target.region for target in tracking.targets].index(best_region(tracking, calibration.camera))
    track = None if tracking is None else tracking.targets[place].track
    return Gathered(inputs, track, tracking, tuple(warnings), across, together)


@dataclass(frozen=True, slots=True)
class Side:
    """One image axis of a recording, or all of one without a camera: its acceleration and the filter's settings."""

    recording: Recording
    calibration: Calibration
    prepared: PreparedAcceleration
    acceleration: Acceleration
    kalman: KalmanSettings


def side_of(recording: Recording, calibration: Calibration) -> Side:
    """A recording's axis with its calibration; without an accelerometer there its acceleration is zero."""
    fused = calibration.camera is None or calibration.camera.fused
    prepared = recording.prepared if fused else still(recording.prepared)
    density = calibration.noise_density(prepared.rate_hz)
    kalman = filter_settings(prepared, density, calibration.bias_m_s2)
    return Side(recording, calibration, prepared, prepared.with_noise(density), kalman)


def best_region(tracking: CameraTracking, camera: CameraCalibration) -> Region:
    """The region of the best target, as it is tracked: one alone may have been moved a little by the recording."""
    regions = [target.region for target in tracking.targets]
    return camera.region if camera.region in regions else regions[0]


def _monitor(tracking: CameraTracking, sides: Sequence[Side]) -> Monitor:
    """The loop of trackers and filters, which have been told what was tracked so far."""
    loops = []
    for side in sides:
        assert side.calibration.camera is not None
        loop = AxisLoop(side.calibration.camera.mappings(), KalmanFilter(side.kalman))
        if tracking.done:
            found = _camera(side, tracking)
            loop.start(found.measured, found.zeros_m)
        loops.append(loop)
    return Monitor(tracking.targets, loops)


def _camera(side: Side, tracking: CameraTracking) -> Together:
    """The camera's displacement along one axis, out of what was tracked so far."""
    camera = side.calibration.camera
    assert camera is not None
    blocks = camera_blocks(tracking.targets, camera, side.recording.exposure_s, side.acceleration)
    return together(blocks, camera.mappings(), side.acceleration, side.kalman, window_ends(side.recording))


def _inputs(
    side: Side, tracking: CameraTracking | None, clock: RunningClock | None = None
) -> tuple[FusionInputs, Together | None, list[str], RunningClock | None]:
    """What is fused along one axis, how the targets agreed, warnings, and the camera's clock.

    clock: as it was learnt along the main axis; None learns it.
    """
    recording, calibration, blocks, errors = side.recording, side.calibration, [], []
    found, told = None, []
    if calibration.camera is not None and tracking is not None:
        found = _camera(side, tracking)
        told = _drops(found, tracking, calibration.camera.direction)
        clock = (
            on_one_clock(found.measured, side.acceleration, side.kalman, "camera")
            if clock is None
            else clock.also(found.measured)
        )
        told += clock.warnings
        blocks.append(clock.measured)
        clock_std = _clock_std(calibration.camera.offset) if clock.std_s is None else clock.std_s
        errors.append(SensorError(Source.CAMERA, calibration.camera.relative_std, clock_std))
    if recording.has("displacement"):
        blocks.append(_displacement(recording, calibration))
        offset = calibration.displacement.offset if calibration.displacement else TimeOffset(0.0, 0.0)
        errors.append(SensorError(Source.DISPLACEMENT, 0.0, _clock_std(offset)))
    level = 0.0 if found is not None else float(blocks[0].value_m[np.argmax(np.isfinite(blocks[0].value_m))])
    blocks[0] = replace(blocks[0], value_m=blocks[0].value_m - level)
    measured, warnings = _merged(blocks, side.acceleration, side.kalman)
    velocity_std = _velocity_std(side.prepared, measured)
    begun = from_first_measurement(side.acceleration, measured, side.prepared.rate_hz)
    inputs = FusionInputs(
        acceleration=begun,
        displacement=measured,
        kalman=_with_ages(replace(side.kalman, velocity_std=velocity_std), blocks[0]),
        zero_ns=None if found is None else int(blocks[0].time_ns[0]),
        level_m=level,
        errors=tuple(errors),
        sampled=None if begun is side.acceleration else side.acceleration,
    )
    return inputs, found, [*warnings, *told], clock


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


def _clock_std(offset: TimeOffset) -> float:
    """Standard deviation (s) of a clock offset; one that the motion does not tell has no effect either."""
    return float(np.sqrt(offset.variance)) if np.isfinite(offset.variance) else 0.0


def _with_ages(kalman: KalmanSettings, measured: Displacement) -> KalmanSettings:
    interval = float(np.median(np.diff(measured.time_ns))) / NANOSECONDS
    return replace(kalman, coasting_s=max(COASTING_INTERVALS * interval, 0.05), lost_s=max(10.0, 10.0 * interval))


def _velocity_std(prepared: PreparedAcceleration, measured: Displacement) -> float:
    """First uncertainty of the velocity: three times the larger of what either sensor says of its size."""
    usable = np.isfinite(measured.value_m)
    steps = np.diff(measured.value_m[usable]) / np.maximum(np.diff(measured.time_ns[usable]) / NANOSECONDS, 1e-3)
    slow = float(np.sqrt(np.mean(steps**2))) if len(steps) else 1.0
    value = prepared.value_m_s2
    fast = (
        0.0
        if not value.any()
        else float(np.std(value)) / (2.0 * np.pi * max(dominant_frequency(value, prepared.rate_hz), 0.2))
    )
    return 3.0 * max(slow, fast)


def track_all(tracking: CameraTracking, monitor: Monitor, accelerations: Sequence[Acceleration]) -> None:
    """Track the frames that are left with the filters' predictions; accelerations: one an axis, of the same stamps."""
    offset = monitor.axes[0].scales[0].time_offset_ns
    pushed = [0] * len(accelerations)
    while tracking.done < len(tracking.time_ns):
        frame = tracking.take()
        if frame is None:
            break
        for axis, acceleration in enumerate(accelerations):
            due = int(np.searchsorted(acceleration.time_ns, frame.time_ns + offset, side="right"))
            monitor.push(part(acceleration, slice(pushed[axis], due)), axis)
            pushed[axis] = max(pushed[axis], due)
        translations = [item for item in monitor.push(frame) if isinstance(item, PixelTranslation)]
        tracking.add(frame, translations)
    tracking.close()


def _displacement(recording: Recording, calibration: Calibration) -> Displacement:
    """The [displacement] channel as measurements on the accelerometer's clock."""
    series, learnt = recording.displacement, calibration.displacement
    require_overlap(recording.prepared.time_ns, series.time_ns, "displacement")
    if learnt is None:
        raise UsageError(
            "The calibration has no displacement part, but the recording has [displacement]. Calibrate again."
        )
    count = len(series.time_ns)
    return Displacement(
        time_ns=series.time_ns + round(1e9 * learnt.offset.value_s),
        value_m=series.value,
        variance_m2=np.full(count, learnt.noise_std_m**2),
        source=np.full(count, Source.DISPLACEMENT, dtype=np.uint8),
    )


def _merged(
    blocks: list[Displacement], acceleration: Acceleration, kalman: KalmanSettings
) -> tuple[Displacement, list[str]]:
    """All measurements in time order, a second sensor brought to the zero of the first, and warnings."""
    first, warnings = blocks[0], []
    for other in blocks[1:]:
        smoothed = smooth(acceleration, first, kalman).estimate
        span = inside(other.time_ns, int(first.time_ns[0]), int(first.time_ns[-1]))
        apart = other.value_m[span] - np.interp(other.time_ns[span], smoothed.time_ns, smoothed.displacement_m)
        if not np.isfinite(apart).any():
            warnings.append("displacement: never overlaps the camera, so its zero is unknown; it was left out.")
            continue
        both = joined([first, replace(other, value_m=other.value_m - float(np.nanmedian(apart)))])
        first = part(both, np.argsort(both.time_ns, kind="stable"))
    if not np.isfinite(first.value_m).any():
        raise DataError("No frame could be tracked and no displacement is left; check camera.roi and the video.")
    return first, warnings


def from_first_measurement(acceleration: Acceleration, measured: Displacement, rate_hz: float) -> Acceleration:
    """Put a sample before the first measurement where that comes first: the zero belongs to it."""
    first, start = int(measured.time_ns[0]), int(acceleration.time_ns[0])
    if first >= start or start - first > 2 * NANOSECONDS:
        return acceleration
    value = float(np.mean(acceleration.value_m_s2[:100]))
    # A whole sample's interval at least: over nanoseconds the step to the first sample would be an endless slope.
    begin = min(first - 1, start - round(NANOSECONDS / rate_hz))
    before = Acceleration(np.array([begin]), np.array([value]), acceleration.noise_density[:1])
    widened = acceleration.noise_density.copy()
    widened[0] += unknown_density(acceleration.value_m_s2, rate_hz)
    return joined([before, replace(acceleration, noise_density=widened)])
