"""The newest seconds of a store, before they become blocks: a log that is only appended to, or a table of PostgreSQL.

What is in the log outlives a kill of its process at once, and a power cut once it is synchronised. A database of pages
would write some pages of 4 kB each second for what is 1 kB.
"""

import json
import os
import secrets
import struct
import threading
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from midspan.records import NANOSECONDS, member_of
from midspan.store.chunk import Chunk, Layout, body_of, chunk_of, encode, layout_of, span_of
from midspan.store.database import PostgresDatabase, StoreFault, lock_file, lock_number, locked, sqlite_faults
from midspan.store.group_rows import GROUP, ROWS, SHOWN, decoded, part_of_pack, stride
from midspan.store.seconds import merge

LOGS = "log"
# A power cut takes at most what came since the log was synchronised, s of the records' time; a page of 4 kB is written
# again each time.
SYNC_S = 10.0
# Readers look through the log at each look: 16 MB take some 30 ms. With groups, of which a minute is 10 MB for each
# thousand points, fewer and longer blocks are worth more.
MAX_LOG_BYTES, MAX_GROUP_LOG_BYTES = 1 << 24, 1 << 26
# A server's readers get the packs of a group whole.
MAX_TABLE_BYTES = 1 << 23
# Length and check sum of a record as it stands there, and its length before it was compressed.
RECORD = struct.Struct("<III")
# Number of a layout, length of a layout that is new (0: it is not), length of a body.
PIECE = struct.Struct("<HHI")
# First and last stamp of a pack in a log, which its other bytes follow.
SPAN = struct.Struct("<qq")


@dataclass(frozen=True, slots=True)
class Piece:
    """Rows of a stream from t0_ns to t1_ns, still as bytes. Of a group (stream GROUP): a pack of its points' rows;
    shown is then the part of the site that wrote it, number its place in a table.
    """

    point: str
    stream: str
    shown: str
    t0_ns: int
    t1_ns: int
    layout: Layout | None
    body: bytes
    number: int = 0

    def chunk(self, names: Collection[str] | None = None) -> Chunk:
        """The rows; names: of the columns that are wanted, None: of all. Raises DataError."""
        return self._chunk() if names is None else drawn(self, frozenset(names))

    def _chunk(self, names: Collection[str] | None = None) -> Chunk:
        if self.layout is None:
            return decoded(self.body, self.point, self.stream, 0, self.shown, names)
        return chunk_of(self.layout, self.body, self.point, self.stream, self.shown, names)


def pack_piece(name: str, part: str, span: tuple[int, int], pack: bytes) -> Piece:
    """The piece of a pack of a group; span: first and last stamp."""
    return Piece(name, GROUP, part, *span, None, pack)


def members_pieces(point: str, number: int, packs: Sequence[Piece]) -> Iterator[Piece]:
    """The pieces of one point of a group in the pieces of that."""
    for one in packs:
        if (found := part_of_pack(one.body, number)) is not None:
            yield Piece(point, ROWS, SHOWN, *found[:2], None, found[2])


# The last 320 s of a dozen points, which all viewers look at: 3 kB each.
@lru_cache(maxsize=4096)
def drawn(piece: Piece, names: frozenset[str]) -> Chunk:
    """Some columns of a piece, which are not to be written to: who asks for them again gets the same ones."""
    chunk = piece._chunk(names)
    for values in (chunk.time_ns, *chunk.columns.values()):
        values.setflags(write=False)
    return chunk


