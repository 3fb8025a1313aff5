"""Result tables to files: one table from suffix to writer."""

import importlib
from dataclasses import dataclass
from pathlib import Path

from midspan.errors import UsageError
from midspan.sinks.replace import replacing
from midspan.sinks.table import ResultTable


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
    _Format("miniSEED 3", (".mseed",), "pymseed", "miniseed"),
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


def write_result(path: Path, table: ResultTable) -> None:
    """Write a table in the format of the path's suffix; the file appears whole or not at all.

    CSV puts the metadata into a `.json` beside it. Raises UsageError for an unknown suffix, a folder that is missing or
    cannot be written, and a table that the format cannot hold.
    """
    row = _format(path)
    writer = importlib.import_module(f"midspan.sinks.{row.module}")
    if row.module == "csv":
        with replacing(path.with_suffix(".json"), path) as (beside, temporary):
            writer.write(temporary, table)
            writer.write_metadata(beside, table)
        return
    with replacing(path) as (temporary,):
        writer.write(temporary, table)
