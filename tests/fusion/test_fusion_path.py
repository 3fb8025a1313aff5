"""An estimate between its rows: the cubic beside the truth of a tone, and what other sensors' zeros gain by it."""

import numpy as np
import pytest

from midspan.fusion.path import at, rows_at
from midspan.fusion.streams import KalmanSettings
from midspan.recording.fusing.one_zero import merged
from midspan.records import Acceleration, Displacement, Estimate, Source, part

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


def test_the_rows_at_their_own_stamps_are_the_rows():
    path = tone(5.0)
    found = rows_at(path, path.time_ns[3:-2])
    for name in Estimate.__slots__:
        np.testing.assert_allclose(getattr(found, name), getattr(path, name)[3:-2], atol=1e-12, err_msg=name)


def test_a_single_row_stands_everywhere():
    path = part(tone(5.0), slice(7, 8))
    found = at(path, path.time_ns[0] + np.array([-5, 0, 5]))[0]
    np.testing.assert_array_equal(found, np.full(3, path.displacement_m[0]))


def test_a_zero_beside_another_sensor_is_as_sure_as_the_measurements_not_as_straight_lines():
    # 5 Hz, 10 mm, twenty rows a period; the second sensor's stamps lie between the rows and its readings are true.
    amplitude, hertz, noise = 0.01, 5.0, 1e-6
    time_s = np.arange(3000) / RATE_HZ
    angle = 2.0 * np.pi * hertz
    rng = np.random.default_rng(3)
    stamps = np.rint(1e9 * time_s).astype(np.int64)
    shaken = -amplitude * angle**2 * np.sin(angle * time_s) + rng.normal(0.0, 1e-4, len(time_s))
    acceleration = Acceleration(stamps, shaken, np.full(len(time_s), 1e-10))

    def block(at_s, source, level):
        value = level + amplitude * np.sin(angle * at_s) + rng.normal(0.0, noise, len(at_s))
        codes = np.full(len(at_s), source, dtype=np.uint8)
        return Displacement(np.rint(1e9 * at_s).astype(np.int64), value, np.full(len(at_s), noise**2), codes)

    # Readings of the second one fall on the crest more often than on the trough.
    later = np.arange(0.055, 29.0, 0.23)
    found = merged(
        [block(time_s, Source.CAMERA, 0.0), block(later, Source.RADAR, 0.003)], acceleration, KalmanSettings()
    )
    second = found.measured.source == Source.RADAR
    straight = amplitude * (angle / RATE_HZ) ** 2 / 8.0
    assert found.levels[0].std_m < 0.01 * straight
    left = found.measured.value_m[second] - amplitude * np.sin(angle * found.measured.time_ns[second] / 1e9)
    assert abs(float(np.median(left))) < 0.01 * straight
