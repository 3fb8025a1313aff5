"""The metadata that a result's file carries: settings, calibration, version."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from midspan.sinks.pair import partner
from midspan.sinks.xlsx import METADATA_SHEET
from midspan.trees import TreeError, json_tree, read_json


def read_metadata(path: Path) -> dict[str, Any]:
    """What `write_result` stored with the rows; empty for files without it, as of other programs."""
    try:
        found = _READERS[path.suffix.lower()](path)
    except (OSError, TreeError, KeyError, TypeError, ValueError, BadZipFile):
        return {}
    return found if isinstance(found, dict) else {}


def _of_csv(path: Path) -> Any:
    return read_json(partner(path))


def _of_parquet(path: Path) -> Any:
    import pyarrow.parquet

    return json_tree(pyarrow.parquet.read_schema(path).metadata[b"midspan"].decode())


def _of_hdf5(path: Path) -> Any:
    import h5py

    with h5py.File(path) as file:
        return json_tree(str(file.attrs["midspan"]))


def _of_matlab(path: Path) -> Any:
    from scipy.io import loadmat

    return json.loads(str(loadmat(path, variable_names=["midspan"])["midspan"][0]))


def _of_xlsx(path: Path) -> Any:
    from openpyxl import load_workbook

    book = load_workbook(path, read_only=True)
    try:
        return json_tree("".join(str(row[0]) for row in book[METADATA_SHEET].iter_rows(values_only=True)))
    finally:
        book.close()


def _of_tdms(path: Path) -> Any:
    from nptdms import TdmsFile

    return json_tree(str(TdmsFile.read_metadata(path).properties["midspan"]))


_READERS: dict[str, Callable[[Path], Any]] = {
    ".csv": _of_csv,
    ".parquet": _of_parquet,
    ".h5": _of_hdf5,
    ".hdf5": _of_hdf5,
    ".mat": _of_matlab,
    ".xlsx": _of_xlsx,
    ".tdms": _of_tdms,
}
