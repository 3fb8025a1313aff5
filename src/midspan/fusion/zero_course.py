"""How far one camera's zero lies beside another's, as both wander: known where both see, bridged where one does not.

Light moves over bumps, surfaces warm and cool, reference frames change: each camera's zero wanders a little. The
difference of two displacements is noise about a level that walks at random (a local level model); how much it walks is
taken from the differences themselves by maximum likelihood. The level is smoothed both ways, so that neither end of a
night shows a step. Differences that no walk explains are left out of it and told; when they stay, they are its new
level: a jump.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from midspan.checks import same_length
from midspan.records import NANOSECONDS, Floats, Nanoseconds

# Differences are gathered into means of this many seconds, and into so many at most.
PIECE_S, MOST_PIECES = 1.0, 4000
# Differences that leave the level are its new level once they have lasted for so many pieces.
NEW_LEVEL_PIECES = 20
# Where nothing was seen for more than so many pieces' length the level may have gone as far as a drift goes.
GAP_PIECES = 3.0
# How far a level goes is looked at over so many pieces; each needs so many pairs.
LAGS, LEAST_PAIRS = (2, 5, 10, 20, 40, 80), 4
AGREE_STD = 4.0
# Walks that are tried, as variances in a second over that of a piece's mean.
WALKS = (0.0, *(float(w) for w in np.logspace(-6, 0.5, 27)))


@dataclass(frozen=True, slots=True, eq=False)
class ZeroCourse:
    """The level at instants: time_ns, level_m, variance_m2 (n,); walk_m2_s: what its variance grows by in a second.

    apart_m (n,): how far the differences lie from the level where no walk explains it, else 0; jump_m (n,): what the
    level jumped by there, else 0.
    """

    time_ns: Nanoseconds
    level_m: Floats
    variance_m2: Floats
    walk_m2_s: float
    apart_m: Floats
    jump_m: Floats

    @property
    def wander_m(self) -> float:
        """Root mean square (m) of how far the level is from where it began; jumps do not count."""
        steady, _ = self._steady()
        return float(np.sqrt(np.mean((steady - steady[0]) ** 2))) if len(steady) else 0.0

    @property
    def growth_m2_s(self) -> float:
        """What its variance grows by in a second, m²/s: a drift goes further in a minute than its steps tell."""
        steady, kept = self._steady()
        drifts = (float(np.mean(step**2) / np.mean(length)) for step, length in _steps(steady, kept))
        return max((self.walk_m2_s, *drifts))

    def _steady(self) -> tuple[Floats, Floats]:
        """Level (k,) without jumps, and its times (s), where differences are explained."""
        kept = self.apart_m == 0.0
        return (self.level_m - np.cumsum(self.jump_m))[kept], (self.time_ns[kept] - self.time_ns[0]) / NANOSECONDS

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
        return level, variance + self.growth_m2_s * np.where(inside, before * after / gap, outside)


def zero_course(
    time_ns: Nanoseconds, difference_m: Floats, variance_m2: Floats, wandering_m2: Floats | None = None
) -> ZeroCourse | None:
    """The level that differences (n,) of two displacements walk about; None where there is none.

    time_ns (n,) increasing; difference_m: NaN where one of both does not see; variance_m2: of each, without the walk;
    wandering_m2 (n,): variance by which both zeros are said to be off, which counts where there was a gap before.
    """
    same_length(time_ns=time_ns, difference_m=difference_m, variance_m2=variance_m2)
    usable = np.isfinite(difference_m) & np.isfinite(variance_m2) & (variance_m2 > 0.0)
    if not usable.any():
        return None
    time_ns, difference_m, variance_m2 = time_ns[usable], difference_m[usable], variance_m2[usable]
    time_s = (time_ns - time_ns[0]) / NANOSECONDS
    pieces = _pieces(time_s, difference_m, variance_m2)
    stamps = time_ns[0] + np.rint(pieces[:, 0] * NANOSECONDS).astype(np.int64)
    scale = float(np.median(pieces[:, 2]))
    walks = np.array(WALKS) * scale
    lengths = np.diff(pieces[:, 0], prepend=pieces[0, 0])
    chances = np.array([_forward(pieces, walk * lengths)[1] for walk in walks])
    walk = float(walks[int(np.argmax(chances))])
    added = walk * lengths
    course = _course(pieces, stamps, walk, added)
    gaps = lengths > GAP_PIECES * _length(time_s)
    if not gaps.any():
        return course
    said = np.zeros(len(pieces)) if wandering_m2 is None else np.interp(pieces[:, 0], time_s, wandering_m2[usable])
    return _course(pieces, stamps, walk, np.where(gaps, course.growth_m2_s * lengths + said, added))


def _course(pieces: Floats, stamps: Nanoseconds, walk: float, added: Floats) -> ZeroCourse:
    """The course of pieces (k, 3) at stamps (k,); added (k,): by what the variance grows up to each of them."""
    found = _forward(pieces, added)[0]
    level, variance = _smoothed(found)
    apart = np.where(found[:, 4] > 0.0, pieces[:, 1] - level, 0.0)
    return ZeroCourse(stamps, level, variance, walk, apart, found[:, 3])


def _steps(level: Floats, time_s: Floats) -> list[tuple[Floats, Floats]]:
    """Changes of a level and how long they took (s), over each lag."""
    lags = [lag for lag in LAGS if len(level) - lag >= LEAST_PAIRS]
    return [(level[lag:] - level[:-lag], time_s[lag:] - time_s[:-lag]) for lag in lags]


def _length(time_s: Floats) -> float:
    """The length of a piece, s."""
    return max(PIECE_S, float(time_s[-1]) / MOST_PIECES)


def _pieces(time_s: Floats, value: Floats, variance: Floats) -> Floats:
    """Rows (k, 3) of time (s), mean and its variance of pieces, outliers of each left out."""
    which = (time_s // _length(time_s)).astype(np.int64)
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
def _forward(pieces: Floats, added: Floats) -> tuple[Floats, float]:
    """Level, variance, predicted variance, jump and whether left out (k, 5), and the logarithm of the likelihood."""
    found = np.zeros((len(pieces), 5))
    chance, out = 0.0, 0
    level, variance = pieces[0, 1], pieces[0, 2]
    found[0, :3] = level, variance, variance
    for k in range(1, len(pieces)):
        predicted = variance + added[k]
        total = predicted + pieces[k, 2]
        innovation = pieces[k, 1] - level
        far = innovation**2 > AGREE_STD**2 * total
        out = out + 1 if far else 0
        # One that is left out costs as much as one at the limit.
        chance -= 0.5 * (np.log(total) + min(innovation**2 / total, AGREE_STD**2))
        if out >= NEW_LEVEL_PIECES:
            level = np.median(pieces[k + 1 - out : k + 1, 1])
            found[k, 3] = level - found[k - 1, 0]
            variance, predicted, out = pieces[k, 2], predicted + found[k, 3] ** 2, 0
        elif far:
            variance, found[k, 4] = predicted, 1.0
        else:
            gain = predicted / total
            level += gain * innovation
            variance = (1.0 - gain) * predicted
        found[k, :3] = level, variance, predicted
    return found, chance


@njit(cache=True)
def _smoothed(found: Floats) -> tuple[Floats, Floats]:
    """Level and variance (k,) of each piece with those after it; a jump tells nothing of what was before it."""
    level, variance = found[:, 0].copy(), found[:, 1].copy()
    for k in range(len(found) - 2, -1, -1):
        if found[k + 1, 3] != 0.0:
            continue
        gain = found[k, 1] / found[k + 1, 2]
        level[k] += gain * (level[k + 1] - found[k, 0])
        variance[k] += gain * gain * (variance[k + 1] - found[k + 1, 2])
    return level, variance
