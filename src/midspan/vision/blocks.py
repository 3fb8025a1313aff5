"""Robust fusion of the translations of many blocks into one translation, roll and zoom."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats

Mask = NDArray[np.bool_]

CUT = 6.0  # Tukey's weight is 0 beyond this many standard deviations
# What Tukey's weights do to a mean square of two normal components (m exponential of mean 2, cut at 6), and to the
# variance of the weighted mean: E[m] E[w] / E[w m], and E[w² m/2] E[w] / E[w - m (1 - m/36) 2/36]².
SQUARE_FACTOR = 1.124
VARIANCE_FACTOR = 0.920
PLAIN_SQUARE = 20.0  # squared distance over its scale: two normal components reach it once in 20 000 blocks
AGREED = 0.9  # of the blocks about the medians: nothing covers the target, no vote is needed
MOST_SQUARE = 1.7  # of the noise over the usual one: more is not noise
_PASSES = 12


@njit(cache=True)
def _median(value: Floats, counted: Mask) -> float:
    """The median of the values that are counted, of two middle ones the lower; 0 where none is."""
    among = np.sort(value[counted])
    return float(among[(len(among) - 1) // 2]) if len(among) else 0.0


@njit(cache=True)
def _distances(found: Floats, information: Floats, levers: Floats, pose: Floats) -> Floats:
    """Squared Mahalanobis distance (blocks,) of every block's translation from the pose's."""
    out = np.empty(found.shape[0])
    for b in range(found.shape[0]):
        rx = found[b, 0] - (pose[0] + levers[b, 0, 0] * pose[2] + levers[b, 0, 1] * pose[3])
        ry = found[b, 1] - (pose[1] + levers[b, 1, 0] * pose[2] + levers[b, 1, 1] * pose[3])
        p = information[b]
        out[b] = p[0, 0] * rx * rx + 2.0 * p[0, 1] * rx * ry + p[1, 1] * ry * ry
    return out


@njit(cache=True)
def _normal(found: Floats, information: Floats, levers: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Normal matrix (4, 4) and right side (4,) of the weighted fit of x, y, roll, zoom."""
    matrix, right = np.zeros((4, 4)), np.zeros(4)
    a, pa = np.zeros((2, 4)), np.empty((2, 4))
    a[0, 0], a[1, 1] = 1.0, 1.0
    for b in range(found.shape[0]):
        if weight[b] <= 0.0:
            continue
        for k in range(2):
            a[k, 2], a[k, 3] = levers[b, k, 0], levers[b, k, 1]
        for i in range(4):
            for k in range(2):
                pa[k, i] = weight[b] * (information[b, 0, k] * a[0, i] + information[b, 1, k] * a[1, i])
            right[i] += pa[0, i] * found[b, 0] + pa[1, i] * found[b, 1]
            for j in range(i + 1):
                matrix[i, j] += pa[0, i] * a[0, j] + pa[1, i] * a[1, j]
    for i in range(4):
        for j in range(i):
            matrix[j, i] = matrix[i, j]
    return matrix, right


@njit(cache=True)
def inverse_of(matrix: Floats) -> Floats:
    """The inverse of a symmetric positive matrix, which needs no pivots."""
    n = len(matrix)
    out = matrix.copy()
    for k in range(n):
        pivot = 1.0 / out[k, k]
        out[k, k] = 1.0
        for j in range(n):
            out[k, j] *= pivot
        for i in range(n):
            if i != k:
                factor = out[i, k]
                out[i, k] = 0.0
                for j in range(n):
                    out[i, j] -= factor * out[k, j]
    return out


@njit(cache=True)
def product(matrix: Floats, vector: Floats) -> Floats:
    """Their product; so small ones are not worth a call of BLAS."""
    out = np.zeros(len(vector))
    for i in range(len(vector)):
        for j in range(len(vector)):
            out[i] += matrix[i, j] * vector[j]
    return out


@njit(cache=True)
def gains(found: Floats, information: Floats, usual: float) -> Floats:
    """Gain (blocks,) of every block, drawn to the median of all as far as its own is uncertain; NaN without one.

    `found` (blocks,) gains, `information` (blocks,) their inverse variances for noise of scale 1; `usual` the scale to
    be expected, 0 where it is not known.
    """
    out = np.full(found.shape[0], np.nan)
    usable = np.isfinite(found) & (information > 0)
    if not usable.any():
        return out
    own = found[usable]
    inverse = information[usable]
    middle = np.median(own)
    square = (own - middle) ** 2
    # The scatter of equal gains gives the noise (0.455 is the median of a normal variable's square); what is more
    # than that is their own difference.
    noise = np.median(square * inverse) / 0.455
    if usual > 0.0:
        noise = np.minimum(noise, MOST_SQUARE * usual**2)
    variance = noise / inverse
    spread = max(np.median(square) / 0.455 - np.median(variance), 0.0)
    # A block's own gain also counts as far as it lies outside the noise: covered blocks must not be averaged away.
    alone = np.maximum(1.0 - 4.0 * variance / np.maximum(square, 1e-300), 0.0)
    trust = np.maximum(spread / np.maximum(spread + variance, 1e-300), alone)
    out[usable] = middle + trust * (own - middle)
    return out


