"""What a group gives out: a second of rows of each point as one block, kind 3, and how its points stand."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from midspan.engine.point import PointStatus
from midspan.records import Floats, GroupRows, Nanoseconds
from midspan.service.group_messages import FIELDS
from midspan.service.live_socket import ROW
from midspan.service.pace import AVERAGED, FRESH_INTERVALS, FRESH_S, MAX_FIRST_S
from midspan.service.reasons import sentence
from midspan.sources.live.blocks import RESULT, VERSION

# Of neither a reason nor a status.
UNPUBLISHED = 255
# Why a point gives no rows that can be relied on, as codes of the documentation's table.
WHY = ("", "starting", "opening", "silent", "no_rows", "lost")
FINE, STARTING, OPENING, SILENT, NO_ROWS, LOST = range(len(WHY))


def ends_of(rows: GroupRows) -> Nanoseconds:
    """Stamps (k,) of the last rows of runs."""
    return rows.t0_ns + rows.dt_ns * (rows.count.astype(np.int64) - 1)


def joined_runs(rows: GroupRows) -> GroupRows:
    """The same rows with runs that follow one another evenly as one, whatever their status, which is the last one's."""
    follows = (rows.point[1:] == rows.point[:-1]) & (rows.dt_ns[1:] == rows.dt_ns[:-1])
    follows &= rows.t0_ns[1:] == ends_of(rows)[:-1] + rows.dt_ns[:-1]
    first = np.flatnonzero(np.concatenate(([True], ~follows)))
    if not len(rows.point) or len(first) == len(rows.point):
        return rows
    last = np.append(first[1:], len(rows.point)) - 1
    count = np.add.reduceat(rows.count.astype(np.int64), first).astype(np.uint32)
    values = (rows.displacement_m, rows.std_m, rows.velocity_m_s)
    return GroupRows(rows.point[first], rows.t0_ns[first], rows.dt_ns[first], count, rows.status[last], *values)


def result_blocks(rows: GroupRows, sequence: NDArray[np.uint32]) -> Iterator[tuple[int, bytes]]:
    """Each run as a block of mm and their standard deviations, with its point's place, in the order of the runs;
    sequence (points,): counts the blocks of each point on.
    """
    starts = np.cumsum(rows.count, dtype=np.int64) - rows.count
    by_point = np.argsort(rows.point, kind="stable")
    first = np.searchsorted(rows.point[by_point], rows.point[by_point])
    earlier = np.empty(len(by_point), dtype=np.uint32)
    earlier[by_point] = np.arange(len(by_point)) - first
    bodies = [b""] * len(rows.point)
    for count in np.unique(rows.count).tolist():
        runs = np.flatnonzero(rows.count == count)
        table = np.zeros(len(runs), np.dtype([*FIELDS, ("values", "<f4", (count,)), ("std", "<f4", (count,))]))
        table["version"], table["kind"], table["n"] = VERSION, RESULT, count
        table["t0_ns"], table["dt_ns"] = rows.t0_ns[runs], rows.dt_ns[runs]
        table["sequence"] = sequence[rows.point[runs]] + earlier[runs]
        places = starts[runs, None] + np.arange(count)
        table["values"], table["std"] = 1e3 * rows.displacement_m[places], 1e3 * rows.std_m[places]
        body, size = table.tobytes(), table.itemsize
        for at, run in enumerate(runs.tolist()):
            bodies[run] = body[at * size : (at + 1) * size]
    np.add.at(sequence, rows.point, 1)
    yield from zip(rows.point.tolist(), bodies, strict=True)


def _fresh_s(interval_s: Floats) -> Floats:
    """For how long a block is fresh, by the usual interval of its sensor, NaN where that is not known."""
    return np.fmax(FRESH_S, FRESH_INTERVALS * interval_s)


