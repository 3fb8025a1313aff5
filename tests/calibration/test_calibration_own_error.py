"""The slow error of a camera: found where one is, by its size and frequency; none in clean records; whose it is."""

import numpy as np
import pytest
from calibration_cases import OFFSET, SCALE, broadband, observed
from scipy.linalg import expm
from scipy.ndimage import gaussian_filter1d

from midspan.calibration.fit import Pair
from midspan.calibration.noise import calibrate_noise
from midspan.calibration.own_noise import contradiction
from midspan.calibration.scale import calibrate_scale
from repeats import slow


def course(seed, time_s, *, rate, omega):
    """An error (n,) of standard deviation 1: first-order Gauss-Markov, with omega a damped oscillator."""
    rng = np.random.default_rng(seed)
    dynamics = np.array([[0.0, omega], [-omega, -2.0 * rate]]) if omega else -rate * np.eye(2)
    state, found = rng.normal(size=2), np.empty(len(time_s))
    for k, lapse in enumerate(np.diff(time_s, prepend=time_s[0])):
        step = expm(dynamics * lapse)
        values, axes = np.linalg.eigh(np.eye(2) - step @ step.T)
        state = step @ state + axes @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=2))
        found[k] = state[0]
    return found


def erring(seed, size_px, **kind):
    """Half a minute and more of a structure of 3 mm, seen with an error of a size in px rms."""
    pair = observed(broadband(seed), seed)
    rows = pair.rows.copy()
    error = course(seed, rows[:, 0], **kind)
    rows[:, 1] += size_px * (error - error[0]) / np.std(error)
    return Pair(pair.samples, rows)


@pytest.mark.parametrize(("hertz", "lasts_s"), [(0.3, 20.0), (0.9, 4.0)])
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_a_mast_that_nods_is_found_by_its_frequency_and_size(hertz, lasts_s, seed):
    found = calibrate_scale(erring(seed, 0.4, rate=1.0 / lasts_s, omega=2.0 * np.pi * hertz), 0.1)
    assert found.own is not None
    assert found.own.hertz == pytest.approx(hertz, rel=0.15)
    # Some ten oscillations tell the size to a third.
    assert found.own.std == pytest.approx(0.4, rel=0.5)
    assert abs(found.scale.value_m_per_px / SCALE - 1.0) < 4.0 * np.sqrt(found.scale.variance) / abs(SCALE)


@pytest.mark.parametrize("late_s", [0.02, -0.02])
def test_a_clock_that_steps_is_no_mast_that_nods(late_s):
    pair = observed(broadband(1), 1)
    rows = pair.rows.copy()
    after = rows[:, 0] > np.mean(rows[[0, -1], 0])
    rows[after, 0] += late_s
    found = calibrate_scale(Pair(pair.samples, rows[np.r_[True, np.diff(rows[:, 0]) > 0.0]]), 0.1)
    assert found.own is None
    assert any("clock jumps" in str(line) for line in found.warnings)
    assert abs(found.scale.value_m_per_px / SCALE - 1.0) < 4.0 * np.sqrt(found.scale.variance) / abs(SCALE) < 0.02


@pytest.mark.parametrize("seed", [1, *slow(2, 3)])
def test_hot_air_is_found(seed):
    found = calibrate_scale(erring(seed, 0.4, rate=1.0 / 2.0, omega=0.0), 0.1)
    assert found.own is not None
    assert 0.2 < found.own.std < 0.8
    assert 0.5 < found.own.time_s < 10.0


def test_a_clean_camera_has_none():
    assert all(calibrate_scale(observed(broadband(seed), seed), 0.1).own is None for seed in range(6))


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_a_line_of_the_accelerometer_is_not_the_cameras(seed):
    # An alias at 0.4 Hz of 1.2 mm rms of displacement, which no camera sees.
    pair = observed(broadband(seed), seed)
    samples = pair.samples.copy()
    samples[:, 1] += 1.7e-3 * (2.0 * np.pi * 0.4) ** 2 * np.sin(2.0 * np.pi * 0.4 * samples[:, 0])
    found = calibrate_scale(Pair(samples, pair.rows), 0.1)
    assert found.own is None or not found.own.alone


