"""Which of two cameras is believed, how the second one's zero follows, and how high the sun stands."""

from datetime import UTC, datetime

import numpy as np
import pytest

from midspan.engine.sun import sun_elevation_deg
from midspan.engine.switching import PUBLISHED, Look, Switch, SwitchSettings
from midspan.errors import UsageError
from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.smoother import smooth
from midspan.fusion.zero_course import zero_course
from midspan.records import Acceleration, Displacement, Source, joined, nanoseconds, part

BOTH = (Source.CAMERA, Source.INFRARED)


def ns(*moment):
    return np.array([int(datetime(*moment, tzinfo=UTC).timestamp()) * 1_000_000_000])


def test_the_sun_stands_where_the_published_example_of_the_solar_position_algorithm_has_it():
    # I. Reda, A. Andreas, Solar Energy 76 (2004) 577, example of appendix A.5: elevation without refraction.
    found = sun_elevation_deg(ns(2003, 10, 17, 19, 30, 30), 39.742476, -105.1786)[0]
    # 0.01° for the short series, 0.0024° of parallax.
    assert found == pytest.approx(39.872046, abs=0.02)


@pytest.mark.parametrize("day", [(2020, 6, 20), (2031, 6, 21), (1990, 12, 22), (2024, 12, 21)])
def test_at_a_solstice_the_sun_s_highest_place_is_given_by_the_tilt_of_the_earth(day):
    summer = day[1] == 6
    stamps = ns(*day) + np.arange(0, 86_400, 20) * 1_000_000_000
    highest = sun_elevation_deg(stamps, 48.0, 11.6).max()
    # The tilt (23.44° in 2000) changes by 0.0001° a year; the solstice may lie half a day away (0.005°).
    assert highest == pytest.approx(90 - 48.0 + (23.438 if summer else -23.438), abs=0.02)


def test_at_an_equinox_day_and_night_are_equally_long_everywhere():
    stamps = ns(2024, 3, 20) + np.arange(0, 86_400, 10) * 1_000_000_000
    for latitude in (-50.0, 0.0, 30.0, 60.0):
        # The equinox is at 03:06 UTC; the declination then grows by 0.4° a day.
        assert np.mean(sun_elevation_deg(stamps, latitude, 8.0) > 0.0) == pytest.approx(0.5, abs=0.006)


def looks(rows, rate_hz=5.0):
    """Looks of both cameras in turn: rows of (camera's std, infrared's std) in mm, NaN where lost."""
    for k, pair in enumerate(rows):
        for late, (source, std_mm) in enumerate(zip(BOTH, pair, strict=True)):
            yield Look(source, round((k / rate_hz + 0.03 * late) * 1e9), (1e-3 * std_mm) ** 2, 50.0 / std_mm)


def run(rows, settings=None, sun=None):
    switch, events = Switch(BOTH, settings), []
    for look in looks(rows):
        events += switch.push(look, sun)
    return switch, events


def test_the_camera_that_knows_more_is_believed_and_equals_do_not_take_turns():
    rng = np.random.default_rng(0)
    # Variances that scatter by a factor of 1.5 about the same mean, for five minutes.
    rows = 0.1 * np.exp(0.2 * rng.standard_normal((1500, 2)))
    assert run(rows)[1] == []
    # Half the standard deviation is four times the information, which is more than twice.
    switch, events = run([(0.1, 0.05)] * 100)
    assert switch.believed is Source.INFRARED
    assert [event.kind for event in events] == ["switch"]
    assert "camera → infrared" in events[0].text


def test_the_other_camera_is_believed_only_after_both_have_seen_for_a_while_unless_this_one_is_lost():
    _, events = run([(0.1, np.nan)] * 50 + [(0.1, 0.02)] * 60)
    hold_s = SwitchSettings().hold_s
    assert hold_s <= events[0].time_ns / 1e9 - 10.0 <= hold_s + 1.0
    _, events = run([(0.1, 0.5)] * 50 + [(np.nan, 0.5)] * 50)
    assert events[0].text.endswith("it no longer sees the target")
    assert 0.0 < events[0].time_ns / 1e9 - 10.0 <= SwitchSettings().silent_s + 0.3


