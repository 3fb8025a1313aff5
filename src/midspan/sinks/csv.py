"""CSV; the JSON file of its metadata is written with it, see `sinks/pair.py`."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from midspan.sinks.arrow import word_column
from midspan.sinks.table import ResultTable, codes, is_text

_ROWS_AT_ONCE = 200_000
# Decimals of the numbers: a picometre for mm, far below any sensor; without them 17 digits would be written.
_DECIMALS = 9
# Arrow writes decimal numbers below a microsecond with an exponent.
_SMALL_NS = 1000


def encode(table: ResultTable) -> Iterator[bytes]:
    """Header and rows; `time_s` from the exact stamps with nine decimals, NaN as an empty field."""
    import pyarrow as pa
    from pyarrow import csv

    count = table.time_ns.size
    coded = {name: codes(name, values) for name, values in table.columns.items()}
    free_text = any(coded[name] is None and is_text(values) for name, values in table.columns.items())
    options = csv.WriteOptions(include_header=False, quoting_style="needed" if free_text else "none")
    yield (",".join(table.columns) + "\n").encode()
    for start in range(0, count, _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, count))
        columns = {name: _column(name, values, coded[name], rows, table) for name, values in table.columns.items()}
        stream = pa.BufferOutputStream()
        csv.write_csv(pa.table(columns), stream, options)
        yield stream.getvalue().to_pybytes()


def _column(name: str, values: Any, coded: Any, rows: slice, table: ResultTable) -> Any:
    import pyarrow as pa

    if name == "time_s":
        stamps = table.time_ns[rows]
        return _small_seconds(stamps) if np.any(np.abs(stamps) < _SMALL_NS) else _decimal_seconds(stamps)
    if coded is not None:
        return word_column(name, coded[rows]).dictionary_decode()
    if is_text(values):
        return pa.array(np.asarray(values[rows]).astype(str).tolist())
    part = np.asarray(values[rows])
    if part.dtype.kind != "f":
        return pa.array(part)
    # Adding zero turns the -0.0 that rounding leaves into 0.0.
    return pa.array(np.round(part.astype(np.float64), _DECIMALS) + 0.0, from_pandas=True)


def _small_seconds(time_ns: Any) -> Any:
    """The same as text, for stamps that Arrow would write with an exponent (0E-9)."""
    import pyarrow as pa

    return pa.array([f"{'-' if t < 0 else ''}{abs(t) // 10**9}.{abs(t) % 10**9:09d}" for t in time_ns.tolist()])


def _decimal_seconds(time_ns: Any) -> Any:
    """Nanoseconds as decimal numbers with nine places: the 128-bit integers that Arrow keeps for them."""
    import pyarrow as pa

    wide = np.empty((time_ns.size, 2), dtype="<i8")
    wide[:, 0] = time_ns
    wide[:, 1] = np.where(time_ns < 0, -1, 0)
    return pa.Array.from_buffers(pa.decimal128(28, 9), time_ns.size, [None, pa.py_buffer(wide.tobytes())])
