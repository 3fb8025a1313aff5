"""/healthz, /readyz and /metrics."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

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


def server(app: Any, listen: str) -> Any:
    """A web server for `host:port` that leaves signals alone."""
    import uvicorn

    host, _, port = listen.rpartition(":")
    config = uvicorn.Config(
        app, host=host.strip("[]"), port=int(port), log_level="warning", access_log=False, lifespan="off"
    )

    class Server(uvicorn.Server):
        """One whose end is the service's."""

        @contextmanager
        def capture_signals(self) -> Iterator[None]:
            """Leave the signals to the service."""
            yield

    return Server(config)
