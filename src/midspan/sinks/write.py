"""Result tables to files: one table from suffix to writer."""

import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from midspan.checks import path_of
from midspan.errors import UsageError
from midspan.sinks.pair import write_pair
from midspan.sinks.table import ResultTable
from midspan.writing import cannot_be_written, replacing


@dataclass(frozen=True, slots=True)
class _Format:
    name: str
    suffixes: tuple[str, ...]
    writer: str
    module: str


_FORMATS = (
    _Format("CSV, with metadata in a .json beside it", (".csv",), "pyarrow", "csv"),
    _Format("Parquet", (".parquet",), "pyarrow", "parquet"),
    _Format("HDF5", (".h5", ".hdf5"), "h5py", "hdf5"),
    _Format("MATLAB 5", (".mat",), "scipy", "matlab"),
    _Format("Excel workbook", (".xlsx",), "openpyxl", "xlsx"),
    _Format("TDMS", (".tdms",), "npTDMS", "tdms"),
    _Format("miniSEED 2", (".mseed",), "pymseed", "miniseed"),
    _Format("Universal file, dataset 58", (".uff",), "midspan", "uff"),
)

FORMATS = tuple((row.name, row.suffixes, row.writer) for row in _FORMATS)
"""Rows of (name, suffixes, what it is written with)."""

_BY_SUFFIX = {suffix: row for row in _FORMATS for suffix in row.suffixes}


def check_target(path: Path) -> None:
    """Raise UsageError if `write_result` could not write there: unknown suffix, or a folder that is missing."""
    _format(path)
    if not path.parent.is_dir():
        raise UsageError(
            f"{path} cannot be written: the folder {path.parent} does not exist. Make it or choose another."
        )


def _format(path: Path) -> _Format:
    row = _BY_SUFFIX.get(path.suffix.lower())
    if row is None:
        raise UsageError(
            f"{path}: the suffix must be one of {', '.join(_BY_SUFFIX)}; received {path.suffix!r}. Give one of them."
        )
    return row


def write_result(path: str | Path, table: ResultTable) -> Path:
    """Write a table in the format of the path's suffix; the file appears whole or not at all. Returns its path.

    A CSV gets a `.json` of the same name with its metadata. Raises UsageError for an unknown suffix, a folder that is
    missing or cannot be written, and a table that the format cannot hold.
    """
    path = path_of("path", path)
    row = _format(path)
    encoded: Iterator[bytes] = importlib.import_module(f"midspan.sinks.{row.module}").encode(table)
    if row.module == "csv":
        write_pair(path, encoded, table)
        return path
    with replacing(path) as (file,), cannot_be_written(path):
        for piece in encoded:
            file.write(piece)
    return path
