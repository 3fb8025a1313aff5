"""Units of channels: text to the factor that brings values to SI."""

import re
from functools import cache
from typing import TYPE_CHECKING

from midspan.checks import nearest
from midspan.errors import UsageError
from midspan.signals.acceleration import GRAVITY_M_S2

if TYPE_CHECKING:
    import pint

# What the field writes, to what the unit library understands. "g" is standard gravity here, never gram.
_SPELLINGS = {
    **dict.fromkeys(("g", "gn", "g_n", "g0"), "standard_gravity"),
    **dict.fromkeys(("mg", "milli-g"), "millistandard_gravity"),
    **dict.fromkeys(("ug", "µg"), "microstandard_gravity"),
    **{"gal": "galileo", "gals": "galileo", "mgal": "milligalileo"},
    **{"dps": "degree/second", "mdps": "millidegree/second"},
    **{'"': "inch", "'": "foot", "mil": "thou", "mils": "thou"},
}

ACCELERATION_UNITS = ("m/s^2", "m/s2", "m/s**2", "mm/s^2", "cm/s^2", "ft/s^2", "in/s^2", "g", "mg", "gal", "mgal")
LENGTH_UNITS = ("m", "mm", "cm", "um", "µm", "nm", "km", "in", "ft", "mil")
VELOCITY_UNITS = ("m/s", "mm/s", "cm/s", "um/s", "µm/s", "in/s", "ft/s")
ANGLE_UNITS = ("deg", "mdeg", "rad", "mrad", "mm/m")
RATE_UNITS = ("deg/s", "mdeg/s", "rad/s", "dps", "mdps")
VOLTAGE_UNITS = ("V", "mV", "uV", "µV", "kV")

_QUANTITIES = {
    "acceleration": ("m/s^2", "[length] / [time] ** 2", ACCELERATION_UNITS),
    "displacement": ("m", "[length]", LENGTH_UNITS),
    "velocity": ("m/s", "[length] / [time]", VELOCITY_UNITS),
    "angle": ("rad", "[]", ANGLE_UNITS),
    "rotation rate": ("rad/s", "1 / [time]", RATE_UNITS),
    "voltage": ("V", "[mass] * [length] ** 2 / [current] / [time] ** 3", VOLTAGE_UNITS),
}
# What most files hold, as the library spells it and to the bits that it gives: reading its definitions takes a third of
# a second.
_COMMON = {
    "acceleration": {"m/s**2": 1.0, "standard_gravity": GRAVITY_M_S2},
    "displacement": {"m": 1.0, "mm": 0.001},
    "velocity": {"m/s": 1.0, "mm/s": 0.001},
    "angle": {"rad": 1.0},
    "rotation rate": {"rad/s": 1.0},
    "time": {"s": 1.0, "ms": 0.001},
    "voltage": {"V": 1.0},
}
# What an axis upright reads at rest in the units of loggers; a gal is a cm/s².
GRAVITY_READS = {
    "g": 1.0, "m/s^2": GRAVITY_M_S2, "gal": 1e2 * GRAVITY_M_S2, "mg": 1e3, "mm/s^2": 1e3 * GRAVITY_M_S2,
}  # fmt: skip
# An axis inclined by 25 degrees, or a zero offset, takes this share off 1 g.
UPRIGHT_WITHIN = 0.1
SI_UNITS = {quantity: row[0] for quantity, row in _QUANTITIES.items()}


@cache
def _registry() -> "pint.UnitRegistry[float]":
    import pint

    return pint.UnitRegistry()


def _spelt(unit: str) -> str:
    """The unit as the library spells it: `m/s²`, `m/s2`, `ms-2`, `cm/sec/sec`, `m.s^-2` all mean what they say."""
    text = unit.strip().strip("[]()").strip()
    text = text.replace("⁻²", "^-2").replace("²", "^2").replace("·", "*").replace("μ", "µ").replace("−", "-")
    if text.lower() in _SPELLINGS:
        return _SPELLINGS[text.lower()]
    text = re.sub(r"\bsec\b", "s", re.sub(r"\bsec(?=\d)", "s", text), flags=re.IGNORECASE)
    text = re.sub(r"^([a-zµ]*m|ft|in)[ .*]?s(\^|\*\*)?-2$", r"\1/s^2", text)
    return re.sub(r"(?<=/)\(?s(?:\^|\*\*)?2\)?$", "s**2", text).replace("^", "**")


@cache
def factor_to_si(unit: str, quantity: str) -> float | None:
    """The factor from `unit` to SI if it measures `quantity` (see `SI_UNITS`), else None.

    Raises UsageError for a unit that is not known at all.
    """
    si, dimension, _ = _QUANTITIES[quantity]
    spelt = _spelt(unit)
    if any(spelt in factors for factors in _COMMON.values()):
        return _COMMON[quantity].get(spelt)
    try:
        amount = _registry().Quantity(1.0, spelt)
        return float(amount.to(si.replace("^", "**")).magnitude) if amount.check(dimension) else None
    except Exception as error:  # its parser lets tokenizer and syntax errors of many kinds through
        known = _QUANTITIES[quantity][2] + (VOLTAGE_UNITS[:2] if quantity == "acceleration" else ())
        hint = nearest(unit.strip().lower(), known)
        text = f"unit must be known and measure {quantity}; received {unit!r}. {hint} Known are {', '.join(known)}."
        raise UsageError(text.replace("  ", " ")) from error


def measures(unit: str | None, quantity: str) -> bool:
    """Whether `unit` is known and measures `quantity`; never raises."""
    if not unit:
        return False
    try:
        return factor_to_si(unit, quantity) is not None
    except UsageError:
        return False


def likely_units(reading: float) -> tuple[str, ...]:
    """The units in which a reading at rest is 1 g, the nearest one first."""
    off = {unit: abs(abs(reading) / one_g - 1.0) for unit, one_g in GRAVITY_READS.items()}
    return tuple(sorted((unit for unit in off if off[unit] < UPRIGHT_WITHIN), key=lambda unit: off[unit]))


def si_factor(unit: str, quantity: str, sensitivity: float | None) -> float:
    """The factor from the file's numbers to the SI unit of a quantity.

    `unit` measures `quantity`, or is a voltage with `sensitivity` in V per SI unit of the quantity (above zero).
    Raises UsageError for an unknown unit, one of another dimension, or a voltage without its sensitivity.
    """
    direct = factor_to_si(unit, quantity)
    si = _QUANTITIES[quantity][0]
    if direct is not None:
        if sensitivity:
            raise UsageError(
                f"sensitivity (V per {si}) goes with unit = 'V'; received {sensitivity:g} with unit {unit!r}. "
                "Remove the sensitivity or set the unit to 'V'."
            )
        return direct
    volts = factor_to_si(unit, "voltage")
    if volts is None:
        raise UsageError(
            f"unit must measure {quantity}, such as {', '.join(_QUANTITIES[quantity][2][:4])}; received {unit!r}. "
            f"Correct the unit, or choose a channel that measures {quantity}."
        )
    if not sensitivity:
        raise UsageError(f"unit {unit!r} needs sensitivity in V per {si}; received none. Give sensitivity.")
    return volts / sensitivity
