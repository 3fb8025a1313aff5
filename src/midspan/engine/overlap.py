"""How far one camera's zero lies beside another's, as both wander: known where both see, bridged where one does not.

Light moves over bumps, surfaces warm and cool, reference frames change: each camera's zero wanders a little. The
difference of two displacements is noise about a level that walks at random (a local level model); how much it walks is
taken from the differences themselves by maximum likelihood. The level is smoothed both ways, so that neither end of a
night shows a step.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from midspan.checks import same_length
from midspan.records import NANOSECONDS, Floats, Nanoseconds

# Differences are gathered into means of this many seconds, and into so many at most.
PIECE_S, MOST_PIECES = 1.0, 4000
AGREE_STD = 4.0
# Walks that are tried, as variances in a second over that of a piece's mean.
WALKS = (0.0, *(float(w) for w in np.logspace(-6, 0.5, 27)))


@dataclass(frozen=True, slots=True, eq=False)
class ZeroCourse:
    """The level at instants: time_ns, level_m, variance_m2 (n,); walk_m2_s: what its variance grows by in a second."""

    time_ns: Nanoseconds
    level_m: Floats
    variance_m2: Floats
    walk_m2_s: float

    def at(self, time_ns: Nanoseconds) -> tuple[Floats, Floats]:
        """Level (m) and its variance (m²) at stamps (n,): straight lines between the instants, a walk about them."""
        origin = int(self.time_ns[0])
        known = (self.time_ns - origin) / NANOSECONDS
        t = (np.asarray(time_ns, dtype=np.int64) - np.int64(origin)) / NANOSECONDS
        level, variance = np.interp(t, known, self.level_m), np.interp(t, known, self.variance_m2)
        right = np.clip(np.searchsorted(known, t), 0, len(known) - 1)
        left = np.clip(right - 1, 0, len(known) - 1)
        before, after = np.maximum(t - known[left], 0.0), np.maximum(known[right] - t, 0.0)
        gap = np.maximum(known[right] - known[left], 1e-9)
        inside = (t > known[0]) & (t < known[-1])
        outside = np.maximum(np.maximum(known[0] - t, t - known[-1]), 0.0)
        return level, variance + self.walk_m2_s * np.where(inside, before * after / gap, outside)


def zero_course(time_ns: Nanoseconds, difference_m: Floats, variance_m2: Floats) -> ZeroCourse | None:
    """The level that differences (n,) of two displacements walk about; None where there is none.

    time_ns (n,) increasing; difference_m: NaN where one of both does not see; variance_m2: of each, without the walk.
    """
    same_length(time_ns=time_ns, difference_m=difference_m, variance_m2=variance_m2)
    usable = np.isfinite(difference_m) & np.isfinite(variance_m2) & (variance_m2 > 0.0)
    if not usable.any():
        return None
    time_ns, difference_m, variance_m2 = time_ns[usable], difference_m[usable], variance_m2[usable]
    pieces = _pieces((time_ns - time_ns[0]) / NANOSECONDS, difference_m, variance_m2)
    scale = float(np.median(pieces[:, 2]))
    walks = np.array(WALKS) * scale
    chances = np.array([_forward(pieces, walk)[1] for walk in walks])
    walk = float(walks[int(np.argmax(chances))])
    level, variance = _smoothed(_forward(pieces, walk)[0], walk)
    stamps = time_ns[0] + np.rint(pieces[:, 0] * NANOSECONDS).astype(np.int64)
    return ZeroCourse(stamps, level, variance, walk)


def _pieces(time_s: Floats, value: Floats, variance: Floats) -> Floats:
    """Rows (k, 3) of time (s), mean and its variance of pieces, outliers of each left out."""
    length = max(PIECE_S, float(time_s[-1]) / MOST_PIECES)
    which = (time_s // length).astype(np.int64)
    starts = np.flatnonzero(np.diff(which, prepend=-1))
    rows = []
    for start, end in zip(starts, (*starts[1:], len(which)), strict=True):
        own, known = value[start:end], variance[start:end]
        middle = float(np.median(own))
        scatter = 1.4826 * float(np.median(np.abs(own - middle)))
        near = np.abs(own - middle) <= AGREE_STD * np.maximum(np.sqrt(known), scatter)
        weight = np.where(near, 1.0 / known, 0.0)
        total = float(weight.sum())
        mean = float(weight @ own) / total
        # Means of few values scatter by chance: what is stated counts for as much.
        rows.append((float(weight @ time_s[start:end]) / total, mean, max(1.0 / total, scatter**2 / near.sum())))
    return np.array(rows)


@njit(cache=True)
def _forward(pieces: Floats, walk: float) -> tuple[Floats, float]:
    """Level, variance, predicted variance and time of each piece (k, 4), and the logarithm of the likelihood."""
    found = np.empty((len(pieces), 4))
    chance = 0.0
    level, variance = pieces[0, 1], pieces[0, 2]
    found[0] = np.array((level, variance, variance, pieces[0, 0]))
    for k in range(1, len(pieces)):
        predicted = variance + walk * (pieces[k, 0] - pieces[k - 1, 0])
        total = predicted + pieces[k, 2]
        innovation = pieces[k, 1] - level
        chance -= 0.5 * (np.log(total) + innovation**2 / total)
        gain = predicted / total
        level += gain * innovation
        variance = (1.0 - gain) * predicted
        found[k] = np.array((level, variance, predicted, pieces[k, 0]))
    return found, chance


@njit(cache=True)
def _smoothed(found: Floats, walk: float) -> tuple[Floats, Floats]:
    """Level and variance (k,) of each piece with those after it."""
    level, variance = found[:, 0].copy(), found[:, 1].copy()
    for k in range(len(found) - 2, -1, -1):
        gain = found[k, 1] / found[k + 1, 2]
        level[k] += gain * (level[k + 1] - found[k, 0])
        variance[k] += gain * gain * (variance[k + 1] - found[k + 1, 2])
    return level, variance
