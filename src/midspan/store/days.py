"""The blocks of a store by days: a SQLite file for each day (UTC), or one PostgreSQL database; and what a day gives.

Days of schema 1 have the tables `chunk` and `summary` in place of `block`, or next to it on the day of the change: they
are read as they are.
"""

import json
from collections.abc import Collection, Iterator, Sequence
from datetime import date, timedelta
from pathlib import Path

import numpy as np

from midspan.records import NANOSECONDS, Floats, Nanoseconds
from midspan.store import partitions, seconds, summary
from midspan.store.chunk import Chunk, encode
from midspan.store.database import Database, PostgresDatabase, Row, SqliteDatabase
from midspan.store.group_rows import decoded
from midspan.store.summary import Buckets as SummaryBuckets

DAYS = "days"
DAY_NS = 86_400 * NANOSECONDS
# Pieces of a second or so become blocks of this length: with each a few pages of the file's index are written again.
BLOCK_S = 320.0
# No block is longer, and with a last piece twice as long.
REACH_NS = round(2.0 * BLOCK_S * NANOSECONDS)
DAY_TABLES = (
    "CREATE TABLE IF NOT EXISTS block (point TEXT NOT NULL, stream TEXT NOT NULL, t0_ns BIGINT NOT NULL, "
    "t1_ns BIGINT NOT NULL, n BIGINT NOT NULL, low DOUBLE PRECISION, high DOUBLE PRECISION, "
    # Histories read the seconds, which stand before the body, never that.
    "seconds {blob}, body {blob} NOT NULL)",
    "CREATE INDEX IF NOT EXISTS block_place ON block (point, stream, t0_ns)",
)
# Tables with rows, and where the number of their calibration is.
TABLES = {"chunk": "calibration", "block": "0", partitions.TABLE: "0"}
# Those whose rows have their seconds next to them.
BLOCK_TABLES = ("block", partitions.TABLE)


