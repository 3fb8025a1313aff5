"""Frames under interference by their floors: the same frames however the record is cut, and none by a first frame."""

import numpy as np
import pytest

from midspan.radar.interference import MIN_FRAMES, Interference

COUNT = 1500


def floors(seed):
    """Floors (n,) of noise, their median over 16 bins, and which of them a burst of ten times the power raises."""
    rng = np.random.default_rng(seed)
    floor = np.median(rng.exponential(1.0, (COUNT, 16)), axis=1)
    burst = np.zeros(COUNT, dtype=bool)
    for first in rng.integers(MIN_FRAMES, COUNT - 30, 20):
        burst[first : first + 20] = True
    floor[rng.integers(0, COUNT, 20)] = np.nan
    return np.where(burst, floor + 10.0, floor), burst & np.isfinite(floor)


@pytest.mark.parametrize("length", [1, 7, 512, 700])
def test_any_cutting_finds_the_same_frames(length):
    floor, burst = floors(0)
    whole, cut = Interference().found(floor), Interference()
    parts = [cut.found(floor[k : k + length]) for k in range(0, COUNT, length)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    # A floor of noise alone is beyond the limit once in 250 000 frames.
    np.testing.assert_array_equal(whole, burst)


@pytest.mark.parametrize("first", [0.0, 1e-12, 1e3])
def test_a_first_frame_of_another_floor_does_not_decide_for_the_others(first):
    floor, burst = floors(1)
    floor[0] = first
    found = Interference().found(floor)
    np.testing.assert_array_equal(found, burst)
