"""A template's kernels for all phases, and how much each block of it tells."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats, Region
from midspan.vision.kernels import PHASES, Integers, build, phase_shift, project, quantised
from midspan.vision.matching import CONTEXT_PX
from midspan.vision.spline import REACH, Floats32, coefficients, combine, weights
from midspan.vision.texture import lowpass_taps, noise_gains, noise_std, values

# Blocks along each axis, and the least size in px for which there are fewer of them.
COARSE, FINE = (5, 12), (8, 10)
LEAST_SHARE = 0.3  # of a block's gradients must be texture, not noise


@dataclass(frozen=True, slots=True)
class Plane:
    """What kernels are made from: `pixels` (rows, columns) around the window, which begins at `top`, `left` in it;
    `weight` (h, w) of the window's pixels; standard deviation of its noise.
    """

    pixels: Floats
    top: int
    left: int
    weight: Floats32
    noise_std: float


class Bank:
    """The kernels of a template for all phases, each made when it is first needed."""

    def __init__(self, plane: Plane, window: Region, smoothing_px: float, division: tuple[int, int]) -> None:
        self.window = window
        self._grids = (_grid(plane, window, 0.0), _grid(plane, window, smoothing_px))
        self._weight = plane.weight
        self.edges = (_edges(window.height, division), _edges(window.width, division))
        down, across = (0.5 * (e[1:] + e[:-1]) for e in self.edges)
        x, y = np.meshgrid(across - 0.5 * window.width, down - 0.5 * window.height)
        self.centres = np.column_stack([x.ravel(), y.ravel()])
        self.kernels = np.empty((PHASES**2, 3, window.height, window.width), dtype=np.float32)
        self._made = np.zeros(PHASES**2, dtype=bool)
        covariance = self._build(PHASES // 2 * (PHASES + 1))
        noise = plane.noise_std**2 * noise_gains(smoothing_px)[1] * 2.0
        share = np.clip(1.0 - noise / np.maximum(_gradient_squares(self._grids[1], self.edges), 1e-30), 0.0, 1.0)
        self.information = _information(covariance, share)
        spread = np.where(np.isfinite(covariance[:, 2, 2]), covariance[:, 2, 2], np.inf)
        self.gain_information = np.where(self.information[:, 0, 0] > 0, 1.0 / np.maximum(spread, 1e-300), 0.0)

    def measure(self, image: NDArray[np.generic], offset: float, place: Floats) -> tuple[Floats, Floats]:
        """Products (blocks, 3) of the frame with the kernels nearest to the blocks' `place` (blocks, 2), and the
        translations (blocks, 2) that these kernels stand for.
        """
        whole, phase = quantised(place)
        if not self._made[phase].all():
            for p in np.unique(phase[~self._made[phase]]):
                self._build(int(p))
        at = (whole[:, 1] + self.window.y, whole[:, 0] + self.window.x, phase)
        return project(image, offset, self.kernels, self.edges, at), np.floor(place * PHASES + 0.5) / PHASES

    def _build(self, phase: int) -> Floats:
        self._made[phase] = True
        return build(self._grids, self._weight, self.edges, phase_shift(phase), self.kernels[phase])


def _edges(size: int, division: tuple[int, int]) -> Integers:
    count = min(division[0], max(size // division[1], 2))
    return np.array([k * size // count for k in range(count + 1)], dtype=np.int64)


def first_plane(image: NDArray[np.generic], window: Region, offset: float) -> Plane:
    """The reference image around the window, less `offset`; its values are known to be usable."""
    y0, x0 = max(window.y - CONTEXT_PX, 0), max(window.x - CONTEXT_PX, 0)
    raw = values(image[y0 : window.y + window.height + CONTEXT_PX, x0 : window.x + window.width + CONTEXT_PX], offset)
    assert raw is not None
    weight = np.ones((window.height, window.width), dtype=np.float32)
    return Plane(raw.astype(np.float64), window.y - y0, window.x - x0, weight, _block_noise(raw))


def _grid(plane: Plane, window: Region, smoothing_px: float) -> Floats32:
    """Spline coefficients over the window and 3 px around it, of the low-passed image where `smoothing_px` is not 0."""
    from scipy.ndimage import convolve1d

    pixels = plane.pixels
    if smoothing_px > 0.0:
        taps = lowpass_taps(smoothing_px)
        pixels = convolve1d(convolve1d(pixels, taps, axis=0, mode="mirror"), taps, axis=1, mode="mirror")
    top, left = plane.top - REACH, plane.left - REACH
    part = coefficients(pixels)[top : top + window.height + 2 * REACH, left : left + window.width + 2 * REACH]
    return np.ascontiguousarray(part, dtype=np.float32)


def _block_noise(raw: Floats32) -> float:
    """Noise of the image: the lower fifth of that of its parts, because fine texture counts as noise."""
    side = 16
    parts = [
        noise_std(raw[y : y + side, x : x + side].astype(np.float64))
        for y in range(0, raw.shape[0] - side + 1, side)
        for x in range(0, raw.shape[1] - side + 1, side)
    ]
    return float(np.quantile(parts, 0.2))


def _gradient_squares(grid: Floats32, edges: tuple[Integers, Integers]) -> Floats:
    """Mean of the squared gradient (blocks,), its level taken out."""
    value, slope = weights(0.0, 0), weights(0.0, 1)
    gx, gy = combine(grid, value, slope).astype(np.float64), combine(grid, slope, value).astype(np.float64)
    down, across = edges
    return np.array(
        [gx[r0:r1, c0:c1].var() + gy[r0:r1, c0:c1].var() for r0, r1 in pairwise(down) for c0, c1 in pairwise(across)]
    )


def _information(covariance: Floats, share: Floats) -> Floats:
    """Inverse covariance (blocks, 2, 2) of x and y for noise of variance 1; 0 for blocks without texture."""
    out = np.zeros((len(covariance), 2, 2))
    for b, c in enumerate(covariance):
        if np.isfinite(c).all() and share[b] > 0.3:
            out[b] = np.linalg.inv(c[:2, :2]) * share[b]
    return out
