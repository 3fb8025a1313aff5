"""/healthz, /readyz and /metrics, their server and its connections; the messages to systemd."""

import asyncio
import os
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from midspan.engine.point import PointStatus
from midspan.errors import UsageError
from midspan.service.keeping import Keeper
from midspan.service.running import Running
from midspan.settings.site import Site

Standing = dict[str, Any]
"""{"ready": bool, "sources": [{"source", "reason", "text"}, …]} and figures by name."""


def application(standing: Callable[[], Standing], figures: Callable[[], str]) -> Any:
    """The web application; `standing` and `figures` are called for each request."""
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import JSONResponse, PlainTextResponse
    from starlette.routing import Route

    async def healthz(request: Request) -> PlainTextResponse:
        return PlainTextResponse("ok\n")

    async def readyz(request: Request) -> JSONResponse:
        now = standing()
        return JSONResponse(now, status_code=200 if now["ready"] else 503)

    async def metrics(request: Request) -> PlainTextResponse:
        return PlainTextResponse(figures(), media_type="text/plain; version=0.0.4")

    return Starlette(routes=[Route("/healthz", healthz), Route("/readyz", readyz), Route("/metrics", metrics)])


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


def listening(site: Site) -> socket.socket:
    """A socket that listens where the site's file says. Raises UsageError where it cannot."""
    listen = site.settings.service.listen
    host, _, port = listen.rpartition(":")
    host = host.strip("[]")
    try:
        return socket.create_server((host, int(port)), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        why = error.strerror if isinstance(error, socket.gaierror) else os.strerror(error.errno or 0)
        raise UsageError(
            f"{site.file}: service.listen: {listen} cannot be listened on ({why}). Stop the program that "
            "listens there, or write another address or port."
        ) from None


class Server(uvicorn.Server):
    """A web server whose end is the service's."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals to the service."""
        yield


def server(app: Any) -> Server:
    """A web server for a socket of `listening` that leaves signals alone."""
    config = uvicorn.Config(
        app, http=Connection, backlog=MAX_WAITING, log_level="warning", access_log=False, lifespan="off"
    )

    return Server(config)


COUNTS = {
    "records": "Records that came.",
    "faults": "Records that could not be used.",
    "skipped": "Frames that were skipped because the engine did not keep up.",
}


def figures(points: Iterable[Running], keeper: Keeper, now_s: float) -> str:
    """The text of /metrics."""
    from prometheus_client import CollectorRegistry, Gauge, generate_latest

    registry = CollectorRegistry()
    labels = ["point", "source"]
    counts = {key: Gauge(f"midspan_source_{key}", text, labels, registry=registry) for key, text in COUNTS.items()}
    age = Gauge("midspan_source_age_seconds", "Time since the newest record.", labels, registry=registry)
    of_a_point = f"{', '.join(f'{one.value} {one.name.lower()}' for one in PointStatus)}."
    status = Gauge("midspan_point_status", of_a_point, ["point"], registry=registry)
    for one in points:
        status.labels(one.name).set(int(one.live.status))
        for name, stream in one.streams.items():
            for key, gauge in counts.items():
                gauge.labels(one.name, name).set(getattr(stream, key))
            if stream.heard_s is not None:
                age.labels(one.name, name).set(now_s - stream.heard_s)
    waiting = Gauge("midspan_store_waiting", "Batches that wait for the store.", registry=registry)
    waiting.set(keeper.waiting)
    Gauge("midspan_store_dropped", "Batches that were lost.", registry=registry).set(keeper.dropped)
    return str(generate_latest(registry).decode())


def notify(text: str) -> None:
    """Send a line such as READY=1, WATCHDOG=1 or STOPPING=1 to systemd's socket in NOTIFY_SOCKET, if any."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    # An abstract address begins with @.
    name = f"\0{address[1:]}" if address.startswith("@") else address
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
        out.settimeout(1.0)
        out.sendto(text.encode(), name)
