"""Rows of numbers that come one at a time, kept as columns: a few bytes a number, where an object takes hundreds."""

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Columns:
    """Columns that grow by a row at a time; `codes`: a letter of `array.array` each, "q" int64, "d" float64, "B" uint8.

    Numbers come out as they were put in, to the last bit.
    """

    def __init__(self, codes: str) -> None:
        self._columns: list[array[Any]] = [array(code) for code in codes]

    def __len__(self) -> int:
        return len(self._columns[0])

    def append(self, *row: float) -> None:
        """Add a row, a number for each column."""
        for column, value in zip(self._columns, row, strict=True):
            column.append(value)

    def row(self, number: int) -> tuple[Any, ...]:
        """The row of this number, from 0."""
        return tuple(column[number] for column in self._columns)

    def column(self, number: int) -> NDArray[Any]:
        """The rows so far (n,) of the column with this number, a copy."""
        return np.array(self._columns[number])
