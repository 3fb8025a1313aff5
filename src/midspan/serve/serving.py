"""What the routes of the server share: the store, who has access, the engine, the rows that come, and workers."""

import asyncio
import ctypes
import functools
import math
import multiprocessing
import signal
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar

from fastapi import Depends
from starlette.requests import HTTPConnection

from midspan.serve import groups, reading
from midspan.serve.access import Access
from midspan.serve.attempts import Attempts
from midspan.serve.engine_link import EngineLink
from midspan.serve.groups import GroupTables
from midspan.serve.problems import Problem
from midspan.serve.viewers import LiveRows
from midspan.service.live_socket import Tree, of_ready
from midspan.service.places import place_of
from midspan.service.reasons import sentence
from midspan.store.database import StoreFault

Found = TypeVar("Found")

# Points of a store that nothing measures, and their newest rows, are looked for so often, s.
POINTS_S, NEWEST_S = 30.0, 5.0
# Which calibration made which rows is looked for so often, s: it takes a tenth of a second for 200 days.
SPANS_S = 30.0
# Requests that wait for a worker at most, and how long: more are turned away.
MAX_WAITING, LONGEST_S = 16, 60.0


class Worker:
    """One thing at a time, in a thread or a process; what is too much to wait is refused."""

    def __init__(self, make: Callable[[], Executor]) -> None:
        self._make, self._waiting = make, 0
        self._executor: Executor | None = None

    async def run(self, work: Callable[..., Found], *arguments: Any, longest_s: float = LONGEST_S) -> Found:
        """What a function gives. Raises what it does, and Problem where there is too much to do."""
        if self._waiting >= MAX_WAITING:
            raise Problem(503, "Too many requests wait for the store. Try again in some seconds.", headers=RETRY)
        if self._executor is None:
            self._executor = self._make()
        self._waiting += 1
        try:
            call = functools.partial(work, *arguments)
            future = asyncio.get_running_loop().run_in_executor(self._executor, call)
            return await asyncio.wait_for(future, longest_s)
        except TimeoutError:
            text = f"The request took longer than {longest_s:g} s. Request a shorter time."
            raise Problem(503, text, headers=RETRY) from None
        except BrokenProcessPool:
            # Ended from outside, as where memory runs out.
            self._executor = None
            raise Problem(503, "The worker process ended. Request a shorter time.", headers=RETRY) from None
        finally:
            self._waiting -= 1

    def close(self) -> None:
        """End it, without what it does at present."""
        executor, self._executor = self._executor, None
        if executor is None:
            return
        if isinstance(executor, ProcessPoolExecutor):
            for process in list((executor._processes or {}).values()):
                process.kill()
        # A process has semaphores, which it gives back once it has ended.
        executor.shutdown(wait=isinstance(executor, ProcessPoolExecutor), cancel_futures=True)


RETRY = {"Retry-After": "5"}


def counted(group: Tree) -> Tree:
    """What is reported to viewers of a group: how many points stand how, without what changes all the time."""
    return {key: group[key] for key in ("group", "numbers", "reasons", "statuses")}


# What is reported to viewers of a source that is wrong.
WRONG = ("point", "source", "reason", "text")
# What changes from one state to the next; viewers count it down alone.
PASSING = ("stage_left_s", "latency_s")


def _lasting(stands: Tree) -> Tree:
    """How a point stands, without what changes from one state to the next."""
    return {key: value for key, value in stands.items() if key not in PASSING}


def thread() -> Executor:
    """For what takes milliseconds."""
    return ThreadPoolExecutor(2, thread_name_prefix="store")


def process() -> Executor:
    """For what takes longer, whose memory and time are not the server's."""
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_begin_worker)


# Of a machine without memory left the kernel ends this process first, never one that measures.
FIRST_TO_END = "1000"
PR_SET_PDEATHSIG = 1