class Day:
    """One database with chunks of one or of all days."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self._tables: frozenset[str] | None = None

    @property
    def tables(self) -> frozenset[str]:
        """Those that it has, but for schema 1's second one."""
        if self._tables is None:
            self._tables = frozenset(name for name in (*TABLES, "summary") if self.database.has_table(name))
        return self._tables

    def make_tables(self) -> None:
        """Make what is not there."""
        for sql in DAY_TABLES:
            self.database.execute(sql)
        self._tables = None

    def insert(self, chunk: Chunk) -> None:
        """Add a block."""
        stamps = (int(chunk.time_ns[0]), int(chunk.time_ns[-1]), len(chunk.time_ns))
        seconds = summary.encode(chunk) if chunk.shown else None
        values = (chunk.point, chunk.stream, *stamps, *chunk.limits, seconds, encode(chunk))
        self.database.execute("INSERT INTO block VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", values)

    def insert_blocks(self, day: int, rows: Sequence[Row]) -> None:
        """Add blocks of points of a group, as the table has them, within a transaction."""
        self.database.execute_many("INSERT INTO block VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", rows)

    def newest_of(self, points: Sequence[str], stream: str) -> list[tuple[str, int]]:
        """Points, of some, that have blocks, each with the stamp of its newest row."""
        sql = (
            "SELECT value, (SELECT t1_ns FROM block WHERE point = value AND stream = ? ORDER BY t0_ns DESC LIMIT 1) "
            "FROM json_each(?)"
        )
        return _known(self.database.execute(sql, (stream, json.dumps(list(points)))))

    def newest_ns(self, point: str, stream: str) -> int | None:
        """The stamp of a stream's newest row; None without any."""
        sql = "SELECT MAX(t1_ns) FROM {} WHERE point = ? AND stream = ?"
        found = [self.database.execute(sql.format(one), (point, stream))[0][0] for one in self._with_rows]
        return max((int(one) for one in found if one is not None), default=None)

    def count(self, point: str, stream: str, first_ns: int, last_ns: int) -> int:
        """How many rows the chunks have that reach into a time."""
        sql = "SELECT SUM(n) FROM {} WHERE point = ? AND stream = ? AND t0_ns >= ? AND t0_ns <= ? AND t1_ns >= ?"
        place = (point, stream, first_ns - REACH_NS, last_ns, first_ns)
        return sum(int(self.database.execute(sql.format(one), place)[0][0] or 0) for one in self._with_rows)

    def chunks(
        self, point: str, stream: str, first_ns: int, last_ns: int, names: Collection[str] | None = None
    ) -> Iterator[Chunk]:
        """The chunks that reach into a time, whole, in the order of time, with all columns or those of some names."""
        sql = (
            "SELECT {}, body FROM {} WHERE point = ? AND stream = ? AND t0_ns >= ? AND t0_ns <= ? AND t1_ns >= ? "
            "ORDER BY t0_ns"
        )
        place = (point, stream, first_ns - REACH_NS, last_ns, first_ns)
        for table in self._with_rows:
            for number, body in self.database.execute(sql.format(TABLES[table], table), place):
                yield decoded(bytes(body), point, stream, number, names=names)

    def draw(self, place: tuple[str, str, int, int], found: SummaryBuckets, shown: str) -> None:
        """Give buckets the seconds of a stream of a point in a time, or its rows where there are no seconds."""
        point, stream, first_ns, last_ns = place
        within = (point, stream, first_ns - REACH_NS, last_ns, first_ns)
        where = "point = ? AND stream = ? AND t0_ns >= ? AND t0_ns <= ?"
        for table in self.tables.intersection(BLOCK_TABLES):
            sql = f"SELECT t0_ns, seconds FROM {table} WHERE {where} AND t1_ns >= ? AND seconds IS NOT NULL"
            rows = [(int(t0_ns), bytes(body)) for t0_ns, body in self.database.execute(sql, within)]
            if rows:
                found.add_seconds(summary.decode(rows))
        if "chunk" not in self.tables:
            return
        sql = f"SELECT t0_ns, body FROM summary WHERE {where}"
        rows = self.database.execute(sql, within[:4]) if "summary" in self.tables else []
        if rows:
            found.add_seconds(summary.decode_first([(int(t0_ns), bytes(body)) for t0_ns, body in rows]))
        slots = {int(row[0]) for row in rows}
        sql = f"SELECT calibration, body FROM chunk WHERE {where} AND t1_ns >= ?"
        for number, body in self.database.execute(sql, within) if not rows else self._unsummed(within, slots):
            chunk = decoded(bytes(body), point, stream, number)
            found.add_rows(part_of(chunk, first_ns, last_ns), shown)

    def _unsummed(self, within: tuple[str, str, int, int, int], slots: set[int]) -> Iterator[Row]:
        """Chunks of schema 1 that have no seconds yet: its newest ones."""
        where = "point = ? AND stream = ? AND t0_ns >= ? AND t0_ns <= ? AND t1_ns >= ?"
        for (t0_ns,) in self.database.execute(f"SELECT DISTINCT t0_ns FROM chunk WHERE {where}", within):
            if t0_ns - t0_ns % summary.FIRST_SLOT_NS not in slots:
                sql = "SELECT calibration, body FROM chunk WHERE point = ? AND stream = ? AND t0_ns = ?"
                yield from self.database.execute(sql, (*within[:2], t0_ns))

    def limits(self, point: str, stream: str, first_ns: int, last_ns: int) -> tuple[Nanoseconds, Floats, Floats]:
        """Begin, least and largest value of each chunk that begins in a time."""
        sql = (
            "SELECT t0_ns, low, high FROM {} WHERE point = ? AND stream = ? AND t0_ns >= ? AND t0_ns < ? "
            "AND low IS NOT NULL ORDER BY t0_ns"
        )
        rows = [
            row
            for table in self._with_rows
            for row in self.database.execute(sql.format(table), (point, stream, first_ns, last_ns))
        ]
        numbers = np.array(rows, dtype=np.float64).reshape(-1, 3)
        return np.array([row[0] for row in rows], dtype=np.int64), numbers[:, 1], numbers[:, 2]

    def begins(self, point: str, stream: str) -> list[int]:
        """The first stamp of each chunk of a stream, by the index alone."""
        sql = "SELECT t0_ns FROM {} WHERE point = ? AND stream = ?"
        return [
            int(row[0]) for one in self._with_rows for row in self.database.execute(sql.format(one), (point, stream))
        ]

    def end_ns(self, point: str, stream: str, t0_ns: int) -> int | None:
        """The last stamp of the chunk that begins at an instant; None where it was removed meanwhile."""
        sql = "SELECT MAX(t1_ns) FROM {} WHERE point = ? AND stream = ? AND t0_ns = ?"
        found = (self.database.execute(sql.format(one), (point, stream, t0_ns))[0][0] for one in self._with_rows)
        return max((int(one) for one in found if one is not None), default=None)

    def head(self, point: str, stream: str, t0_ns: int, count: int) -> tuple[int, bytes] | None:
        """The number of the calibration as the table has it, and the first bytes of the chunk that begins there; None
        where it was removed meanwhile.
        """
        sql = "SELECT {}, substr(body, 1, ?) FROM {} WHERE point = ? AND stream = ? AND t0_ns = ?"
        place = (count, point, stream, t0_ns)
        rows = [row for one in self._with_rows for row in self.database.execute(sql.format(TABLES[one], one), place)]
        return (int(rows[-1][0]), bytes(rows[-1][1])) if rows else None

    def streams(self) -> set[tuple[str, str, int]]:
        """Point, stream and day of all that is kept."""
        found = set()
        for table in self._with_rows:
            sql = f"SELECT DISTINCT point, stream, t0_ns / {DAY_NS} FROM {table}"
            found |= {(str(a), str(b), int(c)) for a, b, c in self.database.execute(sql)}
        return found

    def forget_since(self, point: str, time_ns: int) -> None:
        """Remove a point's rows from a time on."""
        streams = {stream for one, stream, _ in self.streams() if one == point}
        cut = [
            part_of(one, int(one.time_ns[0]), time_ns - 1)
            for stream in streams
            for one in self.chunks(point, stream, time_ns - 1, time_ns)
            if one.time_ns[0] < time_ns <= one.time_ns[-1]
        ]
        for table in self._with_rows:
            self.database.execute(f"DELETE FROM {table} WHERE point = ? AND t1_ns >= ?", (point, time_ns))
        for one in cut:
            self.insert(one)
        if "summary" in self.tables:
            sql = "DELETE FROM summary WHERE point = ? AND t0_ns >= ?"
            self.database.execute(sql, (point, time_ns - time_ns % summary.FIRST_SLOT_NS))

    @property
    def _with_rows(self) -> list[str]:
        return [name for name in TABLES if name in self.tables]


