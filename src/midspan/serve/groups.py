"""Points of groups as the interface shows them: those of a group are asked of the engine at once, and kept a second."""

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.engine.point import PointStatus
from midspan.errors import MidspanError
from midspan.records import member_name, member_of
from midspan.serve import reading
from midspan.serve.engine_link import EngineLink
from midspan.service.live_socket import ROW, Tree
from midspan.service.reasons import sentence

# How the points of a group stand is asked for so often at most, s; what viewers look at is sent on for so long.
TABLE_S, WATCH_S = 1.0, 5.0
# Rows of points that a page lists come for so long, s: it lists them twice a minute. No more points than this.
LOOK_S, MAX_LOOKED = 45.0, 200


@dataclass(frozen=True, slots=True)
class GroupTable:
    """How the points of a group stand: by place the newest row, and the place of its reason in `reasons`."""

    name: str
    numbers: range
    reasons: list[str]
    newest: NDArray[np.void]
    why: NDArray[np.uint8]

    def in_order(self) -> list[int]:
        """The places of points: first those with a reason."""
        fine = self.why == 0
        return [*np.flatnonzero(~fine).tolist(), *np.flatnonzero(fine).tolist()]

    def state(self, place: int, now_s: float, away: str) -> Tree:
        """A point as `PointState` has it; away: why no process measures it, empty where one does."""
        row, reason = self.newest[place], away or self.reasons[self.why[place]]
        time_ns = int(row["time_ns"])
        value, std = float(row["displacement_mm"]), float(row["displacement_std_mm"])
        return {
            "name": f"{self.name}-{self.numbers[place]}",
            "status": None if away else PointStatus(int(row["status"])).name.lower(),
            "reason": reason,
            "text": sentence(reason) if reason else "",
            "displacement_mm": value if np.isfinite(value) else None,
            "displacement_std_mm": std if np.isfinite(std) else None,
            "time": reading.iso(time_ns) if time_ns else None,
            "age_s": reading.age_s(time_ns, now_s) if time_ns else None,
        }


class GroupTables:
    """link: to the engine, whose newest state has the groups."""

    def __init__(self, link: EngineLink) -> None:
        self._link = link
        self._tables: dict[str, tuple[float, GroupTable]] = {}
        self._watched: dict[str, float] = {}
        self._looked: dict[str, float] = {}

    def _numbers(self) -> Iterator[tuple[str, range]]:
        for one in self._link.state.get("groups", []):
            yield str(one["group"]), range(*one["numbers"])

    def names(self) -> list[str]:
        """The points of all groups."""
        return [member_name(name, number) for name, numbers in self._numbers() for number in numbers]

    def number(self, point: str) -> tuple[str, int] | None:
        """The group of a point, and its number there; None for what is no point of a group."""
        group, number = member_of(point) or ("", 0)
        return (group, number) if number in dict(self._numbers()).get(group, range(0)) else None

    async def table(self, group: str) -> GroupTable | None:
        """How the points of a group stand; None where no engine says so."""
        then_s, kept = self._tables.get(group, (-TABLE_S, None))
        if kept is not None and (self._link.reason or time.monotonic() - then_s < TABLE_S):
            return kept
        with suppress(MidspanError):
            head, body = await self._link.ask("group", group=group)
            # As they are with this answer: the settings may have changed meanwhile.
            numbers = range(*head["numbers"])
            newest = np.frombuffer(body, dtype=ROW, count=len(numbers))
            why = np.frombuffer(body, dtype=np.uint8, offset=newest.nbytes)
            table = GroupTable(group, numbers, [str(one) for one in head["reasons"]], newest, why)
            self._tables[group] = (time.monotonic(), table)
            return table
        return None

    async def state(self, point: str) -> Tree | None:
        """A point of a group as `PointState` has it; None for another one, and where no engine says so."""
        if (found := self.number(point)) is None:
            return None
        group, number = found
        table = await self.table(group)
        if table is None or number not in table.numbers:
            return None
        return table.state(table.numbers.index(number), time.time(), self._link.reason)

    async def states(self, most: int | None) -> list[Tree]:
        """The points of all groups, of each this many at most: first those with a reason."""
        found = list[Tree]()
        for group, _ in list(self._numbers()):
            table, now_s = await self.table(group), time.time()
            if table is not None:
                found += [table.state(place, now_s, self._link.reason) for place in table.in_order()[:most]]
        return found

    def look(self, points: list[str]) -> None:
        """A page lists these points: let their rows come for a while."""
        until_s = time.monotonic() + LOOK_S
        self._looked = dict(list({**self._looked, **dict.fromkeys(points, until_s)}.items())[-MAX_LOOKED:])

    @property
    def looked(self) -> frozenset[str]:
        """The points that a page lists."""
        now_s = time.monotonic()
        return frozenset(name for name, until_s in self._looked.items() if until_s > now_s)

    async def watch(self, points: frozenset[str]) -> None:
        """Let the engine send the rows of those of these points that are of groups."""
        now_s = time.monotonic()
        if points.issubset(self._watched) and all(now_s - self._watched[one] < WATCH_S for one in points):
            return
        self._watched = dict.fromkeys(points, now_s)
        with suppress(MidspanError):
            await self._link.ask("watch", points=sorted(points))


def ready(groups: list[dict[str, Any]]) -> list[Tree]:
    """The points of groups that are named, as /readyz shows points."""
    nothing = {"rows_age_s": None, "sigma_mm": None, "usual_sigma_mm": None}
    return [{**one, **nothing} for group in groups for one in group["points"]]
