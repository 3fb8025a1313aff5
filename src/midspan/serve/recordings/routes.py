"""The interface over recordings, below /api/v1/recordings: look, settings, calibrate, estimate, traces, files."""

import stat
import tempfile
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.responses import FileResponse, JSONResponse, PlainTextResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.background import BackgroundTask

from midspan.checks import option
from midspan.fusion.methods import METHODS
from midspan.serve.login import ADMIN
from midspan.serve.points import FILES, Done, Format, SpectrumBody
from midspan.serve.problems import Problem, declared
from midspan.serve.reading import MAX_BUCKETS
from midspan.serve.recordings import reading
from midspan.serve.recordings.desk import Desk, desk_of
from midspan.serve.recordings.tickets import Ticket
from midspan.serve.settings_file import TEXT, on_trial, require_unchanged, tag_of, text_of
from midspan.serve.sources import pictured
from midspan.settings.stored.calibration import CALIBRATION_FILE
from midspan.vision.tracker import TRACKERS
from midspan.writing import write_whole

Tree = dict[str, Any]
# Looking at the first frames of a film from a slow disk, and writing a day's rows as a workbook, take this long, s.
LOOK_S, FILE_S = 300.0, 900.0
# A report brings scripts and styles in itself; it gets an origin of its own, which has no access to this page.
REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data:; font-src data:; form-action 'none'; frame-ancestors 'none'"
)
Trace = Literal["result", "across", "reference", "error"]
# Whole ns of 64 bits reach from 1685 to 2255.
Second = Annotated[float, Query(ge=-9e9, le=9e9, allow_inf_nan=False, description="s on the accelerometer's clock")]


class Link(BaseModel):
    """The secret of a link that was printed."""

    model_config = ConfigDict(extra="forbid")
    link: str = Field(min_length=1, max_length=100)


class Token(BaseModel):
    """What is sent as `Authorization: Bearer` from now on."""

    token: str


class Recordings(BaseModel):
    """The recordings that were opened, and what they can be estimated with."""

    recordings: list[dict[str, Any]]
    methods: list[str]
    trackers: list[str]


class Wanted(BaseModel):
    """How a recording is estimated. calibration: with its calibration.json; else it is calibrated first."""

    model_config = ConfigDict(extra="forbid")
    calibration: bool = False
    method: str | None = Field(None, max_length=40)
    tracker: str | None = Field(None, max_length=40)


class FileWanted(BaseModel):
    """Which file is wanted: the report, or the result in a format."""

    model_config = ConfigDict(extra="forbid")
    format: Literal["report"] | Format


class Address(BaseModel):
    """Where a file is, once, within a minute."""

    path: str


Opened = Annotated[Desk, Depends(desk_of)]
links = APIRouter(tags=["access"])
files = APIRouter(include_in_schema=False)
routes = APIRouter(prefix="/recordings", tags=["recordings"], dependencies=ADMIN)
SEEN = declared(401, 403, 404, 422)
COMMANDED = declared(401, 403, 404, 409, 413, 415, 422)


@links.post("/link", response_model=Token, responses=declared(401, 413, 415, 422))
async def change_link(given: Link, desk: Opened) -> Token:
    """Change a link for a token."""
    token = desk.access.changed(given.link)
    if token is None:
        raise Problem(401, f"This link has been used. {desk.access.how}", code=desk.access.code)
    return Token(token=token)


@files.get("/files/{number}")
async def file(number: str, desk: Opened) -> FileResponse:
    """A file, for whoever has its ticket."""
    ticket = desk.tickets.take(number)
    if ticket is None or not ticket.file.is_file():
        raise Problem(404, "This download link was used or has expired. Request the file on the page again.")
    headers = {} if ticket.name else {"Content-Security-Policy": REPORT_POLICY}
    after = BackgroundTask(ticket.file.unlink, missing_ok=True) if ticket.is_made else None
    return FileResponse(
        ticket.file, media_type=ticket.media, filename=ticket.name or None, headers=headers, background=after
    )


