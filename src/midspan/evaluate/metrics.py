"""A displacement against a reference, and a result against its own error band."""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from midspan.checks import positive, same_length
from midspan.errors import DataError, UsageError
from midspan.evaluate.interpolation import Piecewise, piecewise, step_of
from midspan.evaluate.lag import correlation, find_lag
from midspan.fusion.blocks import REJECTED
from midspan.records import Floats, Innovation, Nanoseconds, TimeSeries, seconds
from midspan.signals.stamps import shown

MAX_LAG_S = 1.0
MIN_INSTANTS = 2


@dataclass(frozen=True, slots=True)
class Comparison:
    """A displacement against a reference at `count` of its own instants, from start_s to end_s on its clock.

    rmse_mm; bias_mm: mean error; rmse_without_bias_mm: what is left without it; largest_error_mm: in absolute value,
    at largest_error_at_s. normalised_rmse_percent: of the reference's peak-to-peak; None where that is zero.
    correlation, lag_s: None for constant signals; a positive lag: the estimate comes later than the reference.
    coverage_95: share of the errors within ±1.96 of the estimate's standard deviation; None where it has none.
    time_ns, error_mm (count,): estimate minus reference; notes: what was assumed and left out.
    """

    start_s: float
    end_s: float
    count: int
    rmse_mm: float
    rmse_without_bias_mm: float
    bias_mm: float
    largest_error_mm: float
    largest_error_at_s: float
    normalised_rmse_percent: float | None
    correlation: float | None
    lag_s: float | None
    peak_to_peak_mm: float
    reference_peak_to_peak_mm: float
    coverage_95: float | None
    notes: tuple[str, ...] = ()
    time_ns: Nanoseconds = field(default_factory=lambda: np.empty(0, dtype=np.int64), repr=False, compare=False)
    error_mm: Floats = field(default_factory=lambda: np.empty(0), repr=False, compare=False)

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values, without the series."""
        tree = asdict(self)
        del tree["time_ns"], tree["error_mm"]
        return tree | {"notes": list(self.notes)}


def compare(
    estimate: TimeSeries, reference: TimeSeries, *, std_m: Floats | None = None, max_lag_s: float = MAX_LAG_S
) -> Comparison:
    """Compare a displacement with a reference over their common span.

    estimate, reference: displacement in m on one clock; std_m (n,): the estimate's standard deviation, m, where it has
    one; max_lag_s: largest lag looked for, s, above 0. The reference is interpolated at the estimate's instants (cubic
    spline, never across a gap of more than three of its intervals). Raises DataError without common instants.
    """
    positive("max_lag_s", max_lag_s, "s")
    splines = piecewise(reference)
    time_s = seconds(estimate.time_ns, splines.origin_ns)
    expected = splines.at(time_s)
    used = np.isfinite(expected) & np.isfinite(estimate.value)
    if np.count_nonzero(used) < MIN_INSTANTS:
        raise _no_common_span(estimate, reference)
    value = estimate.value[used]
    error = value - expected[used]
    std = None if std_m is None else np.asarray(std_m)[used]
    lag_s = find_lag(time_s[used], value, splines, max_lag_s)
    return _comparison(estimate.time_ns[used], (value, expected[used]), std, lag_s, _notes(estimate, splines, error))


def _comparison(
    time_ns: Nanoseconds,
    pair: tuple[Floats, Floats],
    std_m: Floats | None,
    lag_s: float | None,
    notes: tuple[str, ...],
) -> Comparison:
    error = pair[0] - pair[1]
    rmse, bias = float(np.sqrt(np.mean(error**2))), float(np.mean(error))
    extent = float(np.ptp(pair[1]))
    worst = int(np.argmax(np.abs(error)))
    return Comparison(
        start_s=int(time_ns[0]) / 1e9,
        end_s=int(time_ns[-1]) / 1e9,
        count=len(time_ns),
        rmse_mm=1e3 * rmse,
        rmse_without_bias_mm=1e3 * float(np.std(error)),
        bias_mm=1e3 * bias,
        largest_error_mm=1e3 * abs(float(error[worst])),
        largest_error_at_s=int(time_ns[worst]) / 1e9,
        normalised_rmse_percent=100.0 * rmse / extent if extent > 0 else None,
        correlation=correlation(*pair),
        lag_s=lag_s,
        peak_to_peak_mm=1e3 * float(np.ptp(pair[0])),
        reference_peak_to_peak_mm=1e3 * extent,
        coverage_95=None if std_m is None else coverage(error, std_m, 0.95),
        notes=notes,
        time_ns=time_ns,
        error_mm=1e3 * error,
    )


def _notes(estimate: TimeSeries, splines: Piecewise, error: Floats) -> tuple[str, ...]:
    found = []
    step = step_of(estimate.time_ns)
    if splines.step_s > 2.0 * step:
        found.append(
            f"The reference has {1 / splines.step_s:.4g} values a second, the result {1 / step:.4g}: between its "
            "values it is interpolated, which misses motion faster than about a quarter of its rate."
        )
    if len(splines.splines) > 1:
        count = len(splines.splines) - 1
        found.append(f"The reference has {count} {'gap' if count == 1 else 'gaps'}; nothing is compared there.")
    if len(error) < 0.5 * len(estimate.value):
        found.append(f"Only {100 * len(error) / len(estimate.value):.3g} % of the result lie where the reference does.")
    return tuple(found)


def _no_common_span(estimate: TimeSeries, reference: TimeSeries) -> DataError:
    spans = [f"{shown(int(s.time_ns[0]))} to {shown(int(s.time_ns[-1]))}" for s in (estimate, reference)]
    return DataError(
        f"Result and reference have no instants in common: the result runs from {spans[0]}, the reference from "
        f"{spans[1]}. Both must be on the accelerometer's clock; check that they belong to one recording "
        "and the unit of the times."
    )


def coverage(error: Floats, std: Floats, level: float = 0.95) -> float:
    """Share of the errors (n,) within the band of probability `level` (0 to 1) of their standard deviation (n,).

    For an honest normal band it is `level`. Values that are not finite are left out; NaN where none is left. Raises
    UsageError for a level outside its range.
    """
    from scipy.special import ndtri

    if not 0.0 < level < 1.0:
        raise UsageError(f"level must be a probability between 0 and 1; received {level!r}. 0.95 is usual.")
    same_length(error=error, std=std)
    known = np.isfinite(error) & np.isfinite(std)
    if not known.any():
        return float("nan")
    return float(np.mean(np.abs(error[known]) <= float(ndtri(0.5 + 0.5 * level)) * std[known]))


def normalised_innovation(innovation: Innovation) -> Floats:
    """Innovations over their predicted standard deviation (k,), without the rejected ones.

    For a filter with the right noise levels they are white with mean 0 and mean square (the NIS) 1.
    """
    used = innovation.verdict != REJECTED
    return np.asarray(innovation.value_m[used] / np.sqrt(innovation.variance_m2[used]), dtype=np.float64)
