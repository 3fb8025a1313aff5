"""The theoretical bound: closed form against recursion against a dense solution."""

import numpy as np
import pytest

from midspan.errors import UsageError
from midspan.evaluate.bound import KnownNoise, closed_bound, exact_bound, still, variance_rows, zeroed_bound
from midspan.fusion.streams import KalmanSettings

CASES = [
    KnownNoise(2e-3, 100.0, 1e-4, 30.0),
    KnownNoise(2e-3, 100.0, 1e-4, 10.0),
    KnownNoise(2e-3, 100.0, 1e-4, 3.0),
    KnownNoise(2e-2, 100.0, 1e-4, 10.0),
]


@pytest.mark.parametrize("noise", CASES)
def test_closed_form_and_recursion_agree_for_the_smoother(noise):
    # The closed form is for continuous measurements; sampling them costs the smoother less than 0.1 %.
    assert exact_bound(noise, "smoother") == pytest.approx(closed_bound(noise, "smoother"), rel=1e-3)


@pytest.mark.parametrize("noise", CASES)
def test_the_recursion_of_the_filter_is_just_above_the_closed_form(noise):
    # Between two measurements the causal error grows, which the continuous form does not know: up to 8 % while the
    # corner stays below 0.13 of the rate. Rows are taken at and after a measurement, never just before one, which
    # favours the recursion by half a sample of that growth, 0.5 % here.
    ratio = exact_bound(noise, "kalman") / closed_bound(noise, "kalman")
    assert 0.995 < ratio < 1.08


def test_the_smoother_halves_the_standard_deviation_of_the_filter():
    assert closed_bound(CASES[0], "smoother") == pytest.approx(0.5 * closed_bound(CASES[0], "kalman"), rel=1e-12)


def test_the_smoothed_variance_is_that_of_the_dense_least_squares_solution():
    # A second route without any recursion: positions at all samples as linear functions of start, velocity and white
    # accelerations held at density S_a, measured directly; the inverse of the normal matrix is the covariance.
    noise = KnownNoise(2e-2, 50.0, 1e-3, 10.0)
    acceleration, displacement = still(noise, 6.0)
    settings = KalmanSettings(bias_walk=0.0, bias_std=1e-12, displacement_std=1.0, velocity_std=1.0)
    found = variance_rows(acceleration, displacement, "smoother", settings)
    n, dt, step = len(found), 1 / 50.0, 5
    transition = np.array([[1.0, dt], [0.0, 1.0]])
    q = noise.acceleration_density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    normal = np.zeros((2 * n, 2 * n))
    inverse = np.linalg.inv(q)
    for k in range(n - 1):
        row = np.zeros((2, 2 * n))
        row[:, 2 * k : 2 * k + 2], row[:, 2 * k + 2 : 2 * k + 4] = -transition, np.eye(2)
        normal += row.T @ inverse @ row
    # The start is known to 1 m and 1 m/s one interval before the first sample.
    start = transition @ transition.T + q
    normal[:2, :2] += np.linalg.inv(start)
    for k in range(0, n, step):
        normal[2 * k, 2 * k] += 1.0 / noise.displacement_std_m**2
    dense = np.diag(np.linalg.inv(normal))[::2]
    # The conditioning of the normal matrix leaves about 1e-6.
    np.testing.assert_allclose(found, dense, rtol=1e-5)


def test_missing_measurements_raise_the_bound_where_they_are_missing():
    acceleration, displacement = still(CASES[1], 60.0)
    whole = variance_rows(acceleration, displacement, "smoother")
    displacement.value_m[300:320] = np.nan
    broken = variance_rows(acceleration, displacement, "smoother")
    # Two seconds without a frame at a corner of 2.5 rad/s lose much; 20 s away nothing is lost.
    assert np.sqrt(broken[3100] / whole[3100]) > 2.0
    np.testing.assert_allclose(broken[1000:1100], whole[1000:1100], rtol=1e-6)


def test_counting_from_the_first_frame_adds_the_variance_of_the_zero():
    acceleration, displacement = still(CASES[1], 60.0)
    variance = variance_rows(acceleration, displacement, "smoother")
    assert zeroed_bound(acceleration, displacement) == pytest.approx(np.sqrt(variance.mean() + variance[0]), rel=1e-12)
    causal = variance_rows(acceleration, displacement, "kalman")
    expected = np.sqrt(causal.mean() + variance[0])
    assert zeroed_bound(acceleration, displacement, "kalman") == pytest.approx(expected, rel=1e-12)


def test_wrong_levels_and_methods_are_refused():
    with pytest.raises(UsageError, match="displacement_std_m must be a positive number"):
        KnownNoise(1e-3, 100.0, 0.0, 10.0)
    with pytest.raises(UsageError, match="Did you mean 'smoother'"):
        closed_bound(CASES[0], "smother")
