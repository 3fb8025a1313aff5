"""Universal file format: one dataset 58 a column, binary with 64-bit floats (58b).

Source: SDRC I-DEAS universal file datasets, dataset 58, and the University of Cincinnati's binary 58b.
"""

from collections.abc import Iterator

import numpy as np

from midspan.errors import UsageError
from midspan.records import Floats
from midspan.sinks.table import ResultTable, codes, is_text, unit_of
from midspan.writing import WRITTEN_BY

# Codes of the ordinate's kind; 1 is general.
_GENERAL, _TIME = 1, 17
_BY_UNIT = {"s": _TIME, "mm": 8, "mm/s": 11}
_HEADER_LINES = 11


def encode(table: ResultTable) -> Iterator[bytes]:
    """Every column as a time response named by its first line, its unit (mm, not m) in the ordinate's label.

    The abscissa is even, from the first time stamp at the median interval; the exact times are the function `time_s`.
    Words become codes. Binary, since the text form has twelve digits only. Raises UsageError below two rows.
    """
    if table.time_ns.size < 2:
        raise UsageError(f"A universal file needs two rows or more; received {table.time_ns.size}. Choose .csv.")
    step_s = float(np.median(np.diff(table.time_ns))) * 1e-9
    start_s = float(table.time_ns[0]) * 1e-9
    for number, (name, values) in enumerate(table.columns.items(), start=1):
        coded = codes(name, values)
        if coded is None and is_text(values):
            continue
        numbers = np.array(values if coded is None else coded, dtype=np.float64)
        yield _header(number, name, numbers, (start_s, step_s))
        yield numbers.astype("<f8").tobytes()
        yield b"    -1\n"


def _header(number: int, name: str, values: Floats, abscissa: tuple[float, float]) -> bytes:
    """The lines in front of the values; `abscissa` is start and step in s, of which six digits fit."""
    kind = _BY_UNIT.get(unit_of(name) or "", _GENERAL)
    lines = [
        "    -1",
        # Little endian (1), IEEE 754 (2).
        f"    58b{1:6d}{2:6d}{_HEADER_LINES:12d}{8 * values.size:12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        f"{name:<80}",
        f"{WRITTEN_BY:<80}",
        *[f"{'NONE':<80}"] * 3,
        # Time response (1), its number; the response point is numbered likewise, there is no reference point.
        f"{1:5d}{number:10d}{0:5d}{0:10d} {'NONE':10s}{number:10d}{0:4d} {'NONE':10s}{0:10d}{0:4d}",
        # Real double precision (4), even spacing (1).
        f"{4:10d}{values.size:10d}{1:10d}{abscissa[0]:13.5e}{abscissa[1]:13.5e}{0.0:13.5e}",
        _axis(_TIME, "time", "s"),
        _axis(kind, name[:20], unit_of(name) or "NONE"),
        _axis(0, "NONE", "NONE"),
        _axis(0, "NONE", "NONE"),
    ]
    return ("\n".join(lines) + "\n").encode()


def _axis(kind: int, label: str, unit: str) -> str:
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {label:<20s} {unit:<20s}"
