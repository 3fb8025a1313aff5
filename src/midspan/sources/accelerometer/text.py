"""Text columns: csv, txt, dat and asc in any dialect."""

import warnings
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.sources.accelerometer.channel import Channel, ChannelSet, Values
from midspan.sources.accelerometer.clock import TIME_UNITS, texts_to_ns
from midspan.sources.accelerometer.dialect import BLANKS, Dialect, find_dialect
from midspan.sources.accelerometer.last_line import cut_last_line
from midspan.sources.boundary import require_memory

if TYPE_CHECKING:
    import pandas as pd


def read(path: Path) -> ChannelSet:
    """All numeric and time columns of a text file.

    Encoding, delimiter, decimal sign, preamble, header and units are found and told in the notes. What is no number
    becomes NaN. Columns of words are left out. Raises DataError where no columns of numbers are found.
    """
    require_memory(path, path.stat().st_size, "its table")
    dialect = find_dialect(path)
    cut = cut_last_line(path, encoding=dialect.encoding, delimiter=dialect.delimiter, decimal=dialect.decimal)
    text = _Text(path, dialect, None if cut is None else cut[0])
    frame, notes = _parse(text)
    found = [f"encoding {dialect.encoding}", *dialect.notes, *notes]
    channels: list[Channel] = []
    for k in _numeric_columns(dialect):
        if dialect.joined is not None and k == dialect.joined + 1:
            continue
        column = frame[k]
        if k == dialect.joined:
            column = column.astype("str").str.cat(frame[k + 1].astype("str"), sep="T")
        exact = _exact_epoch(text, k) if _is_fractional_epoch(column, dialect.units[k]) else None
        if exact is not None:
            channels.append(Channel(dialect.names[k], exact, "ns"))
            continue
        channel, said = _channel(_joined_name(dialect, k), dialect.units[k], column, dialect.decimal)
        found += [note for note in said if note not in found]
        channels += [channel] if channel else []
    return ChannelSet(tuple(channels), tuple(found), () if cut is None or not cut[1] else (cut[1],))


def _numeric_columns(dialect: Dialect) -> list[int]:
    return [k for k in range(len(dialect.names)) if k not in dialect.words]


def _joined_name(dialect: Dialect, column: int) -> str:
    """A date column joined with its time of day goes by the latter's name, unless one heading stood for both."""
    if column != dialect.joined or dialect.names[column + 1].endswith(" of day"):
        return dialect.names[column]
    return dialect.names[column + 1]


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
    if not pd.api.types.is_numeric_dtype(column):
        moments = texts_to_ns(column)
        if moments is not None:
            return Channel(name, moments[0], "ns"), moments[1]
        return _numbers_among_words(name, unit, column, decimal)
    return Channel(name, _values(column, unit), unit), ()


def _values(column: "pd.Series[Any]", unit: str | None) -> Values:
    """Whole numbers that may be epoch stamps stay whole: float64 would lose their last digits."""
    values = column.to_numpy()
    epoch = values.dtype.kind == "i" and values.size and abs(int(values[-1])) >= 1_000_000_000
    if epoch and (unit is None or unit.lower() in TIME_UNITS):
        return values.astype(np.int64)
    return np.ascontiguousarray(values, dtype=np.float64)


def _numbers_among_words(
    name: str, unit: str | None, column: "pd.Series[Any]", decimal: str
) -> tuple[Channel | None, tuple[str, ...]]:
    """A column in which single cells are no numbers: those become NaN; a column of words alone gives no channel."""
    import pandas as pd

    texts = column.astype("str").str.strip()
    if decimal == ",":
        texts = texts.str.replace(",", ".", regex=False)
    values = pd.to_numeric(texts, errors="coerce").to_numpy(dtype=np.float64)
    if not np.isfinite(values).any():
        return None, ()
    lost = int(np.count_nonzero(np.isnan(values) & column.notna().to_numpy()))
    return Channel(name, values, unit), (f"{lost} cells of {name} are no numbers and count as missing",) if lost else ()
