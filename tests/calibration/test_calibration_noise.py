"""Noise levels and clock offset of a displacement sensor of known unit."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_cases import OFFSET, broadband, observed, spoilt, tones

from midspan.calibration.fit import Pair, aligned
from midspan.calibration.noise import calibrate_noise, learn_motion
from midspan.calibration.sensors.fit import bias_of
from midspan.fusion.streams import NO_ERRORS, KalmanSettings, smooth
from midspan.records import Acceleration, Displacement, nanoseconds
from repeats import slow


def metres(motion, seed, noise_m=1e-4, **given):
    """Displacement in m with a relative variance of 1, so that the estimated factor is the variance itself."""
    pair = observed(motion, seed, scale=1.0, noise_px=noise_m, **given)
    return replace(pair, rows=np.column_stack((pair.rows[:, :2], np.ones(len(pair.rows)))))


@pytest.mark.parametrize("noise_m", [1e-4, *slow(2e-5, 1e-3)])
def test_noise_of_both_sensors_is_estimated(noise_m):
    fits = [calibrate_noise(metres(broadband(s), 200 + s, noise_m), 0.5) for s in range(4)]
    # 590 measurements give each variance to ± 6 %, the mean of four to ± 3 %.
    assert np.mean([f.variance_factor for f in fits]) == pytest.approx(noise_m**2, rel=0.08)
    # The accelerometer's level shows only in the band between; within a factor of two costs below 1 % of RMSE.
    assert 0.5 < np.median([f.input_noise.density for f in fits]) / (2e-3**2 / 100.0) < 2.0


def test_the_variance_given_with_a_measurement_counts_relatively():
    pair = metres(broadband(3), 3)
    rows = pair.rows * [1.0, 1.0, 4.0]
    one, four = calibrate_noise(pair, 0.0), calibrate_noise(replace(pair, rows=rows), 0.0)
    assert four.variance_factor == pytest.approx(one.variance_factor / 4.0, rel=1e-3)


@pytest.mark.parametrize("offset_s", [-0.3, *slow(0.05, 0.3)])
def test_the_clock_offset_is_estimated_where_the_motion_tells_it(offset_s):
    fit = calibrate_noise(metres(broadband(4), 4, offset_s=offset_s), 0.5)
    assert fit.offset.value_s == pytest.approx(offset_s, abs=1e-3)
    assert np.sqrt(fit.offset.variance) < 1e-3


def test_a_still_structure_leaves_the_clocks_be():
    fit = calibrate_noise(metres(tones(1, (1e-8, 1.0)), 5), 0.5)
    assert fit.offset.value_s == 0.0
    assert not np.isfinite(fit.offset.variance)
    assert fit.variance_factor == pytest.approx(1e-8, rel=0.2)


def test_no_search_leaves_the_offset_at_zero():
    assert calibrate_noise(metres(broadband(6), 6), 0.0).offset.value_s == 0.0


def test_the_apparent_scale_tells_a_wrong_unit():
    pair = metres(broadband(7), 7)
    fit = calibrate_noise(pair, 0.5)
    assert fit.scale == pytest.approx(1.0, abs=4.0 * fit.scale_std + 1e-3)
    turned = calibrate_noise(replace(pair, rows=pair.rows * [1.0, -1.0, 1.0]), 0.0)
    assert turned.scale < 0


def test_outliers_do_not_raise_the_estimated_noise():
    clean = metres(broadband(8), 8)
    rows = clean.rows * [1.0, 1e3, 1.0]
    dirty, _ = spoilt(replace(clean, rows=rows), 8)
    found = calibrate_noise(replace(dirty, rows=dirty.rows / [1.0, 1e3, 1.0]), 0.5)
    expected = calibrate_noise(clean, 0.5)
    assert found.variance_factor == pytest.approx(expected.variance_factor, rel=0.25)
    assert found.offset.value_s == pytest.approx(OFFSET, abs=1e-3)


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_outliers_in_bursts_are_found_and_no_others_even_at_the_start(seed):
    # A fifth of a slow sensor's values, 30 times their noise off, in bursts of one to six; the first five are wrong.
    rng = np.random.default_rng(seed)
    pair = metres(broadband(seed), seed, noise_m=3e-4, rate_hz=4.0, offset_s=0.0)
    n = len(pair.rows)
    begins = rng.choice(np.arange(8, n, 8), n // 36, replace=False)
    wrong = np.zeros(n, dtype=bool)
    for begin, length in zip((0, *begins), (5, *rng.integers(1, 7, len(begins))), strict=True):
        wrong[begin : begin + length] = True
    rows = pair.rows.copy()
    rows[wrong, 1] += rng.choice([-1.0, 1.0], n)[wrong] * rng.uniform(20, 60, n)[wrong] * 3e-4
    found = calibrate_noise(replace(pair, rows=rows), 0.0)
    marked = ~np.isfinite(found.findings.pair.rows[:, 2])
    assert np.all(marked[wrong])
    # One of a hundred good ones at most, which take less than a tenth of the noise with them.
    assert np.mean(marked[~wrong]) <= 0.02
    # Some 180 values are left: ± 11 % of the variance.
    assert found.variance_factor == pytest.approx(9e-8, rel=0.4)


@pytest.mark.parametrize("length_s", [15.0, 30.0, 60.0])
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_a_bias_that_drifts_is_reported_from_none_in_a_record_of_any_length(length_s, seed):
    whole = metres(broadband(seed), seed, offset_s=0.0)
    samples, rows = (one[one[:, 0] < length_s] for one in (whole.samples, whole.rows))
    found = [
        calibrate_noise(replace(whole, samples=samples + np.outer(samples[:, 0], [0.0, rate, 0.0]), rows=rows), 0.0)
        # 0.2 m/s² a minute, as electronics that warm up.
        for rate in (0.0, 0.2 / 60.0)
    ]
    pairs = [one.findings.pair for one in found]
    assert [pair.bias_drifts for pair in pairs] == [False, True]
    # The drift is no noise.
    still, drifting = (np.sqrt(one.input_noise.density) for one in found)
    assert drifting == pytest.approx(still, rel=0.5)
    rates = [bias_of(pair, one.findings.fit).drift_m_s3 for pair, one in zip(pairs, found, strict=True)]
    assert rates == [0.0, pytest.approx(0.2 / 60.0, rel=0.05)]


@pytest.mark.parametrize("drifts", [False, True])
def test_whitened_innovations_are_those_of_the_filter(drifts):
    # Second route: the fusion filter itself, on the scaled signals, with the same noise levels and no gate.
    pair = replace(metres(broadband(9), 9, offset_s=0.0), bias_drifts=drifts)
    density, noise = 2e-3**2 / 100.0, 1e-8
    w = aligned(pair, 0.0).whitened((density / noise * pair.rate_hz) ** 0.25)
    time_ns = nanoseconds(pair.samples[:, 0])
    acceleration = Acceleration(time_ns, pair.samples[:, 1], np.full(len(time_ns), density))
    met = nanoseconds(pair.rows[:, 0])
    # A start and a bias, and one that drifts at one rate, a cubic of the displacement, are taken out of ours.
    seconds = pair.rows[:, 0]
    apart = pair.rows[:, 1] - pair.responses[0].at(seconds)
    moved = pair.rows[:, 1] - np.polynomial.Polynomial.fit(seconds, apart, 3 if drifts else 2)(seconds)
    displacement = Displacement(met, moved, np.full(len(met), noise), np.full(len(met), 4, dtype=np.uint8))
    settings = KalmanSettings(
        bias_walk=0.003 * density,
        displacement_std=3.0,
        velocity_std=3.0,
        bias_std=3.0,
        rates=NO_ERRORS,
        noise_memory=np.inf,
    )
    innovation = smooth(acceleration, displacement, settings).innovation
    later = slice(100, None)
    ours = (w.translation - w.response)[later]
    # The two differ in the start, forgotten after ten seconds.
    np.testing.assert_allclose(ours, innovation.value_m[3:][later], atol=1e-3 * np.std(ours))
    np.testing.assert_allclose(noise * w.variance[later], innovation.variance_m2[3:][later], rtol=1e-3)


@pytest.mark.parametrize(("density", "noise_m"), [(1e-4, 1e-5), (1e-4, 1e-3), (1e-7, 1e-5)])
def test_the_strength_of_a_motion_without_an_accelerometer_is_estimated_from_its_displacement(density, noise_m):
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        # White acceleration in steps of 1 ms, integrated twice: exactly the model, but for its step.
        shaken = np.sqrt(density * 1000.0) * rng.standard_normal(60_000)
        moved = np.cumsum(np.cumsum(shaken)) * 1e-6
        frame = np.arange(50, 60_000, 100)
        value = moved[frame] + noise_m * rng.standard_normal(len(frame))
        rows = np.column_stack((frame / 1000.0, value - value[0], np.full(len(frame), noise_m**2)))
        time = np.arange(0.0, 60.0, 0.01)
        samples = np.column_stack((time, np.zeros(len(time)), np.ones(len(time))))
        found.append(learn_motion(Pair(samples, rows, 1.0)))
    # 600 frames tell a variance to 6 % at best; where the noise hides the fast part, fewer count. The mean of six.
    assert np.exp(np.mean(np.log(found))) == pytest.approx(density, rel=0.25)


@pytest.mark.parametrize(("offset_s", "max_offset_s"), [(0.1, 0.5), *slow((0.0, 0.0), (0.1, 0.0))])
def test_a_reversed_sign_is_far_more_likely_turned_round(offset_s, max_offset_s):
    pair = metres(broadband(8), 8, offset_s=offset_s if max_offset_s else 0.0)
    turned = replace(pair, rows=pair.rows * [1.0, -1.0, 1.0])
    # Twenty in the logarithm is one chance in 10^8; the right sign must be as clear the other way.
    assert calibrate_noise(pair, max_offset_s).reversed_gain < -20.0
    assert calibrate_noise(turned, max_offset_s).reversed_gain > 20.0
