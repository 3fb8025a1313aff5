"""The fusion of a recording's prepared inputs: outliers, the zero, and what the calibration's own error adds."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.time_offset import without_lonely
from midspan.errors import UntrustedError
from midspan.fusion.gate import ACCEPTED, REACQUIRED, REJECTED, GateSettings
from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.noise_profile import LEAST, noise_factors
from midspan.fusion.runners import RUNNERS, MethodSettings, Runner, run_method
from midspan.fusion.smoother import Smoothed, smooth
from midspan.recording.span import inside, shown
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    Estimate,
    Floats,
    Innovation,
    Source,
    joined,
    part,
    seconds,
)
from midspan.signals.health import Mask

# A prediction is sharp when its variance with the measurement's is below this many of the measurement's own.
SHARP_VARIANCES = 25.0
NEIGHBOURS = 8
# The zero of `kalman` comes from this much of the record, smoothed: it belongs to its start-up.
ZERO_S = 60.0
# Wide enough to let everything in: the response to an error must be linear.
NO_GATE = GateSettings(limit=1e9)


@dataclass(frozen=True, slots=True)
class SensorError:
    """What is uncertain of one sensor: relative standard deviation of its scale, and of its clock in s."""

    source: Source
    relative_scale_std: float = 0.0
    clock_std_s: float = 0.0


@dataclass(frozen=True, slots=True)
class FusionInputs:
    """What is fused: acceleration, displacement measurements of all sensors, the filter's settings.

    zero_ns: the instant that the displacement counts from (the first frame), None for a displacement sensor's own zero;
    level_m: taken off the displacement before fusing, so that a height of 123 m does not start the filter 123 m away;
    errors: what is uncertain of each sensor's calibration.
    """

    acceleration: Acceleration
    displacement: Displacement
    kalman: KalmanSettings
    zero_ns: int | None = None
    level_m: float = 0.0
    errors: tuple[SensorError, ...] = ()


def fuse(inputs: FusionInputs, method: str, settings: MethodSettings | None = None) -> Smoothed:
    """Run a method of `midspan methods`; rows count from the zero, their variance holds all that is uncertain.

    settings: the keys of [fusion] that single methods use; its filter settings are those of `inputs`. Raises
    UntrustedError where the method ran away.
    """
    settings = replace(settings or MethodSettings(), kalman=inputs.kalman)
    runner = RUNNERS[method]
    fused = _smooth_again(inputs) if method == "smoother" else _run(inputs, method, settings)
    _refuse_runaway(fused, method)
    zero = _at_zero(inputs, fused.estimate if runner.both_ways else _beginning(inputs))
    rows = fused.estimate
    variance = rows.variance_m2 + zero[1]
    for error_m in _measurement_errors(inputs, rows):
        variance = variance + _response(inputs, runner, settings, error_m, fused) ** 2
    displacement_m = rows.displacement_m + (inputs.level_m if inputs.zero_ns is None else -zero[0])
    return replace(fused, estimate=replace(rows, displacement_m=displacement_m, variance_m2=variance))


def _run(inputs: FusionInputs, method: str, settings: MethodSettings) -> Smoothed:
    return run_method(method, inputs.acceleration, inputs.displacement, settings)


def _refuse_runaway(fused: Smoothed, method: str) -> None:
    rows = fused.estimate
    if np.all(np.isfinite(rows.displacement_m)) and np.all(np.isfinite(rows.variance_m2)):
        return
    raise UntrustedError(
        f"{method} ran away: its rows must be finite numbers, and from "
        f"{shown(int(rows.time_ns[np.argmin(np.isfinite(rows.displacement_m) & np.isfinite(rows.variance_m2))]))} on "
        "they are not. Leave fusion.literal out, or choose another fusion.method."
    )


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
    k = int(np.argmin(np.abs(rows.time_ns - inputs.zero_ns)))
    ahead = (inputs.zero_ns - int(rows.time_ns[k])) / NANOSECONDS
    return float(rows.displacement_m[k] + ahead * rows.velocity_m_s[k]), float(rows.variance_m2[k])


def _smooth_again(inputs: FusionInputs) -> Smoothed:
    """The smoother, run again where the first run found lonely outliers or noise that is other than declared.

    After a gap the prediction is so wide that an outlier passes the gate and leads the filter away. A measurement that
    leaves its neighbours on both sides is only kept where a sharp prediction agrees with it.
    """
    first = smooth(inputs.acceleration, inputs.displacement, inputs.kalman)
    lonely = _lonely(inputs.displacement, first.innovation)
    learnt = _learnt_variance(inputs.displacement, first.innovation)
    if not lonely.any() and learnt is None:
        return first
    declared = inputs.displacement.variance_m2 if learnt is None else learnt
    variance = np.where(lonely, np.inf, declared)
    second = smooth(inputs.acceleration, replace(inputs.displacement, variance_m2=variance), inputs.kalman)
    # They count as rejected measurements, with the first run's innovations.
    left_out = part(first.innovation, np.isin(first.innovation.time_ns, inputs.displacement.time_ns[lonely]))
    both = joined([second.innovation, replace(left_out, verdict=np.full_like(left_out.verdict, REJECTED))])
    both = part(both, np.argsort(both.time_ns, kind="stable"))
    return replace(second, innovation=both, variance_m2=declared[_places(inputs.displacement, both)])


def _learnt_variance(measured: Displacement, found: Innovation) -> Floats | None:
    """Variance (m,) of each measurement where the noise is clearly other than declared; None where it nowhere is."""
    met = _places(measured, found)
    declared = measured.variance_m2[met]
    variance = measured.variance_m2.copy()
    for source in np.unique(measured.source[met]):
        own = measured.source[met] == source
        # The prediction's own variance follows the noise that is told, so the whole innovation scales with it.
        variance[met[own]] = noise_factors(part(found, own)) ** 2 * declared[own]
    return None if np.array_equal(variance[met], declared) else variance


def _lonely(measured: Displacement, found: Innovation) -> Mask:
    """Measurements (m,) that leave their neighbours of the same sensor without a sharp prediction that agrees."""
    usable = np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2)
    sharp = np.zeros(len(usable), dtype=bool)
    met = _places(measured, found)
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


def _places(measured: Displacement, found: Innovation) -> NDArray[np.int64]:
    """The measurement (index) that each innovation belongs to; their stamps agree to the nanosecond."""
    place = np.searchsorted(measured.time_ns, found.time_ns - 1)
    return np.minimum(place, len(measured.time_ns) - 1)


def _measurement_errors(inputs: FusionInputs, rows: Estimate) -> list[Floats]:
    """The error (m,) of all measurements for one standard deviation of each uncertain value of each sensor."""
    measured = inputs.displacement
    value = np.where(np.isfinite(measured.value_m), measured.value_m, 0.0)
    found = []
    for error in inputs.errors:
        own = measured.source == error.source
        if error.relative_scale_std > 0.0:
            found.append(np.where(own, error.relative_scale_std * value, 0.0))
        if 0.0 < error.clock_std_s < np.inf:
            velocity = np.interp(measured.time_ns, rows.time_ns, rows.velocity_m_s)
            found.append(np.where(own, error.clock_std_s * velocity, 0.0))
    return found


def _response(
    inputs: FusionInputs, runner: Runner, settings: MethodSettings, error_m: Floats, fused: Smoothed
) -> Floats:
    """What an error (m,) of the measurements that were used does to each row, relative to the zero: linear."""
    found, declared = fused.innovation, inputs.displacement.variance_m2
    if not len(found.time_ns):
        # Methods without a gate use every measurement.
        return _alone(inputs, runner, settings, (error_m, declared))
    met = _places(inputs.displacement, found)
    used = (found.verdict == ACCEPTED) | (found.verdict == REACQUIRED)
    taken = declared[met] if fused.variance_m2 is None else np.maximum(fused.variance_m2, LEAST**2 * declared[met])
    variance = np.full(len(error_m), np.inf)
    variance[met[used]] = taken[used]
    return _alone(inputs, runner, settings, (error_m, variance))


def _alone(inputs: FusionInputs, runner: Runner, settings: MethodSettings, measured: tuple[Floats, Floats]) -> Floats:
    """The method's rows, relative to the zero, for measurements (value, variance) alone, without acceleration."""
    error_m, variance = measured
    alone = replace(
        inputs,
        acceleration=replace(inputs.acceleration, value_m_s2=np.zeros(len(inputs.acceleration.time_ns))),
        displacement=replace(inputs.displacement, value_m=error_m, variance_m2=variance),
        kalman=replace(inputs.kalman, bias=0.0, gate=NO_GATE),
    )
    rows = _run(alone, runner.response, replace(settings, kalman=alone.kalman)).estimate
    return rows.displacement_m - _at_zero(alone, rows if runner.both_ways else _beginning(alone))[0]
