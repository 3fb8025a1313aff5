"""Unwrapping: the limits of the plain and the aided way, and the filter that has neither."""

import numpy as np
import pytest
from radar_cases import CYCLE, RATE, UNIT, accelerometer, phasors, sine

from midspan.papers.printed.radar_phase import unwrap_aided
from midspan.papers.radar_002 import unwrap_plain
from midspan.radar.aligned import unwrap_aligned
from midspan.radar.alignment import align
from midspan.radar.unwrap import inertial_steps, wrapped
from midspan.simulate.motion.motion import Sines

TIME = np.arange(0, 20, 1 / RATE)


def error_cycles(phase: np.ndarray, moved: np.ndarray) -> float:
    """Largest error in cycles of the range change, its zero left free."""
    error = phase / UNIT - (moved - moved[0])
    return float(np.nanmax(np.abs(error - np.nanmedian(error[:50])))) / CYCLE


@pytest.mark.parametrize(("speed", "right"), [(0.090, True), (0.100, False)])
def test_plain_unwrapping_ends_at_a_quarter_of_a_wavelength_a_frame(speed: float, right: bool) -> None:
    moved = sine(speed, 1.0).displacement(TIME)
    assert (error_cycles(unwrap_plain(np.angle(phasors(moved, 60.0))), moved) < 0.5) == right


@pytest.mark.parametrize("speed", [0.1, 0.3, 1.0, 4.0])
def test_aided_unwrapping_has_no_limit_of_speed(speed: float) -> None:
    motion = sine(speed, 1.0)
    moved = motion.displacement(TIME)
    phase = np.angle(phasors(moved, 30.0))
    aided = unwrap_aided(phase, motion.acceleration(TIME), period_s=0.01, phase_per_m=UNIT)
    assert error_cycles(aided, moved) < 0.1


def test_aided_unwrapping_follows_its_equations_step_by_step() -> None:
    rng = np.random.default_rng(0)
    phase, acceleration = wrapped(np.cumsum(rng.normal(0, 1, 50))), rng.normal(0, 5, 50)
    expected = list(np.unwrap(phase[:2]))
    for k in range(2, 50):
        predicted = 2 * expected[-1] - expected[-2] + UNIT * 1e-4 * acceleration[k - 1]  # equations 12 and 13
        expected.append(phase[k] + 2 * np.pi * np.round((predicted - phase[k]) / (2 * np.pi)))  # 14 and 15
    got = unwrap_aided(phase, acceleration, period_s=0.01, phase_per_m=UNIT)
    np.testing.assert_allclose(got, expected, atol=1e-9)


def test_one_wrong_cycle_makes_the_aided_way_run_away_but_not_the_filter() -> None:
    motion = sine(0.1, 1.0)
    moved = motion.displacement(TIME)
    phase = np.angle(phasors(moved, 30.0))
    phase[900] += 3.0  # one bad frame
    aided = unwrap_aided(phase, motion.acceleration(TIME), period_s=0.01, phase_per_m=UNIT)
    assert error_cycles(aided, moved) > 100
    found, _ = unwrap_aligned(
        TIME,
        phase,
        variance_rad2=np.full(len(TIME), 5e-4),
        samples=accelerometer(motion, 20.0),
        phase_per_m=UNIT,
        ratio=1.0,
    )
    left = np.arange(len(TIME)) != 900
    assert error_cycles(found.phase_rad[left], moved[left]) < 0.1


def test_inertial_steps_are_the_exact_integrals_between_frames() -> None:
    motion = Sines(np.array([0.01, 0.002]), np.array([1.0, 4.0]))
    samples = np.column_stack((np.arange(-1, 6, 0.01), motion.acceleration(np.arange(-1, 6, 0.01))))
    frames = np.sort(np.random.default_rng(1).uniform(0, 5, 200))
    steps = inertial_steps(frames, samples)
    u, v = motion.displacement(frames), motion.velocity(frames)
    # The cubic spline through 100 Hz leaves 1e-4 of a motion of 4 Hz.
    np.testing.assert_allclose(steps[1:, 0], np.diff(v), atol=5e-6)
    np.testing.assert_allclose(steps[1:, 1], np.diff(u) - v[:-1] * np.diff(frames), atol=1e-7)


def slips(seed: int, *, snr_db: float, fades: float = 0.0, delay_s: float = 0.0, gain: float = 1.0, speed: float = 0.3):
    """Largest error in cycles of the frames that are used, and how often the cycle was a guess."""
    rng = np.random.default_rng(seed)
    motion = sine(speed, float(rng.choice([0.3, 1.0, 2.0])), rng.uniform(0, 2 * np.pi))
    moved = motion.displacement(TIME)
    variance = np.full(len(TIME), 0.5 * 10 ** (-snr_db / 10))
    for start in rng.uniform(4, 19, 2) if fades else ():
        variance[np.logical_and(start <= TIME, start + fades > TIME)] = np.inf
    samples = accelerometer(motion, 20.0, noise=3e-3, seed=seed, delay_s=delay_s, gain=gain)
    phase = np.angle(phasors(moved, snr_db, seed))
    found, _ = unwrap_aligned(TIME, phase, variance_rad2=variance, samples=samples, phase_per_m=UNIT, ratio=1.0)
    return error_cycles(found.phase_rad, moved), len(found.restarts)


