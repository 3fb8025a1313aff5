"""CSV; the JSON file of its metadata is written with it, see `sinks/metadata.py`."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.sinks.table import ResultTable, codes, is_text, words_of

_ROWS_AT_ONCE = 200_000
# Decimals of the numbers: a picometre for mm, far below any sensor; without them 17 digits would be written.
_DECIMALS = 9
# Arrow writes decimal numbers below a microsecond with an exponent (0E-9): such stamps are written as texts.
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
        if np.all(np.abs(stamps) >= _SMALL_NS):
            return _decimal_seconds(stamps)
        return pa.array([f"{'-' if t < 0 else ''}{abs(t) // 10**9}.{abs(t) % 10**9:09d}" for t in stamps.tolist()])
    if coded is not None:
        return word_column(name, coded[rows]).dictionary_decode()
    if is_text(values):
        return pa.array(np.asarray(values[rows]).astype(str).tolist())
    part = np.asarray(values[rows])
    if part.dtype.kind != "f":
        return pa.array(part)
    # Adding zero turns the -0.0 that rounding leaves into 0.0.
    return pa.array(np.round(part.astype(np.float64), _DECIMALS) + 0.0, from_pandas=True)


def word_column(name: str, coded: NDArray[np.uint8]) -> Any:
    """Codes (n,) of `source` or `status` as a dictionary array of their words."""
    import pyarrow as pa

    return pa.DictionaryArray.from_arrays(pa.array(coded.astype(np.int8)), pa.array(list(words_of(name) or ())))


def _decimal_seconds(time_ns: Any) -> Any:
    """Nanoseconds as decimal numbers with nine places: the 128-bit integers that Arrow keeps for them."""
    import pyarrow as pa

    wide = np.empty((time_ns.size, 2), dtype="<i8")
    wide[:, 0] = time_ns
    wide[:, 1] = np.where(time_ns < 0, -1, 0)
    return pa.Array.from_buffers(pa.decimal128(28, 9), time_ns.size, [None, pa.py_buffer(wide.tobytes())])
