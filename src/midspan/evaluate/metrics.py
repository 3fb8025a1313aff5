"""A displacement against a reference, and a result against its own error band."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from midspan.checks import option, positive, same_length
from midspan.errors import DataError, UsageError
from midspan.evaluate.interpolation import Piecewise, piecewise, step_of
from midspan.evaluate.lag import correlation, find_lag
from midspan.fusion.blocks import REJECTED
from midspan.records import Floats, Innovation, Nanoseconds, TimeSeries, seconds
from midspan.signals.stamps import shown

MAX_LAG_S = 1.0
MIN_INSTANTS = 2
ALIGNMENTS = ("none", "zero", "zero+lag")
# What takes off half of the error is named.
MOSTLY = 0.5
# Displacement and reference correlated like this have one form: a fifth of the variance is another (1 - 0.9² = 0.19).
ALIKE = 0.9
# Units of length are ten times apart or more; nearer than half of that it may be a scale.
UNITS_APART = 5.0


@dataclass(frozen=True, slots=True)
class Band:
    """Standard deviation (n,) of a displacement, m, and the part of it that is its zero's, common to all rows, m."""

    std_m: Floats
    zero_std_m: float = 0.0

    @property
    def without_zero(self) -> Floats:
        """The standard deviation (n,) without that of the zero, m."""
        with np.errstate(over="ignore"):
            return np.asarray(np.sqrt(np.maximum(np.asarray(self.std_m) ** 2 - self.zero_std_m**2, 0.0)))


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far a displacement is from a reference after `zero_mm` and `late_s` were taken off the displacement.

    rmse_mm; bias_mm: mean error; largest_error_mm: in absolute value, at largest_error_at_s. normalised_rmse_percent:
    of the reference's peak-to-peak; None where that is zero. coverage_95: share of the errors within ±1.96 of the
    estimate's standard deviation, without that of the zero where a zero was taken off; None where it has none.
    """

    zero_mm: float
    late_s: float
    rmse_mm: float
    bias_mm: float
    largest_error_mm: float
    largest_error_at_s: float
    normalised_rmse_percent: float | None
    coverage_95: float | None


@dataclass(frozen=True, slots=True)
class Comparison(Agreement):
    """A displacement against a reference at `count` of its own instants, from start_s to end_s on its clock.

    plain, without_zero, without_zero_and_lag: as they are, after the mean error, and after the lag and the mean error
    were taken off (None where there is no lag). align: "none", "zero" or "zero+lag": which of them is the headline,
    whose figures are its own; without a lag those without the zero.
    correlation, lag_s: None for constant signals; a positive lag: the estimate comes later than the reference.
    time_ns, error_mm (count,): estimate minus reference, of the headline; notes: what was assumed and left out.
    """

    start_s: float
    end_s: float
    count: int
    plain: Agreement
    without_zero: Agreement
    without_zero_and_lag: Agreement | None
    align: str
    correlation: float | None
    lag_s: float | None
    peak_to_peak_mm: float
    reference_peak_to_peak_mm: float
    notes: tuple[str, ...] = ()
    time_ns: Nanoseconds = field(default_factory=lambda: np.empty(0, dtype=np.int64), repr=False, compare=False)
    error_mm: Floats = field(default_factory=lambda: np.empty(0), repr=False, compare=False)

    def __repr__(self) -> str:
        inside = "" if self.coverage_95 is None else f", {100 * self.coverage_95:.1f} % inside ±1.96 σ"
        return (
            f"Comparison(RMSE {self.rmse_mm:.4g} mm, bias {self.bias_mm:.4g} mm{inside}; {self.count} instants from "
            f"{self.start_s:g} to {self.end_s:g} s)"
        )

    @property
    def rmse_without_bias_mm(self) -> float:
        """Root mean square of the errors without their mean, mm."""
        return self.without_zero.rmse_mm

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values, without the series: those of the headline, then each of the three."""
        tree = asdict(self)
        del tree["time_ns"], tree["error_mm"]
        return {**tree, "rmse_without_bias_mm": self.rmse_without_bias_mm, "notes": list(self.notes)}


