"""From an opened, calibrated recording to what is fused: tracking to its end, displacement in metres, first guesses."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.fusion.streams import KalmanSettings
from midspan.recording.cameras.lost_target import lost_events, lost_warnings
from midspan.recording.cameras.tracked import Eye, Seen, Side, open_eyes, seen_along, side_of, track_all, zero_of
from midspan.recording.displacement.sensor import displacement_inputs
from midspan.recording.fusing.fuse import FusionInputs, SensorError
from midspan.recording.fusing.one_clock import OneClock
from midspan.recording.fusing.one_zero import merged
from midspan.recording.sensor_series import SensorSeries, series_of
from midspan.recording.stored.calibration import Calibration
from midspan.recording.streams.acceleration import PreparedAcceleration, from_first_measurement
from midspan.recording.streams.progress import Progress
from midspan.recording.streams.recording import Recording
from midspan.recording.tracking.tracking import CameraTracking
from midspan.records import (
    NANOSECONDS,
    Displacement,
    Event,
)
from midspan.signals.health import Mask, dominant_frequency

# Rows are `coasting` when the last accepted measurement is older than this many of the sensor's usual intervals.
COASTING_INTERVALS = 2.5


@dataclass(frozen=True, slots=True)
class Gathered:
    """The inputs of the fusion, and warnings.

    across: the inputs along the second image axis; eyes: all cameras; radar: what it measured; frozen: what of
    [displacement] stood still; events: targets lost and seen again, clocks that jump.
    """

    inputs: FusionInputs
    warnings: tuple[str, ...]
    across: FusionInputs | None = None
    eyes: tuple[Eye, ...] = ()
    radar: RadarInputs | None = None
    frozen: tuple[Event, ...] = ()
    events: tuple[Event, ...] = ()


def gather(
    recording: Recording, calibration: Calibration, tracking: CameraTracking | None, progress: Progress
) -> Gathered:
    """Track what is left of the camera's frames with the filters' predictions, and bring all sensors together."""
    sides = [side_of(recording, calibration)]
    if recording.across is not None and calibration.across is not None:
        sides.append(side_of(recording.across, calibration.across))
    eyes = open_eyes(sides, tracking, progress)
    if eyes:
        track_all(eyes)
    radar = None
    if recording.has("radar"):
        radar = radar_inputs(recording, calibration, sides[0].acceleration, sides[0].kalman, progress)
    main = _inputs(sides[0], 0, eyes, radar=radar)
    across = None
    warnings = (*main.warnings, *(line for one in main.seen for line in lost_warnings(*_blind(one))))
    if len(sides) > 1:
        beside = _inputs(sides[1], 1, eyes, {seen.eye.sensor: seen.clock for seen in main.seen})
        across, warnings = beside.inputs, (*warnings, *beside.warnings)
    return Gathered(
        inputs=main.inputs,
        warnings=warnings,
        across=across,
        eyes=eyes,
        radar=radar,
        frozen=main.frozen,
        events=(*(event for one in main.seen for event in lost_events(*_blind(one))), *main.events),
    )


def _blind(seen: Seen) -> tuple[SensorSeries, Mask]:
    """What tells when a camera's target was lost."""
    series = series_of(seen.eye.sensor, seen.eye.source, seen.measured)
    return series, seen.eye.tracking.targets[seen.eye.best].dark


@dataclass(frozen=True, slots=True)
class Along:
    """What is fused along one axis, what each camera says along it, warnings, what of [displacement] stood still, and
    what happened to the clocks.
    """

    inputs: FusionInputs
    seen: tuple[Seen, ...]
    warnings: tuple[str, ...]
    frozen: tuple[Event, ...]
    events: tuple[Event, ...] = ()


def _inputs(
    side: Side,
    axis: int,
    eyes: tuple[Eye, ...],
    clocks: dict[str, OneClock] | None = None,
) -> Along:
    """What is fused along the axis with this number (0: the main one).

    clocks: of each camera, as learnt along the main axis; None learns them.
    """
    recording, calibration, blocks = side.recording, side.calibration, []
    seen = tuple(seen_along(side, axis, eye, (clocks or {}).get(eye.sensor)) for eye in eyes[:1])
    told = [line for one in seen for line in one.warnings]
    errors = [SensorError(one.eye.source, one.relative_std, one.clock_std_s) for one in seen]
    clocks_met = [one.clock for one in seen]
    blocks += [one.measured for one in seen]
    if radar is not None:
        blocks.append(radar.measured)
        errors.append(radar.error)
        told += radar.warnings
    frozen: tuple[Event, ...] = ()
    if recording.has("displacement"):
        sensor = displacement_inputs(recording, calibration, acceleration=side.acceleration, kalman=side.kalman)
        blocks.append(sensor.measured)
        errors.append(sensor.error)
        frozen = sensor.events
        told += sensor.warnings
        clocks_met.append(sensor.clock)
    from_first_frame = bool(seen)
    level = 0.0 if from_first_frame else float(blocks[0].value_m[np.argmax(np.isfinite(blocks[0].value_m))])
    blocks[0] = replace(blocks[0], value_m=blocks[0].value_m - level)
    jumped = [level for clock in clocks_met for level in clock.levels]
    together = merged(blocks, side.acceleration, side.kalman)
    measured = together.measured
    velocity_std = _velocity_std(side.prepared, measured)
    begun = from_first_measurement(side.acceleration, measured, side.prepared.rate_hz)
    inputs = FusionInputs(
        acceleration=begun,
        displacement=measured,
        kalman=_with_ages(replace(side.kalman, velocity_std=velocity_std), blocks[0]),
        zero_ns=None if not from_first_frame else zero_of(seen, blocks[0]),
        level_m=level,
        errors=tuple(errors),
        levels=(
            *together.levels,
            *(one.wandering for one in seen if one.wandering is not None),
            *(() if radar is None else radar.levels),
            *jumped,
        ),
        sampled=None if begun is side.acceleration else side.acceleration,
    )
    events = tuple(event for clock in clocks_met for event in clock.events)
    return Along(inputs, seen, (*together.warnings, *told), frozen, events)


def _with_ages(kalman: KalmanSettings, measured: Displacement) -> KalmanSettings:
    # Two cameras take turns; at night one of them is left.
    each = [measured.time_ns[measured.source == source] for source in np.unique(measured.source)]
    usual = [float(np.median(np.diff(time_ns))) / NANOSECONDS for time_ns in each if len(time_ns) > 1]
    interval = max(usual, default=0.0)
    return replace(kalman, coasting_s=max(COASTING_INTERVALS * interval, 0.05), lost_s=max(10.0, 10.0 * interval))


def _velocity_std(prepared: PreparedAcceleration, measured: Displacement) -> float:
    """First uncertainty of the velocity: three times the larger of what either sensor says of its size."""
    # Of one sensor: two that measure a millisecond apart differ by their noise.
    usable = np.isfinite(measured.value_m)
    usable &= measured.source == measured.source[np.argmax(usable)]
    steps = np.diff(measured.value_m[usable]) / np.maximum(np.diff(measured.time_ns[usable]) / NANOSECONDS, 1e-3)
    slow = float(np.sqrt(np.mean(steps**2))) if len(steps) else 1.0
    value = prepared.value_m_s2
    fast = (
        0.0
        if not value.any()
        else float(np.std(value)) / (2.0 * np.pi * max(dominant_frequency(value, prepared.rate_hz), 0.2))
    )
    return 3.0 * max(slow, fast)
