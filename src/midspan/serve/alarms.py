"""Alarms: those that are open and those that ended, acknowledging, silencing, a test, the audit list."""

import time
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from midspan.alarms.book import DAY_NS, KEEP_DAYS, Book, has_book
from midspan.alarms.machine import OPEN
from midspan.alarms.messages import iso, silence_tree, tree_of
from midspan.alarms.watch import SILENCE
from midspan.errors import MidspanError
from midspan.serve.instants import PATTERN, instant_ns
from midspan.serve.login import READ, Operator
from midspan.serve.points import Done
from midspan.serve.problems import Problem, declared
from midspan.serve.serving import Serving, Shared
from midspan.service.live_socket import Tree
from midspan.service.places import place_of

MAX_AUDIT = 1000


class SilenceBody(BaseModel):
    """Who silenced an alarm, until when and why."""

    until: str
    owner: str
    reason: str


class AlarmBody(BaseModel):
    """An alarm, as MQTT and webhooks have it."""

    id: str
    point: str
    name: str
    state: str = Field(description="pending, firing, acknowledged or ended")
    level: str = Field(description="warning or critical")
    on: str = Field(description="displacement, drift, velocity, std, silent, disk or no_data")
    reason: str = Field(description="limit; band: only the band exceeds the limit; no_data: there are no rows")
    value: float
    value_std: float = Field(description="standard deviation of the value, 0 where it has none")
    peak: float = Field(description="peak value, the one farthest from zero")
    limit: float
    unit: str
    time: str = Field(description="of the newest change, ISO 8601 UTC")
    since: str = Field(
        description="since when the limit is exceeded for certain; of one that never was, its band. ISO 8601 UTC"
    )
    text: str
    acknowledged_by: str
    silence: SilenceBody | None


class SilenceListed(BaseModel):
    """A silence that is in force: of a rule, whether an alarm of it is open or not."""

    id: str
    point: str
    name: str = Field(description="of the rule")
    no_data: bool = Field(description="true for the alarm of missing rows (no_data_s)")
    until: str
    owner: str
    reason: str


class AuditBody(BaseModel):
    """What became of an alarm, by whom; empty for midspan itself."""

    time: str
    alarm: str
    what: str
    who: str
    text: str


class TargetBody(BaseModel):
    """How delivery to a target stands; fault: why the newest attempt failed."""

    target: str
    waiting: int
    sent: int
    fault: str
    sent_s: float | None


class LimitBody(BaseModel):
    """A limit of a point, in the unit of its value."""

    point: str
    name: str
    on: str
    level: str
    limit: float
    unit: str


class SilenceWanted(BaseModel):
    """Until when an alarm is silent, and why, as everybody sees it."""

    model_config = ConfigDict(extra="forbid")
    until: Annotated[str, StringConstraints(pattern=PATTERN)] = Field(description="ISO 8601 (UTC without a zone) or ns")
    reason: Annotated[str, StringConstraints(min_length=1, max_length=200)]


State = Literal["open", "pending", "firing", "acknowledged", "ended"]
routes = APIRouter(prefix="/alarms", tags=["alarms"])
SEEN = declared(401, 403, 422)
COMMANDED = declared(401, 403, 404, 409, 413, 415, 422)


def kept_alarms(folder: Path, now_ns: int, since_ns: int) -> list[Tree]:
    """The alarms of a service's folder that are open, or ended since an instant, newest change first."""
    if not has_book(folder):
        return []
    with closing(Book(folder, read_only=True)) as book:
        silences = {key.partition(":")[2]: tree for key, tree in book.kept().items() if key.startswith("silence:")}
        silent = {key: {name: tree[name] for name in ("until", "owner", "reason")} for key, tree in silences.items()
                  if tree["until_ns"] > now_ns}  # fmt: skip
        return [tree_of(one, silent.get(one.key)) for one in book.alarms(since_ns)]


def kept_silences(folder: Path, now_ns: int) -> list[Tree]:
    """The silences of a service's folder that are in force."""
    if not has_book(folder):
        return []
    with closing(Book(folder, read_only=True)) as book:
        kept = {key.removeprefix(SILENCE): tree for key, tree in book.kept().items() if key.startswith(SILENCE)}
    return [silence_tree(key, tree) for key, tree in kept.items() if tree["until_ns"] > now_ns]


def kept_audit(folder: Path, count: int, alarm: str | None) -> list[Tree]:
    """The newest lines of the audit list."""
    if not has_book(folder):
        return []
    with closing(Book(folder, read_only=True)) as book:
        lines = book.audit(count, alarm)
    return [
        {"time": iso(one.time_ns), "alarm": one.alarm, "what": one.what, "who": one.who, "text": one.text}
        for one in lines
    ]


