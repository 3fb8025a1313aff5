"""Time columns to int64 nanoseconds: seconds, epoch numbers of any magnitude, ISO 8601 and other written dates."""

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from midspan.errors import DataError
from midspan.records import NANOSECONDS, Nanoseconds
from midspan.sources.accelerometer.channel import Values

if TYPE_CHECKING:
    import pandas as pd

NOT_A_TIME = np.iinfo(np.int64).min

# Nanoseconds in one unit of a time column.
TIME_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sekunden"), NANOSECONDS),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1_000_000),
    **dict.fromkeys(("us", "µs", "μs", "usec", "microsecond", "microseconds"), 1_000),
    **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds"), 1),
    **dict.fromkeys(("min", "minutes"), 60 * NANOSECONDS),
    **dict.fromkeys(("h", "hours"), 3600 * NANOSECONDS),
}

TIME_NAMES = (
    *(
        "time",
        "time_s",
        "time_ns",
        "time_us",
        "time_ms",
        "t",
        "t_s",
        "timestamp",
        "time_stamp",
        "datetime",
        "date_time",
    ),
    *("date", "epoch", "utc", "seconds", "sec", "elapsed", "x_value", "zeit", "temps", "tiempo"),
)

# How the note ends on a column of times without any.
TEXT = "left out: it holds words, no times"
# From this magnitude on a number without a unit is an epoch in ms, µs, ns: the year 5138 in s is 1e11.
_EPOCH_MAGNITUDES = ((1e17, 1, "ns"), (1e14, 1_000, "µs"), (1e11, 1_000_000, "ms"))

_DATE = r"\d{4}-?\d{2}-?\d{2}|\d{1,4}[./]\d{1,2}[./]\d{2,4}"
_CLOCK = r"\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d+|:\d{1,3})?)?(?:\s?(?:Z|[+-]\d{2}:?\d{2}))?"
_DATE_PATTERN = re.compile(rf"^(?:{_DATE})$")
_CLOCK_PATTERN = re.compile(rf"^{_CLOCK}$")
_STAMP_PATTERN = re.compile(rf"^(?:{_DATE})(?:T|\s+)(?:{_CLOCK}|\d{{6}}(?:[.,]\d+)?Z?)$")
_THOUSANDTHS = r"^(.*\d{1,2}:\d{2}:\d{2}):(\d{1,3})$"
_ZONE_PATTERN = re.compile(r"(?:Z|[+-]\d{2}:?\d{2})$")


def is_time_name(name: str) -> bool:
    """Whether a channel of this name holds times."""
    last = re.split(r"[/.]", name.lower())[-1].strip()
    return last in TIME_NAMES or last.startswith(("time", "zeit")) or "timestamp" in last


def is_date(text: str) -> bool:
    """Whether a field is a calendar date that no number could be, such as 2024-05-01 or 01.05.2024."""
    return bool(_DATE_PATTERN.match(text)) and not text.isdigit()


def is_clock(text: str) -> bool:
    """Whether a field is a time of day such as 12:30:00.25."""
    return bool(_CLOCK_PATTERN.match(text))


def is_time_text(text: str) -> bool:
    """Whether a field is a written time: a date, a time of day or both."""
    return is_date(text) or is_clock(text) or bool(_STAMP_PATTERN.match(text))


def numbers_to_ns(values: Values, unit: str | None) -> tuple[Nanoseconds, str]:
    """Time stamps (n,) of a numeric time column, and a note on how it was understood.

    `unit` is one of `TIME_UNITS`; without it (or with "s" and numbers far too large for seconds) the magnitude decides
    between seconds (relative or since 1970) and ms, µs or ns since 1970. NaN becomes `NOT_A_TIME`.
    """
    known = TIME_UNITS.get((unit or "").lower())
    largest = float(np.nanmax(np.abs(values))) if values.size and not np.all(np.isnan(values)) else 0.0
    factor, note = known or NANOSECONDS, f"time in {unit}" if known else "time taken as seconds"
    if known is None or known == NANOSECONDS:
        for magnitude, per_unit, word in _EPOCH_MAGNITUDES:
            if largest >= magnitude:
                factor, note = per_unit, f"time taken as {word} since 1970 by its magnitude"
                break
    if largest * factor > 9.2e18:
        raise DataError(
            f"Time of {largest:g} {unit or 's'} lies beyond the year 2262. Correct the time column or its unit."
        )
    return _scaled(values, factor), note


