"""Kernels that turn pixels into translations: one product a pixel for x, for y and for the gain.

In each block of the window the frame is a T - a d·∇T + level + ramps, with the template T at a known phase, a small
remaining shift d and a gain a. The kernels are the rows of (Zᵀ W A)⁻¹ Zᵀ W that belong to a d and a: A holds the
gradients, the template, 1 and two ramps, W one over each pixel's noise variance, and Z the same columns as A of the
low-passed template. Whatever is in A and not wanted drops out exactly; the low-pass in Z alone keeps the template's
noise and aliasing, which the gradient amplifies, out of the result (an instrument in the sense of regression).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats
from midspan.vision.spline import Floats32, combine, weights

Integers = NDArray[np.int64]

PHASES = 16  # a pixel, along each axis: linearising over 1/32 px leaves an error of the order of 1e-4 px
_UNKNOWNS = 6


@njit(cache=True)
def _invert(matrix: Floats) -> bool:
    """Invert a square matrix in place by elimination with pivots on scaled rows; False where it is singular."""
    n = matrix.shape[0]
    work = np.zeros((n, 2 * n))
    for i in range(n):
        largest = np.abs(matrix[i]).max()
        if largest == 0.0:
            return False
        work[i, :n] = matrix[i] / largest
        work[i, n + i] = 1.0 / largest
    for k in range(n):
        best = k + np.abs(work[k:, k]).argmax()
        if abs(work[best, k]) < 1e-9:
            return False
        if best != k:
            line = work[k].copy()
            work[k], work[best] = work[best], line
        work[k] /= work[k, k]
        for i in range(n):
            if i != k:
                work[i] -= work[i, k] * work[k]
    matrix[:] = work[:, n:]
    return True


@njit(cache=True)
def _columns(planes: Floats32, box: tuple[int, int, int, int]) -> Floats:
    """The regressors (6, pixels) of a block: -∂x, -∂y, template, 1, ramp across, ramp down."""
    top, bottom, left, right = box
    out = np.empty((_UNKNOWNS, (bottom - top) * (right - left)))
    n = 0
    for r in range(top, bottom):
        for c in range(left, right):
            out[0, n], out[1, n], out[2, n] = -planes[1, r, c], -planes[2, r, c], planes[0, r, c]
            out[3, n] = 1.0
            out[4, n] = (2 * c - left - right + 1) / (right - left)
            out[5, n] = (2 * r - top - bottom + 1) / (bottom - top)
            n += 1
    return out


@njit(cache=True)
def _planes(grid: Floats32, x: float, y: float) -> Floats32:
    """Template and its gradients x and y, (3, h, w), moved by (x, y) px."""
    wx, wy = weights(-x, 0), weights(-y, 0)
    value = combine(grid, wy, wx)
    out = np.empty((3, *value.shape), dtype=np.float32)
    out[0] = value
    out[1] = combine(grid, wy, weights(-x, 1))
    out[2] = combine(grid, weights(-y, 1), wx)
    return out


@njit(cache=True, fastmath=True)
def build(
    grids: tuple[Floats32, Floats32], weight: Floats32, edges: tuple[Integers, Integers], shift: Floats, out: Floats32
) -> Floats:
    """Fill `out` (3, h, w) with the kernels for the template moved by `shift` (2,): x, y in px.

    `grids`: spline coefficients (h + 6, w + 6) of the template and of the low-passed one; `weight` (h, w) one over the
    noise variance; `edges`: rows and columns (n + 1,) at which the blocks begin and end. Returns the kernels' noise
    covariance (blocks, 3, 3) for that noise; infinite where a block holds no texture.
    """
    model, instrument = _planes(grids[0], shift[0], shift[1]), _planes(grids[1], shift[0], shift[1])
    down, across = edges
    count = (len(down) - 1) * (len(across) - 1)
    covariance = np.full((count, 3, 3), np.inf)
    for b in range(count):
        j, i = divmod(b, len(across) - 1)
        box = (down[j], down[j + 1], across[i], across[i + 1])
        rows, columns = box[1] - box[0], box[3] - box[2]
        part = weight[box[0] : box[1], box[2] : box[3]].copy().reshape(rows * columns).astype(np.float64)
        weighted = _columns(instrument, box) * part
        inverse = weighted @ _columns(model, box).T
        if not _invert(inverse):
            out[:, box[0] : box[1], box[2] : box[3]] = np.float32(0.0)
            continue
        kernels = np.ascontiguousarray(inverse[:3]) @ weighted
        covariance[b] = (kernels / part) @ kernels.T
        for n in range(3):
            for r in range(rows):
                for c in range(columns):
                    out[n, box[0] + r, box[2] + c] = kernels[n, r * columns + c]
    return covariance


@njit(cache=True)
def places(pose: Floats, centres: Floats) -> Floats:
    """Translation (blocks, 2) of each block under `pose` (4,): x, y in px at the window's middle, roll in rad, zoom.

    `centres` (blocks, 2): x, y of the blocks from the window's middle, px.
    """
    out = np.empty((centres.shape[0], 2))
    for b in range(centres.shape[0]):
        x, y = centres[b, 0], centres[b, 1]
        out[b, 0] = pose[0] - pose[2] * y + pose[3] * x
        out[b, 1] = pose[1] + pose[2] * x + pose[3] * y
    return out


@njit(cache=True)
def quantised(place: Floats) -> tuple[Integers, Integers]:
    """Whole pixels (blocks, 2) and the number of the phase (blocks,) nearest to each translation (blocks, 2)."""
    whole = np.empty(place.shape, dtype=np.int64)
    phase = np.zeros(place.shape[0], dtype=np.int64)
    for b in range(place.shape[0]):
        for axis in range(2):
            steps = int(np.floor(place[b, axis] * PHASES + 0.5))
            whole[b, axis] = (steps + PHASES // 2) // PHASES
            phase[b] = phase[b] * PHASES + steps - whole[b, axis] * PHASES + PHASES // 2
    return whole, phase


def phase_shift(phase: int) -> Floats:
    """The shift (2,): x, y in px, -0.5 to below 0.5, of the phase of that number."""
    return np.array([phase // PHASES - PHASES // 2, phase % PHASES - PHASES // 2]) / PHASES


@njit(cache=True, fastmath=True)
def project(
    image: NDArray[np.generic],
    offset: float,
    bank: Floats32,
    edges: tuple[Integers, Integers],
    at: tuple[Integers, Integers, Integers],
) -> Floats:
    """Products of every block with its kernels: (blocks, 3) for a dx, a dy and a.

    `image` (rows, columns), of which `offset` is subtracted; `bank` (phases, 3, h, w); `edges` of the blocks in the
    window; `at`: for every block the row and column of the image where the window would begin for it, and its phase.
    NaN where the block is not wholly inside the image.
    """
    down, across = edges
    top, left, phase = at
    out = np.zeros((top.shape[0], 3))
    level = np.float32(offset)
    acc = np.empty((3, bank.shape[3]), dtype=np.float32)
    for b in range(top.shape[0]):
        j, i = divmod(b, len(across) - 1)
        r0, r1, c0, c1 = down[j], down[j + 1], across[i], across[i + 1]
        y, x = top[b], left[b]
        if y + r0 < 0 or x + c0 < 0 or y + r1 > image.shape[0] or x + c1 > image.shape[1]:
            out[b] = np.nan
            continue
        width = c1 - c0
        acc[:, :width] = np.float32(0.0)
        p = phase[b]
        for r in range(r0, r1):
            line = image[y + r, x + c0 : x + c1]
            k0, k1, k2 = bank[p, 0, r, c0:c1], bank[p, 1, r, c0:c1], bank[p, 2, r, c0:c1]
            for c in range(width):
                value = np.float32(line[c]) - level
                acc[0, c] += k0[c] * value
                acc[1, c] += k1[c] * value
                acc[2, c] += k2[c] * value
        for n in range(3):
            total = 0.0
            for c in range(width):
                total += acc[n, c]
            out[b, n] = total
    return out
