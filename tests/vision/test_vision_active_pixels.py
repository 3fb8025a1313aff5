import numpy as np
import pytest

from midspan.vision.active_pixels import by_amplitude, by_correlation, slope_and_r_squared

FRAMES = 200
MOTION = 0.3 * np.sin(0.7 * np.arange(FRAMES))


def phases(slopes, noise, seed=0):
    """(n, k) phases that follow MOTION with each pixel's slope and noise."""
    rng = np.random.default_rng(seed)
    clean = np.outer(MOTION, slopes)
    return (clean + rng.normal(0, 1, clean.shape) * noise).astype(np.float32)


def test_regression_of_phase_on_translation_is_not_flattened_by_noise_in_the_phase():
    slope, r_squared = slope_and_r_squared(phases(np.full(400, -1.2), 0.25), MOTION)
    # Variance of 0.3 sin is 0.045: R² = 1.44 · 0.045 / (1.44 · 0.045 + 0.0625) = 0.509. The other way round the
    # gain would come out at 0.509 of itself.
    assert slope.mean() == pytest.approx(-1.2, rel=0.01)
    assert r_squared.mean() == pytest.approx(0.509, abs=0.02)


def test_still_and_noisy_pixels_are_left_out_and_the_gain_is_that_of_the_others():
    slopes = np.concatenate([np.full(60, -1.25), np.zeros(40)])
    noise = np.concatenate([np.full(60, 0.05), np.full(40, 1.0)])
    selection = by_correlation(phases(slopes, noise), MOTION)
    assert not selection.active[60:].any()
    assert selection.active[:60].mean() > 0.5
    assert selection.gain_px_per_rad == pytest.approx(-0.8, rel=0.005)
    assert selection.r_squared > 0.999


def test_more_pixels_explain_more_than_any_alone():
    phase = phases(np.full(80, -1.0), 0.2)
    alone = slope_and_r_squared(phase, MOTION)[1].max()
    selection = by_correlation(phase, MOTION)
    # Noise of independent pixels averages: 1 - R² falls with their number.
    assert 1 - selection.r_squared < (1 - alone) / 20
    assert selection.active.sum() > 60


def test_least_information_keeps_pixels_when_noise_in_the_motion_limits_r_squared():
    # With 0.02 px of noise in the reference motion every pixel has the same R², and the maximum falls on a few.
    rng = np.random.default_rng(3)
    phase = phases(np.full(500, -1.0), 0.01)
    noisy = MOTION + rng.normal(0, 0.02, FRAMES)
    bare = by_correlation(phase, noisy, least_information=0.0)
    kept = by_correlation(phase, noisy, information=np.ones(500), least_information=0.5)
    assert bare.active.sum() < 250
    assert kept.active.sum() >= 250
    assert kept.r_squared == pytest.approx(bare.r_squared, abs=1e-3)


def test_amplitude_rule_is_a_fifth_of_the_mean_of_the_thirty_largest():
    amplitude = np.full((10, 10), 3.0)
    amplitude[:3] = 10.0  # thirty pixels: the threshold is 2
    amplitude[9, :5] = 1.9
    active = by_amplitude(amplitude)
    assert active.sum() == 95
    assert not active[9, :5].any()
