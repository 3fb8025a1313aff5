"""Active pixels: those whose local phase tells the translation.

After the paper on hybrid phase and feature matching, section 3.1 step 3: the threshold of correlation that makes the
mean phase explain the translation best (maximum R²). R² alone ends with a handful of pixels once the translation's own
noise limits it, so that the pixels kept must also hold a given share of all the information.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats, Floats32, Region
from midspan.signals.health import Mask

STRONGEST = 30
AMPLITUDE_SHARE = 0.2
THRESHOLDS = 64


@dataclass(frozen=True, slots=True, eq=False)
class ActivePixels:
    """The pixels whose phase tells a target's translation: x and y, (rows, columns) of `region` in the reference frame.

    r_squared: of the regressions along x and y that chose them; NaN where the amplitude did.
    """

    region: Region
    x: Mask
    y: Mask
    r_squared: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Selection:
    """Active pixels (k,), the gain in px/rad of their mean phase, and the R² of that regression."""

    active: Mask
    gain_px_per_rad: float
    r_squared: float


def by_amplitude(amplitude: NDArray[np.floating]) -> Mask:
    """Pixels whose local amplitude exceeds a fifth of the mean of the 30 largest; same shape."""
    flat = np.sort(amplitude, axis=None)[-STRONGEST:]
    return np.asarray(amplitude > AMPLITUDE_SHARE * float(flat.mean()), dtype=bool)


def slope_and_r_squared(phase: Floats | Floats32, translation: Floats) -> tuple[Floats, Floats]:
    """Regression of `phase` (n,) or (n, k), rad, on `translation` (n,), px: slopes in rad/px and R².

    Phase on translation and not the other way round: the noise is in the phase.
    """
    t = translation - translation.mean()
    p = phase - phase.mean(axis=0)
    product = np.tensordot(t, p, axes=(0, 0))
    power_t = max(float(t @ t), 1e-300)
    power_p = np.maximum(np.sum(p * p, axis=0), 1e-300)
    return np.asarray(product / power_t), np.asarray(product**2 / (power_t * power_p))


def by_correlation(
    phase: Floats32,
    translation: Floats,
    *,
    weight: Floats | None = None,
    information: Floats | None = None,
    least_information: float = 0.5,
) -> Selection:
    """Pixels by the threshold of |correlation| with the largest R² among those that keep enough information.

    `phase` (n, k) rad of k pixels in n frames, `translation` (n,) px of the residual motion, `weight` (k,) of the
    pixels in the mean (equal without), `information` (k,) of each pixel in any unit (without: slope² over the variance
    about its own regression line). `least_information` is the share of its sum to be kept, 0 (the paper's rule) to 1.
    """
    r_squared = slope_and_r_squared(phase, translation)[1]
    if information is None:
        information = r_squared / np.maximum(1.0 - r_squared, 1e-9)
    order = np.argsort(-r_squared, kind="stable")
    shares = np.cumsum(information[order]) / max(float(information.sum()), 1e-300)
    counts = np.unique(np.linspace(1, len(order), THRESHOLDS).astype(np.int64))
    first = int(np.searchsorted(shares, least_information)) + 1
    counts = np.unique(np.append(counts[counts >= first], min(first, len(order))))
    w = (np.ones(len(order)) if weight is None else np.asarray(weight, dtype=np.float64))[order]
    means = _means_of_first(phase[:, order], w, counts)
    slopes, fits = slope_and_r_squared(means, translation)
    best = int(np.argmax(fits))
    active = np.zeros(len(order), dtype=bool)
    active[order[: counts[best]]] = True
    return Selection(active, 1.0 / float(slopes[best]), float(fits[best]))


def _means_of_first(phase: Floats32, weight: Floats, counts: NDArray[np.int64]) -> Floats:
    """Weighted mean phases (n, thresholds) over the first `counts` pixels."""
    starts = np.concatenate([[0], counts[:-1]])
    used = slice(0, int(counts[-1]))
    parts = np.add.reduceat(phase[:, used] * weight[used], starts, axis=1, dtype=np.float64)
    total = np.add.reduceat(weight[used], starts)
    return np.asarray(np.cumsum(parts, axis=1) / np.cumsum(total))
