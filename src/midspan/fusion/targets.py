"""Several targets of one camera: each one's displacement relative to the expected path, and one value a frame out of
them.

All targets are fixed, so their displacements differ by noise and by a constant: each counts from its own reference
picture, whose noise is in its zero. Arrays have the axes (target k, frame n); what was not seen is NaN.
"""

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats

# Targets further than this many standard deviations from what the others or the prediction say are left out.
AGREE_STD = 4.0
# The median of normal values is known to π/2 of the variance of their mean.
MEDIAN_EXCESS = 0.5 * np.pi
Used = NDArray[np.bool_]


def combine(residual: Floats, variance: Floats, used: Used) -> tuple[Floats, Floats]:
    """One value a frame and its variance (n,): the mean by inverse variance of those residuals (k, n) that are `used`;
    NaN and infinite where none is.
    """
    inverse = np.where(used, 1.0 / np.maximum(np.where(used, variance, 1.0), 1e-300), 0.0)
    total = inverse.sum(axis=0)
    known = np.where(total > 0.0, total, 1.0)
    value = np.where(total > 0.0, np.sum(inverse / known * np.where(used, residual, 0.0), axis=0), np.nan)
    return value, np.where(total > 0.0, 1.0 / known, np.inf)


def agreeing(residual: Floats, variance: Floats, path_variance: Floats) -> Used:
    """Which targets (k, n) agree with each other; where only two are left, the expected path decides between them.

    residual: displacement minus the expected path, each with its own zero; variance: what either may be off by;
    path_variance (n,): of the path. One target alone is always used: the filter judges it.
    """
    usable = np.isfinite(residual) & np.isfinite(variance)
    if len(residual) == 1:
        return usable
    count = usable.sum(axis=0)
    total = np.where(usable, variance, np.inf)
    crowd = count >= 3
    middle, spread = np.zeros(residual.shape[1]), np.asarray(path_variance, dtype=np.float64)
    if crowd.any():
        middle[crowd] = np.nanmedian(np.where(usable, residual, np.nan)[:, crowd], axis=0)
        information = np.where(crowd, np.sum(1.0 / total, axis=0), 1.0)
        spread = np.where(crowd, MEDIAN_EXCESS / information, spread)
    known = np.where(usable, residual - middle, 0.0) / np.sqrt(np.where(usable, variance, 1.0) + spread)
    away = np.where(usable, np.abs(known), np.inf)
    used = usable & (away <= AGREE_STD)
    low = np.min(np.where(usable, residual, np.inf), axis=0)
    high = np.max(np.where(usable, residual, -np.inf), axis=0)
    both = np.sqrt(np.sum(np.where(usable, total, 0.0), axis=0))
    pair = (count == 2) & (high - low <= AGREE_STD * both)
    used = np.where(pair, usable, used)
    # Where nothing agrees, the nearest is taken, and the filter judges it.
    none = (count > 0) & ~used.any(axis=0)
    used[np.argmin(away, axis=0)[none], np.flatnonzero(none)] = True
    return used


def relative_zeros(residual: Floats, variance: Floats) -> Floats:
    """The constant (k,) by which each target lies relative to the others, from residuals (k, n) from one path.

    The mean of what lies within four standard deviations of the median; 0 for a target that was never seen. The zeros
    together are moved so that their mean by inverse variance is 0: no target's reference picture counts alone.
    """
    zeros, weights = np.zeros(len(residual)), np.zeros(len(residual))
    for k, (row, own) in enumerate(zip(residual, variance, strict=True)):
        known = np.isfinite(row) & np.isfinite(own)
        if not known.any():
            continue
        middle = float(np.median(row[known]))
        near = known & (np.abs(row - middle) <= AGREE_STD * np.sqrt(np.where(known, own, 0.0)))
        zeros[k] = float(np.mean(row[near])) if near.any() else middle
        weights[k] = 1.0 / max(float(np.median(own[known])), 1e-300)
    return zeros - float(np.sum(weights * zeros)) / max(float(np.sum(weights)), 1e-300)
