"""Points: how they stand, their rows, events, spectra and calibrations."""

import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import FileResponse, JSONResponse
from pydantic import BaseModel, ConfigDict, Field, StringConstraints
from starlette.background import BackgroundTask

from midspan.alarms.book import Book, calibration_id, has_book
from midspan.records import NANOSECONDS
from midspan.serve import reading
from midspan.serve.instants import From, To, span_ns
from midspan.serve.login import OPERATE, READ, Operator
from midspan.serve.problems import Problem, declared
from midspan.serve.serving import Serving, Shared
from midspan.service.live_socket import Tree
from midspan.service.places import place_of
from midspan.service.reasons import NOT_CALIBRATED

# What a file of rows may take, s, and how many are made at a time.
EXPORT_S = 900.0
# Buckets of up to this time take a thread a tenth of a second.
QUICK_S = 2 * 86_400.0
# Rows of up to this time take a thread 25 ms at 100 Hz on a busy machine; a process takes seconds to start there.
QUICK_ROWS_S = 10.0
# Points of groups that a list has besides the first ones at most.
MAX_ALSO = 20
Numbers = list[float | None]
ARROW = "application/vnd.apache.arrow.stream"
BINARY = {"schema": {"type": "string", "format": "binary"}}
FILES = {
    "csv": "text/csv",
    "parquet": "application/vnd.apache.parquet",
    "h5": "application/x-hdf5",
    "mat": "application/x-matlab-data",
    "xlsx": "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
    "mseed": "application/vnd.fdsn.mseed",
    "tdms": "application/octet-stream",
    "uff": "application/octet-stream",
}
Format = Literal["csv", "parquet", "h5", "mat", "xlsx", "mseed", "tdms", "uff"]


class Warned(BaseModel):
    """What a calibration warns of, and what to do."""

    code: str
    severity: str = Field(description="warning, or serious: the displacement may be wrong by more than its band")
    text: str


class PointState(BaseModel):
    """How a point stands: its newest row, with its age, and why there is none that can be relied on."""

    name: str
    status: str | None = Field(description="tracking, coasting, lost, warming or calibrating; null without any row")
    reason: str = Field(description="reason code; empty: no fault")
    text: str
    displacement_mm: float | None
    displacement_std_mm: float | None
    time: str | None = Field(description="of the newest row, ISO 8601 UTC")
    age_s: float | None
    notice: str = Field("", description="reason code of a pending step, also without rows")
    warnings: list[Warned] = Field([], description="of the calibration that makes the rows, the worst first")
    since: str | None = Field(None, description="time of the last change of status or reason that this server saw")
    calibration: int | None = None
    stage: str = Field("", description="capturing, calibrating or opening, else empty")
    stage_left_s: float | None = Field(None, description="remaining time of the stage, s; null: unknown")
    latency_s: float | None = Field(None, description="mean delay of rows after their time stamp, s")


class Series(BaseModel):
    """Rows, one list for each of the result's columns, or buckets; `time` in ns UTC. A second axis adds columns."""

    model_config = {"extra": "allow"}
    time: list[int]


class EventBody(BaseModel):
    """An event as it was stored."""

    time: str
    time_ns: int
    kind: str
    text: str


class Span(BaseModel):
    """First and last row of a span, ISO 8601 UTC; gaps of less than eleven minutes may be in it."""

    model_config = ConfigDict(populate_by_name=True)
    begin: str = Field(alias="from")
    to: str


class Refused(BaseModel):
    """Why a calibration was refused, as everybody sees it."""

    model_config = ConfigDict(extra="forbid")
    reason: Annotated[str, StringConstraints(max_length=200)] = ""


class Refusal(BaseModel):
    """When a calibration was refused, by whom and why."""

    time: str
    owner: str
    reason: str


class CalibrationBody(BaseModel):
    """A calibration of the store; state: in force, offered, refused or retired; rows: when it made rows."""

    id: int
    time: str
    state: str
    calibration: dict[str, Any]
    rows: list[Span] = Field([], description="the newest 50 spans of rows made with it")
    refusal: Refusal | None = Field(None, description="refusal, if a user refused it within 400 days")


class SpectrumBody(BaseModel):
    """One-sided power spectral density, and natural frequencies; `reason` says why there are none."""

    frequency_hz: Numbers
    density_mm2_hz: Numbers
    segment_s: float | None
    modes: list[dict[str, Any]]
    reason: str


