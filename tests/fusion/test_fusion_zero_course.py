"""The zero of one camera beside another: what no walk explains is left out of it and told; jumps; how fast it grows."""

import numpy as np
import pytest

from midspan.fusion.zero_course import NEW_LEVEL_PIECES, zero_course

NOISE_M = 2e-5


def course_of(added, seconds=200, seed=0):
    """The course of differences at 4 Hz: noise about `added` (a function of time, m)."""
    time_s = np.arange(0.0, seconds, 0.25)
    seen = added(time_s) + NOISE_M * np.random.default_rng(seed).standard_normal(len(time_s))
    time_ns = np.rint(1e9 * time_s).astype(np.int64)
    return zero_course(time_ns, seen, np.full(len(time_s), NOISE_M**2))


def test_an_excursion_is_left_out_and_its_size_is_told():
    course = course_of(lambda t: np.where((t >= 80.0) & (t < 90.0), 5e-3, 0.0))
    out = course.apart_m != 0.0
    assert course.time_ns[out][[0, -1]] / 1e9 == pytest.approx([80.4, 89.4], abs=0.1)
    assert course.apart_m[out] == pytest.approx(5e-3, abs=5 * NOISE_M)
    # A second's mean of four values is known to half of one's noise.
    assert np.abs(course.level_m).max() < 3 * NOISE_M
    assert not course.jump_m.any()
    assert course.wander_m < NOISE_M


@pytest.mark.parametrize("height_m", [-3e-3, 3e-3])
def test_a_difference_that_stays_is_the_new_level_from_its_twentieth_second_on(height_m):
    course = course_of(lambda t: np.where(t >= 80.0, height_m, 0.0))
    (jump,) = np.flatnonzero(course.jump_m)
    assert course.time_ns[jump] / 1e9 == pytest.approx(80.0 + NEW_LEVEL_PIECES - 0.6, abs=0.1)
    assert course.jump_m[jump] == pytest.approx(height_m, abs=3 * NOISE_M)
    assert course.level_m[-1] == pytest.approx(height_m, abs=3 * NOISE_M)
    assert course.level_m[0] == pytest.approx(0.0, abs=3 * NOISE_M)
    assert course.wander_m < 2 * NOISE_M


def test_a_drift_grows_by_what_it_does_in_a_minute_not_by_its_steps():
    rate = 4e-6
    course = course_of(lambda t: rate * t)
    # Over the longest lag of 80 s: (80 s · rate)² in 80 s.
    assert course.growth_m2_s == pytest.approx(80.0 * rate**2, rel=0.1)
    assert course.walk_m2_s < course.growth_m2_s
    # From 0 to `end` evenly: its root mean square is end / √3.
    assert course.wander_m == pytest.approx(rate * 200.0 / np.sqrt(3.0), rel=0.05)


def test_a_drift_goes_on_through_a_gap_and_is_no_jump():
    rate = 8e-6
    course = course_of(lambda t: np.where((t > 60.0) & (t < 100.0), np.nan, rate * t))
    assert not course.jump_m.any()
    assert not course.apart_m.any()
    before, after = (np.searchsorted(course.time_ns, 1e9 * t) for t in (59.0, 102.0))
    for place in (before, after):
        assert course.level_m[place] == pytest.approx(rate * course.time_ns[place] / 1e9, abs=4 * NOISE_M)


def test_what_both_zeros_are_said_to_be_off_by_explains_a_level_that_changed_in_a_gap():
    time_s = np.arange(0.0, 160.0, 0.25)
    seen = np.where(time_s > 80.0, 1e-3, 0.0) + NOISE_M * np.random.default_rng(0).standard_normal(len(time_s))
    seen[(time_s > 60.0) & (time_s < 100.0)] = np.nan
    time_ns, noise = np.rint(1e9 * time_s).astype(np.int64), np.full(len(time_s), NOISE_M**2)
    assert zero_course(time_ns, seen, noise).jump_m.any()
    course = zero_course(time_ns, seen, noise, np.where(time_s > 80.0, 0.5e-3**2, 0.0))
    assert not course.jump_m.any()
    assert course.level_m[-1] == pytest.approx(1e-3, abs=3 * NOISE_M)


def test_a_walk_grows_as_it_is_stated():
    growth = []
    for seed in range(20):
        walked = np.cumsum(1e-5 * np.random.default_rng(100 + seed).standard_normal(400))
        course = course_of(lambda t, level=walked: level[t.astype(int)], seconds=400, seed=seed)
        growth.append(course.growth_m2_s / 1e-10)
        assert not course.apart_m.any()
    # The largest of six lags is above the walk's own: by half in the middle of twenty.
    assert 0.9 < np.median(growth) < 2.5