@dataclass(slots=True)
class FilePieces:
    """The logs of a folder: one of this process, made when it is needed, and those of others, which are only read.

    synced_ns: stamp up to which this process has synchronised its log.
    """

    folder: Path
    read_only: bool = False
    _file: int | None = None
    _path: Path | None = None
    _layouts: dict[bytes, int] = field(default_factory=dict)
    _size: int = 0
    _synced_ns: int | None = None
    _is_synced: bool = False
    _with_groups: bool = False

    @property
    def full(self) -> bool:
        """Whether what this process has added should become blocks."""
        return self._size > (MAX_GROUP_LOG_BYTES if self._with_groups else MAX_LOG_BYTES)

    def add(self, chunks: Sequence[Chunk], packs: Sequence[Piece] = ()) -> None:
        """Append chunks and packs of groups, all or none. Raises StoreFault."""
        if self.read_only:
            raise StoreFault("store_unavailable", f"{self.folder.parent}: the store is open read-only.")
        before = dict(self._layouts)
        pieces = [self._piece(layout_bytes(chunk), body_of(chunk)) for chunk in chunks]
        pieces += [self._piece(pack_bytes(one), SPAN.pack(one.t0_ns, one.t1_ns) + one.body) for one in packs]
        record = record_of(b"".join(pieces))
        with sqlite_faults(self.folder):
            file = self._opened()
            try:
                done = 0
                while done < len(record):
                    done += os.write(file, record[done:])
            except OSError:
                self._layouts = before
                os.ftruncate(file, self._size)
                raise
            self._size += len(record)
            self._with_groups = self._with_groups or bool(packs)
            newest_ns = max([int(chunk.time_ns[-1]) for chunk in chunks] + [one.t1_ns for one in packs])
            if self._synced_ns is None:
                self._synced_ns = newest_ns
            self._is_synced = False
            if abs(newest_ns - self._synced_ns) >= SYNC_S * NANOSECONDS:
                self.sync()
                self._synced_ns = newest_ns

    def sync(self) -> None:
        """Bring what was added to the disk. Raises StoreFault."""
        if self._file is not None and not self._is_synced:
            with sqlite_faults(self.folder):
                os.fsync(self._file)
            self._is_synced = True

    def of(self, point: str, stream: str) -> list[Piece]:
        """A stream's pieces in all logs, in the order of time."""
        found = [one for log in followed(self.folder) for one in log.get((point, stream), ())]
        if stream == ROWS and (member := member_of(point)) is not None:
            found += members_pieces(point, member[1], self.packs(member[0]))
        return sorted(found, key=lambda one: one.t0_ns)

    def packs(self, name: str) -> list[Piece]:
        """The packs of a group in all logs, those of each log in the order of their writing."""
        return [one for log in followed(self.folder) for one in log.get((name, GROUP), ())]

    def streams(self) -> set[tuple[str, str, int]]:
        """Point, stream and first stamp of all pieces."""
        pieces = (one for log in followed(self.folder) for own in log.values() for one in own)
        return {(one.point, one.stream, one.t0_ns) for one in pieces}

    def own(self, points: Sequence[str]) -> list[Piece]:
        """What this process has added."""
        return [] if self._path is None else list(read(self._path))

    def adopt(self, points: Collection[str]) -> None:
        """Go on with the log of a process that has ended, where there is one of these points and groups alone, which
        nobody else writes: to make blocks of it at once would take seconds in which nothing is kept. Raises StoreFault.
        """
        for path in [] if self._file is not None else sorted(self.folder.glob("*.log")):
            with sqlite_faults(path):
                file = os.open(path, os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0))
                before = Followed(path)
                if locked(file) and path.exists() and (pieces := before.look()) and _writers(pieces) <= set(points):
                    # Of a power cut a part of a record may be left.
                    os.ftruncate(file, size := whole_bytes(path))
                    self._file, self._path, self._size = file, path, size
                    self._layouts = {_layout_json(*one): number for number, one in enumerate(before.layouts)}
                    self._with_groups = any(stream == GROUP for _, stream in pieces)
                    return
                os.close(file)

    def take_over(self, keys: Collection[str], make_blocks: Callable[[Sequence[Piece]], None]) -> list[int]:
        """Make blocks of the logs whose process has ended, and remove them; how many pieces each had."""
        counts = []
        for path in sorted(self.folder.glob("*.log")):
            file = None if path == self._path else lock_file(path)
            if file is None:
                continue
            with file:
                make_blocks(pieces := list(read(path)))
                counts.append(len(pieces))
            path.unlink(missing_ok=True)
        return counts

    def clear(self, pieces: Sequence[Piece]) -> None:
        """Begin the log anew: its pieces are blocks now. Raises StoreFault."""
        if self._file is not None:
            with sqlite_faults(self.folder):
                os.ftruncate(self._file, 0)
        self._layouts, self._size, self._is_synced, self._with_groups = {}, 0, False, False

    def close(self) -> None:
        """Let the log go; it is removed where it is empty."""
        if self._file is not None and self._path is not None:
            os.close(self._file)
            if not self._size:
                self._path.unlink(missing_ok=True)
        self._file = self._path = None

    def _opened(self) -> int:
        while self._file is None:
            self.folder.mkdir(parents=True, exist_ok=True)
            path = self.folder / f"{secrets.token_hex(8)}.log"
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
            # Between its making and its lock another process may have taken it for an abandoned one.
            if locked(file) and path.exists():
                self._file, self._path, self._size = file, path, 0
            else:
                os.close(file)
        return self._file

    def _piece(self, layout: bytes, body: bytes) -> bytes:
        new = layout not in self._layouts
        number = self._layouts.setdefault(layout, len(self._layouts))
        return PIECE.pack(number, len(layout) if new else 0, len(body)) + (layout if new else b"") + body


