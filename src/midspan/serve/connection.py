"""The web server and its connections: how many there are, and how long each may take."""

import asyncio
import socket
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from midspan.serve.limits import MAX_HEADER_BYTES

# A request is whole within this time, and what is answered is taken on within it, s.
REQUEST_S, TAKEN_S = 20.0, 60.0
# Connections at a time, of them from one address, and such that wait to be accepted: service managers give a process
# 1024 descriptors, and each connection may read files.
MAX_CONNECTIONS, MAX_OF_AN_ADDRESS, MAX_WAITING = 400, 200, 64
# The kernel keeps for a connection what its other end does not take; without a limit that is megabytes.
SEND_BUFFER_BYTES = 256 * 1024
# A message from a viewer, of which there are none of any use.
MAX_MESSAGE_BYTES = 4096
# A websocket's end is waited for so long, s.
CLOSE_S = 2.0


class Connection(H11Protocol):
    """uvicorn's, which itself has no time-out before a request is whole, nor for one that does not take its answer."""

    _deadline: asyncio.TimerHandle | None = None
    _taking: asyncio.TimerHandle | None = None
    _address: str = ""
    _of_addresses: ClassVar[Counter[str]] = Counter()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, or end it at once where there are too many."""
        super().connection_made(transport)
        bind = transport.get_extra_info("socket")
        bind.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        # Headers and content are two writes: with Nagle's algorithm the second one waits 40 ms for the other end's
        # acknowledgement. asyncio sets this only for sockets that were made for TCP by name.
        bind.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._address = self.client[0] if self.client else ""
        self._of_addresses[self._address] += 1
        if len(self.connections) > MAX_CONNECTIONS or self._of_addresses[self._address] > MAX_OF_AN_ADDRESS:
            transport.abort()
        self._await_request()

    def on_response_complete(self) -> None:
        """The next request has its time from now on."""
        super().on_response_complete()
        self._await_request()

    def pause_writing(self) -> None:
        """The other end does not take what it asked for: it has its time."""
        super().pause_writing()
        if self._taking is None:
            self._taking = self.loop.call_later(TAKEN_S, self.transport.abort)

    def resume_writing(self) -> None:
        """The other end took it."""
        super().resume_writing()
        if self._taking is not None:
            self._taking.cancel()
            self._taking = None

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the deadlines."""
        for timer in (self._deadline, self._taking):
            if timer is not None:
                timer.cancel()
        self._release()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """A websocket has no time by which it is whole."""
        super().handle_websocket_upgrade(event)
        if self._deadline is not None:
            self._deadline.cancel()
        self._release()

    def _release(self) -> None:
        if self._address:
            self._of_addresses[self._address] -= 1
            if self._of_addresses[self._address] <= 0:
                del self._of_addresses[self._address]
            self._address = ""

    def _await_request(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = self.loop.call_later(REQUEST_S, self._end_unless_answering)

    def _end_unless_answering(self) -> None:
        if self.cycle is None or self.cycle.response_complete or self.conn.their_state is h11.SEND_BODY:
            self.transport.abort()
        else:
            self._await_request()


class Viewing(WebSocketsSansIOProtocol):
    """uvicorn's, whose connection the application may end at once: `scope["midspan.abort"]`."""

    def handle_connect(self, event: Any) -> None:
        """Begin, unless there are too many connections."""
        if len(self.connections) > MAX_CONNECTIONS:
            self.transport.abort()
            return
        super().handle_connect(event)
        if hasattr(self, "scope"):
            self.scope["midspan.abort"] = self.transport.abort  # type: ignore[typeddict-unknown-key]

    def keepalive_timeout(self) -> None:
        """What does not answer does not take the end of the connection either."""
        super().keepalive_timeout()
        self.loop.call_later(CLOSE_S, self.transport.abort)


class Server(uvicorn.Server):
    """A web server whose end is its process's."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals to the process."""
        yield


def server(app: Any, *, tls_cert: Path | None = None, tls_key: Path | None = None) -> Server:
    """A web server for a socket that listens."""
    config = uvicorn.Config(
        app,
        http=Connection,
        ws=Viewing,
        ws_max_size=MAX_MESSAGE_BYTES,
        ws_per_message_deflate=False,
        h11_max_incomplete_event_size=MAX_HEADER_BYTES,
        backlog=MAX_WAITING,
        log_level="error",
        access_log=False,
        lifespan="off",
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=1,
        ssl_certfile=None if tls_cert is None else str(tls_cert),
        ssl_keyfile=None if tls_key is None else str(tls_key),
    )
    return Server(config)
