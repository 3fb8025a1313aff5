"""Causes of what two sensors differ by: a mounting that resonates, a clock that is off."""

import numpy as np
import pytest

import midspan
from midspan.calibration.causes import Cause, named_cause
from midspan.calibration.fit import Pair
from recording_edits import write_displacement
from repeats import slow

RATE_HZ, LENGTH_S = 100.0, 60.0


def compared(seed, response=lambda hertz: np.ones_like(hertz), late_s=0.0):
    """A minute of three modes, 3 mm rms, by readings of 0.4 mm at 10 Hz; response: of what the accelerometer feels."""
    rng = np.random.default_rng(seed)
    time_s, shown_s = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ), np.arange(0.5, LENGTH_S - 0.5, 0.1)
    # Each mode is a few lines that lie close together, so that its amplitude changes.
    hertz = np.concatenate([rng.normal(f, 0.01 * f, 8) for f in (1.2, 2.9, 5.1)])
    size = np.repeat([2.6e-3, 1.0e-3, 0.4e-3], 8) / 2.0 * np.exp(2j * np.pi * rng.uniform(size=24))

    def waves(at_s, gain):
        return np.real(np.exp(2j * np.pi * np.outer(at_s, hertz)) @ (size * gain))

    felt = waves(time_s, -((2.0 * np.pi * hertz) ** 2) * response(hertz)) + 5e-3 * rng.normal(size=len(time_s))
    shown = waves(shown_s + late_s, 1.0) + 0.4e-3 * rng.normal(size=len(shown_s))
    samples = np.column_stack((time_s, felt, np.ones(len(time_s))))
    return Pair(samples, np.column_stack((shown_s, shown, np.ones(len(shown_s)))), 1.0)


@pytest.mark.parametrize("resonance_hz", [5.0, 6.0])
def test_a_railing_that_resonates_is_named(resonance_hz):
    # Fast motion is felt up to thirty times too strongly; no other cause was near, and all were listed.
    def railing(hertz, damping=0.03):
        r = hertz / resonance_hz
        return (1.0 + 2j * damping * r) / (1.0 - r**2 + 2j * damping * r)

    found = named_cause(compared(1, railing))
    assert found is not None
    assert found.cause is Cause.RESONANCE


@pytest.mark.parametrize("late_s", [-0.08, 0.3])
def test_an_offset_is_no_step_of_the_same_size(late_s):
    found = named_cause(compared(2, late_s=late_s))
    assert found is not None
    assert found.cause is Cause.CLOCK


def test_sensors_that_agree_have_no_cause():
    assert named_cause(compared(3)) is None


@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_a_step_of_a_third_of_a_period_is_no_reversed_sign(seed, tmp_path):
    # It was refused: turned round, or with an offset that is that of the longer part.
    pair = compared(seed)
    stamps = pair.rows[:, 0] + np.where(pair.rows[:, 0] > 22.0, 0.3, 0.0)
    write_displacement(tmp_path, pair.samples[:, :2].T, (stamps, 1e3 * pair.rows[:, 1]))
    sensor = midspan.calibrate(tmp_path).displacement
    assert sensor.offset.value_s == 0.0
    # The sensor's own noise, which 600 readings tell to 3 %.
    assert sensor.noise_std_m == pytest.approx(0.4e-3, rel=0.15)
