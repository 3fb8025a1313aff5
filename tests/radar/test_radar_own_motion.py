"""Targets that move on their own: which of them, by how much, at what frequency; and none where none does."""

import numpy as np
import pytest

from midspan.radar.own_motion import Shown, own_motions
from midspan.simulate.motion.motion import random_motion

RATE_HZ, LENGTH_S, NOISE_M, DENSITY = 100.0, 60.0, 1e-5, 4.5e-8
TIME = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ)


def shown_of(own, seed=0, factor_error=0.0, hidden=None):
    """What targets show that move by `own` (targets, n) themselves, and the accelerometer's samples."""
    rng = np.random.default_rng(seed)
    motion = random_motion((0.5, 4.0), 2e-3, rng=rng)
    sampled = np.arange(-1.0, LENGTH_S + 1.0, 0.005)
    noise = np.sqrt(DENSITY / 0.005) * rng.standard_normal(len(sampled))
    samples = np.column_stack((sampled, motion.acceleration(sampled) + noise + 0.1))
    value = (1.0 + factor_error) * motion.displacement(TIME) + own + NOISE_M * rng.standard_normal(own.shape)
    if hidden is not None:
        value[:, (hidden[0] < TIME) & (hidden[1] > TIME)] = np.nan
    none = np.zeros(own.shape, dtype=bool)
    few = np.zeros(len(own))
    variance = np.full(own.shape, NOISE_M**2)
    return Shown(TIME, value, variance, none, few + 3e-4, few), samples


def sway(amplitude_m, frequency_hz):
    return amplitude_m * np.sin(2 * np.pi * frequency_hz * TIME + 0.4)


STILL = np.zeros(len(TIME))


@pytest.mark.parametrize("targets", [1, 2, 3])
@pytest.mark.parametrize("hidden", [None, (20.0, 26.0)])
def test_nothing_is_found_where_no_target_moves_by_itself(targets, hidden) -> None:
    for seed in range(6):
        found = own_motions(*shown_of(np.zeros((targets, len(TIME))), seed, hidden=hidden))
        assert found.power_m2.max() < 1e-12
        assert not found.left_out.any()
        assert not found.undecided.any()


@pytest.mark.parametrize(("amplitude_m", "frequency_hz"), [(3e-4, 0.5), (1e-4, 1.5), (1e-3, 0.3)])
def test_an_only_target_is_found_out_by_the_accelerometer(amplitude_m, frequency_hz) -> None:
    found = own_motions(*shown_of(sway(amplitude_m, frequency_hz)[None], seed=3))
    # The rest is the accelerometer's own noise: 0.02 mm at 0.5 Hz.
    assert found.std_m(0) == pytest.approx(amplitude_m / np.sqrt(2), rel=0.15)
    assert found.main_hz(0) == pytest.approx(frequency_hz, rel=0.1)
    assert not found.left_out.any()


def test_of_three_the_one_that_moves_is_left_out_however_slowly() -> None:
    for amplitude_m, frequency_hz in ((5e-5, 0.5), (3e-3, 0.03)):
        found = own_motions(*shown_of(np.stack((STILL, sway(amplitude_m, frequency_hz), STILL)), seed=4))
        assert found.left_out.tolist() == [False, True, False]
        assert found.std_m(1) == pytest.approx(amplitude_m / np.sqrt(2), rel=0.1)
        assert found.power_m2[[0, 2]].max() < (0.05 * amplitude_m) ** 2


@pytest.mark.parametrize("guilty", [0, 1])
def test_of_two_the_accelerometer_tells_which_moves(guilty) -> None:
    own = np.zeros((2, len(TIME)))
    own[guilty] = sway(3e-4, 0.7)
    found = own_motions(*shown_of(own, seed=5))
    assert found.left_out.tolist() == [guilty == 0, guilty == 1]
    assert found.std_m(guilty) == pytest.approx(3e-4 / np.sqrt(2), rel=0.1)


def test_what_the_accelerometer_cannot_tell_of_two_is_put_into_the_error_of_both() -> None:
    found = own_motions(*shown_of(np.stack((sway(2e-3, 0.03), STILL)), seed=6))
    assert found.undecided[0]
    assert not found.left_out.any()
    assert found.power_m2[0, 0] == found.power_m2[1, 0] == pytest.approx(2e-6, rel=0.2)


def test_a_factor_that_is_off_within_its_deviation_is_no_motion_of_the_target() -> None:
    found = own_motions(*shown_of(STILL[None], seed=7, factor_error=4e-4))
    assert found.power_m2.max() == 0.0
