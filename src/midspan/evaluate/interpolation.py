"""A reference evaluated at other instants, only where it is dense enough to say something there."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from midspan.errors import DataError
from midspan.records import NANOSECONDS, Floats, Nanoseconds, TimeSeries, seconds

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
