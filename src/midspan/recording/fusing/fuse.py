"""The fusion of a recording's prepared inputs: outliers, the zero, and what the calibration's own error adds."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.outliers import without_lonely
from midspan.errors import UntrustedError
from midspan.fusion.beginning import SHARP_VARIANCES, Beginning, judged_backwards
from midspan.fusion.causal import filter_record
from midspan.fusion.gate import ACCEPTED, REJECTED
from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.noise_profile import LEAST, noise_factors
from midspan.fusion.path import at, velocity_at
from midspan.fusion.response import linear, places, standing_still, used_variance
from midspan.fusion.runners import RUNNERS, MethodSettings, Runner, run_method
from midspan.fusion.smoother import Smoothed, doubt_levels, smooth
from midspan.recording.in_turn import in_turn
from midspan.recording.streams.span import inside, shown
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    Estimate,
    Event,
    Floats,
    Innovation,
    Nanoseconds,
    Source,
    joined,
    part,
    seconds,
)
from midspan.signals.health import Mask

NEIGHBOURS = 8
# The zero of `kalman` comes from this much of the record, smoothed: it belongs to its start-up.
ZERO_S = 60.0


@dataclass(frozen=True, slots=True)
class SensorError:
    """What is uncertain of one sensor: relative standard deviation of its scale, and of its clock in s."""

    source: Source
    relative_scale_std: float = 0.0
    clock_std_s: float = 0.0


@dataclass(frozen=True, slots=True)
class LevelError:
    """From an instant on a sensor's measurements count from a zero that is known to a standard deviation (m) only."""

    source: Source
    from_ns: int
    std_m: float


@dataclass(frozen=True, slots=True, eq=False)
class CourseError:
    """A sensor's zero wanders, and is known at stamps (n,) to standard deviations (n,) in m only.

    source: the sensor, or several whose zeros wander together.
    """

    source: Source | tuple[Source, ...]
    time_ns: Nanoseconds
    std_m: Floats


@dataclass(frozen=True, slots=True)
class FusionInputs:
    """What is fused: acceleration, displacement measurements of all sensors, the filter's settings.

    sampled: the acceleration without a sample that was put before the first one, None where there is no such sample;
    zero_ns: the instant that the displacement counts from (the first frame), None for a displacement sensor's own zero;
    level_m: taken off the displacement before fusing, so that a height of 123 m does not start the filter 123 m away;
    errors: what is uncertain of each sensor's calibration; levels: zeros that are uncertain, and errors that come back
    with the motion and do not average out. cameras: what each of two measured, all of it.
    """

    acceleration: Acceleration
    displacement: Displacement
    kalman: KalmanSettings
    zero_ns: int | None = None
    level_m: float = 0.0
    errors: tuple[SensorError, ...] = ()
    levels: tuple[LevelError | CourseError, ...] = ()
    sampled: Acceleration | None = None
    cameras: tuple[Displacement, ...] = ()


def fuse(inputs: FusionInputs, method: str, settings: MethodSettings | None = None) -> Smoothed:
    """Run a method of `midspan methods`; rows count from the zero, their variance holds all that is uncertain.

    settings: the keys of [fusion] that single methods use; its filter settings are those of `inputs`. Raises
    UntrustedError where the method ran away.
    """
    settings = replace(settings or MethodSettings(), kalman=inputs.kalman)
    runner = RUNNERS[method]
    if runner.one_series:
        inputs = replace(inputs, displacement=in_turn(inputs.displacement))
    begun = judged_backwards(inputs.acceleration, inputs.displacement, inputs.kalman)
    told = _outliers_at_start(inputs, begun)
    if told:
        variance = np.where(begun.wrong, np.inf, inputs.displacement.variance_m2)
        inputs = replace(inputs, displacement=replace(inputs.displacement, variance_m2=variance))
    fused = _smooth_again(inputs, begun.right) if method == "smoother" else _run(inputs, method, settings)
    fused = replace(fused, events=(*told, *fused.events))
    _refuse_runaway(fused, method)
    zero = _at_zero(inputs, _rows_of_zero(inputs, runner, fused.estimate))
    rows = fused.estimate
    variance = rows.variance_m2 + zero[1]
    for error_m in _measurement_errors(inputs, rows):
        variance = variance + _response(inputs, runner, settings, error_m, fused) ** 2
    displacement_m = rows.displacement_m + (inputs.level_m if inputs.zero_ns is None else -zero[0])
    estimate = replace(rows, displacement_m=displacement_m, variance_m2=variance)
    return replace(fused, estimate=estimate, zero_variance_m2=zero[1])


