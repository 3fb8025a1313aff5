"""Targets: the signed conversion factor with its deviation, and the choice of what is fixed."""

from dataclasses import replace

import numpy as np
import pytest
from radar_cases import CARRIER, RATE, SHORT, UNIT, accelerometer, phasors, profiles_of, sine

from midspan.errors import UntrustedError
from midspan.papers.printed.radar_phase import best_on_grid, grid_factor
from midspan.radar.alignment import align
from midspan.radar.channels import channel_weights, combined, noise_variance, phase_variance
from midspan.radar.chirp import RangeAxis
from midspan.radar.evidence import clutter_share, static_centre
from midspan.radar.target import find_targets, ranked
from midspan.simulate.motion.motion import Sines, random_motion
from midspan.simulate.radar.signal import RadarModel, Reflector, noise_for, phase_bound_m

FRAMES = 2500
MOTION = Sines(np.array([2e-3, 1e-3]), np.array([1.1, 2.3]))
SAMPLES = accelerometer(MOTION, FRAMES / RATE)
# Amplitudes as seen: what moves on its own and the attached plate are the strongest.
WALL = Reflector(1.318, 800.0, 1.0)
ANGLED = Reflector(2.0543, 600.0, 1 / 1.2748, 0.2)
ABOVE = Reflector(3.3, 700.0, -1 / 6.0, -0.3)
PERSON = Reflector(4.4, 1500.0, 0.8, 0.1, own=random_motion((0.2, 1.5), 4e-3, rng=np.random.default_rng(5)))
PLATE = Reflector(0.1, 3000.0, 0.0)
TWO = (Reflector(5.40, 800.0, 1.0, 0.4), Reflector(5.43, 700.0, 0.5, -0.5))


@pytest.fixture(scope="module")
def targets():
    model = RadarModel((WALL, ANGLED, ABOVE, PERSON, PLATE, *TWO), SHORT, noise_for(600.0, 20.0), time_offset_s=0.012)
    profiles = profiles_of(model, MOTION, FRAMES)
    return find_targets(profiles, model.frame_s(FRAMES), samples=SAMPLES, axis=SHORT.axis)


def near(targets, range_m):
    return min(targets, key=lambda target: abs(target.range_m - range_m))


@pytest.mark.parametrize(("reflector", "factor"), [(WALL, 1.0), (ANGLED, 1.2748), (ABOVE, -6.0)])
def test_each_fixed_target_gives_its_factor_range_and_the_clock_offset(targets, reflector, factor) -> None:
    found = near(targets, reflector.range_m)
    assert found.range_m == pytest.approx(reflector.range_m, abs=0.1 * SHORT.bin_m)
    # The goal for 2 mm and a force-balance accelerometer is 0.3 %; a head-on wall is a factor of 1 only with the true
    # carrier, with the start frequency it would be 0.977.
    assert found.conversion_factor == pytest.approx(factor, rel=1e-3)
    assert found.relative_std < 1e-3
    assert found.time_offset_s == pytest.approx(0.012, abs=2e-4)
    assert found.coherence > 0.999
    assert found.objection == ""


def test_what_moves_by_itself_or_not_at_all_is_objected_to(targets) -> None:
    assert "does not follow" in near(targets, 0.1).objection
    person = near(targets, 4.4)
    assert "explains only" in person.objection or "does not follow" in person.objection
    order = [target.range_m for target in ranked(targets)]
    # The strongest of the clean ones first; the two that share a bin show it in receivers that disagree.
    assert order[0] == pytest.approx(1.318, abs=0.02)
    assert near(targets, 5.41).disagreement_rad > 0.2
    assert order.index(near(targets, 5.41).range_m) == len(order) - 1
    assert near(targets, 1.318).disagreement_rad < 0.02


