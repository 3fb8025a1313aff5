"""The time over which a displacement sensor averages, where it is not declared.

Averaging over T takes (π f T)²/6 from a motion at f Hz: fast motion comes out smaller than slow motion. A wrong gain is
the same at all frequencies, so that both can be distinguished where the motion has more than one.
"""

from dataclasses import replace

import numpy as np

from midspan.calibration.fit import Fit, Pair, best_corner
from midspan.calibration.minimum import minimum
from midspan.signals.health import dominant_frequency

# The exposure is found to this share of the longest one; so many are tried first.
TOLERANCE, TRIED = 0.01, 6
# Up to so many periods of the motion the first term of the average holds to 2 % of it.
MOST_PERIODS = 0.4
# With a gain farther from 1 than this it is something else.
MAX_GAIN_ERROR = 0.2


def with_exposure(pair: Pair, fit: Fit) -> tuple[Pair, Fit]:
    """The pair with the most likely exposure of its measurements, none where the motion does not show it, and its fit.

    An exposure is taken where it gains more likelihood, with any gain, than a parameter costs that tells nothing (as in
    `fit.with_input_noise`).
    """
    frequency_hz = dominant_frequency(pair.samples[:, 1], pair.sample_rate_hz)
    longest_s = min(1.0 / pair.rate_hz, MOST_PERIODS / max(frequency_hz, MOST_PERIODS * pair.rate_hz))
    free = replace(pair, ratio=None)

    def fitted(share: float) -> Fit:
        return best_corner(replace(free, exposure_s=share * longest_s), fit.offset_s, fit.corner)

    shares = np.linspace(0.0, 1.0, TRIED)
    tried = [fitted(float(share)).likelihood for share in shares]
    k = int(np.argmax(tried))
    low, high = float(shares[max(k - 1, 0)]), float(shares[min(k + 1, TRIED - 1)])
    share = minimum(lambda one: -fitted(one).likelihood, low, high, TOLERANCE)
    best = fitted(share)
    gained = best.likelihood - tried[0] >= 0.5 * np.log(max(len(fit.whitened.variance), 1))
    if not gained or abs(best.ratio - 1.0) > MAX_GAIN_ERROR:
        return pair, fit
    found = replace(pair, exposure_s=share * longest_s)
    return found, best_corner(found, fit.offset_s, fit.corner)
