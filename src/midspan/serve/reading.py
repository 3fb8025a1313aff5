"""What the server reads of a store: buckets, rows, events, calibrations, spectra, files. Plain values in and out, so
that each may run in a thread or in a process of its own.
"""

import json
import math
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import NANOSECONDS, Nanoseconds, TimeSeries, member_of
from midspan.serve.viewers import plain
from midspan.service.journal import rows_stream
from midspan.service.stored_recording import stored_rows, stored_table
from midspan.sinks.table import WORDS, words_of
from midspan.store.chunk import Chunk, join
from midspan.store.database import StoreFault
from midspan.store.store import Store, is_store, open_store
from midspan.store.summary import Drawn

Tree = dict[str, Any]

MAX_BUCKETS = 5000
# Rows that one answer holds at most: half an hour at 100 Hz. More is for `export`, which is a file.
MAX_ROWS = 200_000
# Buckets are made of seconds up to this length, s; of longer ones the store has least and largest values alone.
SECONDS_S = 32 * 86_400.0
# A file has this many rows at most: a day at 100 Hz, for which a gigabyte of memory is needed.
MAX_FILE_ROWS = 10_000_000
# A spectrum is made of this many rows at most: six hours at 100 Hz.
MAX_SPECTRUM_ROWS = 2_200_000
MAX_EVENTS = 1000
# Of a calibration as many spans of its rows: a year of weeks with a gap in each.
MAX_SPANS = 50


@contextmanager
def opened(where: str) -> Iterator[Store]:
    """A store that is read alone. Raises StoreFault where there is none, or none that can be reached."""
    if not is_store(where):
        raise StoreFault("store_unavailable", "The store does not exist yet: nothing has been measured.")
    with closing(open_store(where, read_only=True)) as store:
        yield store


def iso(time_ns: int) -> str:
    """An instant in ns UTC as ISO 8601 with all its digits."""
    whole, rest = divmod(time_ns, NANOSECONDS)
    return f"{datetime.fromtimestamp(whole, UTC):%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"


def has_point(where: str, point: str) -> bool:
    """Whether anything of a point is kept."""
    with opened(where) as store:
        return store.has_point(point)


def known_points(where: str) -> tuple[list[str], list[str]]:
    """The points and the groups of which rows are kept."""
    with opened(where) as store:
        return store.points, store.groups


def first_of_groups(points: Sequence[str], groups: Collection[str], most: int | None) -> list[str]:
    """Points by name, of each group this many at most; None: all."""
    counts = dict.fromkeys(groups, 0)
    found = []
    for point in points:
        group, _ = member_of(point) or ("", 0)
        if most is not None and group in counts:
            counts[group] += 1
            if counts[group] > most:
                continue
        found.append(point)
    return found


def newest_ns(where: str, point: str) -> int | None:
    """The stamp of a point's newest row that is kept; None without any."""
    with opened(where) as store:
        return store.newest_ns(point, rows_stream())


def newest(where: str, point: str) -> Tree:
    """A point's newest row that is kept; empty without any."""
    with opened(where) as store:
        last_ns = store.newest_ns(point, rows_stream())
        rows = None if last_ns is None else stored_rows(store, point, rows_stream(), last_ns, last_ns)
    if last_ns is None or rows is None or not len(rows.time_ns):
        return {}
    columns = table_columns(rows)
    return {
        "time_ns": last_ns,
        **{name: plain(columns[name])[-1] for name in ("displacement_mm", "displacement_std_mm")},
        "status": WORDS["status"][int(rows.columns["status"][-1])],
    }


def table_columns(rows: Chunk) -> dict[str, NDArray[Any]]:
    """Displacement and its deviation, mm."""
    return {
        "displacement_mm": 1e3 * np.asarray(rows.columns["displacement_m"], dtype=np.float64),
        "displacement_std_mm": 1e3 * np.asarray(rows.columns["std_m"], dtype=np.float64),
    }


