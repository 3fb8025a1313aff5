"""A table of results back from its file, to be written in another format."""

from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from midspan.errors import DataError, UsageError
from midspan.records import NANOSECONDS, Nanoseconds
from midspan.sinks.metadata import KEY, read_metadata
from midspan.sinks.table import ResultTable, is_text, unit_of, words_of
from midspan.sinks.tdms import GROUP
from midspan.sinks.xlsx import ROWS_SHEET
from midspan.sources.boundary import reading, require_file

TIME = "time_s"


def read_table(path: Path) -> ResultTable:
    """The columns and the metadata of a file that `write_result` wrote, of the formats that hold all of them.

    Raises UsageError for another format, DataError for a file that is no such table.
    """
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise UsageError(
            f"{path}: must be a result in one of {', '.join(READERS)}, which hold all columns and the metadata; "
            f"received {suffix!r}. Name the result in one of these formats."
        )
    require_file(path)
    with reading(path, "a result"):
        columns: dict[str, Any] = {name: np.asarray(values) for name, values in READERS[suffix](path).items()}
        for name, values in columns.items():
            if words_of(name) is not None:
                # Without the blanks of formats with a fixed length.
                texts = (one.decode() if isinstance(one, bytes) else one for one in values.tolist())
                columns[name] = [str(text).strip() for text in texts]
    if not len(columns.get(TIME, ())):
        raise DataError(f"{path} holds no rows with a column {TIME}. Name a file that midspan wrote.")
    text_columns = [name for name, one in columns.items() if name != TIME and unit_of(name) and is_text(one)]
    if text_columns:
        raise DataError(
            f"{path}: the column {text_columns[0]} holds text; it must hold numbers only. Correct the file."
        )
    time_ns = _stamps(path, columns[TIME])
    columns[TIME] = time_ns / NANOSECONDS
    metadata = {key: value for key, value in read_metadata(path).items() if key != KEY}
    return ResultTable(columns=columns, time_ns=time_ns, metadata=metadata)


def _stamps(path: Path, values: Any) -> Nanoseconds:
    """Stamps (n,) to the nearest ns of texts or floats of seconds.

    Raises DataError for a stamp that is no number, or not later than the one before.
    """
    try:
        if is_text(values):
            # The digits of the file: a float keeps seven decimals of a time of today.
            time_ns = np.array([int(Decimal(one).scaleb(9).to_integral_value()) for one in values], dtype=np.int64)
        else:
            time_ns = np.array([round(NANOSECONDS * float(one)) for one in values], dtype=np.int64)
    except (ArithmeticError, ValueError, TypeError):
        raise DataError(f"{path}: {TIME} must be a number of seconds in every row. Correct the file.") from None
    late = np.flatnonzero(np.diff(time_ns) <= 0)
    if late.size:
        before, after = time_ns[late[0] : late[0] + 2] / NANOSECONDS
        raise DataError(
            f"{path}: {TIME} must grow from row to row; the row at {after} s follows that at {before} s. Sort the rows."
        )
    return time_ns


def _of_csv(path: Path) -> dict[str, Any]:
    import pyarrow as pa
    from pyarrow import csv

    exact = csv.ConvertOptions(column_types={TIME: pa.string()})
    table = csv.read_csv(path, convert_options=exact)
    return {name: table[name].to_numpy() for name in table.column_names}


def _of_parquet(path: Path) -> dict[str, Any]:
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    return {name: np.asarray(table[name].to_pylist()) for name in table.column_names}


def _of_hdf5(path: Path) -> dict[str, Any]:
    import h5py

    with h5py.File(path) as file:
        return {name: file[name][()] for name in file}


def _of_matlab(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    found = loadmat(path)
    names = [name for name in found if not name.startswith("__") and name != "midspan"]
    return {name: found[name].ravel() for name in names}


def _of_xlsx(path: Path) -> dict[str, Any]:
    import pandas as pd

    frame = pd.read_excel(path, sheet_name=ROWS_SHEET, engine="openpyxl")
    return {str(name): frame[name].to_numpy() for name in frame}


def _of_tdms(path: Path) -> dict[str, Any]:
    from nptdms import TdmsFile

    with TdmsFile.open(path) as file:
        return {channel.name: channel[:] for channel in file[GROUP].channels()}


READERS: dict[str, Callable[[Path], dict[str, Any]]] = {
    ".csv": _of_csv,
    ".parquet": _of_parquet,
    ".h5": _of_hdf5,
    ".hdf5": _of_hdf5,
    ".mat": _of_matlab,
    ".xlsx": _of_xlsx,
    ".tdms": _of_tdms,
}