class Done(BaseModel):
    """What a command did, in a sentence."""

    text: str


routes = APIRouter(prefix="/points", tags=["points"])
OF_A_POINT = declared(401, 403, 404, 422)
COMMANDED = declared(401, 403, 404, 409, 422)


@routes.get("", response_model=list[PointState], dependencies=READ, responses=declared(401, 403, 422))
async def points(
    serving: Shared,
    of_groups: Annotated[int | None, Query(ge=0)] = None,
    also: Annotated[list[str] | None, Query()] = None,
) -> list[Tree]:
    """All points of the site. of_groups: of each group this many at most, first those with a reason, and those that
    `also` names; their rows come over the websocket for some time.
    """
    own = [await point_state(serving, name) for name in await serving.points(of_groups)]
    if of_groups is None:
        return [*own, *await serving.groups.states(None)]
    found = await serving.groups.states(of_groups)
    listed = {one["name"] for one in found}
    more = [await serving.groups.state(name) for name in (also or ())[:MAX_ALSO] if name not in listed]
    found += [one for one in more if one is not None]
    serving.groups.look([str(one["name"]) for one in found])
    return [*own, *found]


@routes.get("/{name}", response_model=PointState, dependencies=READ, responses=OF_A_POINT)
async def point(name: str, serving: Shared) -> Tree:
    """One point."""
    await serving.require_point(name)
    return await serving.groups.state(name) or await point_state(serving, name)


@routes.get(
    "/{name}/series", response_model=Series, dependencies=READ,
    responses={**OF_A_POINT, 200: {"content": {ARROW: BINARY}}},
)  # fmt: skip
async def series(
    name: str,
    serving: Shared,
    begin: From = None,
    to: To = None,
    buckets: Annotated[int | None, Query(ge=1, le=reading.MAX_BUCKETS)] = None,
    format: Literal["json", "arrow"] = "json",
) -> Response:
    """Rows, or least, largest and mean of equal buckets: a peak keeps its height, a gap is null."""
    await serving.require_point(name)
    span = span_ns(begin, to)
    if buckets is not None:
        if format == "arrow":
            raise Problem(422, "format: must be json with buckets; arrow is for rows. Leave one of them out.")
        if span[1] - span[0] < buckets:
            raise Problem(422, "buckets: must be at least 1 ns long. Request fewer.")
        length_s = (span[1] - span[0]) / NANOSECONDS
        # Of months there are least and largest values of blocks, which are few.
        worker = serving.long if QUICK_S < length_s <= reading.SECONDS_S else serving.quick
        return JSONResponse(await worker.run(reading.buckets, serving.where, name, *span, buckets))
    work = reading.series_json if format == "json" else reading.series_arrow
    worker = serving.quick if span[1] - span[0] <= QUICK_ROWS_S * NANOSECONDS else serving.long
    body = await worker.run(work, serving.where, name, *span)
    return Response(body, media_type="application/json" if format == "json" else ARROW)


@routes.get(
    "/{name}/export", dependencies=READ, response_class=FileResponse,
    responses={**OF_A_POINT, 200: {"content": dict.fromkeys(FILES.values(), BINARY)}},
)  # fmt: skip
async def export(name: str, serving: Shared, begin: From = None, to: To = None, format: Format = "csv") -> FileResponse:
    """Every row, as the file that `midspan export` writes; times are UTC."""
    await serving.require_point(name)
    span = span_ns(begin, to)
    if serving.exporting.locked():
        raise Problem(503, "Another export is running. Try again in some seconds.", headers={"Retry-After": "5"})
    async with serving.exporting:
        folder = tempfile.TemporaryDirectory(prefix="midspan-export-")
        file = Path(folder.name) / f"{name}.{format}"
        try:
            await serving.files.run(reading.export, serving.where, name, span, str(file), longest_s=EXPORT_S)
        except BaseException:
            folder.cleanup()
            raise
    return FileResponse(file, media_type=FILES[format], filename=file.name, background=BackgroundTask(folder.cleanup))


