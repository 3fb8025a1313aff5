"""Sources: how each stream stands, its picture, pauses."""

import asyncio
import json
import time
from typing import Annotated

from fastapi import APIRouter, Response
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from midspan.serve.login import OPERATE, READ
from midspan.serve.points import Done
from midspan.serve.problems import Problem, declared
from midspan.serve.serving import Serving, Shared
from midspan.service.live_socket import Tree

# A picture is shown to all who ask within this time, s.
PICTURE_S = 0.5


class SourceState(BaseModel):
    """How a stream stands; `name` is POINT.KIND, or of several of a kind POINT.NAME."""

    name: str
    point: str
    source: str
    reason: str = Field(description="reason code; empty: no fault")
    text: str
    age_s: float | None
    records: int
    faults: int
    skipped: int
    stamps: str
    address: str
    rate_hz: float | None = Field(None, description="frames or values per second, from the newest time stamps")
    nominal_rate_hz: float | None = Field(None, description="rate in the calibration recording of the point")
    delay_s: float | None = Field(None, description="mean delay of records after their time stamp, s")
    late: int | None = Field(None, description="rejected values and frames: late, out of order or repeated")
    restarts: int | None = Field(None, description="number of reconnections to the source")
    clock_offset_s: float | None = Field(
        None,
        description="clock offset, added to its stamps to get the accelerometer's clock: calibrated, then tracked, s",
    )
    clock_offset_std_s: float | None = Field(None, description="standard deviation of the clock offset, s")
    clock_drift_ppm: float | None = Field(None, description="estimated clock drift, ppm")


class Pause(BaseModel):
    """Why a source is paused, as everybody sees it."""

    model_config = ConfigDict(extra="forbid")
    reason: Annotated[str, StringConstraints(min_length=1, max_length=200)]


class ProfileTarget(BaseModel):
    """A target of a radar, as it was calibrated."""

    bin: float
    range_m: float | None
    snr_db: float


class ProfileBody(BaseModel):
    """The newest range profile of a radar, the mean of its channels."""

    time_ns: int
    range_m: list[float] | None = Field(description="of each bin; null where it is not known")
    magnitude_db: list[float] = Field(description="of each bin, relative to the strongest one")
    targets: list[ProfileTarget]


PICTURE_HEADERS = {
    "X-Midspan-Time": "time_ns", "X-Midspan-Width": "width", "X-Midspan-Height": "height",
    "X-Midspan-Low": "low", "X-Midspan-High": "high", "X-Midspan-Unit": "unit",
    "X-Midspan-Targets": "targets",
}  # fmt: skip
"""Of a picture: when it was taken (ns UTC), the size of the frame, which regions count in, px, and what black and white
stand for where they are no grey levels: degC, or counts. Targets as JSON: `roi` in the reference frame, `x_px`, `y_px`
by which it has moved, null where it is lost, `quality` from 0 to 1, `matches` of a tracker that counts them.
"""


def pictured(about: Tree, jpeg: bytes) -> Response:
    """A picture as an answer, with those headers that something is known for."""
    found = {key: about.get(value) for key, value in PICTURE_HEADERS.items()}
    texts = {key: json.dumps(value) if isinstance(value, list) else value for key, value in found.items()}
    headers = {key: str(value) for key, value in texts.items() if value not in (None, "")}
    return Response(jpeg, media_type="image/jpeg", headers=headers)


routes = APIRouter(prefix="/sources", tags=["sources"])
COMMANDED = declared(401, 403, 404, 409, 413, 415, 422)
SHOWN = declared(401, 403, 404, 409, 422)


def known(serving: Serving) -> list[Tree]:
    """The streams of the newest state, with their names."""
    points = serving.link.state.get("points", [])
    return [{**source, "name": f"{one['point']}.{source['source']}"} for one in points for source in one["sources"]]


def require_source(serving: Serving, name: str) -> Tree:
    """The newest state of a stream. Raises Problem for a name that is no source's."""
    found = next((one for one in known(serving) if one["name"] == name), None)
    if found is None:
        raise Problem(404, f"{name}: is not a source of this site. GET /api/v1/sources lists them as POINT.KIND.")
    return found


@routes.get("", response_model=list[SourceState], dependencies=READ, responses=declared(401, 403))
async def sources(serving: Shared) -> list[Tree]:
    """All streams of the site; none where no process measures."""
    return known(serving)


@routes.get(
    "/{name}/picture", dependencies=READ, response_class=Response,
    responses={
        **SHOWN,
        200: {"content": {"image/jpeg": {"schema": {"type": "string", "format": "binary"}}}},
    },
)  # fmt: skip
async def picture(name: str, serving: Shared) -> Response:
    """A camera's newest frame, whole; there are two a second at most."""
    answer, body = await newest(serving, name, "picture")
    return pictured(answer, body)


@routes.get("/{name}/profile", response_model=ProfileBody, dependencies=READ, responses=SHOWN)
async def profile(name: str, serving: Shared) -> Tree:
    """A radar's newest range profile with its targets; there are two a second at most."""
    return (await newest(serving, name, "profile"))[0]


async def newest(serving: Serving, name: str, command: str) -> tuple[Tree, bytes]:
    """What the engine shows of a source, shared by all who ask at the time. Raises Problem."""
    address = require_source(serving, name)["address"]
    async with serving.looking.setdefault(name, asyncio.Lock()):
        taken_s, answer, body = serving.pictures.get(name, (-PICTURE_S, {}, b""))
        # Of a source there is a picture or a profile; what the other one's command says is not kept.
        if time.monotonic() - taken_s > PICTURE_S or answer.get("command") != command:
            found, body = await serving.link.ask(command, source=name)
            answer = {**found, "command": command, "address": address}
            serving.pictures[name] = (time.monotonic(), answer, body)
    return answer, body


@routes.post("/{name}/pause", response_model=Done, dependencies=OPERATE, responses=COMMANDED)
async def pause(name: str, wanted: Pause, serving: Shared) -> Done:
    """Leave a source out, with a reason: what it brings is not used, and that it is away is no fault."""
    require_source(serving, name)
    answer, _ = await serving.link.ask("pause", source=name, reason=wanted.reason)
    return Done(text=str(answer["text"]))


@routes.post("/{name}/resume", response_model=Done, dependencies=OPERATE, responses=COMMANDED)
async def resume(name: str, serving: Shared) -> Done:
    """Use a paused source again."""
    require_source(serving, name)
    answer, _ = await serving.link.ask("resume", source=name)
    return Done(text=str(answer["text"]))
