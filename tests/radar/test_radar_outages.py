"""Blockage, the cycle after it, and several targets that stand in for each other."""

import numpy as np
from radar_cases import RATE, UNIT

from midspan.radar.blockage import blocked


def test_a_target_is_blocked_at_once_and_back_after_five_good_frames() -> None:
    amplitude = np.array([1.0, 1.1, 0.3, 0.9, 1.0, 1.0, 3.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_array_equal(np.flatnonzero(~blocked(amplitude, 1.0)), [0, 1, 11, 12])


def test_clutter_left_behind_an_obstruction_is_not_taken_for_the_target() -> None:
    # 30 dB below the target and 20 dB above the noise: a test against the noise would accept it.
    assert blocked(np.full(10, 3.0), 100.0).all()
    assert blocked(np.array([np.nan]), 100.0).all()


def test_dips_of_a_weak_target_s_noise_are_no_obstruction_but_an_obstruction_is() -> None:
    # Complex noise 8 dB below: 1 % of the amplitudes lie below 0.4, as all do where it is hidden for 1 s.
    rng = np.random.default_rng(0)
    noise = 10 ** (-8 / 10)
    z = np.ones(20_000) + np.sqrt(noise / 2) * (rng.normal(size=20_000) + 1j * rng.normal(size=20_000))
    assert np.mean(np.abs(z) < 0.4) > 0.003
    # Single frames that noise hides by chance, once in 30 000, and the four after them.
    assert np.mean(blocked(np.abs(z), 1.0, noise)) < 1e-3
    hidden = z.copy()
    hidden[1000:1100] -= 1.0
    # Six frames' mean tells it, and the return.
    found = blocked(np.abs(hidden), 1.0, noise)
    assert found[1012:1100].mean() > 0.9
    assert not found[1120:1140].any()


def record(jump: int, *, std_m: float, clutter_m: float = 0.0, seed: int = 0):
    """Phase with `jump` cycles lost at frame 1000 and coarse ranges with noise, some of them missing."""
    rng = np.random.default_rng(seed)
    moved = 4e-3 * np.sin(2 * np.pi * 0.9 * np.arange(2000) / RATE)
    phase = UNIT * moved + rng.normal(0, 0.02, 2000)
    phase[1000:] -= 2 * np.pi * jump
    phase[950:1000] = np.nan
    coarse = 7.46 + moved + rng.normal(0, std_m, 2000) + clutter_m * np.sin(2 * UNIT * moved)
    coarse[rng.random(2000) < 0.1] = np.nan
    return moved, phase, coarse
