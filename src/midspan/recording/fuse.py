"""The fusion of a recording's prepared inputs: outliers, the zero, and what the calibration's own error adds."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.time_offset import without_lonely
from midspan.fusion.gate import ACCEPTED, REACQUIRED, REJECTED, GateSettings
from midspan.fusion.kalman import KalmanFilter, KalmanSettings
from midspan.fusion.smoother import Smoothed, smooth
from midspan.recording.span import inside
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    Estimate,
    Event,
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


def fuse(inputs: FusionInputs, method: str) -> Smoothed:
    """Run `method` ("smoother" or "kalman"); rows count from the zero, their variance holds all that is uncertain."""
    fused = _smooth_twice(inputs) if method == "smoother" else _filter(inputs)
    zero = _at_zero(inputs, fused.estimate if method == "smoother" else _beginning(inputs))
    rows = fused.estimate
    variance = rows.variance_m2 + zero[1]
    for error_m in _measurement_errors(inputs, rows):
        variance = variance + _response(inputs, method, error_m, fused.innovation) ** 2
    displacement_m = rows.displacement_m + (inputs.level_m if inputs.zero_ns is None else -zero[0])
    return replace(fused, estimate=replace(rows, displacement_m=displacement_m, variance_m2=variance))


def _filter(inputs: FusionInputs) -> Smoothed:
    stream = KalmanFilter(inputs.kalman)
    stream.push(inputs.displacement)
    outputs = stream.push(inputs.acceleration)
    (rows,) = [item for item in outputs if isinstance(item, Estimate)]
    innovations = [item for item in outputs if isinstance(item, Innovation)]
    return Smoothed(rows, joined(innovations), tuple(item for item in outputs if isinstance(item, Event)))


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


def _smooth_twice(inputs: FusionInputs) -> Smoothed:
    """The smoother, run again without lonely outliers where any got into the first run's wide predictions.

    After a gap the prediction is so wide that an outlier passes the gate and leads the filter away. A measurement that
    leaves its neighbours on both sides is only kept where a sharp prediction agrees with it.
    """
    first = smooth(inputs.acceleration, inputs.displacement, inputs.kalman)
    lonely = _lonely(inputs.displacement, first.innovation)
    if not lonely.any():
        return first
    variance = np.where(lonely, np.inf, inputs.displacement.variance_m2)
    second = smooth(inputs.acceleration, replace(inputs.displacement, variance_m2=variance), inputs.kalman)
    # They count as rejected measurements, with the first run's innovations.
    left_out = part(first.innovation, np.isin(first.innovation.time_ns, inputs.displacement.time_ns[lonely]))
    both = joined([second.innovation, replace(left_out, verdict=np.full_like(left_out.verdict, REJECTED))])
    return replace(second, innovation=part(both, np.argsort(both.time_ns, kind="stable")))


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


def _response(inputs: FusionInputs, method: str, error_m: Floats, found: Innovation) -> Floats:
    """What an error (m,) of the measurements that were used does to each row, relative to the zero: linear."""
    used = np.zeros(len(error_m), dtype=bool)
    used[_places(inputs.displacement, found)] = (found.verdict == ACCEPTED) | (found.verdict == REACQUIRED)
    alone = replace(
        inputs,
        acceleration=replace(inputs.acceleration, value_m_s2=np.zeros(len(inputs.acceleration.time_ns))),
        displacement=replace(
            inputs.displacement,
            value_m=error_m,
            variance_m2=np.where(used, inputs.displacement.variance_m2, np.inf),
        ),
        kalman=replace(inputs.kalman, bias=0.0, gate=NO_GATE),
    )
    if method == "smoother":
        rows = smooth(alone.acceleration, alone.displacement, alone.kalman).estimate
        return rows.displacement_m - _at_zero(alone, rows)[0]
    return _filter(alone).estimate.displacement_m - _at_zero(alone, _beginning(alone))[0]
