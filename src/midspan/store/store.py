"""The store of a site: what is kept of its points, by whom it was made, and how it is read again.

SQLite: `site.sqlite` with calibrations, checkpoints, events and the pyramid of least and largest values, a file for
each day (UTC) with the blocks, and a log of the newest minutes. PostgreSQL: the same in tables of one database. One
process writes a point; any number read.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from midspan.errors import DataError, MidspanError, UsageError
from midspan.records import NANOSECONDS, Event, Floats, Nanoseconds
from midspan.store.blocks import blocks_of, joined
from midspan.store.chunk import Chunk
from midspan.store.database import Database, Division, FileLocks, PostgresDatabase, SqliteDatabase, lock_in_session
from midspan.store.days import BLOCK_S, DAY_NS, DAY_TABLES, DAYS, REACH_NS, Days, OneDatabase, part_of
from midspan.store.group_rows import GROUP, GroupChunk
from midspan.store.group_state import StateFiles
from midspan.store.group_store import Groups, StateTable
from midspan.store.kept import TABLES as KEPT_TABLES
from midspan.store.kept import Kept
from midspan.store.partitions import TABLES as PARTITION_TABLES
from midspan.store.parts import PART_TABLE, keep_checkpoint, kept_checkpoint
from midspan.store.pieces import LOGS, FilePieces, Piece, Pieces, TablePieces
from midspan.store.pyramid import LEVELS_S, Pyramid
from midspan.store.pyramid import TABLE as PYRAMID_TABLE
from midspan.store.seconds import SECOND_TABLE
from midspan.store.spans import CalibratedSpan, spans_of
from midspan.store.summary import STATUS, STD, Drawn
from midspan.store.summary import Buckets as SummaryBuckets

# 1: pieces and chunks of ten seconds as Arrow streams, in the files of the days. They are read still.
SCHEMA, READABLE = 2, ("1", "2")
SITE_FILE = "site.sqlite"
# Without a write-ahead log, which would have every checkpoint written twice; nobody reads it while it is written.
CHECKPOINT_FILE = "checkpoints.sqlite"
FIRST_NS, LAST_DAY = -(2**62), 2**31

SITE_TABLES = (
    *KEPT_TABLES,
    PYRAMID_TABLE,
    "CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS calibration (point TEXT NOT NULL, number BIGINT NOT NULL, made_ns BIGINT NOT NULL, "
    "state TEXT NOT NULL, body TEXT NOT NULL, settings TEXT NOT NULL, PRIMARY KEY (point, number))",
    "CREATE TABLE IF NOT EXISTS event (point TEXT NOT NULL, time_ns BIGINT NOT NULL, kind TEXT NOT NULL, "
    "text TEXT NOT NULL, axis BIGINT NOT NULL, PRIMARY KEY (point, time_ns, kind, text))",
)
CHECKPOINT_TABLES = (
    "CREATE TABLE IF NOT EXISTS checkpoint (point TEXT PRIMARY KEY, time_ns BIGINT NOT NULL, body {blob} NOT NULL)",
    PART_TABLE,
)
PIECE_TABLE = (
    "CREATE TABLE IF NOT EXISTS piece (point TEXT NOT NULL, stream TEXT NOT NULL, shown TEXT NOT NULL, "
    "t0_ns BIGINT NOT NULL, t1_ns BIGINT NOT NULL, body {blob} NOT NULL, PRIMARY KEY (point, stream, t0_ns))"
)
SERVER_TABLES = (PIECE_TABLE, SECOND_TABLE, *PARTITION_TABLES)


@dataclass(frozen=True, slots=True)
class Batch:
    """What is written at once; events: by point; checkpoints: their instant (ns) and their parts, of which those that
    did not change are not written again.
    """

    chunks: Sequence[Chunk] = ()
    events: Sequence[tuple[str, Event]] = ()
    checkpoints: Mapping[str, tuple[int, Sequence[bytes]]] = field(default_factory=dict)
    groups: Sequence[GroupChunk] = ()


@dataclass(frozen=True, slots=True)
class StoredCalibration:
    """A point's calibration: its number, when it was made (ns UTC), its state and its JSON text.

    state: "in force", "offered", "refused" or "retired". settings: of the point's recordings then, as JSON.
    """

    point: str
    number: int
    made_ns: int
    state: str
    body: str
    settings: str


@dataclass(frozen=True, slots=True)
class Buckets:
    """Least and largest value of equal spans: begin_ns (n,) and low, high (n,), NaN where nothing is kept."""

    begin_ns: Nanoseconds
    low: Floats
    high: Floats


class Store:
    """Reads and writes a site's records; one thread at a time. points: that it writes."""

    def __init__(
        self,
        site: Database,
        checkpoints: Database,
        days: Days,
        pieces: Pieces,
        states: StateFiles | StateTable,
        locks: FileLocks | None = None,
        points: Sequence[str] = (),
    ) -> None:
        self._site, self.checkpoints, self._days = site, checkpoints, days
        self._pieces, self._locks = pieces, locks
        self._kept, self._pyramid = Kept(site, days, pieces), Pyramid(site, days)
        self._groups = Groups(self._kept, self._pyramid, days, pieces, states)
        self._newest: dict[tuple[str, str], int | None] = {}
        # The first stamp of each stream since its last block.
        self._begun: dict[tuple[str, str], int] = {}
        self._points = set(points)
        self._took_over = False

    def close(self) -> None:
        """Let the files or the connection go. What was written becomes blocks, where that can be done."""
        try:
            self.flush()
        except MidspanError:
            # The log has it, for the next process that writes.
            pass
        finally:
            for one in (self._pieces, self._groups.states, self._site, self.checkpoints, self._days, self._locks):
                if one is not None:
                    one.close()

    # What is written

    def write(self, batch: Batch) -> None:
        """Keep a batch. Rows at or before the newest kept one of their stream are dropped: none is ever doubled.

        When it returns, everything is kept, and outlives a kill of the process; a power cut may take rows of the last
        SYNC_S. After an exception any part of it may be kept, and it is to be written again. The chunks come first: a
        checkpoint is never newer than what it rests on. Raises StoreFault.
        """
        lasting = [one.key for one in batch.groups if self._groups.is_due(one)]
        try:
            new = [one for chunk in batch.chunks for one in self._new_rows(chunk)]
            packs = [one for chunk in batch.groups for one in self._groups.new_packs(chunk)]
            if new or packs:
                self._points.update(one.key for one in batch.groups)
                self._keep(new, packs)
            if batch.checkpoints or lasting:
                self._pieces.sync()
        except BaseException:
            self._newest.clear()
            self._groups.forget_newest()
            raise
        for group in batch.groups:
            self._groups.put_state(group, lasting=group.key in lasting)
        if batch.events:
            with self._site.transaction():
                for point, event in batch.events:
                    self._site.execute(
                        "INSERT INTO event VALUES (?, ?, ?, ?, ?) ON CONFLICT DO NOTHING",
                        (point, event.time_ns, event.kind, event.text, event.axis),
                    )
        for point, (time_ns, parts) in batch.checkpoints.items():
            with self.checkpoints.transaction():
                keep_checkpoint(self.checkpoints, point, time_ns, parts)

    def _new_rows(self, chunk: Chunk) -> list[Chunk]:
        """The rows that are not kept yet, in parts as long as a block at most, which no day cuts."""
        newest_ns = self.newest_ns(chunk.point, chunk.stream)
        if newest_ns is not None:
            chunk = chunk.rows(chunk.time_ns > newest_ns)
        if not len(chunk.time_ns):
            return []
        self._newest[chunk.point, chunk.stream] = int(chunk.time_ns[-1])
        return chunk.split(BLOCK_S)

    def _keep(self, new: Sequence[Chunk], packs: Sequence[Piece]) -> None:
        """Append to the log; what is long enough there becomes blocks first."""
        self._points.update(one.point for one in new)
        if not self._took_over:
            self._pieces.adopt(self._points)
            self.take_over()
        begins = [((one.point, one.stream), int(one.time_ns[0])) for one in new]
        begins += [((one.point, one.stream), one.t0_ns) for one in packs]
        for stream, t0_ns in begins:
            begun_ns = self._begun.setdefault(stream, t0_ns)
            if self._pieces.full or abs(t0_ns - begun_ns) >= BLOCK_S * NANOSECONDS:
                self.flush()
                break
        for stream, t0_ns in begins:
            self._begun.setdefault(stream, t0_ns)
        self._pieces.add(new, packs)

    def take_over(self) -> list[int]:
        """Make blocks of what ended processes left in their logs; how many pieces each had."""
        counts = self._pieces.take_over(self._points, self._make_blocks)
        for piece in self._pieces.own(sorted(self._points)):
            self._begun.setdefault((piece.point, piece.stream), piece.t0_ns)
        self._took_over = True
        return counts

    def flush(self) -> None:
        """Make blocks of all that this process has written. Raises StoreFault."""
        if not self._begun:
            return
        pieces = self._pieces.own(sorted(self._points))
        # What the site's file says of rows is to outlive no row.
        self._pieces.sync()
        self._make_blocks(pieces)
        self._pieces.clear(pieces)
        self._begun.clear()

    def _make_blocks(self, pieces: Sequence[Piece]) -> None:
        """Join pieces to blocks: each day's in one transaction, then what the site's file says of them. Those that are
        blocks already are left out, so that it may be done again after a power cut or a kill in the middle.
        """
        self._groups.make_blocks([one for one in pieces if one.stream == GROUP])
        pieces = [one for one in pieces if one.stream != GROUP]
        blocks = blocks_of(self._without_blocks(pieces))
        days = {block.time_ns[0] // DAY_NS for block in blocks}
        for number in sorted(days):
            day = self._days.of(int(number))
            with day.database.transaction():
                for block in blocks:
                    if block.time_ns[0] // DAY_NS == number:
                        day.insert(block)
        # What was kept already may not be in the site's tables: the process may have ended between the two.
        streams = {(one.point, one.stream, one.t0_ns // DAY_NS) for one in pieces}
        spans = {(one.point, one.stream, one.t0_ns) for one in pieces if one.shown}
        with self._site.transaction():
            self._kept.note(streams)
            self._pyramid.build(spans)

    def _without_blocks(self, pieces: Sequence[Piece]) -> list[Piece]:
        """The pieces that are no blocks yet."""
        newest: dict[tuple[str, str, int], int] = {}
        for place in {(one.point, one.stream, one.t0_ns // DAY_NS) for one in pieces}:
            for day in self._days.between(place[2], place[2]):
                newest_ns = day.newest_ns(*place[:2])
                newest[place] = FIRST_NS if newest_ns is None else max(newest.get(place, FIRST_NS), newest_ns)
        return [one for one in pieces if one.t0_ns > newest.get((one.point, one.stream, one.t0_ns // DAY_NS), FIRST_NS)]

    def add_calibration(self, point: str, made_ns: int, body: str, settings: str, *, accept: bool) -> int:
        """Keep a calibration, in force (the one before is retired) or offered; returns its number, from 1 on."""
        with self._site.transaction():
            last = self._site.execute("SELECT MAX(number) FROM calibration WHERE point = ?", (point,))[0][0]
            number = 1 + (last or 0)
            sql = "INSERT INTO calibration VALUES (?, ?, ?, ?, ?, ?)"
            state = "in force" if accept else "offered"
            self._site.execute(sql, (point, number, made_ns, state, body, settings))
            if accept:
                self._retire_others(point, number)
        return number

    def accept(self, point: str, number: int) -> bool:
        """Put an offered calibration in force; whether there was such a one: of two who accept it one did."""
        with self._site.transaction():
            found = self._decided(point, number, "in force")
            if found:
                self._retire_others(point, number)
        return found

    def refuse(self, point: str, number: int) -> bool:
        """Refuse an offered calibration; whether there was such a one."""
        return self._decided(point, number, "refused")

    def _decided(self, point: str, number: int, state: str) -> bool:
        sql = "UPDATE calibration SET state = ? WHERE point = ? AND number = ? AND state = 'offered' RETURNING number"
        return bool(self._site.execute(sql, (state, point, number)))

    def _retire_others(self, point: str, number: int) -> None:
        sql = "UPDATE calibration SET state = 'retired' WHERE point = ? AND state = 'in force' AND number <> ?"
        self._site.execute(sql, (point, number))

    def forget_before(self, time_ns: int) -> None:
        """Remove the chunks of whole days before a time; events, calibrations and the pyramid stay."""
        self.flush()
        day = time_ns // DAY_NS
        self._days.forget_before(day)
        self._site.execute("DELETE FROM kept WHERE day < ?", (day,))

    def forget_since(self, point: str, time_ns: int, calibration: int) -> None:
        """Remove what a point has from a time on, and a calibration that was made for it."""
        self.flush()
        streams = self.streams(point)
        for day in self._days.between(time_ns // DAY_NS, LAST_DAY):
            with day.database.transaction():
                day.forget_since(point, time_ns)
        self._newest.clear()
        with self._site.transaction():
            self._site.execute("DELETE FROM event WHERE point = ? AND time_ns >= ?", (point, time_ns))
            self._site.execute("DELETE FROM calibration WHERE point = ? AND number = ?", (point, calibration))
            self._site.execute("DELETE FROM kept WHERE point = ? AND day > ?", (point, time_ns // DAY_NS))
            self._pyramid.forget_since(point, time_ns)
            for stream in streams:
                newest_ns = self._kept_newest_ns(point, stream)
                if newest_ns is None or newest_ns // DAY_NS < time_ns // DAY_NS:
                    place = (point, stream, time_ns // DAY_NS)
                    self._site.execute("DELETE FROM kept WHERE point = ? AND stream = ? AND day = ?", place)
            self._pyramid.build({(point, stream, time_ns) for stream in streams})

    # What is read

    @property
    def points(self) -> list[str]:
        """The names of the points of which rows are kept, sorted."""
        return sorted(self._kept.points.union(self._pyramid.points))

    @property
    def groups(self) -> list[str]:
        """The names of the groups of which rows are kept, sorted."""
        return self._kept.groups

    def has_point(self, point: str) -> bool:
        """Whether anything of a point is kept."""
        for table in ("pyramid", "calibration", "event"):
            if self._site.execute(f"SELECT 1 FROM {table} WHERE point = ? LIMIT 1", (point,)):
                return True
        return bool(self._kept.streams(point))

    def streams(self, point: str) -> list[str]:
        """The names of a point's streams, sorted."""
        return self._kept.streams(point)

    def days(self, point: str, stream: str) -> list[int]:
        """The days (since 1970, UTC) of which a stream has rows, sorted."""
        return self._kept.days(point, stream)

    def take_forward(self) -> None:
        """Make of a store of schema 1 one of this: its days stay as they are, the site's file learns of them."""
        with self._site.transaction():
            self._kept.note_days()
            self._site.execute("UPDATE meta SET value = ? WHERE key = 'schema'", (str(SCHEMA),))

    def make_histories(self) -> None:
        """Make anew what the site's file has of the days: which there are, and the values above them."""
        with self._site.transaction():
            self._site.execute("DELETE FROM kept")
            for point, stream, day in self._kept.note_days():
                begins = self._pyramid.limits(point, stream, day * DAY_NS, (day + 1) * DAY_NS)[0]
                self._pyramid.build({(point, stream, int(begin_ns)) for begin_ns in begins})

    def count(self, point: str, stream: str, first_ns: int, last_ns: int) -> int:
        """How many rows the chunks have that reach into a time: as many as it has, or some minutes' more."""
        days = self._days.between((first_ns - REACH_NS) // DAY_NS, last_ns // DAY_NS)
        pieces = (part_of(one, first_ns, last_ns) for one in self._newest_rows(point, stream))
        return sum(day.count(point, stream, first_ns, last_ns) for day in days) + sum(len(p.time_ns) for p in pieces)

    def newest_ns(self, point: str, stream: str) -> int | None:
        """The stamp of a stream's newest row, None without any."""
        if (point, stream) not in self._newest:
            pieces = self._pieces.of(point, stream)
            newest = [one.t1_ns for one in pieces[-1:]]
            kept_ns = self._kept_newest_ns(point, stream)
            self._newest[point, stream] = max([*newest, *([] if kept_ns is None else [kept_ns])], default=None)
        return self._newest[point, stream]

    def _kept_newest_ns(self, point: str, stream: str) -> int | None:
        """The stamp of the newest row in the days."""
        for number in reversed(self.days(point, stream)):
            for day in self._days.between(number, number):
                newest_ns = day.newest_ns(point, stream)
                if newest_ns is not None:
                    return newest_ns
        return None

    def _newest_rows(self, point: str, stream: str, shown: str | None = None) -> list[Chunk]:
        """The rows that are no blocks yet; shown: with what is drawn of this column alone.

        The log is read before the days: it is emptied after they have them.
        """
        pieces = self._pieces.of(point, stream)
        names = None if shown is None else {shown, STD, STATUS}
        late = self._without_blocks(pieces)
        return joined([one.chunk(names) for one in late])

    def chunks(
        self, point: str, stream: str, first_ns: int, last_ns: int, *, names: Collection[str] | None = None
    ) -> Iterator[Chunk]:
        """The chunks with rows from `first_ns` to `last_ns`, cut to these, in the order of time; names: of the columns
        that are wanted, None: of all.
        """
        newest = [one for one in self._pieces.of(point, stream) if one.t0_ns <= last_ns and one.t1_ns >= first_ns]
        last_kept_ns = FIRST_NS
        for day in self._days.between((first_ns - REACH_NS) // DAY_NS, last_ns // DAY_NS):
            for chunk in day.chunks(point, stream, first_ns, last_ns, names):
                last_kept_ns = max(last_kept_ns, int(chunk.time_ns[-1]))
                part = part_of(chunk, first_ns, last_ns)
                if len(part.time_ns):
                    yield part
        for one in newest:
            if one.t0_ns > last_kept_ns:
                part = part_of(one.chunk(names), first_ns, last_ns)
                if len(part.time_ns):
                    yield part

    def buckets(self, point: str, stream: str, first_ns: int, last_ns: int, count: int) -> Buckets:
        """Least and largest values of `count` equal spans from `first_ns` on: of rows and seconds, and where the spans
        are longer than a block, of blocks or of the coarsest level that is finer.
        """
        step_ns = max((last_ns - first_ns) // count, 1)
        begin_ns = first_ns + step_ns * np.arange(count)
        finer = [level for level, length_s in LEVELS_S.items() if length_s * NANOSECONDS <= step_ns]
        if step_ns < BLOCK_S * NANOSECONDS:
            edges = np.append(begin_ns, max(begin_ns[-1] + step_ns, last_ns))
            drawn = self.drawn(point, stream, edges)
            return Buckets(begin_ns, drawn.low, drawn.high)
        places, lows, highs = (
            self._pyramid.spans(point, stream, first_ns, last_ns, finer[-1])
            if finer
            else self._pyramid.limits(point, stream, first_ns, last_ns)
        )
        late = [one.drawn(one.shown) for one in self._newest_rows(point, stream) if one.shown]
        places = np.concatenate([places, *(time_ns for time_ns, _ in late)])
        lows, highs = (np.concatenate([one, *(values for _, values in late)]) for one in (lows, highs))
        inside = (places >= first_ns) & (places < last_ns)
        low, high = np.full(count, np.inf), np.full(count, -np.inf)
        # A block belongs to the bucket that its begin is in.
        number = np.clip((places[inside] - first_ns) // step_ns, 0, count - 1)
        np.minimum.at(low, number, lows[inside])
        np.maximum.at(high, number, highs[inside])
        return Buckets(begin_ns, np.where(np.isfinite(low), low, np.nan), np.where(np.isfinite(high), high, np.nan))

    def drawn(self, point: str, stream: str, edges: Nanoseconds, shown: str = "") -> Drawn:
        """The figures of a column (left out: the first) in buckets between edges (n + 1,) in ns: of seconds where all
        buckets are as long, of rows where they are shorter, and where no seconds are kept.
        """
        found, first_ns, last_ns = SummaryBuckets(edges), int(edges[0]), int(edges[-1]) - 1
        if len(edges) > 1 and int(np.diff(edges).min()) >= NANOSECONDS:
            newest = self._newest_rows(point, stream, shown or None)
            for day in self._days.between((first_ns - REACH_NS) // DAY_NS, last_ns // DAY_NS):
                day.draw((point, stream, first_ns, last_ns), found, shown)
            for chunk in newest:
                found.add_rows(part_of(chunk, first_ns, last_ns), shown)
            return found.figures
        names = {shown, STD, STATUS} if shown else None
        for chunk in joined(list(self.chunks(point, stream, first_ns, last_ns, names=names))):
            found.add_rows(chunk, shown)
        return found.figures

    def events(self, point: str, first_ns: int, last_ns: int) -> list[Event]:
        """A point's events, in the order of time."""
        sql = "SELECT time_ns, kind, text, axis FROM event WHERE point = ? AND time_ns BETWEEN ? AND ? ORDER BY time_ns"
        return [Event(*row) for row in self._site.execute(sql, (point, first_ns, last_ns))]

    def event_times(self, point: str, kind: str, last_ns: int) -> list[int]:
        """The instants (ns) of a point's events of one kind up to `last_ns`, in the order of time."""
        sql = "SELECT time_ns FROM event WHERE point = ? AND kind = ? AND time_ns <= ? ORDER BY time_ns"
        return [int(row[0]) for row in self._site.execute(sql, (point, kind, last_ns))]

    def calibrations(self, point: str) -> list[StoredCalibration]:
        """A point's calibrations in the order of their numbers."""
        sql = "SELECT point, number, made_ns, state, body, settings FROM calibration WHERE point = ? ORDER BY number"
        return [StoredCalibration(*row) for row in self._site.execute(sql, (point,))]

    def calibration(self, point: str, number: int | None = None) -> StoredCalibration | None:
        """A point's calibration of this number; left out: the one in force."""
        for one in self.calibrations(point):
            if one.number == number or (number is None and one.state == "in force"):
                return one
        return None

    def spans(self, point: str, stream: str) -> list[CalibratedSpan]:
        """When a stream's rows were made with which calibration."""
        return spans_of(self._days.all(), self._pieces.of(point, stream), point, stream)

    def checkpoint(self, point: str) -> tuple[int, bytes] | None:
        """A point's newest checkpoint and its instant (ns). Raises DataError for a damaged one."""
        databases = (self.checkpoints, self._site)
        found = (kept_checkpoint(one, point) for one in databases if one.has_table("checkpoint"))
        return max((one for one in found if one is not None), key=lambda one: one[0], default=None)

    def group_checkpoint(self, key: str) -> tuple[int, bytes] | None:
        """A group's newest state, by `GroupChunk.key`, and its instant (ns). Raises DataError for a damaged one."""
        return self._groups.checkpoint(key)


def open_store(
    where: str | Path, *, read_only: bool = False, points: Sequence[str] = (), division: Division | None = None
) -> Store:
    """The store in a folder, or at a `postgresql://` address; made where there is none, unless it is only read.

    points: whose records will be written: locked until the store is closed, as is the site's division. Raises DataError
    where there is none to read, UsageError for one of another version and, before anything is written, for a point that
    another process writes or a site that runs in another division; StoreFault where it cannot be reached.
    """
    with ExitStack() as opened:
        if is_address(where):
            server = PostgresDatabase(str(where), partial(lock_in_session, points=points, division=division))
            database: Database = server
            store = Store(server, server, OneDatabase(server), TablePieces(server), StateTable(server), points=points)
            tables: tuple[str, ...] = (*SITE_TABLES, *CHECKPOINT_TABLES, *DAY_TABLES, *SERVER_TABLES)
        else:
            folder = Path(where)
            if read_only and not (folder / SITE_FILE).is_file():
                raise DataError(
                    f"{folder}: is not a store: it has no {SITE_FILE}. `midspan replay` and `midspan run` create one."
                )
            locks = FileLocks(folder, points, division)
            opened.callback(locks.close)
            database = SqliteDatabase(folder / SITE_FILE, read_only=read_only)
            pieces = FilePieces(folder / LOGS, read_only)
            days = Days(folder / DAYS, read_only=read_only)
            file = folder / CHECKPOINT_FILE
            has_file = not read_only or file.is_file()
            checkpoints = SqliteDatabase(file, read_only=read_only, ahead=False) if has_file else database
            states = StateFiles(folder, read_only=read_only)
            store = Store(database, checkpoints, days, pieces, states, locks, points)
            for sql in () if read_only else CHECKPOINT_TABLES:
                checkpoints.execute(sql)
            tables = SITE_TABLES
        opened.callback(store.close)
        if not read_only:
            database.create(tables)
        if _version(database, str(where), write=not read_only) == "1" and not read_only:
            store.take_forward()
        opened.pop_all()
    return store


def is_store(path: str | Path) -> bool:
    """Whether a path is the folder of a store, or the address of a database."""
    return is_address(path) or (Path(path) / SITE_FILE).is_file()


def is_address(where: str | Path) -> bool:
    """Whether a store is named by the address of a PostgreSQL database."""
    return str(where).startswith(("postgresql://", "postgres://"))


def _version(database: Database, where: str, *, write: bool) -> str:
    """The store's schema, which is written where there is none. Raises UsageError for one that cannot be read."""
    rows = database.execute("SELECT value FROM meta WHERE key = 'schema'")
    if not rows and write:
        database.execute("INSERT INTO meta VALUES ('schema', ?)", (str(SCHEMA),))
        return str(SCHEMA)
    found = str(rows[0][0]) if rows else "none"
    if found not in READABLE:
        name = "the PostgreSQL store" if is_address(where) else where
        raise UsageError(f"{name}: is a store of version {found}; this midspan reads versions {', '.join(READABLE)}.")
    return found
