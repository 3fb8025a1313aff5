"""Excel workbooks: the first sheet with columns of numbers, read as the same table in a text file is."""

import csv
import warnings
from collections.abc import Iterator
from dataclasses import replace
from datetime import date, time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zipfile import ZipFile

from midspan.errors import DataError
from midspan.sources.accelerometer import text
from midspan.sources.accelerometer.channel import ChannelSet
from midspan.sources.boundary import require_memory


def read(path: Path) -> ChannelSet:
    """The numeric and time columns of the first sheet that has some; preamble, names and units as in a text file.

    Formulas count with the values that were saved with them. Raises DataError where no sheet holds columns of numbers.
    """
    from openpyxl import load_workbook

    with ZipFile(path) as archive:
        # The sheets are read row by row; the texts that they share are not.
        require_memory(path, max((one.file_size for one in archive.infolist()), default=0), "its largest part")
    with warnings.catch_warnings():
        # What the library does not keep (styles, extensions) is nothing that is read here.
        warnings.simplefilter("ignore")
        book = load_workbook(path, read_only=True, data_only=True)
    try:
        reasons = []
        for sheet in book.worksheets:
            try:
                found = _as_text(sheet)
            except DataError as error:
                reasons.append(error)
                continue
            # How the table was written for the reader of texts is no property of the workbook.
            notes = (f"sheet {sheet.title!r}", *found.notes[2:])
            return replace(found, notes=notes)
    finally:
        book.close()
    raise DataError(f"{path}: none of its {len(reasons)} sheets holds columns of numbers. Give a table of numbers.")


def _as_text(sheet: Any) -> ChannelSet:
    """A sheet by way of a text file with semicolons, which no blank in a cell can be taken for."""
    with TemporaryDirectory(prefix="midspan-") as folder:
        table = Path(folder) / "sheet.csv"
        with table.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, delimiter=";", lineterminator="\n").writerows(_rows(sheet))
        return text.read(table)


def _rows(sheet: Any) -> Iterator[list[str]]:
    """The rows with a content; those of words, a preamble among them, are as long as they are filled."""
    # Some programs declare a million rows of sixteen thousand columns: only what is there counts.
    sheet.reset_dimensions()
    for row in sheet.iter_rows(values_only=True):
        cells = [_text(value) for value in row]
        if not any(isinstance(value, int | float) for value in row):
            while cells and not cells[-1]:
                cells.pop()
        if cells:
            yield cells


def _text(value: Any) -> str:
    """A cell as a text file has it."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, date | time):
        return value.isoformat()
    return " ".join(str(value).split())