@routes.get("", response_model=Recordings, responses=declared(401, 403))
async def recordings(desk: Opened) -> Tree:
    """All recordings that were opened, each with its settings as they are now."""
    found = [{"number": n, **await desk.quick.run(reading.summary, str(one))} for n, one in enumerate(desk.files)]
    return {"recordings": found, "methods": list(METHODS), "trackers": list(TRACKERS)}


@routes.get("/{number}/contents", response_model=dict[str, Any], responses=SEEN)
async def contents(number: int, desk: Opened) -> Tree:
    """What `midspan inspect` says of it."""
    return await desk.commands.asked("inspect", str(desk.require(number)))


@routes.get(
    "/{number}/cameras/{camera}/picture", response_class=Response,
    responses={**SEEN, 200: {"content": {"image/jpeg": {"schema": {"type": "string", "format": "binary"}}}}},
)  # fmt: skip
async def picture(number: int, camera: str, desk: Opened) -> Response:
    """A camera's first frame."""
    body, tree = await desk.long.run(reading.first_frame, str(desk.require(number)), camera, longest_s=LOOK_S)
    return pictured(tree, body)


@routes.get(
    "/{number}/settings", response_class=PlainTextResponse, responses={**SEEN, 200: {"content": TEXT}}
)  # fmt: skip
async def settings(number: int, desk: Opened) -> PlainTextResponse:
    """recording.toml as text; its ETag is what a change is sent with."""
    content = desk.require(number).read_bytes()
    return PlainTextResponse(content, headers={"ETag": tag_of(content)})


@routes.put(
    "/{number}/settings", response_model=Done, responses=declared(401, 403, 404, 412, 413, 415, 422, 428),
    openapi_extra={"requestBody": {"required": True, "content": TEXT}},
)  # fmt: skip
async def change(
    number: int,
    request: Request,
    response: Response,
    desk: Opened,
    if_match: Annotated[str | None, Header(max_length=200)] = None,
) -> Done:
    """Check new settings, with the regions that they name, and write them."""
    content, path = await text_of(request, if_match), desk.require(number)
    async with desk.changing:
        require_unchanged(path, if_match)
        await desk.long.run(require_recording, path, content, longest_s=LOOK_S)
        write_whole(path, content, mode=stat.S_IMODE(path.stat().st_mode))
    response.headers["ETag"] = tag_of(content)
    return Done(text=f"{path.name} is written.")


def require_recording(path: Path, content: bytes) -> None:
    """Raises Problem 422 with the key for settings that a recording may not have."""
    with on_trial(path, content) as trial:
        reading.require_regions_inside(trial)


@routes.get("/{number}/job", response_model=dict[str, Any], responses=SEEN)
async def job(number: int, desk: Opened) -> Tree:
    """The calculation that runs, or ran last; without `what` where there was none."""
    desk.require(number)
    newest = desk.commands.newest(number)
    return {} if newest is None else newest.to_dict()


@routes.post("/{number}/calibrate", response_model=dict[str, Any], status_code=202, responses=COMMANDED)
async def calibrate(number: int, desk: Opened) -> Tree:
    """Calibrate it, as `midspan calibrate` does; writes calibration.json."""
    return desk.commands.start(number, "calibrate", str(desk.require(number))).to_dict()


@routes.post("/{number}/estimate", response_model=dict[str, Any], status_code=202, responses=COMMANDED)
async def estimate(number: int, wanted: Wanted, desk: Opened) -> Tree:
    """Estimate it, as `midspan estimate` does; writes result.csv, result.json and report.html."""
    path = desk.require(number)
    folder = path.parent
    more = ["-c", str(folder / CALIBRATION_FILE)] if wanted.calibration else []
    if wanted.method is not None:
        more += ["--method", option("method", wanted.method, METHODS)]
    if wanted.tracker is not None:
        more += ["--tracker", option("tracker", wanted.tracker, TRACKERS)]
    written = ["-o", str(folder / reading.RESULT_FILE), "--report", str(folder / reading.REPORT_FILE)]
    return desk.commands.start(number, "estimate", str(path), *written, *more).to_dict()


