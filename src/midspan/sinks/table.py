"""A table of results as the writers take it: columns, exact time stamps and metadata."""

import json
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from midspan.checks import refuse
from midspan.records import Nanoseconds, Source, Status

if TYPE_CHECKING:
    import pandas as pd

Column = NDArray[np.generic] | list[str]

WORDS = {"source": tuple(member.word for member in Source), "status": tuple(member.word for member in Status)}
"""Words of the columns that hold codes, in the order of their codes."""

UNITS = {
    **{"time_s": "s", "displacement_mm": "mm", "displacement_std_mm": "mm", "velocity_mm_s": "mm/s"},
    **dict.fromkeys(("x_px", "y_px", "std_x_px", "std_y_px"), "px"),
}

# An image axis in the middle of a column's name, or the name of a target at its end.
_AXIS, _TARGET = re.compile(r"_[xy](?=_mm)"), re.compile(r"^((?:std_)?[xy]_px)_.+$")

_POSE = re.compile(r"^(?:translation|rotation)_[xyz](?:_std)?_(mm|mdeg)$")


def unit_of(name: str) -> str | None:
    """The unit of a column, that of a second axis or target included; None where it has none."""
    if (found := _POSE.match(name)) is not None:
        return found[1]
    return UNITS.get(_TARGET.sub(r"\1", _AXIS.sub("", name)))


def words_of(name: str) -> tuple[str, ...] | None:
    """The words of a column that holds codes, in the order of their codes; None for any other column."""
    return WORDS["status"] if name.startswith("status_") else WORDS.get(name)


@dataclass(frozen=True, slots=True)
class ResultTable:
    """`columns` name → values (n,) in the order they are written, the first one `time_s` (float64, s).

    `time_ns` (n,) int64 are the same times exactly. `source` and `status` are words or the codes of `Source` and
    `Status`. `metadata` (settings, calibration, version) is anything that JSON can hold.
    """

    columns: dict[str, Column]
    time_ns: Nanoseconds
    metadata: dict[str, Any] = field(default_factory=dict)

    def to_pandas(self) -> "pd.DataFrame":
        """The rows as a data frame indexed by `time_s`, with words for source and status."""
        import pandas as pd

        columns: dict[str, Any] = dict(self.columns)
        for name, values in columns.items():
            coded, words = codes(name, values), words_of(name) or ()
            columns[name] = values if coded is None else pd.Categorical.from_codes(coded, pd.Index(words))
        return pd.DataFrame(columns, index=pd.Index(columns.pop("time_s"), name="time_s"))

    def __post_init__(self) -> None:
        lengths = {name: len(values) for name, values in self.columns.items()} | {"time_ns": len(self.time_ns)}
        if len(set(lengths.values())) > 1:
            raise refuse("columns of a result", "of equal length", lengths)


def codes(name: str, values: Column) -> NDArray[np.uint8] | None:
    """The codes (n,) of a column of words known in `WORDS`; None for a column of numbers.

    Raises UsageError for a word or code that is not known.
    """
    words = words_of(name)
    if words is None:
        return None
    array = np.asarray(values)
    if array.dtype.kind in "iu":
        if array.size and (array.min() < 0 or array.max() >= len(words)):
            raise refuse(name, f"codes from 0 to {len(words) - 1}", int(array.max()))
        return array.astype(np.uint8)
    known, places = np.unique(array.astype(str), return_inverse=True)
    unknown = [str(word) for word in known if word not in words]
    if unknown:
        raise refuse(name, f"one of {', '.join(words)}", unknown[0])
    return np.array([words.index(str(word)) for word in known], dtype=np.uint8)[places]


def words_or_numbers(name: str, values: Column) -> NDArray[np.generic]:
    """A column as an array (n,): codes as their words, other words as texts, numbers as they are."""
    coded = codes(name, values)
    if coded is not None:
        return np.array(words_of(name))[coded]
    array = np.asarray(values)
    return array.astype(str) if is_text(array) else array


def is_text(values: Column) -> bool:
    """Whether a column holds words."""
    return np.asarray(values).dtype.kind in "UOS"


def metadata_json(table: ResultTable, indent: int | None = None) -> str:
    """The metadata as JSON text; numbers of numpy become plain ones, what JSON cannot hold becomes its text."""
    return json.dumps(table.metadata, indent=indent, ensure_ascii=False, default=_plain)


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return str(value)
