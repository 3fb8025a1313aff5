"""From counts to temperature and back."""

import math

import numpy as np
import pytest

from midspan.errors import UsageError
from midspan.thermal.radiometry import (
    Air,
    OpticalPath,
    Planck,
    added_counts,
    black_body_counts,
    celsius,
    celsius_table,
    transmission,
)

CAMERA = Planck(r1=16125.8, b_k=1420.1, f=1.0, o=-5588.0, r2=0.0109034)
HAZE = OpticalPath(0.9, 40.0, 280.0, 300.0, 310.0, 0.8, 0.6)


def test_black_bodies_come_back_at_their_temperature() -> None:
    truth = np.linspace(-40.0, 120.0, 50)
    np.testing.assert_allclose(celsius(black_body_counts(truth + 273.15, CAMERA), CAMERA), truth, atol=1e-9)


def test_what_is_as_warm_as_everything_around_it_looks_black_whatever_lies_between() -> None:
    # Nothing is lost or gained where object, air, window and surroundings have one temperature.
    path = OpticalPath(0.7, 60.0, 290.0, 290.0, 290.0, 0.8, 0.6)
    assert float(celsius(black_body_counts(290.0, CAMERA), CAMERA, path)) == pytest.approx(16.85, abs=1e-9)
    share, added = added_counts(CAMERA, path)
    own = float(black_body_counts(290.0, CAMERA))
    assert share * own + added == pytest.approx(own, rel=1e-12)


def test_the_radiance_followed_step_by_step_gives_the_same_object() -> None:
    tau = transmission(HAZE)
    rad = [float(black_body_counts(t, CAMERA)) for t in (315.0, 280.0, 300.0, 310.0)]
    signal = 0.9 * rad[0] + 0.1 * rad[1]  # emitted and reflected
    signal = tau * signal + (1 - tau) * rad[2]  # air before the window
    signal = 0.8 * signal + 0.2 * rad[3]  # window
    signal = tau * signal + (1 - tau) * rad[2]  # air behind it
    assert float(celsius(np.array(signal), CAMERA, HAZE)) == pytest.approx(315.0 - 273.15, abs=1e-9)


def test_the_air_dims_with_distance_and_water_and_not_without_distance() -> None:
    at = [transmission(OpticalPath(distance_m=d)) for d in (0.0, 10.0, 100.0)]
    assert at[0] == 1.0
    assert at[0] > at[1] > at[2] > 0.5
    wet = transmission(OpticalPath(distance_m=100.0, humidity=0.95))
    assert wet < transmission(OpticalPath(distance_m=100.0, humidity=0.1))
    # 100 m, 20 °C, no water: the makers' formula by hand.
    dry = OpticalPath(distance_m=100.0, humidity=0.0, air=Air())
    expected = 1.9 * math.exp(-math.sqrt(50) * 0.006569) - 0.9 * math.exp(-math.sqrt(50) * 0.01262)
    assert transmission(dry) == pytest.approx(expected, rel=1e-12)


def test_the_table_is_the_formula_and_has_no_number_below_what_is_possible() -> None:
    table = celsius_table(CAMERA, HAZE)
    counts = np.array([9000, 15000, 40000])
    np.testing.assert_allclose(table[counts], celsius(counts.astype(float), CAMERA, HAZE), rtol=1e-6)
    assert np.isnan(table[0])
    real = table[np.isfinite(table)]
    assert np.all(np.diff(real) >= 0.0)


@pytest.mark.parametrize("wrong", [{"emissivity": 0.0}, {"humidity": 1.5}, {"air_k": -1.0}, {"distance_m": math.inf}])
def test_surroundings_that_cannot_be_are_refused(wrong) -> None:
    with pytest.raises(UsageError):
        OpticalPath(**wrong)
