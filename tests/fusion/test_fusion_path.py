"""An estimate between its rows: the cubic together with the truth of a tone, and what other sensors' zeros gain by
it."""

import numpy as np
import pytest

from midspan.fusion.path import at
from midspan.records import Estimate, part

RATE_HZ, EPOCH_NS = 100.0, 1_700_000_000_000_000_000


def tone(hertz, seconds_=4.0):
    time_s = np.arange(round(seconds_ * RATE_HZ)) / RATE_HZ
    angle = 2.0 * np.pi * hertz * time_s
    codes = np.zeros(len(time_s), dtype=np.uint8)
    stamps = EPOCH_NS + np.rint(1e9 * time_s).astype(np.int64)
    speed = 2.0 * np.pi * hertz * np.cos(angle)
    return Estimate(stamps, np.sin(angle), 1.0 + time_s, speed, codes, codes)


@pytest.mark.parametrize(("hertz", "most"), [(3.0, 4e-6), (10.0, 5e-4)])
def test_between_rows_a_tone_is_met_to_the_fourth_power_of_the_interval(hertz, most):
    path = tone(hertz)
    between = path.time_ns[:-1] + np.int64(5_000_000)
    found = at(path, between)[0]
    # The cubic's error is at most h⁴/384 of the fourth derivative: (2π f h)⁴ / 384 of the amplitude.
    assert (2.0 * np.pi * hertz / RATE_HZ) ** 4 / 384.0 < most
    assert np.abs(found - np.sin(2.0 * np.pi * hertz * (between - EPOCH_NS) / 1e9)).max() < most


def test_at_the_rows_it_is_the_rows_and_beyond_the_ends_the_last_ones():
    path = tone(5.0)
    value, variance = at(path, path.time_ns)
    # Nanoseconds since 1970 are exact as differences; only rounding is left.
    np.testing.assert_allclose(value, path.displacement_m, atol=1e-12)
    np.testing.assert_allclose(variance, path.variance_m2, atol=1e-12)
    value, variance = at(path, path.time_ns[[0, -1]] + np.array([-1_000_000_000, 1_000_000_000]))
    np.testing.assert_array_equal(value, path.displacement_m[[0, -1]])
    np.testing.assert_array_equal(variance, path.variance_m2[[0, -1]])


def test_a_single_row_stands_everywhere():
    path = part(tone(5.0), slice(7, 8))
    found = at(path, path.time_ns[0] + np.array([-5, 0, 5]))[0]
    np.testing.assert_array_equal(found, np.full(3, path.displacement_m[0]))