@routes.get("/{name}/events", response_model=list[EventBody], dependencies=READ, responses=OF_A_POINT)
async def events(name: str, serving: Shared, begin: From = None, to: To = None) -> list[Tree]:
    """The newest 1000 events of a time (left out: of a day), in its order."""
    await serving.require_point(name)
    return await serving.quick.run(reading.events, serving.where, name, *span_ns(begin, to, 86_400.0))


@routes.get("/{name}/spectrum", response_model=SpectrumBody, dependencies=READ, responses=OF_A_POINT)
async def spectrum(name: str, serving: Shared, begin: From = None, to: To = None) -> Tree:
    """Spectrum and natural frequencies of the rows of a time."""
    await serving.require_point(name)
    return await serving.long.run(reading.spectrum_of, serving.where, name, *span_ns(begin, to))


@routes.get("/{name}/calibrations", response_model=list[CalibrationBody], dependencies=READ, responses=OF_A_POINT)
async def calibrations(name: str, serving: Shared) -> list[Tree]:
    """All calibrations of a point that the store has; the spans of rows are up to half a minute old."""
    await serving.require_point(name)
    kept, rows = await serving.quick.run(reading.calibrations, serving.where, name), await serving.calibrated_rows(name)
    refused = [one["id"] for one in kept if one["state"] == "refused"]
    why = await serving.quick.run(refusals, place_of(serving.where), name, refused) if refused else {}
    return [{**one, "rows": rows.get(one["id"], []), "refusal": why.get(one["id"])} for one in kept]


def refusals(folder: Path, point: str, numbers: Sequence[int]) -> dict[int, Tree]:
    """Refusals of a point's calibrations of these numbers, as the audit list of a service's folder has them."""
    if not has_book(folder):
        return {}
    with closing(Book(folder, read_only=True)) as book:
        lines = {number: book.audit(1, calibration_id(point, number)) for number in numbers}
    return {
        number: {"time": reading.iso(one.time_ns), "owner": one.who, "reason": one.text}
        for number, found in lines.items()
        for one in found
    }


@routes.post(
    "/{name}/calibrate", response_model=Done, status_code=202, dependencies=OPERATE, responses=COMMANDED
)  # fmt: skip
async def calibrate(name: str, serving: Shared) -> Done:
    """Calibrate a point again; its rows go on meanwhile."""
    await serving.require_point(name)
    if serving.groups.number(name) is not None:
        raise Problem(409, f"{name}: {NOT_CALIBRATED}")
    answer, _ = await serving.link.ask("calibrate", point=name)
    return Done(text=str(answer["text"]))


@routes.post("/{name}/calibrations/{number}/accept", response_model=Done, dependencies=OPERATE, responses=COMMANDED)
async def accept(name: str, number: int, serving: Shared) -> Done:
    """Put an offered calibration in force."""
    return await _decided(serving, "accept", name, number)


@routes.post(
    "/{name}/calibrations/{number}/refuse", response_model=Done,
    responses={**COMMANDED, **declared(413, 415)},
)  # fmt: skip
async def refuse(name: str, number: int, login: Operator, serving: Shared, why: Refused | None = None) -> Done:
    """Refuse an offered calibration, with or without a reason; the one in force stays."""
    reason = "" if why is None else why.reason.strip()
    return await _decided(serving, "refuse", name, number, who=login.name, reason=reason)


async def _decided(serving: Serving, command: str, name: str, number: int, **values: str) -> Done:
    await serving.require_point(name)
    kept = await serving.quick.run(reading.calibrations, serving.where, name)
    if number not in [one["id"] for one in kept]:
        raise Problem(404, f"{name} has no calibration {number}. GET its calibrations for those that it has.")
    answer, _ = await serving.link.ask(command, point=name, number=number, **values)
    return Done(text=str(answer["text"]))


async def point_state(serving: Serving, name: str) -> Tree:
    """A point as `PointState` has it: of the rows that came last, else of the store's newest."""
    known, now_s, stands = await serving.newest(name), time.time(), serving.stands(name)
    time_ns = known.get("time_ns")
    return {
        **stands,
        "status": known.get("status") if stands["status"] is None else stands["status"],
        "displacement_mm": known.get("displacement_mm"),
        "displacement_std_mm": known.get("displacement_std_mm"),
        "time": None if time_ns is None else reading.iso(time_ns),
        "age_s": None if time_ns is None else reading.age_s(time_ns, now_s),
    }
