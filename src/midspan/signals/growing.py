"""Rows of numbers that come one at a time, kept as bytes: a few a number, where an object takes hundreds."""

from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Columns:
    """Columns that grow by a row at a time; `codes`: a letter each, "q" int64, "d" float64, "B" uint8.

    Numbers come out as they were put in, to the last bit.
    """

    def __init__(self, codes: str) -> None:
        self._row = Struct(f"={codes}")
        self._kind = np.dtype([(str(k), f"={code}") for k, code in enumerate(codes)])
        self._rows, self._count = bytearray(), 0

    def __len__(self) -> int:
        return self._count

    def append(self, *row: float) -> None:
        """Add a row, a number for each column."""
        self._rows += self._row.pack(*row)
        self._count += 1

    def row(self, number: int) -> tuple[Any, ...]:
        """The row of this number, from 0."""
        return self._row.unpack_from(self._rows, number * self._row.size)

    def column(self, number: int) -> NDArray[Any]:
        """The rows so far (n,) of the column with this number, a copy."""
        return np.frombuffer(self._rows, dtype=self._kind)[str(number)].copy()
