"""What the second pass does not do again: logged filters, against a second run over all."""

import numpy as np
import pytest
from estimator_cases import camera, measured_of, oscillating, samples_of, sensor_of
from test_fusion_estimator import settings_of, spoilt
from test_fusion_estimator_faults import CASES, shifted

from midspan.fusion import estimator as estimator_module
from midspan.fusion.estimator import Estimator
from midspan.fusion.model import EstimatorSettings

NAMES = ("displacement_m", "variance_m2", "velocity_m_s", "source", "status")
# Of the logged filters some then lie before what is decided otherwise later, and some behind it.
SHORT = 256
FAULTS = {**{name: spoil for name, (spoil, _) in CASES.items()}, "0.7 mm step": shifted(0.7e-3)}


@pytest.fixture
def short_blocks(monkeypatch):
    monkeypatch.setattr(estimator_module, "BLOCK", SHORT)


def logged(samples, sensors, settings):
    whole = Estimator(settings, log=True)
    for record in (measured_of(sensors), samples):
        whole.push(record)
    whole.finish()
    return whole


def with_fault(name):
    rng = np.random.default_rng(801)
    truth = oscillating(rng, 120.0)
    samples, sensor = samples_of(truth, rng), sensor_of(truth, rng)
    FAULTS[name](rng, samples, sensor)
    return samples, [sensor], EstimatorSettings((sensor.channel,))


def assert_same_bits(one, other):
    for name in NAMES:
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


def assert_as_a_second_run(log, settings):
    assert log.core.logged_filters()
    assert_same_bits(log.smoothed(settings)[0], log.smoothed(settings, logged=False)[0])


@pytest.mark.parametrize("name", FAULTS)
def test_logged_filters_give_the_bits_of_a_second_run_over_all(short_blocks, name):
    samples, sensors, settings = with_fault(name)
    assert_as_a_second_run(logged(samples, sensors, settings), settings)


def test_logged_filters_of_two_sensors_give_the_bits_of_a_second_run_over_all(short_blocks):
    _, samples, sensors = spoilt()
    settings = settings_of(sensors)
    log = logged(samples, sensors, settings)
    assert_as_a_second_run(log, settings)


def test_filters_of_other_settings_are_not_used(short_blocks):
    samples, sensors, settings = with_fault("clean")
    log, other = logged(samples, sensors, settings), EstimatorSettings((camera(),), bias_walk=1e-6)
    assert_same_bits(log.smoothed(other)[0], log.smoothed(other, logged=False)[0])