def _scaled(values: Values, factor: int) -> Nanoseconds:
    if values.dtype == np.int64:
        whole = values.astype(np.int64)
        return np.asarray(np.where(whole == NOT_A_TIME, NOT_A_TIME, whole * np.int64(factor)), dtype=np.int64)
    # Whole and fractional part apart: an epoch in seconds times 1e9 would not fit the 53 bits of a float.
    lost = np.isnan(values)
    whole = np.floor(np.where(lost, 0.0, values))
    fraction = np.where(lost, 0.0, values) - whole
    time_ns = whole.astype(np.int64) * np.int64(factor) + np.rint(fraction * factor).astype(np.int64)
    time_ns[lost] = NOT_A_TIME
    return time_ns


def texts_to_ns(texts: "Sequence[str | None] | pd.Series[Any]") -> tuple[Nanoseconds, tuple[str, ...]] | None:
    """Time stamps (n,) of written times and notes; None if the column holds no written times.

    Understood are ISO 8601 with or without a zone (without: UTC), dates with dots (day first) or slashes (the year
    first, or the day, or the month where the numbers tell), and a bare time of day (since midnight); thousandths of a
    second can follow a point, a comma or a colon. What cannot be read becomes `NOT_A_TIME`.
    """
    import pandas as pd

    series = pd.Series(texts, dtype="str")
    start = series.iloc[:1000].dropna().str.strip()
    start = start[start != ""]
    if start.empty or not is_time_text(str(start.iloc[0])):
        return None
    series = series.str.strip()
    if series.str.contains(",", regex=False).any():
        series = series.str.replace(",", ".", regex=False)
    # Times such as 12:30:00:025, whose last part counts thousandths of a second, become 12:30:00.025.
    parts = series.str.extract(_THOUSANDTHS)
    if not parts[1].isna().all():
        series = series.where(parts[1].isna(), parts[0] + "." + parts[1].str.zfill(3))
    first = str(start.iloc[0])
    if is_clock(first):
        elapsed = pd.to_timedelta(series, errors="coerce")
        return _stamps(elapsed.dt.as_unit("ns")), ("time of day taken as seconds since midnight",)
    notes: tuple[str, ...] = () if _ZONE_PATTERN.search(first.split("T")[-1]) else ("time without zone taken as UTC",)
    series, order = _slashes_in_order(series)
    notes += order
    moments = pd.to_datetime(_iso_order(series), format="ISO8601", utc=True, errors="coerce")
    return _stamps(moments.dt.as_unit("ns")), notes


def _stamps(series: "pd.Series[Any]") -> Nanoseconds:
    return np.asarray(series.astype("int64").to_numpy(), dtype=np.int64)


def _slashes_in_order(series: "pd.Series[Any]") -> tuple["pd.Series[Any]", tuple[str, ...]]:
    """Dates such as 05/04/2024 rewritten with dots, day first; a note where day and month could be either way."""
    if not re.match(r"^\d{1,2}/\d{1,2}/\d{4}", str(series.dropna().iloc[0])):
        return series, ()
    parts = series.str.extract(r"^(\d{1,2})/(\d{1,2})/(\d{4})(.*)$")
    first, second = (parts[i].dropna().astype(int).max() for i in (0, 1))
    month_first = second > 12 >= first
    day, month = (parts[1], parts[0]) if month_first else (parts[0], parts[1])
    note = f"dates taken with the {'month' if month_first else 'day'} first"
    if max(first, second) <= 12:
        note += "; it could be the month: write 2024-04-05 to be sure"
    return day + "." + month + "." + parts[2] + parts[3], (note,)


def _iso_order(series: "pd.Series[Any]") -> "pd.Series[Any]":
    """Dates such as 1.5.2024 and 2024/05/01 rewritten in ISO order; others unchanged."""
    first = str(series.dropna().iloc[0])
    for pattern, (year, month, day) in (
        (r"^(\d{1,2})\.(\d{1,2})\.(\d{4})", (2, 1, 0)),
        (r"^(\d{4})/(\d{1,2})/(\d{1,2})", (0, 1, 2)),
    ):
        if re.match(pattern, first):
            parts = series.str.extract(f"{pattern}(.*)$")
            rest = parts[3].str.replace(r"^\s+", "T", regex=True)
            return parts[year] + "-" + parts[month].str.zfill(2) + "-" + parts[day].str.zfill(2) + rest
    return series.str.replace(r"\s+", " ", regex=True)
