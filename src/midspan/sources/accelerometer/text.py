"""Text columns in any dialect (csv, txt, dat, asc), and Excel workbooks, read as the same table in a text file is."""

import csv
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import date, time
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.sources.accelerometer.channel import Channel, ChannelSet
from midspan.sources.accelerometer.clock import TEXT, TIME_UNITS, is_time_name, texts_to_ns
from midspan.sources.accelerometer.dialect import BLANKS, Dialect, find_dialect
from midspan.sources.accelerometer.last_line import cut_last_line
from midspan.sources.boundary import require_memory

if TYPE_CHECKING:
    import pandas as pd


def read(path: Path) -> ChannelSet:
    """All numeric and time columns of a text file.

    Encoding, delimiter, decimal sign, preamble, header and units are found and reported in the notes. What is no number
    becomes NaN. Columns of words are left out. Raises DataError where no columns of numbers are found.
    """
    require_memory(path, path.stat().st_size, "its table")
    dialect = find_dialect(path)
    cut = cut_last_line(path, encoding=dialect.encoding, delimiter=dialect.delimiter, decimal=dialect.decimal)
    text = _Text(path, dialect, None if cut is None else cut[0])
    frame, notes = _parse(text)
    found = [f"encoding {dialect.encoding}", *dialect.notes, *notes]
    found += [f"{name!r} {TEXT}" for k in dialect.words if is_time_name(name := dialect.names[k])]
    channels: list[Channel] = []
    for k in _numeric_columns(dialect):
        if dialect.joined is not None and k == dialect.joined + 1:
            continue
        column, name = frame[k], dialect.names[k]
        if k == dialect.joined:
            column = column.astype("str").str.cat(frame[k + 1].astype("str"), sep="T")
            # They go by the name of the time of day, unless one heading stood for both.
            other = dialect.names[k + 1]
            name = name if other.endswith(" of day") else other
        exact = _exact_epoch(text, k) if _is_fractional_epoch(column, dialect.units[k]) else None
        if exact is not None:
            channels.append(Channel(name, exact, "ns"))
            continue
        channel, said = _channel(name, dialect.units[k], column, dialect.decimal)
        found += [note for note in said if note not in found]
        channels += [channel] if channel else []
    return ChannelSet(tuple(channels), tuple(found), () if cut is None or not cut[1] else (cut[1],))


def _numeric_columns(dialect: Dialect) -> list[int]:
    return [k for k in range(len(dialect.names)) if k not in dialect.words]


@dataclass(frozen=True, slots=True)
class _Text:
    """A text file, how it is written, and its bytes that count (None: all)."""

    path: Path
    dialect: Dialect
    end: int | None

    def opened(self) -> Path | BytesIO:
        """What pandas reads."""
        return self.path if self.end is None else BytesIO(self.path.read_bytes()[: self.end])


def _parse(text: _Text, only: int | None = None) -> tuple["pd.DataFrame", list[str]]:
    """All columns as pandas reads them, or one column as it is written."""
    import pandas as pd

    dialect = text.dialect
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            frame = pd.read_csv(
                text.opened(),
                sep=dialect.delimiter,
                decimal=dialect.decimal,
                header=None,
                names=list(range(len(dialect.names))),
                usecols=_numeric_columns(dialect) if only is None else [only],
                dtype=None if only is None else "string[pyarrow]",
                index_col=False,
                skiprows=dialect.first_row,
                comment=dialect.comment,
                encoding=dialect.encoding,
                encoding_errors="replace",
                skipinitialspace=dialect.delimiter != BLANKS,
                low_memory=only is not None,
                on_bad_lines="warn",
            )
        except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError) as error:
            raise DataError(
                f"{text.path} could not be read as text columns: {error}. Check the file's rows."
            ) from error
    lost = sum(str(w.message).count("Skipping line") for w in caught)
    return frame, [f"{lost} lines with too many fields left out"] if lost else []


def _is_fractional_epoch(column: "pd.Series[Any]", unit: str | None) -> bool:
    """Whether these can be seconds since 1970 (2001 on) with decimals, of which a float keeps seven only."""
    if column.dtype.kind != "f" or not len(column) or (unit or "s").lower() not in TIME_UNITS:
        return False
    return bool(1e9 <= column.iloc[0] < 1e10 and 1e9 <= column.iloc[-1] < 1e10)


