"""The groups of a running site: once a second what came is filtered, kept, published, and then acknowledged."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from midspan.engine.point import PointStatus
from midspan.errors import DataError, MidspanError
from midspan.records import Event, GroupRows
from midspan.service.group import Group, GroupSecond, Inbox, numbered
from midspan.service.group_results import WHY, joined_runs, result_blocks, state_payload
from midspan.service.live_socket import ROW, Tree
from midspan.service.mqtt import Broker
from midspan.service.packets import Receipt
from midspan.service.reasons import sentence
from midspan.settings.group import GroupPlan
from midspan.settings.site import Site
from midspan.store.group_rows import GroupChunk
from midspan.store.store import Batch, Store

# Events of single points of a group a second at most; of more the group has one that counts them.
MAX_EVENTS = 20
# States of points that are retained a second at most; the others follow.
MAX_STATES = 1000
# Messages that are not acknowledged while the store is away, at most: below MAX_UNACKNOWLEDGED of the broker.
MAX_UNKEPT = 50_000
# Points without good rows that a state names at most; the others are counted.
MAX_NAMED = 20
# Rows of points that a viewer looks at are sent for so long after it asked, s, and of this number at most.
WATCHED_S, MAX_WATCHED = 15.0, 1000


@dataclass(frozen=True, slots=True)
class Given:
    """What the service publishes after a second of all groups: events by point, and rows of points that are watched."""

    events: list[tuple[str, Event]] = field(default_factory=list)
    frames: list[tuple[str, bytes]] = field(default_factory=list)


class Groups:
    """put: takes what is to be kept; say: a line for a person. `begin` and `second` are called in threads."""

    def __init__(self, put: Callable[[Batch], None], say: Callable[[str], None]) -> None:
        self._put, self._say, self._in_use = put, say, threading.Lock()
        self._groups: dict[str, Group] = {}
        self._sequences: dict[str, Any] = {}
        self._receipts: list[Receipt] = []
        # The broker's connection by which states were retained last.
        self._connection = 0
        self._watched: dict[str, float] = {}

    def begin(self, plans: Sequence[GroupPlan], store: Store) -> None:
        """Go on with these groups: those that run already as they are, others from what the store has of them."""
        with self._in_use:
            before = self._groups
            self._groups = {plan.name: self._begun(plan, before.get(plan.name), store) for plan in plans}
            self._sequences = {
                name: self._sequences[name] if name in before and before[name] is one else _counts(one)
                for name, one in self._groups.items()
            }

    def _begun(self, plan: GroupPlan, before: Group | None, store: Store) -> Group:
        if before is not None and before.plan == plan:
            return before
        try:
            kept = store.group_checkpoint(plan.key)
            fresh = Group.begun(plan) if kept is None else Group.begun(plan, kept[1], kept[0])
        except (DataError, ValueError) as error:
            self._say(f"{plan.name}: the stored state cannot be used ({error}); its filters begin anew.")
            fresh = Group.begun(plan)
        if before is not None and before.topics.keys() == fresh.topics.keys():
            # What came and was not read yet is not lost.
            fresh.inboxes = before.inboxes
        return fresh

    def has_point(self, name: str) -> bool:
        """Whether a point of this name is in a group."""
        return any(one.plan.number(name) is not None for one in self._groups.values())

    @property
    def points(self) -> int:
        """How many points the groups have."""
        return sum(len(one.plan.numbers) for one in self._groups.values())

    @property
    def inboxes(self) -> dict[str, tuple[Inbox, int]]:
        """Where messages of each topic go."""
        return {topic: place for one in self._groups.values() for topic, place in one.topics.items()}

    def second(self, now_ns: int, broker: Broker | None) -> Given:
        """Filter what came, hand it over to be kept and publish it."""
        with self._in_use:
            return self._second(now_ns, broker)

    def _second(self, now_ns: int, broker: Broker | None) -> Given:
        given = Given()
        if broker is not None and broker.connection != self._connection:
            # What an earlier connection was to retain may be lost.
            self._connection = broker.connection
            for one in self._groups.values():
                one.standings.forget_published()
        for one in list(self._groups.values()):
            second = one.second(now_ns)
            events = fewer(one.plan.name, second.events)
            self._put(_batch(one, second, events))
            self._receipts += second.receipts
            given.events.extend(events)
            given.frames.extend(self._frames(one, second.rows))
            if broker is not None and broker.connected:
                broker.publish_results(self._results(one, second.rows))
                self._retain_states(one, broker)
        return given

    def receipts(self, *, kept: bool) -> list[Receipt]:
        """What may be acknowledged; kept: whether all that was handed over is. Of what is not kept, the broker holds
        as much as it may: then it is asked for more.
        """
        end = len(self._receipts) - (0 if kept else MAX_UNKEPT)
        receipts = self._receipts[: max(end, 0)]
        del self._receipts[: max(end, 0)]
        return receipts

    def _results(self, one: Group, rows: GroupRows) -> list[tuple[str, bytes]]:
        sequence = self._sequences[one.plan.name]
        return [(f"{one.name(place)}/displacement", body) for place, body in result_blocks(joined_runs(rows), sequence)]

    def _retain_states(self, one: Group, broker: Broker) -> None:
        """Retain how points stand that stand otherwise than what is retained, some of them a second."""
        for place in one.standings.changed(MAX_STATES):
            name = one.name(place)
            if not broker.publish(f"{name}/state", state_payload(one.standings.tree(place, name)), retain=True):
                # The others follow the next time.
                return
            one.standings.is_published(place)

    # For the page

    def watch(self, head: Tree) -> Tree:
        """Send rows of the points that the page's server names for a while."""
        now_s, named = time.time(), [str(one) for one in head.get("points", [])]
        known = [name for name in named if self.has_point(name)]
        fresh = {name: until_s for name, until_s in self._watched.items() if until_s > now_s}
        self._watched = dict(list({**fresh, **dict.fromkeys(known, now_s + WATCHED_S)}.items())[-MAX_WATCHED:])
        return {"points": known}

    def _frames(self, one: Group, rows: GroupRows) -> list[tuple[str, bytes]]:
        """Rows of watched points as they go over the local socket."""
        now_s, found = time.time(), list[tuple[str, bytes]]()
        for name, until_s in list(self._watched.items()):
            number = one.plan.number(name)
            if number is not None and until_s > now_s:
                body = row_bytes(rows, one.plan.numbers.index(number))
                found += [(name, body)] if body else []
        return found

    async def table(self, head: Tree) -> tuple[Tree, bytes]:
        """How all points of a group stand: the codes of reasons; each point's newest row, then its reason's place."""
        one = self._groups.get(str(head.get("group")))
        if one is None:
            raise MidspanError(f"{head.get('group')}: is not a group of this site.")
        standings, numbers = one.standings, one.plan.numbers
        newest = standings.newest.copy()
        newest["status"] = standings.status
        head = {"reasons": list(WHY), "numbers": [numbers.start, numbers.stop, numbers.step]}
        return head, newest.tobytes() + standings.why.tobytes()

    def state(self) -> list[Tree]:
        """How the groups stand: counts, and those points that are named."""
        return [_state(one) for one in self._groups.values()]


