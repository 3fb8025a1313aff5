"""How well a shift could be measured at each place of an image, from the structure tensor and the noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats
from midspan.vision.texture import gaussian_taps, noise_std, values

SMOOTHING_PX = 0.8
CROSS_SHARE = 0.1  # what the variance across the measured direction counts
CLIPPED_SHARE = 0.02  # more black or saturated pixels than this rule a place out


@dataclass(frozen=True, slots=True)
class Grid:
    """Predicted standard deviation (px) (rows, columns) of a region centred at centre_y and centre_x; NaN: ruled out.

    noise: standard deviation of the image's noise in its own unit.
    """

    std_px: Floats
    centre_x: NDArray[np.int64]
    centre_y: NDArray[np.int64]
    noise: float


def score_grid(image: NDArray[np.generic], size: int, margins: tuple[int, int], direction: str) -> Grid:
    """Score regions of `size` px on a grid of a quarter of it, `margins` (columns, rows) away from the border."""
    wide = np.asarray(image, dtype=np.float64)
    finite = np.isfinite(wide)
    plain = np.where(finite, wide, np.median(wide[finite]) if finite.any() else 0.0)
    noise = max(noise_std(plain), _rounding(image))
    step = max(size // 4, 4)
    x = np.arange(margins[0], image.shape[1] - margins[0] - size + 1, step)
    y = np.arange(margins[1], image.shape[0] - margins[1] - size + 1, step)
    variance = _variance(plain, noise, (y, x), size, direction)
    bad = _window_sums((~finite | clipped(image)).astype(np.float64), y, x, size) > CLIPPED_SHARE * size * size
    return Grid(np.where(bad, np.nan, np.sqrt(variance)), x + size // 2, y + size // 2, noise)


def _rounding(image: NDArray[np.generic]) -> float:
    """Standard deviation of rounding to whole numbers; a trifle of the level for other types."""
    if image.dtype.kind in "iub":
        return float(1.0 / np.sqrt(12.0))
    finite = np.abs(image[np.isfinite(image)])
    return 1e-6 * float(finite.max(initial=0.0)) + 1e-30


def _variance(
    plain: Floats, noise: float, places: tuple[NDArray[np.int64], NDArray[np.int64]], size: int, direction: str
) -> Floats:
    """Variance (px²) of a shift measured between two frames at each place (rows, columns)."""
    taps = gaussian_taps(SMOOTHING_PX).astype(np.float32)
    m = len(taps) // 2
    level = float(plain.mean())
    raw = values(np.pad(plain, m, mode="edge"), level)
    smoothed = _core.smooth(raw, taps).astype(np.float64) if raw is not None else np.zeros_like(plain)
    gy, gx = np.asarray(np.gradient(smoothed), dtype=np.float64)
    y, x = places
    # The noise's own gradients: central difference of the smoothed noise along one axis.
    own = float(np.sum(np.convolve(taps, [0.5, 0.0, -0.5]) ** 2) * np.sum(taps.astype(np.float64) ** 2))
    base = noise**2 * own * size * size
    xx = np.maximum(_window_sums(gx * gx, y, x, size) - 1.5 * base, 1e-30)
    yy = np.maximum(_window_sums(gy * gy, y, x, size) - 1.5 * base, 1e-30)
    xy = _window_sums(gx * gy, y, x, size)
    det = np.maximum(xx * yy - xy * xy, 1e-6 * xx * yy)
    along, across = (yy, xx) if direction == "x" else (xx, yy)
    return np.asarray(2.0 * noise**2 * (along + CROSS_SHARE * across) / det, dtype=np.float64)


def clipped(image: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Where the image (rows, columns) is black or saturated: within 1 % of the ends of an 8 bit scale, or, for other
    types, at an extreme value that more than one pixel in a thousand shares.
    """
    if image.dtype == np.uint8:
        grey = image.astype(np.uint8, copy=False)
        return np.asarray((grey <= 2) | (grey >= 253))
    flat = image[np.isfinite(image)]
    if flat.size == 0:
        return np.ones(image.shape, dtype=np.bool_)
    out = np.zeros(image.shape, dtype=np.bool_)
    for extreme in (flat.min(), flat.max()):
        same = image == extreme
        if np.count_nonzero(same) > 1e-3 * image.size:
            out |= same
    return out


def _window_sums(a: Floats, y: NDArray[np.int64], x: NDArray[np.int64], size: int) -> Floats:
    """Sums of `a` over the squares of `size` px with the top left corners at all y and x."""
    total = np.zeros((a.shape[0] + 1, a.shape[1] + 1))
    total[1:, 1:] = a.cumsum(0).cumsum(1)
    top, bottom = y[:, None], y[:, None] + size
    left, right = x[None, :], x[None, :] + size
    return np.asarray(total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left])
