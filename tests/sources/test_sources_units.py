"""Units that are known without the library's definitions are what these say."""

import math

import pint
import pytest

from midspan.sources.accelerometer import units

SI = {
    "acceleration": "m/s**2",
    "displacement": "m",
    "velocity": "m/s",
    "angle": "rad",
    "rotation rate": "rad/s",
    "time": "s",
    "voltage": "V",
}


@pytest.mark.parametrize("quantity", SI)
def test_common_units_are_those_of_the_library_bit_for_bit(quantity):
    registry = pint.UnitRegistry()
    for unit, factor in units._COMMON[quantity].items():
        assert registry.Quantity(1.0, unit).to(SI[quantity]).magnitude == factor


def test_a_common_unit_measures_its_own_quantity_alone():
    assert units.factor_to_si("mm", "displacement") == 0.001
    assert units.factor_to_si("mm", "acceleration") is None
    assert units.factor_to_si("s", "acceleration") is None
    assert units.factor_to_si("g", "acceleration") == 9.80665


@pytest.mark.parametrize(
    ("unit", "quantity", "factor"),
    [
        ("deg/s", "rotation rate", math.pi / 180.0),
        ("dps", "rotation rate", math.pi / 180.0),
        ("mdps", "rotation rate", math.pi / 180e3),
        ("mdeg/s", "rotation rate", math.pi / 180e3),
        ("rad/s", "rotation rate", 1.0),
        ("deg", "angle", math.pi / 180.0),
        ("mdeg", "angle", math.pi / 180e3),
        ("mm/m", "angle", 1e-3),
        ("mm/s", "velocity", 1e-3),
        ("in/s", "velocity", 0.0254),
    ],
)
def test_rotation_and_velocity_are_in_si_units(unit, quantity, factor):
    assert units.factor_to_si(unit, quantity) == pytest.approx(factor, rel=1e-12)
    assert not units.measures(unit, "acceleration")
