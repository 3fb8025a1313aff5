"""Small steps of a sensor's zero, shown by many innovations, and what must not be taken for one."""

import re

import numpy as np
import pytest
from estimator_cases import NOISE_D, estimated, measured_of, oscillating, samples_of, scores, sensor_of

from midspan.fusion.estimator import Lag
from midspan.fusion.model import EstimatorSettings
from midspan.records import joined
from repeats import slow

STEP_S = 60.0


def recorded(seed, *, length_s=120.0, rate_hz=10.0):
    rng = np.random.default_rng(seed)
    truth = oscillating(rng, length_s)
    sensor = sensor_of(truth, rng, rate_hz=rate_hz, length_s=length_s)
    return rng, truth, samples_of(truth, rng, length_s=length_s), sensor


def steps_found(found):
    """Time (s), size and its standard deviation (mm) of each level shift."""
    own = [one for one in found.events if one.kind == "level_shift"]
    sizes = [re.search(r"by (-?[\d.]+) ± ([\d.]+) mm", one.text) for one in own]
    return [(1e-9 * one.time_ns, float(size[1]), float(size[2])) for one, size in zip(own, sizes, strict=True) if size]


@pytest.mark.parametrize("size_m", [0.7e-3, -0.7e-3])
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_a_small_step_is_reported_where_it_was(size_m, seed):
    # 0.1 mm of noise and 0.06 mm of prediction: the first innovation is 6 deviations, but the gate of 4 alone tells no
    # step from chance; its size is known to 0.12 mm once the innovations after it are there.
    _, truth, samples, sensor = recorded(seed)
    sensor.value += size_m * (sensor.time > STEP_S)
    found = estimated(samples, [sensor])
    ((time_s, size_mm, std_mm),) = steps_found(found)
    assert abs(time_s - STEP_S) < 0.5
    assert abs(size_mm - 1e3 * size_m) < 4.0 * max(std_mm, 0.12)
    # What is in the rows for good is what the step's size is off by.
    assert scores(found, truth, inner=(STEP_S + 5.0, 115.0))[0] < 0.3


@pytest.mark.parametrize("seed", [0, 1, 2, 3, *slow(4, 5, 6, 7, 8, 9, 10, 11)])
def test_no_step_is_found_where_there_is_none(seed):
    _, _, samples, sensor = recorded(100 + seed, rate_hz=(2.0, 5.0, 10.0)[seed % 3])
    assert not steps_found(estimated(samples, [sensor]))


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_a_smoothed_record_keeps_its_level_from_the_step_on(seed):
    _, truth, samples, sensor = recorded(20 + seed)
    sensor.value += 0.7e-3 * (sensor.time > STEP_S)
    found = estimated(samples, [sensor], log=True)
    ((_, _, std_mm),) = steps_found(found)
    found.rows = found.estimator.smoothed()[0]
    # Before the step as without one (0.03 mm), after it by what its size is off by; followed it would be 0.7 mm.
    assert scores(found, truth, inner=(5.0, STEP_S - 1.0))[0] < 0.05
    assert scores(found, truth, inner=(STEP_S, 115.0))[0] < 3.0 * std_mm


def test_the_lag_follows_the_filter_over_a_step():
    _, truth, samples, sensor = recorded(31)
    sensor.value += 0.7e-3 * (sensor.time > STEP_S)
    found = estimated(samples, [sensor])
    stream = Lag(EstimatorSettings((sensor.channel,)), 100)
    outputs = [*stream.push(measured_of([sensor])), *stream.push(samples), *stream.finish()]
    found.rows = joined([one.estimates[0] for one in outputs if one.estimates])
    # A second pass by the same sums: 0.12 mm of the step's size, where following it would be 0.7 mm.
    assert scores(found, truth, inner=(STEP_S + 5.0, 115.0))[0] < 0.4


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_the_level_is_not_believed_because_the_noise_rose_before(seed):
    rng, truth, samples, sensor = recorded(40 + seed)
    loud = (sensor.time > 40.0) & (sensor.time < 47.0)
    sensor.value[loud] += rng.normal(0.0, 10.0 * NOISE_D, np.count_nonzero(loud))
    sensor.value += 2e-3 * (sensor.time > STEP_S)
    found = estimated(samples, [sensor])
    assert any(abs(time_s - STEP_S) < 0.5 for time_s, _, _ in steps_found(found))
    time, error = found.error_of(truth)
    after = (time > STEP_S + 5.0) & (time < 115.0)
    assert np.mean(np.abs(error[after]) < 1.96 * np.sqrt(found.rows.variance_m2[after])) > 0.8


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_a_step_that_comes_in_halves_below_the_gate_is_reported(seed):
    # 0.45 mm at two measurements one after the other: each innovation is below the gate of 4 deviations or near it.
    _, truth, samples, sensor = recorded(60 + seed)
    sensor.value += 0.45e-3 * ((sensor.time > STEP_S) + 1.0 * (sensor.time > STEP_S + 0.1))
    found = estimated(samples, [sensor])
    assert steps_found(found)
    assert scores(found, truth, inner=(STEP_S + 5.0, 115.0))[0] < 0.4
