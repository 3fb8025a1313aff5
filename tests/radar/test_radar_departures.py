"""Targets that leave their place in the middle of a record: found by the accelerometer and by the other targets."""

import numpy as np
import pytest
from radar_cases import CYCLE, RATE, accelerometer

from midspan.radar.departures import departures
from midspan.radar.several import SeveralTargets, record_combined
from midspan.simulate.motion.motion import random_motion

SECONDS, LEAVES_S = 40, 25.0
SIGMA = 5e-6
MOTION = random_motion((0.5, 4.0), 2e-3, rng=np.random.default_rng(3))
TIME = np.arange(0, SECONDS, 1 / RATE)
SINCE = np.maximum(TIME - LEAVES_S, 0.0)
LATER = TIME >= LEAVES_S
# What a target does by itself, m of displacement: a car drives off, one creeps off at 5 mm/s, a cycle is lost.
OWN = {"car": 0.75 * SINCE**2, "creep": 5e-3 * SINCE, "slip": CYCLE * LATER, "small slip": 3e-4 * LATER}


def seen(own, targets=2, seed=0):
    """Displacement (targets, n) of which the first moves by itself, variance, and the accelerometer's samples."""
    rng = np.random.default_rng(seed)
    value = MOTION.displacement(TIME) + rng.normal(0.0, SIGMA, (targets, len(TIME)))
    value -= value[:, :1]
    value[0] += own
    return value, np.full_like(value, SIGMA**2), accelerometer(MOTION, SECONDS, noise=3e-3, seed=seed)


def left(value, variance, samples):
    return departures(TIME, value, variance, samples=samples, relative_std=np.full(len(value), 3e-4))


@pytest.mark.parametrize("targets", [2, 3])
@pytest.mark.parametrize("name", OWN)
def test_the_target_that_moves_by_itself_is_left_out_and_no_other(name, targets) -> None:
    found = left(*seen(OWN[name], targets))
    # Half a second about what is felt is left out, on either side.
    assert found[0, LATER][:5].all()
    assert not found[0, TIME < LEAVES_S - 1.05].any()
    assert not found[1:].any()


def test_what_drives_or_creeps_away_stays_left_out_and_what_jumped_does_not() -> None:
    for name in ("car", "creep"):
        assert left(*seen(OWN[name]))[0, LATER].all(), name
    for name in ("slip", "small slip"):
        assert not left(*seen(OWN[name]))[0, TIME > LEAVES_S + 1.05].any(), name


def test_a_target_that_stops_again_may_come_back() -> None:
    found = left(*seen(5e-3 * np.minimum(SINCE, 6.0)))[0]
    assert found[LATER & (TIME < LEAVES_S + 6.0)].all()
    assert not found[TIME > LEAVES_S + 7.1].any()


def test_a_still_view_is_left_alone_in_twenty_draws() -> None:
    assert not any(left(*seen(0.0 * TIME, 3, seed)).any() for seed in range(20))


def test_an_error_of_the_accelerometer_is_not_the_targets() -> None:
    value, variance, samples = seen(0.0 * TIME)
    samples[1500:1520, 1] += 0.5
    # Integrated twice that is 0.1 m/s from then on, which both targets contradict.
    assert not left(value, variance, samples).any()


def combined(own, targets, moved=None):
    value, variance, _ = seen(own, targets)
    none = np.zeros(value.shape, dtype=bool)
    some, found = record_combined(
        value, variance, RATE, told=(none, none if moved is None else moved), relative_std=np.full(targets, 3e-4)
    )
    true = MOTION.displacement(TIME)
    return some, found, found[0] - (true - true[0])


def test_of_three_the_one_that_leaves_slowly_is_outvoted_without_a_trace() -> None:
    # 0.1 mm/s: the accelerometer does not feel it.
    some, (_, variance, datum), error = combined(1e-4 * SINCE, 3)
    assert np.abs(error - error[1000:2400].mean()).max() < 6 * SIGMA
    assert not datum.any()
    assert some.left_out[0, TIME > LEAVES_S + 1.0].all()
    assert not some.left_out[1:].any()
    assert variance[-1] == pytest.approx(SIGMA**2 / 2)


def test_of_two_nobody_knows_which_is_right_and_the_variance_holds_both() -> None:
    some, (_, variance, _), error = combined(1e-4 * SINCE, 2)
    later = TIME > LEAVES_S + 1.0
    assert np.all(np.abs(error[later]) < 1.1 * np.sqrt(variance[later]) + 3 * SIGMA)
    assert np.all(some.apart_m[later] > 0.0)
    # The time in which the distance grew unnoticed is widened as well, and what was before is not.
    assert np.all(np.abs(error) < 4.0 * np.sqrt(variance) + 3 * SIGMA)
    assert np.all(some.apart_m[TIME < LEAVES_S - 3.0] == 0.0)


def test_a_target_that_jumped_is_learnt_anew_and_leaves_no_step() -> None:
    value, variance, samples = seen(OWN["slip"])
    moved = left(value, variance, samples)
    some, _, error = combined(OWN["slip"], 2, moved)
    assert np.abs(error - error[1000:2400].mean()).max() < 6 * SIGMA
    # It has a say again after the ten seconds in which its offset is learnt.
    assert some.left_out[0, TIME < LEAVES_S + 10.0][-900:].all()
    assert not some.left_out[0, TIME > LEAVES_S + 11.1].any()


def test_one_that_does_not_keep_its_distance_is_never_learnt() -> None:
    value, variance, _ = seen(0.0 * TIME)
    value[1] += 1e-4 * TIME
    some = SeveralTargets(2, RATE)
    found, spread, _ = some.push(value, variance)
    true = MOTION.displacement(TIME)
    assert np.all(spread == SIGMA**2)
    assert np.abs(found - (true - true[0])).max() < 8 * SIGMA


def test_a_spike_of_the_accelerometer_is_not_the_targets_however_their_noise_differs() -> None:
    for seed in range(5):
        value, variance, samples = seen(0.0 * TIME, 2, seed)
        value[1] += np.random.default_rng(seed + 9).normal(0.0, 4 * SIGMA, len(TIME))
        variance[1] = 17 * SIGMA**2
        samples[1500, 1] += 2.0
        assert not left(value, variance, samples).any()


def test_where_only_one_is_seen_a_change_of_speed_may_be_the_accelerometers_and_a_jump_is_not() -> None:
    value, variance, samples = seen(0.0 * TIME, 1)
    samples[1500, 1] += 2.0
    assert not left(value, variance, samples).any()
    assert left(*seen(OWN["slip"], 1))[0, LATER][:5].all()