def _outliers_at_start(inputs: FusionInputs, begun: Beginning) -> tuple[Event, ...]:
    """An event for the first measurements that are left out: a filter that has just begun would believe them."""
    count = int(np.count_nonzero(begun.wrong))
    if not count:
        return ()
    first = int(inputs.displacement.time_ns[np.argmax(begun.wrong)])
    text = f"{count} of the first measurements, the first at {shown(first)}, contradict those after them; left out."
    return (Event(first, "rejected", text),)


def _run(inputs: FusionInputs, method: str, settings: MethodSettings) -> Smoothed:
    acceleration = inputs.acceleration if RUNNERS[method].has_state else _sampled(inputs)
    return run_method(method, acceleration, inputs.displacement, settings)


def _sampled(inputs: FusionInputs) -> Acceleration:
    """The accelerometer's own samples: to a method without a state one that was put before them is a gap."""
    return inputs.acceleration if inputs.sampled is None else inputs.sampled


def _refuse_runaway(fused: Smoothed, method: str) -> None:
    rows = fused.estimate
    if np.all(np.isfinite(rows.displacement_m)) and np.all(np.isfinite(rows.variance_m2)):
        return
    raise UntrustedError(
        f"{method} ran away: its rows must be finite numbers, and from "
        f"{shown(int(rows.time_ns[np.argmin(np.isfinite(rows.displacement_m) & np.isfinite(rows.variance_m2))]))} on "
        "they are not. Leave fusion.literal out, or choose another fusion.method."
    )


def _rows_of_zero(inputs: FusionInputs, runner: Runner, rows: Estimate) -> Estimate:
    """The rows that tell best what the displacement is at the zero."""
    reaches_zero = runner.has_state or inputs.sampled is None
    return rows if runner.both_ways and reaches_zero else _beginning(inputs)


def _beginning(inputs: FusionInputs) -> Estimate:
    """The start of the record, smoothed."""
    time_ns = inputs.acceleration.time_ns
    end = int(time_ns[0]) + round(ZERO_S * NANOSECONDS)
    first = part(inputs.displacement, inside(inputs.displacement.time_ns, int(time_ns[0]), end))
    return smooth(part(inputs.acceleration, inside(time_ns, int(time_ns[0]), end)), first, inputs.kalman).estimate


def _at_zero(inputs: FusionInputs, rows: Estimate) -> tuple[float, float]:
    """Displacement and variance at the zero's instant; nothing where the sensor has its own zero."""
    if inputs.zero_ns is None:
        return 0.0, 0.0
    if inputs.zero_ns < rows.time_ns[0]:
        return _measured_at_zero(inputs, inputs.zero_ns)
    displacement_m, variance_m2 = at(rows, np.array([inputs.zero_ns]))
    return float(displacement_m[0]), float(variance_m2[0])


def _measured_at_zero(inputs: FusionInputs, zero_ns: int) -> tuple[float, float]:
    """Displacement and variance of the zero's own measurement: before the samples nothing else is known of it."""
    measured = inputs.displacement
    k = int(np.argmax((measured.time_ns >= zero_ns) & np.isfinite(measured.value_m)))
    return float(measured.value_m[k]), float(measured.variance_m2[k])


def _smooth_again(inputs: FusionInputs, right: Mask) -> Smoothed:
    """The smoother over what a causal run leaves: without lonely outliers, with the noise that it found.

    The causal run learns the noise as it goes, so that a sudden change does not lead it away, as it would the smoother.
    After a gap the prediction is so wide that an outlier passes the gate and leads the filter away. A measurement that
    leaves its neighbours on both sides is only kept where a sharp prediction agrees with it. right (m,): measurements
    that are known to be no outliers.
    """
    causal = filter_record(inputs.acceleration, inputs.displacement, inputs.kalman)
    declared = _learnt_variance(inputs.displacement, causal)
    lonely = _lonely(replace(inputs.displacement, variance_m2=declared), causal.innovation) & ~right
    kept = replace(inputs.displacement, variance_m2=np.where(lonely, np.inf, declared))
    found = smooth(inputs.acceleration, kept, inputs.kalman)
    doubt_levels(found.estimate, found.innovation)
    if not lonely.any() and np.array_equal(declared, inputs.displacement.variance_m2, equal_nan=True):
        return found
    # They count as rejected measurements, with the causal run's innovations.
    met = places(inputs.displacement, causal.innovation)
    left_out = part(causal.innovation, lonely[met])
    both = joined([found.innovation, replace(left_out, verdict=np.full_like(left_out.verdict, REJECTED))])
    place = np.concatenate((places(kept, found.innovation), met[lonely[met]]))
    order = np.argsort(place)
    return replace(found, innovation=part(both, order), variance_m2=declared[place[order]])


