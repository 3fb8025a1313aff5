"""Rows of a group of points as packs: many points' second in one, each point's part read alone.

A pack is bytes that the core makes (`core/src/packed`): an index by point, then each point's runs, every bit of them
kept. A block of one point is a pack of its own rows.
"""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.errors import DataError
from midspan.records import NANOSECONDS, GroupRows, Nanoseconds, Source, Status, member_name
from midspan.store.chunk import Chunk, Columns, decode

MAGIC = b"mg\x01\0"
# The streams of a group's packs and of the rows of its points; what histories draw.
GROUP, ROWS, SHOWN = "group", "rows", "displacement_m"
# What the packs of a point of a group say of its columns.
VELOCITY = "velocity_m_s"


@dataclass(frozen=True, slots=True)
class GroupChunk:
    """Rows of a group `name` and the state that they lead to: its instant (ns) and bytes, None: not kept now.

    Points are called NAME-NUMBER. part: of a site in shards, which points its writer has: the first number and the
    number of shards, such as "1 3"; empty: all.
    """

    name: str
    rows: GroupRows
    checkpoint: tuple[int, bytes] | None = None
    part: str = ""

    @property
    def key(self) -> str:
        """What its checkpoint is kept under."""
        return f"{self.name} {self.part}".strip()


def member_names(group: str, members: NDArray[np.bool_]) -> list[str]:
    """The names of those that are there, members (m,) by their number."""
    return [member_name(group, number) for number in np.flatnonzero(members).tolist()]


def stride(part: str) -> tuple[int, int]:
    """The first number of a part of a group, and the step from each to the next, which is the number of shards."""
    first, _, step = part.partition(" ")
    return (int(first), int(step)) if part else (0, 1)


def packed(rows: GroupRows) -> bytes:
    """Rows as a pack. Raises ValueError where runs of a point overlap, or columns are not as long as the runs."""
    kinds = (np.uint32, np.int64, np.int64, np.uint32, np.uint8, np.float64, np.float64, np.float64)
    values = (getattr(rows, name) for name in GroupRows.__slots__)
    return _core.pack_rows(*(np.ascontiguousarray(one, dtype=kind) for one, kind in zip(values, kinds, strict=True)))


def unpacked(pack: bytes) -> GroupRows:
    """The rows of a pack, by point. Raises DataError for damaged bytes."""
    try:
        return GroupRows(*_core.unpack_rows(pack, True))
    except ValueError as error:
        raise DataError(f"The store holds damaged rows of a group ({error}).") from None


def end_ns(rows: GroupRows) -> Nanoseconds:
    """The stamp of each run's last row (k,)."""
    return np.asarray(rows.t0_ns + rows.dt_ns * (rows.count.astype(np.int64) - 1))


