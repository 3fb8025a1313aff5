"""A record through the two branches of a complementary FIR method, segment by segment of even samples.

Rows whose filters would reach over an end or a gap are those of the smoothed path, which the estimator makes. What the
sampling of the displacement and its interpolation make of such a motion (folding, imaging) is in the rows' band.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.path import at
from midspan.fusion.streams import KalmanSettings, Smoothed, smooth
from midspan.papers.printed.branches import (
    EXACT_RULE,
    AtFrames,
    Branches,
    NoiseGain,
    Rates,
    integration_error,
    velocity,
)
from midspan.papers.printed.filters import FilterBank
from midspan.papers.printed.resample import REACH_STEPS, filtered_at, local_spline
from midspan.records import NANOSECONDS, Acceleration, Displacement, Estimate, Event, Floats, Nanoseconds, part, seconds
from midspan.signals.health import Mask, runs

# A step of the acceleration outside these shares of the usual one ends a segment.
SHORTEST_STEP, LONGEST_STEP = 0.5, 1.5
# A displacement interval longer than this many usual ones is a gap and not interpolated.
LONGEST_STEPS = 2.5
# Of the guarded forms: a gap of up to this many usual intervals is filled from the path, as long as the acceleration
# alone carries it well.
FILLED_STEPS = 10.0
# This many such intervals in a row are a slower sensor: with one value in ten missing by chance, once in 10^10 values.
MIN_SLOW = 5
# Measurements closer than this share of the usual interval to the one before are left out: a spline through both would
# swing.
CLOSE_SHARE = 0.4
# A value that lies this many standard deviations from the path is an outlier.
OUTLIER_STD = 6.0
# Stamps that scatter by less than this share of a step about an even clock are taken for even.
EVEN_SHARE = 1e-4
# Over this many samples jitter averages out, and a clock's drift does not.
CLOCK_SAMPLES = 2001
# Where no noise density or variance is given: 1 mg in 100 Hz, 0.1 mm.
USUAL_DENSITY, USUAL_VARIANCE = 1e-6, 1e-8


@dataclass(frozen=True, slots=True)
class Method:
    """The branches with their rates, and the filters' transforms; knots (m, 3): time in s, displacement, variance.

    path: the smoothed record, whose motion shows what sampling makes of it.
    """

    branches: Branches
    rates: Rates
    bank: FilterBank
    noise: NoiseGain
    knots: Floats
    path: Estimate

    @classmethod
    def make(cls, branches: Branches, rates: Rates, knots: Floats, path: Estimate) -> "Method":
        """Prepare the transforms: of displacement and acceleration the row, of the sampled path what it is off by."""
        bank = FilterBank((branches.low, branches.high, None), (None, None, branches.low))
        return cls(branches, rates, bank, NoiseGain(branches, rates), knots, path)


def smoothed_record(acceleration: Acceleration, displacement: Displacement, kalman: KalmanSettings) -> Smoothed:
    """The smoothed record; the filters know no bias, so that its mean is as good as any."""
    return smooth(acceleration, displacement, replace(kalman, bias=float(np.mean(acceleration.value_m_s2))))


class Literal(Protocol):
    """Settings of a paper's method."""

    @property
    def literal(self) -> bool:
        """Exactly as printed."""


Settings = TypeVar("Settings", bound=Literal)


