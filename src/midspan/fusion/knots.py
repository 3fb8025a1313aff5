"""Displacement measurements as knots of a spline: merged where too close, with what is taken off them beforehand."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.branches import MERGED_SHARE, AtFrames, Branches, Rates, Window
from midspan.records import Displacement, Floats, seconds
from midspan.signals.resample import REACH_STEPS, filtered_at, spline_rows

# Columns of a knot; ABSENT: 1 where it stands for a missing measurement, else 0.
TIME, VALUE, VARIANCE, SOURCE, ABSENT, ANTI_ALIASED, FOLDED = range(7)
COLUMNS = 7


@dataclass(frozen=True, slots=True)
class Grid:
    """Samples of a stretch from index `first` on: time_s, acceleration, its noise density: (n,)."""

    first: int
    time_s: Floats
    acceleration: Floats
    density: Floats


def usable_rows(displacement: Displacement, origin_ns: int) -> Floats:
    """Rows (m, 4) of time in s, value, variance and source of the measurements of finite variance, and of holes."""
    usable = np.isfinite(displacement.variance_m2)
    return np.column_stack(
        (
            seconds(displacement.time_ns[usable], origin_ns),
            displacement.value_m[usable],
            displacement.variance_m2[usable],
            displacement.source[usable].astype(np.float64),
        )
    )


def merged(rows: Floats, apart_s: float, closed_s: float) -> tuple[Floats, Floats]:
    """Rows (m, 4) with those within `apart_s` of the first of a group made one by inverse variance; and what is left.

    Groups that begin after `closed_s` may still grow: they stay as they are, in the second array.
    """
    time = rows[:, TIME]
    done = int(np.searchsorted(time, closed_s, side="right"))
    if not len(rows) or np.min(np.diff(time), initial=np.inf) > apart_s:
        return rows[:done], rows[done:]
    groups, start = [], 0
    while start < len(rows) and time[start] <= closed_s:
        stop = int(np.searchsorted(time, time[start] + apart_s, side="right"))
        group = rows[start:stop]
        # A hole of one sensor is none where another has a value.
        sound = np.isfinite(group[:, VALUE])
        group = group[sound] if sound.any() else group
        weight = 1.0 / group[:, VARIANCE]
        groups.append(
            [
                float(np.average(group[:, TIME], weights=weight)),
                float(np.average(group[:, VALUE], weights=weight)),
                1.0 / float(np.sum(weight)),
                group[int(np.argmax(weight)), SOURCE],
            ]
        )
        start = stop
    return np.array(groups).reshape(-1, 4), rows[start:]


class Knots:
    """The knots of one gap-free stretch of acceleration."""

    def __init__(self, branches: Branches, rates: Rates, window: Window) -> None:
        self._branches, self._rates, self._window = branches, rates, window
        self._rows = np.empty((0, COLUMNS))
        self._waiting = np.empty((0, 4))
        self._absent = np.empty((0, 4))
        # Times of the last measurement that was made a knot, and of the last missing one.
        self._met_s = self._missed_s = -np.inf
        # Times of the last knot that is no hole, and of the last measured one.
        self._sound_s = self._measured_s = np.nan

    def add(self, rows: Floats, absent: Floats) -> None:
        """Take measurements (m, 4), and what stands for missing ones (q, 4), in time order."""
        self._waiting = np.concatenate((self._waiting, rows))
        self._absent = np.concatenate((self._absent, absent))

    def prepare(self, grid: Grid, known_s: float) -> list[tuple[float, float]]:
        """Make knots of the measurements known for good, up to `known_s`; returns the gaps met: start and end in s."""
        apart_s = MERGED_SHARE * self._rates.frame_s
        absent = self._lonely(apart_s, known_s - apart_s)
        met = self._waiting[:, TIME]
        rows, self._waiting = merged(self._waiting, apart_s, known_s - apart_s)
        used = len(met) - len(self._waiting)
        self._met_s = float(met[used - 1]) if used else self._met_s
        rows = np.column_stack((rows, np.zeros(len(rows))))
        if len(absent):
            rows = np.concatenate((rows, np.column_stack((absent, np.ones(len(absent))))))
            rows = rows[np.argsort(rows[:, TIME], kind="stable")]
        if not len(rows):
            return []
        self._rows = np.concatenate((self._rows, self._prepared(grid, rows)))
        return self._gaps(rows)

    def _lonely(self, apart_s: float, closed_s: float) -> Floats:
        """The missing ones (q, 4) up to `closed_s` that have no measurement beside them, nor another missing one."""
        count = int(np.searchsorted(self._absent[:, TIME], closed_s, side="right"))
        if not count:
            return self._absent[:0]
        due, self._absent = self._absent[:count], self._absent[count:]
        met = np.concatenate(([self._met_s], self._waiting[:, TIME], [np.inf]))
        place = np.searchsorted(met, due[:, TIME])
        lonely = (due[:, TIME] - met[np.maximum(place - 1, 0)] > apart_s) & (met[place] - due[:, TIME] > apart_s)
        kept = []
        for i in np.flatnonzero(lonely):
            if due[i, TIME] - self._missed_s > apart_s:
                self._missed_s = float(due[i, TIME])
                kept.append(i)
        return due[kept]

    def _gaps(self, rows: Floats) -> list[tuple[float, float]]:
        """Where new knots (m, 5) leave too long an interval: from the last measured one to the next, in s."""
        sound = rows[(rows[:, ABSENT] == 0.0) | np.isfinite(rows[:, VALUE])]
        if not len(sound):
            return []
        times = np.concatenate(([self._sound_s], sound[:, TIME]))
        measured = np.where(sound[:, ABSENT] == 0.0, sound[:, TIME], -np.inf)
        measured = np.fmax.accumulate(np.concatenate(([self._measured_s], measured)))
        self._sound_s, self._measured_s = float(times[-1]), float(measured[-1])
        return [
            (float(measured[i]), float(times[i + 1])) for i in np.flatnonzero(np.diff(times) > self._window.longest_s)
        ]

    def forget(self, before_s: float) -> None:
        """Drop the knots that no later row can need."""
        keep_s = before_s - (REACH_STEPS + 1.0) * self._window.longest_s
        self._rows = self._rows[np.searchsorted(self._rows[:, TIME], keep_s) :]

    def rows(self, time_s: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Anti-aliased displacement and folded probe (2, n) at instants (n,), and whether they are sound (n,)."""
        rows, sound = np.empty((2, len(time_s))), np.empty(len(time_s), dtype=np.bool_)
        limits = (self._window.longest_s, REACH_STEPS * self._rates.frame_s)
        columns = np.ascontiguousarray(self._rows[:, [ANTI_ALIASED, FOLDED]])
        spline_rows(time_s, np.ascontiguousarray(self._rows[:, TIME]), columns, limits, rows, sound)
        return rows, sound

    def variance(self, time_s: Floats) -> Floats:
        """Variance (n,) in m² of the knots around instants (n,)."""
        found = self._rows[:, VARIANCE]
        if not len(found) or np.ptp(found) == 0.0:
            return np.full(len(time_s), found[0] if len(found) else self._rates.variance_m2)
        return np.interp(time_s, self._rows[:, TIME], found)

    def sources(self, time_s: Floats) -> NDArray[np.uint8]:
        """Source (n,) of the last knot before each instant (n,)."""
        found = self._rows[:, SOURCE]
        if np.ptp(found) == 0.0:
            return np.full(len(time_s), found[0], dtype=np.uint8)
        place = np.searchsorted(self._rows[:, TIME], time_s, side="right") - 1
        result: NDArray[np.uint8] = found[np.maximum(place, 0)].astype(np.uint8)
        return result

    def coasting(self, time_s: Floats, longest_s: float) -> NDArray[np.bool_]:
        """Whether instants (n,) lie behind a missing measurement and longer than `longest_s` behind a real one."""
        absent = self._rows[:, ABSENT] > 0.0
        if not absent.any():
            return np.zeros(len(time_s), dtype=np.bool_)
        place = np.searchsorted(self._rows[:, TIME], time_s, side="right")
        measured = np.concatenate(([-np.inf], np.maximum.accumulate(np.where(absent, -np.inf, self._rows[:, TIME]))))
        result: NDArray[np.bool_] = (
            (place > 0) & absent[np.maximum(place - 1, 0)] & (time_s - measured[place] > longest_s)
        )
        return result

    def _prepared(self, grid: Grid, rows: Floats) -> Floats:
        """Knots (m, 7): the anti-aliasing stage's part taken off; not finite where acceleration is missing beside."""
        index = np.searchsorted(grid.time_s, rows[:, TIME], side="right") - 1
        reach = self._branches.reach
        inside = (index >= reach) & (index + reach + 1 < len(grid.time_s))
        removed = self._filtered(self._branches.removed, grid, index, rows, inside)
        probe = self._filtered(self._branches.probe, grid, index, rows, inside)
        variance = rows[:, VARIANCE].copy()
        if self._branches.removed is not None:
            # The stage's own noise: that of the acceleration through its filter.
            gain = float(np.sum(self._branches.removed.wanted**2)) / self._rates.step_s
            variance += gain * grid.density[np.clip(index, 0, len(grid.density) - 1)]
        time, value, source, absent = rows[:, TIME], rows[:, VALUE], rows[:, SOURCE], rows[:, ABSENT]
        return np.column_stack((time, value, variance, source, absent, value - removed, probe - removed))

    def _filtered(
        self, taps: AtFrames | None, grid: Grid, index: NDArray[np.int64], rows: Floats, inside: NDArray[np.bool_]
    ) -> Floats:
        """What a filter makes of the acceleration at the knots (m,); 0 without a filter."""
        if taps is None:
            return np.where(inside | (self._branches.reach == 0), 0.0, np.nan)
        result = np.full(len(rows), np.nan)
        at = index[inside]
        fraction = (rows[inside, TIME] - grid.time_s[at]) / (grid.time_s[at + 1] - grid.time_s[at])
        result[inside] = filtered_at(grid.acceleration, at, fraction, (taps.wanted, taps.bend))
        return result