@pytest.mark.parametrize("seed", range(5))
def test_no_slip_at_six_decibels_with_fades_a_late_clock_and_a_wrong_factor_together(seed: int) -> None:
    # A slip is an error of a whole cycle; at 6 dB the noise alone reaches half a cycle now and then.
    error, _ = slips(seed, snr_db=6.0, fades=0.2, delay_s=0.1 * (-1) ** seed, gain=1.2 if seed % 2 else 0.8)
    assert error < 0.8


@pytest.mark.parametrize("speed", [0.3, 1.0])
def test_a_dead_accelerometer_is_noticed_and_the_filter_goes_on_without(speed: float) -> None:
    moved = sine(speed, 1.0).displacement(TIME)
    still = np.column_stack((np.arange(-1, 21, 0.01), np.full(2200, 0.02)))
    found, alignment = unwrap_aligned(
        TIME,
        np.angle(phasors(moved, 20.0)),
        variance_rad2=np.full(2000, 5e-3),
        samples=still,
        phase_per_m=UNIT,
        ratio=1.0,
    )
    assert alignment is None
    assert error_cycles(found.phase_rad, moved) < 0.3


def test_alignment_finds_ratio_sign_and_offset_from_the_wrapped_phase_within_its_deviations() -> None:
    pulls = []
    for seed in range(6):
        motion = sine(0.2, 1.3, float(seed))
        ratio, offset = (-1 / 6.0, 0.8, 1 / 1.2748)[seed % 3], 0.013 * (seed - 2)
        phase = np.angle(phasors(ratio * motion.displacement(TIME + offset), 20.0, seed))
        found = align(TIME, phase, samples=accelerometer(motion, 20.0, noise=3e-3, seed=seed), phase_per_m=UNIT)
        pulls += [(found.ratio - ratio) / found.ratio_std, (found.offset_s - offset) / found.offset_std_s]
        assert found.ratio_std < 0.003 * abs(ratio)
        assert found.offset_std_s < 1e-3
    assert np.max(np.abs(pulls)) < 4.0


def test_a_motion_so_strong_that_second_differences_wrap_is_aligned_with_a_rough_ratio() -> None:
    motion = sine(2.0, 1.6)  # 20 m/s², where second differences of one frame wrap from 9.5 m/s² on
    moved, samples = motion.displacement(TIME), accelerometer(motion, 20.0, noise=3e-3, delay_s=0.04)
    phase = np.angle(phasors(moved, 20.0))
    found = align(TIME, phase, samples=samples, phase_per_m=UNIT, prior=1.3)
    assert found.ratio == pytest.approx(1.0, abs=1e-3)
    assert found.offset_s == pytest.approx(0.04, abs=1e-3)
    run, _ = unwrap_aligned(
        TIME, phase, variance_rad2=np.full(len(TIME), 5e-3), samples=samples, phase_per_m=UNIT, ratio=1.3
    )
    assert error_cycles(run.phase_rad, moved) < 0.3
    assert run.restarts == ()


def test_alignment_says_nothing_where_there_is_no_motion_or_another_one() -> None:
    quiet = np.angle(phasors(np.zeros(2000), 20.0))
    assert align(TIME, quiet, samples=accelerometer(sine(0.1, 1.0), 20.0), phase_per_m=UNIT) is None
    samples = accelerometer(Sines(np.array([0.0]), np.array([1.0])), 20.0)
    assert (
        align(TIME, np.angle(phasors(sine(0.1, 1.0).displacement(TIME), 20.0)), samples=samples, phase_per_m=UNIT)
        is None
    )


def test_an_outage_coasts_with_a_growing_deviation_and_a_return_that_cannot_be_sure_is_reported() -> None:
    motion = sine(0.05, 1.0)
    moved = motion.displacement(TIME)
    variance = np.full(len(TIME), 5e-3)
    variance[800:1300] = np.inf
    samples = accelerometer(motion, 20.0, noise=2e-2)
    found, _ = unwrap_aligned(
        TIME, np.angle(phasors(moved, 20.0)), variance_rad2=variance, samples=samples, phase_per_m=UNIT, ratio=1.0
    )
    assert np.isnan(found.phase_rad[800:1300]).all()
    assert (np.diff(found.filtered_variance_m2[800:1300]) > 0).all()
    assert found.restarts == (1300,)
    assert np.isfinite(found.phase_rad[:800]).all()


def test_the_filter_is_quieter_than_the_phase_and_its_deviation_covers_the_error() -> None:
    motion = sine(0.1, 0.5)
    moved = motion.displacement(TIME)
    found, _ = unwrap_aligned(
        TIME,
        np.angle(phasors(moved, 15.0)),
        variance_rad2=np.full(len(TIME), 0.5 * 10**-1.5),
        samples=accelerometer(motion, 20.0),
        phase_per_m=UNIT,
        ratio=1.0,
    )
    error = (found.filtered_m - moved)[500:]
    assert np.std(error) < 0.5 * np.std((found.phase_rad / UNIT - moved)[500:])
    z = (error - error.mean()) / np.sqrt(found.filtered_variance_m2[500:])
    assert np.std(z) < 1.3
