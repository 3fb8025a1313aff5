"""A scale factor that changes while it is measured: an accelerometer that warms up, a gain that is switched.

One factor is fitted to the whole record. Where it changes slowly by a share g(t), the innovations hold that share of
the motion: s g(t) D(t). So g is a regression of the innovations on the whitened products of the response and Legendre's
polynomials of time. What else is in the innovations (a mast that nods) is coloured: the covariance of the coefficients
is that of sums over blocks of time, which holds whatever the colour (W. K. Newey, K. D. West, Econometrica 55 (1987)
703-708, doi 10.2307/1913610).
"""

from functools import partial

import numpy as np

from midspan.calibration.fit import Fit, Pair, aligned
from midspan.notices import Notice
from midspan.records import Floats

# Polynomials up to this order follow a warm-up of a tenth of the record to a fifth of its size.
ORDER = 3
# A bias that drifts meanwhile is in the displacement by these orders; the lower ones are open anyway.
BIAS_ORDERS = range(4, 9)
# Blocks of time whose sums are taken as independent.
BLOCKS = 24
# A scale that does not change seems to with this probability; and a change of less than this is of no importance.
BY_CHANCE, MIN_CHANGE = 1e-4, 1e-3
# Instants at which the course is looked at.
GRID = 100


def gain_drift(pair: Pair, fit: Fit) -> float:
    """How far apart scale factors lie in the course of a record, relative; 0: that may be chance."""
    from scipy.stats import f

    time_s = pair.rows[:, 0] + fit.offset_s
    middle, half = 0.5 * (time_s[0] + time_s[-1]), 0.5 * float(time_s[-1] - time_s[0])

    def course(order: int, at_s: Floats) -> Floats:
        return np.asarray(np.polynomial.Legendre.basis(order)((at_s - middle) / half))

    def product(at_s: Floats, order: int) -> Floats:
        return np.asarray(pair.responses[0].at(at_s, pair.exposure_s, pair.logger) * course(order, at_s))

    drifts = [partial(course, k) for k in BIAS_ORDERS]
    here = aligned(pair, fit.offset_s, *drifts, *(partial(product, order=k) for k in range(1, ORDER + 1)))
    w = here.whitened(fit.corner)
    standard = w.columns / np.sqrt(w.variance)[:, None]
    left = standard[:, :1] - fit.ratio * standard[:, 1:2]
    if len(left) < 2 * BLOCKS:
        return 0.0
    others = np.column_stack((standard[:, 1], standard[:, -ORDER - len(drifts) : -ORDER]))
    both = np.column_stack((fit.ratio * standard[:, -ORDER:], left))
    both -= others @ np.linalg.lstsq(others, both, rcond=None)[0]
    columns, left = both[:, :-1], both[:, -1:]
    inverse = np.linalg.pinv(columns.T @ columns, hermitian=True)
    size = inverse @ (columns.T @ left)
    parts = np.array([np.sum(one, axis=0) for one in np.array_split(columns * (left - columns @ size), BLOCKS)])
    covariance = inverse @ (parts.T @ parts) @ inverse * BLOCKS / (BLOCKS - ORDER)
    chi = float((size.T @ np.linalg.pinv(covariance, hermitian=True) @ size).item())
    # Of a covariance from a few blocks, as Hotelling's.
    free = BLOCKS - ORDER
    if chi * free / (ORDER * (BLOCKS - 1.0)) < f.isf(BY_CHANCE, ORDER, free):
        return 0.0
    courses = np.stack([course(k, np.linspace(middle - half, middle + half, GRID)) for k in range(1, ORDER + 1)])
    most = float(np.ptp(size[:, 0] @ courses))
    return most if most > MIN_CHANGE else 0.0


def drift_text(sensor: str, most: float) -> list[Notice]:
    """A sentence on a scale factor that changes, by so much (relative)."""
    text = (
        f"{sensor}: its scale factor relative to the accelerometer changes by {100.0 * most:.2g} % during the record, "
        "as during accelerometer warm-up. The error band includes the mean change; the first rows may be worse. Let "
        "the accelerometer warm up for some minutes before recording."
    )
    return [Notice("gain-drifts", text)] if most > 0.0 else []
