"""The gain of an accelerometer, estimated with a slower sensor: as exact as the exact stamps allow, and no better."""

import numpy as np
import pytest

import midspan
from recording_edits import set_keys, write_displacement
from repeats import slow

LENGTH_S, NOISE_M, NOISE_M_S2, SAMPLES_HZ = 60.0, 1e-4, 2e-3, 100.0
# A slow swing and a vibration above the sensor's Nyquist frequency: m, Hz.
LINES = ((8e-3, 0.1), (3e-3, 10.3))


def write(folder, seed, gain=1.0):
    """A sensor of 10 Hz whose stamps are jittered by 15 ms, a quarter of them missing; returns its stamps (s) and the
    motion, m, as a function of s.
    """
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(LINES))

    def moved(time_s, order=0):
        return sum(
            a * (2.0 * np.pi * f) ** order * np.sin(2.0 * np.pi * f * time_s + p + 0.5 * np.pi * order)
            for (a, f), p in zip(LINES, phase, strict=True)
        )

    time = np.arange(0.0, LENGTH_S, 1.0 / SAMPLES_HZ)
    accel = gain * moved(time, 2) + 5e-3 + rng.normal(0.0, NOISE_M_S2, len(time))
    met = np.arange(0.1, LENGTH_S - 0.1, 0.1)
    met = np.sort(met + rng.uniform(-0.015, 0.015, len(met)))[rng.random(len(met)) > 0.25]
    write_displacement(folder, (time, accel), (met, 1e3 * (moved(met) + rng.normal(0.0, NOISE_M, len(met)))))
    set_keys(folder, "displacement", exposure_s=0, noise_time_s=0)
    return met, moved


def fisher_std(met, moved_m):
    """Standard deviation of the gain by the Fisher information of the exact stamps, all noise known.

    White acceleration noise of density q integrated twice from 0 on has the covariance q (s²t/2 − s³/6), s ≤ t; what it
    begins with and a constant bias make a parabola, which is projected out. Dense, without any filter.
    """
    early, later = np.minimum.outer(met, met), np.maximum.outer(met, met)
    covariance = NOISE_M_S2**2 / SAMPLES_HZ * early**2 * (later / 2.0 - early / 6.0) + NOISE_M**2 * np.eye(len(met))
    columns = np.column_stack((moved_m, np.ones_like(met), met, met * met))
    signal, *parabola = np.linalg.solve(np.linalg.cholesky(covariance), columns).T
    basis, _ = np.linalg.qr(np.column_stack(parabola))
    return 1.0 / np.linalg.norm(signal - basis @ (basis.T @ signal))


@pytest.mark.parametrize("seed", [2, *slow(3, 6)])
def test_the_gain_is_as_exact_as_the_stamps_allow(seed, tmp_path):
    met, moved = write(tmp_path, seed)
    least = fisher_std(met, moved(met))
    assert 2e-3 < least < 4e-3
    found = midspan.calibrate(tmp_path)
    # The noise levels are estimated from some 450 readings, to a few per cent.
    assert 0.85 * least < found.accelerometer_scale_std < 1.3 * least
    assert abs(found.accelerometer_scale - 1.0) < 3.5 * least


def test_a_gain_that_changes_the_result_is_a_note(tmp_path):
    write(tmp_path, 2, gain=1.013)
    found = midspan.estimate(tmp_path)
    (said,) = (one for one in found.warnings if one.code == "gain-estimated")
    known = found.calibration
    assert f"a gain of {known.accelerometer_scale:.5g} ± {known.accelerometer_scale_std:.2g}" in said
    assert said.severity == "note"
    assert (known.accelerometer_scale - 1.0) > 2.0 * known.accelerometer_scale_std


def test_an_estimated_gain_costs_the_result_little(tmp_path):
    errors = []
    for seed in (1, 2):
        _, moved = write(tmp_path, seed)
        for estimated in (True, False):
            set_keys(tmp_path, "accelerometer", estimate_scale=estimated)
            result = midspan.estimate(tmp_path)
            inner = (result.time_s > 2.0) & (result.time_s < LENGTH_S - 2.0)
            errors.append(np.mean((result.displacement_mm - 1e3 * moved(result.time_s))[inner] ** 2))
    with_gain, without = np.sqrt(errors[0] + errors[2]), np.sqrt(errors[1] + errors[3])
    # 0.32 % of 2.1 mm rms together with the result's own 0.034 mm: 1.02 on average, 1.05 for one and a half deviations.
    assert with_gain < 1.05 * without
