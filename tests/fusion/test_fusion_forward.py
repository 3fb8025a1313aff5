"""The filter and the pass back over it against plain matrices that hold the parameters as states."""

import numpy as np
import pytest
from fusion_oracles import input_over, van_loan

from midspan.fusion.estimator import Estimator
from midspan.fusion.model import START_S, EstimatorSettings, Parameter, ParameterKind
from midspan.fusion.streams import AS_DECLARED, NO_ERRORS
from midspan.records import Channel, Measured, Samples, Source, joined, nanoseconds

# The joint filter integrates the acceleration along straight lines: at 1500 Hz the two rules agree to 2e-6 at 1.3 Hz,
# far below what the scale error is known to; at 300 Hz 6e-5 would be a fifth of that.
RATE_HZ, FRAME_HZ, LENGTH_S = 1500.0, 7.0, 5.0
DENSITY, NOISE_M = 4e-6 / RATE_HZ, 5e-6
# Of the scale error and the clock offset (s): so small that products of two of them are of no weight.
PRIOR = np.array([5e-4, 1e-4])
EXPOSURE_S = 0.02
BLUR_S2 = EXPOSURE_S**2 / 24.0
# Displacement (m), velocity (m/s) and bias (m/s²) at the start, at a crest: the joint filter takes a scale error times
# the predicted displacement, the estimator times the updated one: the prediction has to be good from the start.
START = np.array([5e-3, 2e-3, 0.02])
BEGIN_S = -START_S


# The joint filter takes its rows at the prediction, the estimator the sensitivity to a scale error at the updated
# displacement: while little is known of the start that is some percent of the sensitivity.
WITHIN = 0.03