@routes.post("/{number}/cancel", response_model=Done, responses=COMMANDED)
async def cancel(number: int, desk: Opened) -> Done:
    """End the calculation of a recording; nothing half-written is left."""
    desk.require(number)
    newest = desk.commands.newest(number)
    if newest is None or newest.state != "running":
        raise Problem(409, "No calculation is running.")
    await desk.commands.cancel()
    return Done(text="Cancelled; nothing was written." if newest.state == "cancelled" else "It had ended already.")


@routes.get("/{number}/calibration", response_model=dict[str, Any], responses=SEEN)
async def calibration(number: int, desk: Opened) -> Tree:
    """Its calibration.json."""
    return reading.calibration(str(desk.require(number)))


@routes.get("/{number}/result", response_model=dict[str, Any], responses=SEEN)
async def result(number: int, desk: Opened) -> Tree:
    """What stands with the rows of its result, and when they begin and end."""
    path = str(desk.require(number))
    return {**reading.result(path), **await desk.long.run(reading.span, path, "result", longest_s=LOOK_S)}


@routes.get("/{number}/series", response_class=JSONResponse, responses=SEEN)
async def series(
    number: int,
    desk: Opened,
    from_s: Second,
    to_s: Second,
    buckets: Annotated[int | None, Query(ge=1, le=MAX_BUCKETS)] = None,
    of: Trace = "result",
) -> Response:
    """Rows, or equal buckets of them as of a point: of the result, along its second axis (across), of the reference, or
    of result less reference (error).
    """
    if to_s <= from_s:
        raise Problem(422, "from_s, to_s: `to_s` must be after `from_s`.")
    path = str(desk.require(number))
    body = await desk.long.run(reading.series, path, of, from_s, to_s, buckets, longest_s=LOOK_S)
    return Response(body, media_type="application/json")


@routes.get("/{number}/spectrum", response_model=SpectrumBody, responses=SEEN)
async def spectrum(number: int, desk: Opened, from_s: Second, to_s: Second, of: Trace = "result") -> Tree:
    """Spectrum and natural frequencies of a part of what `series` gives."""
    path = str(desk.require(number))
    return await desk.long.run(reading.spectrum_of, path, of, from_s, to_s, longest_s=LOOK_S)


@routes.get("/{number}/comparison", response_model=dict[str, Any], responses=SEEN)
async def comparison(number: int, desk: Opened) -> Tree:
    """What `midspan compare` says of result and reference."""
    path = desk.require(number)
    return await desk.commands.asked("compare", str(path.parent / reading.RESULT_FILE), str(path))


@routes.post("/{number}/files", response_model=Address, responses=COMMANDED)
async def prepare(number: int, wanted: FileWanted, desk: Opened) -> Address:
    """Make a file, and say where it can be had."""
    path = desk.require(number)
    folder = path.parent
    if wanted.format == "report":
        return Address(path=_address(desk, Ticket(folder / reading.REPORT_FILE, "text/html; charset=utf-8")))
    source, media = folder / reading.RESULT_FILE, FILES[wanted.format]
    name = f"{folder.resolve().name}.{wanted.format}"
    if wanted.format == "csv":
        return Address(path=_address(desk, Ticket(source, media, name)))
    target = Path(tempfile.mkdtemp(dir=desk.folder)) / name
    await desk.commands.asked("export", str(source), "-o", str(target))
    return Address(path=_address(desk, Ticket(target, media, name, is_made=True)))


def _address(desk: Desk, ticket: Ticket) -> str:
    if not ticket.file.is_file():
        raise Problem(409, f"{ticket.file.name}: does not exist yet. Estimate the recording first.")
    return f"/files/{desk.tickets.put(ticket)}"
