"""Filter and smoother against dense Gaussian conditioning, filterpy and van Loan's discretisation."""

import filterpy.kalman
import numpy as np
import pytest
from fusion_oracles import acceleration_block, chain, condition, displacement_block, filtered, van_loan, walk_at_end

from midspan.evaluate.bound import KnownNoise, closed_bound
from midspan.fusion.streams import NO_ERRORS, KalmanSettings, smooth

# No gate: the dense solution believes everything. Moderate prior spreads keep the dense solve well conditioned.
OPEN = KalmanSettings(
    bias_walk=1e-3,
    displacement_std=0.5,
    velocity_std=0.7,
    bias_std=0.4,
    bias=0.05,
    rates=NO_ERRORS,
    noise_memory=np.inf,
)
# Measurements on a sample, several in one interval, one twice at an instant, none in others.
STAMPS = np.array([0.0, 0.011, 0.013, 0.0177, 0.05, 0.05, 0.1234, 0.1301, 0.1302, 0.1303, 0.2, 0.21, 0.2995])


def short_record(seed, *, jitter=0.0, pause=0.01):
    rng = np.random.default_rng(seed)
    steps = 0.01 + jitter * rng.uniform(-1, 1, 29)
    steps[10] = pause
    time = np.concatenate(([0.0], np.cumsum(steps)))
    acceleration = acceleration_block(time, rng.normal(0, 2.0, 30), 10 ** rng.uniform(-3, -1, 30))
    value = rng.normal(0, 0.1, len(STAMPS))
    variance = 10 ** rng.uniform(-5, -2, len(STAMPS))
    variance[3] = np.inf
    value[7] = np.nan
    return acceleration, displacement_block(STAMPS, value, variance)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("causal", [True, False])
def test_mean_and_variance_equal_dense_gaussian_conditioning(seed, causal):
    acceleration, displacement = short_record(seed)
    expected = condition(chain(acceleration, displacement, OPEN), displacement, causal=causal)
    got = filtered(acceleration, displacement, OPEN)[0] if causal else smooth(acceleration, displacement, OPEN).estimate
    # The dense solve loses about six digits of sixteen: condition number of variances 1 to 1e-5.
    np.testing.assert_allclose(got.displacement_m, expected[:, 0], rtol=1e-8, atol=1e-9 * np.ptp(expected[:, 0]))
    np.testing.assert_allclose(got.velocity_m_s, expected[:, 1], rtol=1e-8, atol=1e-8 * np.ptp(expected[:, 1]))
    np.testing.assert_allclose(got.variance_m2, expected[:, 2], rtol=1e-8)


@pytest.mark.parametrize("causal", [True, False])
def test_the_variance_equals_the_dense_one_for_jittered_samples_with_a_pause(causal):
    # The mean depends on the rule by which an interval's length enters the input, the variance does not.
    acceleration, displacement = short_record(5, jitter=0.004, pause=0.05)
    expected = condition(chain(acceleration, displacement, OPEN), displacement, causal=causal)
    got = filtered(acceleration, displacement, OPEN)[0] if causal else smooth(acceleration, displacement, OPEN).estimate
    np.testing.assert_allclose(got.variance_m2, expected[:, 2], rtol=1e-8)


def test_innovations_have_the_density_of_the_dense_gaussian():
    # The innovations are a triangular transformation of the measurements with unit diagonal, so the joint density of
    # the measurements must be the product of the innovations' densities.
    acceleration, displacement = short_record(4)
    means, covariance, kinds = chain(acceleration, displacement, OPEN)
    met = [i for i, (kind, _, _) in enumerate(kinds) if kind == "d"]
    which = np.array([kinds[i][1] for i in met])
    at = 3 * np.array(met)
    total = covariance[np.ix_(at, at)] + np.diag(displacement.variance_m2[which])
    left = displacement.value_m[which] - means[met, 0]
    expected = left @ np.linalg.solve(total, left) + np.linalg.slogdet(total)[1]
    innovation = smooth(acceleration, displacement, OPEN).innovation
    got = np.sum(innovation.value_m**2 / innovation.variance_m2 + np.log(innovation.variance_m2))
    assert len(innovation.value_m) == len(met)
    assert got == pytest.approx(expected, rel=1e-8)


def synchronous_record():
    rng = np.random.default_rng(5)
    time = np.arange(400) / 100.0
    acceleration = acceleration_block(time, rng.normal(0, 1.0, 400), 2e-3)
    return acceleration, displacement_block(time[::10], rng.normal(0, 0.02, 40), 4e-4)