def _learnt_variance(measured: Displacement, causal: Smoothed) -> Floats:
    """Variance (m,) of each measurement: another one than declared where the noise clearly is."""
    met, innovation = places(measured, causal.innovation), causal.innovation
    declared, used = measured.variance_m2[met], causal.variance_m2
    taken = np.ones(len(met)) if used is None else np.sqrt(used / declared)
    variance = measured.variance_m2.copy()
    for source in np.unique(measured.source[met]):
        own = measured.source[met] == source
        # The prediction's own variance follows the noise that is told, so the whole innovation scales with it.
        variance[met[own]] = noise_factors(part(innovation, own), taken[own]) ** 2 * declared[own]
    return variance


def _lonely(measured: Displacement, found: Innovation) -> Mask:
    """Measurements (m,) that leave their neighbours of the same sensor without a sharp prediction that agrees."""
    usable = np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2)
    sharp = np.zeros(len(usable), dtype=bool)
    met = places(measured, found)
    sharp[met] = (found.variance_m2 < SHARP_VARIANCES * measured.variance_m2[met]) & (found.verdict == ACCEPTED)
    mask = np.zeros(len(usable), dtype=bool)
    for source in np.unique(measured.source):
        own = np.flatnonzero(usable & (measured.source == source))
        doubted = np.flatnonzero(~sharp[own])
        # Only the doubted ones and the neighbours they are judged by are looked at: a day has a million measurements.
        near = np.unique(np.clip(doubted[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1), 0, len(own) - 1))
        which = own[near]
        rows = np.column_stack(
            (seconds(measured.time_ns[which], 0), measured.value_m[which], measured.variance_m2[which])
        )
        mask[np.intersect1d(which[np.isinf(without_lonely(rows)[:, 2])], own[doubted])] = True
    return mask


def _measurement_errors(inputs: FusionInputs, rows: Estimate) -> list[Floats]:
    """The error (m,) of all measurements for one standard deviation of each uncertain value of each sensor."""
    measured = inputs.displacement
    # A wrong scale moves a sensor's own zero as well.
    level = inputs.level_m if inputs.zero_ns is None else 0.0
    value = np.where(np.isfinite(measured.value_m), measured.value_m + level, 0.0)
    found = []
    for error in inputs.errors:
        own = measured.source == error.source
        if error.relative_scale_std > 0.0:
            found.append(np.where(own, error.relative_scale_std * value, 0.0))
        if 0.0 < error.clock_std_s < np.inf:
            found.append(np.where(own, error.clock_std_s * velocity_at(rows, measured.time_ns), 0.0))
    for zero in inputs.levels:
        if isinstance(zero, CourseError):
            std = np.interp(measured.time_ns, zero.time_ns, zero.std_m)
            found.append(np.where(np.isin(measured.source, zero.source), std, 0.0))
            continue
        own = (measured.source == zero.source) & (measured.time_ns >= zero.from_ns)
        found.append(np.where(own, zero.std_m, 0.0))
    return found


def _response(
    inputs: FusionInputs, runner: Runner, settings: MethodSettings, error_m: Floats, fused: Smoothed
) -> Floats:
    """What an error (m,) of the measurements that were used does to each row, relative to the zero: linear."""
    found, declared = fused.innovation, inputs.displacement.variance_m2
    if not len(found.time_ns):
        # Methods without a gate use every measurement.
        return _alone(inputs, runner, settings, (error_m, declared))
    taken = fused.variance_m2
    if taken is not None:
        taken = np.maximum(taken, LEAST**2 * declared[places(inputs.displacement, found)])
    return _alone(inputs, runner, settings, (error_m, used_variance(inputs.displacement, found, taken)))


def _alone(inputs: FusionInputs, runner: Runner, settings: MethodSettings, measured: tuple[Floats, Floats]) -> Floats:
    """The method's rows, relative to the zero, for measurements (value, variance) alone, without acceleration."""
    error_m, variance = measured
    alone = replace(
        inputs,
        acceleration=standing_still(inputs.acceleration),
        sampled=None if inputs.sampled is None else standing_still(inputs.sampled),
        displacement=replace(inputs.displacement, value_m=error_m, variance_m2=variance),
        kalman=linear(inputs.kalman),
    )
    rows = _run(alone, runner.response, replace(settings, kalman=alone.kalman)).estimate
    return rows.displacement_m - _at_zero(alone, _rows_of_zero(alone, runner, rows))[0]