def fused(
    design: Callable[[Rates, Settings], Branches],
    settings: Settings,
    record: tuple[Acceleration, Displacement],
    smoothed: Smoothed,
) -> Smoothed:
    """The smoothed record with the rows (n) of the branches that are designed for its rates.

    Its path gives the rows of ends and gaps, and decides what is an outlier; a row for each sample within it. Except in
    the literal form the path also stands for outliers and missing measurements in short gaps.
    """
    (acceleration, displacement), path, fill = record, smoothed.estimate, not settings.literal
    within = (acceleration.time_ns >= path.time_ns[0]) & (acceleration.time_ns <= path.time_ns[-1])
    rows = rows_at(path, acceleration.time_ns[within])
    usable = np.isfinite(displacement.value_m) & np.isfinite(displacement.variance_m2)
    measured = part(displacement, usable)
    rates = rates_of(acceleration, measured)
    if rates is None:
        return replace(smoothed, estimate=rows)
    measured = without_outliers(measured, path) if fill else measured
    origin_ns = int(acceleration.time_ns[0])
    knots = _knots(measured, rates, origin_ns)
    slow = slower_events(knots, rates, origin_ns)
    knots = _filled(knots, rates, path, origin_ns) if fill else knots
    branches = design(rates, settings)
    method = Method.make(branches, rates, knots, path)
    for segment in segments(acceleration, rates.step_s):
        _overwrite(rows, _segment(method, segment, origin_ns))
    reported = tuple(Event(origin_ns, "rate", text) for text in branches.warnings)
    events = (*smoothed.events, *reported, *slow)
    return replace(smoothed, estimate=rows, events=events, delay_s=_delay_s(method))


def rows_at(path: Estimate, time_ns: Nanoseconds) -> Estimate:
    """The rows of an estimate at other stamps (n,); source and status are those of its last row before each.

    The velocity is that of straight lines: the slope of the cubic would be sharper on a smoothed path, but a causal one
    jumps where a measurement is met.
    """
    displacement, variance = at(path, time_ns)
    origin = int(path.time_ns[0])
    velocity = np.interp(seconds(time_ns, origin), seconds(path.time_ns, origin), path.velocity_m_s)
    last = np.maximum(np.searchsorted(path.time_ns, time_ns, side="right") - 1, 0)
    return Estimate(time_ns, displacement, variance, velocity, path.source[last], path.status[last])


def _delay_s(method: Method) -> float:
    """Reach of a row into what comes later: of the filters, the anti-aliasing stage's, and the spline, s."""
    before = 0 if method.branches.removed is None else method.branches.removed.half
    return (method.bank.half + before) * method.rates.step_s + method.branches.reach_steps * method.rates.frame_s


def slower_events(knots: Floats, rates: Rates, origin_ns: int) -> list[Event]:
    """An event for each segment in which a slower sensor stands in: the filters are not made for it."""
    found = []
    for first, last in runs(np.diff(knots[:, 0]) > LONGEST_STEPS * rates.frame_s):
        start_s, length_s = knots[first, 0], knots[last, 0] - knots[first, 0]
        if last - first >= MIN_SLOW:
            text = (
                f"For {length_s:.3g} s displacement came every {length_s / (last - first):.2g} s only, and not every "
                f"{rates.frame_s:.3g} s as the filters are made for: the rows there rest on the smoother."
            )
            found.append(Event(origin_ns + round(start_s * NANOSECONDS), "rate", text))
    return found


def without_outliers(measured: Displacement, path: Estimate) -> Displacement:
    """The measurements but those that lie far from the path."""
    expected, variance = at(path, measured.time_ns)
    apart = (measured.value_m - expected) ** 2
    return part(measured, apart <= OUTLIER_STD**2 * (measured.variance_m2 + variance))


def rates_of(acceleration: Acceleration, measured: Displacement) -> Rates | None:
    """Usual steps and noise levels; None where there are too few of either to tell."""
    if len(acceleration.time_ns) < 3 or len(measured.time_ns) < 3:
        return None
    # Of several sensors the one that measures most.
    main = np.bincount(measured.source).argmax()
    return Rates(
        step_s=_usual_step(acceleration.time_ns),
        frame_s=_usual_step(measured.time_ns[measured.source == main]),
        noise_density=_usual(acceleration.noise_density, USUAL_DENSITY),
        variance_m2=_usual(measured.variance_m2, USUAL_VARIANCE),
    )


