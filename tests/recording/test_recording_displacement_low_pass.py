"""What a displacement sensor shows of the accelerometer: a logger's low-pass, slow drift, cross motion."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

import midspan
from midspan.calibration.own_noise import noise_floor
from midspan.errors import UntrustedError
from recording_edits import set_keys, write_displacement
from repeats import slow

# A Butterworth low-pass of fourth order (its polynomial in s over the corner frequency), whose delay of slow motion is
# 2.613 over that.
BUTTERWORTH = Polynomial([1.0, 2.6131, 3.4142, 2.6131, 1.0])
CORNER_HZ, NOISE_MM, RATE_HZ = 5.0, 0.1, 5.0
DELAY_S = 2.6131 / (2 * np.pi * CORNER_HZ)
SIZE_MM, HERTZ = np.array([3.0, 2.0, 1.0]), np.array([0.6, 1.7, 3.9])


def write(folder, seed, *, low_pass=False, drift=0.0, average_s=0.0, length_s=70.0, noise_mm=NOISE_MM, early_s=0.0):
    """A recording of three swelling modes; returns its truth as a function of s, mm.

    drift: 1/f noise of the accelerometer, m/s² rms; average_s: exposure of the displacement sensor, whose stamps are
    early_s too early.
    """
    rng = np.random.default_rng(seed)
    # Each mode is a few lines that lie close together.
    hertz = (HERTZ[:, None] + rng.normal(0.0, 0.03, (3, 5)) * HERTZ[:, None]).ravel()
    size = np.repeat(SIZE_MM, 5) / np.sqrt(5.0) * np.exp(1j * rng.uniform(0.0, 6.28, 15))

    def moved(time, gain=1.0):
        return np.real(np.exp(2j * np.pi * np.outer(time, hertz)) @ (size * gain))

    time, met = np.arange(0.0, length_s, 0.01), np.arange(0.503, length_s - 0.5, 1.0 / RATE_HZ)
    passed = 1.0 / BUTTERWORTH(1j * hertz / CORNER_HZ) if low_pass else np.ones(15)
    accel = 1e-3 * moved(time, -((2 * np.pi * hertz) ** 2) * passed) + rng.normal(0.0, 2e-3, len(time))
    if drift:
        power = np.fft.rfft(rng.normal(size=2 * len(time)))
        power[1:] /= np.sqrt(np.arange(1, len(power)))
        power[0] = 0.0
        slow = np.fft.irfft(power)[: len(time)]
        accel += drift * slow / np.std(slow)
    height = moved(met, np.sinc(hertz * average_s)) + rng.normal(0.0, noise_mm, len(met))
    write_displacement(folder, (time, accel), (met - early_s, height))
    return moved


def test_a_logger_that_delays_is_no_clock(tmp_path):
    write(tmp_path, 1, low_pass=True)
    with pytest.raises(
        UntrustedError, match="low-pass in the accelerometer's logger delays and attenuates fast motion"
    ):
        midspan.estimate(tmp_path)


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_the_band_holds_what_a_low_pass_does_but_for_its_delay(tmp_path, seed):
    moved = write(tmp_path, seed, low_pass=True)
    set_keys(tmp_path, "displacement", estimate_offset=True)
    result = midspan.estimate(tmp_path)
    assert any("low-pass in the accelerometer's logger" in line for line in result.warnings)
    # The offset is the delay of slow motion, to a tenth of what it differs by up to the fastest mode (11 ms).
    assert result.calibration.displacement.offset.value_s == pytest.approx(DELAY_S, abs=1e-3)
    error = result.displacement_mm - moved(result.time_s - DELAY_S)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.9
    # The fastest mode, 0.7 mm rms, comes 11 ms later than slow motion.
    assert np.sqrt(np.mean(error**2)) < 2.0 * np.hypot(NOISE_MM, 0.7 * 2 * np.pi * HERTZ[2] * 0.011)


@pytest.mark.parametrize("method", ["smoother", *slow("kalman")])
def test_clocks_that_differ_are_in_the_band_where_they_are_said_to_be_one(method, tmp_path):
    # A noisy sensor of 5 Hz whose stamps are 30 ms early: what that makes, 0.4 mm rms, is below twice its noise.
    moved = write(tmp_path, 6, noise_mm=0.6, early_s=0.03)
    set_keys(tmp_path, "displacement", estimate_offset=False)
    result = midspan.estimate(tmp_path, method=method)
    assert any("clock seems to differ" in line for line in result.warnings)
    # Which of both clocks is right nobody knows: the band holds either.
    for late_s in (0.0, 0.03):
        error = result.displacement_mm - moved(result.time_s - late_s)
        assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85


@pytest.mark.parametrize("early_s", [0.3, *slow(0.02)])
def test_a_constant_offset_is_the_simplest_explanation_and_widens_no_band(early_s, tmp_path):
    moved = write(tmp_path, 6, noise_mm=0.4, early_s=early_s)
    result = midspan.estimate(tmp_path)
    assert [line.code for line in result.warnings] == ["clock-corrected"]
    assert result.calibration.displacement.apart_std_m == 0.0
    # To five of its deviations, which are 0.5 ms.
    assert result.calibration.displacement.offset.value_s == pytest.approx(early_s, abs=2.5e-3)
    error = result.displacement_mm - moved(result.time_s)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85
    # An honest band is as wide as the error; the 90 rows in a second of it are no independent ones.
    assert np.sqrt(np.mean(result.displacement_std_mm**2)) < 1.6 * np.sqrt(np.mean(error**2))


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_without_a_low_pass_none_is_found(tmp_path, seed):
    write(tmp_path, seed)
    set_keys(tmp_path, "displacement", estimate_offset=True)
    result = midspan.estimate(tmp_path)
    assert result.calibration.displacement.apart_std_m == 0.0
    assert not any("low-pass" in line for line in result.warnings)


def test_it_is_stored_and_read_again(tmp_path):
    write(tmp_path, 2, low_pass=True)
    set_keys(tmp_path, "displacement", estimate_offset=True)
    found = midspan.estimate(tmp_path).calibration
    again = midspan.load_calibration(found.save(tmp_path / "calibration.json"))
    assert again.displacement.apart_std_m == pytest.approx(found.displacement.apart_std_m)


def test_a_sensor_that_averages_over_its_interval_has_no_other_clock(tmp_path):
    moved = write(tmp_path, 4, average_s=0.2)
    result = midspan.estimate(tmp_path)
    assert result.calibration.displacement.exposure_s == pytest.approx(0.2, rel=0.05)
    error = result.displacement_mm - moved(result.time_s)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85


def test_an_accelerometer_that_drifts_is_no_slow_error_of_the_sensor(tmp_path):
    moved = write(tmp_path, 5, drift=0.03)
    result = midspan.estimate(tmp_path)
    # The sensor's readings are within some millimetres: its error cannot be larger.
    assert result.calibration.displacement.slow_std_m < 3e-3
    error = result.displacement_mm - moved(result.time_s)
    assert np.sqrt(np.mean(error**2)) < 3.0 * NOISE_MM
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85


def test_readings_have_no_more_noise_than_the_lowest_band_of_their_spectrum():
    time = np.arange(400) / RATE_HZ
    for seed in range(20):
        rng = np.random.default_rng(seed)
        moved = 5.0 * np.sin(2 * np.pi * 0.7 * time) + 2.0 * np.sin(2 * np.pi * 1.4 * time)
        floor = noise_floor(moved + rng.normal(0.0, 0.3, len(time)))
        # The least of six means of 16 squares lies 0.32 below one on average, and one scatters by 0.25.
        assert 0.4 < floor / 0.09 < 1.2
