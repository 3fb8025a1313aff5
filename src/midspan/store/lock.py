"""One process at a time writes a point of a store: locks that end with their process, however it ends."""

import hashlib
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

from midspan.errors import UsageError
from midspan.store.database import sqlite_faults

LOCKS = "locks"
# A server that hears nothing of a client's machine for 25 s ends its session, which lets its points go.
KEEP_ALIVE = "SET tcp_keepalives_idle = 10; SET tcp_keepalives_interval = 5; SET tcp_keepalives_count = 3"


class FileLocks:
    """Locks of points on files in the store's folder. Raises UsageError for a point that another process writes."""

    def __init__(self, folder: Path, points: Sequence[str]) -> None:
        self._files = ExitStack()
        with ExitStack() as undone:
            undone.callback(self.close)
            for point in points:
                file = folder / LOCKS / f"{point}.lock"
                with sqlite_faults(file):
                    file.parent.mkdir(parents=True, exist_ok=True)
                    if not _locked(self._files.enter_context(file.open("ab"))):
                        raise is_written(str(folder), point)
            undone.pop_all()

    def close(self) -> None:
        """Let the points go."""
        self._files.close()


def _locked(file: IO[bytes]) -> bool:
    """Lock a file until it is closed; whether nobody else has. Where a system has no such locks, nobody has."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def lock_in_session(connection: Any, points: Sequence[str]) -> None:
    """Lock points for as long as a connection to PostgreSQL lasts. Raises UsageError as `FileLocks` does."""
    if points:
        connection.execute(KEEP_ALIVE)
    for point in points:
        # Advisory locks are 64-bit numbers.
        number = int.from_bytes(hashlib.blake2b(f"midspan {point}".encode(), digest_size=8).digest(), signed=True)
        if not connection.execute("SELECT pg_try_advisory_lock(%s)", (number,)).fetchone()[0]:
            raise is_written("the PostgreSQL store", point)


def is_written(store: str, point: str) -> UsageError:
    """The error for a point that another process writes."""
    return UsageError(
        f"{store}: another process writes the point {point!r} (`midspan run` or `midspan replay`); nothing was "
        "touched. Stop that one first, or give another point or store."
    )
