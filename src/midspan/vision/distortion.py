"""The two lens models of OpenCV as compiled arithmetic: where a ray falls on the picture, and back.

Rays are (x, y) on the plane at distance 1 before the camera; the lens moves them to (x, y) as a picture shows them.
Twelve coefficients stand for every model. Pinhole: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, rational radial terms,
tangential terms and thin prism (Weng, Cohen and Herniou 1992, doi 10.1109/34.159901). Fisheye: k1 … k4 and zeros
(Kannala and Brandt 2006, doi 10.1109/TPAMI.2006.153).
"""

import math

import numpy as np
from numba import njit

from midspan.records import Floats

COEFFICIENTS = 12
# Rays further from the axis than this are not given a place on a plane: 85°.
STEEPEST = math.tan(math.radians(85.0))
_CLOSE = 1e-13


def radial_limit(k: Floats, fisheye: bool) -> float:
    """Largest distance of a ray from the axis (on the plane at 1) up to which the model's radius still grows.

    k: the twelve coefficients. Beyond it two rays fall on one place of the picture, so nothing can be said there.
    """
    if fisheye:
        # d(theta_d)/d(theta) as a polynomial in theta²
        slope = np.polynomial.Polynomial([1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]])
        angle = math.sqrt(_first_root(slope))
        return min(math.tan(angle), STEEPEST) if angle < 0.5 * math.pi else STEEPEST
    # r N / D as functions of u = r²; its slope changes sign where (N + 2 u N') D = 2 u N D'
    above = np.polynomial.Polynomial([1.0, k[0], k[1], k[4]])
    below = np.polynomial.Polynomial([1.0, k[5], k[6], k[7]])
    twice = np.polynomial.Polynomial([0.0, 2.0])
    slope = (above + twice * above.deriv()) * below - twice * above * below.deriv()
    return min(math.sqrt(min(_first_root(slope), _first_root(below))), STEEPEST)


def _first_root(polynomial: "np.polynomial.Polynomial") -> float:
    roots = polynomial.trim().roots()
    real = roots[np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots))].real
    positive = real[real > 0.0]
    return float(positive.min()) if positive.size else math.inf


@njit(cache=True)
def _radial(r, fisheye, k):  # type: ignore[no-untyped-def]
    """Radius on the picture over radius of the ray, and its slope divided by the radius."""
    if fisheye:
        if r < 1e-6:
            return 1.0 + (k[0] - 1.0 / 3.0) * r * r, 2.0 * (k[0] - 1.0 / 3.0)
        angle = math.atan(r)
        u = angle * angle
        bent = angle * (1.0 + u * (k[0] + u * (k[1] + u * (k[2] + u * k[3]))))
        slope = 1.0 + u * (3.0 * k[0] + u * (5.0 * k[1] + u * (7.0 * k[2] + u * 9.0 * k[3])))
        factor = bent / r
        return factor, (slope / (1.0 + r * r) - factor) / (r * r)
    u = r * r
    above, below = 1.0 + u * (k[0] + u * (k[1] + u * k[4])), 1.0 + u * (k[5] + u * (k[6] + u * k[7]))
    above_slope, below_slope = k[0] + u * (2.0 * k[1] + 3.0 * u * k[4]), k[5] + u * (2.0 * k[6] + 3.0 * u * k[7])
    return above / below, 2.0 * (above_slope * below - above * below_slope) / (below * below)


@njit(cache=True)
def bent(x, y, fisheye, k):  # type: ignore[no-untyped-def]
    """Where the ray (x, y) falls, and the four derivatives: xx, xy, yx, yy."""
    u = x * x + y * y
    factor, slope = _radial(math.sqrt(u), fisheye, k)
    if fisheye:
        return x * factor, y * factor, factor + slope * x * x, slope * x * y, slope * x * y, factor + slope * y * y
    p1, p2 = k[2], k[3]
    prism_x, prism_y = k[8] + 2.0 * k[9] * u, k[10] + 2.0 * k[11] * u
    there_x = x * factor + 2.0 * p1 * x * y + p2 * (u + 2.0 * x * x) + u * (k[8] + k[9] * u)
    there_y = y * factor + p1 * (u + 2.0 * y * y) + 2.0 * p2 * x * y + u * (k[10] + k[11] * u)
    across = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    xx = factor + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x + 2.0 * prism_x * x
    yy = factor + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x + 2.0 * prism_y * y
    return there_x, there_y, xx, across + 2.0 * prism_x * y, across + 2.0 * prism_y * x, yy