async def known(serving: Serving, *, ended: bool = True) -> list[Tree]:
    """All alarms: the open ones with their newest values, where something measures. ended: with those that have."""
    folder, now_ns = place_of(serving.where), time.time_ns()
    kept = await serving.quick.run(kept_alarms, folder, now_ns, now_ns - KEEP_DAYS * DAY_NS if ended else now_ns)
    try:
        answer, _ = await serving.link.ask("alarms")
    except MidspanError:
        return kept
    fresh = {one["id"]: one for one in answer.get("alarms", [])}
    # What is kept a moment later than it changed is open already, or ended.
    rest = [one for one in kept if one["id"] not in fresh]
    return [*fresh.values(), *rest]


async def require_alarm(serving: Serving, number: str) -> None:
    """Raises Problem for what is no alarm's id, or that of one that ended."""
    found = next((one for one in await known(serving) if one["id"] == number), None)
    if found is None:
        raise Problem(404, f"{number}: is not an alarm. GET /api/v1/alarms lists them.")
    if found["state"] not in OPEN:
        raise Problem(409, f"{number}: has ended.")


@routes.get("", response_model=list[AlarmBody], dependencies=READ, responses=SEEN)
async def alarms(
    serving: Shared,
    state: Annotated[State | None, Query(description="only those in this state; open: all but ended")] = None,
    point: Annotated[str | None, Query(description="only those of this point", max_length=64)] = None,
) -> list[Tree]:
    """The alarms that are open, and those that ended within 30 days."""
    found = await known(serving, ended=state in (None, "ended"))
    states = OPEN if state == "open" else (*OPEN, "ended") if state is None else (state,)
    return [one for one in found if one["state"] in states and point in (None, one["point"])]


@routes.get("/audit", response_model=list[AuditBody], dependencies=READ, responses=SEEN)
async def audit(
    serving: Shared, alarm: Annotated[str | None, Query(description="only of this alarm", max_length=64)] = None
) -> list[Tree]:
    """What became of alarms, newest first; at most 1000 lines."""
    return await serving.quick.run(kept_audit, place_of(serving.where), MAX_AUDIT, alarm)


@routes.get("/targets", response_model=list[TargetBody], dependencies=READ, responses=declared(401, 403, 409))
async def targets(serving: Shared) -> list[Any]:
    """Where alarms go besides page and store, and how delivery stands."""
    answer, _ = await serving.link.ask("alarms")
    return list(answer.get("targets", []))


@routes.get("/limits", response_model=list[LimitBody], dependencies=READ, responses=declared(401, 403, 409))
async def limits(serving: Shared) -> list[Any]:
    """The limits of all points that are measured."""
    answer, _ = await serving.link.ask("alarms")
    return list(answer.get("limits", []))


@routes.get("/silences", response_model=list[SilenceListed], dependencies=READ, responses=declared(401, 403))
async def silences(serving: Shared) -> list[Any]:
    """The silences that are in force."""
    try:
        answer, _ = await serving.link.ask("alarms")
    except MidspanError:
        return await serving.quick.run(kept_silences, place_of(serving.where), time.time_ns())
    return list(answer.get("silences", []))


@routes.delete("/silences/{number}", response_model=Done, responses=declared(401, 403, 404, 409, 422))
async def end_silence(number: str, login: Operator, serving: Shared) -> Done:
    """End a silence, also one of a rule without an open alarm."""
    if number not in [one["id"] for one in await silences(serving)]:
        raise Problem(404, f"{number}: is not a silence. GET /api/v1/alarms/silences lists them.")
    answer, _ = await serving.link.ask("end_silence", silence=number, who=login.name)
    return Done(text=str(answer["text"]))


@routes.post("/test", response_model=Done, responses=declared(401, 403, 409))
async def test(login: Operator, serving: Shared) -> Done:
    """Send a message that says that it is a test to every target."""
    answer, _ = await serving.link.ask("test_alarms", who=login.name)
    return Done(text=str(answer["text"]))


@routes.post("/{number}/acknowledge", response_model=Done, responses=COMMANDED)
async def acknowledge(number: str, login: Operator, serving: Shared) -> Done:
    """Say that a firing alarm is seen: it is not repeated any more."""
    await require_alarm(serving, number)
    answer, _ = await serving.link.ask("acknowledge", alarm=number, who=login.name)
    return Done(text=str(answer["text"]))


@routes.post("/{number}/silence", response_model=Done, responses=COMMANDED)
async def silence(number: str, wanted: SilenceWanted, login: Operator, serving: Shared) -> Done:
    """Send no messages about an alarm, nor about the next ones of its rule, until an instant."""
    until_ns = instant_ns(wanted.until, "until")
    if until_ns <= time.time_ns():
        raise Problem(422, f"until: must be in the future; received {wanted.until!r}.")
    await require_alarm(serving, number)
    head = {"alarm": number, "who": login.name, "until_ns": until_ns, "reason": wanted.reason}
    answer, _ = await serving.link.ask("silence", **head)
    return Done(text=str(answer["text"]))


@routes.post("/{number}/unsilence", response_model=Done, responses=COMMANDED)
async def unsilence(number: str, login: Operator, serving: Shared) -> Done:
    """End a silence."""
    await require_alarm(serving, number)
    answer, _ = await serving.link.ask("unsilence", alarm=number, who=login.name)
    return Done(text=str(answer["text"]))