def test_a_record_that_begins_in_the_dark_begins_with_the_camera_that_sees_and_without_an_event():
    switch, events = run([(np.nan, 0.1)] * 50)
    assert switch.believed is Source.INFRARED
    assert events == []


def test_the_published_rule_takes_the_larger_number_of_matches_whatever_the_variance():
    # The camera has twice the matches, and here matches follow 1 / std.
    switch, _ = run([(0.05, 0.1)] * 30, PUBLISHED)
    assert switch.believed is Source.CAMERA
    counted = Switch(BOTH, PUBLISHED)
    for k in range(30):
        counted.push(Look(Source.CAMERA, k * 100_000_000, 1e-12, 20.0))
        counted.push(Look(Source.INFRARED, k * 100_000_000 + 1, 1e-6, 40.0))
    assert counted.believed is Source.INFRARED


def test_the_sun_decides_between_equals_and_not_against_what_is_seen():
    equal = [(0.1, 0.1)] * 100
    assert run(equal, sun=-20.0)[0].believed is Source.INFRARED
    assert run(equal, sun=30.0)[0].believed is Source.CAMERA
    assert run(equal, sun=-3.0)[0].believed is Source.CAMERA  # twilight says nothing
    assert run([(0.02, 0.1)] * 100, sun=-20.0)[0].believed is Source.CAMERA


@pytest.mark.parametrize("wrong", [{"rule": "votes"}, {"factor": 0.5}, {"hold_s": -1.0}, {"average_s": 0.0}])
def test_settings_that_cannot_be_are_refused(wrong):
    with pytest.raises(UsageError):
        SwitchSettings(**wrong)


def wandering(seed, walk_m=2e-6, noise_m=5e-5, night=(400, 700), seconds=1000):
    """Differences of two cameras at 1 Hz whose zero walks at random, none at night; and the true level."""
    rng = np.random.default_rng(seed)
    level = 1e-3 + np.cumsum(walk_m * rng.standard_normal(seconds))
    seen = level + noise_m * rng.standard_normal(seconds)
    seen[slice(*night)] = np.nan
    return nanoseconds(np.arange(seconds) + 0.5), seen, np.full(seconds, noise_m**2), level


def test_the_zero_beside_another_is_the_dense_least_squares_solution():
    # Without a night: over one the level may go as far as a drift goes, which is no walk.
    time_ns, seen, variance, _ = wandering(3, seconds=120, night=(50, 51))
    course = zero_course(time_ns, seen, variance)
    known = np.isfinite(seen)
    t = time_ns[known] / 1e9
    walk = np.diag(1.0 / (course.walk_m2_s * np.diff(t)))
    steps = np.diff(np.eye(len(t)), axis=0)
    # The walk's steps and the differences are independent Gaussian values; each has its own row.
    information = steps.T @ walk @ steps + np.diag(1.0 / variance[known])
    covariance = np.linalg.inv(information)
    np.testing.assert_allclose(course.level_m, covariance @ (seen[known] / variance[known]), rtol=0, atol=1e-9)
    np.testing.assert_allclose(course.variance_m2, np.diag(covariance), rtol=1e-6)


def test_the_zero_is_bridged_over_a_night_with_a_band_that_holds_it():
    inside, ends = [], []
    for seed in range(20):
        time_ns, seen, variance, level = wandering(seed)
        found, spread = zero_course(time_ns, seen, variance).at(time_ns)
        inside.append(np.abs(found - level) <= 1.96 * np.sqrt(spread))
        ends.append(np.abs(np.diff(found)).max())
        # In the middle of the night it is known worst.
        assert spread[550] > 2.0 * spread[300]
    # Twenty nights of one walk each: neighbours err alike, so the share scatters about 95 %.
    assert 0.85 < np.mean(inside) <= 1.0
    assert max(ends) < 2e-5


