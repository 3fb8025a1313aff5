"""The metadata that a result's file carries: settings, calibration, version. Those of a CSV are in a JSON file of its
name, which says by a check sum which CSV it belongs to.
"""

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from midspan.sinks.table import ResultTable, metadata_json
from midspan.sinks.xlsx import METADATA_SHEET
from midspan.trees import TreeError, json_tree, read_json
from midspan.writing import replacing

KEY = "csv"


def read_metadata(path: Path) -> dict[str, Any]:
    """What `write_result` stored with the rows; empty for files without it, as of other programs."""
    try:
        found = _READERS[path.suffix.lower()](path)
    except (OSError, TreeError, KeyError, TypeError, ValueError, BadZipFile):
        return {}
    return found if isinstance(found, dict) else {}


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
    ".csv": lambda path: read_json(partner(path)),
    ".parquet": _of_parquet,
    ".h5": _of_hdf5,
    ".hdf5": _of_hdf5,
    ".mat": _of_matlab,
    ".xlsx": _of_xlsx,
    ".tdms": _of_tdms,
}


def partner(path: Path) -> Path:
    """The file of metadata of a CSV."""
    return path.with_suffix(".json")


def write_pair(path: Path, encoded: Iterator[bytes], table: ResultTable) -> None:
    """Write a CSV and its metadata with the CSV's rows and SHA-256 under the key `csv`.

    Each file is whole or absent; between their two renames a kill leaves the new metadata with the old CSV, which the
    check sum shows.
    """
    digest = hashlib.sha256()
    with replacing(partner(path), path) as (metadata, rows):
        for piece in encoded:
            digest.update(piece)
            rows.write(piece)
        own = {KEY: {"rows": len(table.time_ns), "sha256": digest.hexdigest()}}
        metadata.write((metadata_json(replace(table, metadata=table.metadata | own), indent=2) + "\n").encode())


def mismatch(path: Path) -> str | None:
    """A sentence where a CSV is not the one that the JSON file of its name was written for; None where it is.

    None as well where there is no such file, or one that names no check sum.
    """
    if path.suffix.lower() != ".csv":
        return None
    try:
        wanted = read_json(partner(path))[KEY]["sha256"]
    except (OSError, TreeError, KeyError, TypeError):
        return None
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if found == wanted:
        return None
    return (
        f"{path.name} and {partner(path).name} do not belong together (the SHA-256 differs): the CSV was changed, or "
        "its writing was interrupted. Its settings and calibration may be others; estimate again to be sure."
    )
