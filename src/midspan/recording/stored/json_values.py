"""Values of a `calibration.json`, each read with its rule; what JSON has no number for is null."""

import math
from typing import Any

from midspan.records import TimeOffset


class WrongValueError(ValueError):
    """A key of a calibration that is missing or holds what it cannot."""


def section_of(tree: Any, name: str) -> dict[str, Any] | None:
    """The object under a name, None where there is none."""
    section = tree.get(name) if isinstance(tree, dict) else None
    if section is not None and not isinstance(section, dict):
        raise WrongValueError(f"{name} must be an object with keys; received {section!r}")
    return section


def number(section: dict[str, Any], key: str, default: float | None = None, positive: bool = False) -> float:
    """A finite number; `key` is its whole path, of which the last part stands in the section."""
    value = section.get(key.rpartition(".")[2], default)
    if value is None:
        raise WrongValueError(f"{key} is missing")
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise WrongValueError(f"{key} must be a finite number; received {value!r}")
    if positive and value <= 0:
        raise WrongValueError(f"{key} must be above 0; received {value!r}")
    return float(value)


def std(section: dict[str, Any], key: str, default: float | None = None) -> float:
    """A standard deviation."""
    value = number(section, key, default)
    if value < 0:
        raise WrongValueError(f"{key} must be 0 or more; received {value!r}")
    return value


def std_or_unknown(section: dict[str, Any], key: str) -> float:
    """A standard deviation, infinite where it is null or missing."""
    return math.inf if section.get(key.rpartition(".")[2]) is None else std(section, key)


def number_or(section: dict[str, Any], key: str, unknown: float) -> float:
    """A number, or `unknown` where it is null or missing: what could not be learnt is written as null."""
    return unknown if section.get(key.rpartition(".")[2]) is None else number(section, key)


def offset_of(tree: dict[str, Any], section: str) -> TimeOffset:
    """A sensor's clock offset."""
    unknown = tree.get("time_offset_std_s", 0.0) is None
    spread = math.inf if unknown else std(tree, f"{section}.time_offset_std_s", 0.0)
    return TimeOffset(number(tree, f"{section}.time_offset_s"), spread**2)


def finite_or_none(value: float) -> float | None:
    """The value as it is written: None for one that is not finite."""
    return float(value) if math.isfinite(value) else None
