"""The time over which a displacement sensor averages, where it is not declared.

Averaging over T leaves sin(π f T)/(π f T) of a motion at f Hz: fast motion comes out smaller than slow motion. A wrong
gain is the same at all frequencies, so that both can be distinguished where the motion has more than one.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from midspan.calibration.agreement import at_rate, misfit, straightened
from midspan.calibration.first_order import lead_over_first_order
from midspan.calibration.fit import Fit, Pair, best_corner
from midspan.calibration.frequency_response import MIN_GAIN, exposure_shows
from midspan.calibration.minimum import global_minimum

# The exposure is found to this share of the longest one; number of exposures that are tried first.
TOLERANCE, TRIED = 0.001, 11
# A gain farther from 1 than this has another cause.
MAX_GAIN_ERROR = 0.2
# Its standard deviation is first sought with this step, as a share of it, and then with one of its size.
STEP, ROUNDS = 0.05, 3


@dataclass(frozen=True, slots=True)
class Exposed:
    """The pair with the exposure found, and its fit; spread: what the exposure's error makes of a gain, relative.

    open_s: an exposure that explains the readings no better than other causes do: it is not in the pair.
    """

    pair: Pair
    fit: Fit
    spread: float = 0.0
    open_s: float = 0.0


def find_exposure(pair: Pair, fit: Fit, *, offset_cost: float) -> Exposed:
    """The pair with the most likely exposure of its measurements, none where the motion does not show it, and its fit.

    An exposure is taken where it gains more likelihood, with any gain, than a parameter without effect would (as in
    `fit.with_input_noise`), explains the readings better than any delay and any first-order response, and explains
    more than it leaves. It is no longer than the interval of the measurements.
    Where none is taken those that the motion does not exclude make the gain uncertain. offset_cost: as of
    `first_order.lead_over_first_order`.
    """
    longest_s, free = 1.0 / pair.rate_hz, replace(pair, ratio=None)

    @cache
    def fitted(share: float) -> Fit:
        return best_corner(replace(free, exposure_s=share * longest_s), fit.offset_s, fit.corner)

    share = global_minimum(lambda one: -fitted(one).likelihood, 0.0, 1.0, tried=TRIED, tolerance=TOLERANCE)
    best = fitted(share)
    none = fitted(0.0)
    gained = best.likelihood - none.likelihood >= 0.5 * np.log(max(len(fit.whitened.variance), 1))
    # What leaves more than it explains, where it leaves most, is something else, which averaging happens to resemble.
    explained = none.noise > misfit(replace(free, exposure_s=share * longest_s), best).factor * best.noise
    if abs(best.ratio - 1.0) > MAX_GAIN_ERROR:
        return Exposed(pair, fit)
    shows = gained and explained and _shows(free, fit)
    if not (shows and _leads(free, best, share * longest_s, offset_cost)):
        # What the motion does not exclude, the gain may be off by: over all exposures, each by its likelihood.
        tried = [fitted(float(one)) for one in np.linspace(0.0, 1.0, TRIED)]
        weights = np.exp([one.likelihood - best.likelihood for one in tried])
        away = np.array([one.ratio - none.ratio for one in tried])
        spread = float(np.sqrt(np.average(away**2, weights=weights)))
        return Exposed(pair, fit, spread, share * longest_s if shows else 0.0)
    step, spread = STEP * share, 0.0
    for _ in range(ROUNDS):
        below, above = fitted(share - step), fitted(share + step)
        curved = (2.0 * best.likelihood - below.likelihood - above.likelihood) / step**2
        std = min(1.0 / float(np.sqrt(max(curved, 1e-300))), share)
        spread, step = std * abs(above.ratio - below.ratio) / (2.0 * step), std
    found = replace(pair, exposure_s=share * longest_s)
    return Exposed(found, best_corner(found, fit.offset_s, fit.corner), spread)


def _leads(free: Pair, best: Fit, exposure_s: float, offset_cost: float) -> bool:
    """Whether an exposure is clearly more likely than a first-order response."""
    with_it, without = replace(free, exposure_s=exposure_s), replace(free, exposure_s=0.0)
    lead = lead_over_first_order(with_it, without, best, exposure_s**2 / 24.0, offset_cost=offset_cost)
    return lead > MIN_GAIN


def _shows(pair: Pair, fit: Fit) -> bool:
    """Whether an exposure shows that is no clock running at another rate, which blurs the motion as well."""
    straight = straightened(pair, fit)
    if straight is None:
        return exposure_shows(pair, fit)
    return exposure_shows(at_rate(pair, fit.offset_s, straight[1]), straight[0])
