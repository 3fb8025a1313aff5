"""A tower whose top leans as it sways: gravity in the acceleration, with and without a sight of the tilt."""

import numpy as np
import pytest

import midspan
from pinhole_tracks import MDEG, Site, nothing, stacked, times, together, waves

HEIGHT_M = 60.0
# Two modes and the wind, each with its slope times the height: of a cantilever, and under an even load.
PARTS = (
    (waves(0.24, 0.26, 8e-3, 11), 1.377),
    (waves(1.48, 1.52, 0.3e-3, 12), -4.78),
    (waves(0.003, 0.02, 5e-3, 13, 8), 1.333),
)
SWAYS = together(*(one for one, _ in PARTS))
LEAN = together(*(times(one, slope / HEIGHT_M) for one, slope in PARTS), waves(0.004, 0.02, 3.0 * MDEG, 14, 6))


def tower(looks, **changes):
    """looks: up (1) or down (-1); where the top leans to, a camera that looks down turns the other way."""
    turns = (times(LEAN, float(looks)), nothing, nothing)
    site = Site(stacked(20.0, 60.0), SWAYS, turns, rate_hz=30.0, noise_px=0.003, lateral=looks, duration_s=100.0)
    return site.but(**changes)


def error_mm(site, result):
    late = result.time_s > 5.0
    error = site.error_mm(result.time_s, result.displacement_mm)[late]
    return error - np.mean(error), result.displacement_std_mm[late]


# A scale that does not know of gravity is 9 % off (0.7 mm), one that takes all modes for alike 1 % (0.1 mm).
@pytest.mark.parametrize("looks", [-1, 1], ids=["down", "up"])
def test_the_scale_is_learnt_with_gravity_by_the_tilt_that_both_targets_show(looks, tmp_path):
    site = tower(looks)
    result = midspan.estimate(site.write(tmp_path))
    camera = result.calibration.camera
    near, far = (1.0 / target.scale.value_m_per_px for target in camera.targets)
    true = 5000.0 * (1.0 / 20.0 - 1.0 / 60.0)
    assert near - far == pytest.approx(true, abs=3.0 * camera.relative_std * true)
    assert camera.relative_std < 0.006
    error, std = error_mm(site, result)
    assert np.std(error) < 0.06
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9
    # The slope of the mode that moves most.
    assert result.calibration.slope == pytest.approx(1.377 / HEIGHT_M, rel=0.2)


def test_a_slope_that_no_target_shows_is_as_uncertain_as_faster_modes_make_it(tmp_path):
    # Gravity goes with the roll of a camera that looks to the side.
    still = tower(-1, targets=stacked(20.0), turns=(nothing,) * 3)
    folder = still.write(tmp_path)
    time_s, felt = np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1).T
    leans = np.column_stack((time_s, felt - 9.80665 * LEAN(time_s)))
    np.savetxt(folder / "accel.csv", leans, "%.7f", ",", header="time_s,accel", comments="")
    camera = midspan.calibrate(folder).camera
    true = 20.0 / 5000.0
    assert camera.scale.value_m_per_px == pytest.approx(true, abs=2.5 * camera.relative_std * true)
    assert camera.relative_std > 0.005
