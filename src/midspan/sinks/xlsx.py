"""Excel workbooks: the rows in a sheet `result`, the metadata in a sheet `midspan`."""

import errno
import io
import os
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

import numpy as np

from midspan.errors import UsageError
from midspan.sinks.table import ResultTable, is_text, metadata_json, words_or_numbers
from midspan.writing import WRITTEN_BY

ROWS_SHEET, METADATA_SHEET = "result", "midspan"
# Rows of a sheet, and characters of a cell; source: Microsoft, "Excel specifications and limits".
MAX_ROWS, MAX_CHARACTERS = 1_048_576, 32_767
_PROPERTIES = "docProps/core.xml"
# The first date of a ZIP archive stands for none.
_NO_DATE = datetime(1980, 1, 1)


class _Archive(ZipFile):
    """An archive without dates, so that the same table gives the same bytes, whose properties, which say who wrote it,
    are not compressed: they can be found.
    """

    def writestr(self, name: Any, data: Any, *_: Any) -> None:
        """Add a file."""
        super().writestr(ZipInfo(name), data, ZIP_STORED if name == _PROPERTIES else ZIP_DEFLATED)

    def write(self, filename: Any, arcname: Any = None, *_: Any) -> None:
        """Add a file that the library keeps on disk."""
        self.writestr(arcname, Path(filename).read_bytes())


def encode(table: ResultTable) -> Iterator[bytes]:
    """A heading and the rows; words as texts, NaN as empty cells; the metadata as JSON text in pieces, a row each.

    Raises UsageError for more rows than a sheet holds.
    """
    from openpyxl import Workbook
    from openpyxl.writer.excel import ExcelWriter

    count = len(table.time_ns)
    if count >= MAX_ROWS:
        raise UsageError(f"A sheet of .xlsx holds {MAX_ROWS - 1} rows; received {count}. Choose .csv or .parquet.")
    columns = [_cells(name, values) for name, values in table.columns.items()]
    book = Workbook(write_only=True)
    book.properties.creator = WRITTEN_BY
    book.properties.created = book.properties.modified = _NO_DATE
    rows, metadata = book.create_sheet(ROWS_SHEET), book.create_sheet(METADATA_SHEET)
    stream = io.BytesIO()
    try:
        rows.append(list(table.columns))
        for row in zip(*columns, strict=True):
            rows.append(row)
        text = metadata_json(table)
        for start in range(0, len(text), MAX_CHARACTERS):
            metadata.append([text[start : start + MAX_CHARACTERS]])
        with _Archive(stream, "w", ZIP_DEFLATED, allowZip64=True) as archive:
            ExcelWriter(book, archive).save()
    except Exception as error:
        # The library keeps sheets in temporary files, which would complain of a full disk once more, later.
        for sheet in (rows, metadata):
            for writing in filter(None, (sheet._rows, getattr(sheet._writer, "xf", None))):
                with suppress(Exception):
                    writing.close()
        # Where lxml is installed it writes them, and has errors of its own: IO_ENOSPC.
        code = getattr(errno, str(error).removeprefix("IO_"), None)
        if code is None:
            raise
        raise OSError(code, os.strerror(code)) from error
    yield stream.getvalue()


def _cells(name: str, values: Any) -> list[Any]:
    array = words_or_numbers(name, values)
    cells = array.astype(object)
    if not is_text(array):
        cells[~np.isfinite(array)] = None
    return list(cells)
