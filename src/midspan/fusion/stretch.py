"""One gap-free stretch of acceleration through the two branches, and least squares where a window is not full."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.branches import EXACT_RULE, Branches, NoiseGain, Rates, integration_error, velocity, window_of
from midspan.fusion.even import EvenClock
from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.knots import Grid, Knots, usable_rows
from midspan.fusion.screen import Screened
from midspan.fusion.smoother import smooth
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    Estimate,
    Event,
    Floats,
    Nanoseconds,
    Source,
    Status,
    joined,
    part,
    seconds,
)
from midspan.signals.fir import FilterBank

# Rows without a full window are solved in pieces of at least so many.
SHORTEST_PIECE = 256
# Gaps that follow each other at once are told as one, each of them up to so many of the filters' intervals long.
MOST_IN_A_ROW_STEPS = 20.0


@dataclass(frozen=True, slots=True)
class Method:
    """A method made for its rates, with the filters' prepared transforms; shared by all stretches of a stream."""

    branches: Branches
    rates: Rates
    edges: KalmanSettings
    bank: FilterBank
    noise: NoiseGain

    @classmethod
    def make(cls, branches: Branches, rates: Rates, edges: KalmanSettings) -> "Method":
        """Prepare the transforms: of displacement and acceleration the row, of probe and acceleration the folding."""
        bank = FilterBank((branches.low, branches.high))
        if branches.probe is not None:
            unfolded = -np.convolve(branches.low, branches.probe.wanted)
            bank = FilterBank((branches.low, branches.high, None), (None, unfolded, branches.low))
        return cls(branches, rates, edges, bank, NoiseGain(branches, rates))


