"""What is said where the radar cannot know: variances that cover, dead accelerometers, outages, hand-over."""

from dataclasses import replace

import numpy as np
import pytest
from radar_cases import CYCLE, RATE, SHORT, UNIT, accelerometer, phasors, profiles_of, sine

from midspan.radar.aligned import unwrap_aligned
from midspan.radar.alignment import align
from midspan.radar.measurement import TargetFrames, displacement
from midspan.radar.peaks import at_place
from midspan.radar.phase_noise import bending, factor_spread, measured_variance, modulation, slip_variance
from midspan.radar.several import SeveralTargets
from midspan.radar.target import Target, find_targets, ranked
from midspan.simulate.motion.motion import Sines, random_motion
from midspan.simulate.radar.signal import RadarModel, Reflector, noise_for

TIME = np.arange(0, 20, 1 / RATE)


def test_the_noise_of_a_phase_is_found_under_a_motion_and_a_cycle_that_was_lost() -> None:
    rng = np.random.default_rng(0)
    phase = UNIT * sine(0.1, 1.0).displacement(TIME) + rng.normal(0, 0.03, 2000)
    phase[700:] += 2 * np.pi
    phase[100:130] = np.nan
    # 2000 values, of which neighbours share noise: 5 %.
    assert np.sqrt(measured_variance(phase, np.zeros(2000))) == pytest.approx(0.03, rel=0.08)
    assert np.isnan(measured_variance(phase[:40], np.zeros(40)))


@pytest.mark.parametrize("share", [0.0, 0.05, 0.2])
def test_another_reflector_bends_the_phase_by_what_it_modulates_the_amplitude(share: float) -> None:
    moved = 5e-3 * np.sin(np.linspace(0, 40, 6000))
    z = phasors(moved, 30.0) + share * np.exp(1j * (0.4 * UNIT * moved + 1.0))
    phase = np.unwrap(np.angle(z))
    found = modulation(z, phase, 1e-3)
    bent = np.std(phase - UNIT * moved)
    assert found**2 + 0.5e-3 == pytest.approx(bent**2, rel=0.12)
    assert np.isnan(modulation(z[:60], phase[:60] * 0, 1e-3))


def test_the_bend_counts_twice_and_less_where_the_phase_hardly_turns() -> None:
    assert bending(0.1, np.array([0.0, np.nan, -30.0])) == pytest.approx(0.02)
    assert bending(0.1, np.array([0.0, 0.1])) == pytest.approx(2 * 0.01 * 0.005, rel=0.01)
    assert bending(0.1, np.full(3, np.nan)) == 0


