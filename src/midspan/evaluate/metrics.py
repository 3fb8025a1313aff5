"""A displacement against a reference, and a result against its own error band."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from midspan.checks import option, positive, same_length
from midspan.errors import DataError, UsageError
from midspan.fusion.blocks import REJECTED
from midspan.records import NANOSECONDS, Floats, Innovation, Nanoseconds, TimeSeries, seconds
from midspan.signals.stamps import shown

# A pause of the reference longer than this many of its usual intervals is a gap: nothing is interpolated across it.
MAX_GAP_STEPS = 3.0


@dataclass(frozen=True, slots=True)
class Piecewise:
    """A series as cubic splines, one for each segment without a gap.

    Not-a-knot splines: their error is at most 5/384 · h⁴ · max|x''''|, for a sine of frequency f sampled at rate r thus
    5/384 · (2π f/r)⁴ of its amplitude; Akima's and other local cubics are of lower order at the crests. A spline across
    a gap would ring into its neighbours, so each segment has its own.
    origin_ns: what its seconds count from; start_s, end_s (k,): the segments; step_s: the usual interval.
    """

    origin_ns: int
    start_s: Floats
    end_s: Floats
    step_s: float
    splines: tuple[Any, ...]

    def at(self, time_s: Floats) -> Floats:
        """Values (n,) at increasing instants (n,), s after `origin_ns`; NaN in gaps and outside."""
        value = np.full(len(time_s), np.nan)
        first = np.searchsorted(time_s, self.start_s, side="left")
        last = np.searchsorted(time_s, self.end_s, side="right")
        for spline, i, j in zip(self.splines, first, last, strict=True):
            if j > i:
                value[i:j] = spline(time_s[i:j])
        return value

    def covers(self, time_s: Floats, margin_s: float) -> Any:
        """Whether (n,) each instant lies in a segment, `margin_s` away from both its ends."""
        k = np.clip(np.searchsorted(self.start_s, time_s, side="right") - 1, 0, len(self.start_s) - 1)
        return (time_s - margin_s >= self.start_s[k]) & (time_s + margin_s <= self.end_s[k])


def piecewise(series: TimeSeries) -> Piecewise:
    """Splines of a series (n,) in its own unit; values that are not numbers count as missing.

    Raises DataError below two numbers.
    """
    usable = np.isfinite(series.value)
    time_ns, value = series.time_ns[usable], series.value[usable]
    if len(time_ns) < 2:
        raise DataError(f"The reference needs two numbers or more; it has {len(time_ns)}. Check its column.")
    step_ns = float(np.median(np.diff(time_ns)))
    edges = np.concatenate(([0], np.flatnonzero(np.diff(time_ns) > MAX_GAP_STEPS * step_ns) + 1, [len(time_ns)]))
    origin_ns = int(time_ns[0])
    time_s = seconds(time_ns, origin_ns)
    return Piecewise(
        origin_ns=origin_ns,
        start_s=time_s[edges[:-1]],
        end_s=time_s[edges[1:] - 1],
        step_s=step_ns / NANOSECONDS,
        splines=tuple(_spline(time_s[i:j], value[i:j]) for i, j in pairwise(edges)),
    )


def _spline(time_s: Floats, value: Floats) -> Any:
    from scipy.interpolate import CubicSpline

    if len(time_s) == 1:
        return lambda at: np.full(len(at), value[0])
    return CubicSpline(time_s, value, bc_type="not-a-knot")


def step_of(time_ns: Nanoseconds) -> float:
    """The usual interval of stamps (n,), s."""
    return float(np.median(np.diff(time_ns))) / NANOSECONDS


# The correlation is taken over this many instants at most, chosen at random: evenly thinned ones could always meet a
# periodic motion at the same phase.
MAX_INSTANTS = 5_000
MIN_LAG_INSTANTS = 20
MAX_LAGS = 2_000
CANDIDATES = 5
# Of maxima that differ by less than this, as a periodic motion has them, the one with the smallest lag is meant.
ALIKE_MAXIMA = 1e-3


def correlation(a: Floats, b: Floats) -> float | None:
    """Pearson's correlation of two arrays (n,); None where either one is constant."""
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt(np.dot(a, a) * np.dot(b, b)))
    floor = 1e-12 * len(a) * float(np.finfo(float).tiny + np.max(np.abs(a)) * np.max(np.abs(b)))
    return float(np.dot(a, b)) / power if power > floor else None


def find_lag(time_s: Floats, value: Floats, reference: Piecewise, max_lag_s: float) -> float | None:
    """Seconds by which `value` (n,) at `time_s` (n,) comes later than the reference; positive: later.

    The lag maximises the correlation of value(t) with reference(t − lag) within ±max_lag_s, or a quarter of the span in
    common where that is shorter: scanned in steps of the finer of both intervals, the best maxima then refined on the
    reference's spline. None where either is constant, or no maximum lies inside.
    """
    span = float(np.sum(reference.end_s - reference.start_s))
    limit = min(max_lag_s, 0.25 * min(span, float(time_s[-1] - time_s[0])))
    inside = np.flatnonzero(reference.covers(time_s, limit))
    if len(inside) < MIN_LAG_INSTANTS or limit <= 0.0:
        return None
    if len(inside) > MAX_INSTANTS:
        inside = np.sort(np.random.default_rng(0).choice(inside, MAX_INSTANTS, replace=False))
    at, own = time_s[inside], value[inside]

    def score(lag_s: float) -> float:
        found = correlation(own, reference.at(at - lag_s))
        return -2.0 if found is None else found

    step = min(float(np.median(np.diff(time_s))), reference.step_s)
    lags = np.linspace(-limit, limit, min(2 * int(np.ceil(limit / step)) + 1, MAX_LAGS + 1))
    return _refined(lags, np.array([score(lag) for lag in lags]), score)


def _refined(lags: Floats, scores: Floats, score: Callable[[float], float]) -> float | None:
    """The refined lag of the highest maximum inside, None without one."""
    from scipy.optimize import minimize_scalar

    peaks = np.flatnonzero((scores[1:-1] >= scores[:-2]) & (scores[1:-1] > scores[2:])) + 1
    peaks = peaks[np.argsort(scores[peaks])[::-1][:CANDIDATES]]
    if not len(peaks) or max(scores[0], scores[-1]) > scores[peaks[0]] + ALIKE_MAXIMA:
        return None
    found = []
    for i in peaks:
        bracket = (float(lags[i - 1]), float(lags[i + 1]))
        options = {"xatol": 1e-7}
        refined = minimize_scalar(lambda lag: -score(lag), bounds=bracket, method="bounded", options=options)
        found.append((float(refined.x), -float(refined.fun)))
    best = max(value for _, value in found)
    return min((lag for lag, value in found if value > best - ALIKE_MAXIMA), key=abs)


MAX_LAG_S = 1.0
MIN_INSTANTS = 2
ALIGNMENTS = ("none", "zero", "zero+lag")
# What takes off half of the error is named.
MOSTLY = 0.5
ANOTHER_ZERO = "The reference has another zero"
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
        inside, left = (
            "" if one.coverage_95 is None else f", {100 * one.coverage_95:.1f} % inside ±1.96 σ"
            for one in (self, self.without_zero)
        )
        return (
            f"Comparison(RMSE {self.rmse_mm:.4g} mm, bias {self.bias_mm:.4g} mm{inside}; zero removed: RMSE "
            f"{self.rmse_without_bias_mm:.4g} mm{left}; {self.count} instants from {self.start_s:g} to "
            f"{self.end_s:g} s)"
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
    # A mean error that the band of the zero contains is no other zero.
    contained_mm = 0.0 if both.band is None else 1.96e3 * both.band.zero_std_m
    if zero.rmse_mm < MOSTLY * plain.rmse_mm and abs(zero.zero_mm) > contained_mm:
        found.append(
            f"{ANOTHER_ZERO}: the displacement is {zero.zero_mm:+.4g} mm from it on average. With "
            f"aligned zeros the RMSE is {zero.rmse_mm:.4g} mm{_inside(zero)} (--align zero)."
        )
    if late is not None and late.rmse_mm < MOSTLY * zero.rmse_mm:
        which = "late" if late.late_s > 0 else "early"
        found.append(
            f"The reference has another clock: the displacement is {1e3 * abs(late.late_s):.4g} ms {which}. With "
            f"aligned zero and lag the RMSE is {late.rmse_mm:.4g} mm{_inside(late)} (--align zero+lag)."
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
            f"The reference has {1 / splines.step_s:.4g} values per second, the result {1 / step:.4g}: it is "
            "interpolated and misses motion above about a quarter of its rate."
        )
    if len(splines.splines) > 1:
        count = len(splines.splines) - 1
        found.append(f"The reference has {count} {'gap' if count == 1 else 'gaps'}; nothing is compared there.")
    if len(error) < 0.5 * len(estimate.value):
        found.append(f"Only {100 * len(error) / len(estimate.value):.3g} % of the result overlaps the reference.")
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
