"""A template with all that is computed from it once, and the spline peak of its ZNCC in a patch."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan._core import Fix
from midspan.errors import DataError
from midspan.records import Floats, Floats32, Region
from midspan.vision.region import inner
from midspan.vision.search import coarse_factor
from midspan.vision.texture import (
    REACH,
    check_texture,
    full_scale,
    lowpass_taps,
    noise_gains,
    noise_std,
    values,
)

INSET_PX = 8  # the template's spline needs this much image around the window
CONTEXT_PX = 20  # the spline is fitted with this much around it, so that the mirror at its edge is not felt


@dataclass(frozen=True, slots=True)
class Matching:
    """How to match: Gaussian smoothing (px), and below which share of the possible correlation a peak is refused."""

    smoothing_px: float
    min_correlation: float


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """The reference window and all that is computed from it once.

    matcher: looks for it in a frame. window: the part of the region that is matched. taps: (2 m + 1,) of the low-pass.
    pixels: (h, w) filtered and with zero mean. offset: subtracted from all frames. factor: of decimation.
    """

    matcher: _core.Template
    window: Region
    taps: Floats32
    pixels: Floats32
    offset: float
    factor: int
    expected_correlation: float
    threshold: float

    def near(self, image: NDArray[np.generic], place: tuple[int, int], radius: tuple[int, int]) -> Fix | None:
        """The best peak that is accepted within `radius` px of the window's `place` (x, y) px.

        A peak on the rim moves the search there, four times at most.
        """
        return self.matcher.near(image, self.offset, place, radius)


def make_template(image: NDArray[np.generic], region: Region, matching: Matching) -> Template:
    """Prepare the template of `region` in the reference `image`; UsageError when it has no texture to follow."""
    window = inner(region, image.shape[1], image.shape[0], INSET_PX)
    raw, x0, y0, offset = _surroundings(image, region, window)
    sigma = noise_std(raw.astype(np.float64))
    check_texture(raw, sigma, full_scale(image), str(region))
    taps = lowpass_taps(matching.smoothing_px).astype(np.float32)
    grid = _grid(raw, taps, window, (x0, y0))
    basis = _basis(grid)
    pixels, gradient = np.ascontiguousarray(basis[0]), _informative(basis)
    gains = noise_gains(matching.smoothing_px)
    fisher = _outer(gradient)
    expected, threshold = _correlations(pixels, fisher, sigma**2 * gains[0], matching.min_correlation)
    margin = 2 * (len(taps) // 2)
    matcher = _core.Template(
        window=(window.x, window.y, window.width, window.height),
        taps=taps,
        grid=grid,
        basis=basis,
        information=np.stack([fisher, _outer(np.stack([_core.smooth(np.pad(g, margin), taps) for g in gradient]))]),
        gains=(gains[0], pixels.size * gains[1], pixels.size * gains[2]),
        threshold=threshold,
    )
    return Template(matcher, window, taps, pixels, offset, coarse_factor(pixels), expected, threshold)


def _surroundings(image: NDArray[np.generic], region: Region, window: Region) -> tuple[Floats32, int, int, float]:
    """The image around the window less its mean, the column and row of its first pixel, and that mean."""
    x0, y0 = max(window.x - CONTEXT_PX, 0), max(window.y - CONTEXT_PX, 0)
    cut = image[y0 : window.y + window.height + CONTEXT_PX, x0 : window.x + window.width + CONTEXT_PX]
    wide = np.asarray(cut, dtype=np.float64)
    offset = float(np.mean(wide[np.isfinite(wide)])) if np.isfinite(wide).any() else 0.0
    raw = values(cut, offset)
    if raw is None:
        raise without_values(region)
    return raw, x0, y0, offset


def without_values(region: Region) -> DataError:
    """The error for a region with too many pixels that are no numbers."""
    return DataError(
        f"camera.roi must lie where at least 98 % of the pixels have a value; received {region}. Choose another place."
    )


def _grid(raw: Floats32, taps: Floats32, window: Region, origin: tuple[int, int]) -> Floats32:
    """Spline coefficients of the smoothed image over the window and 3 px around it."""
    margin = len(taps) // 2
    spline = _core.spline_coefficients(_core.smooth(raw, taps).astype(np.float64))
    top, left = window.y - origin[1] - margin - REACH, window.x - origin[0] - margin - REACH
    part = spline[top : top + window.height + 2 * REACH, left : left + window.width + 2 * REACH]
    return np.ascontiguousarray(part, dtype=np.float32)


def _basis(grid: Floats32) -> Floats32:
    """The template (h, w) with zero mean and its gradients along x and y: (3, h, w)."""
    value, slope = _core.spline_weights(0.0, 0), _core.spline_weights(0.0, 1)
    pixels = _core.combine(grid, value, value).astype(np.float64)
    gradients = [_core.combine(grid, value, slope), _core.combine(grid, slope, value)]
    return np.stack([pixels - pixels.mean(), *gradients]).astype(np.float32)


def _informative(basis: Floats32) -> Floats32:
    """The gradients (2, h, w) without mean and without the template in them.

    Level and gain of the frame are free, so that only this part of the gradients tells anything about the shift.
    """
    pixels = basis[0].astype(np.float64)
    out = []
    for plane in basis[1:]:
        g = plane.astype(np.float64)
        g -= g.mean()
        out.append(g - pixels * (float(np.sum(pixels * g)) / max(float(np.sum(pixels * pixels)), 1e-300)))
    return np.stack(out).astype(np.float32)


def _outer(gradient: Floats32) -> Floats:
    """Sum of g gᵀ (2, 2) over the window."""
    flat = gradient.reshape(2, -1).astype(np.float64)
    # BLAS would start a thread for so little, which costs more than the sum.
    return np.asarray(np.einsum("ik,jk->ij", flat, flat), dtype=np.float64)


def _correlations(pixels: Floats32, fisher: Floats, noise_variance: float, share: float) -> tuple[float, float]:
    """The correlation that noise in frame and template allows, and the smallest that is accepted.

    A peak must also stand above what unrelated texture reaches by chance: 4.5 standard deviations with as many
    independent pixels as the texture has correlation areas.
    """
    variance = max(float(np.var(pixels)), 1e-300)
    expected = min(max(1.0 - noise_variance / variance, 0.3), 1.0)
    slopes = math.sqrt(float(fisher[0, 0] * fisher[1, 1])) / pixels.size
    independent = max(pixels.size * min(slopes / variance, 1.0), 1.0)
    chance = min(4.5 / math.sqrt(independent), 0.6)
    return expected, max(share * expected, chance)
