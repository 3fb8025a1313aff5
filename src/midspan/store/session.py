"""A session with a PostgreSQL server that ends where nothing is heard of the server any more."""

import time
from collections.abc import Generator
from typing import Any

import psycopg

# A statement of the writer is ended by the server after this time, s; a server that hangs ends nothing: a writer's
# session that hears nothing for longer than that ends itself, and any other one after MAX_SILENT_S.
STATEMENT_S, SILENT_S, MAX_SILENT_S = 30.0, 40.0, 600.0
# What is sent over a line that is cut is given up after 25 s, as is a line on which nothing is sent.
LINE: dict[str, Any] = {
    "keepalives": 1, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3, "tcp_user_timeout": 25_000,
}  # fmt: skip


class Session(psycopg.Connection[Any]):
    """A connection that raises OperationalError, and is closed, after `silent_s` without an answer."""

    silent_s = MAX_SILENT_S

    def wait(self, gen: Generator[Any, Any, Any], *arguments: Any, **options: Any) -> Any:
        """See `psycopg.Connection.wait`."""
        return super().wait(self._heard(gen), *arguments, **options)

    def _heard(self, gen: Generator[Any, Any, Any]) -> Generator[Any, Any, Any]:
        heard_s = time.monotonic()
        try:
            wanted = next(gen)
            while True:
                ready = yield wanted
                if ready:
                    heard_s = time.monotonic()
                elif time.monotonic() - heard_s > self.silent_s:
                    # Nothing is sent any more: neither the end of a transaction nor that of a copy.
                    self.pgconn.finish()
                    raise psycopg.OperationalError(f"the server has not answered for {self.silent_s:.0f} s")
                wanted = gen.send(ready)
        except StopIteration as done:
            return done.value
