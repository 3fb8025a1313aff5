"""The zero's part of the band, which all rows have in common, and the rest of it: by simulation over seeds."""

import numpy as np
import pytest
from estimator_cases import LIVELY, camera, measured_of, oscillating, samples_of, sensor_of
from test_fusion_second_pass import rows_of

from midspan.fusion.estimator import Estimator, Lag
from midspan.fusion.model import EstimatorSettings
from midspan.records import seconds

LENGTH_S, SETTLED_S, SEEDS = 24.0, 6.0, range(20)
# Of the first channel, and of a second one that gives the zero: standard deviation of the zero, noise, m.
CASES = {"a camera": [(0.0, 1e-4)], "the better target is the second": [(2e-4, 2e-4), (0.0, 1e-4)]}


def zero_of(outputs):
    """The zero's variance as last stated, m²."""
    return next(one.zero_variance_m2[0] for one in reversed(outputs) if one.zero_variance_m2)


def rows_by_method(samples, measured, settings):
    """Rows and the zero's variance of each method."""
    estimator, lag = Estimator(settings, log=True), Lag(settings, 50)
    causal, lagged = ([*one.push(measured), *one.push(samples), *one.finish()] for one in (estimator, lag))
    return {
        "kalman": (rows_of(causal), zero_of(causal)),
        "lag": (rows_of(lagged), zero_of(lagged)),
        "smoother": (estimator.smoothed(settings)[0], zero_of(causal)),
    }


def shares(case, seed):
    """Of each method: mean error over the zero's deviation, and rms error about its mean over the rest of the band."""
    rng = np.random.default_rng(seed)
    truth = oscillating(rng, LENGTH_S, LIVELY)
    samples = samples_of(truth, rng, length_s=LENGTH_S)
    sensors = [
        sensor_of(
            truth, rng, camera(target=str(k), zero_std_m=zero), length_s=LENGTH_S, std=std, zero=zero * rng.normal()
        )
        for k, (zero, std) in enumerate(CASES[case])
    ]
    first_s = sensors[0].time[0]
    settings = EstimatorSettings(
        tuple(one.channel for one in sensors), zero_ns=round(1e9 * first_s), bias_std_m_s2=(0.05,)
    )
    found = {}
    for method, (rows, zero_m2) in rows_by_method(samples, measured_of(sensors), settings).items():
        time = seconds(rows.time_ns, 0)
        settled = (time > SETTLED_S) & (time < LENGTH_S - 2.0)
        error = (rows.displacement_m - truth.at(time) + truth.at(np.array([first_s])))[settled]
        rest = rows.variance_m2[settled] - zero_m2
        assert np.all(rest > 0.0)
        found[method] = error.mean() / np.sqrt(zero_m2), np.std(error) / np.sqrt(np.mean(rest))
    return found


@pytest.mark.parametrize("case", CASES)
def test_the_mean_error_is_the_zeros_and_the_rest_is_the_rows_own(case):
    drawn = [shares(case, seed) for seed in SEEDS]
    for method in drawn[0]:
        zero, rest = (np.sqrt(np.mean(np.square(one))) for one in np.transpose([found[method] for found in drawn]))
        # The zero is one draw a record: the root mean square of 20 lies within 0.6 and 1.45 in 998 of 1000.
        assert 0.6 < zero < 1.45, (method, zero)
        # Of each record some fifty independent errors: 20 records tell their size to 3 %; adapting noise costs some.
        assert 0.85 < rest < 1.15, (method, rest)
