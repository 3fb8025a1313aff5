"""Several targets in one frame: who agrees, and the mean of those who do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from midspan.fusion.targets import AGREE_STD, agreeing, combine, relative_zeros

NAN = float("nan")


def used(residual, variance=1.0, path_variance=1.0):
    rows = np.array(residual, dtype=np.float64)
    return agreeing(rows, np.full(rows.shape, variance), np.full(rows.shape[1], path_variance))


def test_the_mean_weighs_by_inverse_variance_and_knows_its_own():
    value, own_variance = combine(np.array([[1.0], [3.0]]), np.array([[1.0], [4.0]]), np.array([[True], [True]]))
    # (1/1 + 3/4) / (1/1 + 1/4) = 1.4 with variance 1 / 1.25.
    assert value[0] == pytest.approx(1.4)
    assert own_variance[0] == pytest.approx(0.8)


def test_a_frame_without_any_target_has_no_value():
    value, own_variance = combine(np.full((2, 1), NAN), np.full((2, 1), NAN), np.zeros((2, 1), dtype=bool))
    assert np.isnan(value[0])
    assert np.isinf(own_variance[0])


def test_of_three_targets_the_one_that_leaves_the_median_is_dropped_whatever_was_expected():
    # The path is far from all of them; the two that agree are believed.
    assert used([[20.0], [20.5], [40.0]])[:, 0].tolist() == [True, True, False]


def test_of_two_targets_the_expected_path_decides():
    assert used([[0.5], [12.0]])[:, 0].tolist() == [True, False]
    assert used([[12.0], [-0.5]])[:, 0].tolist() == [False, True]


def test_two_targets_that_agree_with_each_other_are_both_used_though_the_path_is_elsewhere():
    # The filter's own gate judges what they say together.
    assert used([[12.0], [12.5]])[:, 0].tolist() == [True, True]


def test_one_target_alone_and_the_last_one_seen_are_always_used():
    assert used([[99.0]])[:, 0].tolist() == [True]
    assert used([[99.0], [NAN]])[:, 0].tolist() == [True, False]


@given(st.integers(2, 6), st.integers(0, 2**31 - 1))
def test_what_differs_by_noise_alone_is_hardly_ever_dropped_and_the_mean_has_its_variance(count, seed):
    rng = np.random.default_rng(seed)
    std = rng.uniform(0.5, 2.0, (count, 1))
    residual = std * rng.standard_normal((count, 400))
    variance = np.broadcast_to(std**2, residual.shape)
    mask = agreeing(residual, variance, np.zeros(400))
    # Beyond four standard deviations of the difference lie 6e-5 of all: of 2400 at most a few.
    assert np.mean(~mask) < 0.005
    value, own_variance = combine(residual, variance, mask)
    assert own_variance[mask.all(axis=0)] == pytest.approx(1.0 / np.sum(1.0 / std**2))
    # 400 draws: the ratio of rms and standard deviation is 1 ± 0.035, so 0.8 and 1.2 are six of those away.
    assert 0.8 < np.sqrt(np.mean(value**2 / own_variance)) < 1.2


@given(st.integers(0, 2**31 - 1))
def test_relative_zeros_are_found_through_noise_outliers_and_lost_frames(seed):
    rng = np.random.default_rng(seed)
    true = np.array([0.3, -0.2, 0.0])
    residual = true[:, None] + 0.05 * rng.standard_normal((3, 300))
    residual[0, :15] = 9.0
    residual[1, 40:60] = np.nan
    zeros = relative_zeros(residual, np.full(residual.shape, 0.05**2))
    # Means over 280 frames: 0.003 each, five of which are the tolerance.
    np.testing.assert_allclose(zeros - zeros.mean(), true - true.mean(), atol=0.015)
    # No target's own reference picture counts for more than its noise says.
    assert abs(zeros.mean()) < 1e-12


def test_a_target_that_was_never_seen_has_no_zero():
    residual = np.array([[0.1, 0.1, 0.1], [NAN, NAN, NAN]])
    zeros = relative_zeros(residual, np.array([[1.0] * 3, [NAN] * 3]))
    assert zeros.tolist() == pytest.approx([0.0, -0.1])
    assert AGREE_STD == 4.0
