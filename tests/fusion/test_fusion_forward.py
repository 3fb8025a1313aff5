"""The forward recursion and the pass back over it against plain matrices that hold the parameters as states."""

import numpy as np
import pytest
from fusion_oracles import input_over, van_loan

from midspan.fusion.backward import pass_back
from midspan.fusion.filtering import FOUND_COLUMNS, RECORD, TAKEN, THETA
from midspan.fusion.forward import MEASUREMENT_COLUMNS, SET_DATUM
from midspan.fusion.hypothesis import DATUM, GOOD
from midspan.fusion.model import (
    START_S,
    Beginning,
    Block,
    EstimatorSettings,
    Filter,
    Parameter,
    ParameterKind,
    options_of,
    run,
    tables_of,
)
from midspan.records import Channel, Source

# The joint filter integrates the acceleration along straight lines: at 300 Hz the two rules agree to 6e-5 at 1.3 Hz.
RATE_HZ, FRAME_HZ, LENGTH_S = 300.0, 7.0, 5.0
DENSITY, NOISE_M = 4e-6 / RATE_HZ, 5e-5
# Of the scale error and the clock offset (s): so small that products of two of them are of no weight.
PRIOR = np.array([5e-3, 1e-3])
EXPOSURE_S = 0.02
BLUR_S2 = EXPOSURE_S**2 / 24.0
START = np.array([0.3, 0.5, 0.2])
BEGIN_S = -START_S
# Displacement, velocity, bias and datum; three of the zero, which is known here.
STATES, PARAMETERS = 7, 2


