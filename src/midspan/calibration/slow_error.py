"""The slow error of a displacement sensor: noise that is correlated over seconds, as that of a GNSS receiver.

It is taken as a first-order Gauss-Markov process together with the white noise, with the variance of the largest
likelihood of the innovations. A record mostly shows only how fast the error drifts, variance over correlation time:
what is slower than the frequency at which the accelerometer's noise exceeds the sensor's looks like the motion's own
start. So the variance is the mean over all correlation times, each weighed by its likelihood.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from midspan.calibration.fit import Fit, Pair, aligned, best_corner, corner_range
from midspan.calibration.whitening import NO_SLOW_ERROR
from midspan.records import Floats

# Correlation times from so many intervals of the measurements up to this share of the record; how many are tried.
SHORTEST_INTERVALS, LONGEST_SHARE, TIMES_TRIED = 2.0, 0.5, 8
# Logarithm of the slow error's variance in units of the noise variance: its range.
VARIANCES = (-7.0, 14.0)
# Logarithms and the likelihood are found to this, by first steps of so much; so many trials at most.
TOLERANCE, STEP, TRIALS = 0.05, 0.5, 80


def with_slow_error(pair: Pair, fit: Fit, time_s: float | None = None) -> tuple[Pair, Fit]:
    """The pair with the most likely slow error of its measurements, and the fit; time_s: its correlation time if known.

    Without one the noise stays white unless the slow error gains more than two parameters cost that tell nothing (as in
    `fit.with_input_noise`).
    """
    white = replace(pair, slow=NO_SLOW_ERROR)
    here = aligned(white, fit.offset_s)
    rows = here.rows[:, 0]
    shortest = SHORTEST_INTERVALS / pair.rate_hz
    longest = max(LONGEST_SHARE * float(rows[-1] - rows[0]), 2.0 * shortest)
    times = np.geomspace(shortest, longest, TIMES_TRIED) if time_s is None else np.array([time_s])
    corners = np.log(corner_range(pair))
    found: list[tuple[float, float]] = []
    start = np.array([np.log(fit.corner), 0.0])
    for lasting in times:

        def fitted(at: Floats, lasting: float = lasting) -> Fit:
            own = replace(white, slow=(float(np.exp(np.clip(at[1], *VARIANCES))), 1.0 / lasting))
            return replace(here, pair=own).fit(float(np.exp(np.clip(at[0], *corners))))

        simplex = start + STEP * np.array([[0.0, 0.0], [-1.0, 0.0], [0.0, 1.0]])
        options = {"xatol": TOLERANCE, "fatol": TOLERANCE, "maxfev": TRIALS, "initial_simplex": simplex}
        best = minimize(lambda at, of=fitted: -of(at).likelihood, start, method="Nelder-Mead", options=options)
        found.append((-best.fun, float(np.exp(np.clip(best.x[1], *VARIANCES)))))
        start = best.x
    likelihood, variance = np.array(found).T
    if time_s is None and likelihood.max() - here.fit(fit.corner).likelihood < np.log(max(len(rows), 1)):
        return white, fit
    weight = np.exp(likelihood - likelihood.max())
    mean = float(np.average(variance, weights=weight))
    slow = replace(pair, slow=(mean, float(np.average(variance / times, weights=weight)) / mean))
    return slow, best_corner(slow, fit.offset_s)
