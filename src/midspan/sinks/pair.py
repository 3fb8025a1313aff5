"""A CSV and the JSON file of its metadata, which says by a check sum which CSV it belongs to."""

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from midspan.sinks.table import ResultTable, metadata_json
from midspan.trees import TreeError, read_json
from midspan.writing import replacing

KEY = "csv"


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
