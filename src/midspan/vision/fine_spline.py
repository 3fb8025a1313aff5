"""Quintic B-splines with two coefficients a pixel along each axis: pictures finer than the pixels they are read on.

Coefficient k of a line lies k/2 px from its first pixel, less a margin of four coefficients before and behind.
"""

import numpy as np
from numba import njit

from midspan.records import Floats
from midspan.vision.spline import REACH, Floats32, coefficients, combine, quintic, weights

PER_PX = 2
MARGIN = 4  # coefficients beyond the first and last pixel: the spline's 3, and 1 for a shift of half a pixel
FINE_TAPS = 2 * MARGIN + 1


@njit(cache=True)
def fine_weights(shift: float, derivative: int) -> Floats:
    """Weights (9,) of the coefficients about a pixel for a point `shift` (-0.5 to 0.5 px) after it, or their first
    derivative by it.
    """
    out = np.empty(FINE_TAPS)
    for j in range(FINE_TAPS):
        value = quintic(j - MARGIN - PER_PX * shift, derivative)
        out[j] = value if derivative == 0 else -PER_PX * value
    return out


@njit(cache=True, fastmath=True)
def read(grid: Floats32, wy: Floats, wx: Floats) -> Floats32:
    """Values (rows, columns) on the pixels of `grid` (2 rows + 7, 2 columns + 7); weights (9,) wy down, wx across."""
    rows, columns = (grid.shape[0] - FINE_TAPS) // PER_PX + 1, (grid.shape[1] - FINE_TAPS) // PER_PX + 1
    out = np.zeros((rows, columns), dtype=np.float32)
    line = np.empty(grid.shape[1], dtype=np.float32)
    parted = np.empty((PER_PX, grid.shape[1] // PER_PX + 1), dtype=np.float32)
    for r in range(rows):
        line[:] = np.float32(0.0)
        for j in range(FINE_TAPS):
            w = np.float32(wy[j])
            if w != 0:
                for c in range(grid.shape[1]):
                    line[c] += w * grid[PER_PX * r + j, c]
        for c in range(grid.shape[1]):
            parted[c % PER_PX, c // PER_PX] = line[c]
        for i in range(FINE_TAPS):
            w, part = np.float32(wx[i]), parted[i % PER_PX]
            start = i // PER_PX
            for c in range(columns):
                out[r, c] += w * part[start + c]
    return out


@njit(cache=True, fastmath=True)
def spread(pixels: Floats32, wy: Floats, wx: Floats, out: Floats32) -> None:
    """Add to the coefficients `out` what `read` would take from each to `pixels` (rows, columns): its transpose."""
    rows, columns = pixels.shape
    line = np.empty(out.shape[1], dtype=np.float32)
    parted = np.empty((PER_PX, out.shape[1] // PER_PX + 1), dtype=np.float32)
    for r in range(rows):
        parted[:] = np.float32(0.0)
        for i in range(FINE_TAPS):
            w, part = np.float32(wx[i]), parted[i % PER_PX]
            start = i // PER_PX
            for c in range(columns):
                part[start + c] += w * pixels[r, c]
        for c in range(out.shape[1]):
            line[c] = parted[c % PER_PX, c // PER_PX]
        for j in range(FINE_TAPS):
            w = np.float32(wy[j])
            if w != 0:
                for c in range(out.shape[1]):
                    out[PER_PX * r + j, c] += w * line[c]


@njit(cache=True)
def planes(grid: Floats32, x: float, y: float) -> Floats32:
    """Values and slopes along x and y (3, rows, columns) of the spline image moved by (x, y) px, each -0.5 to 0.5."""
    wx, wy = fine_weights(-x, 0), fine_weights(-y, 0)
    value = read(grid, wy, wx)
    out = np.empty((3, *value.shape), dtype=np.float32)
    out[0] = value
    out[1] = read(grid, wy, fine_weights(-x, 1))
    out[2] = read(grid, fine_weights(-y, 1), wx)
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
