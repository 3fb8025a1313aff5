import numpy as np
import pytest
from scipy.ndimage import correlate

from midspan.vision.steerable import MARGIN_PX, SPACING, filter_taps, noise_power, quadrature, responses, spread_back

# Where the pair is meant to work: around its peak at 2 · 0.67 / 2π = 0.21 cycles/px.
FREQUENCIES = [0.13, 0.16, 0.2, 0.25, 0.3]


def wave(frequency, phase, axis, side=64):
    line = np.cos(2 * np.pi * frequency * np.arange(side) + phase)
    image = np.tile(line, (side, 1))
    return (100 + 20 * (image if axis == "x" else image.T)).astype(np.float32)


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_amplitude_is_flat_and_phase_linear_on_a_sinusoid(axis, frequency):
    field = quadrature(wave(frequency, 0.4, axis), axis)
    line = field[5] if axis == "x" else field[:, 5]
    amplitude = np.abs(line)
    # Freeman and Adelson's pair is in quadrature to some per cent; the ripple runs at twice the frequency.
    assert np.ptp(amplitude) / amplitude.mean() < 0.08
    expected = 2 * np.pi * frequency * (np.arange(len(line)) + MARGIN_PX) + 0.4
    assert np.abs(np.angle(line * np.exp(-1j * expected))).max() < 0.04


def test_even_and_odd_filter_respond_to_no_constant():
    for response in responses(np.full((20, 20), 200.0, dtype=np.float32), "x"):
        assert np.abs(response).max() < 1e-3  # float32 of 200 times 81 taps


@pytest.mark.parametrize("axis", ["x", "y"])
def test_responses_are_plain_correlations_with_the_separable_kernel(axis):
    image = np.random.default_rng(0).normal(0, 30, (40, 33)).astype(np.float32)
    even, odd, across = filter_taps()
    m = MARGIN_PX
    for taps, found in zip((even, odd), responses(image, axis), strict=True):
        kernel = np.outer(across, taps) if axis == "x" else np.outer(taps, across)
        full = correlate(image.astype(np.float64), kernel, mode="constant")
        assert found == pytest.approx(full[m:-m, m:-m], abs=1e-3)


def test_taps_are_those_of_the_tables_but_for_the_mean():
    even, odd, across = filter_taps(SPACING)
    # Table III of the paper, f1 of G2 at 0, 1, 2: -0.9213, -0.0601, 0.3964 (sign turned); table V, f1 of H2 at 1, 2.
    assert even[4:7] == pytest.approx([0.9213, 0.0601, -0.3964], abs=0.01)
    assert np.abs(odd[5:7]) == pytest.approx([0.7551, 0.0998], abs=0.003)
    assert even.sum() == pytest.approx(0, abs=1e-12)
    assert across[4] == 1.0


@pytest.mark.parametrize("axis", ["x", "y"])
def test_noise_comes_out_with_the_power_that_is_reported(axis):
    noise = np.random.default_rng(1).normal(0, 1, (600, 600)).astype(np.float32)
    # 350 000 pixels, about 15 of them to one independent value: 1 % at one sigma.
    for response, power in zip(responses(noise, axis), noise_power(), strict=True):
        assert response.var() == pytest.approx(power, rel=0.04)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_spreading_back_is_the_adjoint_of_the_filters(axis):
    rng = np.random.default_rng(2)
    image = rng.normal(0, 1, (30, 26)).astype(np.float32)
    weights = (rng.normal(size=(22, 18)) + 1j * rng.normal(size=(22, 18))).astype(np.complex64)
    even, odd = responses(image, axis)
    direct = np.sum(weights.real * odd) - np.sum(weights.imag * even)
    assert np.sum(spread_back(weights, axis) * image) == pytest.approx(direct, rel=1e-4, abs=1e-3)
