"""A scale factor that changes in the course of a record is found and in the deviation; none is found where it stays."""

import numpy as np
import pytest
from calibration_cases import SCALE, broadband, observed

from midspan.calibration.fit import Pair
from midspan.calibration.scale import calibrate_scale
from repeats import slow


def warmed(seed, change, course):
    """A pair whose accelerometer's gain changes by so much over the record, by course of 0 to 1."""
    pair = observed(broadband(seed), seed)
    samples = pair.samples.copy()
    at = (samples[:, 0] - samples[0, 0]) / (samples[-1, 0] - samples[0, 0])
    samples[:, 1] *= 1.0 + change * course(at)
    return Pair(samples, pair.rows)


@pytest.mark.parametrize(
    ("change", "course"),
    [(0.03, lambda at: at), (-0.03, lambda at: at), (0.03, lambda at: 1.0 - np.exp(-at / 0.25))],
)
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_an_accelerometer_that_warms_up_is_named_and_in_the_deviation(change, course, seed):
    found = calibrate_scale(warmed(seed, change, course), 0.1)
    assert "gain-drifts" in {line.code for line in found.warnings}
    # What it was at the begin and at the end both lie within two deviations, a quarter of them for noise.
    relative = np.hypot(np.sqrt(found.scale.variance) / abs(SCALE), found.response.relative_std)
    for gain in (1.0, 1.0 + change):
        assert abs(found.scale.value_m_per_px / SCALE / gain - 1.0) < 2.5 * relative
    assert found.response.relative_std < abs(change)


@pytest.mark.parametrize("seeds", [range(4), *slow(range(4, 8))])
def test_a_gain_that_stays_is_none(seeds):
    for seed in seeds:
        found = calibrate_scale(observed(broadband(seed), seed), 0.1)
        assert "gain-drifts" not in {line.code for line in found.warnings}
