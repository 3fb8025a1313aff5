"""Rows of a store as a result table, and which of them are meant."""

import json
import re
from datetime import UTC, datetime
from typing import Any

import numpy as np

from midspan._version import __version__
from midspan.checks import nearest
from midspan.errors import DataError, UsageError
from midspan.records import NANOSECONDS, seconds
from midspan.service.journal import NEW_DATUM, rows_stream
from midspan.sinks.table import ResultTable
from midspan.store.chunk import Chunk, join
from midspan.store.store import Store

FIRST_NS, LAST_NS = -(2**62), 2**62


def instant(text: str | None, option: str) -> int | None:
    """An instant in ns UTC of ISO 8601 (without a zone: UTC) or of seconds since 1970; None where it is left out."""
    if text is None:
        return None
    if re.fullmatch(r"[+-]?\d+(\.\d*)?", text.strip()):
        seconds_text, _, rest = text.strip().partition(".")
        sign = -1 if seconds_text.startswith("-") else 1
        return int(seconds_text) * NANOSECONDS + sign * int(rest[:9].ljust(9, "0") or 0)
    try:
        found = datetime.fromisoformat(text.strip())
    except ValueError:
        raise UsageError(
            f"{option}: must be an instant like 2026-11-22T10:00:00Z or seconds since 1970; received {text!r}."
        ) from None
    zoned = found if found.tzinfo else found.replace(tzinfo=UTC)
    whole = zoned.replace(microsecond=0)
    return round(whole.timestamp()) * NANOSECONDS + zoned.microsecond * 1000


def chosen_point(store: Store, name: str | None) -> str:
    """The point that is meant: the named one, or the only one. Raises UsageError, DataError for a store without any."""
    known = store.points
    if not known:
        raise DataError("The store has no rows yet.")
    if name is None:
        if len(known) > 1:
            raise UsageError(f"--point must be one of {', '.join(known)}; the store has several points. Name one.")
        return known[0]
    if name not in known:
        raise UsageError(f"--point must be one of {', '.join(known)}; received {name!r}. {nearest(name, known)}")
    return name


def stored_rows(
    store: Store, point: str, stream: str, first_ns: int | None, last_ns: int | None, calibration: int | None = None
) -> Chunk | None:
    """A stream's rows from `first_ns` to `last_ns` as one block, None where there are none.

    calibration: only those of this one; None: of all.
    """
    newest_ns = store.newest_ns(point, stream)
    if newest_ns is None:
        return None
    found = list(
        store.chunks(point, stream, FIRST_NS if first_ns is None else first_ns, min(last_ns or LAST_NS, newest_ns))
    )
    found = [one for one in found if calibration in (None, one.calibration)]
    return join(found) if found else None


def stored_table(store: Store, point: str, first_ns: int | None, last_ns: int | None) -> ResultTable:
    """The rows of a point in the columns of a result, with the calibrations and events that belong to them.

    Where the zero is another one from some row on there is a column `datum`, which counts the zeros. Raises DataError
    where there are no rows.
    """
    rows = stored_rows(store, point, rows_stream(), first_ns, last_ns)
    if rows is None or not len(rows.time_ns):
        raise DataError(f"The store has no rows of {point!r} in that time.")
    columns: dict[str, Any] = {
        "time_s": seconds(rows.time_ns, 0),
        **_columns(rows, ""),
        "source": rows.columns["source"],
    }
    columns["status"] = rows.columns["status"]
    for axis in "xy":
        second = stored_rows(store, point, rows_stream(axis), int(rows.time_ns[0]), int(rows.time_ns[-1]))
        if second is not None and np.array_equal(second.time_ns, rows.time_ns):
            columns |= {**_columns(second, f"_{axis}"), f"status_{axis}": second.columns["status"]}
    datums = np.array(store.event_times(point, NEW_DATUM, int(rows.time_ns[-1])), dtype=np.int64)
    number = np.searchsorted(datums, rows.time_ns, side="right")
    if number[-1] > number[0]:
        columns["datum"] = number
    span = (int(rows.time_ns[0]), int(rows.time_ns[-1]))
    return ResultTable(columns=columns, time_ns=rows.time_ns, metadata=_metadata(store, point, rows, span))


def _columns(rows: Chunk, axis: str) -> dict[str, Any]:
    return {
        f"displacement{axis}_mm": 1e3 * rows.columns["displacement_m"],
        f"displacement_std{axis}_mm": 1e3 * rows.columns["std_m"].astype(np.float64),
        f"velocity{axis}_mm_s": 1e3 * rows.columns["velocity_m_s"].astype(np.float64),
    }


def _metadata(store: Store, point: str, rows: Chunk, span: tuple[int, int]) -> dict[str, object]:
    """Calibrations of the rows' time and events, as plain values; the zero's deviation is that of the last row."""
    return {
        "midspan": __version__,
        "point": point,
        "zero_std_mm": 1e3 * float(rows.columns["zero_std_m"][-1]),
        "calibrations": [
            {"number": one.number, "made_s": one.made_ns / NANOSECONDS, "state": one.state, **json.loads(one.body)}
            for one in store.calibrations(point)
        ],
        "events": [
            {"time_s": event.time_ns / NANOSECONDS, "kind": event.kind, "text": event.text}
            for event in store.events(point, *span)
        ],
    }
