"""From instants to a grid and back: a local cubic spline through uneven knots, a filter read between its samples."""

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats


def local_spline(
    at_s: Floats, knot_s: Floats, value: Floats, longest_s: float, reach_s: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Values (n,) of local cubic splines through uneven knots, and whether an instant has one (n,).

    at_s (n,), knot_s (k,): seconds, increasing; value (k,), not finite where a knot does not count; longest_s: the
    longest interval that is bridged; reach_s: how far behind the start of an interval a knot counts. An instant has a
    value where it lies in a bridged interval between two knots that count; elsewhere the values are 0. Each interval
    uses at most four knots on each side of it that count, so its values do not depend on what is further away.
    """
    return _core.local_spline(
        np.ascontiguousarray(at_s), np.ascontiguousarray(knot_s), np.ascontiguousarray(value), longest_s, reach_s
    )


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
