"""Values of a `calibration.json`, each read with its rule; what JSON has no number for is null."""

import math
from typing import Any

from midspan.checks import TIME_S, ValueRange, shown
from midspan.records import TimeOffset

# What any number of a calibration can be, amplitudes of any unit among them: its square stays finite.
ANY = ValueRange(-1e30, 1e30)
AMPLITUDE = ValueRange(1e-30, 1e30)
# A ratio of variances.
RATIO = ValueRange(1e-12, 1e12)
# Noise of one sample, from that of computed data without any (rounding) to the full scale of a shock sensor.
BIAS_M_S2 = ValueRange(-1e4, 1e4, "m/s²")
NOISE_M_S2 = ValueRange(1e-15, 1e6, "m/s²")
# Of px, mm or m: from rounding to above any range.
NOISE = ValueRange(1e-15, 1e6, "(px or mm)")
FACTOR = ValueRange(1e-9, 1e9)


class WrongValueError(ValueError):
    """A key of a calibration that is missing or holds what it cannot."""


def section_of(tree: Any, name: str) -> dict[str, Any] | None:
    """The object under a name, None where there is none."""
    section = tree.get(name) if isinstance(tree, dict) else None
    if section is not None and not isinstance(section, dict):
        raise WrongValueError(f"{name} must be an object with keys; received {shown(section)}")
    return section


def number(section: dict[str, Any], key: str, default: float | None = None, limits: ValueRange = ANY) -> float:
    """A number within the limits; `key` is its whole path, of which the last part stands in the section."""
    value = section.get(key.rpartition(".")[2], default)
    if value is None:
        raise WrongValueError(f"{key} is missing")
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise WrongValueError(f"{key} must be a finite number; received {shown(value)}")
    if value not in limits:
        raise WrongValueError(f"{key} must be {limits}; received {shown(value)}")
    return float(value)


def std(section: dict[str, Any], key: str, default: float | None = None) -> float:
    """A standard deviation."""
    return number(section, key, default, ValueRange(0.0, ANY.high))


def factor(section: dict[str, Any], key: str, default: float | None = None) -> float:
    """A scale or conversion factor of either sign, which is never 0."""
    value = number(section, key, default)
    if abs(value) not in FACTOR:
        raise WrongValueError(f"{key} must not be 0, its size {FACTOR}; received {shown(value)}")
    return value


def std_or_unknown(section: dict[str, Any], key: str) -> float:
    """A standard deviation, infinite where it is null or missing."""
    return math.inf if section.get(key.rpartition(".")[2]) is None else std(section, key)


def number_or(section: dict[str, Any], key: str, unknown: float, limits: ValueRange = ANY) -> float:
    """A number, or `unknown` where it is null or missing: what could not be learnt is written as null."""
    return unknown if section.get(key.rpartition(".")[2]) is None else number(section, key, limits=limits)


def offset_of(tree: dict[str, Any], section: str) -> TimeOffset:
    """A sensor's clock offset."""
    unknown = tree.get("time_offset_std_s", 0.0) is None
    spread = math.inf if unknown else std(tree, f"{section}.time_offset_std_s", 0.0)
    return TimeOffset(number(tree, f"{section}.time_offset_s", limits=TIME_S), spread**2)


def finite_or_none(value: float) -> float | None:
    """The value as it is written: None for one that is not finite."""
    return float(value) if math.isfinite(value) else None