class Stretch:
    """Takes acceleration without gaps and displacement in time order, gives each sample's row once it is due.

    Samples are counted from the stretch's start; the arrays hold those from `_base` on. A row is full when its filters,
    and those of both neighbours (its velocity needs them), reach sound samples only.
    """

    def __init__(self, method: Method, origin_ns: int) -> None:
        self._method, self._origin_ns = method, origin_ns
        self._window = window_of(method.branches, method.rates)
        self._knots = Knots(method.branches, method.rates, self._window)
        self._raw: list[Displacement] = []
        self._level = 0.0
        self._acceleration: list[Acceleration] = []
        self._clock = EvenClock(method.rates.step_s, jittered=method.rates.jittered)
        # On the even clock: instants and acceleration of the samples that have theirs.
        self._time_s, self._even = np.empty(0), np.empty(0)
        self._base = self._interpolated = self._given = 0
        # On the grid: anti-aliased displacement, what folding left of the probe, variance, whether sound.
        self._displacement, self._folded, self._variance = np.empty(0), np.empty(0), np.empty(0)
        self._sound = np.empty(0, dtype=np.bool_)
        self._piece: tuple[int, Estimate] | None = None
        # The gap met last, which the next one may go on: start and end in s, and how many intervals it is.
        self._gap: tuple[float, float, int] | None = None

    def push(self, acceleration: Acceleration, displacement: Screened) -> list[Estimate | Event]:
        """Take samples and all displacement up to the last of them; returns the rows that are due.

        The branches take what bridges rejected and missing measurements, least squares does without.
        """
        self._acceleration.append(acceleration)
        self._acceleration = [joined(self._acceleration)]
        if len(acceleration.time_ns):
            self._take(*self._clock.push(seconds(acceleration.time_ns, self._origin_ns), acceleration.value_m_s2))
        if len(displacement.believed.time_ns):
            self._raw.append(displacement.believed)
        self._knots.add(
            usable_rows(displacement.bridged, self._origin_ns), usable_rows(displacement.missing, self._origin_ns)
        )
        outputs = self._advance(final=False)
        self._forget()
        return outputs

    def finish(self) -> list[Estimate | Event]:
        """The rows still due; nothing may be pushed afterwards."""
        if not self._acceleration:
            return []
        if self._clock.behind:
            self._take(*self._clock.finish())
        outputs = self._advance(final=True)
        return [*outputs, *([] if self._gap is None else [self._told(*self._gap)])]

    def _take(self, time_s: Floats, value: Floats) -> None:
        self._time_s = np.concatenate((self._time_s, time_s))
        self._even = np.concatenate((self._even, value))

    @property
    def _end(self) -> int:
        return self._base + len(self._acceleration[0].time_ns)

    def _advance(self, *, final: bool) -> list[Estimate | Event]:
        block = self._acceleration[0]
        grid = Grid(self._base, self._time_s, self._even, block.noise_density)
        last = len(self._time_s) - 1 if final else len(self._time_s) - 2 - self._window.reach
        if last < 0:
            return []
        known_s = np.inf if final else float(self._time_s[last])
        outputs: list[Estimate | Event] = list(self._gaps(self._knots.prepare(grid, known_s), known_s))
        self._interpolate(known_s - self._window.ahead_s)
        return [*outputs, *self._rows(final=final)]

    def _gaps(self, found: list[tuple[float, float]], known_s: float) -> list[Event]:
        """The gaps that are over; those that follow each other at once are one: a sensor slower than the filters."""
        told, frame_s = [], self._method.rates.frame_s
        longest_s = MOST_IN_A_ROW_STEPS * frame_s
        for start_s, end_s in found:
            if self._gap is not None and start_s == self._gap[1] and end_s - start_s <= longest_s:
                self._gap = (self._gap[0], end_s, self._gap[2] + 1)
                continue
            told += [] if self._gap is None else [self._told(*self._gap)]
            self._gap = (start_s, end_s, 1)
            if end_s - start_s > longest_s:
                told.append(self._told(*self._gap))
                self._gap = None
        # What would go on with it is known by now, however the input was cut.
        if self._gap is not None and known_s > self._gap[1] + longest_s + frame_s:
            told.append(self._told(*self._gap))
            self._gap = None
        return told

    def _told(self, start_s: float, end_s: float, count: int) -> Event:
        length = f"No displacement for {end_s - start_s:.3g} s that may be used"
        if count > 1:
            length = (
                f"For {end_s - start_s:.3g} s displacement came every {(end_s - start_s) / count:.2g} s only, and not "
                f"every {self._method.rates.frame_s:.3g} s as the filters are made for"
            )
        text = (
            f"{length}: the filters' memory was reset; rows that "
            "would need it are solved by least squares from what there is, with the wider band that belongs to it."
        )
        return Event(self._origin_ns + round(start_s * NANOSECONDS), "gap", text)

    def _interpolate(self, until_s: float) -> None:
        """Bring the displacement to the grid up to `until_s`."""
        start = self._interpolated - self._base
        stop = max(int(np.searchsorted(self._time_s, until_s, side="right")), start)
        time_s = self._time_s[start:stop]
        rows, sound = self._knots.rows(time_s)
        self._displacement = np.concatenate((self._displacement, rows[0]))
        self._folded = np.concatenate((self._folded, rows[1]))
        self._variance = np.concatenate((self._variance, self._knots.variance(time_s)))
        self._sound = np.concatenate((self._sound, sound))
        self._interpolated = self._base + stop

    def _rows(self, *, final: bool) -> list[Estimate]:
        """Rows in order: full ones by the filters, the others in pieces by least squares."""
        end = self._base + len(self._even) - self._window.wide - 1
        stop = self._end if final else min(self._interpolated - self._window.half - 1, end)
        if stop <= self._given:
            return []
        first = self._given
        full = self._full(first, stop)
        edges = np.flatnonzero(np.diff(full)) + 1
        outputs: list[Estimate] = []
        for a, b in zip((0, *edges), (*edges, len(full)), strict=True):
            start, end = first + int(a), first + int(b)
            outputs.extend([self._filtered(start, end)] if full[a] else self._solved(start, end, final=final))
            if self._given < end:
                break
        return outputs

    def _full(self, start: int, stop: int) -> NDArray[np.bool_]:
        """Whether each row (n,) from `start` to `stop` has a full window of sound samples."""
        margin, wide = self._window.half + 1, self._window.wide + 1
        first, count = start - self._base, stop - start
        last = min(len(self._even) - wide, len(self._sound) - margin)
        full = np.zeros(count, dtype=np.bool_)
        full[max(wide - first, 0) : max(last - first, 0)] = True
        changes = np.flatnonzero(np.diff(self._sound, prepend=True, append=True))
        for begun, ended in zip(changes[::2], changes[1::2], strict=True):
            full[max(begun - margin - first, 0) : max(ended + margin - first, 0)] = False
        return full

    def _filtered(self, start: int, end: int) -> Estimate:
        """The rows from `start` to `end` by the two branches."""
        method, block, half = self._method, self._acceleration[0], self._window.half
        around = slice(start - half - self._base, end + half - self._base)
        wide = slice(start - self._window.wide - 1 - self._base, end + self._window.wide + 1 - self._base)
        beside = slice(start - 1 - self._base, end + 1 - self._base)
        series = [_cut(self._displacement, wide), self._even[wide]]
        if method.branches.probe is not None:
            series.append(_cut(self._folded, wide))
        found, *folding = method.bank(*series)
        variance = method.noise.rows(self._variance[around], block.noise_density[around])
        if method.branches.rule != EXACT_RULE:
            variance += integration_error(found, method.branches.rule) ** 2
        for error in folding:
            variance += error[1:-1] ** 2
        self._given = end
        speed = velocity(found, self._even[beside], method.rates.step_s)
        displacement, time_ns = found[1:-1], block.time_ns[beside][1:-1]
        if self._clock.behind:
            late_s = seconds(time_ns, self._origin_ns) - self._time_s[beside][1:-1]
            change = np.diff(found, 2) / method.rates.step_s**2
            displacement, speed = displacement + late_s * (speed + 0.5 * late_s * change), speed + late_s * change
        at_s = self._time_s[beside][1:-1]
        coasting = self._knots.coasting(at_s, method.edges.coasting_s)
        return Estimate(
            time_ns=time_ns,
            displacement_m=displacement,
            variance_m2=variance,
            velocity_m_s=speed,
            source=np.where(coasting, np.uint8(Source.PREDICTION), self._knots.sources(at_s)),
            status=np.where(coasting, np.uint8(Status.COASTING), np.uint8(Status.TRACKING)),
        )

    def _solved(self, start: int, end: int, *, final: bool) -> list[Estimate]:
        """The rows from `start` to `end` by least squares, as far as their pieces are complete.

        Pieces lie on a fixed raster and see a fixed number of samples on each side, so that the rows do not depend on
        how the input was cut.
        """
        length, outputs = max(self._window.delay, SHORTEST_PIECE), []
        while start < end:
            number = start // length
            if not final and self._end < (number + 1) * length + self._window.delay:
                break
            if self._piece is None or self._piece[0] != number:
                self._piece = (number, self._solve(number * length, (number + 1) * length))
            until = min(end, (number + 1) * length)
            outputs.append(part(self._piece[1], slice(start - number * length, until - number * length)))
            start = self._given = until
        return outputs

    def _solve(self, start: int, end: int) -> Estimate:
        """Least squares (the smoother) over a piece and what is beside it; gives the rows of the piece."""
        first, last = max(start - self._window.delay, 0), min(end + self._window.delay, self._end)
        block = part(self._acceleration[0], slice(first - self._base, last - self._base))
        near, level = self._near(block.time_ns)
        edges = replace(self._method.edges, bias=float(np.mean(block.value_m_s2)))
        found = smooth(block, replace(near, value_m=near.value_m - level), edges).estimate
        rows = part(found, slice(start - first, end - first))
        return replace(rows, displacement_m=rows.displacement_m + level)

    def _near(self, time_ns: Nanoseconds) -> tuple[Displacement, float]:
        """The measurements within the span of `time_ns`, and the level they start from."""
        if not self._raw:
            empty = np.empty(0)
            return Displacement(empty.astype(np.int64), empty, empty, empty.astype(np.uint8)), self._level
        self._raw = [joined(self._raw)]
        raw = self._raw[0]
        near = part(raw, (raw.time_ns >= time_ns[0]) & (raw.time_ns <= time_ns[-1]))
        values = near.value_m[np.isfinite(near.value_m) & np.isfinite(near.variance_m2)]
        if len(values):
            return near, float(values[0])
        before = raw.value_m[(raw.time_ns < time_ns[0]) & np.isfinite(raw.value_m)]
        return near, float(before[-1]) if len(before) else self._level

    def _forget(self) -> None:
        """Drop what no later row can need."""
        length = max(self._window.delay, SHORTEST_PIECE)
        keep = (self._given // length) * length - self._window.delay
        keep = min(keep, self._given - self._window.wide - 2, self._interpolated - 2 * self._window.reach - 2)
        cut = keep - self._base
        if cut <= 0:
            return
        self._acceleration = [part(self._acceleration[0], slice(cut, None))]
        self._time_s, self._even, self._base = self._time_s[cut:], self._even[cut:], keep
        self._displacement, self._folded = self._displacement[cut:], self._folded[cut:]
        self._variance, self._sound = self._variance[cut:], self._sound[cut:]
        self._knots.forget(float(self._time_s[0]))
        if self._raw:
            raw = joined(self._raw)
            old = raw.time_ns < self._acceleration[0].time_ns[0]
            values = raw.value_m[old & np.isfinite(raw.value_m)]
            self._level = float(values[-1]) if len(values) else self._level
            self._raw = [part(raw, ~old)]


def _cut(values: Floats, which: slice) -> Floats:
    """The rows `which` of values (n,), zeros beyond the end: where a filter that is padded to another's length ends."""
    found = values[which]
    missing = which.stop - which.start - len(found)
    return np.concatenate((found, np.zeros(missing))) if missing else found
