"""Whatever goes wrong, the smoothed rows are never worse over ten seconds than the slow sensor's own interpolation."""

from dataclasses import replace

import numpy as np
import pytest
from estimator_cases import BRIDGE, LIVELY, estimated, oscillating, samples_of, sensor_of
from scipy.interpolate import CubicSpline
from test_fusion_estimator_faults import CASES, during

from midspan.records import seconds

WINDOW_S = 10.0
# (m/s²)²/s: an accelerometer whose zero walks by 9 mm/s² in a minute.
WALK = 9e-3**2 / 60.0


def drifting(rng, samples, sensor):
    step = rng.normal(0, np.sqrt(WALK / 100.0), len(samples.time_ns))
    samples.value_m_s2[:, 0] += np.cumsum(step)


def weaker(rng, samples, sensor):
    samples.value_m_s2[:] *= 0.95


def dead(rng, samples, sensor):
    samples.value_m_s2[during(samples, 63.0)] = 0.0


FAULTS = {name: spoil for name, (spoil, _) in CASES.items()} | {
    "zero walks": drifting,
    "gain 0.95": weaker,
    "dead": dead,
}


@pytest.mark.parametrize(("modes", "rate_hz"), [(BRIDGE, 10.0), (LIVELY, 2.0)])
@pytest.mark.parametrize("name", FAULTS)
def test_never_worse_than_the_slow_sensor_alone(name, modes, rate_hz):
    rng = np.random.default_rng(801)
    truth = oscillating(rng, 120.0, modes)
    samples, sensor = samples_of(truth, rng), sensor_of(truth, rng, rate_hz=rate_hz)
    FAULTS[name](rng, samples, sensor)
    walk = WALK if name == "zero walks" else 1e-8
    found = estimated(samples, [sensor], log=True, bias_walk=walk)
    found = replace(found, rows=found.estimator.smoothed()[0])
    time, error = found.error_of(truth)
    assert np.array_equal(time, seconds(found.rows.time_ns, 0))
    exact = truth.at(time)
    cubic, line = (
        CubicSpline(sensor.time, sensor.value)(time) - exact,
        np.interp(time, sensor.time, sensor.value) - exact,
    )
    for first_s in np.arange(5.0, 105.0):
        within = (time >= first_s) & (time < first_s + WINDOW_S)
        alone = min(np.mean(cubic[within] ** 2), np.mean(line[within] ** 2))
        assert np.mean(error[within] ** 2) < alone