@dataclass(slots=True)
class Standings:
    """How the points (n,) of a group stand: when each sensor was heard (accelerations, displacements; s, NaN before)
    and its usual interval (s, NaN before the second block), the newest row, when that came (s), and what was published
    of it.
    """

    count: int
    heard_s: Floats = field(init=False)
    interval_s: Floats = field(init=False)
    row_s: Floats = field(init=False)
    newest: NDArray[np.void] = field(init=False)
    why: NDArray[np.uint8] = field(init=False)
    status: NDArray[np.uint8] = field(init=False)
    published: NDArray[np.uint8] = field(init=False)

    def __post_init__(self) -> None:
        self.heard_s, self.interval_s = np.full((2, self.count), np.nan), np.full((2, self.count), np.nan)
        self.row_s, self.newest = np.full(self.count, np.nan), np.zeros(self.count, dtype=ROW)
        self.newest["status"] = PointStatus.WARMING
        self.newest["displacement_mm"] = self.newest["displacement_std_mm"] = np.nan
        self.why = np.full(self.count, STARTING, dtype=np.uint8)
        self.status = self.newest["status"].copy()
        self.published = np.full((2, self.count), UNPUBLISHED, dtype=np.uint8)

    def heard(self, sensor: int, points: NDArray[np.uint32], now_s: float) -> None:
        """Blocks of points came."""
        own = np.unique(points)
        usual_s, passed_s = self.interval_s[sensor, own], now_s - self.heard_s[sensor, own]
        # The first interval is the usual one, unless it is an outage's; an outage counts as much as is still fresh.
        mean_s = usual_s + (np.minimum(passed_s, _fresh_s(usual_s)) - usual_s) / AVERAGED
        mean_s = np.where(np.isnan(usual_s), np.minimum(passed_s, MAX_FIRST_S), mean_s)
        # Blocks that are read at once are one arrival.
        self.interval_s[sensor, own] = np.where(passed_s > 0.0, mean_s, usual_s)
        self.heard_s[sensor, own] = now_s

    def given(self, rows: GroupRows, now_s: float) -> None:
        """Rows were given out."""
        if not len(rows.point):
            return
        # Of several runs of a point the last one counts.
        last = np.cumsum(rows.count, dtype=np.int64) - 1
        self.newest["time_ns"][rows.point], self.newest["status"][rows.point] = ends_of(rows), rows.status
        self.newest["displacement_mm"][rows.point] = 1e3 * rows.displacement_m[last]
        self.newest["displacement_std_mm"][rows.point] = 1e3 * rows.std_m[last]
        self.row_s[rows.point] = now_s

    def look(self, now_s: float) -> None:
        """Judge each point as of now."""
        fresh_s = _fresh_s(self.interval_s)
        silent = (now_s - self.heard_s > fresh_s).any(axis=0)
        unheard, rowless = np.isnan(self.heard_s).any(axis=0), np.isnan(self.row_s)
        # Rows need both sensors.
        no_rows = now_s - self.row_s > fresh_s.max(axis=0)
        lost = self.newest["status"] == PointStatus.LOST
        cases = [silent, unheard & rowless, rowless, no_rows, lost]
        self.why = np.select(cases, [SILENT, STARTING, OPENING, NO_ROWS, LOST], FINE).astype(np.uint8)
        # As the newest row says, and lost once there are none.
        self.status = np.where(no_rows, np.uint8(PointStatus.LOST), self.newest["status"])

    def changed(self, most: int) -> list[int]:
        """Up to this many points that stand otherwise than was published of them."""
        now = np.stack((self.why, self.status))
        points: list[int] = np.flatnonzero((now != self.published).any(axis=0))[:most].tolist()
        return points

    def is_published(self, point: int) -> None:
        """How a point stands is published."""
        self.published[:, point] = self.why[point], self.status[point]

    def forget_published(self) -> None:
        """Whatever was published of the points is no longer there."""
        self.published[:] = UNPUBLISHED

    def tree(self, point: int, name: str) -> dict[str, object]:
        """How a point stands, as the topic `state` has it."""
        why = WHY[self.why[point]]
        status = PointStatus(int(self.status[point])).name.lower()
        return {"point": name, "status": status, "reason": why, "text": sentence(why) if why else ""}


def state_payload(tree: dict[str, object]) -> str:
    """A point's state as it is retained."""
    return json.dumps(tree)
