"""From an opened, calibrated recording to what is fused: tracking to its end, displacement in metres, first guesses."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.engine.monitor import Monitor
from midspan.errors import DataError, UsageError
from midspan.fusion.kalman import KalmanFilter, KalmanSettings
from midspan.fusion.smoother import smooth
from midspan.recording.acceleration import PreparedAcceleration, unknown_density
from midspan.recording.calibrate import open_tracking
from midspan.recording.calibration import Calibration
from midspan.recording.fuse import FusionInputs, SensorError
from midspan.recording.progress import Progress
from midspan.recording.recording import Recording
from midspan.recording.span import inside, require_overlap
from midspan.recording.tracking import CameraTracking
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    Floats,
    PixelTrack,
    PixelTranslation,
    Source,
    TimeOffset,
    joined,
    part,
)
from midspan.signals.health import dominant_frequency

# Rows are `coasting` when the last accepted measurement is older than this many of the sensor's usual intervals.
COASTING_INTERVALS = 2.5


@dataclass(frozen=True, slots=True)
class Gathered:
    """The inputs of the fusion, the camera's track and tracking (None without one), and warnings."""

    inputs: FusionInputs
    track: PixelTrack | None
    tracking: CameraTracking | None
    warnings: tuple[str, ...]


def gather(
    recording: Recording, calibration: Calibration, tracking: CameraTracking | None, progress: Progress
) -> Gathered:
    """Track what is left of the camera's frames with the filter's predictions, and bring all sensors together."""
    prepared = recording.prepared
    density = calibration.noise_density(prepared.rate_hz)
    acceleration = prepared.with_noise(density)
    kalman = KalmanSettings(bias=calibration.bias_m_s2, bias_std=_bias_std(calibration, prepared.value_m_s2))
    blocks, errors, track = [], [], None
    if calibration.camera is not None and recording.has("camera"):
        camera, mapping = calibration.camera, calibration.camera.mapping()
        tracking = tracking or open_tracking(recording, calibration, progress)
        track = track_all(tracking, Monitor(tracking.tracker, mapping, KalmanFilter(kalman)), acceleration)
        blur_s = tracking.blur_s(recording.settings.camera.exposure_s if recording.settings.camera else None)
        blocks.append(_unblurred(mapping.displacement(track), blur_s, acceleration))
        relative = float(np.sqrt(camera.scale.variance)) / abs(camera.scale.value_m_per_px)
        errors.append(SensorError(Source.CAMERA, relative, _clock_std(camera.offset)))
    if recording.has("displacement"):
        blocks.append(_displacement(recording, calibration))
        offset = calibration.displacement.offset if calibration.displacement else TimeOffset(0.0, 0.0)
        errors.append(SensorError(Source.DISPLACEMENT, 0.0, _clock_std(offset)))
    level = 0.0 if track is not None else float(blocks[0].value_m[np.argmax(np.isfinite(blocks[0].value_m))])
    blocks[0] = replace(blocks[0], value_m=blocks[0].value_m - level)
    measured, warnings = _merged(blocks, acceleration, kalman)
    inputs = FusionInputs(
        acceleration=_from_first_measurement(acceleration, measured, prepared.rate_hz),
        displacement=measured,
        kalman=_with_ages(replace(kalman, velocity_std=_velocity_std(prepared, measured)), blocks[0]),
        zero_ns=None if track is None else int(blocks[0].time_ns[0]),
        level_m=level,
        errors=tuple(errors),
    )
    return Gathered(inputs, track, tracking, tuple(warnings))


def _clock_std(offset: TimeOffset) -> float:
    """Standard deviation (s) of a clock offset; one that the motion does not tell has no effect either."""
    return float(np.sqrt(offset.variance)) if np.isfinite(offset.variance) else 0.0


def _with_ages(kalman: KalmanSettings, measured: Displacement) -> KalmanSettings:
    interval = float(np.median(np.diff(measured.time_ns))) / NANOSECONDS
    return replace(kalman, coasting_s=max(COASTING_INTERVALS * interval, 0.05), lost_s=max(10.0, 10.0 * interval))


def _bias_std(calibration: Calibration, value: Floats) -> float:
    """First uncertainty of the bias: a mean over motion is off by some of the motion."""
    return float(0.3 * np.std(value) + 10.0 * calibration.noise_std_m_s2 + 1e-4)


def _velocity_std(prepared: PreparedAcceleration, measured: Displacement) -> float:
    """First uncertainty of the velocity: three times the larger of what either sensor says of its size."""
    usable = np.isfinite(measured.value_m)
    steps = np.diff(measured.value_m[usable]) / np.maximum(np.diff(measured.time_ns[usable]) / NANOSECONDS, 1e-3)
    slow = float(np.sqrt(np.mean(steps**2))) if len(steps) else 1.0
    value = prepared.value_m_s2
    fast = float(np.std(value)) / (2.0 * np.pi * max(dominant_frequency(value, prepared.rate_hz), 0.2))
    return 3.0 * max(slow, fast)


def track_all(tracking: CameraTracking, monitor: Monitor, acceleration: Acceleration) -> PixelTrack:
    """Track the frames that are left with the filter's predictions; returns the whole track."""
    offset = monitor.scale.time_offset_ns
    if tracking.done:
        monitor.push(monitor.scale.displacement(tracking.track))
    pushed = 0
    while tracking.done < len(tracking.time_ns):
        frame = tracking.take()
        if frame is None:
            break
        due = int(np.searchsorted(acceleration.time_ns, frame.time_ns + offset, side="right"))
        monitor.push(part(acceleration, slice(pushed, due)))
        pushed = max(pushed, due)
        (translation,) = monitor.push(frame)
        assert isinstance(translation, PixelTranslation)
        tracking.add(frame, translation)
    tracking.close()
    return tracking.track


def _unblurred(measured: Displacement, blur_s: float, acceleration: Acceleration) -> Displacement:
    """The camera's displacement without what averaging over `blur_s` added: blur²/24 of the acceleration."""
    if blur_s == 0.0:
        return measured
    value = acceleration.value_m_s2 - np.mean(acceleration.value_m_s2)
    added = blur_s**2 / 24.0 * np.interp(measured.time_ns, acceleration.time_ns, value)
    return replace(measured, value_m=measured.value_m - added)


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


def _from_first_measurement(acceleration: Acceleration, measured: Displacement, rate_hz: float) -> Acceleration:
    """Put a sample before the first measurement where that comes first: the zero belongs to it."""
    first, start = int(measured.time_ns[0]), int(acceleration.time_ns[0])
    if first >= start or start - first > 2 * NANOSECONDS:
        return acceleration
    value = float(np.mean(acceleration.value_m_s2[:100]))
    before = Acceleration(np.array([first - 1]), np.array([value]), acceleration.noise_density[:1])
    widened = acceleration.noise_density.copy()
    widened[0] += unknown_density(acceleration.value_m_s2, rate_hz)
    return joined([before, replace(acceleration, noise_density=widened)])
