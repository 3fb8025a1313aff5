"""Smoothed rows and their band while the zero is not known yet, against a dense least squares solution."""

import numpy as np
import pytest
from estimator_cases import camera, estimated, oscillating, samples_of, sensor_of
from fusion_oracles import van_loan
from scipy.linalg import solve_triangular
from test_fusion_second_pass import rows_of

from midspan.fusion.estimator import Estimator, Lag
from midspan.fusion.model import START_S, EstimatorSettings
from midspan.fusion.streams import AS_DECLARED, NO_ERRORS
from midspan.records import Measured, Samples, nanoseconds

RATE_HZ, LENGTH_S, DENSITY = 50.0, 6.0, 1e-6
COUNT = int(RATE_HZ * LENGTH_S)
# Displacement (m), velocity (m/s) and bias (m/s²) before the first measurement.
START = np.array([1.0, 0.5, 0.3])
# Of each case: the channels as (zero's standard deviation (m), noise (m), from, until (s), what their zero is (m)), and
# from when on rows count.
CASES = {
    "the sensor with the zero is late": ([(0.0, 1e-4, 4.0, 6.0, 0.0), (np.inf, 2e-4, 0.0, 6.0, 5e-3)], None),
    "it is late and alone then": ([(0.0, 1e-4, 4.0, 6.0, 0.0), (np.inf, 2e-4, 0.0, 4.2, 5e-3)], None),
    "its zero is uncertain": ([(3e-4, 1e-4, 4.0, 6.0, 0.0), (np.inf, 2e-4, 0.0, 6.0, 5e-3)], None),
    "it is late together with three": (
        [(0.0, 5e-6, 3.0, 5.0, 0.0), *((np.inf, 1e-4, 0.5 * k, 6.0, 10.0**k) for k in range(3))],
        None,
    ),
    "a camera is late": ([(0.0, 5e-6, 4.0, 6.0, 0.0), (np.inf, 3e-4, 0.0, 6.0, 5e-3)], 4.0),
    "a sharp camera alone": ([(0.0, 2e-6, 0.0, 6.0, 0.0)], 0.0),
    "another begins a kilometre away": ([(0.0, 5e-6, 0.0, 6.0, 0.0), (np.inf, 1e-4, 2.0, 6.0, 1e3)], None),
}


def given(name):
    """Samples without acceleration, measurements of noise at every fifth sample, and the settings."""
    rng, (channels, zero_s) = np.random.default_rng(5), CASES[name]
    time = np.arange(COUNT) / RATE_HZ
    samples = Samples(nanoseconds(time), np.zeros((COUNT, 1)), np.full((COUNT, 1), DENSITY), np.zeros(COUNT, np.uint8))
    met = [(k, c) for k in range(0, COUNT, 5) for c, (_, _, a, b, _) in enumerate(channels) if a <= time[k] < b]
    at, number = np.array(met).T
    std, zero = (np.array([channel[i] for channel in channels])[number] for i in (1, 4))
    measured = Measured(nanoseconds(time[at]), number, zero + std * rng.normal(size=len(at)), std**2, np.zeros(len(at)))
    settings = EstimatorSettings(
        channels=tuple(camera(sensor=str(c), zero_std_m=one[0]) for c, one in enumerate(channels)),
        bias_std_m_s2=(START[2],),
        bias_walk=0.0,
        velocity_std_m_s=(START[1],),
        displacement_std_m=START[0],
        rates=NO_ERRORS,
        noise_memory=np.inf,
        noise_weight=AS_DECLARED,
        zero_ns=None if zero_s is None else round(zero_s * 1e9),
    )
    return samples, measured, settings, at


def motions(channels):
    """What the unknowns (start, two of each step's noise, zeros), each of unit variance or free, are to the states
    (COUNT, 3) and to the zeros."""
    size = 3 + 2 * COUNT
    state, states = np.zeros((3, size + channels)), []
    state[:, :3] = np.diag(START)
    for k in range(COUNT):
        transition, noise = van_loan(START_S if k == 0 else 1.0 / RATE_HZ, DENSITY, 0.0)
        state = transition @ state
        state[:2, 3 + 2 * k : 5 + 2 * k] += np.linalg.cholesky(noise[:2, :2])
        states.append(state.copy())
    return np.array(states), np.eye(size + channels)[size:]


