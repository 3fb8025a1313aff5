"""What a radar's only target moves by on its own: neither the factor's sign nor a fast vibration changes it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_cases import broadband, observed

from midspan.calibration.fit import best_corner
from midspan.calibration.own_error import averaged
from midspan.calibration.radar import calibrate
from midspan.calibration.sensors.radar import RadarTarget
from midspan.radar.target import Target

NOISE_M = 5e-5


def search(hertz, size_m, scale=1.0, rate_hz=100.0):
    """A radar's range to a target that vibrates by itself, as it was compared with the accelerometer."""
    pair = observed(broadband(1), 1, rate_hz=rate_hz, scale=scale, noise_px=NOISE_M, offset_s=0.0)
    rows = pair.rows.copy()
    rows[:, 2] = 1.0
    rows[:, 1] += size_m * np.sin(2.0 * np.pi * hertz * rows[:, 0])
    pair = replace(pair, rows=rows)
    return SimpleNamespace(pair=pair, fit=best_corner(pair, 0.0))


def moved(given, factor):
    target = Target(20.0, 1.1, 1.0, 20.0, np.ones(1, dtype=complex), 0.0, conversion_factor=factor, noise_m=NOISE_M)
    (item,), notices = calibrate._with_slow_motion((RadarTarget(target),), given, NOISE_M**2)
    return item.target.own_m, item.target.own_hz, notices


@pytest.mark.parametrize("hertz", [9.7, 20.4])
def test_a_fast_vibration_is_no_slow_one(hertz):
    # 9.7 and 20.4 Hz are 0.3 and 0.4 Hz in every tenth of 100 frames a second.
    pair = search(hertz, 5e-4).pair
    thin = averaged(pair, 10)
    assert thin.rate_hz == pytest.approx(10.0)
    assert np.mean(1.0 / thin.rows[:, 2]) == pytest.approx(10.0)
    added = thin.rows[:, 1] - averaged(search(hertz, 0.0).pair, 10).rows[:, 1]
    # What a mean over 0.1 s leaves of it: sin(pi f T) / (pi f T), 3 % and 2 %.
    assert np.max(np.abs(added)) < 0.05 * 5e-4


def test_a_block_of_which_nothing_is_usable_is_left_out():
    pair = search(1.0, 0.0).pair
    rows = pair.rows.copy()
    rows[:15, 1:] = np.nan, np.inf
    thin = averaged(pair.changed(rows=rows), 10)
    assert np.isinf(thin.rows[0, 2])
    assert thin.rows[1, 2] == pytest.approx(0.2)
    assert np.isfinite(thin.rows[:, :2]).all()


def test_the_factors_sign_hides_no_motion(monkeypatch):
    monkeypatch.setattr(calibrate, "find_own_error", lambda *_: (None, False))
    for sign in (1.0, -1.0):
        own_m, _, notices = moved(search(0.5, 3e-4, sign, 20.0), sign)
        # A sine of 0.3 mm has 0.21 mm rms.
        assert own_m == pytest.approx(2.1e-4, rel=0.15)
        assert notices
