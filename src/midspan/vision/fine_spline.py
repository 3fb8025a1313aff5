"""Quintic B-splines with two coefficients a pixel along each axis: pictures finer than the pixels they are read on.

Coefficient k of a line lies k/2 px from its first pixel, less a margin of four coefficients before and behind.
"""

import numpy as np
from numba import njit

from midspan.records import Floats
from midspan.vision.spline import REACH, Floats32, coefficients, combine, weights

PER_PX = 2
MARGIN = 4  # coefficients beyond the first and last pixel: the spline's 3, and 1 for a shift of half a pixel
FINE_TAPS = 2 * MARGIN + 1


@njit(cache=True)
def quintic(x: float, derivative: int) -> float:
    """Quintic B-spline at `x` (px from its centre), or its first or second derivative, from truncated powers."""
    power = 5 - derivative
    total = 0.0
    binomial = 1.0
    for k in range(7):
        base = x + 3.0 - k
        if base > 0.0:
            total += binomial * base**power
        binomial *= -(6.0 - k) / (k + 1.0)
    scale = 120.0 if derivative == 0 else (24.0 if derivative == 1 else 6.0)
    return float(total / scale)


@njit(cache=True)
def fine_weights(shift: float, derivative: int) -> Floats:
    """Weights (9,) of the coefficients about a pixel for a point `shift` (-0.5 to 0.5 px) after it, or their first or
    second derivative by it.
    """
    out = np.empty(FINE_TAPS)
    for j in range(FINE_TAPS):
        out[j] = (-PER_PX) ** derivative * quintic(j - MARGIN - PER_PX * shift, derivative)
    return out


@njit(cache=True, fastmath=True)
def _down(grid: Floats32, row: int, wy: Floats32, line: Floats32) -> None:
    """Fill `line` with the sums of nine rows of `grid` from `row` on, each times its weight."""
    for c in range(len(line)):
        total = np.float32(0.0)
        for j in range(FINE_TAPS):
            total += wy[j] * grid[row + j, c]
        line[c] = total


@njit(cache=True, fastmath=True)
def _across(line: Floats32, wx: Floats32, out: Floats32) -> None:
    """Fill `out` with the weighted sums of nine values of `line` about each pixel."""
    for c in range(len(out)):
        total = np.float32(0.0)
        for i in range(FINE_TAPS):
            total += wx[i] * line[PER_PX * c + i]
        out[c] = total


@njit(cache=True)
def _pixels(grid: Floats32) -> tuple[int, int]:
    """How many rows and columns of pixels lie on the coefficients."""
    return (grid.shape[0] - FINE_TAPS) // PER_PX + 1, (grid.shape[1] - FINE_TAPS) // PER_PX + 1


@njit(cache=True)
def read(grid: Floats32, wy: Floats, wx: Floats) -> Floats32:
    """Values (rows, columns) on the pixels of `grid` (2 rows + 7, 2 columns + 7); weights (9,) wy down, wx across."""
    down, across = wy.astype(np.float32), wx.astype(np.float32)
    out, line = np.empty(_pixels(grid), dtype=np.float32), np.empty(grid.shape[1], dtype=np.float32)
    for r in range(len(out)):
        _down(grid, PER_PX * r, down, line)
        _across(line, across, out[r])
    return out


@njit(cache=True, fastmath=True)
def spread(pixels: Floats32, wy: Floats, wx: Floats, out: Floats32) -> None:
    """Add to the coefficients `out` what `read` would take from each to `pixels` (rows, columns): its transpose."""
    rows, columns = pixels.shape
    reach = FINE_TAPS // PER_PX
    # A tenth weight of 0 and lines of 0 around the pixels: even and odd coefficients then have sums of equal length.
    down, across = np.zeros(FINE_TAPS + 1, dtype=np.float32), np.zeros(FINE_TAPS + 1, dtype=np.float32)
    down[:FINE_TAPS], across[:FINE_TAPS] = wy, wx
    line = np.zeros(columns + 2 * reach, dtype=np.float32)
    lines = np.zeros((rows + 2 * reach, PER_PX * (columns + reach)), dtype=np.float32)
    for r in range(rows):
        line[reach : reach + columns] = pixels[r]
        for k in range(columns + reach):
            even, odd = np.float32(0.0), np.float32(0.0)
            for m in range(reach + 1):
                even += across[PER_PX * m] * line[k + reach - m]
                odd += across[PER_PX * m + 1] * line[k + reach - m]
            lines[r + reach, PER_PX * k], lines[r + reach, PER_PX * k + 1] = even, odd
    for r in range(out.shape[0]):
        half, part = divmod(r, PER_PX)
        for c in range(out.shape[1]):
            total = np.float32(0.0)
            for m in range(reach + 1):
                total += down[PER_PX * m + part] * lines[half + reach - m, c]
            out[r, c] += total


@njit(cache=True)
def planes(grid: Floats32, x: float, y: float) -> Floats32:
    """Values and slopes along x and y (3, rows, columns) of the spline image moved by (x, y) px, each -0.5 to 0.5."""
    wx, wy = fine_weights(-x, 0).astype(np.float32), fine_weights(-y, 0).astype(np.float32)
    slope_x, slope_y = fine_weights(-x, 1).astype(np.float32), fine_weights(-y, 1).astype(np.float32)
    rows, columns = _pixels(grid)
    out, line = np.empty((3, rows, columns), dtype=np.float32), np.empty(grid.shape[1], dtype=np.float32)
    for r in range(rows):
        _down(grid, PER_PX * r, wy, line)
        _across(line, wx, out[0, r])
        _across(line, slope_x, out[1, r])
        _down(grid, PER_PX * r, slope_y, line)
        _across(line, wx, out[2, r])
    return out


@njit(cache=True)
def curvatures(grid: Floats32, x: float, y: float) -> Floats32:
    """Second derivatives along x, along x and y, and along y (3, rows, columns) of the image that `planes` gives."""
    down, across = np.empty((3, FINE_TAPS), dtype=np.float32), np.empty((3, FINE_TAPS), dtype=np.float32)
    for d in range(3):
        down[d], across[d] = fine_weights(-y, d), fine_weights(-x, d)
    rows, columns = _pixels(grid)
    out, line = np.empty((3, rows, columns), dtype=np.float32), np.empty(grid.shape[1], dtype=np.float32)
    for r in range(rows):
        for d in range(3):
            _down(grid, PER_PX * r, down[d], line)
            _across(line, across[2 - d], out[d, r])
    return out


def refined(image: Floats) -> Floats32:
    """Coefficients (2 rows + 7, 2 columns + 7) that continue the one-per-pixel spline of `image` (rows, columns)."""
    around = REACH + MARGIN // PER_PX + 2
    # Mirrored as the spline itself is, so that the samples beyond the edge are the spline's own.
    grid = coefficients(np.pad(image, around, mode="reflect")).astype(np.float32)
    rows, columns = (size - 2 * REACH for size in grid.shape)
    samples = np.empty((PER_PX * rows, PER_PX * columns))
    for j in range(PER_PX):
        for i in range(PER_PX):
            samples[j::PER_PX, i::PER_PX] = combine(grid, weights(j / PER_PX, 0), weights(i / PER_PX, 0))
    skip = PER_PX * (around - REACH) - MARGIN
    fine = coefficients(samples)
    return np.ascontiguousarray(
        fine[skip : skip + PER_PX * image.shape[0] + 7, skip : skip + PER_PX * image.shape[1] + 7], dtype=np.float32
    )
