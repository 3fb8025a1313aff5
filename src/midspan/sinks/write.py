"""Result tables to files: one table from suffix to writer."""

import importlib
from collections.abc import Iterator
from pathlib import Path

from midspan.checks import path_of
from midspan.errors import UsageError
from midspan.sinks.metadata import write_pair
from midspan.sinks.table import ResultTable
from midspan.writing import cannot_be_written, replacing

# Name, suffixes, what it is written with, and the module that writes it.
_WRITERS = (
    ("CSV, with metadata in a .json next to it", (".csv",), "pyarrow", "csv"),
    ("Parquet", (".parquet",), "pyarrow", "parquet"),
    ("HDF5", (".h5", ".hdf5"), "h5py", "hdf5"),
    ("MATLAB 5", (".mat",), "scipy", "matlab"),
    ("Excel workbook", (".xlsx",), "openpyxl", "xlsx"),
    ("TDMS", (".tdms",), "npTDMS", "tdms"),
    ("miniSEED 2", (".mseed",), "pymseed", "miniseed"),
    ("Universal file, dataset 58", (".uff",), "midspan", "uff"),
)
FORMATS = tuple(row[:3] for row in _WRITERS)
"""Rows of (name, suffixes, what it is written with)."""

_MODULES = {suffix: module for _, suffixes, _, module in _WRITERS for suffix in suffixes}


def check_target(path: Path) -> None:
    """Raise UsageError if `write_result` could not write there: unknown suffix, or a folder that is missing."""
    _module(path)
    if not path.parent.is_dir():
        raise UsageError(
            f"{path} cannot be written: the folder {path.parent} does not exist. Create it or choose another."
        )


def _module(path: Path) -> str:
    module = _MODULES.get(path.suffix.lower())
    if module is None:
        raise UsageError(
            f"{path}: the suffix must be one of {', '.join(_MODULES)}; received {path.suffix!r}. Give one of them."
        )
    return module


def write_result(path: str | Path, table: ResultTable) -> Path:
    """Write a table in the format of the path's suffix; the file appears whole or not at all. Returns its path.

    A CSV gets a `.json` of the same name with its metadata. Raises UsageError for an unknown suffix, a folder that is
    missing or cannot be written, and a table that the format cannot hold.
    """
    path = path_of("path", path)
    module = _module(path)
    encoded: Iterator[bytes] = importlib.import_module(f"midspan.sinks.{module}").encode(table)
    if module == "csv":
        write_pair(path, encoded, table)
        return path
    with replacing(path) as (file,), cannot_be_written(path):
        for piece in encoded:
            file.write(piece)
    return path
