"""What the second pass does not do again or leaves out: logged filters, states that are certain; against all of it."""

import numpy as np
import pytest
from estimator_cases import camera, measured_of, oscillating, samples_of, sensor_of
from test_fusion_estimator import settings_of, spoilt
from test_fusion_estimator_faults import CASES, shifted

from midspan.fusion import estimator as estimator_module
from midspan.fusion import second_pass
from midspan.fusion.backward import pass_back
from midspan.fusion.estimator import Estimator
from midspan.fusion.forward import find_uncertain, predict_covariance
from midspan.fusion.model import EstimatorSettings
from midspan.fusion.second_pass import smooth

NAMES = ("displacement_m", "variance_m2", "velocity_m_s", "source", "status")
# Of the logged filters some then lie before what is decided otherwise later, and some behind it.
SHORT = 256
FAULTS = {**{name: spoil for name, (spoil, _) in CASES.items()}, "0.7 mm step": shifted(0.7e-3)}


@pytest.fixture
def short_blocks(monkeypatch):
    monkeypatch.setattr(estimator_module, "BLOCK", SHORT)
    monkeypatch.setattr(second_pass, "BLOCK", SHORT)


def logged(samples, sensors, settings):
    whole = Estimator(settings, log=True)
    for record in (measured_of(sensors), samples):
        whole.push(record)
    whole.finish()
    return whole.log


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
    quick = smooth(log, settings)[0]
    assert log.filters
    log.filters.clear()
    assert_same_bits(quick, smooth(log, settings)[0])


@pytest.mark.parametrize("name", FAULTS)
def test_logged_filters_give_the_bits_of_a_second_run_over_all(short_blocks, name, monkeypatch):
    samples, sensors, settings = with_fault(name)
    log, used, chosen = logged(samples, sensors, settings), [], second_pass.logged_filters
    monkeypatch.setattr(second_pass, "logged_filters", lambda *given: used.append(chosen(*given)) or used[-1])
    logged_count = len(log.filters)
    assert_as_a_second_run(log, settings)
    # Where nothing is wrong all of them are right; the last one is after all samples.
    assert name != "clean" or len(used[0]) >= logged_count - 1 > 0


def test_logged_filters_of_two_sensors_give_the_bits_of_a_second_run_over_all(short_blocks):
    _, samples, sensors = spoilt()
    settings = settings_of(sensors)
    log = logged(samples, sensors, settings)
    assert_as_a_second_run(log, settings)


def test_filters_of_other_settings_are_not_used(short_blocks):
    samples, sensors, settings = with_fault("clean")
    log, other = logged(samples, sensors, settings), EstimatorSettings((camera(),), bias_walk=1e-6)
    quick = smooth(log, other)[0]
    log.filters.clear()
    assert_same_bits(quick, smooth(log, other)[0])


def test_the_pass_back_over_uncertain_states_is_that_over_all(monkeypatch):
    _, samples, sensors = spoilt()
    settings = settings_of(sensors)
    log = logged(samples, sensors, settings)
    quick = smooth(log, settings)[0]

    def over_all(time_s, start_s, tables, counted, left, *given):
        nodes, record, uncertain = left
        assert not uncertain.all()
        pass_back(time_s, start_s, tables, counted, (nodes, record, np.ones_like(uncertain)), *given)

    monkeypatch.setattr(second_pass, "pass_back", over_all)
    whole = smooth(log, settings)[0]
    # Rounding: W is rotated to another number of columns.
    std = np.sqrt(whole.variance_m2)
    assert np.max(np.abs(quick.displacement_m - whole.displacement_m) / std) < 1e-6
    assert np.allclose(quick.variance_m2, whole.variance_m2, rtol=1e-6)


@pytest.mark.parametrize("axes", [1, 2])
def test_the_covariance_is_predicted_as_by_whole_matrices(axes):
    rng, moving, dt = np.random.default_rng(axes), 3 * axes, 0.013
    certain, n = {moving, moving + 3}, moving + 5
    root = rng.normal(size=(n, n))
    root[list(certain)] = 0.0
    p, walks = root @ root.T, np.zeros(n)
    walks[2:moving:3], walks[moving + 1], walks[moving + 3] = 1e-3, 2e-3, 3e-3
    transition = np.eye(n)
    for i in range(0, moving, 3):
        transition[i : i + 3, i : i + 3] += [[0.0, dt, -0.5 * dt * dt], [0.0, 0.0, -dt], [0.0, 0.0, 0.0]]
    expected = transition @ p @ transition.T + dt * np.diag(walks)
    uncertain = np.empty(n, dtype=np.int64)
    count = find_uncertain(p, moving, walks, uncertain)
    # A state with a walk does not stay certain.
    assert uncertain[:count].tolist() == [moving + 1, moving + 2, moving + 3, moving + 4]
    predict_covariance(p, axes, dt, walks, uncertain, count)
    # Sums of a dozen products of size 10.
    assert np.allclose(p, expected, rtol=1e-12, atol=1e-13)
    assert np.array_equal(p, p.T)
