"""The minimum of a function of one number: scipy.optimize takes longer to import than a calibration to be checked."""

import math
from collections.abc import Callable

import numpy as np

# The smaller part of the golden section.
GOLDEN = 0.5 * (3.0 - math.sqrt(5.0))
# A step shorter than this share of the place changes the function by no more than rounding.
MIN_SHARE = math.sqrt(2.2e-16)
MAX_STEPS = 500


def global_minimum(cost: Callable[[float], float], low: float, high: float, *, tried: int, tolerance: float) -> float:
    """Where a function that may have several minima is least: between the neighbours of the best of `tried` places."""
    places = np.linspace(low, high, tried)
    k = int(np.argmin([cost(float(place)) for place in places]))
    return minimum(cost, float(places[max(k - 1, 0)]), float(places[min(k + 1, tried - 1)]), tolerance)


def minimum(cost: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Where `cost` is least between two bounds, to a tolerance: parabolas, and golden sections where they fail.

    R. P. Brent, Algorithms for Minimization without Derivatives, Prentice-Hall 1973, chapter 5.
    """
    best = second = third = low + GOLDEN * (high - low)
    at_best = at_second = at_third = cost(best)
    step = before = 0.0
    for _ in range(MAX_STEPS - 1):
        middle, least = 0.5 * (low + high), MIN_SHARE * abs(best) + tolerance / 3.0
        if abs(best - middle) <= 2.0 * least - 0.5 * (high - low):
            break
        last, before = before, step
        fitted = None
        if abs(last) > least:
            fitted = _vertex((best, at_best), (second, at_second), (third, at_third), (low, high), last)
        if fitted is None:
            before = (low if best >= middle else high) - best
            step = GOLDEN * before
        else:
            step = fitted
            if best + step - low < 2.0 * least or high - (best + step) < 2.0 * least:
                step = math.copysign(least, middle - best)
        tried = best + math.copysign(max(abs(step), least), step)
        at_tried = cost(tried)
        if at_tried <= at_best:
            low, high = (best, high) if tried >= best else (low, best)
            third, at_third, second, at_second, best, at_best = second, at_second, best, at_best, tried, at_tried
            continue
        low, high = (tried, high) if tried < best else (low, tried)
        if at_tried <= at_second or second == best:
            third, at_third, second, at_second = second, at_second, tried, at_tried
        elif at_tried <= at_third or third in (best, second):
            third, at_third = tried, at_tried
    return best


def _vertex(
    best: tuple[float, float],
    second: tuple[float, float],
    third: tuple[float, float],
    bounds: tuple[float, float],
    last: float,
) -> float | None:
    """The step from the best point to the vertex of the parabola through three; None where it is not to be trusted."""
    (x, fx), (w, fw), (v, fv) = best, second, third
    r, q = (x - w) * (fx - fv), (x - v) * (fx - fw)
    p = (x - v) * q - (x - w) * r
    q = 2.0 * (q - r)
    if q > 0.0:
        p = -p
    q = abs(q)
    if abs(p) < abs(0.5 * q * last) and q * (bounds[0] - x) < p < q * (bounds[1] - x):
        return p / q
    return None
