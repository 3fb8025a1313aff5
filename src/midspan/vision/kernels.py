"""Kernels that turn pixels into translations: one product a pixel for x, for y and for the gain.

In each block of the window the frame is a T - a d·∇T + level + ramps, with the template T at a known phase, a small
remaining shift d and a gain a. The kernels are the rows of (Zᵀ W A)⁻¹ Zᵀ W that belong to a d and a: A holds the
gradients, the template, 1, two ramps and the template times each ramp (light that falls off across the block), W one
over each pixel's noise variance, and Z the same columns as A of the low-passed template. Whatever is in A and not
wanted drops out exactly; the low-pass in Z alone keeps the template's noise and aliasing, which the gradient amplifies,
out of the result (an instrument in the sense of regression). What they give for the second order of a shift is known
and taken off, so that kernels for every eighth of a pixel are enough.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats
from midspan.vision.fine_spline import FINE_TAPS, PER_PX, curvatures, planes
from midspan.vision.spline import Floats32

Integers = NDArray[np.int64]
Halves = NDArray[np.int16]
LARGEST_HALF = 32767.0

PHASES = 8  # a pixel, along each axis: the third order over 1/16 px leaves an error of the order of 4e-5 px
_UNKNOWNS = 8


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
        pivot = 1.0 / work[best, k]
        for j in range(2 * n):
            scaled = work[best, j] * pivot
            work[best, j] = work[k, j]
            work[k, j] = scaled
        for i in range(n):
            factor = work[i, k]
            if i != k:
                for j in range(2 * n):
                    work[i, j] -= factor * work[k, j]
    matrix[:] = work[:, n:]
    return True


@njit(cache=True, fastmath=True)
def _columns(planes: Floats32) -> Floats:
    """The regressors (8, pixels) of a block from its `planes` (3, h, w): -∂x, -∂y, template, 1, ramps across and down,
    the template times each.
    """
    rows, columns = planes.shape[1], planes.shape[2]
    out = np.empty((_UNKNOWNS, rows * columns))
    for r in range(rows):
        part = out[:, r * columns : (r + 1) * columns]
        down = (2 * r - rows + 1) / rows
        for c in range(columns):
            across, value = (2 * c - columns + 1) * (1.0 / columns), planes[0, r, c]
            part[0, c], part[1, c], part[2, c] = -planes[1, r, c], -planes[2, r, c], value
            part[3, c], part[4, c], part[5, c] = 1.0, across, down
            part[6, c], part[7, c] = across * value, down * value
    return out


@njit(cache=True)
def build(
    grids: tuple[Floats32, Floats32],
    weight: Floats32,
    box: tuple[int, int, int, int],
    shift: tuple[float, float],
    out: Floats32,
) -> Floats:
    """Fill `out` (3 pixels,) with the kernels of the block `box` for the template moved by `shift` (x, y px).

    `grids`: fine spline coefficients (2 h + 7, 2 w + 7) of the template and of the low-passed one; `weight` (h, w) one
    over the noise variance; `box`: first row, row after the last, first column, column after the last of the block in
    the window. The kernels are zero where the block holds no texture. Returns what they give (2, 5) for x and y (rows)
    of a block turned by 1 rad or enlarged by 1 about its middle, and of the second order of a shift: for its dx²/2,
    dx dy and dy²/2 (columns).
    """
    top, bottom, left, right = box
    beyond = FINE_TAPS - PER_PX
    down, across = slice(PER_PX * top, PER_PX * bottom + beyond), slice(PER_PX * left, PER_PX * right + beyond)
    # Copies without gaps: only along those can the compiler take several pixels at once.
    grid = grids[0][down, across].copy()
    moved = planes(grid, shift[0], shift[1])
    model = _columns(moved)
    weighted = _columns(planes(grids[1][down, across].copy(), shift[0], shift[1]))
    weighted *= weight[top:bottom, left:right].copy().reshape(weighted.shape[1])
    inverse = weighted @ model.T
    if not _invert(inverse):
        out[:] = np.float32(0.0)
        return np.zeros((2, 5))
    kernels = np.ascontiguousarray(inverse[:3]) @ weighted
    out[:] = kernels.reshape(len(out))
    return kernels[:2] @ _warps(moved, curvatures(grid, shift[0], shift[1])).T


@njit(cache=True, fastmath=True)
def _warps(planes: Floats32, curvatures: Floats32) -> Floats:
    """How a block's pixels (5, pixels) change when it is turned by 1 rad, when it is enlarged by 1, and to the second
    order of a shift: with dx²/2, dx dy and dy²/2.
    """
    rows, columns = planes.shape[1], planes.shape[2]
    out = np.empty((5, rows * columns))
    for r in range(rows):
        part, y = out[:, r * columns : (r + 1) * columns], r - 0.5 * (rows - 1)
        for c in range(columns):
            x = c - 0.5 * (columns - 1)
            part[0, c] = y * planes[1, r, c] - x * planes[2, r, c]
            part[1, c] = -x * planes[1, r, c] - y * planes[2, r, c]
            part[2, c], part[3, c], part[4, c] = curvatures[0, r, c], curvatures[1, r, c], curvatures[2, r, c]
    return out


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
def quantised(place: Floats) -> tuple[Integers, Integers, Floats]:
    """Whole pixels (blocks, 2), the number of the phase (blocks,) nearest to each translation (blocks, 2), and what
    both make together (blocks, 2), px.
    """
    whole, near = np.empty(place.shape, dtype=np.int64), np.empty(place.shape)
    phase = np.zeros(place.shape[0], dtype=np.int64)
    for b in range(place.shape[0]):
        for axis in range(2):
            steps = int(np.floor(place[b, axis] * PHASES + 0.5))
            whole[b, axis] = (steps + PHASES // 2) // PHASES
            phase[b] = phase[b] * PHASES + steps - whole[b, axis] * PHASES + PHASES // 2
            near[b, axis] = steps / PHASES
    return whole, phase, near


@njit(cache=True)
def phase_shift(phase: int) -> tuple[float, float]:
    """The shift x, y in px, -0.5 to below 0.5, of the phase of that number."""
    return (phase // PHASES - PHASES // 2) / PHASES, (phase % PHASES - PHASES // 2) / PHASES


@njit(cache=True)
def block_part(box: tuple[int, int, int, int], columns: int) -> tuple[int, int]:
    """First number and size of a block's pixels among those of a window of so many `columns`, block after block."""
    top, bottom, left, right = box
    return top * columns + (bottom - top) * left, (bottom - top) * (right - left)