def test_noise_and_snr_of_a_target_are_those_of_the_cramer_rao_bound(targets) -> None:
    found = near(targets, 2.0543)
    # 20 dB a sample at 600 counts, four receivers; the Hann window costs a factor sqrt(1.5).
    bound = phase_bound_m(20.0, SHORT, 4)
    assert found.noise_m / 1.2748 == pytest.approx(np.sqrt(1.5) * bound, rel=0.1)
    assert found.snr_db == pytest.approx(20 + 10 * np.log10(256 * 4 / 1.5), abs=0.5)


def test_without_a_usable_target_the_reason_is_given_and_nothing_is_returned(targets) -> None:
    with pytest.raises(UntrustedError, match=r"No fixed target .* 4\.4. m .*explains only|does not follow"):
        ranked(tuple(target for target in targets if target.objection))
    with pytest.raises(UntrustedError, match="detects no target"):
        ranked(())
    vague = replace(near(targets, 1.318), conversion_factor_std=0.05)
    with pytest.raises(UntrustedError, match=r"uncertain by ± 5\.0 %"):
        ranked((vague,))


def test_the_factors_deviation_covers_its_error_over_many_draws() -> None:
    time, pulls = np.arange(0, 20, 0.01), []
    for seed in range(16):
        motion = random_motion((0.5, 5.0), 0.5e-3, rng=np.random.default_rng(seed))
        samples = accelerometer(motion, 20.0, noise=1e-3, seed=seed)
        phase = np.angle(phasors(motion.displacement(time) / 1.5, 25.0, seed))
        found = align(time, phase, samples=samples, phase_per_m=UNIT)
        pulls.append((found.ratio - 1 / 1.5) / found.ratio_std)
    # 16 draws of a standard normal: their rms lies below 1.45 in 99 of 100 cases.
    assert np.sqrt(np.mean(np.square(pulls))) < 1.45


@pytest.mark.parametrize("share", [0.05, 0.2, 0.4])
def test_clutter_in_the_bin_shows_as_its_share_once_the_phase_turns(share: float) -> None:
    moved = 2e-3 * np.sin(np.linspace(0, 40, 4000))
    z = phasors(moved, 40.0) + share * np.exp(0.7j)
    # 4000 phasors with noise of 1 %.
    assert clutter_share(z, np.unwrap(np.angle(z))) == pytest.approx(share, abs=0.002)
    assert np.isnan(clutter_share(z[:20], np.zeros(20)))


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_what_is_attached_to_the_radar_is_taken_out_where_the_arc_is_long_enough(share: float) -> None:
    moved = 2e-3 * np.sin(np.linspace(0, 40, 4000))
    leak = share * np.exp(0.7j)
    z = phasors(moved, 40.0) + leak
    bent, straight = np.unwrap(np.angle(z)), np.unwrap(np.angle(z - static_centre(z)))
    # Uncorrected, a share e bends the phase by up to e rad: 0.02 mm rms at 0.1.
    assert np.std(bent / UNIT - moved) > 0.15e-3 * share
    assert np.std(straight / UNIT - moved) < 3e-6
    short = phasors(0.05e-3 * np.sin(np.linspace(0, 40, 4000)), 40.0) + leak
    assert static_centre(short) == 0


def test_phasors_that_lie_on_no_circle_are_left_alone() -> None:
    rng = np.random.default_rng(8)
    assert static_centre(rng.normal(size=500) + 1j * rng.normal(size=500)) == 0
    assert static_centre(np.full(10, 1 + 1j)) == 0


def test_receivers_add_up_in_phase_and_a_hole_in_one_leaves_the_others() -> None:
    rng = np.random.default_rng(6)
    gains = np.array([1.0, 0.8j, -1.1, 0.9 * np.exp(1j)])
    noise = (rng.normal(size=(3000, 4)) + 1j * rng.normal(size=(3000, 4))) * 0.1 / np.sqrt(2)
    signal = phasors(1e-3 * np.sin(np.linspace(0, 20, 3000)), 200.0)
    z = signal[:, None] * gains + noise
    weights = channel_weights(z)
    together = combined(z, weights)
    one, four = (np.std(np.angle(v / v.mean())) for v in (z[:, 0] / signal, together / signal))
    assert four / one == pytest.approx(1 / np.linalg.norm(gains), rel=0.06)
    valid = np.ones(z.shape, dtype=bool)
    valid[10, 2], valid[20] = False, False
    holed = combined(np.where(valid, z, 1e6), weights, valid)
    assert np.angle(holed[10] / together[10]) == pytest.approx(0, abs=0.15)
    assert abs(holed[10]) == pytest.approx(abs(together[10]), rel=0.15)
    assert np.isnan(holed[20])
    assert np.isinf(phase_variance(holed, 0.01)[20])


