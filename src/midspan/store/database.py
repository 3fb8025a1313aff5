"""SQLite files and PostgreSQL behind one interface: SQL with `?` for values, `{blob}` for the type of bytes.

One process at a time writes a point of a store: the locks end with their process, however it ends. A database is used
by one thread at a time.
"""

import errno
import hashlib
import sqlite3
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from midspan.errors import DataError, MidspanError, UsageError

# A reader waits so long for a writer's transaction, and a network connection for its server.
WAIT_S = 5.0
LOCKS, SHARDS, SERVER = "locks", "shards", "the PostgreSQL store"
# Numbers of shards that processes run a site as, but for one.
DIVISIONS = (
    "SELECT objid::bigint FROM pg_locks WHERE locktype = 'advisory' AND objsubid = 2 AND classid::bigint = %s AND "
    "objid::bigint <> %s AND database = (SELECT oid FROM pg_database WHERE datname = current_database())"
)
# A server that hears nothing of a client's machine for 25 s ends its session, which lets its points go.
KEEP_ALIVE = "SET tcp_keepalives_idle = 10; SET tcp_keepalives_interval = 5; SET tcp_keepalives_count = 3"
# PostgreSQL's code for a disk without room; rows that are deleted by one statement.
DISK_FULL, DELETED_AT_ONCE = "53100", 10_000

Row = tuple[Any, ...]


class StoreFault(MidspanError):
    """The store does not take or give anything at present: `code` is a reason code of the documentation's table."""

    exit_code = 3

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code


