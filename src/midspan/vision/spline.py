"""Quintic B-splines on the pixel grid: weights, coefficients, interpolation (Unser, 1999, doi 10.1109/79.799930)."""

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats

Floats32 = NDArray[np.float32]

# The quintic B-spline reaches 3 px to either side; a shift of up to 1 px needs the coefficients at -3 … 3.
REACH = 3
TAPS = 2 * REACH + 1


def quintic(x: float, derivative: int) -> float:
    """Quintic B-spline at `x` (px from its centre), or its first or second derivative."""
    return _core.quintic(x, derivative)


def weights(shift: float, derivative: int) -> Floats:
    """Weights (7,) of the coefficients at -3 … 3 px for a point at `shift` (-1 to 1 px), or their derivative by it."""
    return _core.spline_weights(shift, derivative)


def coefficients(image: Floats) -> Floats:
    """Coefficients (rows, columns) of the quintic spline through `image` (rows, columns), mirrored at its edges."""
    return _core.spline_coefficients(image)


def combine(grid: Floats32, down: Floats, across: Floats) -> Floats32:
    """Filter `grid` (rows + 6, columns + 6) with weights (7,) down and across: (rows, columns)."""
    return _core.combine(grid, down, across)


def translated(grid: Floats32, x: float, y: float) -> Floats32:
    """The spline image moved by x to the right and y down (-1 to 1 px): value at k is the spline at k - (x, y).

    `grid` holds the coefficients with 3 px more on every side than the result.
    """
    return _core.translated(grid, x, y)