def record(seed=3):
    """A cosine with a bias, and frames at uneven instants that are late and of another scale."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(LENGTH_S * RATE_HZ)) / RATE_HZ
    count, w = int(LENGTH_S * FRAME_HZ) - 2, 2 * np.pi * 1.3
    noise = rng.normal(0, np.sqrt(DENSITY * RATE_HZ), len(time))
    acceleration = -5e-3 * w * w * np.cos(w * time) + 0.02 + noise
    met = 0.03 + np.arange(count) / FRAME_HZ + rng.uniform(0, 0.5 / FRAME_HZ, count)
    # In the first interval: the filter begins with the sample before it.
    met[0] = 0.6 / RATE_HZ
    value = 0.9994 * 5e-3 * np.cos(w * (met + 1.2e-4)) + rng.normal(0, NOISE_M, count)
    return time, acceleration, met, value


def settings_of(met):
    """Both parameters are estimated from the start; the noise is as declared, and nothing is asked for."""
    begun_ns = -1_000_000_000
    return EstimatorSettings(
        channels=(Channel("camera", Source.CAMERA, 1.0, exposure_s=EXPOSURE_S),),
        parameters=(
            Parameter(ParameterKind.SCALE_ERROR, (0,), PRIOR[0], estimated_from_ns=begun_ns),
            Parameter(ParameterKind.CLOCK_OFFSET, (0,), PRIOR[1], estimated_from_ns=begun_ns),
        ),
        bias_std_m_s2=(START[2],),
        bias_walk=0.0,
        velocity_std_m_s=(START[1],),
        displacement_std_m=START[0],
        rates=NO_ERRORS,
        noise_memory=np.inf,
        noise_weight=AS_DECLARED,
        zero_ns=int(nanoseconds(met[:1])[0]),
    )


def estimated(time, acceleration, met, value):
    """The estimator at the end, and its rows (n,)."""
    estimator = Estimator(settings_of(met), log=True)
    zeros, count = np.zeros(len(met)), len(time)
    density, kind = np.full((count, 1), DENSITY), np.zeros(count, dtype=np.uint8)
    estimator.push(Measured(nanoseconds(met), zeros.astype(np.int64), value, zeros + NOISE_M**2, zeros))
    found = estimator.push(Samples(nanoseconds(time), acceleration[:, None], density, kind))
    found += estimator.finish()
    return estimator, joined([one.estimates[0] for one in found if one.estimates])


def joint(time, acceleration, met, value):
    """An extended Kalman filter of x, v, b, datum, scale error and clock offset in plain matrices, smoothed by Rauch,
    Tung and Striebel: mean and covariance of the states at the samples, filtered and smoothed.
    """
    edges, a = np.concatenate(([BEGIN_S], time)), np.concatenate((acceleration[:1], acceleration))
    instants = [(t, 1, 0) for t in time] + [(t, 0, i) for i, t in enumerate(met)]
    # Nothing better is known of the place than the first measurement.
    mean, spread = np.array([value[0], *np.zeros(5)]), np.diag([*START**2, 0.0, *PRIOR**2])
    chain, at = [], BEGIN_S
    for t, is_sample, i in sorted(instants):
        transition, noise, moved = np.eye(6), np.zeros((6, 6)), np.zeros(6)
        if t > at:
            j = min(np.searchsorted(edges, at, side="right"), len(time)) - 1
            slope = (a[j + 1] - a[j]) / (edges[j + 1] - edges[j])
            transition[:3, :3], noise[:3, :3] = van_loan(t - at, DENSITY, 0.0)
            moved[:3] = input_over(t - at, at - edges[j], a[j], slope)
        before = (mean, spread)
        mean, spread = transition @ mean + moved, transition @ spread @ transition.T + noise
        chain.append((before, transition, (mean, spread), is_sample))
        at = t
        if is_sample:
            continue
        if i == 0:
            copy = np.eye(6)
            copy[3] = copy[0]
            mean, spread = copy @ mean, copy @ spread @ copy.T
            chain.append((chain[-1][2], copy, (mean, spread), 0))
        now = np.interp(t, edges, a)
        row = np.array([1.0 - mean[4], mean[5], -BLUR_S2, 0.0, -mean[0], mean[1]])
        predicted = mean[0] * (1 - mean[4]) + mean[5] * mean[1] + BLUR_S2 * (now - mean[2])
        gain = spread @ row / (row @ spread @ row + NOISE_M**2)
        mean, spread = mean + gain * (value[i] - predicted), spread - np.outer(gain, row @ spread)
    filtered = [after for _, _, after, is_sample in chain if is_sample]
    back, late = [], (mean, spread)
    for before, transition, after, is_sample in reversed(chain):
        if is_sample:
            back.append(late)
        smoother = before[1] @ transition.T @ np.linalg.pinv(after[1], hermitian=True, rcond=1e-18)
        late = (before[0] + smoother @ (late[0] - after[0]), before[1] + smoother @ (late[1] - after[1]) @ smoother.T)
    return filtered, back[::-1]


JOINT_ROW = np.array([1.0, 0.0, 0.0, -1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def both():
    """The record, the estimator at its end with its rows, and the joint filter."""
    given = record()
    return given, *estimated(*given), joint(*given)


def test_parameters_found_are_those_of_a_filter_that_has_them_as_states(both):
    _, estimator, _, (filtered, _) = both
    value, variance = estimator.parameters
    mean, spread = filtered[-1]
    assert np.sqrt(variance) == pytest.approx(np.sqrt(np.diag(spread)[4:]), rel=WITHIN)
    assert np.all(np.abs(value - mean[4:]) < 0.05 * np.sqrt(variance))


def test_rows_and_band_are_those_of_a_filter_that_has_them_as_states(both):
    (time, *_), _, rows, (filtered, _) = both
    assert len(rows.time_ns) == len(time) - 1
    for k in (-1, -200, -500):
        mean, spread = filtered[k]
        std = np.sqrt(rows.variance_m2[k])
        assert std == pytest.approx(np.sqrt(JOINT_ROW @ spread @ JOINT_ROW), rel=WITHIN)
        assert rows.displacement_m[k] == pytest.approx(JOINT_ROW @ mean, abs=0.05 * std)


def test_the_pass_back_is_the_smoother_of_plain_matrices(both):
    (time, *_), estimator, _, (_, smoothed) = both
    rows = estimator.smoothed()[0]
    # Its first row is that of the second sample.
    for k in np.flatnonzero(time > 0.5)[::20]:
        mean, spread = smoothed[k]
        std = np.sqrt(rows.variance_m2[k - 1])
        assert std == pytest.approx(np.sqrt(JOINT_ROW @ spread @ JOINT_ROW), rel=WITHIN)
        assert abs(rows.displacement_m[k - 1] - JOINT_ROW @ mean) < 0.05 * std
