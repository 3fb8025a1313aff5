"""Columns of numbers inside the page, small enough to hold every row; `columns.js` reads them.

A column is rounded to whole multiples of its quantum. Differences of the order that makes them smallest, coded without
sign (0, −1, 1, −2, … as 0, 1, 2, 3, …) and split into bytes of equal weight, are deflated (RFC 1950).
"""

import base64
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from midspan.records import Floats

MAX_ORDER = 3
# Of the multiples: differences of the highest order are 2³ times larger, and JavaScript's numbers hold integers to 2⁵³.
MAX_MULTIPLE = 2**48


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """Finite values (n,), given to the nearest multiple of `quantum`, in their unit."""

    value: Floats
    quantum: float


def round_below(fine: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above `fine`, which must be above 0."""
    power = 10.0 ** math.floor(math.log10(fine))
    return float(max(k for k in (1.0, 2.0, 5.0) if k * power <= fine * (1.0 + 1e-9)) * power)


def packed(columns: Sequence[Column]) -> tuple[list[dict[str, Any]], str]:
    """How each column is to be read (quantum, count, order of the differences, bytes a value), and all data as text."""
    layout, data = list[dict[str, Any]](), list[bytes]()
    for column in columns:
        multiple = np.clip(np.rint(column.value / column.quantum), -MAX_MULTIPLE, MAX_MULTIPLE).astype(np.int64)
        order, code = min(_codes(multiple), key=lambda found: float(np.sum(np.log2(found[1] + 1.0))))
        width = max(1, (int(code.max(initial=0)).bit_length() + 7) // 8)
        data += [((code >> np.uint64(8 * k)) & np.uint64(255)).astype(np.uint8).tobytes() for k in range(width)]
        layout.append({"quantum": column.quantum, "count": len(code), "order": order, "width": width})
    return layout, base64.b64encode(zlib.compress(b"".join(data), 9)).decode()


def _codes(multiple: Any) -> list[tuple[int, Any]]:
    """Order and codes (n,) without sign of the differences of each order."""
    found = []
    for order in range(MAX_ORDER + 1):
        step = np.diff(multiple, order, prepend=np.zeros(order, dtype=np.int64)) if order else multiple
        found.append((order, ((step << 1) ^ (step >> 63)).astype(np.uint64)))
    return found