def filterpy_run(acceleration, displacement):
    """The same model on a grid with filterpy: both accelerations of an interval as the input, Newmark beta 1/12."""
    dt, n = 0.01, len(acceleration.time_ns)
    model = filterpy.kalman.KalmanFilter(dim_x=3, dim_z=1, dim_u=2)
    model.F, model.Q = walk_at_end(dt, 2e-3, OPEN.bias_walk)
    model.B = np.array([[5 / 12 * dt**2, dt**2 / 12], [dt / 2, dt / 2], [0.0, 0.0]])
    model.H, model.R = np.array([[1.0, 0.0, 0.0]]), np.array([[4e-4]])
    model.x = np.array([[displacement.value_m[0]], [0.0], [OPEN.bias]])
    model.P = np.diag([OPEN.displacement_std**2, OPEN.velocity_std**2, OPEN.bias_std**2])
    means, covariances, before = [], [], acceleration.value_m_s2[0]
    inputs = np.column_stack((np.concatenate(([before], acceleration.value_m_s2[:-1])), acceleration.value_m_s2))
    for k in range(n):
        model.predict(u=inputs[k][:, None])
        if k % 10 == 0:
            model.update(displacement.value_m[k // 10])
        means.append(model.x.copy())
        covariances.append(model.P.copy())
    return model, inputs, np.array(means)[:, :, 0], np.array(covariances)


def test_filter_equals_filterpy_on_a_synchronous_record():
    acceleration, displacement = synchronous_record()
    _, _, means, covariances = filterpy_run(acceleration, displacement)
    estimate, _ = filtered(acceleration, displacement, OPEN)
    np.testing.assert_allclose(estimate.displacement_m, means[:, 0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(estimate.variance_m2, covariances[:, 0, 0], rtol=1e-9)


def test_smoother_equals_filterpy_rts_on_a_synchronous_record():
    acceleration, displacement = synchronous_record()
    model, inputs, means, covariances = filterpy_run(acceleration, displacement)
    # filterpy's backward pass knows no input; its part is taken out first and put back afterwards.
    forced = np.zeros((len(means), 3))
    for k in range(len(means)):
        forced[k] = model.F @ (forced[k - 1] if k else np.zeros(3)) + model.B @ inputs[k]
    smoothed, variance, _, _ = model.rts_smoother(means - forced, covariances)
    estimate = smooth(acceleration, displacement, OPEN).estimate
    np.testing.assert_allclose(estimate.displacement_m, (smoothed + forced)[:, 0], rtol=1e-7, atol=1e-11)
    np.testing.assert_allclose(estimate.variance_m2, variance[:, 0, 0], rtol=1e-7)


def test_the_walk_of_the_bias_within_a_step_may_be_left_out():
    # An accelerometer of 2 mm/s² per sample at 100 Hz with the default walk: the part left out is below 1e-5.
    settings, density = KalmanSettings(), 0.002**2 / 100.0
    exact, used = van_loan(0.01, density, settings.bias_walk)[1], walk_at_end(0.01, density, settings.bias_walk)[1]
    np.testing.assert_allclose(np.diag(used), np.diag(exact), rtol=1e-5)


def test_steady_variance_is_the_closed_form_and_the_smoother_has_half_the_deviation():
    # Much faster sampling than the corner (2 rad/s against 314 rad/s), where the continuous formula holds to a per
    # cent.
    noise = KnownNoise(0.02, 100.0, 3.5e-3, 50.0)
    time = np.arange(6000) / 100.0
    acceleration = acceleration_block(time, np.zeros(6000), noise.acceleration_density)
    displacement = displacement_block(time[::2], np.zeros(3000), noise.displacement_std_m**2)
    known = KalmanSettings(bias_walk=0.0, bias_std=1e-9, rates=NO_ERRORS, noise_memory=np.inf)
    causal = np.sqrt(np.mean(filtered(acceleration, displacement, known)[0].variance_m2[3000:]))
    both = np.sqrt(np.mean(smooth(acceleration, displacement, known).estimate.variance_m2[2000:4000]))
    assert both / closed_bound(noise) == pytest.approx(1.0, abs=0.005)
    assert causal / closed_bound(noise, "kalman") == pytest.approx(1.0, abs=0.03)
    assert causal / both == pytest.approx(2.0, rel=0.03)