def _known(rows: Sequence[Row]) -> list[tuple[str, int]]:
    return [(str(point), int(newest_ns)) for point, newest_ns in rows if newest_ns is not None]


def part_of(chunk: Chunk, first_ns: int, last_ns: int) -> Chunk:
    """Its rows from a time to a time."""
    if chunk.time_ns[0] >= first_ns and chunk.time_ns[-1] <= last_ns:
        return chunk
    return chunk.rows((chunk.time_ns >= first_ns) & (chunk.time_ns <= last_ns))


class Days:
    """The databases of the days (their numbers since 1970): a SQLite file each, without a write-ahead log: a block is
    written once, at the end of its file.
    """

    def __init__(self, folder: Path, *, read_only: bool) -> None:
        self._folder, self._read_only = folder, read_only
        self._open: dict[int, Day] = {}

    def of(self, day: int) -> Day:
        """The day's database, made where there is none."""
        if day not in self._open:
            made = Day(SqliteDatabase(self.file(day), read_only=self._read_only, ahead=False))
            if not self._read_only:
                made.make_tables()
            self._open[day] = made
        return self._open[day]

    def all(self) -> Iterator[Day]:
        """All days' databases, the earliest first."""
        for day in self.numbers():
            yield self.of(day)

    def between(self, first: int, last: int) -> Iterator[Day]:
        """Those of the days from `first` to `last`."""
        for day in self.numbers():
            if first <= day <= last:
                yield self.of(day)

    def forget_before(self, day: int) -> None:
        """Remove the files of the days before."""
        for old in [one for one in self.numbers() if one < day]:
            if old in self._open:
                self._open.pop(old).database.close()
            for end in ("", "-wal", "-shm", "-journal"):
                Path(f"{self.file(old)}{end}").unlink(missing_ok=True)

    def close(self) -> None:
        """Let the files go."""
        for one in self._open.values():
            one.database.close()
        self._open.clear()

    def file(self, day: int) -> Path:
        """Where a day is."""
        return self._folder / f"{date(1970, 1, 1) + timedelta(day)}.sqlite"

    def numbers(self) -> list[int]:
        """The days that there are, sorted."""
        names = (file.stem for file in self._folder.glob("????-??-??.sqlite"))
        return sorted((date.fromisoformat(name) - date(1970, 1, 1)).days for name in names)


class ServerDay(Day):
    """All days of a PostgreSQL database, and the table of seconds that others read there."""

    database: PostgresDatabase

    def insert_blocks(self, day: int, rows: Sequence[Row]) -> None:
        """Add blocks of points of a group to the day's part of their table, within a transaction."""
        partitions.insert(self.database, day, rows)

    def newest_of(self, points: Sequence[str], stream: str) -> list[tuple[str, int]]:
        """Points, of some, that have blocks, each with the stamp of its newest row."""
        sql = (
            f"SELECT point, (SELECT t1_ns FROM {partitions.TABLE} AS own WHERE own.point = named.point "
            "AND stream = ? ORDER BY t0_ns DESC LIMIT 1) FROM unnest(?::text[]) AS named (point)"
        )
        return _known(self.database.execute(sql, (stream, list(points))))

    def forget_since(self, point: str, time_ns: int) -> None:
        """Remove a point's rows from a time on; of the second that this is in, the rows before it stay."""
        super().forget_since(point, time_ns)
        begin_ns = time_ns - time_ns % NANOSECONDS
        for stream in seconds.forget_since(self.database, point, time_ns):
            for chunk in self.chunks(point, stream, begin_ns, time_ns - 1):
                if len((part := part_of(chunk, begin_ns, time_ns - 1)).time_ns):
                    seconds.merge(self.database, part)

    def forget_before(self, time_ns: int) -> None:
        """Remove all from before a time."""
        partitions.drop_before(self.database, time_ns // DAY_NS)
        for table in self.tables:
            self.database.delete(table, "t0_ns < ?", (time_ns,))
        seconds.forget_before(self.database, time_ns)


class OneDatabase(Days):
    """All days in one PostgreSQL database."""

    def __init__(self, database: PostgresDatabase) -> None:
        self._day = ServerDay(database)

    def of(self, day: int) -> Day:
        """The database."""
        return self._day

    def all(self) -> Iterator[Day]:
        """The database, once."""
        yield self._day

    def between(self, first: int, last: int) -> Iterator[Day]:
        """The database, once."""
        yield self._day

    def forget_before(self, day: int) -> None:
        """Remove the chunks of the days before."""
        self._day.forget_before(day * DAY_NS)

    def close(self) -> None:
        """The connection is the site's."""