def series_json(where: str, point: str, first_ns: int, end_ns: int) -> bytes:
    """The rows from `first_ns` until before `end_ns` as one object of lists. Raises DataError for too many."""
    time_ns, columns = _rows(where, point, first_ns, end_ns) or (np.empty(0, np.int64), _no_columns())
    tree: Tree = {"time": time_ns.tolist()}
    for name, values in columns.items():
        words = words_of(name)
        tree[name] = [words[code] for code in values.tolist()] if words else plain(np.asarray(values, dtype=float))
    return json.dumps(tree, separators=(",", ":")).encode()


def series_arrow(where: str, point: str, first_ns: int, end_ns: int) -> bytes:
    """The same as an Arrow IPC stream; `time` is a UTC time stamp in ns."""
    import pyarrow as pa

    table = _rows(where, point, first_ns, end_ns)
    time_ns, columns = table if table is not None else (np.empty(0, np.int64), _no_columns())
    arrays = {"time": pa.array(time_ns, type=pa.timestamp("ns", tz="UTC"))}
    for name, values in columns.items():
        words = words_of(name)
        column = pa.array(np.asarray(values))
        arrays[name] = (
            pa.DictionaryArray.from_arrays(column.cast(pa.int8()), pa.array(words)).dictionary_decode()
            if words
            else column
        )
    made = pa.table(arrays)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, made.schema) as writer:
        writer.write_table(made)
    return bytes(sink.getvalue().to_pybytes())


def _no_columns() -> dict[str, NDArray[Any]]:
    numbers = ("time_s", "displacement_mm", "displacement_std_mm", "velocity_mm_s")
    return {**{name: np.empty(0) for name in numbers}, **{n: np.empty(0, np.int8) for n in ("source", "status")}}


def _rows(where: str, point: str, first_ns: int, end_ns: int) -> tuple[Nanoseconds, dict[str, Any]] | None:
    with opened(where) as store:
        count = store.count(point, rows_stream(), first_ns, end_ns - 1)
        if count > MAX_ROWS:
            raise DataError(
                f"from, to: must span at most {MAX_ROWS} rows; received {count}. Request buckets=2000, a shorter "
                "time, or /export, which has every row."
            )
        try:
            table = stored_table(store, point, first_ns, end_ns - 1)
        except DataError:
            return None
    return table.time_ns, dict(table.columns)


