"""What sensor and accelerometer differ by, where it is not white: the band is wider by it, and a warning says so."""

import numpy as np
import pytest

import midspan
from midspan.calibration.agreement import Misfit, misfit
from midspan.calibration.fit import Pair, evaluate
from recording_edits import set_keys, write_displacement
from repeats import slow


def write(folder, seed, inclined_deg=0.0, length_s=60.0):
    """A recording of an inclined accelerometer under motion along both axes; returns its truth (s, mm)."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, length_s, 0.5e-3)
    moved = [
        sum(
            size * np.sin(2 * np.pi * (hertz + rng.normal(0, 0.05)) * time + rng.uniform(0, 6.28))
            for size, hertz in ((4e-3, 0.7), (3e-3, 1.9), (1.5e-3, 3.7))
        )
        for _ in range(2)
    ]
    along, cross = (np.gradient(np.gradient(one, time), time) for one in moved)
    turned = np.radians(inclined_deg)
    accel = (np.cos(turned) * along + np.sin(turned) * cross)[::20] + 0.03
    accel += rng.normal(0.0, 2e-3, len(accel))
    met = np.arange(1000, len(time) - 1000, 400) + 7
    height = 1e3 * (moved[0][met] + rng.normal(0.0, 2e-4, len(met)))
    write_displacement(folder, (time[::20], accel), (time[met], height))
    return time, 1e3 * moved[0]


@pytest.mark.parametrize("method", ["kalman", *slow("smoother")])
def test_cross_motion_of_an_inclined_accelerometer_widens_the_band(method, tmp_path):
    inside = []
    for seed in range(3):
        known = write(tmp_path, seed, inclined_deg=10.0)
        result = midspan.estimate(tmp_path, method=method)
        assert any("not white noise" in line for line in result.warnings)
        # As far as the sensor's readings cannot have this noise it is the accelerometer's already.
        assert result.calibration.misfit > 1.0 or result.calibration.noise_std_m_s2 > 0.1
        error = result.displacement_mm - np.interp(result.time_s, *known)
        inside.append(np.mean(np.abs(error) < 1.96 * result.displacement_std_mm))
    # With white noise 35 to 40 % of the smoother's rows were inside.
    assert np.mean(inside) > 0.85


def test_an_accelerometer_along_the_axis_has_no_misfit(tmp_path):
    for seed in range(3):
        write(tmp_path, seed)
        set_keys(tmp_path, "displacement", noise_time_s=0)
        found = midspan.calibrate(tmp_path)
        assert found.misfit == 1.0
        assert not found.warnings
    again = midspan.load_calibration(found.save(tmp_path / "calibration.json"))
    assert again.misfit == found.misfit


def test_white_innovations_are_seldom_coloured():
    rng, found = np.random.default_rng(0), []
    time = np.arange(0.0, 60.0, 0.01)
    for _ in range(200):
        samples = np.column_stack((time, rng.normal(0.0, 2e-3, len(time)), np.ones(len(time))))
        met = np.arange(1.0, 59.0, 0.1)
        rows = np.column_stack((met, rng.normal(0.0, 1e-3, len(met)), np.ones(len(met))))
        pair = Pair(samples, rows, 1.0)
        found.append(misfit(pair, evaluate(pair, 0.0, 3.0)) != Misfit())
    # Noise of which the model holds but for its sizes; one of a thousand is meant, and its low frequencies are not.
    assert np.mean(found) < 0.02


def test_the_frequency_of_a_tone_that_no_noise_explains_is_named():
    rng, time, met = np.random.default_rng(1), np.arange(0.0, 60.0, 0.01), np.arange(1.0, 59.0, 0.1)
    samples = np.column_stack((time, rng.normal(0.0, 2e-3, len(time)), np.ones(len(time))))
    value = rng.normal(0.0, 1e-3, len(met)) + 1e-3 * np.sin(2 * np.pi * 2.0 * met)
    pair = Pair(samples, np.column_stack((met, value, np.ones(len(met)))), 1.0)
    found = misfit(pair, evaluate(pair, 0.0, 3.0))
    # A band is half the corner frequency wide, 0.24 Hz, and the tone lies somewhere in it: half of that off at most.
    assert found.frequency_hz == pytest.approx(2.0, abs=0.125)
    # Its power, 0.5 of the noise's, in a band of 14 of 290 ordinates; together they are 1.5 times the noise.
    assert found.factor == pytest.approx((1.0 + 0.5 * 290 / 14) / 1.5, rel=0.3)
