"""The tables of methods agree, the gate's events are told, and changed noise is found in the innovations."""

from dataclasses import replace

import numpy as np
import pytest
from fusion_oracles import acceleration_block, displacement_block

from midspan.errors import UsageError
from midspan.fusion.events import GateEvents, gate_events
from midspan.fusion.gate import ACCEPTED, REACQUIRED, REJECTED
from midspan.fusion.methods import DEFAULT_METHOD, LITERAL, METHODS, no_literal_form
from midspan.fusion.noise_profile import WINDOW, noise_factors
from midspan.fusion.runners import RUNNERS, run_method
from midspan.records import Innovation, part


def test_every_method_has_a_runner_and_a_line_on_when_to_use_it():
    assert list(RUNNERS) == list(METHODS)
    assert DEFAULT_METHOD in METHODS
    assert set(METHODS) >= LITERAL
    assert all(runner.response in RUNNERS for runner in RUNNERS.values())
    assert "adaptive-kalman" in no_literal_form("smoother")


@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_a_row_a_sample_and_follows_a_sine(method):
    time, met = np.arange(4000) / 100.0, np.arange(400) / 10.0 + 0.003
    omega = 2 * np.pi * 0.8
    rng = np.random.default_rng(1)
    acceleration = acceleration_block(time, -(omega**2) * 2e-3 * np.sin(omega * time) + rng.normal(0, 2e-3, 4000), 4e-8)
    displacement = displacement_block(met, 2e-3 * np.sin(omega * met) + rng.normal(0, 1e-4, 400), 1e-8)
    found = run_method(method, acceleration, displacement).estimate
    np.testing.assert_array_equal(found.time_ns, acceleration.time_ns)
    error = (found.displacement_m - 2e-3 * np.sin(omega * time))[1000:-500]
    # Every method must be better than the displacement itself, which is off by 0.1 mm at its own instants.
    assert np.sqrt(np.mean(error**2)) < 1e-4


def test_an_unknown_method_is_refused_with_the_nearest_name():
    with pytest.raises(UsageError, match="kalman"):
        run_method("kalmann", acceleration_block([0.0, 0.01], [0.0, 0.0], 1.0), displacement_block([0.0], [0.0], 1.0))


def innovations(verdicts, value=None):
    count = len(verdicts)
    return Innovation(
        time_ns=np.arange(count, dtype=np.int64) * 100_000_000,
        value_m=np.full(count, 8e-3) if value is None else value,
        variance_m2=np.full(count, 1e-8),
        verdict=np.array(verdicts, dtype=np.int8),
    )


@pytest.mark.parametrize(("run", "told"), [(4, 0), (5, 1), (60, 1)])
def test_five_or_more_rejections_in_a_row_are_told_once(run, told):
    found = gate_events(innovations([ACCEPTED] * 3 + [REJECTED] * run + [ACCEPTED] * 3))
    assert [event.kind for event in found] == ["rejected"] * told
    if told:
        assert found[0].time_ns == 300_000_000
        assert f"{run} measurements in a row were rejected from 0.300 to {0.3 + 0.1 * (run - 1):.3f} s" in found[0].text


def test_a_run_that_ends_in_a_takeover_is_told_as_that_and_one_cut_off_by_the_end_is_told_too():
    found = gate_events(innovations([ACCEPTED, *[REJECTED] * 49, REACQUIRED, ACCEPTED, *[REJECTED] * 7]))
    assert [event.kind for event in found] == ["reacquired", "rejected"]
    assert "8.00 mm" in found[0].text
    assert "50 measurements" in found[0].text


@pytest.mark.parametrize("size", [1, 3, 50])
def test_events_do_not_depend_on_the_cutting(size):
    rng = np.random.default_rng(2)
    verdicts = np.repeat(rng.choice([ACCEPTED, REJECTED, REACQUIRED], 60, p=[0.5, 0.4, 0.1]), rng.integers(1, 9, 60))
    whole = innovations(verdicts)
    watch, found = GateEvents(), []
    for start in range(0, len(verdicts), size):
        found += watch.push(part(whole, slice(start, start + size)))
    assert [*found, *watch.finish()] == gate_events(whole)


def noise(scale, seed=0):
    rng = np.random.default_rng(seed)
    return innovations([ACCEPTED] * len(scale), 1e-4 * scale * rng.normal(0, 1, len(scale)))


def as_declared(innovation):
    """The factors for a run that took the noise as declared."""
    return noise_factors(innovation, np.ones(len(innovation.value_m)))


def test_noise_as_predicted_gives_factors_of_one():
    # Over a hundred minutes at 10 Hz: 61 steps scatter by a fifth, and a factor of two is beyond chance.
    assert np.mean(as_declared(noise(np.ones(60000))) == 1.0) > 0.999


def test_a_step_of_the_noise_is_found_where_it_is():
    scale = np.where(np.arange(1200) < 700, 1.0, 5.0)
    found = as_declared(noise(scale, 3))
    assert np.all(found[:680] == 1.0)
    # The median of 61 steps knows a fivefold noise to ± 20 %, now and then 50 %.
    assert np.mean(found[720:]) == pytest.approx(5.0, rel=0.15)
    edge = int(np.argmax(found > 2.0))
    assert abs(edge - 700) < WINDOW // 2


def test_outliers_drift_and_too_few_measurements_are_no_change_of_noise():
    rng = np.random.default_rng(4)
    plain = noise(np.ones(2000), 4)
    spoilt = plain.value_m + np.where(rng.random(2000) < 0.1, 5e-3, 0.0)
    drift = plain.value_m + 2e-3 * np.sin(np.arange(2000) / 200.0)
    for value in (spoilt, drift):
        assert np.mean(as_declared(innovations([ACCEPTED] * 2000, value)) == 1.0) > 0.97
    assert np.all(as_declared(noise(5.0 * np.ones(WINDOW - 1))) == 1.0)


def test_a_run_that_followed_the_noise_finds_the_same_factors():
    # Innovations relative to five times the declared noise are as small as usual; the factor must not be lost.
    scale = np.where(np.arange(1200) < 700, 1.0, 5.0)
    plain = noise(scale, 5)
    followed = replace(plain, variance_m2=plain.variance_m2 * scale**2)
    assert noise_factors(followed, scale) == pytest.approx(as_declared(plain), rel=0.2)