def buckets(where: str, point: str, first_ns: int, end_ns: int, count: int) -> Tree:
    """Least, largest and mean displacement, largest deviation, worst status and number of rows of `count` spans."""
    edges = first_ns + ((end_ns - first_ns) * np.arange(count + 1, dtype=object) // count).astype(np.int64)
    with opened(where) as store:
        if end_ns - first_ns <= SECONDS_S * NANOSECONDS:
            found = store.drawn(point, rows_stream(), edges, "displacement_m")
        else:
            kept = store.buckets(point, rows_stream(), first_ns, end_ns - 1, count)
            nothing = np.full(count, np.nan)
            found = Drawn(kept.low, kept.high, nothing, nothing, np.full(count, -1), nothing)
    words = (*WORDS["status"], None)
    return {
        "time": edges[:-1].tolist(),
        "displacement_mm_min": plain(1e3 * found.low),
        "displacement_mm_max": plain(1e3 * found.high),
        "displacement_mm_mean": plain(1e3 * found.mean),
        "displacement_std_mm": plain(1e3 * found.std),
        "status": [words[code] for code in found.status.tolist()],
        "rows": plain(found.rows),
    }


def events(where: str, point: str, first_ns: int, end_ns: int) -> list[Tree]:
    """The newest events of a time, in its order."""
    with opened(where) as store:
        found = store.events(point, first_ns, end_ns - 1)[-MAX_EVENTS:]
    return [{"time": iso(one.time_ns), "time_ns": one.time_ns, "kind": one.kind, "text": one.text} for one in found]


def calibrations(where: str, point: str) -> list[Tree]:
    """A point's calibrations with their numbers, times, states and contents."""
    with opened(where) as store:
        kept = store.calibrations(point)
    return [
        {"id": one.number, "time": iso(one.made_ns), "state": one.state, "calibration": json.loads(one.body)}
        for one in kept
    ]


def calibrated_rows(where: str, point: str) -> dict[int, list[Tree]]:
    """The newest spans of a point's rows that were made with each calibration, by its number."""
    with opened(where) as store:
        spans = store.spans(point, rows_stream())
    rows: dict[int, list[Tree]] = {}
    for one in spans:
        rows.setdefault(one.calibration, []).append({"from": iso(one.first_ns), "to": iso(one.last_ns)})
    return {number: of_one[-MAX_SPANS:] for number, of_one in rows.items()}


def spectrum_of(where: str, point: str, first_ns: int, end_ns: int) -> Tree:
    """Spectrum and natural frequencies of the rows of a time."""
    with opened(where) as store:
        if store.count(point, rows_stream(), first_ns, end_ns - 1) > MAX_SPECTRUM_ROWS:
            raise DataError(f"from, to: must span at most {MAX_SPECTRUM_ROWS} rows. Give a shorter time.")
        rows = stored_rows(store, point, rows_stream(), first_ns, end_ns - 1)
    if rows is None:
        return spectrum_tree(TimeSeries(np.empty(0, np.int64), np.empty(0)))
    return spectrum_tree(TimeSeries(rows.time_ns, np.asarray(rows.columns["displacement_m"], dtype=np.float64)))


def spectrum_tree(series: TimeSeries) -> Tree:
    """Spectrum and natural frequencies of a displacement, m; `reason` says why there are none."""
    from midspan.evaluate.spectrum import spectrum

    if not len(series.time_ns):
        return {"frequency_hz": [], "density_mm2_hz": [], "segment_s": None, "modes": [], "reason": "no rows"}
    try:
        found = spectrum(series)
    except DataError as error:
        return {"frequency_hz": [], "density_mm2_hz": [], "segment_s": None, "modes": [], "reason": str(error)}
    return {
        "frequency_hz": plain(found.frequency_hz),
        "density_mm2_hz": plain(found.density_mm2_hz),
        **found.to_dict(),
        "reason": "",
    }


def segment_modes(where: str, point: str, first_ns: int, end_ns: int, length_ns: int) -> tuple[int, list[Tree]] | None:
    """Begin (ns) and natural frequencies of the first segment of this length of a time.

    None without rows of half of it: of less, modes are known ten times worse.
    """
    from midspan.evaluate.spectrum import spectrum

    with opened(where) as store:
        names = {"displacement_m", "status"}
        first = next(store.chunks(point, rows_stream(), first_ns, end_ns - 1, names=names), None)
        if first is None:
            return None
        begin_ns = int(first.time_ns[0])
        last_ns = min(begin_ns + length_ns, end_ns) - 1
        rows = join(list(store.chunks(point, rows_stream(), begin_ns, last_ns, names=names)))
    if len(rows.time_ns) > MAX_SPECTRUM_ROWS or rows.time_ns[-1] - begin_ns < length_ns // 2:
        return None
    value = np.where(rows.columns["status"] == WORDS["status"].index("lost"), np.nan, rows.columns["displacement_m"])
    try:
        found = spectrum(TimeSeries(rows.time_ns, np.asarray(value, dtype=np.float64)))
    except DataError:
        return None
    return begin_ns, found.to_dict()["modes"]


def export(where: str, point: str, span: tuple[int, int], file: str) -> None:
    """Write the file that `midspan export` writes. Raises DataError where there are no rows, or too many."""
    from midspan.sinks.write import write_result

    with opened(where) as store:
        count = store.count(point, rows_stream(), span[0], span[1] - 1)
        if count > MAX_FILE_ROWS:
            raise DataError(
                f"from, to: must span at most {MAX_FILE_ROWS} rows; received {count}. Request parts, run `midspan "
                "export`, or set `archive` for whole days."
            )
        table = stored_table(store, point, span[0], span[1] - 1)
    write_result(Path(file), table)


def age_s(time_ns: int, now_s: float) -> float:
    """How old a row is."""
    return math.floor(1e3 * max(now_s - time_ns / NANOSECONDS, 0.0)) / 1e3