def compare(
    estimate: TimeSeries,
    reference: TimeSeries,
    *,
    band: Band | None = None,
    align: str = "none",
    max_lag_s: float = MAX_LAG_S,
) -> Comparison:
    """Compare a displacement with a reference over their common span.

    estimate, reference: displacement in m on one clock; band: the estimate's standard deviation, where it has one;
    align: the headline, "none", "zero" or "zero+lag"; max_lag_s: largest lag looked for, s, above 0. The reference is
    interpolated at the estimate's instants (cubic spline, never across a gap of more than three of its intervals).
    Raises DataError without common instants.
    """
    positive("max_lag_s", max_lag_s, "s")
    option("align", align, ALIGNMENTS)
    splines = piecewise(reference)
    time_s = seconds(estimate.time_ns, splines.origin_ns)
    both = _Pair.at(estimate, splines.at(time_s), band)
    if len(both.time_ns) < MIN_INSTANTS:
        raise _no_common_span(estimate, reference)
    lag_s = find_lag(seconds(both.time_ns, splines.origin_ns), both.value, splines, max_lag_s)
    late = None if lag_s is None else _Pair.at(estimate, splines.at(time_s - lag_s), band)
    on_one_clock = None if late is None else late.agreement(zero=True, late_s=lag_s or 0.0)
    agreements = (both.agreement(), both.agreement(zero=True), on_one_clock)
    headline = agreements[ALIGNMENTS.index(align)] or agreements[1]
    drawn = late if late is not None and headline is on_one_clock else both
    return Comparison(
        **asdict(headline),
        start_s=int(both.time_ns[0]) / 1e9,
        end_s=int(both.time_ns[-1]) / 1e9,
        count=len(both.time_ns),
        plain=agreements[0],
        without_zero=agreements[1],
        without_zero_and_lag=agreements[2],
        align=align,
        correlation=correlation(both.value, both.expected),
        lag_s=lag_s,
        peak_to_peak_mm=1e3 * float(np.ptp(both.value)),
        reference_peak_to_peak_mm=1e3 * float(np.ptp(both.expected)),
        notes=(*_explained(both, agreements), *_notes(estimate, splines, both.error)),
        time_ns=drawn.time_ns,
        error_mm=1e3 * drawn.error - headline.zero_mm,
    )


@dataclass(frozen=True, slots=True)
class _Pair:
    """Displacement and reference (n,) in m at common instants, and the displacement's band."""

    time_ns: Nanoseconds
    value: Floats
    expected: Floats
    band: Band | None

    @classmethod
    def at(cls, estimate: TimeSeries, expected: Floats, band: Band | None) -> "_Pair":
        """Where both are known."""
        used = np.isfinite(expected) & np.isfinite(estimate.value)
        own = None if band is None else replace(band, std_m=np.asarray(band.std_m)[used])
        return cls(estimate.time_ns[used], estimate.value[used], expected[used], own)

    @property
    def error(self) -> Floats:
        """Displacement minus reference (n,), m."""
        return self.value - self.expected

    def agreement(self, *, zero: bool = False, late_s: float = 0.0) -> Agreement:
        """The figures, after the mean error was taken off or as they are; the lag is off already."""
        off = float(np.mean(self.error)) if zero else 0.0
        error, extent = self.error - off, float(np.ptp(self.expected))
        rmse, worst = float(np.sqrt(np.mean(error**2))), int(np.argmax(np.abs(error)))
        covered = None
        if self.band is not None:
            covered = coverage(error, self.band.without_zero if zero else self.band.std_m, 0.95)
        return Agreement(
            zero_mm=1e3 * off,
            late_s=late_s,
            rmse_mm=1e3 * rmse,
            bias_mm=1e3 * float(np.mean(error)),
            largest_error_mm=1e3 * abs(float(error[worst])),
            largest_error_at_s=int(self.time_ns[worst]) / 1e9,
            normalised_rmse_percent=100.0 * rmse / extent if extent > 0 else None,
            coverage_95=covered,
        )


def _explained(both: _Pair, agreements: tuple[Agreement, Agreement, Agreement | None]) -> tuple[str, ...]:
    """What most of the error is, where that is a unit, a zero or a clock rather than the displacement's form."""
    plain, zero, late = agreements
    found = []
    if (ratio := _of_another_scale(both)) is not None:
        found.append(
            f"Displacement and reference have the same form, but the displacement is {ratio:.3g} times the reference. "
            "Check the units of both (--unit) and their signs."
        )
    if zero.rmse_mm < MOSTLY * plain.rmse_mm:
        found.append(
            f"The reference has another zero: the displacement is {zero.zero_mm:+.4g} mm from it on average. Without "
            f"that the RMSE is {zero.rmse_mm:.4g} mm{_inside(zero)} (--align zero)."
        )
    if late is not None and late.rmse_mm < MOSTLY * zero.rmse_mm:
        which = "late" if late.late_s > 0 else "early"
        found.append(
            f"The reference has another clock: the displacement is {1e3 * abs(late.late_s):.4g} ms {which}. Without "
            f"that and without the zero the RMSE is {late.rmse_mm:.4g} mm{_inside(late)} (--align zero+lag)."
        )
    return tuple(found)


def _of_another_scale(both: _Pair) -> float | None:
    """How many times the reference the displacement is, where they are alike but for a unit or the sign."""
    alike = correlation(both.value, both.expected)
    if alike is None or abs(alike) < ALIKE:
        return None
    ratio = alike * float(np.std(both.value) / np.std(both.expected))
    return None if 1 / UNITS_APART < ratio < UNITS_APART else ratio


def _inside(found: Agreement) -> str:
    return "" if found.coverage_95 is None else f", and {100 * found.coverage_95:.3g} % lie inside ±1.96 σ"


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
