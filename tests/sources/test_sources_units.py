"""Units that are known without the library's definitions are what these say."""

import pint
import pytest

from midspan.sources.accelerometer import units

SI = {"acceleration": "m/s**2", "displacement": "m", "time": "s", "voltage": "V"}


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
