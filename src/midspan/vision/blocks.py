"""Robust fusion of the translations of many blocks into one translation, roll and zoom."""

import numpy as np
from numba import njit

from midspan.records import Floats

CUT = 6.0  # Tukey's weight is 0 beyond this many standard deviations
# What Tukey's weights do to a mean square of two normal components (m exponential of mean 2, cut at 6), and to the
# variance of the weighted mean: E[m] E[w] / E[w m], and E[w² m/2] E[w] / E[w - m (1 - m/36) 2/36]².
SQUARE_FACTOR = 1.124
VARIANCE_FACTOR = 0.920
_PASSES = 12


@njit(cache=True)
def _median(value: Floats, weight: Floats) -> float:
    """Weighted median; 0 without weight."""
    order = np.argsort(value)
    half, total = 0.5 * weight.sum(), 0.0
    for k in order:
        total += weight[k]
        if total >= half:
            return float(value[k])
    return 0.0


@njit(cache=True)
def _distances(found: Floats, information: Floats, centres: Floats, pose: Floats) -> Floats:
    """Squared Mahalanobis distance (blocks,) of every block's translation from the pose's."""
    out = np.empty(found.shape[0])
    for b in range(found.shape[0]):
        x, y = centres[b, 0], centres[b, 1]
        rx = found[b, 0] - (pose[0] - pose[2] * y + pose[3] * x)
        ry = found[b, 1] - (pose[1] + pose[2] * x + pose[3] * y)
        p = information[b]
        out[b] = p[0, 0] * rx * rx + 2.0 * p[0, 1] * rx * ry + p[1, 1] * ry * ry
    return out


@njit(cache=True)
def _normal(found: Floats, information: Floats, centres: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Normal matrix (4, 4) and right side (4,) of the weighted fit of x, y, roll, zoom."""
    matrix, right = np.zeros((4, 4)), np.zeros(4)
    a = np.zeros((2, 4))
    for b in range(found.shape[0]):
        if weight[b] <= 0.0:
            continue
        x, y = centres[b, 0], centres[b, 1]
        a[0, 0], a[0, 2], a[0, 3] = 1.0, -y, x
        a[1, 1], a[1, 2], a[1, 3] = 1.0, x, y
        for i in range(4):
            for k in range(2):
                pa = weight[b] * (information[b, 0, k] * a[0, i] + information[b, 1, k] * a[1, i])
                right[i] += pa * found[b, k]
                for j in range(4):
                    matrix[i, j] += pa * a[k, j]
    return matrix, right


@njit(cache=True)
def fuse(found: Floats, information: Floats, centres: Floats) -> tuple[Floats, Floats, Floats, float]:
    """Pose (4,): x, y in px, roll in rad, zoom; its covariance (4, 4); the blocks' weights; the noise scale.

    `found` (blocks, 2) translations in px; `information` (blocks, 2, 2) their inverse covariances for noise of scale
    1, zero where a block does not count; `centres` (blocks, 2) from the window's middle, px. Tukey's biweight from a
    median start, its scale from the median distance of the blocks: up to four blocks in ten may say anything. Roll and
    zoom are drawn to zero as far as they may be noise, so that they cost nothing where there are none.
    """
    use = information[:, 0, 0] + information[:, 1, 1]
    pose = np.zeros(4)
    pose[0] = _median(found[:, 0], np.where(use > 0, np.sqrt(information[:, 0, 0]), 0.0))
    pose[1] = _median(found[:, 1], np.where(use > 0, np.sqrt(information[:, 1, 1]), 0.0))
    counted = np.where(use > 0, 1.0, 0.0)
    covariance = np.full((4, 4), np.inf)
    weight, scale = counted.copy(), 1.0
    if counted.sum() < 4:
        return pose, covariance, np.zeros(len(use)), np.inf
    for step in range(_PASSES):
        distance = _distances(found, information, centres, pose)
        square = max(_median(distance, counted) / 1.386, 1e-12)
        before = pose.copy()
        weight = counted * np.maximum(1.0 - distance / (CUT**2 * square), 0.0) ** 2
        matrix, right = _normal(found, information, centres, weight)
        total = weight.sum()
        scale = np.sqrt(SQUARE_FACTOR * (weight * distance).sum() / max(2.0 * total - 4.0, 1.0))
        for k in range(4):
            matrix[k, k] = matrix[k, k] * (1.0 + 1e-9) + 1e-12
        covariance = np.linalg.inv(matrix) * (VARIANCE_FACTOR * scale**2)
        pose = np.linalg.solve(matrix, right)
        for k in range(2, 4):
            spread = max(pose[k] ** 2 - covariance[k, k], 1e-3 * covariance[k, k]) + 1e-300
            matrix[k, k] += max(scale, 1e-9) ** 2 / spread
        covariance = np.linalg.inv(matrix) * (VARIANCE_FACTOR * scale**2)
        pose = np.linalg.solve(matrix, right)
        if step > 2 and np.abs(pose[:2] - before[:2]).max() < 1e-6:
            break
    return pose, covariance, weight, scale