def _begin_worker() -> None:
    """A worker ends with the server, however that ends, and not by Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        with suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text(FIRST_TO_END)
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


@dataclass(slots=True)
class Serving:
    """where: the store; site_file: SITE.toml, None where only the engine, if any, knows it; secure: TLS."""

    where: str
    site_file: Path | None = None
    secure: bool = False
    attempts: Attempts = field(default_factory=Attempts)
    # The newest picture of each camera, when it came (s), and who waits for another.
    pictures: dict[str, tuple[float, Tree, bytes]] = field(default_factory=dict)
    looking: dict[str, asyncio.Lock] = field(default_factory=dict)
    # One change of the settings, and one file of rows, at a time.
    changing: asyncio.Lock = field(default_factory=asyncio.Lock)
    exporting: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(1))
    # Natural frequencies of segments by point, step (ns) and its number, and who computes them.
    segments: dict[tuple[str, int, int], tuple[int, list[Tree]] | None] = field(default_factory=dict)
    following: asyncio.Lock = field(default_factory=asyncio.Lock)
    access: Access = field(init=False)
    link: EngineLink = field(init=False)
    groups: GroupTables = field(init=False)
    live: LiveRows = field(default_factory=LiveRows)
    quick: Worker = field(default_factory=lambda: Worker(thread))
    long: Worker = field(default_factory=lambda: Worker(process))
    files: Worker = field(default_factory=lambda: Worker(process))
    hashing: Worker = field(default_factory=lambda: Worker(lambda: ThreadPoolExecutor(1, thread_name_prefix="argon2")))
    _points: tuple[float, tuple[list[str], list[str]]] = (-POINTS_S, ([], []))
    _newest: dict[str, tuple[float, Tree]] = field(default_factory=dict)
    _spans: dict[str, tuple[float, dict[int, list[Tree]]]] = field(default_factory=dict)
    # What was reported to viewers last: how each point stands, and what is wrong.
    _reported: tuple[dict[str, Tree], Tree] = field(default_factory=lambda: ({}, {}))
    # Of each point: status and reason, and when they became so (ns UTC), as far as this process saw it.
    _since: dict[str, tuple[tuple[str, str], int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        folder = place_of(self.where)
        self.access = Access(folder)
        self.link = EngineLink(folder, self._came)
        self.groups = GroupTables(self.link)

    def _came(self, head: Tree, body: bytes) -> None:
        if head["kind"] == "rows":
            self.live.came(str(head["point"]), body)
        elif head["kind"] == "head":
            self.live.came_ahead(str(head["point"]), body)
        elif head["kind"] == "state":
            for one in head["points"]:
                now = (str(one["status"]), str(one["reason"] or one.get("notice", "")))
                if self._since.get(str(one["point"]), (None, 0))[0] != now:
                    self._since[str(one["point"])] = (now, time.time_ns())
            self.report_changes()
        elif head["kind"] in ("event", "alarm"):
            self.live.tell({"type": head["kind"], **{key: value for key, value in head.items() if key != "kind"}})

    @property
    def settings_file(self) -> Path | None:
        """The site's file, where one is known."""
        named = self.link.hello.get("site_file")
        return self.site_file or (Path(named) if named else None)

    async def points(self, of_groups: int | None = None) -> list[str]:
        """The names of all points that are measured but those of groups, or of those that the store has rows of.

        of_groups: of each group of the store this many at most.
        """
        if self.link.state:
            return [str(one["point"]) for one in self.link.state["points"]]
        then_s, known = self._points
        if time.monotonic() - then_s > POINTS_S:
            known = await self.quick.run(reading.known_points, self.where)
            self._points = (time.monotonic(), known)
        return reading.first_of_groups(*known, of_groups)

    async def require_point(self, name: str) -> None:
        """Raises Problem for a name that is no point's."""
        if self.groups.number(name) is not None or name in await self.points():
            return
        if await self.quick.run(reading.has_point, self.where, name):
            return
        raise Problem(404, f"{name}: is not a point of this site. GET /api/v1/points lists them.")

    async def newest(self, name: str) -> Tree:
        """A point's newest row: one that came, else one that is kept; empty without any."""
        if (came := self.live.newest.get(name)) is not None:
            return came
        then_s, kept = self._newest.get(name, (-POINTS_S, {}))
        if time.monotonic() - then_s > NEWEST_S:
            # A store that is away, or not yet made, is no reason not to say how the point stands.
            with suppress(StoreFault):
                kept = await self.quick.run(reading.newest, self.where, name)
            self._newest[name] = (time.monotonic(), kept)
        return kept

    async def calibrated_rows(self, name: str) -> dict[int, list[Tree]]:
        """The spans of a point's rows that were made with each calibration, as they were half a minute ago at most."""
        then_s, spans = self._spans.get(name, (-math.inf, {}))
        if time.monotonic() - then_s > SPANS_S:
            spans = await self.quick.run(reading.calibrated_rows, self.where, name)
            self._spans[name] = (time.monotonic(), spans)
        return spans

    async def watch(self) -> None:
        """Let rows of points of groups come that viewers name."""
        if not self.live.viewers or self.link.reason:
            return
        if points := frozenset(one for one in self.live.named | self.groups.looked if self.groups.number(one)):
            await self.groups.watch(points)

    def since_ns(self, name: str) -> int | None:
        """When a point's status and reason became what they are, ns UTC; None where nothing measures it."""
        return None if self.link.reason else self._since.get(name, (None, None))[1]

    def stands(self, name: str) -> Tree:
        """How a point stands, without its newest row; status: None where nothing measures it."""
        reason = self.link.reason
        state: Tree = next((one for one in self.link.state.get("points", []) if one["point"] == name), {})
        since_ns = self.since_ns(name)
        return {
            "name": name,
            "status": None if reason or not state else state["status"],
            "reason": reason or state.get("reason") or state.get("notice", ""),
            "text": sentence(reason) if reason else state.get("text") or state.get("notice_text", ""),
            "notice": "" if reason else state.get("notice", ""),
            "warnings": [] if reason else state.get("warnings", []),
            "since": None if since_ns is None else reading.iso(since_ns),
            "calibration": state.get("calibration"),
            "stage": "" if reason else state.get("stage", ""),
            "stage_left_s": None if reason else state.get("stage_left_s"),
            "latency_s": None if reason else state.get("latency_s"),
        }

    def report_changes(self) -> None:
        """Report to viewers which points stand otherwise than before, and what is wrong: they need not ask."""
        names = [str(one["point"]) for one in self.link.state.get("points", [])]
        now, standing = {name: self.stands(name) for name in names}, self.standing()
        wrong = {
            "ready": standing["ready"],
            "sources": [{key: one[key] for key in WRONG} for one in standing["sources"] if one["reason"]],
            "settings": standing["settings"],
            "has_settings": standing["has_settings"],
            "groups": [counted(one) for one in standing["groups"]],
        }
        before, wrong_before = self._reported
        changed = [one for name, one in now.items() if _lasting(one) != _lasting(before.get(name, {}))]
        if not changed and wrong == wrong_before and now.keys() == before.keys():
            return
        self._reported = now, wrong
        self.live.tell({"type": "state", "points": changed, "again": now.keys() != before.keys(), **wrong})

    def standing(self) -> Tree:
        """As /readyz shows it: of the newest state, or why there is none."""
        reason, site = self.link.reason, {"has_settings": self.settings_file is not None}
        if not reason and self.link.state:
            own = self.link.state.get("groups", [])
            points = [of_ready(one) for one in self.link.state["points"]] + groups.ready(own)
            state = {key: self.link.state[key] for key in ("ready", "sources", "settings")}
            return {**state, "points": points, "groups": own, **site}
        reason = reason or "starting"
        source = {"point": "", "source": "engine", "reason": reason, "text": sentence(reason)}
        old = self.link.state or {"points": [], "sources": [], "settings": None}
        kept = [one for one in old["sources"] if one["source"] != "engine"] if reason == "engine_silent" else []
        points = [of_ready(one) for one in old["points"]] if reason == "engine_silent" else []
        return {
            "ready": False,
            "points": points,
            "groups": [],
            "sources": [source, *kept],
            "settings": old["settings"],
            **site,
        }

    def close(self) -> None:
        """End the workers."""
        for worker in (self.quick, self.long, self.files, self.hashing):
            worker.close()


async def serving_of(connection: HTTPConnection) -> Serving:
    """What a request's application shares. A coroutine: FastAPI gives plain functions a thread, which costs 0.2 ms."""
    serving: Serving = connection.app.state.serving
    return serving


Shared = Annotated[Serving, Depends(serving_of)]
"""A parameter of routes that need it."""
