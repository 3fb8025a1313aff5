"""Rows as they come, as numbered messages: kept for a while, so that a viewer that was cut off goes on without a hole.

A viewer that does not take what waits for it is dropped, with the reason: nobody is waited for.
"""

import asyncio
import json
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.records import NANOSECONDS
from midspan.service.live_socket import ROW
from midspan.sinks.table import WORDS

# Rows are sent so often, s: five messages a second cost a viewer of four points half of what ten do.
SEND_S = 0.2
# What is kept for viewers that come again, s and bytes: longer cuts are filled from the store.
KEPT_S, MAX_KEPT_BYTES = 60.0, 16_000_000
# A viewer for which this waits is dropped: six minutes of four points at 100 Hz. Of what is kept it first gets half of
# that at most.
MAX_WAITING_BYTES = 8_000_000
# Rows of a message, and of all messages of a time, at most: a point that was opened gives minutes of rows at once.
MAX_ROWS, MAX_SENT = 1000, 20_000
STALLED = "the viewer was too slow; reconnect with after= the newest sequence"
# Why a viewer is dropped, as a websocket's close code: try again later.
TRY_AGAIN = 1013


@dataclass(slots=True, eq=False)
class Viewer:
    """points: whose rows it gets; None: of all. head: provisional ones, too. dropped: it did not take what waited."""

    points: frozenset[str] | None
    head: bool = False
    waiting: deque[str] = field(default_factory=deque)
    bytes: int = 0
    some: asyncio.Event = field(default_factory=asyncio.Event)
    dropped: asyncio.Event = field(default_factory=asyncio.Event)

    def put(self, text: str) -> None:
        """Queue a message, or drop the viewer where too many wait."""
        if self.bytes + len(text) > MAX_WAITING_BYTES:
            self.dropped.set()
            self.waiting.clear()
        else:
            self.waiting.append(text)
            self.bytes += len(text)
        self.some.set()

    @property
    def named(self) -> frozenset[str]:
        """The points whose rows it asks for by name."""
        return self.points or frozenset()

    def gets(self, point: str) -> bool:
        """Whether a point's rows are for it."""
        return self.points is None or point in self.points

    async def next(self) -> str | None:
        """The next message; None once it is dropped."""
        while not self.waiting and not self.dropped.is_set():
            self.some.clear()
            await self.some.wait()
        if self.dropped.is_set():
            return None
        text = self.waiting.popleft()
        self.bytes -= len(text)
        return text


