"""A sensor of first order, the rival of one that averages: both weaken fast motion, and the first delays it too.

    mean over T       1 − (ω T)²/24 + …
    first order τ     1/(1 + jω τ) = exp(−jω τ) (1 − (ω τ)²/2 + j (ω τ)³/3 + …)

With τ² = T²/12, and its delay of slow motion taken for a clock offset, it does the same but for the third power. Motion
that does not tell the two apart tells no exposure: an accelerometer that errs in proportion to its motion (its gain, an
attitude that follows, a lever arm) leaves the same slope.
"""

from dataclasses import replace

import numpy as np

from midspan.calibration.fit import Fit, Pair, best_corner, refine
from midspan.calibration.minimum import minimum
from midspan.records import Floats

# Time constants that are tried, in that of the same weakening of slow motion, and how well the best is found (share).
SHORTEST, LONGEST, TOLERANCE = 0.3, 1.5, 0.03
# ∫ exp(−u) f(u) du by the points of Gauss and Laguerre: right to 1e-3 up to ω τ = 0.7, where 18 % are left out.
NODES, WEIGHTS = np.polynomial.laguerre.laggauss(12)


def lead_over_first_order(found: Pair, without: Pair, fit: Fit, square_s2: float, *, offset_cost: float = 0.0) -> float:
    """By how much a pair with an exposure is more likely (logarithm) than one with a first-order response instead.

    Each at its best ratio and clock offset. found, without: the pair with and without the exposure; fit: of the first;
    square_s2: T²/24 of the exposure; offset_cost: what a clock offset other than 0 costs, in likelihood.
    """
    found, without = (replace(one, ratio=None, reference=None) for one in (found, without))
    usual_s = float(np.sqrt(2.0 * square_s2))

    def likelihood(pair: Pair, delay_s: float) -> float:
        free = refine(pair, best_corner(pair, fit.offset_s + delay_s, fit.corner), usual_s).likelihood
        return max(free - offset_cost, best_corner(pair, 0.0, fit.corner).likelihood) if offset_cost > 0.0 else free

    def cost(share: float) -> float:
        return -likelihood(behind_first_order(without, share * usual_s), share * usual_s)

    return likelihood(found, 0.0) + cost(minimum(cost, SHORTEST, LONGEST, TOLERANCE))


def behind_first_order(pair: Pair, time_constant_s: float) -> Pair:
    """The pair with the acceleration that a sensor of first order would follow."""
    return replace(pair, samples=_delayed(pair.samples, time_constant_s))


def _delayed(samples: Floats, time_constant_s: float) -> Floats:
    """Samples (n, 3) of which a time constant is the mean delay, exponentially distributed."""
    time_s, value = samples[:, 0], samples[:, 1]
    parts = (w * np.interp(time_s - u * time_constant_s, time_s, value) for u, w in zip(NODES, WEIGHTS, strict=True))
    return np.column_stack((time_s, sum(parts), samples[:, 2:]))