def test_the_noise_is_found_among_still_and_moving_things() -> None:
    rng = np.random.default_rng(7)
    noise = (rng.normal(size=(500, 2, 64)) + 1j * rng.normal(size=(500, 2, 64))) / np.sqrt(2)
    noise[:, :, 10] += 500
    noise[:, :, 20] += 100 * phasors(0.01 * np.sin(np.arange(500)), 300.0)[:, None]
    assert noise_variance(noise) == pytest.approx(1.0, rel=0.03)


def test_the_printed_grid_finds_factors_inside_it_and_none_outside() -> None:
    time = np.arange(0, 40, 0.01)
    motion = sine(0.1, 1.0)
    acceleration = motion.acceleration(time)
    inside = grid_factor(motion.displacement(time) / 1.2748, acceleration, RATE)
    # The trapezoids lose (omega dt)² / 6 at 1 Hz and the grid has steps of 0.001.
    assert inside.conversion_factor == pytest.approx(1.2748, abs=3e-3)
    assert inside.error_m < 1e-4
    assert grid_factor(motion.displacement(time) / 6.0, acceleration, RATE).conversion_factor == pytest.approx(2.0)
    negative = grid_factor(-motion.displacement(time) / 1.3, acceleration, RATE)
    assert negative.conversion_factor == pytest.approx(0.5)
    los = np.stack((motion.displacement(time) / 6.0, motion.displacement(time) / 1.2748))
    assert best_on_grid(los, acceleration, RATE)[0] == 1


def test_stored_targets_without_a_profile_are_examined_all_the_same() -> None:
    time = np.arange(0, 25, 0.01)
    moved = MOTION.displacement(time)
    stored = np.stack([phasors(moved / 1.2748, 30.0, 1), phasors(0 * moved, 30.0, 2)], axis=-1)[:, None]
    axis = RangeAxis(np.array([np.nan, np.nan]), SHORT.carrier_hz)
    first, still = find_targets(100 * stored, time, samples=accelerometer(MOTION, 25.0), axis=axis)
    assert first.conversion_factor == pytest.approx(1.2748, rel=1e-3)
    assert first.snr_db == pytest.approx(30.0, abs=0.5)
    assert "does not follow" in still.objection


def test_a_target_that_no_frame_but_the_mean_of_all_shows_is_found_with_its_factor() -> None:
    # Two receivers of 5 dB each, on 64 bins of noise.
    rng = np.random.default_rng(3)
    time = np.arange(FRAMES) / RATE
    z = (rng.normal(size=(FRAMES, 2, 64)) + 1j * rng.normal(size=(FRAMES, 2, 64))) / np.sqrt(2)
    z[:, :, 30] += 10 ** (5 / 20) * np.exp(1j * UNIT * MOTION.displacement(time) / 1.2)[:, None] * [1.0, 1j]
    axis = RangeAxis(np.arange(64) * SHORT.bin_m, CARRIER)
    best = ranked(find_targets(z, time, samples=SAMPLES, axis=axis))[0]
    assert best.place_bin == pytest.approx(30.0, abs=0.2)
    # Three of its deviations, and these are below 1 %.
    assert best.conversion_factor == pytest.approx(1.2, abs=3.0 * best.conversion_factor_std)
    assert best.relative_std < 0.01
    # Of 0.09 mm of noise in each frame the accelerometer explains nothing.
    assert best.coherence > 0.97