def test_a_zero_that_stands_still_is_a_mean_and_outliers_do_not_move_it():
    rng = np.random.default_rng(1)
    time_ns = nanoseconds(np.arange(0, 60, 0.1))
    seen = 2e-3 + 1e-5 * rng.standard_normal(len(time_ns))
    seen[::40] += 5e-3
    course = zero_course(time_ns, seen, np.full(len(time_ns), 1e-10))
    level, spread = course.at(time_ns)
    assert level == pytest.approx(2e-3, abs=3e-6)
    assert np.sqrt(spread.max()) < 3e-6
    assert zero_course(time_ns, np.full(len(time_ns), np.nan), np.ones(len(time_ns))) is None


def day(seed, mismatch=0.005):
    """A day of 600 s: slow drift and a mode, a camera that is blind from 200 to 420 s, infrared with its own zero."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 600.0, 0.02)
    slow, fast = 2e-3 * np.sin(2 * np.pi * t / 500.0), 1e-3 * np.sin(2 * np.pi * 0.8 * t)
    accel = -((2 * np.pi * 0.8) ** 2) * fast + 2.5e-3 * rng.standard_normal(len(t)) + 0.02
    accel -= (2 * np.pi / 500.0) ** 2 * slow
    acceleration = Acceleration(nanoseconds(t), accel, np.full(len(t), 2.5e-3**2 * 0.02))
    blocks = []
    for source, std_m, start_s in ((Source.CAMERA, 5e-5, 0.0), (Source.INFRARED, 1e-4, 0.13)):
        stamps = np.arange(start_s, 599.5, 0.5)
        true = np.interp(stamps, t, slow) + 1e-3 * np.sin(2 * np.pi * 0.8 * stamps)
        noise = std_m * rng.standard_normal(len(stamps))
        value = true + noise
        if source is Source.CAMERA:
            value[(stamps > 200) & (stamps < 420)] = np.nan
        else:
            # Its scale factor is off, and its zero wanders by a tenth of a millimetre.
            value = (1.0 + mismatch) * true + noise + 3e-3 + np.cumsum(4e-6 * rng.standard_normal(len(stamps)))
        blocks.append(
            Displacement(
                nanoseconds(stamps), value, np.full(len(stamps), std_m**2), np.full(len(stamps), source, np.uint8)
            )
        )
    return t, slow + fast, acceleration, blocks


def test_a_day_with_a_night_is_measured_without_a_gap_and_without_a_step_at_dusk_and_dawn():
    for seed in range(3):
        t, true, acceleration, (camera, infrared) = day(seed)
        settings = KalmanSettings(coasting_s=1.5)
        path = smooth(acceleration, camera, settings).estimate
        there = np.interp(infrared.time_ns, path.time_ns, path.displacement_m)
        near = (infrared.time_ns < 200e9) | (infrared.time_ns > 420e9)
        apart = np.where(near, infrared.value_m - there, np.nan)
        level, _ = zero_course(infrared.time_ns, apart, infrared.variance_m2 + 1e-10).at(infrared.time_ns)
        moved = Displacement(infrared.time_ns, infrared.value_m - level, infrared.variance_m2, infrared.source)
        both = joined([camera, moved])
        found = smooth(acceleration, part(both, np.argsort(both.time_ns, kind="stable")), settings).estimate
        error = found.displacement_m - true
        assert np.all(found.status[50:-50] == 0)
        assert np.sqrt(np.mean(error**2)) < 0.15e-3
        for edge in (200.0, 420.0):
            # Forty infrared frames of 0.1 mm: their mean is known to 0.016 mm.
            before, after = error[(t > edge - 20) & (t < edge)], error[(t > edge) & (t < edge + 20)]
            assert abs(after.mean() - before.mean()) < 0.05e-3
        # The night's error is what the walk of an unseen zero makes, and a constant zero would leave a step of more.
        constant = np.nanmedian(apart)
        assert np.abs(level - constant).max() > 3e-5


def test_a_camera_that_has_gone_blind_is_not_believed_for_what_it_knew_before():
    # The camera knew ten times more and goes dark at 10 s; infrared carries on. One switch, none back.
    switch, events = run([(0.02, 0.2)] * 50 + [(np.nan, 0.2)] * 60)
    assert switch.believed is Source.INFRARED
    assert len(events) == 1
