"""Noise of the measurements that is not alike all along the record: the instants at which its level changes.

Innovations of a segment with its own variance s against one variance of the whole (m of n innovations): the logarithm
of the likelihood gains n/2 ln s − Σ m/2 ln sᵢ. The likeliest instant splits the record, and each part again, as long as
that gains more than a change of unknown place and size would by chance (half the logarithm of n for each and for the
segment: N. R. Zhang, D. O. Siegmund, A modified Bayes information criterion, Biometrics 63 (2007) 22-32, doi
10.1111/j.1541-0420.2006.00662.x). Taken for one level, a change looks like an error that is correlated over seconds.

The noise whose level changes is the sensor's, or the accelerometer's where that is likelier: an accelerometer that errs
with a cross motion or its attitude leaves innovations that are correlated, which a noisier sensor does not.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.fit import Fit, Pair, best_corner
from midspan.calibration.outliers import cleaned
from midspan.records import Floats

# A level is told by this many innovations at least: its variance is then known to a quarter. And it holds for this
# share of them: what is briefer, as a sensor that is stuck for some seconds, is no level of the noise.
MIN_SEGMENT, MIN_SHARE = 30, 0.1
# Unknowns of a change, half a ln n each: its instant, and the variance on both sides for one.
UNKNOWNS = 3.0
# An innovation's variance is more than the noise's alone: a level is found in rounds. Of one that is 25 times another
# the first round leaves a factor of 2.5, the fourth less than 1.1.
ROUNDS = 4


def with_noise_levels(pair: Pair, fit: Fit, whole: Floats | None = None) -> tuple[Pair, Fit]:
    """The pair with the levels of its noise in the relative variances of its rows, of mean 1, and its fit; both as they
    are where one level explains the innovations.

    Where levels of the accelerometer's noise explain them better, the pair has those instead. whole (m, 3): the rows
    with those that were left out as outliers, which are judged again by the levels.
    """
    inner = fit.whitened.index[_edges(fit.residual**2)[1:-1]]
    if not len(inner):
        return pair, fit
    edges = np.r_[0, inner, len(pair.rows)]
    felt = _levelled_acceleration(pair, fit, edges)
    pair, fit = _levelled(pair, fit, edges)
    if felt[1].likelihood > fit.likelihood:
        return felt
    if whole is not None:
        pair = with_outliers(pair, whole)
        pair = cleaned(pair, best_corner(pair, fit.offset_s, fit.corner))
        pair, fit = _levelled(pair, best_corner(pair, fit.offset_s, fit.corner), edges)
    return pair, fit


def _levelled(pair: Pair, fit: Fit, edges: NDArray[np.int64]) -> tuple[Pair, Fit]:
    """The pair and its fit with the level of each segment of rows, the numbers of whose first ones are `edges`."""
    for _ in range(ROUNDS):
        level = _level(fit, edges)
        rows = pair.rows.copy()
        rows[:, 2] *= np.repeat(level, np.diff(edges))
        rows[:, 2] /= np.mean(rows[fit.whitened.index, 2])
        pair = replace(pair, rows=rows)
        fit = best_corner(pair, fit.offset_s, fit.corner)
    return pair, fit


def _levelled_acceleration(pair: Pair, fit: Fit, edges: NDArray[np.int64]) -> tuple[Pair, Fit]:
    """The pair and its fit with a level of the accelerometer's noise during each segment of rows."""
    begins_s = pair.rows[edges[1:-1], 0] + fit.offset_s
    segment = np.searchsorted(begins_s, pair.samples[:, 0], side="right")
    for _ in range(ROUNDS):
        level = _level(fit, edges)[segment] * (1.0 if pair.level is None else pair.level)
        pair = replace(pair, level=level / np.mean(level))
        fit = best_corner(pair, fit.offset_s, fit.corner)
    return pair, fit


def _level(fit: Fit, edges: NDArray[np.int64]) -> Floats:
    """Mean square (k,) of the innovations of each segment of rows, the numbers of whose first ones are `edges`."""
    segment = np.searchsorted(edges, fit.whitened.index, side="right") - 1
    count = np.bincount(segment, minlength=len(edges) - 1)
    level = np.bincount(segment, fit.residual**2, minlength=len(edges) - 1) / np.maximum(count, 1)
    # Of a segment of which nothing is left no level shows.
    return np.where(level > 0.0, level, 1.0)


def with_outliers(pair: Pair, whole: Floats) -> Pair:
    """The pair with the rows of `whole` (m, 3) that were left out, each at the relative variance of the one before."""
    rows, used = pair.rows.copy(), np.flatnonzero(np.isfinite(pair.rows[:, 2]))
    before = used[np.maximum(np.searchsorted(used, np.arange(len(rows)), side="right") - 1, 0)]
    left = np.isinf(rows[:, 2]) & np.isfinite(whole[:, 2])
    rows[left, 2] = rows[before[left], 2]
    return replace(pair, rows=rows)


def _edges(square: Floats) -> list[int]:
    """Edges of the segments of one level, by the squares of innovations (k,) of relative variance 1."""
    edges, open_ones = [0, len(square)], [(0, len(square))]
    least = 0.5 * UNKNOWNS * float(np.log(max(len(square), 1)))
    brief = max(MIN_SEGMENT, round(MIN_SHARE * len(square)))
    while open_ones:
        first, last = open_ones.pop()
        cut = _cut(square[first:last], brief, least)
        if cut:
            edges.append(first + cut)
            open_ones += [(first, first + cut), (first + cut, last)]
    return sorted(edges)


def _cut(square: Floats, brief: int, least: float) -> int:
    """Where squares (k,) split into two levels of at least `brief` that gain more than `least`; 0: nowhere."""
    count = len(square)
    if count < 2 * brief:
        return 0
    first = np.arange(brief, count - brief + 1)
    total = np.cumsum(square)
    before, after = total[first - 1] / first, (total[-1] - total[first - 1]) / (count - first)
    if not (np.all(before > 0.0) and np.all(after > 0.0)):
        # Without any noise there are no levels.
        return 0
    gains = 0.5 * (count * np.log(total[-1] / count) - first * np.log(before) - (count - first) * np.log(after))
    best = int(np.argmax(gains))
    return int(first[best]) if gains[best] > least else 0
