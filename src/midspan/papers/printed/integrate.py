"""Acceleration to displacement on an even grid by the trapezoidal rule twice, as a finite filter.

x[k+1] − 2 x[k] + x[k−1] = dt² (a[k+1] + 2 a[k] + a[k−1]) / 4; it does not delay. At the frequency f the amplitude is
too small by about (2 pi f dt)² / 6.
"""

import numpy as np

from midspan.checks import positive, refuse
from midspan.records import Floats

TRAPEZOID = np.array([0.25, 0.5, 0.25])
# How far the sums that must vanish may be from zero, relative to the sum of magnitudes.
ROUNDING = 1e-9


def integrating(high_pass: Floats, step_s: float) -> Floats:
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
    result: Floats = positive("step_s", step_s, "s") ** 2 * np.convolve(summed, TRAPEZOID, mode="same")
    return result