@njit(cache=True)
def _ray_radius(target, fisheye, k, limit):  # type: ignore[no-untyped-def]
    """The radius whose image is `target`, by Newton steps kept inside a shrinking bracket; -1 where there is none."""
    low, high = 0.0, limit
    if target > limit * _radial(limit, fisheye, k)[0]:
        return -1.0
    r = min(target, limit)
    for _ in range(100):
        factor, slope = _radial(r, fisheye, k)
        off = r * factor - target
        if abs(off) <= _CLOSE * (1.0 + target):
            break
        if off > 0.0:
            high = r
        else:
            low = r
        steepness = factor + slope * r * r
        r = r - off / steepness if steepness > 0.0 else 0.5 * (low + high)
        if not low < r < high:
            r = 0.5 * (low + high)
    return r


@njit(cache=True)
def ray(x, y, fisheye, k, limit):  # type: ignore[no-untyped-def]
    """The ray (x, y) that falls on a place of the picture; NaN where the model has none.

    The radial part is solved alone first; the small rest (tangential, prism) by Newton's method in the plane.
    """
    radius = math.hypot(x, y)
    r = _ray_radius(radius, fisheye, k, limit)
    if r < 0.0:
        return math.nan, math.nan
    to_x, to_y = (x * r / radius, y * r / radius) if radius > 0.0 else (0.0, 0.0)
    for _ in range(20):
        there_x, there_y, xx, xy, yx, yy = bent(to_x, to_y, fisheye, k)
        off_x, off_y, area = there_x - x, there_y - y, xx * yy - xy * yx
        if not area > 0.0 or math.hypot(to_x, to_y) > limit:
            return math.nan, math.nan
        if abs(off_x) + abs(off_y) <= _CLOSE * (1.0 + radius):
            return to_x, to_y
        to_x -= (yy * off_x - xy * off_y) / area
        to_y -= (xx * off_y - yx * off_x) / area
    return math.nan, math.nan


@njit(cache=True)
def straightened(places, matrix, fisheye, k, limit):  # type: ignore[no-untyped-def]
    """Places (n, 2) in px as the picture shows them → (n, 6): place in an ideal pinhole picture, and derivatives.

    matrix: fx, fy, cx, cy in px. Columns: x, y, then dx/dx, dx/dy, dy/dx, dy/dy of the ideal place by the shown one.
    """
    fx, fy, cx, cy = matrix
    out = np.full((len(places), 6), np.nan)
    for i in range(len(places)):
        x, y = ray((places[i, 0] - cx) / fx, (places[i, 1] - cy) / fy, fisheye, k, limit)
        if not math.isfinite(x):
            continue
        _, _, xx, xy, yx, yy = bent(x, y, fisheye, k)
        area = xx * yy - xy * yx
        out[i, 0], out[i, 1] = fx * x + cx, fy * y + cy
        out[i, 2], out[i, 5] = yy / area, xx / area
        out[i, 3], out[i, 4] = -xy / area * fx / fy, -yx / area * fy / fx
    return out


@njit(cache=True)
def shown(places, matrix, fisheye, k, limit):  # type: ignore[no-untyped-def]
    """Places (n, 2) in px of an ideal pinhole picture → (n, 6): where the real picture shows them, and derivatives."""
    fx, fy, cx, cy = matrix
    out = np.full((len(places), 6), np.nan)
    for i in range(len(places)):
        x, y = (places[i, 0] - cx) / fx, (places[i, 1] - cy) / fy
        if not math.hypot(x, y) <= limit:
            continue
        there_x, there_y, xx, xy, yx, yy = bent(x, y, fisheye, k)
        out[i, 0], out[i, 1] = fx * there_x + cx, fy * there_y + cy
        out[i, 2], out[i, 3], out[i, 4], out[i, 5] = xx, xy * fx / fy, yx * fy / fx, yy
    return out
