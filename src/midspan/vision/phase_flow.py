"""Phase-based optical flow: local phase, its change since the reference, its slope, and translation in gradient form.

Equations 1 to 4 of the paper on hybrid phase and feature matching; the gradient form is that of Chen and others.
"""

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats
from midspan.vision.spline import Floats32
from midspan.vision.steerable import Complex64

SMALLEST_SLOPE = 0.1  # rad/px: below it the gradient form would divide by next to nothing


def phase_change(now: tuple[Floats32, Floats32], reference: Complex64, index: NDArray[np.int64]) -> Floats32:
    """Phase of the responses `now` (even, odd: rows, columns) less the reference's at the pixels `index`: (k,) rad.

    `reference` (k,) are the reference's responses there. The angle of the complex product lies in -π … π by itself;
    a difference of two angles would not.
    """
    here = (now[0] + 1j * now[1]).ravel()[index]
    return np.asarray(np.angle(here * np.conj(reference)), dtype=np.float32)


def phase_slopes(field: Complex64) -> tuple[Floats, Floats]:
    """Slope of the local phase along x and y, rad/px, of responses (rows + 2, columns + 2): two arrays (rows, columns).

    The mean of the steps to the neighbours on either side, each unwrapped by itself: good up to half a cycle a px.
    """
    across = np.angle(field[1:-1, 1:] * np.conj(field[1:-1, :-1]))
    down = np.angle(field[1:, 1:-1] * np.conj(field[:-1, 1:-1]))
    x, y = 0.5 * (across[:, 1:] + across[:, :-1]), 0.5 * (down[1:] + down[:-1])
    return x.astype(np.float64), y.astype(np.float64)


def phase_curvatures(field: Complex64) -> tuple[Floats, Floats, Floats]:
    """Second derivatives xx, yy, xy of the local phase, rad/px², of responses (rows + 2, columns + 2): (rows, columns).

    Differences of neighbours as complex products, as in `phase_slopes`.
    """
    middle = field[1:-1, 1:-1]
    x = np.angle(field[1:-1, 2:] * np.conj(middle) * field[1:-1, :-2] * np.conj(middle))
    y = np.angle(field[2:, 1:-1] * np.conj(middle) * field[:-2, 1:-1] * np.conj(middle))
    xy = 0.25 * np.angle(field[2:, 2:] * np.conj(field[2:, :-2]) * np.conj(field[:-2, 2:]) * field[:-2, :-2])
    return x.astype(np.float64), y.astype(np.float64), xy.astype(np.float64)


def gradient_form(change: Floats32, slope: Floats, smallest_slope: float = SMALLEST_SLOPE) -> float:
    """Translation in px as the mean of -change / slope over the pixels (k,): equation 3 without its scale factor.

    `change` in rad, `slope` of the current frame's phase along the axis in rad/px; pixels with next to no slope are
    left out (below `smallest_slope`, rad/px; the equation has no such limit: 0). NaN without any.
    """
    steep = np.abs(slope) >= max(smallest_slope, 1e-300)
    if not steep.any():
        return float("nan")
    return float(np.mean(-change[steep].astype(np.float64) / slope[steep]))
