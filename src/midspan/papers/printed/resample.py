"""From instants to a grid and back: a local cubic spline through uneven knots, a filter read between its samples."""

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.fusion.methods import SPLINE_FRAMES
from midspan.records import Floats

# The spline of an interval looks at knots at most this many usual steps behind the interval's start.
REACH_STEPS = SPLINE_FRAMES + 1.5
WIDEST = 2 * SPLINE_FRAMES


def local_spline(
    at_s: Floats, knot_s: Floats, value: Floats, longest_s: float, reach_s: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Values (2, n) of local cubic splines through uneven knots, for two channels, and whether an instant has one (n,).

    at_s (n,), knot_s (k,): seconds, increasing; value (k, 2), not finite where a knot does not count; longest_s: the
    longest interval that is bridged; reach_s: how far behind the start of an interval a knot counts. An instant has a
    value where it lies in a bridged interval between two knots that count; elsewhere the values are 0. Each interval
    uses at most four knots on each side of it that count, so its values do not depend on what is further away.
    """
    first, second, bridged = _core.local_spline(
        np.ascontiguousarray(at_s), np.ascontiguousarray(knot_s), value, longest_s, reach_s
    )
    return np.stack((first, second)), bridged


def filtered_at(series: Floats, index: NDArray[np.int64], fraction: Floats, taps: tuple[Floats, Floats]) -> Floats:
    """A filtered series (m,) between its samples: at the fraction `fraction` (m,), 0 to 1, after the sample `index`.

    taps: (filter (n,) from the series to the wanted quantity, filter (n,) from the series to that quantity's second
    derivative times the square of the step), n odd. The quantity runs between two samples as the cubic with these
    second derivatives. Samples half a filter before `index` and half a filter and one after it must exist.
    """
    return _core.filtered_at(np.ascontiguousarray(series), index, np.ascontiguousarray(fraction), *taps)


def spline_reach(knots_ahead: int) -> float:
    """How far, in usual steps behind an interval's start, a spline looks that uses this many knots after the
    interval."""
    return knots_ahead + 1.5


def spline_kernel(knot_step: float, reach: float = REACH_STEPS) -> Floats:
    """The spline's response (n,) to one knot, on a grid of which `knot_step` (at least 1) steps lie between knots.

    reach: how far the spline looks behind the start of an interval, steps between knots.
    """
    half = int(np.ceil((SPLINE_FRAMES + 2) * knot_step))
    knots = np.arange(-WIDEST, WIDEST + 1, dtype=np.float64)
    value = np.repeat(np.where(knots == 0.0, 1.0, 0.0)[:, None], 2, axis=1)
    grid = np.arange(-half, half + 1) / knot_step
    values, _ = local_spline(grid, knots, value, 1.5, reach)
    response: Floats = values[0]
    return response
