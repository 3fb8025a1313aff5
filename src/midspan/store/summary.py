"""What histories draw of rows: for each second least, largest and mean value, largest deviation and worst status, with
the instants of the least and the largest, so that a peak stays in its own bucket.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.records import NANOSECONDS, Floats, Nanoseconds, Status
from midspan.store.chunk import Chunk

ENTRY = np.dtype(
    [
        ("second", "u1"), ("status", "u1"), ("n", "<u2"), ("low", "<f4"), ("high", "<f4"), ("mean", "<f4"),
        ("std", "<f4"), ("low_ns", "<u4"), ("high_ns", "<u4"),
    ]
)  # fmt: skip
"""A second: its number from the begin of the chunk's slot, its worst status, and of the rows that are not lost their
number and figures in SI units, with the instants in ns from its begin."""

STD, STATUS = "std_m", "status"


@dataclass(frozen=True, slots=True)
class Summary:
    """Seconds (n,) that begin at time_ns, with their `ENTRY`."""

    time_ns: Nanoseconds
    entries: NDArray[Any]


@dataclass(frozen=True, slots=True)
class Drawn:
    """Figures of equal buckets (n,), NaN where there are no rows that are not lost; status: -1 where there are none."""

    low: Floats
    high: Floats
    mean: Floats
    std: Floats
    status: NDArray[np.int64]


def is_summed(chunk: Chunk) -> bool:
    """Whether a chunk's rows have what a summary tells."""
    return bool(chunk.shown) and STD in chunk.columns and STATUS in chunk.columns


def encode(chunks: Sequence[Chunk], slot_ns: int) -> bytes:
    """The seconds of the chunks of one slot, in the order of time."""
    time_ns = np.concatenate([one.time_ns for one in chunks])
    value, std, status = (
        np.concatenate([np.asarray(one.columns[name], dtype=np.float64) for one in chunks])
        for name in (chunks[0].shown, STD, STATUS)
    )
    second = (time_ns - slot_ns) // NANOSECONDS
    made = np.zeros(len(np.unique(second)), dtype=ENTRY)
    for entry, number in zip(made, np.unique(second), strict=True):
        inside = second == number
        entry["second"], entry["status"] = number, status[inside].max()
        good = inside & np.isfinite(value) & (status != Status.LOST)
        entry["n"] = np.count_nonzero(good)
        if not entry["n"]:
            continue
        place, begin_ns = np.flatnonzero(good), slot_ns + number * NANOSECONDS
        lowest, highest = place[np.argmin(value[place])], place[np.argmax(value[place])]
        entry["low"], entry["high"], entry["mean"] = value[lowest], value[highest], value[place].mean()
        entry["std"] = std[place].max()
        entry["low_ns"], entry["high_ns"] = time_ns[lowest] - begin_ns, time_ns[highest] - begin_ns
    return made.tobytes()


def decode(rows: Sequence[tuple[int, bytes]]) -> Summary:
    """The seconds of slots, each with the begin of the slot in ns."""
    entries = np.frombuffer(b"".join(body for _, body in rows), dtype=ENTRY)
    counts = [len(body) // ENTRY.itemsize for _, body in rows]
    slots = np.repeat(np.array([t0_ns for t0_ns, _ in rows], dtype=np.int64), counts)
    return Summary(slots + entries["second"].astype(np.int64) * NANOSECONDS, entries)


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
        status = np.asarray(chunk.columns[STATUS], dtype=np.int64)
        value = np.asarray(chunk.columns[shown], dtype=np.float64)
        np.maximum.at(self._status, self._place(chunk.time_ns), status)
        good = np.isfinite(value) & (status != Status.LOST)
        place, value = self._place(chunk.time_ns[good]), value[good]
        np.minimum.at(self._low, place, value)
        np.maximum.at(self._high, place, value)
        np.maximum.at(self._std, place, np.asarray(chunk.columns[STD], dtype=np.float64)[good])
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
        np.maximum.at(self._std, place, entries["std"].astype(np.float64))
        np.add.at(self._total, place, n * entries["mean"].astype(np.float64))
        np.add.at(self._number, place, n)

    @property
    def figures(self) -> Drawn:
        """What was collected."""
        some = self._number > 0
        mean = np.divide(self._total, self._number, out=np.full(len(some), np.nan), where=some)
        low, high, std = (np.where(np.isfinite(one), one, np.nan) for one in (self._low, self._high, self._std))
        return Drawn(low, high, mean, std, self._status)

    def _place(self, time_ns: Nanoseconds) -> NDArray[np.int64]:
        return np.clip(np.searchsorted(self._edges, time_ns, side="right") - 1, 0, len(self._edges) - 2)