def newer(rows: GroupRows, newest_ns: Nanoseconds) -> GroupRows:
    """The rows that are later than newest_ns (m,), by the point's number."""
    before_ns = newest_ns[rows.point]
    if np.all(rows.t0_ns > before_ns):
        return rows
    step_ns = np.maximum(rows.dt_ns, 1)
    old = np.where(rows.t0_ns > before_ns, 0, (before_ns - rows.t0_ns) // step_ns + 1)
    return _cut(rows, np.minimum(old, rows.count.astype(np.int64)), rows.count.astype(np.int64))


def in_slots(rows: GroupRows, length_ns: int) -> Iterator[GroupRows]:
    """Rows by slots of time that begin at whole multiples of a length."""
    first, last = rows.t0_ns // length_ns, end_ns(rows) // length_ns
    if not len(first):
        return
    if first.min() == last.max():
        yield rows
        return
    count, step_ns = rows.count.astype(np.int64), np.maximum(rows.dt_ns, 1)
    slots = {slot for a, b in set(zip(first.tolist(), last.tolist(), strict=True)) for slot in range(a, b + 1)}
    for slot in sorted(slots):
        # The first row at or after an instant.
        begin, end = (-((rows.t0_ns - edge * length_ns) // step_ns) for edge in (slot, slot + 1))
        part = _cut(rows, np.clip(begin, 0, count), np.clip(end, 0, count))
        if len(part.point):
            yield part


def _cut(rows: GroupRows, begin: Nanoseconds, end: Nanoseconds) -> GroupRows:
    """Of each run the rows from `begin` until before `end` (k,); runs without any are left out."""
    count = rows.count.astype(np.int64)
    at = np.repeat(np.cumsum(count) - count, count)
    place = np.arange(len(at)) - at
    kept = (place >= np.repeat(begin, count)) & (place < np.repeat(end, count))
    some = end > begin
    return GroupRows(
        rows.point[some],
        (rows.t0_ns + begin * rows.dt_ns)[some],
        rows.dt_ns[some],
        (end - begin)[some].astype(np.uint32),
        rows.status[some],
        rows.displacement_m[kept],
        rows.std_m[kept],
        rows.velocity_m_s[kept],
    )


def chunk_of_pack(pack: bytes, point: str, stream: str, shown: str = "", names: Collection[str] | None = None) -> Chunk:
    """The rows of a pack of one point with the columns of a point's rows; names: of those that are wanted, None: of
    all. Raises DataError for damaged bytes.
    """
    try:
        rows = GroupRows(*_core.unpack_rows(pack, names is None or VELOCITY in names))
    except ValueError as error:
        raise DataError(f"The store holds a damaged chunk of {point}, {stream} ({error}).") from None
    count = rows.count.astype(np.int64)
    place = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    time_ns = np.repeat(rows.t0_ns, count) + np.repeat(rows.dt_ns, count) * place
    status = np.repeat(rows.status, count)
    columns: Columns = {
        SHOWN: rows.displacement_m,
        "std_m": rows.std_m,
        VELOCITY: rows.velocity_m_s,
        "source": np.where(status == Status.TRACKING, Source.DISPLACEMENT, Source.PREDICTION).astype(np.uint8),
        "status": status,
        "zero_std_m": np.zeros(len(time_ns)),
    }
    wanted = {name: values for name, values in columns.items() if names is None or name in names}
    return Chunk(point, stream, time_ns, wanted, 0, shown)


def decoded(
    data: bytes, point: str, stream: str, calibration: int = 0, shown: str = "", names: Collection[str] | None = None
) -> Chunk:
    """The chunk that bytes hold, of a point of a group or of another one. Raises DataError for damaged bytes."""
    if data.startswith(MAGIC):
        return chunk_of_pack(data, point, stream, shown, names)
    return decode(data, point, stream, calibration, shown, names)


def part_of_pack(pack: bytes, number: int) -> tuple[int, int, bytes] | None:
    """First and last stamp and the pack of one point alone; None where it has no rows in a pack. Raises DataError."""
    try:
        own = _core.pack_of(pack, number)
        if own is None:
            return None
        _, first_ns, last_ns, _ = _core.pack_index(own)
    except ValueError as error:
        raise DataError(f"The store holds damaged rows of a group ({error}).") from None
    return int(first_ns[0]), int(last_ns[0]), own


def newest_of(packs: Iterable[bytes], size: int, nothing_ns: int) -> Nanoseconds:
    """The stamp of the newest row of each point (m,), m at least `size`; `nothing_ns` without any. Raises DataError."""
    newest_ns = np.full(size, nothing_ns, dtype=np.int64)
    for pack in packs:
        try:
            point, _, last_ns, _ = _core.pack_index(pack)
        except ValueError as error:
            raise DataError(f"The store holds damaged rows of a group ({error}).") from None
        newest_ns = grown(newest_ns, point, nothing_ns)
        np.maximum.at(newest_ns, point, last_ns)
    return newest_ns


def grown(values: NDArray[Any], point: NDArray[np.uint32], nothing: int) -> NDArray[Any]:
    """Values by the point's number, as many as it takes for some points."""
    size = int(point.max()) + 1 if len(point) else 0
    if size <= len(values):
        return values
    return np.concatenate([values, np.full(size - len(values), nothing, dtype=values.dtype)])


def length_ns(seconds: float) -> int:
    """A length in ns."""
    return round(seconds * NANOSECONDS)