def _counts(one: Group) -> Any:
    return np.zeros(len(one.plan.numbers), dtype=np.uint32)


def _batch(one: Group, second: GroupSecond, events: Sequence[tuple[str, Event]]) -> Batch:
    """What is kept at once: rows, and the state of the bank after them."""
    rows = numbered(second.rows, one.plan.numbers)
    chunk = GroupChunk(one.plan.name, rows, (one.until_ns, second.state), one.plan.part)
    # Nothing came: the state is kept already.
    return Batch(events=events, groups=[chunk] if second.receipts or len(rows.point) else [])


def fewer(group: str, events: Sequence[tuple[str, Event]]) -> list[tuple[str, Event]]:
    """The first events of points, and of the others how many there are of each kind as events of the group."""
    more = events[MAX_EVENTS:]
    newest = {event.kind: event for _, event in more}
    counts = Counter(event.kind for _, event in more)
    return [
        *events[:MAX_EVENTS],
        *((group, Event(one.time_ns, kind, f"{group}: {counts[kind]} more points: {one.text}"))
          for kind, one in newest.items()),
    ]  # fmt: skip


def row_bytes(rows: GroupRows, place: int) -> bytes:
    """Rows of one point as they go over the local socket; empty without any."""
    starts = np.cumsum(rows.count, dtype=np.int64) - rows.count
    parts = []
    for run in np.flatnonzero(rows.point == place).tolist():
        count, at = int(rows.count[run]), int(starts[run])
        part = np.empty(count, dtype=ROW)
        part["time_ns"] = rows.t0_ns[run] + rows.dt_ns[run] * np.arange(count)
        part["displacement_mm"] = 1e3 * rows.displacement_m[at : at + count]
        part["displacement_std_mm"] = 1e3 * rows.std_m[at : at + count]
        part["status"] = rows.status[run]
        parts.append(part.tobytes())
    return b"".join(parts)


def _state(one: Group) -> Tree:
    """How a group stands, as the page's server has it."""
    standings, numbers = one.standings, one.plan.numbers
    counts = np.bincount(standings.why, minlength=len(WHY)).tolist()
    statuses = np.bincount(standings.status, minlength=len(PointStatus)).tolist()
    wrong = np.flatnonzero(standings.why)
    named = [standings.tree(place, one.name(place)) for place in wrong[:MAX_NAMED].tolist()]
    return {
        "group": one.plan.name,
        "numbers": [numbers.start, numbers.stop, numbers.step],
        "reasons": {why: count for why, count in zip(WHY, counts, strict=True) if why and count},
        "statuses": {status.name.lower(): statuses[status] for status in PointStatus if statuses[status]},
        "points": named,
        "messages": one.messages,
        "faults": one.faults,
    }


def group_sources(groups: Sequence[Mapping[str, Any]]) -> list[Tree]:
    """Groups of which points give no good rows, as sources of the site."""
    return [
        {
            "point": "", "source": str(one["group"]), "reason": why,
            "text": f"{count} points of {one['group']}: {sentence(why)}",
        }
        for one in groups
        for why, count in one["reasons"].items()
    ]  # fmt: skip


def ended_points(before: Site, after: Site) -> list[str]:
    """The points of groups that a site has no more."""
    kept = {plan.name: plan.numbers for plan in after.groups}
    ended = [(plan, set(plan.numbers).difference(kept.get(plan.name, ()))) for plan in before.groups]
    return [plan.point(number) for plan, numbers in ended for number in sorted(numbers)]
