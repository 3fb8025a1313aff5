"""Sources: how each stream stands, its picture, pauses."""

from typing import Annotated

from fastapi import APIRouter, Response
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from midspan.serve.login import Guard
from midspan.serve.points import Done
from midspan.serve.problems import Problem, declared
from midspan.serve.serving import Serving
from midspan.service.live_socket import Tree


class SourceState(BaseModel):
    """How a stream stands; `name` is POINT.KIND, or of several of a kind POINT.NAME."""

    name: str
    point: str
    source: str
    reason: str = Field(description="a reason code; empty where all is well")
    text: str
    age_s: float | None
    records: int
    faults: int
    skipped: int
    stamps: str
    address: str
    rate_hz: float | None = Field(None, description="records (frames, or blocks of values) a second")


class Pause(BaseModel):
    """Why a source is paused, as everybody sees it."""

    model_config = ConfigDict(extra="forbid")
    reason: Annotated[str, StringConstraints(min_length=1, max_length=200)]


def router(serving: Serving, guard: Guard) -> APIRouter:
    """The routes of sources."""
    routes = APIRouter(prefix="/sources", tags=["sources"])
    read, operate = [guard.require("read")], [guard.require("operate")]
    commanded = declared(401, 403, 404, 409, 413, 415, 422)

    def known() -> list[Tree]:
        points = serving.link.state.get("points", [])
        return [{**source, "name": f"{one['point']}.{source['source']}"} for one in points for source in one["sources"]]

    def require(name: str) -> None:
        if name not in [one["name"] for one in known()]:
            raise Problem(404, f"{name}: is no source of this site. GET /api/v1/sources names them, as POINT.KIND.")

    @routes.get("", response_model=list[SourceState], dependencies=read, responses=declared(401, 403))
    async def sources() -> list[Tree]:
        """All streams of the site; none where no process measures."""
        return known()

    @routes.get(
        "/{name}/picture",
        dependencies=read,
        response_class=Response,
        responses={
            **declared(401, 403, 404, 409, 422),
            200: {"content": {"image/jpeg": {"schema": {"type": "string", "format": "binary"}}}},
        },
    )
    async def picture(name: str) -> Response:
        """A camera's next frame, whole."""
        require(name)
        answer, body = await serving.link.ask("picture", source=name)
        headers = {key: str(answer[value]) for key, value in PICTURE_HEADERS.items() if value in answer}
        return Response(body, media_type="image/jpeg", headers=headers)

    @routes.post("/{name}/pause", response_model=Done, dependencies=operate, responses=commanded)
    async def pause(name: str, wanted: Pause) -> Done:
        """Leave a source out, with a reason: what it brings is not used, and that it is away is no fault."""
        require(name)
        answer, _ = await serving.link.ask("pause", source=name, reason=wanted.reason)
        return Done(text=str(answer["text"]))

    @routes.post("/{name}/resume", response_model=Done, dependencies=operate, responses=commanded)
    async def resume(name: str) -> Done:
        """Use a paused source again."""
        require(name)
        answer, _ = await serving.link.ask("resume", source=name)
        return Done(text=str(answer["text"]))

    return routes


PICTURE_HEADERS = {"X-Midspan-Time": "time_ns", "X-Midspan-Width": "width", "X-Midspan-Height": "height"}
"""Of a picture: when it was taken (ns UTC), and the size of the frame, which regions count in, px."""
