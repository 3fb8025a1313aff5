"""Kinds of values that settings are made of, each with its rule in words."""

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from midspan.checks import CARRIER_HZ, RATE_HZ, TIME_S, ValueRange, nearest

MAX_PX = 1_000_000
# What file systems take: bytes of a name and of a path.
MAX_NAME_BYTES, MAX_PATH_BYTES = 255, 4095


def _number(value: object) -> object:
    """A number of TOML: neither a text nor true or false is one."""
    if isinstance(value, bool | str):
        raise ValueError("must be a number")
    if isinstance(value, int) and abs(value) >= 2**63:
        raise ValueError("must be a number of at most 64 bits")
    return value


IsNumber = BeforeValidator(_number)


@dataclass(frozen=True, slots=True)
class Form:
    """What the reference of all keys says of a key's values where its type and limits do not."""

    text: str


@dataclass(frozen=True, slots=True)
class Within:
    """The rule that a number lies within limits; NaN does not."""

    limits: ValueRange

    def __call__(self, value: float) -> float:
        """The value; ValueError where it is outside."""
        if value not in self.limits:
            raise ValueError(f"must be {self.limits}. Correct the value or its unit")
        return value


def limited(low: float, high: float, unit: str = "") -> AfterValidator:
    """A number from `low` to `high`; NaN is none."""
    return _held(ValueRange(low, high, unit))


def _held(limits: ValueRange) -> AfterValidator:
    return AfterValidator(Within(limits))


Rate = Annotated[float, IsNumber, _held(RATE_HZ)]
Carrier = Annotated[float, IsNumber, _held(CARRIER_HZ)]
Time = Annotated[float, IsNumber, _held(TIME_S)]
# An hour is longer than any exposure or sweep of a shutter.
Duration = Annotated[float, IsNumber, limited(0.0, 3600.0, "s")]
# None, up to a day.
NoiseTime = Annotated[float, IsNumber, limited(0.0, 86400.0, "s")]
# Noise in any unit, from below the last digit of a double in mm to above any sensor's range.
Noise = Annotated[float, IsNumber, limited(1e-12, 1e9, "in the unit of the values")]
FiniteNumber = Annotated[float, IsNumber, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1)]


def _is_a_path(value: str) -> str:
    """A text that a file can be named by."""
    if "\0" in value:
        raise ValueError("must be a path without NUL characters")
    if len(value.encode()) > MAX_PATH_BYTES or any(len(name.encode()) > MAX_NAME_BYTES for name in value.split("/")):
        raise ValueError(
            f"must be a path of at most {MAX_PATH_BYTES} bytes, each name in it of at most {MAX_NAME_BYTES} bytes"
        )
    return value


FileName = Annotated[str, Field(min_length=1), AfterValidator(_is_a_path), Form("path")]


def region_is_positive(value: tuple[int, int, int, int] | None) -> tuple[int, int, int, int] | None:
    """Four numbers that are a region of the picture."""
    if value is not None and (min(value[:2]) < 0 or min(value[2:]) < 1):
        raise ValueError("must be x, y >= 0 and width, height >= 1, in px")
    if value is not None and max(value) > MAX_PX:
        raise ValueError(f"must be numbers up to {MAX_PX} px")
    return value


def has_four(value: tuple[float, ...] | None) -> tuple[float, ...] | None:
    """Four numbers, as a camera matrix has."""
    if value is not None and len(value) != 4:
        raise ValueError("must be four numbers, fx, fy, cx, cy, in px")
    return value


def second_is_larger(value: tuple[float, float] | None) -> tuple[float, float] | None:
    """Two numbers in rising order."""
    if value is not None and value[1] <= value[0]:
        raise ValueError("must be two numbers, the second larger")
    return value


@dataclass(frozen=True, slots=True)
class OneOf:
    """The rule that a name stands in a table; `kind` says in messages what it names."""

    table: dict[str, Any]
    kind: str

    def __call__(self, value: str) -> str:
        """The name; ValueError for another one."""
        if value not in self.table:
            rule = (
                f"must be one of {', '.join(self.table)} ({self.kind}s of this version). {nearest(value, self.table)}"
            )
            raise ValueError(rule.rstrip())
        return value


def known(table: dict[str, Any], kind: str) -> AfterValidator:
    """A name that stands in a table; `kind` says in messages what it names."""
    return AfterValidator(OneOf(table, kind))


class Section(BaseModel):
    """A section of the tree: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


def _is_a_word(value: str) -> str:
    """A text that can become part of a column's name."""
    if not (value.isascii() and value.replace("-", "_").replace("_", "a").isalnum()):
        raise ValueError("must consist of letters, digits, _ and -, because column names contain it")
    return value


def _listed(value: Any) -> Any:
    """One section, or several, as a list."""
    if value is None or isinstance(value, tuple) or (isinstance(value, list) and value):
        return value or ()
    if not isinstance(value, dict):
        raise ValueError("must be a section with keys, or a list of named sections")
    return [value]


Listed = BeforeValidator(_listed)
SensorName = Annotated[str, AfterValidator(_is_a_word), Form("letters, digits, _, -")]
