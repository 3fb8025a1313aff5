"""Writes batches to the store, one after another; while it is away they wait, up to a bound."""

import threading
from collections import deque
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from midspan.errors import MidspanError
from midspan.store.database import Division, StoreFault
from midspan.store.store import Batch, Store, is_address, open_store
from midspan.store.upkeep import take_over_left

# Held back at most, in batches of a point and second: an hour of five points. Of groups this many rows are as much.
MAX_WAITING, GROUP_ROWS = 18_000, 500
# Displacement, deviation and velocity of a row.
ROW_BYTES = 24


def written_bytes() -> int | None:
    """What this process has written to disks so far, as the kernel counts it; None where it does not."""
    try:
        lines = Path("/proc/self/io").read_text().splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) for line in lines if line.startswith("write_bytes")), None)


def weight(batch: Batch) -> int:
    """What a batch that waits counts for."""
    rows = sum(len(one.rows.std_m) for one in batch.groups)
    state_bytes = sum(len(one.checkpoint[1]) for one in batch.groups if one.checkpoint is not None)
    return 1 + (rows + state_bytes // ROW_BYTES) // GROUP_ROWS


class Keeper:
    """`put` never waits; `write` writes what waits. Whoever uses the store waits for the thread that does so already: a
    connection of SQLite that is closed in the middle of a statement of another thread ends the process.

    points: that it writes, locked as long as the store is open, as is the site's division. reason: why the store is
    away, empty while it takes everything; dropped: batches that were lost.
    """

    def __init__(self, where: str, points: Sequence[str] = (), division: Division | None = None) -> None:
        self._where, self._points, self._division = where, points, division
        self._store: Store | None = None
        self._waiting: deque[Batch] = deque()
        self._weight, self._counting = 0, threading.Lock()
        self._in_use = threading.RLock()
        self.reason, self.text, self.dropped = "", "", 0

    @property
    def waiting(self) -> int:
        """How many batches wait."""
        return len(self._waiting)

    def put(self, batch: Batch) -> None:
        """Queue a batch; of too many the oldest is lost, and counted."""
        if not (batch.chunks or batch.events or batch.checkpoints or batch.groups):
            return
        with self._counting:
            self._waiting.append(batch)
            self._weight += weight(batch)
            while self._weight > MAX_WAITING and len(self._waiting) > 1:
                self._weight -= weight(self._waiting.popleft())
                self.dropped += 1

    def store(self) -> Store:
        """The open store. Raises StoreFault, and UsageError as `open_store` does."""
        if self._store is None:
            self._store = open_store(self._where, points=self._points, division=self._division)
            if self._division is not None:
                take_over_left(self._where, self._division)
        return self._store

    def lock(self, points: Sequence[str]) -> None:
        """Lock these points in place of those before. Raises UsageError for one that another process writes, with
        which the ones before stay; where the store is away they are locked once it is back.
        """
        with self._in_use:
            before, self._points = self._points, points
            self.write()
            # Its own locks would be in the way.
            self._close()
            try:
                self.store()
            except StoreFault as fault:
                self.reason, self.text = fault.code, str(fault)
            except MidspanError:
                self._points = before
                raise

    def write(self) -> None:
        """Write all that waits, oldest first; where the store is away it is tried again the next time."""
        with self._in_use:
            try:
                self._write()
            except StoreFault as fault:
                self.reason, self.text = fault.code, str(fault)
                self._close()
            except MidspanError as error:
                self.reason, self.text = "store_unavailable", str(error)
                self._close()

    def require(self) -> None:
        """Write all that waits. Raises StoreFault where the store is away."""
        self.write()
        if self.reason:
            raise StoreFault(self.reason, self.text)

    def forget_before(self, time_ns: int) -> None:
        """Remove the days before a time, where the store can be used; of a server in a session of its own: it may take
        longer than rows may wait.
        """
        try:
            if is_address(self._where):
                with closing(open_store(self._where)) as store:
                    store.forget_before(time_ns)
            else:
                with self._in_use:
                    self.store().forget_before(time_ns)
        except MidspanError as error:
            self.text = str(error)

    def close(self) -> None:
        """Write what waits and let the store go."""
        with self._in_use:
            try:
                self.write()
            finally:
                self._close()

    def _write(self) -> None:
        store = self.store()
        while self._waiting:
            batch = self._waiting[0]
            store.write(batch)
            # Of too many `put` may have dropped it meanwhile.
            with self._counting:
                if self._waiting and self._waiting[0] is batch:
                    self._waiting.popleft()
                    self._weight -= weight(batch)
        self.reason = self.text = ""

    def _close(self) -> None:
        if self._store is not None:
            self._store.close()
            self._store = None
