"""Blockage, the cycle after it, and several targets that stand in for each other."""

from itertools import pairwise

import numpy as np
import pytest
from radar_cases import CYCLE, RATE, UNIT

from midspan.errors import UsageError
from midspan.radar.blockage import BlockageMonitor, BlockageSettings
from midspan.radar.cycles import verify_cycles
from midspan.radar.several import SeveralTargets


def test_a_target_is_blocked_at_once_and_back_after_five_good_frames() -> None:
    amplitude = np.array([1.0, 1.1, 0.3, 0.9, 1.0, 1.0, 3.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    blocked = BlockageMonitor(1.0).push(amplitude)
    np.testing.assert_array_equal(np.flatnonzero(~blocked), [0, 1, 11, 12])
    parts = BlockageMonitor(1.0)
    np.testing.assert_array_equal(np.concatenate([parts.push(amplitude[:4]), parts.push(amplitude[4:])]), blocked)
    assert not BlockageMonitor(1.0, BlockageSettings(low=0.2, high=4.0)).push(amplitude).any()


def test_clutter_left_behind_an_obstruction_is_not_taken_for_the_target() -> None:
    # 30 dB below the target and 20 dB above the noise: a test against the noise would accept it.
    assert BlockageMonitor(100.0).push(np.full(10, 3.0)).all()
    assert BlockageMonitor(100.0).push(np.array([np.nan])).all()


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


@pytest.mark.parametrize("jump", [-7, -1, 0, 1, 12])
def test_the_range_tells_by_how_many_cycles_the_phase_came_back_wrong(jump: int) -> None:
    moved, phase, coarse = record(jump, std_m=0.8e-3)
    corrected, (verdict,) = verify_cycles(phase, coarse, restarts=(1000,), phase_per_m=UNIT)
    assert (verdict.cycles, verdict.verdict) == (jump, "shifted" if jump else "verified")
    assert np.nanmax(np.abs(corrected / UNIT - moved)) < 0.1 * CYCLE


def test_an_outage_longer_than_what_is_compared_still_finds_the_frames_before_it() -> None:
    _, phase, coarse = record(1, std_m=0.8e-3)
    phase[300:1000] = np.nan
    _, (verdict,) = verify_cycles(phase, coarse, restarts=(1000,), phase_per_m=UNIT, longest=250)
    assert verdict.cycles == 1


def test_where_the_range_is_too_coarse_a_new_datum_is_declared_and_nothing_is_shifted() -> None:
    _, phase, coarse = record(1, std_m=30e-3)
    corrected, (verdict,) = verify_cycles(phase, coarse, restarts=(1000,), phase_per_m=UNIT)
    assert verdict.verdict == "new datum"
    np.testing.assert_array_equal(corrected, phase)
    blind, (verdict,) = verify_cycles(phase, np.full(2000, np.nan), restarts=(1000,), phase_per_m=UNIT)
    assert verdict.verdict == "new datum"
    np.testing.assert_array_equal(blind, phase)


def test_a_verified_cycle_is_hardly_ever_wrong() -> None:
    wrong = 0
    for seed in range(40):
        _, phase, coarse = record(1, std_m=8e-3, clutter_m=1e-3, seed=seed)
        _, (verdict,) = verify_cycles(phase, coarse, restarts=(1000,), phase_per_m=UNIT)
        wrong += verdict.verdict != "new datum" and verdict.cycles != 1
    assert wrong == 0


def several(sigma, blocked, *, seconds=60.0, seed=0, cuts=()):
    """Truth, combined value and its variance of three targets with starting errors of their own noise."""
    rng = np.random.default_rng(seed)
    count = int(seconds * RATE)
    true = 20e-3 * np.sin(2 * np.pi * 0.5 * np.arange(count) / RATE)
    value = true + rng.normal(0, 1, (3, count)) * np.array(sigma)[:, None]
    value -= value[:, :1]
    variance = np.repeat(np.square(sigma)[:, None], count, axis=1)
    for target, start, end in blocked:
        variance[target, int(start * RATE) : int(end * RATE)] = np.inf
    stream = SeveralTargets(3, RATE)
    edges = [0, *cuts, count]
    parts = [stream.push(value[:, a:b], variance[:, a:b]) for a, b in pairwise(edges)]
    return true, *(np.concatenate(columns) for columns in zip(*parts, strict=True))


SIGMA = (7e-6, 6e-6, 10e-6)


def test_two_of_three_targets_blocked_for_ten_seconds_leave_no_step() -> None:
    true, found, variance, datum = several(SIGMA, [(0, 30, 40), (1, 30, 40)])
    error = found - true
    assert np.std(error[2000:]) < 0.02e-3
    inside, outside = error[3000:4000].mean(), error[2000:3000].mean()
    # Offsets are learnt over 1000 frames: 10 µm / sqrt(1000) and the like.
    assert abs(inside - outside) < 2e-6
    assert not datum.any()
    assert variance[3500] == pytest.approx(SIGMA[2] ** 2)


def test_all_targets_together_are_quieter_than_the_best_alone() -> None:
    true, found, variance, _ = several(SIGMA, [])
    inner = slice(2000, None)
    expected = np.sqrt(1 / np.sum(1 / np.square(SIGMA)))
    assert np.std((found - true)[inner]) == pytest.approx(expected, rel=0.06)
    assert variance[-1] == pytest.approx(expected**2)


def test_everything_blocked_gives_no_value_and_the_cut_does_not_matter() -> None:
    blocked = [(k, 20, 21) for k in range(3)]
    _, found, variance, _ = several(SIGMA, blocked)
    assert np.isnan(found[2000:2100]).all()
    assert np.isinf(variance[2000:2100]).all()
    np.testing.assert_array_equal(several(SIGMA, blocked, cuts=(1, 777, 2050))[1], found)


def test_when_all_have_lost_their_cycle_a_new_datum_is_told_and_the_value_goes_on() -> None:
    stream = SeveralTargets(2, RATE, learning_s=1.0)
    value = np.full((2, 400), 5e-3)
    value[:, 200:] += CYCLE
    variance = np.full((2, 400), 1e-12)
    variance[:, 150:200] = np.inf
    lost = np.zeros((2, 400), dtype=bool)
    lost[:, 200] = True
    found, _, datum = stream.push(value, variance, lost)
    assert np.flatnonzero(datum).tolist() == [200]
    assert found[200] == pytest.approx(found[149])
    with pytest.raises(UsageError, match="2 targets"):
        stream.push(value[:1], variance[:1])