def segments(acceleration: Acceleration, step_s: float) -> list[Acceleration]:
    """The samples between the gaps."""
    steps = np.diff(acceleration.time_ns) / (step_s * NANOSECONDS)
    gaps = np.flatnonzero((steps < SHORTEST_STEP) | (steps > LONGEST_STEP)) + 1
    edges = [0, *gaps.tolist(), len(acceleration.time_ns)]
    return [part(acceleration, slice(first, last)) for first, last in pairwise(edges)]


def _segment(method: Method, block: Acceleration, origin_ns: int) -> Estimate:
    """The rows of a segment that have full windows, at its stamps."""
    time_s = seconds(block.time_ns, origin_ns)
    even_s = even_clock(time_s)
    value = block.value_m_s2 if even_s is time_s else _resampled(even_s, time_s, block.value_m_s2)
    displacement, sampled, sound = _on_grid(method, even_s, value, origin_ns)
    branches, half = method.branches, method.bank.half
    full = _full(sound, half + 1)
    if not full.any():
        return part(_rows_of(block.time_ns, np.zeros((3, len(even_s)))), full)
    found, off = method.bank(displacement, value, sampled)
    own = method.noise.half
    variance = np.full(len(even_s), np.inf)
    variance[own : len(even_s) - own] = method.noise.rows(_variance(method.knots, even_s), block.noise_density)
    inner = slice(half + 1, len(even_s) - half - 1)
    if branches.rule != EXACT_RULE:
        variance[inner] += integration_error(found, branches.rule) ** 2
    variance[inner] += off[1:-1] ** 2
    rows = np.zeros((3, len(even_s)))
    rows[0, inner], rows[1] = found[1:-1], variance
    rows[2, inner] = velocity(found, value[half : len(value) - half], method.rates.step_s)
    if even_s is time_s:
        return part(_rows_of(block.time_ns, rows), full)
    # What the stamps are off the even clock is less than a step.
    late_s = time_s - even_s
    change = np.gradient(rows[2], method.rates.step_s)
    rows[0] += late_s * (rows[2] + 0.5 * late_s * change)
    rows[2] += late_s * change
    return part(_rows_of(block.time_ns, rows), full)


def _rows_of(time_ns: Nanoseconds, rows: Floats) -> Estimate:
    codes = np.zeros(len(time_ns), dtype=np.uint8)
    return Estimate(time_ns, rows[0], rows[1], rows[2], codes, codes)


def _overwrite(rows: Estimate, own: Estimate) -> None:
    """Write a segment's displacement, variance and velocity to their rows; source and status stay the path's."""
    place = np.searchsorted(rows.time_ns, own.time_ns)
    known = place < len(rows.time_ns)
    known[known] &= rows.time_ns[place[known]] == own.time_ns[known]
    for name in ("displacement_m", "variance_m2", "velocity_m_s"):
        getattr(rows, name)[place[known]] = getattr(own, name)[known]


def even_clock(time_s: Floats) -> Floats:
    """The stamps (n,) themselves where they are even; else those of an even clock that follows them slowly."""
    from scipy.ndimage import uniform_filter1d

    steps = np.diff(time_s)
    if len(steps) < 2 or np.std(steps) <= EVEN_SHARE * np.median(steps):
        return time_s
    number = np.arange(len(time_s))
    line = np.polynomial.Polynomial.fit(number, time_s, 1)(number)
    even_s: Floats = line + uniform_filter1d(time_s - line, CLOCK_SAMPLES, mode="reflect")
    return even_s


def _resampled(at_s: Floats, time_s: Floats, value: Floats) -> Floats:
    """A series at other instants by a cubic spline; at its ends by straight lines."""
    step_s = float(np.median(np.diff(time_s)))
    columns = np.column_stack((value, value))
    rows, sound = local_spline(at_s, time_s, columns, 3.0 * step_s, REACH_STEPS * step_s)
    return np.where(sound, rows[0], np.interp(at_s, time_s, value))


def _knots(measured: Displacement, rates: Rates, origin_ns: int) -> Floats:
    """The measurements (m, 3) that a spline is laid through."""
    time_s = seconds(measured.time_ns, origin_ns)
    apart = np.diff(time_s, prepend=-np.inf) >= CLOSE_SHARE * rates.frame_s
    return np.column_stack((time_s, measured.value_m, measured.variance_m2))[apart]


