"""Rows of two complementary FIR branches as a stream: any cutting of the input gives the same rows.

A row is the displacement, brought to the accelerometer's stamps by a cubic spline, through a low-pass, and the
acceleration through a filter that integrates twice and passes the rest. A method that takes something off each
displacement first (the anti-aliasing stage) filters the acceleration at its instant. There are rows where the filters'
windows hold nothing but even steps of the acceleration and displacements without a gap.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from midspan.fusion.methods import SPLINE_FRAMES
from midspan.fusion.on_series import FIRST_NS, MethodRows, SampleBuffer
from midspan.papers.printed.resample import filtered_at, local_spline, spline_reach
from midspan.records import NANOSECONDS, Acceleration, Displacement, Event, Floats, Nanoseconds, seconds
from midspan.signals.health import Mask

# A step of the acceleration outside these shares of the usual one is a gap.
MIN_STEP, MAX_STEP = 0.5, 1.5
# A displacement interval longer than this many usual ones is a gap and not interpolated; nor is one that is longer than
# the spline looks ahead.
MAX_INTERVALS = 2.5
# Displacements closer than this share of the usual interval to the one before are left out: a spline through both would
# swing.
MIN_INTERVALS = 0.4
# Longer than any interval: the first displacement follows none.
MANY_NS = 1 << 62


@dataclass(frozen=True, slots=True)
class AtFrames:
    """A filter from acceleration to displacement at any instant: its taps and those of the second derivative · dt²."""

    wanted: Floats
    bend: Floats

    @property
    def half(self) -> int:
        """Samples that it needs on each side."""
        return len(self.wanted) // 2


@dataclass(frozen=True, slots=True)
class Branches:
    """A method made for a step and a frame interval, s; all taps symmetric, odd in number.

    low: displacement on the grid → low-frequency displacement; high: acceleration → high-frequency displacement (m);
    removed: what is taken off each displacement before it is interpolated (the anti-aliasing stage); spline_frames: how
    many displacements after an interval the spline looks at; bias_m_s2: is taken off the acceleration; warnings: in
    sentences.
    """

    low: Floats
    high: Floats
    step_s: float
    frame_s: float
    spline_frames: int
    removed: AtFrames | None = None
    bias_m_s2: float = 0.0
    warnings: tuple[str, ...] = ()

    @property
    def margin(self) -> int:
        """Samples that a row with its velocity needs on each side on the grid."""
        return max(len(self.low), len(self.high)) // 2 + 1

    @property
    def reach_s(self) -> float:
        """How far the spline looks behind the start of an interval."""
        return spline_reach(self.spline_frames) * self.frame_s

    @property
    def longest_s(self) -> float:
        """The longest interval that is interpolated."""
        return min(MAX_INTERVALS * self.frame_s, self.reach_s)

    @property
    def around_s(self) -> float:
        """How far the spline looks before an interval, and at most after it: four intervals, and the next knot."""
        return (SPLINE_FRAMES + 1) * MAX_INTERVALS * self.frame_s

    @property
    def removed_half(self) -> int:
        """Samples that the anti-aliasing stage needs on each side of a displacement."""
        return 0 if self.removed is None else self.removed.half + 1

    @property
    def delay_samples(self) -> int:
        """Samples that a row needs after its own: the filter, the spline and the anti-aliasing stage."""
        return self.margin + 1 + self.removed_half + int(np.ceil(self.reach_s / self.step_s))

    @property
    def before_samples(self) -> int:
        """Samples that a row needs before its own."""
        return self.margin + 1 + self.removed_half + int(np.ceil(self.around_s / self.step_s))


class FirRows:
    """The branches as a method over a series, see `fusion.on_series`."""

    def __init__(self, branches: Branches) -> None:
        self.branches, self.delay_samples = branches, branches.delay_samples
        self._samples, self._knots = SampleBuffer(1, branches.before_samples), SampleBuffer(1)
        # The first sample, which seconds count from, and the newest displacement.
        self._origin_ns, self._newest_ns, self._reported = FIRST_NS, FIRST_NS, False

    def wait(self, met: Displacement) -> None:
        """Take displacements that are later than the last sample."""
        if len(met.time_ns):
            apart = np.diff(met.time_ns, prepend=max(self._newest_ns, met.time_ns[0] - MANY_NS))
            usable = apart >= MIN_INTERVALS * self.branches.frame_s * NANOSECONDS
            self._knots.add(met.time_ns[usable], met.value_m[usable])
            self._newest_ns = int(met.time_ns[-1])

    def push(self, acceleration: Acceleration) -> None:
        """Take further samples."""
        if self._origin_ns == FIRST_NS:
            self._origin_ns = int(acceleration.time_ns[0])
        self._samples.add(acceleration.time_ns, acceleration.value_m_s2 - self.branches.bias_m_s2)

    def rows(self, time_ns: Nanoseconds) -> MethodRows:
        """The rows at samples (n,); with the first ones comes what is wrong with the rates."""
        place, kept = self._samples.at(time_ns)
        if not kept.any():
            return MethodRows(np.zeros(len(time_ns)), np.zeros(len(time_ns)), kept)
        around = self.branches.margin + 1
        first = max(int(place[0]) - around, 0)
        found, full = self._filtered(slice(first, int(place[-1]) + around))
        place = np.minimum(place - first, len(full) - 1)
        self._forget(int(time_ns[-1]))
        warnings, self._reported = () if self._reported else self.branches.warnings, True
        events = tuple(Event(int(time_ns[0]), "rate", text) for text in warnings)
        return MethodRows(found[0, place], found[1, place], kept & full[place], events)

    def predict(self, time_ns: int) -> None:
        """The estimator predicts."""

    @property
    def state(self) -> tuple[Any, ...]:
        """All that has an effect on what comes later."""
        return self._samples.state, self._knots.state, self._origin_ns, self._newest_ns, self._reported

    @state.setter
    def state(self, state: tuple[Any, ...]) -> None:
        self._samples.state, self._knots.state, self._origin_ns, self._newest_ns, self._reported = state

    def _filtered(self, window: slice) -> tuple[Floats, Mask]:
        """Displacement and velocity (2, n) of samples, and which have full windows among them."""
        time_ns, acceleration = self._samples.time_ns[window], self._samples.columns[0][window]
        branches, count = self.branches, len(time_ns)
        half, found = branches.margin - 1, np.zeros((2, count))
        if count < 2 * branches.margin + 1:
            return found, np.zeros(count, dtype=bool)
        slow, sound = self._on_grid(time_ns)
        displacement, inner = found[0], slice(half, count - half)
        displacement[inner] = through(slow, branches.low, half) + through(acceleration, branches.high, half)
        found[1, 1:-1] = velocity(displacement, acceleration, branches.step_s)
        return found, _full(sound, branches.margin)

    def _on_grid(self, time_ns: Nanoseconds) -> tuple[Floats, Mask]:
        """The displacement without what is removed at samples, and whether it and the step before each are sound."""
        branches, knots, around_ns = self.branches, self._knots, round(self.branches.around_s * NANOSECONDS)
        own = slice(*np.searchsorted(knots.time_ns, (time_ns[0] - around_ns, time_ns[-1] + around_ns)))
        knots_ns, at_s = knots.time_ns[own], seconds(time_ns, self._origin_ns)
        value = knots.columns[0][own] - self._removed(knots_ns)
        found, sound = local_spline(
            at_s, seconds(knots_ns, self._origin_ns), value, branches.longest_s, branches.reach_s
        )
        steps = np.diff(at_s, prepend=at_s[0] - branches.step_s) / branches.step_s
        return found, sound & (steps > MIN_STEP) & (steps < MAX_STEP)

    def _removed(self, knots_ns: Nanoseconds) -> Floats:
        """What the anti-aliasing stage takes off displacements (m,); NaN where it reaches beyond samples or a gap."""
        taps = self.branches.removed
        if taps is None:
            return np.zeros(len(knots_ns))
        time_ns, (acceleration,) = self._samples.time_ns, self._samples.columns
        index = np.searchsorted(time_ns, knots_ns, side="right") - 1
        result = np.full(len(knots_ns), np.nan)
        inside = (index >= taps.half) & (index + taps.half + 1 < len(time_ns))
        steps = np.diff(time_ns) / (self.branches.step_s * NANOSECONDS)
        gaps = np.concatenate(([0], np.cumsum((steps <= MIN_STEP) | (steps >= MAX_STEP))))
        first = index[inside]
        even = gaps[first + taps.half + 1] == gaps[first - taps.half]
        inside[inside], first = even, first[even]
        fraction = (knots_ns[inside] - time_ns[first]) / (time_ns[first + 1] - time_ns[first])
        result[inside] = filtered_at(acceleration, first, fraction, (taps.wanted, taps.bend))
        return result

    def _forget(self, time_ns: int) -> None:
        """Drop what no later row needs."""
        branches, samples = self.branches, self._samples
        samples.drop_first(int(np.searchsorted(samples.time_ns, time_ns)) - branches.before_samples)
        oldest_ns = time_ns - round((branches.margin * branches.step_s + 2.0 * branches.around_s) * NANOSECONDS)
        self._knots.drop_first(int(np.searchsorted(self._knots.time_ns, oldest_ns)))


def through(series: Floats, taps: Floats, half: int) -> Floats:
    """A series (n,) through symmetric taps, (n - 2 half,): at all but `half` samples on each side."""
    spare = half - len(taps) // 2
    found: Floats = np.convolve(series, taps, mode="valid")
    return found[spare : len(found) - spare]


def velocity(displacement: Floats, acceleration: Floats, step_s: float) -> Floats:
    """Velocity (n,) in m/s of a displacement (n + 2,) with its acceleration (n + 2,), of fourth order.

    The central difference is too large by dt²/6 · the second derivative of the velocity; a constant bias drops out.
    """
    difference = (displacement[2:] - displacement[:-2]) / (2.0 * step_s)
    result: Floats = difference - step_s / 12.0 * (acceleration[2:] - acceleration[:-2])
    return result


def _full(sound: Mask, margin: int) -> Mask:
    """Whether samples (n,) have nothing but sound ones within this many on each side."""
    count = np.concatenate(([0], np.cumsum(sound)))
    full = np.zeros(len(sound), dtype=bool)
    full[margin : len(sound) - margin] = count[2 * margin + 1 :] - count[: -2 * margin - 1] == 2 * margin + 1
    return full
