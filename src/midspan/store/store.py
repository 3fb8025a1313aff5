"""The store of a site: what is kept of its points, by whom it was made, and how it is read again.

SQLite: `site.sqlite` with calibrations, checkpoints, events and the pyramid of least and largest values, and a file for
each day (UTC) with the chunks. PostgreSQL: the same tables in one database. One process writes a point; any
number read.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import date, timedelta
from functools import partial
from pathlib import Path

import numpy as np

from midspan.errors import DataError, UsageError
from midspan.records import NANOSECONDS, Event, Floats, Nanoseconds
from midspan.store import summary
from midspan.store.chunk import Chunk, decode, encode, join
from midspan.store.database import Database, FileLocks, PostgresDatabase, SqliteDatabase, lock_in_session
from midspan.store.summary import Buckets as SummaryBuckets
from midspan.store.summary import Drawn, is_summed

SCHEMA = 1
SITE_FILE, DAYS = "site.sqlite", "days"
# Pieces of a second or so are joined to chunks of this length.
CHUNK_S = 10.0
# The lengths of the pyramid's levels above the chunks: 16 chunks, 16 of these, 16 of those (11.4 h).
LEVELS_S = (160.0, 2560.0, 40960.0)
DAY_NS = 86_400 * NANOSECONDS

SITE_TABLES = (
    "CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS calibration (point TEXT NOT NULL, number BIGINT NOT NULL, made_ns BIGINT NOT NULL, "
    "state TEXT NOT NULL, body TEXT NOT NULL, settings TEXT NOT NULL, PRIMARY KEY (point, number))",
    "CREATE TABLE IF NOT EXISTS checkpoint (point TEXT PRIMARY KEY, time_ns BIGINT NOT NULL, body {blob} NOT NULL)",
    "CREATE TABLE IF NOT EXISTS event (point TEXT NOT NULL, time_ns BIGINT NOT NULL, kind TEXT NOT NULL, "
    "text TEXT NOT NULL, axis BIGINT NOT NULL, PRIMARY KEY (point, time_ns, kind, text))",
    "CREATE TABLE IF NOT EXISTS pyramid (point TEXT NOT NULL, stream TEXT NOT NULL, level BIGINT NOT NULL, "
    "t0_ns BIGINT NOT NULL, n BIGINT NOT NULL, low DOUBLE PRECISION, high DOUBLE PRECISION, "
    "PRIMARY KEY (point, stream, level, t0_ns))",
)
DAY_TABLES = (
    "CREATE TABLE IF NOT EXISTS chunk (point TEXT NOT NULL, stream TEXT NOT NULL, t0_ns BIGINT NOT NULL, "
    "t1_ns BIGINT NOT NULL, n BIGINT NOT NULL, joined BIGINT NOT NULL, low DOUBLE PRECISION, high DOUBLE PRECISION, "
    "calibration BIGINT NOT NULL, body {blob} NOT NULL)",
    "CREATE TABLE IF NOT EXISTS summary (point TEXT NOT NULL, stream TEXT NOT NULL, t0_ns BIGINT NOT NULL, "
    "body {blob} NOT NULL, PRIMARY KEY (point, stream, t0_ns))",
    # Histories read this index alone, never the bodies.
    "CREATE INDEX IF NOT EXISTS chunk_place ON chunk (point, stream, t0_ns, t1_ns, n, low, high)",
)


@dataclass(frozen=True, slots=True)
class Batch:
    """What is written at once; events: by point."""

    chunks: Sequence[Chunk] = ()
    events: Sequence[tuple[str, Event]] = ()
    checkpoints: Mapping[str, tuple[int, bytes]] = field(default_factory=dict)


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
    """Reads and writes a site's records; one thread at a time."""

    def __init__(self, site: Database, days: "Days", locks: FileLocks | None = None) -> None:
        self._site, self._days, self._locks = site, days, locks
        self._newest: dict[tuple[str, str], int | None] = {}

    def close(self) -> None:
        """Let the files or the connection go."""
        self._site.close()
        self._days.close()
        if self._locks is not None:
            self._locks.close()

    # What is written

    def write(self, batch: Batch) -> None:
        """Keep a batch. Rows at or before the newest kept one of their stream are dropped: none is ever doubled.

        When it returns, everything is kept; after an exception any part of it may be, and it is to be written again.
        The chunks come first: a checkpoint is never newer than what it rests on. Raises StoreFault.
        """
        new = [one for chunk in batch.chunks for one in self._new_rows(chunk)]
        try:
            for day in sorted({one.time_ns[0] // DAY_NS for one in new}):
                database = self._days.of(int(day))
                with database.transaction():
                    for one in new:
                        if one.time_ns[0] // DAY_NS == day:
                            self._add(database, one)
        except BaseException:
            self._newest.clear()
            raise
        with self._site.transaction():
            for point, event in batch.events:
                self._site.execute(
                    "INSERT INTO event VALUES (?, ?, ?, ?, ?) ON CONFLICT DO NOTHING",
                    (point, event.time_ns, event.kind, event.text, event.axis),
                )
            for point, (time_ns, state) in batch.checkpoints.items():
                self._site.execute(
                    "INSERT INTO checkpoint VALUES (?, ?, ?) "
                    "ON CONFLICT (point) DO UPDATE SET time_ns = excluded.time_ns, body = excluded.body",
                    (point, time_ns, state),
                )

    def _new_rows(self, chunk: Chunk) -> list[Chunk]:
        """The rows that are not kept yet, by slots of CHUNK_S, which no day cuts."""
        newest_ns = self.newest_ns(chunk.point, chunk.stream)
        if newest_ns is not None:
            chunk = chunk.rows(chunk.time_ns > newest_ns)
        if not len(chunk.time_ns):
            return []
        self._newest[chunk.point, chunk.stream] = int(chunk.time_ns[-1])
        return chunk.split(CHUNK_S)

    def _add(self, database: Database, piece: Chunk) -> None:
        """Add a piece; the pieces of earlier slots become one chunk, and the pyramid gets it."""
        slot_ns = _floor(int(piece.time_ns[0]), CHUNK_S)
        rows = database.execute(
            "SELECT t0_ns, calibration, body FROM chunk WHERE point = ? AND stream = ? AND t0_ns >= ? AND t0_ns < ? "
            "AND joined = 0 ORDER BY t0_ns",
            (piece.point, piece.stream, _floor(slot_ns, 86_400.0), slot_ns),
        )
        _insert(database, piece, joined=False)
        for begin_ns in dict.fromkeys(_floor(row[0], CHUNK_S) for row in rows):
            pieces = [
                decode(bytes(body), piece.point, piece.stream, number, piece.shown)
                for t0_ns, number, body in rows
                if _floor(t0_ns, CHUNK_S) == begin_ns
            ]
            database.execute(
                "DELETE FROM chunk WHERE point = ? AND stream = ? AND joined = 0 AND t0_ns >= ? AND t0_ns < ?",
                (piece.point, piece.stream, begin_ns, begin_ns + round(CHUNK_S * NANOSECONDS)),
            )
            # What was made by another calibration stays a chunk of its own.
            for number in dict.fromkeys(one.calibration for one in pieces):
                _insert(database, join([one for one in pieces if one.calibration == number]), joined=True)
            if is_summed(piece):
                self._sum_up(database, pieces, begin_ns)
            if piece.shown:
                self._raise(database, piece.point, piece.stream, begin_ns)

    def _sum_up(self, database: Database, pieces: list[Chunk], slot_ns: int) -> None:
        """Keep the seconds of a slot."""
        database.execute(
            "INSERT INTO summary VALUES (?, ?, ?, ?) ON CONFLICT (point, stream, t0_ns) "
            "DO UPDATE SET body = excluded.body",
            (pieces[0].point, pieces[0].stream, slot_ns, summary.encode(pieces, slot_ns)),
        )

    def _raise(self, database: Database, point: str, stream: str, slot_ns: int) -> None:
        """Make the pyramid's spans above a slot anew, from what is below each: right however often it is done."""
        for level, length_s in enumerate(LEVELS_S):
            begin_ns = _floor(slot_ns, length_s)
            place = (point, stream, begin_ns, begin_ns + round(length_s * NANOSECONDS))
            # The lowest level stands on the chunks, each other one on that below it.
            below, table, where = (database, "chunk", "") if level == 0 else (self._site, "pyramid", " AND level = ?")
            sql = (
                f"SELECT SUM(n), MIN(low), MAX(high) FROM {table} WHERE point = ? AND stream = ? AND t0_ns >= ? "
                f"AND t0_ns < ?{where}"
            )
            found = below.execute(sql, place if level == 0 else (*place, level - 1))
            if found[0][0] is not None:
                self._site.execute(
                    "INSERT INTO pyramid VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT (point, stream, level, t0_ns) "
                    "DO UPDATE SET n = excluded.n, low = excluded.low, high = excluded.high",
                    (point, stream, level, begin_ns, *found[0]),
                )

    def add_calibration(self, point: str, made_ns: int, body: str, settings: str, *, accept: bool) -> int:
        """Keep a calibration, in force (the one before is retired) or offered; returns its number, from 1 on."""
        with self._site.transaction():
            last = self._site.execute("SELECT MAX(number) FROM calibration WHERE point = ?", (point,))[0][0]
            number = 1 + (last or 0)
            sql = "INSERT INTO calibration VALUES (?, ?, ?, ?, ?, ?)"
            self._site.execute(sql, (point, number, made_ns, "offered", body, settings))
            if accept:
                self._put_in_force(point, number)
        return number

    def accept(self, point: str, number: int) -> None:
        """Put an offered calibration in force."""
        with self._site.transaction():
            self._put_in_force(point, number)

    def refuse(self, point: str, number: int) -> bool:
        """Refuse an offered calibration; whether there was such a one."""
        with self._site.transaction():
            place = (point, number)
            sql = "SELECT 1 FROM calibration WHERE point = ? AND number = ? AND state = 'offered'"
            found = bool(self._site.execute(sql, place))
            self._site.execute(
                "UPDATE calibration SET state = 'refused' WHERE point = ? AND number = ? AND state = 'offered'", place
            )
        return found

    def _put_in_force(self, point: str, number: int) -> None:
        self._site.execute("UPDATE calibration SET state = 'retired' WHERE point = ? AND state = 'in force'", (point,))
        self._site.execute("UPDATE calibration SET state = 'in force' WHERE point = ? AND number = ?", (point, number))

    def forget_before(self, time_ns: int) -> None:
        """Remove the chunks of whole days before a time; events, calibrations and the pyramid stay."""
        self._days.forget_before(time_ns // DAY_NS)

    def forget_since(self, point: str, time_ns: int, calibration: int) -> None:
        """Remove what a point has from a time on, and a calibration that was made for it."""
        shown = self._site.execute("SELECT DISTINCT stream FROM pyramid WHERE point = ?", (point,))
        for database in self._days.all():
            database.execute("DELETE FROM chunk WHERE point = ? AND t0_ns >= ?", (point, time_ns))
            since_ns = _floor(time_ns, CHUNK_S)
            database.execute("DELETE FROM summary WHERE point = ? AND t0_ns >= ?", (point, since_ns))
        self._newest.clear()
        with self._site.transaction():
            self._site.execute("DELETE FROM event WHERE point = ? AND time_ns >= ?", (point, time_ns))
            self._site.execute("DELETE FROM calibration WHERE point = ? AND number = ?", (point, calibration))
            for level, length_s in enumerate(LEVELS_S):
                sql = "DELETE FROM pyramid WHERE point = ? AND level = ? AND t0_ns >= ?"
                self._site.execute(sql, (point, level, _floor(time_ns, length_s)))
        for row in shown:
            self._raise(self._days.of(time_ns // DAY_NS), point, str(row[0]), _floor(time_ns, CHUNK_S))

    # What is read

    @property
    def points(self) -> list[str]:
        """The names of the points of which rows are kept, sorted."""
        rows = self._site.execute("SELECT DISTINCT point FROM pyramid")
        for database in self._days.all():
            rows += database.execute("SELECT DISTINCT point FROM chunk")
        return sorted({str(row[0]) for row in rows})

    def has_point(self, point: str) -> bool:
        """Whether anything of a point is kept."""
        for table in ("pyramid", "calibration", "event"):
            if self._site.execute(f"SELECT 1 FROM {table} WHERE point = ? LIMIT 1", (point,)):
                return True
        sql = "SELECT 1 FROM chunk WHERE point = ? LIMIT 1"
        return any(database.execute(sql, (point,)) for database in self._days.all(newest_first=True))

    def count(self, point: str, stream: str, first_ns: int, last_ns: int) -> int:
        """How many rows the chunks have that reach into a time: as many as it has, or some seconds' more."""
        sql = "SELECT SUM(n) FROM chunk WHERE point = ? AND stream = ? AND t0_ns >= ? AND t0_ns <= ? AND t1_ns >= ?"
        place = (point, stream, first_ns - round(CHUNK_S * NANOSECONDS), last_ns, first_ns)
        days = self._days.between(first_ns // DAY_NS, last_ns // DAY_NS)
        return sum(int(day.execute(sql, place)[0][0] or 0) for day in days)

    def streams(self, point: str) -> list[str]:
        """The names of a point's streams, sorted."""
        sql = "SELECT DISTINCT stream FROM chunk WHERE point = ?"
        return sorted({str(row[0]) for database in self._days.all() for row in database.execute(sql, (point,))})

    def days(self, point: str, stream: str) -> list[int]:
        """The days (since 1970, UTC) of which a stream has rows, sorted."""
        sql = "SELECT DISTINCT t0_ns / ? FROM chunk WHERE point = ? AND stream = ?"
        found = (database.execute(sql, (DAY_NS, point, stream)) for database in self._days.all())
        return sorted({int(row[0]) for rows in found for row in rows})

    def newest_ns(self, point: str, stream: str) -> int | None:
        """The stamp of a stream's newest row, None without any."""
        if (point, stream) not in self._newest:
            sql = "SELECT MAX(t1_ns) FROM chunk WHERE point = ? AND stream = ?"
            kept = (database.execute(sql, (point, stream))[0][0] for database in self._days.all(newest_first=True))
            self._newest[point, stream] = next((int(one) for one in kept if one is not None), None)
        return self._newest[point, stream]

    def chunks(self, point: str, stream: str, first_ns: int, last_ns: int) -> Iterator[Chunk]:
        """The chunks with rows from `first_ns` to `last_ns`, cut to these, in the order of time."""
        sql = (
            "SELECT t0_ns, t1_ns, calibration, body FROM chunk WHERE point = ? AND stream = ? AND t0_ns >= ? "
            "AND t0_ns <= ? AND t1_ns >= ? ORDER BY t0_ns"
        )
        reach_ns = round(CHUNK_S * NANOSECONDS)
        for database in self._days.between(first_ns // DAY_NS, last_ns // DAY_NS):
            for t0_ns, t1_ns, number, body in database.execute(
                sql, (point, stream, first_ns - reach_ns, last_ns, first_ns)
            ):
                chunk = decode(bytes(body), point, stream, number)
                inside = t0_ns >= first_ns and t1_ns <= last_ns
                yield chunk if inside else chunk.rows((chunk.time_ns >= first_ns) & (chunk.time_ns <= last_ns))

    def buckets(self, point: str, stream: str, first_ns: int, last_ns: int, count: int) -> Buckets:
        """Least and largest values of `count` equal spans from `first_ns` on, from the coarsest level that is finer."""
        step_ns = max((last_ns - first_ns) // count, 1)
        begin_ns = first_ns + step_ns * np.arange(count)
        low, high = np.full(count, np.inf), np.full(count, -np.inf)
        finer = [k for k, length_s in enumerate(LEVELS_S) if length_s * NANOSECONDS <= step_ns]
        if step_ns < CHUNK_S * NANOSECONDS:
            drawn = [one.drawn(next(iter(one.columns))) for one in self.chunks(point, stream, first_ns, last_ns)]
            places = np.concatenate([np.empty(0, np.int64), *(time_ns for time_ns, _ in drawn)])
            lows = highs = np.concatenate([np.empty(0), *(values for _, values in drawn)])
        else:
            places, lows, highs = self._spans(point, stream, first_ns, last_ns, finer[-1] if finer else None)
        # A chunk belongs to the bucket that its begin is in.
        number = np.clip((places - first_ns) // step_ns, 0, count - 1)
        np.minimum.at(low, number, lows)
        np.maximum.at(high, number, highs)
        return Buckets(begin_ns, np.where(np.isfinite(low), low, np.nan), np.where(np.isfinite(high), high, np.nan))

    def drawn(self, point: str, stream: str, edges: Nanoseconds, shown: str) -> Drawn:
        """The figures of a column in buckets between edges (n + 1,) in ns: of seconds where all buckets are as long,
        of rows where they are shorter, and where no seconds are kept.
        """
        found, first_ns, last_ns = SummaryBuckets(edges), int(edges[0]), int(edges[-1]) - 1
        if len(edges) > 1 and int(np.diff(edges).min()) >= NANOSECONDS:
            for day in self._days.between(first_ns // DAY_NS, last_ns // DAY_NS):
                self._draw_day(day, (point, stream, first_ns, last_ns), found, shown)
            return found.figures
        for chunk in self.chunks(point, stream, first_ns, last_ns):
            found.add_rows(chunk, shown)
        return found.figures

    def _draw_day(self, day: Database, place: tuple[str, str, int, int], found: SummaryBuckets, shown: str) -> None:
        point, stream, first_ns, last_ns = place
        reach_ns = round(CHUNK_S * NANOSECONDS)
        sql = (
            "SELECT t0_ns, body FROM summary WHERE point = ? AND stream = ? AND t0_ns > ? AND t0_ns <= ? ORDER BY t0_ns"
        )
        has_seconds = day.has_table("summary")
        rows = day.execute(sql, (point, stream, first_ns - reach_ns, last_ns)) if has_seconds else []
        if rows:
            found.add_seconds(summary.decode([(int(t0_ns), bytes(body)) for t0_ns, body in rows]))
        summed = {int(row[0]) for row in rows}
        sql = "SELECT t0_ns FROM chunk WHERE point = ? AND stream = ? AND t0_ns > ? AND t0_ns <= ?"
        kept = day.execute(sql, (point, stream, first_ns - reach_ns, last_ns))
        missing = [int(row[0]) for row in kept if _floor(int(row[0]), CHUNK_S) not in summed]
        sql = "SELECT calibration, body FROM chunk WHERE point = ? AND stream = ? AND t0_ns = ?"
        for t0_ns in dict.fromkeys(missing):
            for number, body in day.execute(sql, (point, stream, t0_ns)):
                chunk = decode(bytes(body), point, stream, number)
                found.add_rows(chunk.rows((chunk.time_ns >= first_ns) & (chunk.time_ns <= last_ns)), shown)

    def _spans(
        self, point: str, stream: str, first_ns: int, last_ns: int, level: int | None
    ) -> tuple[Nanoseconds, Floats, Floats]:
        """Begins, least and largest values of the spans of a level; None: of the chunks."""
        place = (point, stream, first_ns, last_ns)
        where = "WHERE point = ? AND stream = ? AND t0_ns >= ? AND t0_ns < ? AND low IS NOT NULL"
        if level is None:
            days = self._days.between(first_ns // DAY_NS, last_ns // DAY_NS)
            rows = [row for day in days for row in day.execute(f"SELECT t0_ns, low, high FROM chunk {where}", place)]
        else:
            sql = f"SELECT t0_ns, low, high FROM pyramid {where} AND level = ?"
            rows = self._site.execute(sql, (*place, level))
        found = np.array(rows, dtype=np.float64).reshape(-1, 3)
        return np.array([row[0] for row in rows], dtype=np.int64), found[:, 1], found[:, 2]

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

    def checkpoint(self, point: str) -> tuple[int, bytes] | None:
        """A point's newest checkpoint and its instant (ns)."""
        rows = self._site.execute("SELECT time_ns, body FROM checkpoint WHERE point = ?", (point,))
        return (int(rows[0][0]), bytes(rows[0][1])) if rows else None


def _floor(time_ns: int, length_s: float) -> int:
    length_ns = round(length_s * NANOSECONDS)
    return time_ns - time_ns % length_ns


def _insert(database: Database, chunk: Chunk, *, joined: bool) -> None:
    stamps = (int(chunk.time_ns[0]), int(chunk.time_ns[-1]), len(chunk.time_ns))
    values = (chunk.point, chunk.stream, *stamps, int(joined), *chunk.limits, chunk.calibration, encode(chunk))
    database.execute("INSERT INTO chunk VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", values)


class Days:
    """The databases of the days (their numbers since 1970): a SQLite file each."""

    def __init__(self, folder: Path, *, read_only: bool) -> None:
        self._folder, self._read_only = folder, read_only
        self._open: dict[int, SqliteDatabase] = {}

    def of(self, day: int) -> Database:
        """The day's database, made where there is none."""
        if day not in self._open:
            database = SqliteDatabase(self._file(day), read_only=self._read_only)
            if not self._read_only:
                for sql in DAY_TABLES:
                    database.execute(sql)
            self._open[day] = database
        return self._open[day]

    def all(self, *, newest_first: bool = False) -> Iterator[Database]:
        """All days' databases, the earliest first."""
        for day in sorted(self._numbers(), reverse=newest_first):
            yield self.of(day)

    def between(self, first: int, last: int) -> Iterator[Database]:
        """Those of the days from `first` to `last`; a day's first chunk may begin on the day before."""
        for day in sorted(day for day in self._numbers() if first - 1 <= day <= last):
            yield self.of(day)

    def forget_before(self, day: int) -> None:
        """Remove the files of the days before."""
        for old in [one for one in self._numbers() if one < day]:
            if old in self._open:
                self._open.pop(old).close()
            for end in ("", "-wal", "-shm"):
                Path(f"{self._file(old)}{end}").unlink(missing_ok=True)

    def close(self) -> None:
        """Let the files go."""
        for database in self._open.values():
            database.close()
        self._open.clear()

    def _file(self, day: int) -> Path:
        return self._folder / f"{date(1970, 1, 1) + timedelta(day)}.sqlite"

    def _numbers(self) -> list[int]:
        names = (file.stem for file in self._folder.glob("????-??-??.sqlite"))
        return [(date.fromisoformat(name) - date(1970, 1, 1)).days for name in names]


class OneDatabase(Days):
    """All days in one PostgreSQL database."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def of(self, day: int) -> Database:
        """The database."""
        return self._database

    def all(self, *, newest_first: bool = False) -> Iterator[Database]:
        """The database, once."""
        yield self._database

    def between(self, first: int, last: int) -> Iterator[Database]:
        """The database, once."""
        yield self._database

    def forget_before(self, day: int) -> None:
        """Remove the chunks of the days before."""
        for table in ("chunk", "summary"):
            self._database.execute(f"DELETE FROM {table} WHERE t0_ns < ?", (day * DAY_NS,))

    def close(self) -> None:
        """The connection is the site's."""


def open_store(where: str | Path, *, read_only: bool = False, points: Sequence[str] = ()) -> Store:
    """The store in a folder, or at a `postgresql://` address; made where there is none, unless it is only read.

    points: whose records will be written: locked until the store is closed. Raises DataError where there is none to
    read, UsageError for one of another version and, before anything is written, for a point that another process
    writes; StoreFault where it cannot be reached.
    """
    with ExitStack() as opened:
        if is_address(where):
            database: Database = PostgresDatabase(str(where), partial(lock_in_session, points=points))
            store = Store(database, OneDatabase(database))
            tables: tuple[str, ...] = (*SITE_TABLES, *DAY_TABLES)
        else:
            folder = Path(where)
            if read_only and not (folder / SITE_FILE).is_file():
                raise DataError(
                    f"{folder}: is no store: it has no {SITE_FILE}. `midspan replay` and `midspan run` make one."
                )
            locks = FileLocks(folder, points)
            opened.callback(locks.close)
            database = SqliteDatabase(folder / SITE_FILE, read_only=read_only)
            store = Store(database, Days(folder / DAYS, read_only=read_only), locks)
            tables = SITE_TABLES
        opened.callback(store.close)
        for sql in () if read_only else tables:
            database.execute(sql)
        _check_version(database, str(where), write=not read_only)
        opened.pop_all()
    return store


def is_store(path: str | Path) -> bool:
    """Whether a path is the folder of a store, or the address of a database."""
    return is_address(path) or (Path(path) / SITE_FILE).is_file()


def is_address(where: str | Path) -> bool:
    """Whether a store is named by the address of a PostgreSQL database."""
    return str(where).startswith(("postgresql://", "postgres://"))


def _check_version(database: Database, where: str, *, write: bool) -> None:
    rows = database.execute("SELECT value FROM meta WHERE key = 'schema'")
    if not rows and write:
        database.execute("INSERT INTO meta VALUES ('schema', ?)", (str(SCHEMA),))
        return
    found = rows[0][0] if rows else "none"
    if found != str(SCHEMA):
        name = "the PostgreSQL store" if is_address(where) else where
        raise UsageError(f"{name}: is a store of version {found}; this midspan reads version {SCHEMA}.")
