"""Which matches of features are accepted: rejection I and II.

Ma, Choi and Sohn, "Real-time structural displacement estimation by fusing asynchronous acceleration and computer
vision measurements", 2022, doi 10.1111/mice.12767, equations 15 to 17 and 29. Positions are arrays (n, 2) of x, y in
px of the whole image; match k joins first[k] in the reference frame with now[k] in the present one.
"""

import math

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats, Prediction
from midspan.signals.medians import SIGMA_OF_MEDIAN

Mask = NDArray[np.bool_]

PAIRINGS = 8
MOST = 0.5  # a believed set holds at least this share of the matches
CONFIDENCE = 3.0  # standard deviations that hold 99.7 % of a normal variable
SPREAD = 4.0  # robust standard deviations from the median


def distance_variation(first: Floats, now: Floats) -> Floats:
    """Distance variation index (n,), 0 to 1, of distances (n,) then and now: equation 15; 1 where both are 0."""
    largest = np.maximum(first, now)
    share = np.divide(np.minimum(first, now), largest, out=np.zeros(len(first)), where=largest > 0.0)
    return np.asarray(1.0 - share)


def best_match(first: Floats, now: Floats, rng: np.random.Generator) -> int:
    """Index of the best match: one of that pair, out of a random pairing of all, whose distance varies least.

    At least two matches; with an odd number the last of the shuffled ones stays alone.
    """
    pairs = rng.permutation(len(first))[: len(first) // 2 * 2].reshape(-1, 2)
    a, b = pairs[:, 0], pairs[:, 1]
    then = np.hypot(*(first[a] - first[b]).T)
    index = distance_variation(then, np.hypot(*(now[a] - now[b]).T))
    return int(a[np.argmin(index)])


def distance_limits(difference: Floats, epsilon_px: float, *, literal: bool = False) -> tuple[Floats, Floats]:
    """Least and largest true distance (n,) of points that lie `difference` (n, 2) apart on the pixel grid: equation 16.

    `epsilon_px` is the discretisation error of a coordinate. A coordinate within 2 epsilon may be no difference at all;
    literal: the equation squares what is then below zero, so that equal coordinates count as 2 epsilon apart.
    """
    size = np.abs(difference)
    least = size - 2.0 * epsilon_px
    least = least if literal else np.maximum(least, 0.0)
    return np.hypot(*least.T), np.hypot(*(size + 2.0 * epsilon_px).T)


def rejection_one(
    first: Floats, now: Floats, epsilon_px: float, *, rng: np.random.Generator, literal: bool = False
) -> Mask:
    """Matches (n,) whose distance to the best match is the same then and now: equations 15 to 17."""
    if len(first) < 2:
        return np.zeros(len(first), dtype=bool)
    best = best_match(first, now, rng)
    then_least, then_largest = distance_limits(first - first[best], epsilon_px, literal=literal)
    now_least, now_largest = distance_limits(now - now[best], epsilon_px, literal=literal)
    return np.asarray((then_largest >= now_least) & (now_largest >= then_least))


def repeated_rejection_one(first: Floats, now: Floats, epsilon_px: float, *, rng: np.random.Generator) -> Mask:
    """Rejection I, paired anew while less than half of the matches pass; the largest set of up to eight tries.

    The best pair of one pairing can be two equal mismatches, as on repeating texture; few others agree with them.
    """
    largest = rejection_one(first, now, epsilon_px, rng=rng)
    for _ in range(PAIRINGS - 1):
        if np.count_nonzero(largest) >= MOST * len(first):
            break
        tried = rejection_one(first, now, epsilon_px, rng=rng)
        if np.count_nonzero(tried) > np.count_nonzero(largest):
            largest = tried
    return largest


def rejection_two(translation: Floats, prediction: Prediction, epsilon_px: float) -> Mask:
    """Matches (n,) whose translation (n, 2), px since the reference frame, the prediction allows: equation 29.

    Along each axis: within 3 standard deviations and 2 epsilon of what is predicted; the shift of the region that the
    equation takes off on both sides is part of the translation here.
    """
    keep = np.ones(len(translation), dtype=bool)
    predicted = ((prediction.x_px, prediction.std_x_px), (prediction.y_px, prediction.std_y_px))
    for axis, (value, std) in enumerate(predicted):
        if math.isfinite(value) and math.isfinite(std):
            keep &= np.abs(translation[:, axis] - value) <= CONFIDENCE * std + 2.0 * epsilon_px
    return keep


def near_median(translation: Floats, least_px: float) -> Mask:
    """Matches (n,) within `least_px`, or four robust standard deviations if that is more, of the median translation."""
    if len(translation) == 0:
        return np.zeros(0, dtype=bool)
    distance = np.abs(translation - np.median(translation, axis=0))
    limit = np.maximum(least_px, SPREAD * SIGMA_OF_MEDIAN * np.median(distance, axis=0))
    return np.asarray(np.all(distance <= limit, axis=1))