def _exact_epoch(text: _Text, column: int) -> NDArray[np.int64] | None:
    """Nanoseconds of a column of decimal seconds, from its digits; None where a field is missing or has an exponent."""
    import pyarrow as pa

    texts = _parse(text, column)[0].iloc[:, 0].str.strip()
    if text.dialect.decimal == ",":
        texts = texts.str.replace(",", ".", regex=False)
    try:
        # pandas keeps text in one piece or in several, depending on the file's size.
        given = pa.array(texts, type=pa.string())
        whole = given.combine_chunks() if isinstance(given, pa.ChunkedArray) else given
        decimals = whole.cast(pa.decimal128(28, 9))
    except pa.ArrowInvalid:
        return None
    if decimals.null_count:
        return None
    # The lower half of the 128 bits: an int64 of nanoseconds fits in it.
    halves = np.frombuffer(decimals.buffers()[1], dtype="<i8").reshape(-1, 2)
    return np.ascontiguousarray(halves[decimals.offset : decimals.offset + len(decimals), 0], dtype=np.int64)


def _channel(
    name: str, unit: str | None, column: "pd.Series[Any]", decimal: str
) -> tuple[Channel | None, tuple[str, ...]]:
    import pandas as pd

    if pd.api.types.is_bool_dtype(column):
        column = column.astype("float64")
    if pd.api.types.is_numeric_dtype(column):
        values = column.to_numpy()
        # Whole numbers that may be epoch stamps stay whole: float64 would lose their last digits.
        epoch = values.dtype.kind == "i" and values.size and abs(int(values[-1])) >= 1_000_000_000
        is_whole = epoch and (unit is None or unit.lower() in TIME_UNITS)
        stored = values.astype(np.int64) if is_whole else np.ascontiguousarray(values, dtype=np.float64)
        return Channel(name, stored, unit), ()
    moments = texts_to_ns(column)
    if moments is not None:
        return Channel(name, moments[0], "ns"), moments[1]
    # Single cells that are no numbers become NaN; a column of words alone gives no channel.
    texts = column.astype("str").str.strip()
    texts = texts.str.replace(",", ".", regex=False) if decimal == "," else texts
    numbers = pd.to_numeric(texts, errors="coerce").to_numpy(dtype=np.float64)
    if not np.isfinite(numbers).any():
        return None, ()
    lost = int(np.count_nonzero(np.isnan(numbers) & column.notna().to_numpy()))
    notes = (f"{lost} cells of {name} are no numbers and count as missing",) if lost else ()
    return Channel(name, numbers, unit), notes


def read_xlsx(path: Path) -> ChannelSet:
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
        for sheet in book.worksheets:
            with TemporaryDirectory(prefix="midspan-") as folder:
                # By way of a text file with semicolons, which no blank in a cell can be taken for.
                table = Path(folder) / "sheet.csv"
                with table.open("w", encoding="utf-8", newline="") as file:
                    csv.writer(file, delimiter=";", lineterminator="\n").writerows(_rows(sheet))
                try:
                    found = read(table)
                except DataError:
                    continue
            # How the table was written for the reader of texts is no property of the workbook.
            return replace(found, notes=(f"sheet {sheet.title!r}", *found.notes[2:]))
        count = len(book.worksheets)
    finally:
        book.close()
    raise DataError(f"{path}: none of its {count} sheets holds columns of numbers. Give a table of numbers.")


def _rows(sheet: Any) -> Iterator[list[str]]:
    """The rows with a content; those of words, a preamble among them, are as long as they are filled."""
    # Some programs declare a million rows of sixteen thousand columns: only what is there counts.
    sheet.reset_dimensions()
    for row in sheet.iter_rows(values_only=True):
        cells = [_cell(value) for value in row]
        if not any(isinstance(value, int | float) for value in row):
            while cells and not cells[-1]:
                cells.pop()
        if cells:
            yield cells


def _cell(value: Any) -> str:
    """A cell as a text file has it."""
    if isinstance(value, date | time):
        return value.isoformat()
    value = int(value) if isinstance(value, bool) else value
    return "" if value is None else " ".join(str(value).split())
