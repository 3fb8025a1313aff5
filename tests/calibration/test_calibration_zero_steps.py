"""Steps of a displacement sensor's zero are no noise of either sensor."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_cases import broadband, observed

from midspan.calibration.displacement.zero_steps import without_steps, zero_steps
from midspan.calibration.noise import calibrate_noise
from midspan.calibration.own_noise import exceeds_own_noise
from midspan.records import TimeSeries, nanoseconds

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
    steps = sorted(zero_steps(found.pair, found.fit))
    # To one interval of 0.1 s, and to 5 times what a step is known to: 1 mm while the other is there.
    assert [at_s for at_s, _ in steps] == pytest.approx([at_s for at_s, _ in STEPS], abs=0.11)
    assert [size for _, size in steps] == pytest.approx([size for _, size in STEPS], abs=5e-3)


def test_without_them_the_noise_is_the_sensors_own():
    time_s = np.arange(0.0, 10.0, 0.5)
    series = TimeSeries(nanoseconds(time_s), np.where(time_s >= 5.0, 0.05, 0.0))
    assert np.all(without_steps(series, [(5.0, 0.05)], 0).value == 0.0)
    none = calibrate_noise(stepped(3, steps=()), 0.0, one_clock=True)
    assert zero_steps(none.findings.pair, none.findings.fit) == []
