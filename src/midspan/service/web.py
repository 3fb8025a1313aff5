"""/healthz, /readyz and /metrics."""

import os
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

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


def server(app: Any) -> Any:
    """A web server for a socket of `listening` that leaves signals alone."""
    import uvicorn

    from midspan.service.connection import MAX_WAITING, Connection

    config = uvicorn.Config(
        app, http=Connection, backlog=MAX_WAITING, log_level="warning", access_log=False, lifespan="off"
    )

    class Server(uvicorn.Server):
        """One whose end is the service's."""

        @contextmanager
        def capture_signals(self) -> Iterator[None]:
            """Leave the signals to the service."""
            yield

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
    of_a_point = "0 tracking, 1 coasting, 2 lost, 3 warming, 4 calibrating."
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