@njit(cache=True, fastmath=True)
def rounded(kernels: Floats32, out: Halves) -> Floats32:
    """Fill `out` (3 pixels,) with three kernels as whole numbers of 16 bits, and return the step (3,) of each.

    Half the memory is half the time, as kernels come from outside the processor's caches. Their rounding makes less
    than a thousandth of the noise of a frame.
    """
    size = len(kernels) // 3
    steps = np.ones(3, dtype=np.float32)
    for k in range(3):
        own, into = kernels[k * size : (k + 1) * size], out[k * size : (k + 1) * size]
        largest = np.abs(own).max()
        if largest > 0.0:
            steps[k] = largest / LARGEST_HALF
        for n in range(size):
            into[n] = np.int16(np.rint(own[n] / steps[k]))
    return steps


@njit(cache=True, fastmath=True)
def project(
    image: NDArray[np.generic],
    offset: float,
    bank: tuple[Halves, Floats32],
    edges: tuple[Integers, Integers],
    at: tuple[Integers, Integers, Integers],
) -> Floats:
    """Products of every block with its kernels: (blocks, 3) for a dx, a dy and a.

    `image` (rows, columns), of which `offset` is subtracted; `bank`: kernels (slots, 3 h w), three of a block, then
    those of the next, and their steps (blocks, slots, 3), see `rounded`; `edges` of the blocks in the window; `at`: for
    every block the row and column of the image where the window would begin for it, and its slot of the bank, -1 for
    none. NaN without a slot and where the block is not wholly inside the image.
    """
    down, across = edges
    top, left, slot = at
    out = np.full((top.shape[0], 3), np.nan)
    level = np.float32(offset)
    pixels = np.empty(np.diff(down).max() * np.diff(across).max(), dtype=image.dtype)
    for b in range(top.shape[0]):
        j, i = divmod(b, len(across) - 1)
        r0, r1, c0, c1 = down[j], down[j + 1], across[i], across[i + 1]
        y, x = top[b], left[b]
        inside = y + r0 >= 0 and x + c0 >= 0 and y + r1 <= image.shape[0] and x + c1 <= image.shape[1]
        if slot[b] < 0 or not inside:
            continue
        # Long runs without gaps are what processor and memory are fast with: first the block's pixels, then a sum each.
        for r in range(r0, r1):
            line, part = image[y + r, x + c0 : x + c1], pixels[(r - r0) * (c1 - c0) : (r + 1 - r0) * (c1 - c0)]
            for c in range(c1 - c0):
                part[c] = line[c]
        first, size = block_part((r0, r1, c0, c1), across[-1])
        kernels, steps = bank[0][slot[b], 3 * first : 3 * (first + size)], bank[1][b, slot[b]]
        k0, k1, k2 = kernels[:size], kernels[size : 2 * size], kernels[2 * size :]
        t0, t1, t2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for n in range(size):
            pixel = np.float32(pixels[n]) - level
            t0 += np.float32(k0[n]) * pixel
            t1 += np.float32(k1[n]) * pixel
            t2 += np.float32(k2[n]) * pixel
        out[b, 0], out[b, 1], out[b, 2] = steps[0] * t0, steps[1] * t1, steps[2] * t2
    return out