def dense(measured, settings, at):
    """Displacement and variance (COUNT,) of the rows: QR of whitened equations, of zeros unknown without a prior."""
    states, zeros = motions(len(settings.channels))
    stds = np.array([channel.zero_std_m for channel in settings.channels])
    prior = np.eye(zeros.shape[1])[: zeros.shape[1] - len(stds)]
    # A known zero has no column; the prior of an unknown one has no row.
    zeros = zeros * np.where(np.isfinite(stds), stds, 1.0)[:, None]
    prior = np.vstack((prior, np.eye(zeros.shape[1])[len(prior) :][np.isfinite(stds)]))
    std = np.sqrt(measured.variance)
    rows = (states[at, 0] + zeros[measured.channel]) / std[:, None]
    first = np.median(measured.value[at == at[0]])
    q, r = np.linalg.qr(np.vstack((prior, rows)))
    best = solve_triangular(r, q[len(prior) :].T @ ((measured.value - first) / std))
    wanted, offset = states[:, 0].copy(), np.full(COUNT, first)
    least = 0.0
    if settings.zero_ns is not None:
        datum = round(settings.zero_ns * 1e-9 * RATE_HZ)
        wanted[datum:] -= states[datum, 0]
        offset[datum:] -= first
        least = np.sum(solve_triangular(r, states[datum, 0], trans="T") ** 2)
    variance = np.sum(solve_triangular(r, wanted.T, trans="T") ** 2, axis=0)
    return offset + wanted @ best, np.maximum(variance, least)


def passed(samples, measured, settings, lag):
    """The rows of `lag`, of more samples than there are, or of `smoother`."""
    stream = Lag(settings, 2 * COUNT) if lag else Estimator(settings, log=True)
    outputs = [*stream.push(measured), *stream.push(samples), *stream.finish()]
    return rows_of(outputs) if lag else stream.smoothed(settings)[0]


@pytest.mark.parametrize("lag", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_rows_and_band_are_those_of_a_dense_solution(name, lag):
    samples, measured, settings, at = given(name)
    rows, (value, variance) = passed(samples, measured, settings, lag), dense(measured, settings, at)
    # Covariances of up to 1 m² are kept to some 1e-16 of that at each of 300 steps.
    assert np.allclose(rows.variance_m2, variance, rtol=1e-3, atol=3e-14)
    assert np.all(np.abs(rows.displacement_m - value) < 0.01 * np.sqrt(variance))


@pytest.mark.parametrize("name", ["the sensor with the zero is late", "a camera is late", "a sharp camera alone"])
def test_the_band_does_not_depend_on_the_last_bits(name):
    samples, measured, settings, _ = given(name)
    expected = passed(samples, measured, settings, False).variance_m2
    # Measurements and their noise differ by a relative 1e-13.
    again = Measured(
        measured.time_ns,
        measured.channel,
        measured.value * (1.0 + 1e-13),
        measured.variance * (1.0 - 1e-13),
        measured.reference_variance,
    )
    assert np.allclose(passed(samples, again, settings, False).variance_m2, expected, rtol=1e-4, atol=3e-15)


@pytest.mark.parametrize("late_s", [5.0, 50.0])
def test_the_band_holds_before_the_sensor_with_the_zero_begins(late_s):
    inside, squares = [], []
    for seed in range(4):
        rng = np.random.default_rng(900 + seed)
        truth = oscillating(rng, 60.0)
        first = sensor_of(truth, rng, camera(sensor="first"), rate_hz=10.0, length_s=60.0, start_s=late_s)
        other = camera(sensor="other", zero_std_m=np.inf)
        second = sensor_of(truth, rng, other, rate_hz=7.0, length_s=60.0, std=2e-4, zero=5e-3)
        found = estimated(samples_of(truth, rng, length_s=60.0), [first, second], log=True)
        found.rows = found.estimator.smoothed()[0]
        _, error = found.error_of(truth)
        inside.append(np.mean(error**2 < 1.96**2 * found.rows.variance_m2))
        squares.append(np.mean(error**2 / found.rows.variance_m2))
    # The zero's error is common to all rows of a record: four of them scatter by some percent.
    assert np.mean(inside) > 0.9
    assert 0.6 < np.sqrt(np.mean(squares)) < 1.3
