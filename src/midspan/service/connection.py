"""One HTTP connection: ended where there are too many, and where no whole request comes."""

import asyncio

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

# A request is whole within this time, s.
REQUEST_S = 20.0
# Connections at a time, and such that wait to be accepted: they take descriptors from store, cameras and captures, and
# service managers give a process 1024.
MAX_CONNECTIONS, MAX_WAITING = 100, 16


class Connection(H11Protocol):
    """uvicorn's, which itself has no time-out before a request is whole."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, or end it at once where there are MAX_CONNECTIONS."""
        super().connection_made(transport)
        if len(self.connections) > MAX_CONNECTIONS:
            transport.abort()
        self._await_request()

    def on_response_complete(self) -> None:
        """The next request has its time from now on."""
        super().on_response_complete()
        self._await_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the deadline."""
        if self._deadline is not None:
            self._deadline.cancel()
        super().connection_lost(exc)

    def _await_request(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = self.loop.call_later(REQUEST_S, self._end_unless_answering)

    def _end_unless_answering(self) -> None:
        if self.cycle is None or self.cycle.response_complete or self.conn.their_state is h11.SEND_BODY:
            self.transport.abort()
        else:
            self._await_request()
