"""Noise of the accelerometer that goes with the motion: found where there is any, and none where there is not."""

from dataclasses import replace

import numpy as np
import pytest

from midspan.calibration.fit import Pair, best_corner, with_input_noise
from midspan.calibration.noise import calibrate_noise
from midspan.calibration.scale import calibrate_scale
from midspan.simulate.motion.motion import random_motion
from repeats import slow

RATE_HZ, LENGTH_S, NOISE_M = 100.0, 180.0, 2e-4
WHITE, MOTION_S = (2e-3) ** 2 / RATE_HZ, 1e-4


def lively(seed, motion_s, scale=1.0):
    """Quiet and lively parts of 20 s each; the acceleration's noise has the density WHITE + motion_s times its square.

    The motion is known finely: the second derivative of what the slow sensor sees, by central differences of 1 ms.
    """
    rng = np.random.default_rng(seed)
    # Slow together with the samples: what integration errs by goes with the motion, too.
    motion = random_motion((0.3, 2.0), 5e-3, rng=np.random.default_rng(seed), flat="velocity")

    def displacement(time):
        return motion.displacement(time) * (0.05 + 0.95 * 0.5 * (1.0 - np.cos(2.0 * np.pi * time / 40.0)) ** 2)

    time, step = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ), 1e-3
    acceleration = (displacement(time + step) - 2.0 * displacement(time) + displacement(time - step)) / step**2
    # Independent of the product's own running mean: the local mean square by a boxcar of a second.
    square = np.convolve(acceleration**2, np.ones(100) / 100.0, mode="same")
    noise = np.sqrt((WHITE + motion_s * square) * RATE_HZ) * rng.standard_normal(len(time))
    met = np.arange(1.0, LENGTH_S - 1.0, 0.1)
    value = (displacement(met) + NOISE_M * rng.standard_normal(len(met))) / scale
    samples = np.column_stack((time, acceleration + noise - np.mean(acceleration + noise), np.ones(len(time))))
    return Pair(samples, np.column_stack((met, value, np.ones(len(met)))), 1.0)


@pytest.mark.parametrize("draws", [4, *slow(6)])
def test_what_goes_with_the_motion_is_found(draws):
    found = [calibrate_noise(lively(seed, MOTION_S), 0.0).input_noise for seed in range(draws)]
    # Levels are found to some 20 % each; what falls into the band of both sensors is a fraction of either.
    assert 0.6 < np.median([one.motion_s for one in found]) / MOTION_S < 1.6
    assert 0.3 < np.median([one.density for one in found]) / WHITE < 3.0


def test_a_constant_noise_stays_constant():
    pairs = [lively(seed, 0.0) for seed in range(10, 20)]
    shares = [with_input_noise(pair, best_corner(pair, 0.0))[0].motion_share for pair in pairs]
    # By chance a parameter that tells nothing gains ½ ln n in one of some hundred.
    assert np.count_nonzero(shares) <= 1


def test_it_is_likelier_than_a_constant_noise_and_leaves_the_ratio_true():
    pair = replace(lively(3, 10 * MOTION_S), ratio=None)
    constant = best_corner(pair, 0.0)
    moving, fit = with_input_noise(pair, constant)
    assert moving.motion_share > 0.5
    assert fit.likelihood > constant.likelihood + 50.0
    assert abs(fit.ratio - 1.0) < 3.0 * np.sqrt(fit.ratio_variance)


def test_the_mean_density_is_that_of_both_parts():
    pair = replace(lively(4, MOTION_S), motion_share=0.8)
    noise = pair.input_noise(2e-6)
    assert noise.density + noise.motion_s * np.mean(pair.lively) == pytest.approx(2e-6)
    assert np.average(pair.pieces[:, 1], weights=np.diff(pair.pieces[:, 0], prepend=0.0)) == pytest.approx(
        1.0, rel=0.02
    )


@pytest.mark.parametrize("draws", [8, *slow(12)])
def test_a_camera_s_scale_is_as_good_as_it_says(draws):
    z = []
    for seed in range(20, 20 + draws):
        found = calibrate_scale(replace(lively(seed, 10 * MOTION_S, scale=2e-3), ratio=None), 0.1)
        z.append((found.scale.value_m_per_px - 2e-3) / np.sqrt(found.scale.variance))
    # The rms of twelve has a standard deviation of 0.2, that of eight 0.25.
    assert np.sqrt(np.mean(np.square(z))) < 1.5