class SqliteDatabase:
    """A file; synchronous = FULL: a transaction that has returned outlives a power cut.

    ahead: a new file gets a write-ahead log (WAL), with which readers and the writer do not wait for each other, but
    each page is written twice. Without it readers wait for the few milliseconds in which the writer commits.
    """

    def __init__(self, file: Path, *, read_only: bool = False, ahead: bool = True) -> None:
        self.file = file
        with sqlite_faults(file):
            if read_only:
                _roll_back(file)
                self._connection = sqlite3.connect(
                    f"{file.resolve().as_uri()}?mode=ro", uri=True, timeout=WAIT_S, isolation_level=None,
                    check_same_thread=False,
                )  # fmt: skip
                return
            file.parent.mkdir(parents=True, exist_ok=True)
            self._connection = sqlite3.connect(file, timeout=WAIT_S, isolation_level=None, check_same_thread=False)
            if ahead:
                self._connection.execute("PRAGMA journal_mode = WAL")
            self._connection.execute("PRAGMA synchronous = FULL")
            # Debian's SQLite would write zeros over what is removed: each page of it once more.
            self._connection.execute("PRAGMA secure_delete = OFF")

    def execute(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """Run one statement; returns its rows."""
        with sqlite_faults(self.file):
            return self._connection.execute(sql.replace("{blob}", "BLOB"), values).fetchall()

    def execute_many(self, sql: str, rows: Sequence[Sequence[Any]]) -> None:
        """Run one statement with the values of each row."""
        with sqlite_faults(self.file):
            self._connection.executemany(sql.replace("{blob}", "BLOB"), rows)

    def create(self, tables: Sequence[str]) -> None:
        """Run the statements that make tables where there are none."""
        for sql in tables:
            self.execute(sql)

    def has_table(self, name: str) -> bool:
        """Whether there is a table: files of earlier versions that are only read have fewer."""
        return bool(self.execute("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?", (name,)))

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """A block whose statements take effect together, or not at all."""
        self.execute("BEGIN IMMEDIATE")
        try:
            yield
            self.execute("COMMIT")
        except BaseException:
            # After a full disk SQLite has rolled back on its own.
            with suppress(StoreFault):
                self.execute("ROLLBACK")
            raise

    def close(self) -> None:
        """Let the file go."""
        self._connection.close()


def _roll_back(file: Path) -> None:
    """Undo what a process left half done that was killed: a connection that only reads may not."""
    if Path(f"{file}-journal").is_file():
        with suppress(sqlite3.Error), closing(sqlite3.connect(file, timeout=WAIT_S)) as connection:
            connection.execute("SELECT COUNT(*) FROM sqlite_master").fetchall()


@contextmanager
def sqlite_faults(file: Path) -> Iterator[None]:
    """What goes wrong with a file of the store, as StoreFault or DataError."""
    try:
        yield
    except sqlite3.OperationalError as error:
        code = "store_full" if "full" in str(error) else "store_unavailable"
        raise StoreFault(code, f"{file}: the store cannot be used ({error}).") from None
    except OSError as error:
        code = "store_full" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "store_unavailable"
        raise StoreFault(code, f"{file}: the store cannot be used ({error.strerror}).") from None
    except sqlite3.DatabaseError as error:
        raise DataError(f"{file}: is not a midspan store, or is damaged ({error}).") from None


class PostgresDatabase:
    """A database of a PostgreSQL server; a lost connection is opened again by the next statement.

    begin: called with each connection before it is used; what it raises closes that connection.
    """

    def __init__(self, url: str, begin: Callable[[Any], None] = lambda _: None) -> None:
        self._url, self._begin = url, begin
        self._connection: Any = None
        with self._session():
            pass

    def execute(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """Run one statement; returns its rows."""
        text = sql.replace("{blob}", "BYTEA").replace("?", "%s")
        with self._session() as session, session.cursor() as cursor:
            cursor.execute(text, tuple(values))
            return cursor.fetchall() if cursor.description else []

    def execute_many(self, sql: str, rows: Sequence[Sequence[Any]]) -> None:
        """Run one statement with the values of each row."""
        with self._session() as session, session.cursor() as cursor:
            cursor.executemany(sql.replace("?", "%s"), rows)

    def copy(self, table: str, types: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """Add rows to a table by COPY, within a transaction; types: of its columns."""
        sql = f"COPY {table} FROM STDIN (FORMAT BINARY)"
        with self._session() as session, session.cursor() as cursor, cursor.copy(sql) as copying:
            copying.set_types(types)
            for row in rows:
                copying.write_row(row)

    def delete(self, table: str, condition: str, values: Sequence[Any]) -> None:
        """Delete rows in steps, so that no statement takes long."""
        some = f"ctid = ANY (ARRAY (SELECT ctid FROM {table} WHERE {condition} LIMIT {DELETED_AT_ONCE}))"
        while self.execute(f"DELETE FROM {table} WHERE {some} AND {condition} RETURNING 1", (*values, *values)):
            pass

    def create(self, tables: Sequence[str]) -> None:
        """Run the statements that make tables where there are none: one process after another, as two that make the
        same table at once fail.
        """
        with self.transaction():
            self.execute("SELECT pg_advisory_xact_lock(hashtext('midspan tables'))")
            for sql in tables:
                self.execute(sql)

    def has_table(self, name: str) -> bool:
        """Whether there is a table."""
        return bool(self.execute("SELECT 1 WHERE to_regclass(?) IS NOT NULL", (name,)))

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """A block whose statements take effect together, or not at all."""
        with self._session() as session, session.transaction():
            yield

    def close(self) -> None:
        """Let the connection go."""
        if self._connection is not None:
            with suppress(Exception):
                self._connection.close()
        self._connection = None

    @contextmanager
    def _session(self) -> Iterator[Any]:
        """The connection, opened where there is none; what goes wrong with it or its server ends it, as StoreFault."""
        import psycopg

        try:
            yield self._opened()
        except (psycopg.OperationalError, psycopg.InterfaceError, psycopg.InternalError) as error:
            self.close()
            raise _unavailable(error) from None

    def _opened(self) -> Any:
        from midspan.store.session import LINE, Session

        if self._connection is None or self._connection.closed:
            connection = Session.connect(self._url, autocommit=True, connect_timeout=round(WAIT_S), **LINE)
            try:
                self._begin(connection)
            except BaseException:
                connection.close()
                raise
            self._connection = connection
        return self._connection


def _unavailable(error: Any) -> StoreFault:
    # The first line says what; the address stays out, it may hold a password.
    line = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    code = "store_full" if error.sqlstate == DISK_FULL else "store_unavailable"
    return StoreFault(code, f"PostgreSQL: the store cannot be used ({line}).")


Database = SqliteDatabase | PostgresDatabase


@dataclass(frozen=True, slots=True)
class Division:
    """Into how many shards the site of a name is divided, of which a process runs one; 0: it is not divided.

    Each division has its own parts of groups, so that the locks of these do not exclude the parts of another one.
    """

    site: str
    count: int

    def other(self, store: str, count: int) -> UsageError:
        """The error for a process that runs the site in another division."""
        running, this = (f"as {one} shard{'s' * (one > 1)}" if one else "without shards" for one in (count, self.count))
        return UsageError(
            f"{store}: the site {self.site!r} runs {running}, and {this} the same points would be written twice; "
            "nothing was changed. Stop everything that runs this site before its shards become more or fewer."
        )


class FileLocks:
    """Locks of points, and of the site's division, on files in the store's folder.

    Raises UsageError for a point that another process writes, and for a site that runs in another division.
    """

    def __init__(self, folder: Path, points: Sequence[str], division: Division | None = None) -> None:
        self._files = ExitStack()
        with ExitStack() as undone:
            undone.callback(self.close)
            for point in points:
                file = folder / LOCKS / f"{point}.lock"
                with sqlite_faults(file):
                    file.parent.mkdir(parents=True, exist_ok=True)
                    if not locked(self._files.enter_context(file.open("ab"))):
                        raise _is_written(str(folder), point)
            if division is not None:
                # A shard's store is a folder in that of the site.
                site_folder = folder.parent if division.count else folder
                self._files.enter_context(_division_file(site_folder, division))
            undone.pop_all()

    def close(self) -> None:
        """Let the points go."""
        self._files.close()


def _division_file(folder: Path, division: Division) -> IO[bytes]:
    """The file that all processes of a division share while they run, each with an open one."""
    with sqlite_faults(folder):
        (folder / LOCKS).mkdir(parents=True, exist_ok=True)
        with (folder / LOCKS / SHARDS).open("ab") as guard:
            # One process after another looks.
            shared(guard, exclusive=True)
            file = (folder / LOCKS / f"{SHARDS}.{division.count}").open("a+b")
            shared(file)
            for path in (folder / LOCKS).glob(f"{SHARDS}.*"):
                # `shards.lock` is that of a point with this name.
                if path.suffix[1:].isdecimal() and path.name != Path(file.name).name:
                    other = lock_file(path)
                    if other is None:
                        file.close()
                        raise division.other(str(folder), int(path.suffix[1:]))
                    other.close()
    return file


def shared(file: IO[bytes], *, exclusive: bool = False) -> None:
    """Lock a file until it is closed, together with others or alone; waits for whoever has it alone."""
    if sys.platform != "win32":
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH)


def lock_file(path: Path) -> IO[bytes] | None:
    """A file that is locked until it is closed, however its process ends; None where another process has it."""
    file = path.open("ab")
    if locked(file):
        return file
    file.close()
    return None


def locked(file: IO[bytes] | int) -> bool:
    """Lock a file (or its descriptor) until it is closed; whether nobody else has. Without such locks nobody has."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def lock_in_session(connection: Any, points: Sequence[str], division: Division | None = None) -> None:
    """Lock points, and the site's division, for as long as a connection to PostgreSQL lasts. Raises UsageError as
    `FileLocks` does.
    """
    from midspan.store.session import SILENT_S, STATEMENT_S

    if points:
        connection.silent_s = SILENT_S
        connection.execute(KEEP_ALIVE)
        connection.execute(f"SET statement_timeout = {round(1e3 * STATEMENT_S)}")
    for point in points:
        if not connection.execute("SELECT pg_try_advisory_lock(%s)", (lock_number(point),)).fetchone()[0]:
            raise _is_written(SERVER, point)
    if division is None:
        return
    site = lock_number(f"{SHARDS} {division.site}", 4)
    with connection.transaction():
        # One process after another looks.
        connection.execute("SELECT pg_advisory_xact_lock(%s)", (lock_number(SHARDS),))
        connection.execute("SELECT pg_advisory_lock_shared(%s, %s)", (site, division.count))
        other = connection.execute(DIVISIONS, (site % 2**32, division.count)).fetchone()
    if other is not None:
        raise division.other(SERVER, int(other[0]))


def lock_number(name: str, size: int = 8) -> int:
    """The number of an advisory lock by its name; size: 8 bytes, or 4 for one half of two."""
    return int.from_bytes(hashlib.blake2b(f"midspan {name}".encode(), digest_size=size).digest(), signed=True)


def _is_written(store: str, point: str) -> UsageError:
    """The error for a point that another process writes."""
    return UsageError(
        f"{store}: another process writes the point {point!r} (`midspan run` or `midspan replay`); nothing was "
        "changed. Stop that process first, or give another point or store."
    )
