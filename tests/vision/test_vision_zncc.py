import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.feature import match_template

from midspan import _core


def centred(a):
    return np.ascontiguousarray(a - a.mean(), dtype=np.float32)


@pytest.mark.parametrize("shape", [(12, 12), (24, 17), (64, 64)])
def test_the_map_agrees_with_scikit_image(shape):
    image = np.random.default_rng(2).integers(0, 256, (90, 100)).astype(np.float64)
    template = image[13 : 13 + shape[0], 20 : 20 + shape[1]]
    mine = _core.zncc_map((image - image.mean()).astype(np.float32), centred(template))
    # Another route (FFT in float64); float32 row sums carry some 1e-7 of the correlation.
    np.testing.assert_allclose(mine, match_template(image, template), atol=1e-6)
    assert np.unravel_index(mine.argmax(), mine.shape) == (13, 20)


def test_a_constant_window_correlates_with_nothing():
    image = np.zeros((40, 40), dtype=np.float32)
    image[:, 30:] = np.random.default_rng(0).normal(0, 30, (40, 10))
    result = _core.zncc_map(image, centred(np.random.default_rng(3).normal(0, 10, (12, 12))))
    assert np.all(result[:, :19] == 0.0)
    assert np.all(np.isfinite(result))


@settings(max_examples=25, deadline=None)
@given(st.floats(0.1, 10.0), st.floats(-100.0, 100.0), st.integers(0, 2**32 - 1))
def test_gain_and_level_of_the_image_do_not_matter(gain, level, seed):
    image = np.random.default_rng(seed).normal(0, 30, (30, 30))
    template = centred(image[5:20, 6:21])
    first = _core.zncc_map(image.astype(np.float32), template)
    second = _core.zncc_map((gain * image + level).astype(np.float32), template)
    # The level costs float32 digits: 100 / 2^24 of noise on a contrast of 3 or more.
    np.testing.assert_allclose(first, second, atol=1e-4)


def test_smoothing_is_the_convolution_along_both_axes():
    image = np.random.default_rng(4).normal(0, 1, (12, 15)).astype(np.float32)
    taps = np.array([0.25, 0.5, 0.25], dtype=np.float32)
    kernel = np.outer(taps, taps)
    windows = np.lib.stride_tricks.sliding_window_view(image, (3, 3))
    np.testing.assert_allclose(_core.smooth(image, taps), np.einsum("yxij,ij->yx", windows, kernel), atol=1e-6)


def test_shrinking_takes_block_means_and_leaves_out_the_rest():
    image = np.random.default_rng(5).normal(0, 1, (13, 11)).astype(np.float32)
    expected = image[:12, :9].reshape(4, 3, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(_core.shrink(image, 3), expected, atol=1e-6)