def record_of(data: bytes) -> bytes:
    """A record of a log, compressed: the heads of columns are much the same each second."""
    import pyarrow as pa

    small = bytes(pa.Codec("zstd").compress(data, asbytes=True))
    return RECORD.pack(len(small), zlib.crc32(small), len(data)) + small


def layout_bytes(chunk: Chunk) -> bytes:
    """What a log says once of all pieces of a stream."""
    return _layout_json(chunk.point, chunk.stream, chunk.shown, layout_of(chunk))


def pack_bytes(piece: Piece) -> bytes:
    """The same of the packs of a group, which say of themselves what columns they have."""
    return _layout_json(piece.point, piece.stream, piece.shown, ())


def _layout_json(point: str, stream: str, shown: str, layout: Layout) -> bytes:
    return json.dumps([point, stream, shown, layout], separators=(",", ":")).encode()


def whole_bytes(path: Path) -> int:
    """Up to where the records of a log are whole."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return 0
    return sum(RECORD.size + len(record) for record, _ in _records(data))


def _records(data: bytes) -> Iterator[tuple[bytes, int]]:
    """The records of a log up to the first that is not whole, with their lengths before they were compressed."""
    at = 0
    while at + RECORD.size <= len(data):
        length, check, whole = RECORD.unpack_from(data, at)
        record = data[at + RECORD.size : at + RECORD.size + length]
        if not length or len(record) < length or zlib.crc32(record) != check:
            return
        yield record, whole
        at += RECORD.size + length


def _writers(pieces: Mapping[tuple[str, str], Sequence[Piece]]) -> set[str]:
    """The points and the keys of groups that pieces are of."""
    return {
        f"{one.point} {one.shown}".strip() if stream == GROUP else point
        for (point, stream), own in pieces.items()
        for one in own
    }


def read(path: Path) -> Iterator[Piece]:
    """The pieces of a log up to the first record that is not whole: what a power cut left of the last ones."""
    for own in Followed(path).look().values():
        yield from own


class Followed:
    """A log as it grows: each look reads what was appended since the one before. A page's server looks at the log of
    minutes again and again, for each viewer.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._begin()

    def _begin(self) -> None:
        self.layouts: list[tuple[str, str, str, Layout]] = []
        self._streams: dict[tuple[str, str], list[Piece]] = {}
        # Where the last whole record began, what stands at its head, and where it ended.
        self._last, self._head, self._end = 0, b"", 0

    def look(self) -> dict[tuple[str, str], list[Piece]]:
        """The pieces by point and stream."""
        import pyarrow as pa

        try:
            with self._path.open("rb") as file:
                file.seek(self._last)
                # Its check sum is another one where the log was begun anew meanwhile.
                if file.read(len(self._head)) != self._head:
                    self._begin()
                file.seek(self._end)
                data = file.read()
        except FileNotFoundError:
            # Its pieces have become blocks meanwhile.
            return {}
        codec = pa.Codec("zstd")
        for record, whole in _records(data):
            head = RECORD.pack(len(record), zlib.crc32(record), whole)
            self._last, self._head, self._end = self._end, head, self._end + RECORD.size + len(record)
            for one in _pieces(codec.decompress(record, decompressed_size=whole, asbytes=True), self.layouts):
                self._streams.setdefault((one.point, one.stream), []).append(one)
        return {stream: list(own) for stream, own in self._streams.items()}


