"""Acceleration to displacement on an even grid, by one family of rules as a finite filter.

All rules are x[k+1] − 2 x[k] + x[k−1] = dt² (beta a[k+1] + (1 − 2 beta) a[k] + beta a[k−1]) (Newmark's family); none
delays. At the frequency f the amplitude is wrong by about (1/12 − beta) (2 pi f dt)²; Numerov's is right to fourth
order.
"""

import numpy as np

from midspan.checks import option, positive, refuse
from midspan.records import Floats

# Numerov: Fox-Goodwin. Trapezoid: the trapezoidal rule twice. Central difference: the second difference of the result
# is the acceleration itself.
RULES = {"numerov": 1.0 / 12.0, "linear": 1.0 / 6.0, "trapezoid": 1.0 / 4.0, "central-difference": 0.0}
# How far the sums that must vanish may be from zero, relative to the sum of magnitudes.
ROUNDING = 1e-9


def weights(rule: str) -> Floats:
    """The three weights (beta, 1 − 2 beta, beta) of the acceleration; `rule` is a name in `RULES`."""
    beta = RULES[option("rule", rule, RULES)]
    return np.array([beta, 1.0 - 2.0 * beta, beta])


def integrating(high_pass: Floats, step_s: float, *, rule: str = "numerov") -> Floats:
    """Filter (n,) from acceleration (m/s²) to displacement (m) that has passed the symmetric `high_pass` (n,), n odd.

    Double integration and high-pass in one: nothing drifts and no large number is formed. The high-pass must have a
    double zero at zero frequency (its taps sum to 0), otherwise the result would not be finite: UsageError.
    """
    p = np.asarray(high_pass, dtype=np.float64)
    size = float(np.sum(np.abs(p)))
    if len(p) % 2 == 0 or np.max(np.abs(p - p[::-1])) > ROUNDING * size or abs(np.sum(p)) > ROUNDING * size:
        raise refuse(
            "high_pass", "an odd number of symmetric taps that sum to 0", f"{len(p)} taps, sum {np.sum(p):.3g}"
        )
    summed = np.concatenate(([0.0], np.cumsum(np.cumsum(p))[:-1]))
    summed = 0.5 * (summed + summed[::-1])
    result: Floats = positive("step_s", step_s, "s") ** 2 * np.convolve(summed, weights(rule), mode="same")
    return result
