"""The slow error of a displacement sensor: noise that is correlated over seconds, as that of a GNSS receiver.

It is modelled as a first-order Gauss-Markov process together with the white noise. A record mostly shows only how fast
the error drifts, variance over correlation time: what is slower than the frequency at which the accelerometer's noise
exceeds the sensor's looks like the motion's own start. So variance and time are not the most likely ones but means over
all of them, each weighed by its likelihood, with an even prior of the standard deviation and of the time. What a record
cannot exclude is reported where it is not taken into account.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.fit import Fit, Pair, aligned, best_corner, best_corner_here
from midspan.calibration.whitening import NO_SLOW_ERROR
from midspan.records import Floats

# Correlation times: the shortest in intervals of the measurements, the longest as a share of the record, how many are
# tried.
MIN_INTERVALS, MAX_SHARE, TIMES_TRIED = 2.0, 0.5, 8
# Standard deviations in units of the white noise: the smallest tried, the factor to the next one, the largest.
SMALLEST, FACTOR, LARGEST = 0.1, 1.6, 1000.0
# Larger ones are not tried where the likelihood (logarithm) has fallen by this from its largest value.
FALLEN = 12.0
# What a record does not exclude with 99 %, by the ratio of likelihoods: half the chi-square of one degree of freedom.
NOT_EXCLUDED = 3.32
# A drift that does not show is reported for this time, s.
DRIFT_S = 10.0


@dataclass(frozen=True, slots=True)
class SlowError:
    """The pair with the slow error of its measurements, and its fit.

    unseen: how far a slow error that is left out may drift in DRIFT_S (standard deviation, in the translation's unit)
    without the record showing it; 0 where one is taken into account or there is none.
    """

    pair: Pair
    fit: Fit
    unseen: float = 0.0


def find_slow_error(pair: Pair, fit: Fit, time_s: float | None = None) -> SlowError:
    """The slow error of the measurements; time_s: its correlation time where that is known, 0: there is none.

    Without one the noise stays white unless the slow error gains more likelihood than a parameter without effect would
    (as in `fit.with_input_noise`).
    """
    white = replace(pair, slow=NO_SLOW_ERROR)
    if time_s == 0.0:
        return SlowError(white, fit)
    rows = pair.rows[pair.used(fit.offset_s), 0]
    shortest = MIN_INTERVALS / pair.rate_hz
    longest = max(MAX_SHARE * float(rows[-1] - rows[0]), 2.0 * shortest)
    times = np.geomspace(shortest, longest, TIMES_TRIED) if time_s is None else np.array([time_s])
    tried = [_along(white, fit, float(lasting)) for lasting in times]
    best = max(float(np.max(one.likelihood)) for one in tried)
    none = aligned(white, fit.offset_s).fit(fit.corner).likelihood
    if time_s is None and best - none < 0.5 * np.log(max(len(rows), 1)):
        return SlowError(white, fit, tried[-1].unseen(longest))
    # Sums over standard deviations and times, each for the width of its part of the scale.
    weights = [t * one.width * np.exp(one.likelihood - best) for t, one in zip(times, tried, strict=True)]
    moments = [float(np.sum(weight * one.std**2)) for weight, one in zip(weights, tried, strict=True)]
    white_moment = sum(float(np.sum(weight * one.noise)) for weight, one in zip(weights, tried, strict=True))
    rate = sum(moment / lasting for moment, lasting in zip(moments, times, strict=True)) / sum(moments)
    slow = replace(pair, slow=(sum(moments) / white_moment, float(rate)))
    return SlowError(slow, best_corner(slow, fit.offset_s))


@dataclass(frozen=True, slots=True)
class _Along:
    """Slow errors of one correlation time: standard deviation (k,), variance (k,) of the white noise with it, in the
    translation's unit, and the logarithm of their likelihood (k,).
    """

    std: Floats
    noise: Floats
    likelihood: Floats

    @property
    def width(self) -> Floats:
        """The part (k,) of the standard deviation's scale that each stands for."""
        return np.maximum(np.gradient(self.std), 0.0)

    def unseen(self, lasting_s: float) -> float:
        """How far a slow error may drift in DRIFT_S without showing."""
        enough = np.max(self.likelihood) - NOT_EXCLUDED
        last = int(np.flatnonzero(self.likelihood >= enough)[-1])
        if last + 1 == len(self.std):
            return float("inf")
        share = (self.likelihood[last] - enough) / (self.likelihood[last] - self.likelihood[last + 1])
        largest = self.std[last] * (self.std[last + 1] / self.std[last]) ** share
        return float(largest * np.sqrt(-2.0 * np.expm1(-DRIFT_S / lasting_s)))


def _along(white: Pair, fit: Fit, lasting_s: float) -> _Along:
    """Slow errors of a correlation time, from small to those that the record excludes."""
    here, found, best = aligned(white, fit.offset_s), [], -np.inf
    size, corner = SMALLEST, fit.corner
    while size < LARGEST:
        with np.errstate(invalid="ignore"):
            one = best_corner_here(replace(here, pair=replace(white, slow=(size * size, 1.0 / lasting_s))), corner)
        if not np.isfinite(one.likelihood):
            # Its covariance is lost in rounding.
            break
        found.append((size * np.sqrt(one.noise), one.noise, one.likelihood))
        best, corner, size = max(best, one.likelihood), one.corner, FACTOR * size
        if one.likelihood < best - FALLEN:
            break
    return _Along(*np.array(found).T)
