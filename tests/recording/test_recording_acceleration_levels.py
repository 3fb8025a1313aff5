"""An accelerometer that is noisier for a part of the record: the noise is its own, not that of the other sensor."""

import numpy as np
import pytest

import midspan
from recording_edits import write_displacement
from repeats import slow

NOISE_MM, NOISY_S, NOISY_M_S2 = 0.3, (40.0, 70.0), 0.3


@pytest.mark.parametrize("seed", [1, *slow(0)])
def test_a_part_in_which_the_accelerometer_errs_is_no_noise_of_the_sensor(seed, tmp_path):
    rng = np.random.default_rng(seed)
    size, hertz, phase = np.array([3.0, 2.0, 0.8]), np.array([0.5, 1.3, 2.9]), rng.uniform(0, 6.28, 3)

    def moved(time, shrunk=1.0):
        return np.sin(2 * np.pi * np.outer(time, hertz) + phase) @ (size * shrunk)

    time, met = np.arange(0.0, 120.0, 0.01), np.arange(0.503, 119.5, 0.1)
    accel = 1e-3 * moved(time, -((2 * np.pi * hertz) ** 2)) + rng.normal(0.0, 2e-3, len(time))
    noisy = (time > NOISY_S[0]) & (time < NOISY_S[1])
    accel[noisy] += rng.normal(0.0, NOISY_M_S2, np.count_nonzero(noisy))
    write_displacement(tmp_path, (time, accel), (met, moved(met) + rng.normal(0.0, NOISE_MM, len(met))))
    result = midspan.estimate(tmp_path)
    # 1190 readings tell their noise to 2 %, and the accelerometer's noise takes as much again. It was 0.21 and 0.97.
    assert 1e3 * result.calibration.displacement.noise_std_m == pytest.approx(NOISE_MM, rel=0.1)
    error = result.displacement_mm - moved(result.time_s)
    # 2 % more or less by the few independent errors of two minutes.
    assert 0.9 < np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) < 0.985
    # Interpolation alone leaves the sensor's own noise.
    assert np.sqrt(np.mean(error**2)) < 0.8 * NOISE_MM
