"""The mean square of a motion, which an accelerometer's errors go with."""

import numpy as np

from midspan.signals.health import MEMORY_S, mean_square

RATE_HZ = 100.0


def test_any_cutting_gives_the_same_bits():
    value = np.random.default_rng(1).normal(size=1000)
    whole = mean_square(value, 0.1, 2.0, RATE_HZ)
    parts, before = [], 2.0
    for piece in np.split(value, [1, 2, 77, 500, 998]):
        parts.append(mean_square(piece, 0.1, before, RATE_HZ))
        before = float(parts[-1][-1])
    assert np.array_equal(np.concatenate(parts), whole)


def test_it_is_the_exponential_mean_of_what_came_before():
    value = np.random.default_rng(2).normal(size=400)
    found = mean_square(value, 0.3, 1.5, RATE_HZ)
    left = np.exp(-np.arange(401) / (MEMORY_S * RATE_HZ))
    weights = left[:-1] * (1.0 - left[1])
    # Rounding of 400 sums.
    assert np.isclose(found[-1], weights @ (value[::-1] - 0.3) ** 2 + 1.5 * left[-1], rtol=1e-12)
