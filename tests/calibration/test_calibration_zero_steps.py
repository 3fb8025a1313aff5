"""Steps of a displacement sensor's zero are no noise of either sensor."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_cases import broadband, observed

from midspan.calibration.displacement.learn import Given, learn
from midspan.calibration.displacement.zero_steps import ZeroStep, without_steps, zero_steps
from midspan.calibration.noise import calibrate_noise
from midspan.calibration.own_noise import exceeds_own_noise
from midspan.records import TimeSeries, nanoseconds
from midspan.signals.acceleration import prepare_acceleration
from midspan.simulate.motion.motion import random_motion
from midspan.simulate.motion.sensors import AccelerometerModel, DisplacementSensorModel, simulate_pair

STEPS = ((20.0, 0.05), (40.0, -0.03))


def stepped(seed, steps=STEPS):
    """A minute of broadband motion and readings of 1 mm of noise in m, whose zero steps."""
    pair = observed(broadband(seed), seed, scale=1.0, noise_px=1e-3, offset_s=0.0)
    rows = np.column_stack((pair.rows[:, :2], np.ones(len(pair.rows))))
    for at_s, size in steps:
        rows[rows[:, 0] >= at_s, 1] += size
    return replace(pair, rows=rows)


@pytest.mark.parametrize("seed", [1, 2])
def test_steps_are_found_where_they_are(seed):
    found = calibrate_noise(stepped(seed), 0.0, one_clock=True).findings
    # As noise they would be the accelerometer's, or a slow error.
    assert exceeds_own_noise(*found.noise) or found.pair.slow[0] > 0.0
    steps = sorted(zero_steps(found.pair, found.fit, 0))
    # To one interval of 0.1 s, and to 5 times what a step is known to: 1 mm while the other is there.
    assert [step.time_ns / 1e9 for step in steps] == pytest.approx([at_s for at_s, _ in STEPS], abs=0.11)
    assert [step.size for step in steps] == pytest.approx([size for _, size in STEPS], abs=5e-3)


def test_without_them_the_noise_is_the_sensors_own():
    time_s = np.arange(0.0, 10.0, 0.5)
    series = TimeSeries(nanoseconds(time_s), np.where(time_s >= 5.0, 0.05, 0.0))
    assert np.all(without_steps(series, [ZeroStep(5_000_000_000, 0.05)]).value == 0.0)
    none = calibrate_noise(stepped(3, steps=()), 0.0, one_clock=True)
    assert zero_steps(none.findings.pair, none.findings.fit, 0) == ()


@pytest.mark.parametrize("factor", [1.0, -2.5])
def test_steps_that_are_taken_out_are_reported_and_hide_no_scale(factor):
    # A scale that is to be estimated was refused, as the steps left 11 % of it open.
    motion = random_motion((0.3, 5.0), 2e-3, rng=np.random.default_rng(1), flat="velocity")
    sensors = AccelerometerModel(100.0, 2e-3, 0.0), DisplacementSensorModel(10.0, 1e-3, 0.0)
    pair = simulate_pair(motion, 60.0, accelerometer=sensors[0], displacement=sensors[1], seed=1)
    read = pair.displacement
    value = factor * (read.value + np.where(read.time_ns >= 30_000_000_000, 0.03, 0.0))
    prepared = prepare_acceleration(pair.acceleration, "accelerometer")
    series = replace(read, value=value)
    learned = learn(Given(prepared, series, 0.1, learns_scale=factor != 1.0), series)
    # 1 mm of noise and 2 mm of motion in a minute tell the scale to a percent.
    assert learned.factor == pytest.approx(1.0 / factor, rel=0.03)
    assert np.sqrt(learned.variance_factor) == pytest.approx(1e-3, rel=0.15)
    (notice,) = [one for one in learned.warnings if one.code == "zero-shifted"]
    assert "30.000 s" in notice