class LiveRows:
    """The newest rows of each point, and the viewers.

    Messages are numbered from the time in milliseconds at which the server began: the numbers of a server that is
    started again are higher than any that a viewer has.
    """

    def __init__(self) -> None:
        self._number = time.time_ns() // 1_000_000
        self._kept: deque[tuple[int, int, str, str]] = deque()
        self._kept_bytes = 0
        self._came: dict[str, list[NDArray[Any]]] = {}
        # Rows that are not final, of which nothing is kept.
        self._ahead: dict[str, list[NDArray[Any]]] = {}
        self._viewers: set[Viewer] = set()
        self.newest: dict[str, dict[str, Any]] = {}
        self.dropped = 0

    @property
    def viewers(self) -> int:
        """How many there are."""
        return len(self._viewers)

    @property
    def named(self) -> frozenset[str]:
        """The points whose rows viewers ask for by name."""
        return frozenset().union(*(one.named for one in self._viewers))

    def came(self, point: str, rows: bytes) -> None:
        """Rows of the engine."""
        found = np.frombuffer(rows, dtype=ROW)
        if len(found):
            self._came.setdefault(point, []).append(found)

    def came_ahead(self, point: str, rows: bytes) -> None:
        """Rows of the engine that what comes later will change."""
        self._ahead.setdefault(point, []).append(np.frombuffer(rows, dtype=ROW))

    def send(self) -> None:
        """Give what came to the viewers."""
        self._send_rows()
        ahead, self._ahead = self._ahead, {}
        for point, rows in ahead.items():
            viewers = [one for one in self._viewers if one.head and one.gets(point)]
            text = head_message(point, np.concatenate(rows)) if viewers else ""
            for viewer in viewers:
                self._give(viewer, text)

    def _send_rows(self) -> None:
        room = MAX_SENT
        for point in list(self._came):
            rows = np.concatenate(self._came.pop(point))
            rows, later = rows[:room], rows[room:]
            room -= len(rows)
            if len(later):
                self._came[point] = [later]
            self._send(point, rows)
            if not room:
                return

    def _send(self, point: str, rows: NDArray[Any]) -> None:
        self.newest[point] = newest_of(rows)
        for part in np.split(rows, range(MAX_ROWS, len(rows), MAX_ROWS)):
            self._number += 1
            text = message(self._number, point, part)
            self._keep(point, text)
            for viewer in [one for one in self._viewers if one.gets(point)]:
                self._give(viewer, text)

    def tell(self, message_tree: dict[str, Any]) -> None:
        """Send something other than rows to every viewer; it is not kept."""
        text = json.dumps(message_tree, separators=(",", ":"))
        for viewer in list(self._viewers):
            self._give(viewer, text)

    def enter(self, points: frozenset[str] | None, after: int | None, *, head: bool = False) -> Viewer:
        """A viewer that first gets what is kept after a sequence number; where some of it is gone, that is said."""
        viewer = Viewer(points, head)
        if after is not None:
            first, texts, room = self._number + 1, deque[str](), MAX_WAITING_BYTES // 2
            for number, _, point, text in reversed(self._kept):
                if number <= after or room < len(text):
                    break
                first = number
                if viewer.gets(point):
                    texts.appendleft(text)
                    room -= len(text)
            if after + 1 < first:
                viewer.put(json.dumps({"type": "gap", "after": after, "first": first}))
            for text in texts:
                viewer.put(text)
        self._viewers.add(viewer)
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """A viewer has gone."""
        self._viewers.discard(viewer)

    def _give(self, viewer: Viewer, text: str) -> None:
        viewer.put(text)
        if viewer.dropped.is_set():
            self._viewers.discard(viewer)
            self.dropped += 1

    def _keep(self, point: str, text: str) -> None:
        now_ns = time.monotonic_ns()
        self._kept.append((self._number, now_ns, point, text))
        self._kept_bytes += len(text)
        while self._kept_bytes > MAX_KEPT_BYTES or now_ns - self._kept[0][1] > KEPT_S * NANOSECONDS:
            self._kept_bytes -= len(self._kept.popleft()[3])


def newest_of(rows: NDArray[Any]) -> dict[str, Any]:
    """The newest of some rows, as a point's state has it."""
    last = rows[-1]
    return {
        "time_ns": int(last["time_ns"]),
        "displacement_mm": _finite(float(last["displacement_mm"])),
        "displacement_std_mm": _finite(float(last["displacement_std_mm"])),
        "status": WORDS["status"][int(last["status"])],
    }


def message(number: int, point: str, rows: NDArray[Any]) -> str:
    """Rows as a viewer gets them: times in ns (UTC), values and deviations in mm, words."""
    words = WORDS["status"]
    status = [words[code] for code in rows["status"].tolist()]
    tree = {"sequence": number, "point": point, **_columns(rows), "status": status}
    return json.dumps(tree, separators=(",", ":"))


def head_message(point: str, rows: NDArray[Any]) -> str:
    """The same of rows that are not final: without a number, as nothing of them is kept."""
    return json.dumps({"type": "head", "point": point, **_columns(rows)}, separators=(",", ":"))


def _columns(rows: NDArray[Any]) -> dict[str, Any]:
    values, stds = np.round(rows["displacement_mm"], 6), np.round(rows["displacement_std_mm"].astype(np.float64), 6)
    return {"time": rows["time_ns"].tolist(), "displacement_mm": plain(values), "displacement_std_mm": plain(stds)}


def plain(values: NDArray[Any]) -> list[float | None]:
    """Numbers as JSON has them: what is not finite is null."""
    shown = values.astype(object)
    shown[~np.isfinite(values)] = None
    found: list[float | None] = shown.tolist()
    return found


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
