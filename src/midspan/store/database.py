"""SQLite files and PostgreSQL behind one interface: SQL with `?` for values, `{blob}` for the type of bytes."""

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from midspan.errors import DataError, MidspanError

# A reader waits so long for a writer's transaction, and a network connection for its server.
WAIT_S = 5.0

Row = tuple[Any, ...]


class StoreFault(MidspanError):
    """The store does not take or give anything at present: `code` is a reason code of the documentation's table."""

    exit_code = 3

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code


class Database(Protocol):
    """One SQLite file or one PostgreSQL database; used by one thread at a time."""

    def execute(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """Run one statement; returns its rows. Raises StoreFault."""
        ...

    def transaction(self) -> Any:
        """A block whose statements take effect together, or not at all."""
        ...

    def close(self) -> None:
        """Let the file or the connection go."""
        ...


class SqliteDatabase:
    """A file in WAL mode: readers and the writer do not wait for each other.

    synchronous = FULL: a transaction that has returned outlives a power cut.
    """

    def __init__(self, file: Path, *, read_only: bool = False) -> None:
        self.file = file
        with sqlite_faults(file):
            if read_only:
                self._connection = sqlite3.connect(
                    f"{file.resolve().as_uri()}?mode=ro", uri=True, timeout=WAIT_S, isolation_level=None,
                    check_same_thread=False,
                )  # fmt: skip
                return
            file.parent.mkdir(parents=True, exist_ok=True)
            self._connection = sqlite3.connect(file, timeout=WAIT_S, isolation_level=None, check_same_thread=False)
            self._connection.execute("PRAGMA journal_mode = WAL")
            self._connection.execute("PRAGMA synchronous = FULL")

    def execute(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """Run one statement; returns its rows."""
        with sqlite_faults(self.file):
            return self._connection.execute(sql.replace("{blob}", "BLOB"), values).fetchall()

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


@contextmanager
def sqlite_faults(file: Path) -> Iterator[None]:
    """What goes wrong with a file of the store, as StoreFault or DataError."""
    try:
        yield
    except sqlite3.OperationalError as error:
        code = "store_full" if "full" in str(error) else "store_unavailable"
        raise StoreFault(code, f"{file}: the store cannot be used ({error}).") from None
    except OSError as error:
        raise StoreFault("store_unavailable", f"{file}: the store cannot be used ({error.strerror}).") from None
    except sqlite3.DatabaseError as error:
        raise DataError(f"{file}: is no store of midspan, or is damaged ({error}).") from None


class PostgresDatabase:
    """A database of a PostgreSQL server; a lost connection is opened again by the next statement.

    begin: called with each connection before it is used; what it raises closes that connection.
    """

    def __init__(self, url: str, begin: Callable[[Any], None] = lambda _: None) -> None:
        self._url, self._begin = url, begin
        self._connection: Any = None
        self._opened()

    def execute(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        """Run one statement; returns its rows."""
        import psycopg

        text = sql.replace("{blob}", "BYTEA").replace("?", "%s")
        try:
            with self._opened().cursor() as cursor:
                cursor.execute(text, tuple(values))
                return cursor.fetchall() if cursor.description else []
        except psycopg.OperationalError as error:
            self.close()
            raise _unavailable(error) from None

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """A block whose statements take effect together, or not at all."""
        import psycopg

        try:
            with self._opened().transaction():
                yield
        except psycopg.OperationalError as error:
            self.close()
            raise _unavailable(error) from None

    def close(self) -> None:
        """Let the connection go."""
        if self._connection is not None:
            with suppress(Exception):
                self._connection.close()
        self._connection = None

    def _opened(self) -> Any:
        import psycopg

        if self._connection is None or self._connection.closed:
            try:
                connection = psycopg.connect(self._url, autocommit=True, connect_timeout=round(WAIT_S))
            except psycopg.OperationalError as error:
                raise _unavailable(error) from None
            try:
                self._begin(connection)
            except BaseException as error:
                connection.close()
                if isinstance(error, psycopg.OperationalError):
                    raise _unavailable(error) from None
                raise
            self._connection = connection
        return self._connection


def _unavailable(error: Exception) -> StoreFault:
    # The first line says what; the address stays out, it may hold a password.
    line = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    code = "store_full" if "No space left" in line else "store_unavailable"
    return StoreFault(code, f"PostgreSQL: the store cannot be used ({line}).")