@pytest.mark.parametrize("lasts_s", [3.0, 7.0])
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_an_error_that_is_smooth_over_some_frames_has_its_size(lasts_s, seed):
    # Air that an exposure averages: its spectrum falls far faster than a Gauss-Markov process' from 1 Hz on, and a fit
    # to all frames found a third to an eighth of its size.
    pair = observed(broadband(seed), seed)
    rows = pair.rows.copy()
    error = course(seed, rows[:, 0], rate=1.0 / lasts_s, omega=0.0)
    rate_hz = (len(rows) - 1) / float(rows[-1, 0] - rows[0, 0])
    error = gaussian_filter1d(error, 0.08 * rate_hz)
    rows[:, 1] += 0.4 * (error - error[0]) / np.std(error)
    found = calibrate_scale(Pair(pair.samples, rows), 0.1)
    assert found.own is not None
    # Half a minute holds ten of its times at most.
    assert 0.5 < found.own.std / 0.4 < 2.5


def measured(seed, size_m, **kind):
    """A displacement sensor (0.4 mm) with an error of a size in m rms, on the same structure."""
    pair = observed(broadband(seed), seed, noise_px=0.4e-3, scale=1.0, offset_s=0.0)
    rows = pair.rows.copy()
    error = course(seed, rows[:, 0], **kind)
    rows[:, 1] += size_m * error / np.std(error)
    rows[:, 2] = 1.0
    return Pair(pair.samples, rows)


@pytest.mark.parametrize("hertz", [0.2, 0.5])
@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_a_displacement_sensor_that_nods_on_its_mast_is_found(hertz, seed):
    found = calibrate_noise(measured(seed, 1.5e-3, rate=0.02 * hertz, omega=2.0 * np.pi * hertz), 0.0)
    assert found.sway is not None
    assert found.sway.hertz == pytest.approx(hertz, rel=0.1)
    # The estimator has it as it was found.
    assert found.slow_hz == (pytest.approx(found.sway.hertz) if found.sway.taken else 0.0)
    # A minute is one draw of what forgets in a minute: its size is told to a half.
    assert found.sway.std == pytest.approx(1.5e-3, rel=0.5)


def test_a_clean_displacement_sensor_does_not_nod():
    assert all(calibrate_noise(measured(seed, 0.0, rate=1.0, omega=0.0), 0.0).sway is None for seed in range(4))


@pytest.mark.parametrize("seed", [1, *slow(2, 3)])
def test_air_that_shimmers_less_than_the_accelerometer_notices_is_found(seed):
    # 0.15 px over 4 s: too little for the accelerometer's noise to have to grow, and seven times a frame's noise.
    found = calibrate_scale(erring(seed, 0.15, rate=1.0 / 4.0, omega=0.0), 0.1)
    assert found.own is not None
    assert 0.07 < found.own.std < 0.3


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_a_bias_that_walks_is_no_motion_of_the_camera(seed):
    # Three vehicles pass while the bias walks by 2 mm/s² in a minute: integrated twice that is millimetres, at
    # frequencies at which the camera's motion hides whose it is. It was booked as 2 to 4 mm that the camera moves by.
    pair = observed(broadband(seed, 1e-3), seed, noise_px=0.003)
    rows, samples = pair.rows.copy(), pair.samples.copy()
    for at_s, width_s, size_m in ((12.0, 2.0, 8e-3), (30.0, 3.5, 12e-3), (45.0, 2.5, -9e-3)):
        u = (rows[:, 0] + OFFSET - at_s) / width_s
        rows[:, 1] += size_m * np.exp(-0.5 * u * u) / SCALE
        u = (samples[:, 0] - at_s) / width_s
        samples[:, 1] += size_m * np.exp(-0.5 * u * u) * (u * u - 1.0) / width_s**2
    samples[:, 1] += 2e-5 * np.cumsum(np.random.default_rng(seed).normal(size=len(samples)))
    found = calibrate_scale(Pair(samples, rows), 0.1)
    assert found.own is None
    assert contradiction(found.search.pair, found.search.fit) == 0.0
