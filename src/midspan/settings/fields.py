"""Kinds of values that settings are made of, each with its rule in words."""

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from midspan.checks import nearest


def _number(value: object) -> object:
    """A number of TOML: neither a text nor true or false is one."""
    if isinstance(value, bool | str):
        raise ValueError("must be a number")
    return value


IsNumber = BeforeValidator(_number)

PositiveNumber = Annotated[float, IsNumber, Field(gt=0, allow_inf_nan=False)]
NonNegativeNumber = Annotated[float, IsNumber, Field(ge=0, allow_inf_nan=False)]
FiniteNumber = Annotated[float, IsNumber, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1)]


def region_is_positive(value: tuple[int, int, int, int] | None) -> tuple[int, int, int, int] | None:
    """Four numbers that are a region of the picture."""
    if value is not None and (min(value[:2]) < 0 or min(value[2:]) < 1):
        raise ValueError("must be x, y >= 0 and width, height >= 1, in px")
    return value


def is_a_word(value: str | None) -> str | None:
    """A text that can become part of a column's name."""
    if value is not None and not (value.isascii() and value.replace("-", "_").replace("_", "a").isalnum()):
        raise ValueError("must be a word of letters, digits, _ or -, as it becomes part of columns' names")
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


def known(table: dict[str, Any], kind: str) -> AfterValidator:
    """A name that stands in a table; `kind` says in messages what it names."""

    def check(value: str) -> str:
        if value not in table:
            raise ValueError(f"must be one of {', '.join(table)} ({kind}s of this version). {nearest(value, table)}")
        return value

    return AfterValidator(check)


class Section(BaseModel):
    """A section of the tree: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)
