"""A sensor that repeats one value: found where the acceleration says that the structure moved, and only there."""

import numpy as np
import pytest

from midspan.signals.clipping import range_limits, resolution
from midspan.signals.stuck import stuck
from midspan.simulate.motion.motion import Sines, Sum, Window, random_motion

NOISE = 2e-3


def accelerated(motion, seed, length_s=60.0):
    """Samples at 100 Hz with 2 mm/s² of noise and a bias of 20 mm/s²."""
    time = np.arange(0.0, length_s, 0.01)
    value = motion.acceleration(time) + 0.02 + NOISE * np.random.default_rng(seed).standard_normal(len(time))
    return np.column_stack((time, value, np.full(len(time), NOISE**2 / 100.0)))


def found(time, value, samples):
    return stuck(time, value, samples, resolution_m=resolution(value))


@pytest.mark.parametrize(("rate_hz", "count"), [(1.0, 5), (1.0, 30), (10.0, 40), (100.0, 150)])
@pytest.mark.parametrize("seed", range(4))
def test_a_stuck_value_is_found_whole_and_nothing_else(rate_hz, count, seed):
    motion = random_motion((0.3, 8.0), 3e-3, rng=np.random.default_rng(seed), flat="velocity")
    time = np.arange(0.5, 59.5, 1.0 / rate_hz)
    value = motion.displacement(time) + 1e-4 * np.random.default_rng(seed).standard_normal(len(time))
    first = len(time) // 3
    value[first : first + count] = value[first]
    mask = found(time, value, accelerated(motion, seed))
    np.testing.assert_array_equal(np.flatnonzero(mask), np.arange(first, first + count))


@pytest.mark.parametrize("step_m", [1e-5, 1e-4, 1e-3])
def test_coarse_resolution_at_rest_is_no_fault(step_m):
    # A second of shaking in a minute of rest; all values are multiples of the resolution.
    shaking = Window(Sines(np.array([5e-3]), np.array([1.3])), 28.0, 32.0, ramp_s=1.0)
    time = np.arange(0.5, 59.5, 0.1)
    for seed in range(4):
        value = np.round((shaking.displacement(time) + 0.0123) / step_m) * step_m
        assert not found(time, value, accelerated(shaking, seed)).any()


@pytest.mark.parametrize("seed", range(6))
def test_motion_within_the_resolution_is_no_fault(seed):
    # 0.3 mm of motion at 1.3 Hz, readings in whole millimetres: they are static most of the time, and rightly so.
    quiet = Sines(np.array([3e-4, 4e-3]), np.array([1.3, 0.02]))
    time = np.arange(0.5, 59.5, 0.1)
    value = np.round(quiet.displacement(time) * 1e3) / 1e3
    assert np.mean(np.diff(value) == 0.0) > 0.5
    assert not found(time, value, accelerated(quiet, seed)).any()


@pytest.mark.parametrize("length_s", [60.0, 600.0])
def test_noise_and_bias_of_the_accelerometer_are_no_motion(length_s):
    # A structure at rest, a sensor without any noise, a segment of an hour's tenth: the integrated noise is metres.
    still = Sines(np.array([1e-9]), np.array([1.0]))
    time = np.arange(0.5, length_s - 0.5, 1.0)
    for seed in range(6):
        value = np.full(len(time), 0.0123)
        value[:20] += 1e-5 * np.arange(20)
        assert not found(time, value, accelerated(still, seed, length_s)).any()


def test_what_the_accelerometer_did_not_see_is_not_held_against_the_sensor():
    motion = random_motion((0.3, 8.0), 3e-3, rng=np.random.default_rng(1), flat="velocity")
    time = np.arange(0.5, 59.5, 0.1)
    value = motion.displacement(time)
    value[200:240] = value[200]
    samples = accelerated(motion, 1)
    bridged = (samples[:, 0] > 15.0) & (samples[:, 0] < 30.0)
    samples[bridged, 2] = 1.0
    assert not found(time, value, samples).any()
    # Where the samples end before the values do, nothing is known either.
    assert not found(time, value, samples[samples[:, 0] < 22.0]).any()


def test_missing_values_inside_a_stuck_segment_do_not_hide_it():
    slow = Sines(np.array([5e-3]), np.array([0.05]))
    motion = Sum((slow, random_motion((0.3, 8.0), 3e-3, rng=np.random.default_rng(2), flat="velocity")))
    time = np.arange(0.5, 59.5, 0.1)
    value = motion.displacement(time)
    value[200:240] = value[200]
    value[[205, 217]] = np.nan
    mask = found(time, value, accelerated(motion, 2))
    np.testing.assert_array_equal(np.flatnonzero(mask), np.setdiff1d(np.arange(200, 240), [205, 217]))


def test_the_resolution_is_the_smallest_step_and_not_rounding():
    value = np.array([1, 2, 5, 9, 2]) * 0.1
    assert resolution(value + np.array([0.0, 1e-16, 0.0, 0.0, 0.0])) == pytest.approx(0.1)
    assert resolution(np.array([np.nan, 3.0, 3.0])) == 0.0


def test_a_sensor_held_at_the_ends_of_its_range_shows_them():
    time = np.arange(600) / 10.0
    motion = 6e-3 * np.sin(2 * np.pi * 0.4 * time) + 5e-3 * np.sin(2 * np.pi * 0.11 * time)
    fine = motion + 1e-4 * np.random.default_rng(0).standard_normal(600)
    assert range_limits(np.clip(fine, -8e-3, 7e-3)) == (-8e-3, 7e-3)
    assert range_limits(np.clip(fine, None, 7e-3)) == (-np.inf, 7e-3)
    assert range_limits(fine) == (-np.inf, np.inf)


@pytest.mark.parametrize("step_m", [1e-4, 5e-4, 2e-3])
def test_the_crests_of_a_coarse_sensor_are_no_ends_of_its_range(step_m):
    time = np.arange(600) / 10.0
    motion = 6e-3 * np.sin(2 * np.pi * 0.4 * time)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(600)
    assert range_limits(np.round((motion + noise) / step_m) * step_m) == (-np.inf, np.inf)
    # Nor is rest before and after the motion.
    still = np.where((time > 20.0) & (time < 40.0), np.abs(motion), 0.0)
    assert range_limits(still) == (-np.inf, np.inf)


@pytest.mark.parametrize("seed", range(3))
def test_an_end_of_the_range_that_a_slow_sensor_meets_one_value_at_a_time(seed):
    # 2 values a second of motion near 0.8 Hz: a crest that is cut off holds one of them, at most two.
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 120.0, 0.5)
    swing = 5e-3 * np.sin(2 * np.pi * 0.83 * time + seed) * (1.0 + 0.2 * np.sin(0.3 * time))
    value = np.round(swing + rng.normal(0.0, 1e-4, len(time)), 6)
    assert range_limits(np.clip(value, None, 4e-3)) == (-np.inf, 4e-3)
    # A sine stays longest at its crests; in steps of any size it seems to have no end of its range.
    for step_m in (1e-6, 1e-4, 1e-3, 3e-3):
        for one in (value, 5e-3 * np.sin(2 * np.pi * 0.83 * time)):
            assert range_limits(np.round(one / step_m) * step_m) == (-np.inf, np.inf)