def _filled(knots: Floats, rates: Rates, path: Estimate, origin_ns: int) -> Floats:
    """With values of the path in short gaps; their errors have everything in common, which their variance holds."""
    steps = np.rint(np.diff(knots[:, 0]) / rates.frame_s).astype(int)
    more = []
    for i in np.flatnonzero((steps > 1) & (steps <= FILLED_STEPS)):
        time_s = np.linspace(knots[i, 0], knots[i + 1, 0], steps[i] + 1)[1:-1]
        value, variance = at(path, origin_ns + np.rint(time_s * NANOSECONDS).astype(np.int64))
        more.append(np.column_stack((time_s, value, len(time_s) * variance)))
    whole = np.concatenate((knots, *more))
    return whole[np.argsort(whole[:, 0], kind="stable")]


def _on_grid(method: Method, even_s: Floats, value: Floats, origin_ns: int) -> tuple[Floats, Floats, Mask]:
    """Anti-aliased displacement, what sampling makes of the path, and whether both are sound, at instants (n,)."""
    branches, rates, knots = method.branches, method.rates, method.knots
    index = np.searchsorted(even_s, knots[:, 0], side="right") - 1
    removed = _at_knots(branches.removed, (even_s, value), index, knots[:, 0])
    expected, there = (
        at(method.path, origin_ns + np.rint(time_s * NANOSECONDS).astype(np.int64))[0]
        for time_s in (knots[:, 0], even_s)
    )
    columns = np.column_stack((knots[:, 1] - removed, expected - removed))
    limits = (LONGEST_STEPS * rates.frame_s, branches.reach_steps * rates.frame_s)
    rows, sound = local_spline(even_s, knots[:, 0], columns, *limits)
    return rows[0], rows[1] - there, sound


def _at_knots(taps: AtFrames | None, grid: tuple[Floats, Floats], index: NDArray[np.int64], time_s: Floats) -> Floats:
    """What a filter makes of the acceleration at the knots (m,); NaN where it reaches too far, 0 without a filter."""
    if taps is None:
        return np.zeros(len(time_s))
    even_s, value = grid
    inside = (index >= taps.half) & (index + taps.half + 1 < len(even_s))
    result = np.full(len(time_s), np.nan)
    first = index[inside]
    fraction = (time_s[inside] - even_s[first]) / (even_s[first + 1] - even_s[first])
    result[inside] = filtered_at(value, first, fraction, (taps.wanted, taps.bend))
    return result


def _variance(knots: Floats, even_s: Floats) -> Floats:
    """Variance (n,) in m² of the knots around instants (n,)."""
    if np.ptp(knots[:, 2]) == 0.0:
        return np.full(len(even_s), knots[0, 2])
    return np.interp(even_s, knots[:, 0], knots[:, 2])


def _full(sound: Mask, margin: int) -> Mask:
    """Whether rows (n,) have nothing but sound ones within this many samples on each side."""
    count = np.concatenate(([0], np.cumsum(sound)))
    full = np.zeros(len(sound), dtype=bool)
    if len(sound) > 2 * margin:
        full[margin : len(sound) - margin] = count[2 * margin + 1 :] - count[: -2 * margin - 1] == 2 * margin + 1
    return full


def _usual_step(time_ns: Nanoseconds) -> float:
    """The mean of the steps that are no gaps, s."""
    steps = np.diff(time_ns) / NANOSECONDS
    median = float(np.median(steps))
    near = steps[(steps > SHORTEST_STEP * median) & (steps < LONGEST_STEP * median)]
    return float(np.mean(near)) if len(near) else max(median, 1.0 / NANOSECONDS)


def _usual(values: Floats, otherwise: float) -> float:
    """The median of what is finite and above zero."""
    known = values[np.isfinite(values) & (values > 0.0)]
    return float(np.median(known)) if len(known) else otherwise
