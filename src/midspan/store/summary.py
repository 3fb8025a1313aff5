"""What histories draw of rows: for each second least, largest and mean value, largest deviation and worst status, with
the instants of the least and the largest, so that a peak stays in its own bucket.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.records import NANOSECONDS, Floats, Nanoseconds, Status
from midspan.store.chunk import Chunk

FIELDS: list[tuple[str, str]] = [
    ("status", "u1"), ("n", "<u2"), ("low", "<f4"), ("high", "<f4"), ("mean", "<f4"), ("std", "<f4"),
    ("low_ns", "<u4"), ("high_ns", "<u4"),
]  # fmt: skip
ENTRY = np.dtype([("second", "<u2"), *FIELDS])
"""A second: its number from the second in which its block begins, its worst status, and of the rows that are not lost
their number and figures in SI units, with the instants in ns from its begin."""

# Schema 1 kept seconds in slots of this length, ns.
FIRST_SLOT_NS = 10 * NANOSECONDS
FIRST_ENTRY = np.dtype([("second", "u1"), *FIELDS])

STD, STATUS = "std_m", "status"
# How many seconds there are.
LENGTH = struct.Struct("<H")


@dataclass(frozen=True, slots=True)
class Summary:
    """Seconds (n,) that begin at time_ns, with their `ENTRY`."""

    time_ns: Nanoseconds
    entries: NDArray[Any]


@dataclass(frozen=True, slots=True)
class Drawn:
    """Figures of equal buckets (n,), NaN where there are no rows that are not lost; status: -1 where there are none.

    rows: how many that are not lost each bucket has, NaN where that is not known.
    """

    low: Floats
    high: Floats
    mean: Floats
    std: Floats
    status: NDArray[np.int64]
    rows: Floats


def columns_of(chunk: Chunk, shown: str) -> tuple[Floats, Floats, NDArray[np.uint8]]:
    """The column that is drawn, its deviation (NaN without one) and the status (tracking without one)."""
    value = np.asarray(chunk.columns[shown or next(iter(chunk.columns))], dtype=np.float64)
    std = np.asarray(chunk.columns.get(STD, np.full(len(value), np.nan)), dtype=np.float64)
    return value, std, np.asarray(chunk.columns.get(STATUS, np.zeros(len(value))), dtype=np.uint8)


def encode(chunk: Chunk) -> bytes:
    """The seconds of a chunk as bytes: those of all entries' first bytes, of all second ones …, compressed."""
    return packed(entries(chunk).tobytes())


def packed(entries: bytes) -> bytes:
    """`ENTRY`s as `decode` reads them."""
    import pyarrow as pa

    planes = np.frombuffer(entries, dtype=np.uint8).reshape(-1, ENTRY.itemsize).T
    return LENGTH.pack(planes.shape[1]) + bytes(pa.Codec("zstd").compress(planes.tobytes(), asbytes=True))


def entries(chunk: Chunk) -> NDArray[Any]:
    """The seconds of a chunk."""
    value, std, status = columns_of(chunk, chunk.shown)
    second = (chunk.time_ns - _whole_second(int(chunk.time_ns[0]))) // NANOSECONDS
    begins = np.concatenate(([0], 1 + np.flatnonzero(np.diff(second))))
    group = np.repeat(np.arange(len(begins)), np.diff(np.append(begins, len(second))))
    good = np.isfinite(value) & (status != Status.LOST)
    made = np.zeros(len(begins), dtype=ENTRY)
    made["second"], made["status"] = second[begins], np.maximum.reduceat(status, begins)
    made["n"] = np.add.reduceat(good.astype(np.int64), begins)
    some = made["n"] > 0
    total = np.add.reduceat(np.where(good, value, 0.0), begins)
    made["mean"][some] = total[some] / made["n"][some]
    made["std"][some] = np.maximum.reduceat(np.where(good, std, -np.inf), begins)[some]
    inside_ns = chunk.time_ns % NANOSECONDS
    for name, extreme, nothing in (("low", np.minimum, np.inf), ("high", np.maximum, -np.inf)):
        shown = np.where(good, value, nothing)
        found = extreme.reduceat(shown, begins)
        made[name][some] = found[some]
        # The first row of each second that has it.
        places = np.flatnonzero(good & (shown == found[group]))
        seconds, first = np.unique(group[places], return_index=True)
        made[f"{name}_ns"][seconds] = inside_ns[places[first]]
    return made


