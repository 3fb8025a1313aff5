"""From instants to a grid and back: a local cubic spline through uneven knots, a filter read between its samples."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats

# Knots used on each side of an interval. A cubic spline forgets what is k knots away by 0.268 to the power k: 0.5 %.
SIDE = 4
# The spline of an interval looks at knots at most this many usual steps behind the interval's start.
REACH_STEPS = SIDE + 1.5
WIDEST = 2 * SIDE


@njit(cache=True, inline="always")
def _bends(step, slope, first, left, last):  # type: ignore[no-untyped-def]
    """Second derivatives of both channels at the knots `left` and `left + 1` of the spline through first … last.

    step (k,), slope (k, 2): of the intervals after each knot. The tridiagonal system is eliminated from both ends
    towards the interval; over the two end intervals the second derivative is constant.
    """
    h = step[left]
    p, q = 0.0, 0.0
    r0 = r1 = s0 = s1 = 0.0
    for i in range(first + 1, left + 1):
        before, after = step[i - 1], step[i]
        share = before / p if i > first + 1 else -1.0
        p = 2.0 * (before + after) - share * before
        r0 = 6.0 * (slope[i, 0] - slope[i - 1, 0]) - (share * r0 if i > first + 1 else 0.0)
        r1 = 6.0 * (slope[i, 1] - slope[i - 1, 1]) - (share * r1 if i > first + 1 else 0.0)
    for i in range(last - 1, left, -1):
        before, after = step[i - 1], step[i]
        share = after / q if i < last - 1 else -1.0
        q = 2.0 * (before + after) - share * after
        s0 = 6.0 * (slope[i, 0] - slope[i - 1, 0]) - (share * s0 if i < last - 1 else 0.0)
        s1 = 6.0 * (slope[i, 1] - slope[i - 1, 1]) - (share * s1 if i < last - 1 else 0.0)
    if left == first and left + 1 == last:
        return 0.0, 0.0, 0.0, 0.0
    if left == first:
        return s0 / (q + h), s0 / (q + h), s1 / (q + h), s1 / (q + h)
    if left + 1 == last:
        return r0 / (p + h), r0 / (p + h), r1 / (p + h), r1 / (p + h)
    det = p * q - h * h
    return (q * r0 - h * s0) / det, (p * s0 - h * r0) / det, (q * r1 - h * s1) / det, (p * s1 - h * r1) / det


@njit(cache=True, inline="always")
def _used(sound, knot_s, left, reach):  # type: ignore[no-untyped-def]
    """First and last knot that the interval after `left` uses."""
    first, last = left, left + 1
    while first > 0 and left - first < SIDE and sound[first - 1]:
        first -= 1
    while last - left <= SIDE and sound[last] and knot_s[last + 1] <= knot_s[left] + reach:
        last += 1
    return first, last


@njit(cache=True)
def spline_rows(at_s, knot_s, value, limits, rows, good):  # type: ignore[no-untyped-def]
    """Values of local cubic splines through uneven knots, on increasing instants, for two channels.

    at_s (n,), knot_s (k,): seconds, increasing; value (k, 2), not finite where a knot does not count. limits: (longest
    interval that is bridged, reach behind the start of an interval), s. rows (2, n) takes the values, good (n,) whether
    the instant lies in a bridged interval between two knots that count; elsewhere the rows are 0. Each interval uses at
    most four knots on each side of it that count, so its rows do not depend on what is further away.
    """
    longest, reach = limits
    count = len(knot_s)
    step, slope, sound = np.zeros(count), np.zeros((count, 2)), np.zeros(count, dtype=np.bool_)
    for i in range(count - 1):
        step[i] = knot_s[i + 1] - knot_s[i]
        slope[i] = (value[i + 1] - value[i]) / step[i]
        sound[i] = step[i] <= longest and np.isfinite(slope[i, 0]) and np.isfinite(slope[i, 1])
    left, done, n = -1, -2, len(at_s)
    start = b0 = c0 = d0 = b1 = c1 = d1 = 0.0
    for k in range(n):
        # An instant exactly on the last knot belongs to the interval before it.
        while left + 2 < count and knot_s[left + 1] <= at_s[k]:
            left += 1
        good[k] = left >= 0 and sound[left] and at_s[k] <= knot_s[left + 1]
        if not good[k]:
            rows[0, k] = rows[1, k] = 0.0
            continue
        if left != done:
            done, start, h = left, knot_s[left], step[left]
            first, last = _used(sound, knot_s, left, reach)
            m0, n0, m1, n1 = _bends(step, slope, first, left, last)
            b0, b1 = slope[left, 0] - h * (2.0 * m0 + n0) / 6.0, slope[left, 1] - h * (2.0 * m1 + n1) / 6.0
            c0, c1, d0, d1 = 0.5 * m0, 0.5 * m1, (n0 - m0) / (6.0 * h), (n1 - m1) / (6.0 * h)
        t = at_s[k] - start
        rows[0, k] = value[left, 0] + t * (b0 + t * (c0 + t * d0))
        rows[1, k] = value[left, 1] + t * (b1 + t * (c1 + t * d1))


# The sums may be reordered: that lets the processor take several taps at once.
@njit(cache=True, fastmath={"reassoc", "contract"})
def filtered_at(series: Floats, index: NDArray[np.int64], fraction: Floats, taps: tuple[Floats, Floats]) -> Floats:
    """A filtered series (m,) between its samples: at the fraction `fraction` (m,), 0 to 1, after the sample `index`.

    taps: (filter (n,) from the series to the wanted quantity, filter (n,) from the series to that quantity's second
    derivative times the square of the step), n odd. The quantity runs between two samples as the cubic with these
    second derivatives. Samples half a filter before `index` and half a filter and one after it must exist.
    """
    wanted, bend = taps
    half = len(wanted) // 2
    result = np.empty(len(index))
    for i in range(len(index)):
        start = index[i] - half
        h0 = h1 = c0 = c1 = 0.0
        for j in range(len(wanted)):
            s0, s1 = series[start + j], series[start + j + 1]
            h0 += wanted[j] * s0
            h1 += wanted[j] * s1
            c0 += bend[j] * s0
            c1 += bend[j] * s1
        b = fraction[i]
        a = 1.0 - b
        result[i] = a * h0 + b * h1 + ((a * a * a - a) * c0 + (b * b * b - b) * c1) / 6.0
    return result


def spline_reach(knots_ahead: int) -> float:
    """How far, in usual steps behind an interval's start, a spline looks that uses so many knots after the interval."""
    return knots_ahead + 1.5


def spline_kernel(knot_step: float, reach: float = REACH_STEPS) -> Floats:
    """The spline's response (n,) to one knot, on a grid of which `knot_step` (at least 1) steps lie between knots.

    reach: how far the spline looks behind the start of an interval, steps between knots.
    """
    half = int(np.ceil((SIDE + 2) * knot_step))
    knots = np.arange(-WIDEST, WIDEST + 1, dtype=np.float64)
    value = np.repeat(np.where(knots == 0.0, 1.0, 0.0)[:, None], 2, axis=1)
    grid = np.arange(-half, half + 1) / knot_step
    rows, good = np.empty((2, len(grid))), np.empty(len(grid), dtype=np.bool_)
    spline_rows(grid, knots, value, (1.5, reach), rows, good)
    result: Floats = rows[0]
    return result
