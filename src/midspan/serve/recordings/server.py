"""The server of `midspan open`: on loopback, for one person, until it is stopped."""

import asyncio
import logging
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from midspan.serve import login
from midspan.serve.application import page_over
from midspan.serve.connection import server
from midspan.serve.limits import Limits
from midspan.serve.problems import answer
from midspan.serve.recordings.desk import Desk
from midspan.serve.recordings.routes import files, links, routes

# What a browser calls this machine. A page of another host that lets its name lead here (DNS rebinding) gets no answer.
OWN_NAMES = frozenset({"127.0.0.1", "localhost", "[::1]"})
# What runs is ended within this time, s.
END_S = 3.0


class OwnHost:
    """An application that answers only requests for this machine by its own names."""

    def __init__(self, app: Any) -> None:
        self._app = app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """An ASGI call."""
        if scope["type"] == "http":
            host = dict(scope["headers"]).get(b"host", b"").decode("latin-1")
            name = host if host.endswith("]") else host.rpartition(":")[0] or host
            if name.lower() not in OWN_NAMES:
                problem = answer(403, f"Host: must be 127.0.0.1 or localhost; received {host[:80]!r}.")
                await problem(scope, receive, send)
                return
        await self._app(scope, receive, send)


def application(desk: Desk) -> Any:
    """The ASGI application over recordings."""
    app = page_over(desk, [login.routes, links, routes])
    app.include_router(files)
    return OwnHost(Limits(app))


async def opened(desk: Desk, listener: socket.socket, ending: asyncio.Event, ready: Callable[[], None]) -> None:
    """Serve until `ending` is set; ready: called once requests are answered."""
    web = server(application(desk))
    serving = asyncio.create_task(web.serve(sockets=[listener]))
    stopping = asyncio.create_task(ending.wait())
    try:
        while not (web.started or serving.done()):
            await asyncio.sleep(0.01)
        ready()
        await asyncio.wait({stopping, serving}, return_when=asyncio.FIRST_COMPLETED)
        # What is cut off by the end is no fault.
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
        web.should_exit = True
        with suppress(TimeoutError):
            await asyncio.wait_for(serving, END_S)
    finally:
        stopping.cancel()
        await desk.close()
