"""The websocket `/live`: rows as they come."""

import asyncio
import re
from contextlib import suppress
from urllib.parse import urlsplit

from fastapi import APIRouter, WebSocket
from starlette.websockets import WebSocketDisconnect, WebSocketState

from midspan.serve.connection import CLOSE_S
from midspan.serve.login import login_of
from midspan.serve.problems import Problem, answer
from midspan.serve.serving import Serving, Shared
from midspan.serve.viewers import STALLED, TRY_AGAIN, Viewer

# Points that a viewer names at most, and viewers.
MAX_NAMED, MAX_VIEWERS = 1000, 200
# Whether a viewer may still read is looked up so often, s.
CHECK_S = 2.0
NO_LONGER = 1008


routes = APIRouter()


@routes.websocket("/live")
async def live(socket: WebSocket, serving: Shared) -> None:
    """Numbered messages; `points` names points, `after` the newest sequence that a viewer has, `head=true` asks for
    provisional rows, too.
    """
    try:
        require_own_origin(socket)
        login_of(socket)
        points, after = await wanted(serving, socket)
        if serving.live.viewers >= MAX_VIEWERS:
            raise Problem(503, f"The limit of {MAX_VIEWERS} viewers is reached. Try again later.")
    except Problem as problem:
        await socket.send_denial_response(answer(problem.status_code, problem.detail, problem.headers))
        return
    await socket.accept()
    viewer = serving.live.enter(points, after, head=socket.query_params.get("head") == "true")
    try:
        await shown(socket, viewer, serving)
    finally:
        serving.live.leave(viewer)


def require_own_origin(socket: WebSocket) -> None:
    """Raises Problem 403 for the page of another host: browsers send their cookies along with its websockets."""
    origin = socket.headers.get("origin")
    if origin is not None and urlsplit(origin).netloc != socket.headers.get("host"):
        raise Problem(403, f"Origin: must be this server's own; received {origin[:80]!r}.")


async def wanted(serving: Serving, socket: WebSocket) -> tuple[frozenset[str] | None, int | None]:
    """The points of a viewer, None for all, and the sequence number after which it goes on. Raises Problem."""
    after = socket.query_params.get("after")
    if after is not None and not re.fullmatch(r"\d{1,18}", after, re.ASCII):
        raise Problem(422, f"after: must be the sequence number of a message; received {after[:40]!r}.")
    named = socket.query_params.get("points")
    if not named:
        return None, None if after is None else int(after)
    names = named.split(",")
    if len(names) > MAX_NAMED:
        raise Problem(422, f"points: must name at most {MAX_NAMED}; received {len(names)}.")
    points = frozenset(names)
    for point in points:
        await serving.require_point(point)
    return points, None if after is None else int(after)


async def shown(socket: WebSocket, viewer: Viewer, serving: Serving) -> None:
    """Send what comes until the viewer leaves, is dropped, or may no longer read."""
    sending = asyncio.create_task(_send(socket, viewer))
    listening = asyncio.create_task(_listen(socket))
    checking = asyncio.create_task(_check(socket))
    dropping = asyncio.create_task(viewer.dropped.wait())
    tasks = (sending, listening, checking, dropping)
    done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    if listening in done or socket.client_state is WebSocketState.DISCONNECTED:
        return
    code, why = (NO_LONGER, "the login is over") if checking in done else (TRY_AGAIN, STALLED)
    # A viewer that takes nothing does not take the reason either: its connection ends all the same.
    with suppress(Exception):
        await asyncio.wait_for(socket.close(code, why), CLOSE_S)
        await asyncio.sleep(CLOSE_S)
    socket.scope["midspan.abort"]()


async def _send(socket: WebSocket, viewer: Viewer) -> None:
    while (text := await viewer.next()) is not None:
        await socket.send_text(text)


async def _listen(socket: WebSocket) -> None:
    """What a viewer sends is not read for anything; its leaving is."""
    with suppress(WebSocketDisconnect, RuntimeError):
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass


async def _check(socket: WebSocket) -> None:
    with suppress(Problem):
        while True:
            await asyncio.sleep(CHECK_S)
            login_of(socket)