def decode(rows: Sequence[tuple[int, bytes]]) -> Summary:
    """The seconds of blocks, each with the first stamp of the block in ns."""
    import pyarrow as pa

    made = [np.empty(0, dtype=ENTRY)]
    codec = pa.Codec("zstd")
    for _, body in rows:
        (count,) = LENGTH.unpack_from(body)
        plain = codec.decompress(body[LENGTH.size :], decompressed_size=count * ENTRY.itemsize, asbytes=True)
        planes = np.frombuffer(plain, dtype=np.uint8).reshape(ENTRY.itemsize, count)
        made.append(np.ascontiguousarray(planes.T).view(ENTRY)[:, 0])
    begins = np.array([_whole_second(t0_ns) for t0_ns, _ in rows], dtype=np.int64)
    return _placed(begins, made[1:], np.concatenate(made))


def decode_first(rows: Sequence[tuple[int, bytes]]) -> Summary:
    """The seconds of slots of a store of schema 1, each with the begin of the slot in ns."""
    made = [np.frombuffer(body, dtype=FIRST_ENTRY) for _, body in rows]
    return _placed(np.array([t0_ns for t0_ns, _ in rows], dtype=np.int64), made, np.concatenate(made))


def _placed(begins: Nanoseconds, parts: Sequence[NDArray[Any]], whole: NDArray[Any]) -> Summary:
    begin_ns = np.repeat(begins, [len(part) for part in parts])
    return Summary(begin_ns + whole["second"].astype(np.int64) * NANOSECONDS, whole)


def _whole_second(time_ns: int) -> int:
    return time_ns - time_ns % NANOSECONDS


class Buckets:
    """Collects the figures of equal buckets between edges (n + 1,) in ns."""

    def __init__(self, edges: Nanoseconds) -> None:
        count = len(edges) - 1
        self._edges = edges
        self._low, self._high = np.full(count, np.inf), np.full(count, -np.inf)
        self._std, self._status = np.full(count, -np.inf), np.full(count, -1)
        self._total, self._number = np.zeros(count), np.zeros(count)

    def add_rows(self, chunk: Chunk, shown: str) -> None:
        """Rows between the edges."""
        if not len(chunk.time_ns):
            return
        value, std, status = columns_of(chunk, shown)
        np.maximum.at(self._status, self._place(chunk.time_ns), status.astype(np.int64))
        good = np.isfinite(value) & (status != Status.LOST)
        place, value = self._place(chunk.time_ns[good]), value[good]
        np.minimum.at(self._low, place, value)
        np.maximum.at(self._high, place, value)
        np.fmax.at(self._std, place, std[good])
        np.add.at(self._total, place, value)
        np.add.at(self._number, place, 1.0)

    def add_seconds(self, summary: Summary) -> None:
        """Seconds: each extreme in the bucket of its instant, the others in that of the second's begin."""
        inside = (summary.time_ns >= self._edges[0]) & (summary.time_ns < self._edges[-1])
        time_ns, entries = summary.time_ns[inside], summary.entries[inside]
        np.maximum.at(self._status, self._place(time_ns), entries["status"].astype(np.int64))
        good = entries["n"] > 0
        time_ns, entries = time_ns[good], entries[good]
        place, n = self._place(time_ns), entries["n"].astype(np.float64)
        np.minimum.at(self._low, self._place(time_ns + entries["low_ns"]), entries["low"].astype(np.float64))
        np.maximum.at(self._high, self._place(time_ns + entries["high_ns"]), entries["high"].astype(np.float64))
        np.fmax.at(self._std, place, entries["std"].astype(np.float64))
        np.add.at(self._total, place, n * entries["mean"].astype(np.float64))
        np.add.at(self._number, place, n)

    @property
    def figures(self) -> Drawn:
        """What was collected."""
        some = self._number > 0
        mean = np.divide(self._total, self._number, out=np.full(len(some), np.nan), where=some)
        low, high, std = (np.where(np.isfinite(one), one, np.nan) for one in (self._low, self._high, self._std))
        return Drawn(low, high, mean, std, self._status, self._number)

    def _place(self, time_ns: Nanoseconds) -> NDArray[np.int64]:
        return np.clip(np.searchsorted(self._edges, time_ns, side="right") - 1, 0, len(self._edges) - 2)