@njit(cache=True)
def _seed(found: Floats, information: Floats, levers: Floats, begin: Floats, square: float) -> Floats:
    """The pose, turned and enlarged as `begin`, that most of the blocks agree with, among those of the blocks."""
    best, most = begin.copy(), -1.0
    for b in range(found.shape[0]):
        if information[b, 0, 0] <= 0.0:
            continue
        pose = begin.copy()
        pose[0] = found[b, 0] - levers[b, 0, 0] * begin[2] - levers[b, 0, 1] * begin[3]
        pose[1] = found[b, 1] - levers[b, 1, 0] * begin[2] - levers[b, 1, 1] * begin[3]
        distance = _distances(found, information, levers, pose)
        # A block's own error doubles the squared distances from it.
        votes = (np.maximum(1.0 - distance / (2.0 * CUT**2 * square), 0.0) ** 2 * (information[:, 0, 0] > 0)).sum()
        if votes > most:
            best, most = pose, votes
    return best


@njit(cache=True)
def fuse(
    found: Floats, information: Floats, levers: Floats, begin: Floats, usual: float
) -> tuple[Floats, Floats, Floats, float]:
    """Pose (4,): x, y in px, roll in rad, zoom; its covariance (4, 4); the blocks' weights; the noise scale.

    `found` (blocks, 2) translations in px; `information` (blocks, 2, 2) their inverse covariances for noise of scale
    1, zero where a block does not count; `levers` (blocks, 2, 2) by how many px a roll of 1 rad and a zoom of 1 move a
    block along x and y; `begin` (4,) the pose before; `usual` the noise scale to be expected, 0 where it is not known.
    Tukey's biweight from the pose that most blocks vote for; its scale is from the median distance of the blocks, at
    most 1.3 times the usual one, so that more than half of them may say anything. Roll and zoom are drawn to zero as
    far as they may be noise.
    """
    shown = information[:, 0, 0] + information[:, 1, 1] > 0
    counted = shown.astype(np.float64)
    pose, covariance = begin.copy(), np.full((4, 4), np.inf)
    weight, scale = counted.copy(), 1.0
    if counted.sum() < 4:
        return pose, covariance, np.zeros(len(counted)), np.inf
    most = MOST_SQUARE * usual * usual if usual > 0.0 else np.inf
    seed = np.array([_median(found[:, 0], shown), _median(found[:, 1], shown), begin[2], begin[3]])
    distance = _distances(found, information, levers, seed)
    square = min(max(_median(distance, shown) / 1.386, 1e-12), most)
    near = (counted * (distance < CUT**2 * square)).sum() / counted.sum()
    pose = seed if near > AGREED else _seed(found, information, levers, begin, square)
    for step in range(_PASSES):
        distance = _distances(found, information, levers, pose)
        square = min(max(_median(distance, shown) / 1.386, 1e-12), most)
        before = pose.copy()
        # Where no block stands out none needs to count less: equal weights are the more exact.
        plain = (counted * distance).max() < PLAIN_SQUARE * square
        factors = (1.0, 1.0) if plain else (SQUARE_FACTOR, VARIANCE_FACTOR)
        weight = counted * np.maximum(1.0 - distance / (CUT**2 * square), 0.0) ** 2 if not plain else counted.copy()
        total = weight.sum()
        if total < 2.5:
            return pose, covariance, weight, np.inf
        matrix, right = _normal(found, information, levers, weight)
        scale = np.sqrt(factors[0] * (weight * distance).sum() / max(2.0 * total - 4.0, 1.0))
        for k in range(4):
            matrix[k, k] = matrix[k, k] * (1.0 + 1e-9) + 1e-12
        inverse = inverse_of(matrix)
        pose = product(inverse, right)
        for k in range(2, 4):
            own = factors[1] * scale**2 * inverse[k, k]
            matrix[k, k] += max(scale, 1e-9) ** 2 / (max(pose[k] ** 2 - own, 1e-3 * own) + 1e-300)
        inverse = inverse_of(matrix)
        covariance = inverse * (factors[1] * scale**2)
        pose = product(inverse, right)
        if step > 0 and np.abs(pose[:2] - before[:2]).max() < 1e-5:
            break
    return pose, covariance, weight, scale