def record(seed=3):
    """A sine with a bias, and frames at uneven instants that are late and of another scale."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(LENGTH_S * RATE_HZ)) / RATE_HZ
    count, w = int(LENGTH_S * FRAME_HZ) - 2, 2 * np.pi * 1.3
    noise = rng.normal(0, np.sqrt(DENSITY * RATE_HZ), len(time))
    acceleration = -5e-3 * w * w * np.sin(w * time) + 0.02 + noise
    met = 0.03 + np.arange(count) / FRAME_HZ + rng.uniform(0, 0.5 / FRAME_HZ, count)
    value = 0.994 * 5e-3 * np.sin(w * (met + 1.2e-3)) + rng.normal(0, NOISE_M, count)
    return time, acceleration, met, value


# The noise is as told: its factor rests on endlessly many measurements.
SETTINGS = EstimatorSettings(
    channels=(Channel("camera", Source.CAMERA, 1.0, exposure_s=EXPOSURE_S),),
    parameters=(
        Parameter(ParameterKind.SCALE_ERROR, (0,), PRIOR[0]),
        Parameter(ParameterKind.CLOCK_OFFSET, (0,), PRIOR[1]),
    ),
    bias_std_m_s2=(START[2],),
    bias_walk=0.0,
    displacement_std_m=START[0],
    noise_memory=1e15,
    noise_weight=1e15,
    zero_ns=0,
)
TABLES = tables_of(SETTINGS)


def compiled(time, acceleration, met, value, cut=None):
    """Nodes, rows and records of the recursion, cut into two blocks at a sample where asked."""
    samples = np.column_stack((time, acceleration, np.full(len(time), DENSITY)))
    rows = np.zeros((len(met) + 1, MEASUREMENT_COLUMNS))
    rows[1:, 0], rows[1:, 2], rows[1:, 3] = met, value, NOISE_M**2
    rows[0, 0], rows[0, 1] = met[0], SET_DATUM
    codes = np.full(len(rows), GOOD)
    codes[0] = DATUM
    begin = Beginning(0.0, acceleration[:1], np.zeros(1), START[:1], START[1:2], 0)
    state, left = Filter.begun(begin, SETTINGS), []
    for part in (slice(0, cut), slice(cut, None)) if cut else (slice(None),):
        block = samples[part]
        own = (rows[:, 0] <= block[-1, 0]) & (rows[:, 0] > (block[0, 0] if part.start else -1.0) - 1 / RATE_HZ)
        left.append(run(state, Block(block, rows[own], codes[own]), TABLES, options_of(SETTINGS), back=True))
    nodes, found, outcome = (
        np.concatenate([getattr(one, name) for one in left]) for name in ("nodes", "found", "record")
    )
    return nodes, found, outcome


def smoothed(time, nodes, outcome, parameters):
    """Rows (n, 3) of displacement, variance and velocity by the pass back."""
    adjoint, counted = np.zeros((1 + PARAMETERS + 2 * STATES, STATES)), np.array([-1])
    left, rows = (nodes.copy(), outcome.copy(), np.ones(STATES, dtype=int)), np.zeros((len(time), 1, FOUND_COLUMNS))
    pass_back(time, BEGIN_S, TABLES, counted, left, adjoint, parameters, rows)
    return rows[:, 0]


def found(outcome):
    """The parameters (2,) that the innovations tell, with their covariance, from the prior."""
    used = outcome[:, TAKEN] > 0.0
    u, e, total = outcome[used, RECORD + 1 : RECORD + 3], outcome[used, RECORD], outcome[used, TAKEN]
    covariance = np.linalg.inv((u.T / total) @ u + np.diag(PRIOR**-2.0))
    return -covariance @ ((u.T / total) @ e), covariance


def joint(time, acceleration, met, value):
    """An extended Kalman filter of x, v, b, datum, scale error and clock offset in plain matrices, smoothed by Rauch,
    Tung and Striebel: mean and covariance of the states at the samples, filtered and smoothed.
    """
    edges, a = np.concatenate(([BEGIN_S], time)), np.concatenate((acceleration[:1], acceleration))
    instants = [(t, 1, 0) for t in time] + [(t, 0, i) for i, t in enumerate(met)]
    mean, spread = np.zeros(6), np.diag([*START**2, 0.0, *PRIOR**2])
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


@pytest.fixture(scope="module")
def both():
    """The compiled recursion, what the parameters are then, and the joint filter."""
    given = record()
    return given, *compiled(*given), joint(*given)


def test_parameters_found_are_those_of_a_filter_that_has_them_as_states(both):
    _, _, _, outcome, (filtered, _) = both
    value, covariance = found(outcome)
    mean, spread = filtered[-1]
    # The joint filter takes its rows at another estimate: a difference of second order in the prior.
    assert np.sqrt(np.diag(covariance)) == pytest.approx(np.sqrt(np.diag(spread)[4:]), rel=5e-3)
    assert value == pytest.approx(mean[4:], abs=0.01 * np.sqrt(np.diag(covariance)).max(), rel=0.02)


def test_rows_and_band_are_those_of_a_filter_that_has_them_as_states(both):
    _, nodes, rows, outcome, (filtered, _) = both
    mean, spread = filtered[-1]
    value, covariance = found(outcome)
    node, prior = nodes[-1, 0], np.diag(PRIOR**2)
    sensitivity = node[1:3]
    # The rows' band is that of the prior: what the record tells of the parameters is taken in its place here.
    variance = rows[-1, 0, 1] + sensitivity @ (covariance - prior) @ sensitivity
    joint_row = np.array([1.0, 0.0, 0.0, -1.0, 0.0, 0.0])
    assert np.sqrt(variance) == pytest.approx(np.sqrt(joint_row @ spread @ joint_row), rel=5e-3)
    assert rows[-1, 0, 0] + sensitivity @ value == pytest.approx(joint_row @ mean, abs=0.05 * np.sqrt(variance))


def test_the_pass_back_is_the_smoother_of_plain_matrices(both):
    (time, *_), nodes, _, outcome, (_, smooth) = both
    value, covariance = found(outcome)
    rows = smoothed(time, nodes, outcome, (value, covariance))
    without = smoothed(time, nodes, outcome, (np.zeros(2), covariance))
    # The parameters move the rows by more than what is compared: their sign and size are tested.
    assert np.abs(rows[:, 0] - without[:, 0]).max() > 3e-5
    joint_row = np.array([1.0, 0.0, 0.0, -1.0, 0.0, 0.0])
    for k in np.flatnonzero(time > 0.5)[::20]:
        mean, spread = smooth[k]
        std = np.sqrt(rows[k, 1])
        assert std == pytest.approx(np.sqrt(joint_row @ spread @ joint_row), rel=5e-3)
        assert abs(rows[k, 0] - joint_row @ mean) < 0.05 * std


def test_any_cutting_gives_the_same_bits():
    given = record()
    whole = compiled(*given)
    for cut in (1, 77, 200):
        nodes, found, outcome = compiled(*given, cut=cut)
        assert np.array_equal(nodes, whole[0])
        assert np.array_equal(found, whole[1])
        # The interval is counted from the block's begin.
        assert np.array_equal(outcome[:, THETA:], whole[2][:, THETA:])
