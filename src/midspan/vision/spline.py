"""Quintic B-splines on the pixel grid: weights, coefficients, interpolation (Unser, 1999, doi 10.1109/79.799930)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats

Floats32 = NDArray[np.float32]

# The quintic B-spline reaches 3 px to either side; a shift of up to 1 px needs the coefficients at -3 … 3.
REACH = 3
TAPS = 2 * REACH + 1


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
def weights(shift: float, derivative: int) -> Floats:
    """Weights (7,) of the coefficients at -3 … 3 px for a point at `shift` (-1 to 1 px), or their derivative by it."""
    w = np.empty(TAPS)
    sign = -1.0 if derivative == 1 else 1.0
    for j in range(TAPS):
        w[j] = sign * quintic(j - REACH - shift, derivative)
    return w


def coefficients(image: Floats) -> Floats:
    """Coefficients (rows, columns) of the quintic spline through `image` (rows, columns), mirrored at its edges."""
    from scipy.ndimage import spline_filter

    return np.asarray(spline_filter(image, order=5, output=np.float64, mode="mirror"), dtype=np.float64)


@njit(cache=True, fastmath=True)
def combine(grid: Floats32, wy: Floats, wx: Floats) -> Floats32:
    """Filter `grid` (rows + 6, columns + 6) with weights wy (7,) down and wx (7,) across: (rows, columns)."""
    rows, columns = grid.shape[0] - 2 * REACH, grid.shape[1] - 2 * REACH
    down, across = wy.astype(np.float32), wx.astype(np.float32)
    out, line = np.empty((rows, columns), dtype=np.float32), np.empty(grid.shape[1], dtype=np.float32)
    for r in range(rows):
        # Sums that are not stored in between: the compiler takes several pixels at once.
        for c in range(len(line)):
            total = np.float32(0.0)
            for j in range(TAPS):
                total += down[j] * grid[r + j, c]
            line[c] = total
        for c in range(columns):
            total = np.float32(0.0)
            for i in range(TAPS):
                total += across[i] * line[c + i]
            out[r, c] = total
    return out


@njit(cache=True)
def translated(grid: Floats32, x: float, y: float) -> Floats32:
    """The spline image moved by x to the right and y down (-1 to 1 px): value at k is the spline at k - (x, y).

    `grid` holds the coefficients with 3 px more on every side than the result.
    """
    return combine(grid, weights(-y, 0), weights(-x, 0))
