"""Long series drawn with few points: the extremes of each segment, so that no peak is lost."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats

# A pause this many times the usual step of the drawn points interrupts the line.
PAUSE_STEPS = 6.0


@dataclass(frozen=True, slots=True)
class Envelope:
    """Segments (k,) of a series: their middle times `t` and the lowest and highest value in each; NaN between pauses.

    whole: each segment is a single value, nothing was thinned.
    """

    t: Floats
    low: Floats
    high: Floats
    whole: bool

    def line(self) -> tuple[Floats, Floats]:
        """Times and values of the polyline through both extremes."""
        if self.whole:
            return self.t, self.low
        return np.repeat(self.t, 2), np.column_stack((self.low, self.high)).ravel()


def starts(count: int, segments: int) -> NDArray[np.int64]:
    """First index of each of at most `segments` nearly equal segments of `count` rows; every row where few."""
    if count <= 2 * segments:
        return np.arange(count)
    return np.unique(np.linspace(0, count, segments, endpoint=False).astype(np.int64))


def envelope(t: Floats, low: Floats, high: Floats, segments: int = 1200) -> Envelope:
    """The envelope of series (n,) at times `t` (n,); `low` and `high` may be the same array. NaN is left out."""
    at = starts(len(t), segments)
    whole = len(at) == len(t)
    if not whole:
        ends = np.append(at[1:], len(t)) - 1
        t, low, high = 0.5 * (t[at] + t[ends]), np.fmin.reduceat(low, at), np.fmax.reduceat(high, at)
    if len(t) > 2:
        steps = np.diff(t)
        pause = np.flatnonzero(steps > PAUSE_STEPS * np.median(steps)) + 1
        t = np.insert(t, pause, t[pause])
        low, high = np.insert(low, pause, np.nan), np.insert(high, pause, np.nan)
    return Envelope(t, low, high, whole)


def spans(t: Floats, mask: NDArray[np.bool_], segments: int = 2000) -> list[tuple[float, float]]:
    """Start and length in time of the runs where `mask` (n,) holds, thinned so that they stay few and visible."""
    if not mask.any():
        return []
    at = starts(len(t), segments)
    held = np.logical_or.reduceat(mask, at)
    edges = np.append(t[at], t[-1])
    change = np.diff(np.concatenate(([0], held.astype(np.int8), [0])))
    first, last = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    return [(float(edges[a]), float(edges[b] - edges[a])) for a, b in zip(first, last, strict=True)]


def logarithmic_means(frequency: Floats, power: Floats, bins: int = 900) -> tuple[Floats, Floats]:
    """A spectrum averaged in logarithmically even bins where these hold several lines; the rest as it is."""
    if len(frequency) <= bins:
        return frequency, power
    edges = np.geomspace(frequency[0], frequency[-1], bins)
    at = np.unique(np.searchsorted(frequency, edges))
    at = at[at < len(frequency)]
    count = np.diff(np.append(at, len(frequency)))
    return np.add.reduceat(frequency, at) / count, np.add.reduceat(power, at) / count
