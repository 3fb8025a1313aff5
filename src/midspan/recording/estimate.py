"""`estimate`: the main job, from a recording to displacement at the accelerometer's rate with its error band."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.time_offset import without_lonely
from midspan.checks import option
from midspan.engine.monitor import Monitor
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.fusion.gate import ACCEPTED, REJECTED
from midspan.fusion.kalman import KalmanFilter, KalmanSettings
from midspan.fusion.methods import METHODS
from midspan.fusion.smoother import Smoothed, smooth
from midspan.recording.acceleration import PreparedAcceleration
from midspan.recording.calibrate import calibrate_and_track, open_tracking
from midspan.recording.calibration import Calibration, CameraCalibration
from midspan.recording.progress import Progress, silent
from midspan.recording.recording import Recording, naming
from midspan.recording.result import Result
from midspan.recording.span import inside, require_overlap, shown
from midspan.recording.tracking import CameraTracking
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    Estimate,
    Event,
    Floats,
    Innovation,
    PixelTrack,
    PixelTranslation,
    Source,
    Status,
    joined,
    part,
    seconds,
)
from midspan.signals.health import dominant_frequency

# Rows are `coasting` when the last accepted measurement is older than this many of the sensor's usual intervals.
COASTING_INTERVALS = 2.5
# Where more than half of the measurements contradict the prediction, the prediction or the calibration is wrong.
MOST_REJECTED = 0.5
# A prediction is sharp when its variance with the measurement's is below this many of the measurement's own.
SHARP_VARIANCES = 25.0
NEIGHBOURS = 8
# The zero of `kalman` comes from this much of the record, smoothed: it belongs to its start-up, not to its causal
# output.
ZERO_S = 60.0


def estimate(
    recording: Recording,
    calibration: Calibration | None = None,
    *,
    method: str | None = None,
    tracking: CameraTracking | None = None,
    progress: Progress = silent,
) -> Result:
    """Estimate the displacement of a recording.

    calibration: left out, it is made first (and then the camera is tracked once for both). tracking: what
    `calibrate_and_track` left, to go on with. method: "smoother" or
    "kalman", over the recording's own. Returns one row for each accelerometer sample in the streams' common span.
    Raises UntrustedError when calibration is refused, DataError for unusable streams.
    """
    # The method is checked first: tracking may take long.
    method = option("method", method or recording.settings.fusion.method, METHODS)
    if calibration is None:
        calibration, tracking = calibrate_and_track(recording, progress)
    with naming(recording):
        return _estimate(recording, calibration, method, tracking, progress)


def _estimate(
    recording: Recording, calibration: Calibration, method: str, tracking: CameraTracking | None, progress: Progress
) -> Result:
    _require(recording, calibration)
    inputs = _inputs(recording, calibration, tracking, progress)
    progress(0, 1, "fusing")
    fused = _fuse(inputs, method)
    _refuse_rejections(fused.innovation)
    rows = _with_calibration_error(inputs, method, fused.estimate)
    result = _cut(recording, inputs, rows)
    progress(1, 1, "fusing")
    return Result(
        estimate=result,
        calibration=calibration,
        settings=recording.settings,
        method=method,
        innovation=fused.innovation,
        events=tuple(sorted((*recording.prepared.events, *fused.events), key=lambda event: event.time_ns)),
        warnings=_warnings(calibration, inputs, fused, result),
        track=inputs.track,
        tracking=inputs.tracking,
        recording=recording,
    )


@dataclass(frozen=True, slots=True)
class Inputs:
    """What is fused: acceleration, displacement of all sensors, the filter's settings, the camera's track.

    level_m: taken off the displacement before fusing, so that a height of 123 m does not start the filter 123 m away.
    """

    acceleration: Acceleration
    displacement: Displacement
    kalman: KalmanSettings
    camera: CameraCalibration | None
    track: PixelTrack | None
    tracking: CameraTracking | None
    level_m: float = 0.0


def _require(recording: Recording, calibration: Calibration) -> None:
    if recording.has("camera") and calibration.camera is None:
        raise UsageError(
            "The calibration has no camera part, but the recording has a camera. Run `midspan calibrate` on a "
            "recording of this camera."
        )
    camera = recording.settings.camera
    if camera and calibration.camera and camera.direction != calibration.camera.direction:
        raise UsageError(
            f"{recording.file}: camera.direction = {camera.direction!r}: the calibration was made for "
            f"{calibration.camera.direction!r}. Calibrate again."
        )


def _inputs(
    recording: Recording, calibration: Calibration, tracking: CameraTracking | None, progress: Progress
) -> Inputs:
    prepared = recording.prepared
    acceleration = prepared.with_noise(calibration.noise_density)
    kalman = KalmanSettings(bias=calibration.bias_m_s2, bias_std=_bias_std(calibration, prepared.value_m_s2))
    track = None
    blocks = []
    if calibration.camera is not None and recording.has("camera"):
        tracking = tracking or open_tracking(recording, calibration, progress)
        track = _track_all(
            tracking, Monitor(tracking.tracker, calibration.camera.mapping(), KalmanFilter(kalman)), acceleration
        )
        blur_s = tracking.blur_s(recording.settings.camera.exposure_s if recording.settings.camera else None)
        blocks.append(_unblurred(calibration.camera.mapping().displacement(track), blur_s, acceleration))
    if recording.has("displacement"):
        blocks.append(_displacement(recording, calibration))
    level = 0.0 if track is not None else float(blocks[0].value_m[np.argmax(np.isfinite(blocks[0].value_m))])
    blocks[0] = replace(blocks[0], value_m=blocks[0].value_m - level)
    measured = _merged(blocks, acceleration, kalman)
    acceleration = _from_first_measurement(acceleration, measured, calibration.noise_density)
    interval = float(np.median(np.diff(blocks[0].time_ns))) / NANOSECONDS
    kalman = replace(
        kalman,
        coasting_s=max(COASTING_INTERVALS * interval, 0.05),
        lost_s=max(10.0, 10.0 * interval),
        velocity_std=_velocity_std(prepared, measured),
    )
    camera = calibration.camera if track is not None else None
    return Inputs(acceleration, measured, kalman, camera, track, tracking, level)


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


def _track_all(tracking: CameraTracking, monitor: Monitor, acceleration: Acceleration) -> PixelTrack:
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


def _merged(blocks: list[Displacement], acceleration: Acceleration, kalman: KalmanSettings) -> Displacement:
    """All measurements in time order; a second sensor is brought to the zero of the first."""
    first = blocks[0]
    for other in blocks[1:]:
        smoothed = smooth(acceleration, first, kalman).estimate
        span = inside(other.time_ns, int(first.time_ns[0]), int(first.time_ns[-1]))
        level = np.interp(other.time_ns[span], smoothed.time_ns, smoothed.displacement_m)
        shift = float(np.nanmedian(other.value_m[span] - level)) if span.stop > span.start else 0.0
        both = joined([first, replace(other, value_m=other.value_m - shift)])
        first = part(both, np.argsort(both.time_ns, kind="stable"))
    if not np.isfinite(first.value_m).any():
        raise DataError("No frame could be tracked and no displacement is left; check camera.roi and the video.")
    return first


def _from_first_measurement(acceleration: Acceleration, measured: Displacement, density: float) -> Acceleration:
    """Put a sample before the first measurement where that comes first: the zero belongs to it."""
    first, start = int(measured.time_ns[0]), int(acceleration.time_ns[0])
    if first >= start or start - first > 2 * NANOSECONDS:
        return acceleration
    value = float(np.mean(acceleration.value_m_s2[:100]))
    unknown = float(np.var(acceleration.value_m_s2))
    before = Acceleration(np.array([first - 1]), np.array([value]), np.array([density]))
    widened = acceleration.noise_density.copy()
    widened[0] += unknown
    return joined([before, replace(acceleration, noise_density=widened)])


def _fuse(inputs: Inputs, method: str) -> Smoothed:
    """Run the method; the displacement counts from the first frame where a camera gives the zero."""
    if method == "smoother":
        smoothed = _smooth_twice(inputs)
        return replace(smoothed, estimate=_zeroed(inputs, smoothed.estimate, smoothed.estimate))
    stream = KalmanFilter(inputs.kalman)
    stream.push(inputs.displacement)
    outputs = stream.push(inputs.acceleration)
    (rows,) = [item for item in outputs if isinstance(item, Estimate)]
    innovations = [item for item in outputs if isinstance(item, Innovation)]
    events = tuple(item for item in outputs if isinstance(item, Event))
    start = int(inputs.acceleration.time_ns[0])
    window = inside(inputs.acceleration.time_ns, start, start + round(ZERO_S * NANOSECONDS))
    beginning = smooth(part(inputs.acceleration, window), inputs.displacement, inputs.kalman).estimate
    return Smoothed(_zeroed(inputs, rows, beginning), joined(innovations), events)


def _smooth_twice(inputs: Inputs) -> Smoothed:
    """The smoother, run again without lonely outliers where any got into the first run's wide predictions.

    After a gap the prediction is so wide that an outlier passes the gate and leads the filter away. A measurement that
    leaves its neighbours on both sides is only kept where a sharp prediction agrees with it.
    """
    measured = inputs.displacement
    first = smooth(inputs.acceleration, measured, inputs.kalman)
    usable = np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2)
    variance = np.where(usable, measured.variance_m2, np.inf)
    found = first.innovation
    if not len(found.time_ns):
        return first
    place = np.minimum(np.searchsorted(found.time_ns, measured.time_ns - 1), len(found.time_ns) - 1)
    sharp = found.variance_m2[place] < SHARP_VARIANCES * variance
    doubted = np.flatnonzero(usable & ~(sharp & (found.verdict[place] == ACCEPTED)))
    # Only the doubted ones and the neighbours they are judged by are looked at: a day has a million measurements.
    near = np.unique(np.clip(doubted[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1), 0, len(variance) - 1))
    rows = np.column_stack((seconds(measured.time_ns[near], 0), measured.value_m[near], variance[near]))
    lonely = np.intersect1d(near[np.isinf(without_lonely(rows)[:, 2])], doubted)
    if not len(lonely):
        return first
    del first
    variance[lonely] = np.inf
    return smooth(inputs.acceleration, replace(measured, variance_m2=variance), inputs.kalman)


def _zeroed(inputs: Inputs, rows: Estimate, beginning: Estimate) -> Estimate:
    """Rows counted from the displacement at the first frame, as the smoothed `beginning` knows it."""
    if inputs.camera is None:
        return replace(rows, displacement_m=rows.displacement_m + inputs.level_m)
    first = int(inputs.displacement.time_ns[np.argmax(inputs.displacement.source == Source.CAMERA)])
    k = int(np.argmin(np.abs(beginning.time_ns - first)))
    ahead = (first - int(beginning.time_ns[k])) / NANOSECONDS
    zero = beginning.displacement_m[k] + ahead * beginning.velocity_m_s[k]
    return replace(
        rows, displacement_m=rows.displacement_m - zero, variance_m2=rows.variance_m2 + beginning.variance_m2[k]
    )


def _with_calibration_error(inputs: Inputs, method: str, rows: Estimate) -> Estimate:
    """Variance widened by what the scale factor's and the clock offset's own uncertainty do to the result.

    The effect of each is found by fusing once more with the value moved by one standard deviation.
    """
    if inputs.camera is None:
        return rows
    variance = rows.variance_m2.copy()
    camera, measured = inputs.camera, inputs.displacement
    own = measured.source == Source.CAMERA
    relative = np.sqrt(camera.scale.variance) / abs(camera.scale.value_m_per_px)
    late = round(1e9 * np.sqrt(camera.offset.variance)) if np.isfinite(camera.offset.variance) else 0
    moved = []
    if relative > 0:
        moved.append(replace(measured, value_m=np.where(own, (1.0 + relative) * measured.value_m, measured.value_m)))
    if late > 0 and own.all():
        moved.append(replace(measured, time_ns=measured.time_ns + late))
    for block in moved:
        other = _fuse(replace(inputs, displacement=block), method).estimate
        variance += (other.displacement_m - rows.displacement_m) ** 2
    return replace(rows, variance_m2=variance)


def _cut(recording: Recording, inputs: Inputs, rows: Estimate) -> Estimate:
    """The rows in the common span; those whose sample had to be bridged are marked coasting."""
    usable = np.flatnonzero(np.isfinite(inputs.displacement.value_m))
    first, last = (int(inputs.displacement.time_ns[i]) for i in (usable[0], usable[-1]))
    # Samples that were put in before the start or into gaps are no rows of the result.
    sampled = recording.prepared.time_ns
    if len(rows.time_ns) > len(sampled):
        place = np.minimum(np.searchsorted(sampled, rows.time_ns), len(sampled) - 1)
        rows = part(rows, sampled[place] == rows.time_ns)
    missing = recording.prepared.missing
    status = np.where(missing & (rows.status == Status.TRACKING), np.uint8(Status.COASTING), rows.status)
    span = inside(rows.time_ns, first, last)
    if span.stop - span.start < 2:
        raise DataError(
            f"The streams do not overlap with the calibrated clock offset: measurements run from {shown(first)} to "
            f"{shown(last)} on the accelerometer's clock, which runs from {shown(int(rows.time_ns[0]))} to "
            f"{shown(int(rows.time_ns[-1]))}. Check the calibration's time_offset_s and the start_s of both."
        )
    return part(replace(rows, status=status), span)


def _lost_end(inputs: Inputs, rows: Estimate) -> list[str]:
    """A sentence when the measurements stop long before both streams do."""
    end = min(int(inputs.displacement.time_ns[-1]), int(inputs.acceleration.time_ns[-1]))
    missed = (end - int(rows.time_ns[-1])) / NANOSECONDS
    if missed <= max(1.0, inputs.kalman.coasting_s):
        return []
    return [
        f"The target was lost from {shown(int(rows.time_ns[-1]))} to the end; the result stops there, "
        f"{missed:.1f} s early."
    ]


def _refuse_rejections(innovation: Innovation) -> None:
    """UntrustedError when most measurements contradict the prediction."""
    share = float(np.mean(innovation.verdict == REJECTED)) if len(innovation.verdict) else 0.0
    if share > MOST_REJECTED:
        raise UntrustedError(
            f"{100 * share:.0f} % of the measurements contradict the acceleration; at most "
            f"{100 * MOST_REJECTED:g} % may. "
            "Scale factor, clock offset or direction belong to another recording, or the sensors do not measure "
            "the same "
            "motion. Calibrate this recording, and look at its camera.roi."
        )


def _warnings(calibration: Calibration, inputs: Inputs, fused: Smoothed, rows: Estimate) -> tuple[str, ...]:
    found = list(calibration.warnings)
    if inputs.tracking is not None:
        found += inputs.tracking.warnings()
    found += [event.text for event in fused.events]
    found += _lost_end(inputs, rows)
    rejected = float(np.mean(fused.innovation.verdict == 1)) if len(fused.innovation.verdict) else 0.0
    if rejected > 0.02:
        found.append(f"{100 * rejected:.1f} % of the measurements were rejected as outliers.")
    for status in (Status.COASTING, Status.LOST):
        share = float(np.mean(rows.status == status))
        if share > 0.0:
            found.append(f"{100 * share:.2g} % of the rows are {status.word}: no measurement supports them.")
    return tuple(found)