_LOCK = threading.Lock()
_FOLLOWED: dict[Path, Followed] = {}


def followed(folder: Path) -> list[dict[tuple[str, str], list[Piece]]]:
    """The pieces of all logs of a folder, each by point and stream."""
    paths = sorted(folder.glob("*.log"))
    with _LOCK:
        for path in [one for one in _FOLLOWED if one.parent == folder and one not in paths]:
            del _FOLLOWED[path]
        return [_FOLLOWED.setdefault(path, Followed(path)).look() for path in paths]


def _pieces(record: bytes, layouts: list[tuple[str, str, str, Layout]]) -> Iterator[Piece]:
    at = 0
    while at < len(record):
        number, new, length = PIECE.unpack_from(record, at)
        at += PIECE.size
        if new:
            point, stream, shown, columns = json.loads(record[at : at + new])
            layouts.append((point, stream, shown, tuple((name, kind, width) for name, kind, width in columns)))
            at += new
        point, stream, shown, layout = layouts[number]
        body = record[at : at + length]
        if stream != GROUP:
            yield Piece(point, stream, shown, *span_of(body), layout, body)
        else:
            yield pack_piece(point, shown, SPAN.unpack_from(body), body[SPAN.size :])
        at += length


@dataclass(slots=True)
class TablePieces:
    """The pieces of a PostgreSQL database, a row each: the server has its own log."""

    database: PostgresDatabase
    _size: int = 0
    _group_size: int = 0

    @property
    def full(self) -> bool:
        """Whether what this process has added should become blocks."""
        return self._size > MAX_LOG_BYTES or self._group_size > MAX_TABLE_BYTES

    def add(self, chunks: Sequence[Chunk], packs: Sequence[Piece] = ()) -> None:
        """Add chunks and packs of groups, all or none. Raises StoreFault."""
        with self.database.transaction():
            for chunk in chunks:
                body = encode(chunk)
                stamps = (int(chunk.time_ns[0]), int(chunk.time_ns[-1]))
                values = (chunk.point, chunk.stream, chunk.shown, *stamps, body)
                self.database.execute("INSERT INTO piece VALUES (?, ?, ?, ?, ?, ?)", values)
                if chunk.shown:
                    merge(self.database, chunk)
                self._size += len(body)
            for one in packs:
                number = "SELECT COALESCE(MAX(number), 0) + 1 FROM group_piece WHERE name = ? AND part = ?"
                sql = f"INSERT INTO group_piece VALUES (?, ?, ({number}), ?, ?, ?)"
                place = (one.point, one.shown)
                self.database.execute(sql, (*place, *place, one.t0_ns, one.t1_ns, one.body))
                self._group_size += len(one.body)

    def sync(self) -> None:
        """What was added is on the server's disk."""

    def adopt(self, points: Collection[str]) -> None:
        """What an ended process left is its point's next writer's own."""

    def of(self, point: str, stream: str) -> list[Piece]:
        """A stream's pieces, in the order of time."""
        found = self._where("point = ? AND stream = ?", (point, stream))
        if stream == ROWS and (member := member_of(point)) is not None:
            found += members_pieces(point, member[1], self.packs(member[0]))
        return sorted(found, key=lambda one: one.t0_ns)

    def packs(self, name: str) -> list[Piece]:
        """The packs of a group, those of each part of the site in the order of their writing."""
        return self._packs("name = ?", (name,))

    def streams(self) -> set[tuple[str, str, int]]:
        """Point, stream and first stamp of all pieces."""
        if not self.database.has_table("piece"):
            return set()
        sql = "SELECT point, stream, t0_ns FROM piece"
        if self.database.has_table("group_piece"):
            sql += f" UNION ALL SELECT name, '{GROUP}', first_ns FROM group_piece"
        return {(str(a), str(b), int(c)) for a, b, c in self.database.execute(sql)}

    def own(self, points: Sequence[str]) -> list[Piece]:
        """The pieces of points that this process writes, and those of its groups under their keys."""
        found = [one for point in points for one in self._where("point = ?", (point,))]
        return found + [one for key in points for one in self._packs("TRIM(name || ' ' || part) = ?", (key,))]

    def take_over(self, keys: Collection[str], make_blocks: Callable[[Sequence[Piece]], None]) -> list[int]:
        """Make blocks of what another number of shards left of these groups; how many pieces each part had. What is of
        a point, or of a part of the same number, is its next writer's own.
        """
        counts, shards = [], {name: stride(part)[1] for name, _, part in (one.partition(" ") for one in keys)}
        for name, part in self.database.execute("SELECT DISTINCT name, part FROM group_piece ORDER BY name, part"):
            if stride(str(part))[1] == shards.get(str(name), stride(str(part))[1]):
                continue
            with self.database.transaction():
                # Other shards wait: the rows that they write follow these.
                place = (str(name), str(part))
                self.database.execute("SELECT pg_advisory_xact_lock(?)", (lock_number(" ".join(place).strip()),))
                if pieces := self._packs("name = ? AND part = ?", place):
                    make_blocks(pieces)
                    self.database.execute("DELETE FROM group_piece WHERE name = ? AND part = ?", place)
                    counts.append(len(pieces))
        return counts

    def clear(self, pieces: Sequence[Piece]) -> None:
        """Remove pieces that are blocks now. Raises StoreFault."""
        for one in pieces:
            place = (one.point, one.stream, one.t0_ns)
            if one.stream == GROUP:
                sql = "DELETE FROM group_piece WHERE name = ? AND part = ? AND number = ?"
                self.database.execute(sql, (one.point, one.shown, one.number))
            else:
                self.database.execute("DELETE FROM piece WHERE point = ? AND stream = ? AND t0_ns = ?", place)
        self._size = self._group_size = 0

    def close(self) -> None:
        """The connection is the site's."""

    def _where(self, condition: str, values: tuple[str, ...]) -> list[Piece]:
        if not self.database.has_table("piece"):
            return []
        sql = f"SELECT point, stream, shown, t0_ns, t1_ns, body FROM piece WHERE {condition} ORDER BY t0_ns"
        rows = self.database.execute(sql, values)
        return [
            Piece(str(point), str(stream), str(shown), int(t0_ns), int(t1_ns), None, bytes(body))
            for point, stream, shown, t0_ns, t1_ns, body in rows
        ]

    def _packs(self, condition: str, values: tuple[str, ...]) -> list[Piece]:
        if not self.database.has_table("group_piece"):
            return []
        sql = f"SELECT name, part, first_ns, last_ns, body, number FROM group_piece WHERE {condition} ORDER BY number"
        return [
            Piece(str(name), GROUP, str(part), int(first_ns), int(last_ns), None, bytes(body), int(number))
            for name, part, first_ns, last_ns, body, number in self.database.execute(sql, values)
        ]


Pieces = FilePieces | TablePieces