def test_the_conversion_factors_deviation_is_that_of_its_errors_for_either_accelerometer() -> None:
    pulls, errors = [], []
    at = np.arange(0, 30, 1 / RATE)
    for seed in range(32):
        noise, size = (5e-5, 3e-3)[seed % 2], (0.2e-3, 2e-3)[seed // 2 % 2]
        motion = random_motion((0.5, 4.0), size / 2.5, rng=np.random.default_rng(seed))
        phase = np.angle(phasors(motion.displacement(at) / 1.2748, 30.0, seed))
        found = align(at, phase, samples=accelerometer(motion, 30.0, noise=noise, seed=seed), phase_per_m=UNIT)
        errors.append(found.ratio * 1.2748 - 1)
        pulls.append(errors[-1] / (found.ratio_std * 1.2748))
    # The rms of 32 standard normal values lies between 0.75 and 1.24 in 95 of 100 cases; seeds are fixed.
    assert 0.8 < np.sqrt(np.mean(np.square(pulls))) < 1.25
    # The noise of the MEMS accelerometer would shrink the ratio by 0.4 % at 0.2 mm; means of eight scatter by 0.2 %.
    assert abs(np.mean(errors[1::4])) < 0.004


def test_clutter_widens_the_factor_where_the_phase_hardly_turns_and_not_where_it_turns_often() -> None:
    assert factor_spread(0.05, 0.0, 0.1) == pytest.approx(0.05, rel=0.01)
    assert factor_spread(0.05, 0.0, 10.0) < 1e-6
    assert factor_spread(np.nan, 0.1, 0.2) == pytest.approx(0.1 / np.sqrt(2), rel=0.05)
    assert factor_spread(np.nan, 0.1, 3.0) < 1e-4


@pytest.mark.parametrize("seed", range(4))
def test_errors_lie_within_their_deviation_with_clutter_and_phase_noise(seed: int) -> None:
    rng = np.random.default_rng(40 + seed)
    motion = random_motion((0.3, 3.0), (1e-3, 3e-3)[seed % 2], rng=rng)
    clutter = Reflector(
        1.318 + rng.uniform(-0.05, 0.05), 1000 * rng.uniform(0.05, 0.2), (0.0, 0.5, -0.7)[seed % 3], 0.4
    )
    view = (Reflector(1.318, 1000.0, 1 / 1.2748), clutter)
    model = RadarModel(view, replace(SHORT, receivers=2), noise_for(1000.0, 5.0), phase_noise_rad=0.01)
    at, samples = model.frame_s(3000), accelerometer(motion, 30.0, noise=3e-3, seed=seed)
    profiles = profiles_of(model, motion, 3000, seed)[:, :, :60]
    axis = replace(SHORT.axis, range_m=SHORT.axis.range_m[:60])
    target = min(
        find_targets(profiles[:2000], at[:2000], samples=samples, axis=axis), key=lambda t: abs(t.range_m - 1.3)
    )
    frames = TargetFrames(at, at_place(profiles, target.place_bin), np.ones((3000, 2), dtype=bool))
    series = displacement(frames, target, samples=samples, phase_per_m=SHORT.phase_per_m(1.318))
    true = motion.displacement(at)
    # The zero is that of the first frame with its noise: left out here.
    error = series.value_m - true - np.mean(series.value_m - true)
    deviation = np.sqrt(series.variance_m2 + (target.relative_std * (true - true.mean())) ** 2)
    assert np.mean(np.abs(error) < 1.96 * deviation) > 0.93
    # And it is no bigger than it must be.
    assert np.median(deviation) < 2.5 * np.std(error)
    assert (series.noise_variance_m2 <= series.variance_m2).all()


def test_a_tree_in_the_wind_comes_after_a_wall_that_echoes_less() -> None:
    motion = random_motion((0.3, 3.0), 1e-3, rng=np.random.default_rng(2))
    tree = Reflector(4.1, 2200.0, 1.0, 0.3, own=random_motion((0.2, 1.5), 0.4e-3, rng=np.random.default_rng(6)))
    model = RadarModel((Reflector(7.46, 1000.0), tree), SHORT, noise_for(1000.0, 0.0))
    at = model.frame_s(3000)
    samples = accelerometer(motion, 30.0)
    found = find_targets(profiles_of(model, motion, 3000), at, samples=samples, axis=SHORT.axis)
    assert ranked(found)[0].range_m == pytest.approx(7.46, abs=0.03)
    moving = min(found, key=lambda target: abs(target.range_m - 4.1))
    # Its own motion is 0.4 mm, of which what is below 0.5 Hz hardly shows.
    assert 0.1e-3 < moving.own_m < 0.8e-3
    assert ranked(found)[0].own_m < 5e-6


@pytest.mark.parametrize("seed", range(4))
def test_a_dead_accelerometer_at_six_decibels_is_told_with_a_growing_variance(seed: int) -> None:
    motion = sine(0.3, 1.0, float(seed))
    rng = np.random.default_rng(seed)
    samples = np.column_stack((np.arange(-1, 21, 0.01), 0.02 + 1e-4 * rng.normal(size=2200)))
    target = Target(24.4, 1.318, 1.0, 6.0, np.ones(1, dtype=complex), 0.0, 1.0, 0.001, 0.0, 0.0, 1.0)
    z = phasors(motion.displacement(TIME), 6.0, seed)[:, None]
    frames = TargetFrames(TIME, z, np.ones((2000, 1), dtype=bool))
    series = displacement(frames, target, samples=samples, phase_per_m=UNIT)
    assert not series.explained
    assert "does not explain" in series.warnings[0]
    seen = np.flatnonzero(np.isfinite(series.value_m))
    assert series.variance_m2[seen[-1]] > CYCLE**2
    alive = displacement(frames, target, samples=accelerometer(motion, 20.0, noise=3e-3), phase_per_m=UNIT)
    assert alive.explained
    assert alive.warnings == ()
    assert np.nanmax(alive.variance_m2[np.isfinite(alive.value_m)]) < (0.3 * CYCLE) ** 2


def test_the_chance_of_a_slip_is_none_in_small_innovations_and_whole_cycles_in_scattered_ones() -> None:
    rng = np.random.default_rng(1)
    assert slip_variance(rng.normal(0, 0.3, 2000))[-1] < 1e-6
    many = slip_variance(rng.uniform(-np.pi, np.pi, 2000))
    assert many[-1] > (2 * np.pi) ** 2 * 100
    assert (np.diff(many) >= 0).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_record_that_begins_in_full_swing_does_not_slip(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = Sines(np.array([0.3 / (2 * np.pi * 1.3)]), np.array([1.3]), phase_rad=rng.uniform(0, 6.3))
    moved = motion.displacement(TIME)
    found, _ = unwrap_aligned(
        TIME,
        np.angle(phasors(moved, 8.0, seed)),
        variance_rad2=np.full(2000, 0.5 * 10**-0.8),
        samples=accelerometer(motion, 20.0, noise=3e-3, seed=seed),
        phase_per_m=UNIT,
        ratio=1.1,
    )
    error = found.phase_rad / UNIT - moved
    assert np.max(np.abs(error - np.median(error))) < 0.8 * CYCLE
    assert found.restarts == ()


@pytest.mark.parametrize("seed", range(10))
def test_an_outage_of_everything_coasts_and_ends_in_a_known_cycle_or_a_new_datum(seed: int) -> None:
    rng = np.random.default_rng(60 + seed)
    bin_m = (SHORT.bin_m, 0.234)[seed % 2]
    motion = random_motion((0.2, 4.0), rng.uniform(0.5e-3, 5e-3), rng=rng)
    time, length = np.arange(0, 30, 1 / RATE), 10 ** rng.uniform(-0.7, 1.0)
    moved, share = motion.displacement(time), rng.uniform(0.0, 0.15)
    turn = UNIT * moved * rng.choice([1.0, 0.5, 1.7]) + rng.uniform(0, 6)
    blocked = (time >= 12) & (time < 12 + length)
    z = np.where(blocked, 0.0, np.exp(1j * UNIT * moved)) * (1 + share * np.exp(-1j * turn)) + 0.02 * (
        rng.normal(size=3000) + 1j * rng.normal(size=3000)
    )
    # A reflector beside the target pulls the range by its share of up to a bin over pi, as it turns.
    coarse = 6.3 + moved + share * bin_m / np.pi * np.sin(turn) + rng.normal(0, 0.02 * bin_m, 3000)
    target = Target(24.4, 1.318, 1.0, 31.0, np.ones(1, dtype=complex), 0.0, 1.0, 0.001, 0.0, 0.0, 1.0)
    frames = TargetFrames(time, z[:, None], np.ones((3000, 1), dtype=bool), coarse)
    samples = accelerometer(motion, 30.0, noise=3e-3, seed=seed)
    series = displacement(frames, target, samples=samples, phase_per_m=UNIT)
    inside = np.flatnonzero(blocked)
    assert np.isnan(series.value_m[inside]).all()
    assert np.isinf(series.variance_m2[inside]).all()
    assert (np.diff(series.predicted_variance_m2[inside]) > 0).all()
    error = series.range_change_m - moved
    jump = np.nanmedian(error[time > 12 + length]) - np.nanmedian(error[time < 12])
    assert abs(jump) < 0.5 * CYCLE or series.new_datum[inside[-1] + 1 : inside[-1] + 30].any()


def test_a_target_that_lost_its_cycle_is_handed_over_without_a_step() -> None:
    rng = np.random.default_rng(3)
    true = 5e-3 * np.sin(2 * np.pi * 0.7 * np.arange(4000) / RATE)
    value = true + 5e-6 * rng.normal(size=(2, 4000))
    variance = np.full((2, 4000), 25e-12)
    variance[0, 1500:1700], value[0, 1700:] = np.inf, value[0, 1700:] + 3 * CYCLE
    lost = np.zeros((2, 4000), dtype=bool)
    lost[0, 1700] = True
    found, _, datum = SeveralTargets(2, RATE).push(value, variance, lost)
    assert not datum.any()
    # Offsets over 1000 frames of 7 µm: no step beyond the noise.
    assert np.max(np.abs(found - true)) < 6 * 5e-6
    assert np.std((found - true)[3000:]) < 0.8 * 5e-6
