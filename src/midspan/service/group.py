"""One group of a running site: its messages become blocks, its bank filters them, its points stand somehow."""

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple

import numpy as np

from midspan.engine.bank import Bank, BankBlocks, BankCode, BankSensor, BankSettings
from midspan.records import NANOSECONDS, Event, GroupRows
from midspan.service.group_messages import OF_ALL, PointBlocks, Refusals, not_ahead, of_all, of_points
from midspan.service.group_results import Standings
from midspan.service.packets import Receipt
from midspan.settings.group import NUMBER, GroupPlan, topic_of
from midspan.sources.live.blocks import MAX_BYTES
from midspan.sources.live.instants import SourceFault

# Of a group this waits at most; of it so much is filtered at once, once a second: half a minute of 1000 points.
MAX_WAITING_BYTES, MAX_TAKEN_BYTES = 64_000_000, 16_000_000
# A message waits so long for room, s: below the time after which the broker takes us for gone.
ROOM_WAIT_S = 10.0
# What cannot be used is an event of the group so often, s.
TELL_AGAIN_S = 60.0
# What came is filtered in steps of this length: the bank keeps 40 s of 100 Hz of a sensor for the other one.
SLICE_NS = 8 * NANOSECONDS
# Of one message of all points at most this many bytes a point: 250 values.
POINT_BYTES = 1000
# Besides, of head and topic.
HEAD_BYTES = 70_000
# Kind and text of the event that each code of the bank is.
EVENTS = {
    BankCode.LATE: ("late", "Readings came after the rows that they belong to and are left out."),
    BankCode.OVERFLOW: ("overflow", "Too many readings wait for the other sensor; the newest are left out."),
    BankCode.SHIFTED: ("level_shift", "The displacement has shifted for good; the standard deviation includes it."),
    BankCode.LOST: ("lost", "No displacement is accepted any more."),
    BankCode.TRACKING: ("returned", "Displacements are accepted again."),
    BankCode.FROZEN: ("frozen", "The displacement sensor repeats one value, which is left out from now on."),
}
# Those that come with each block while they last: they are counted.
REPEATED = (BankCode.LATE, BankCode.OVERFLOW)


class Message(NamedTuple):
    """A message of a sensor (0: acceleration, 1: displacement) of the point at a place of the bank; receipt: what it is
    acknowledged with.
    """

    sensor: int
    place: int
    payload: bytes
    receipt: Receipt


class Waiting:
    """Messages of a group in the order in which they came, of both sensors together, so that neither runs ahead.

    `put` is called from the broker's thread, and waits for room: what the broker has meanwhile stays there.
    """

    def __init__(self) -> None:
        self._messages = deque[Message]()
        self._bytes, self._lost, self._changed = 0, 0, threading.Condition()

    def put(self, message: Message) -> bool:
        """Queue a message; whether there was room in time."""
        size = len(message.payload)
        with self._changed:
            if self._bytes and self._bytes + size > MAX_WAITING_BYTES:
                self._changed.wait_for(lambda: self._bytes + size <= MAX_WAITING_BYTES, ROOM_WAIT_S)
            if self._bytes and self._bytes + size > MAX_WAITING_BYTES:
                self._lost += 1
                return False
            self._bytes += size
            self._messages.append(message)
        return True

    def take(self) -> tuple[list[Message], int]:
        """The first messages, as many as are filtered at once, and how many were lost since the last time."""
        taken, size = list[Message](), 0
        with self._changed:
            while self._messages and size < MAX_TAKEN_BYTES:
                taken.append(self._messages.popleft())
                size += len(taken[-1].payload)
            lost, self._lost = self._lost, 0
            self._bytes -= size
            self._changed.notify_all()
        return taken, lost


@dataclass(frozen=True, slots=True)
class Inbox:
    """Where messages of one sensor of a group go; kind: of its blocks, shared: whether one has those of all points."""

    waiting: Waiting
    sensor: int
    kind: int
    shared: bool

    def put(self, place: int, payload: bytes, receipt: Receipt) -> bool:
        """See `Waiting.put`."""
        return self.waiting.put(Message(self.sensor, place, payload, receipt))


@dataclass(frozen=True, slots=True)
class GroupSecond:
    """What a group gave at once: rows, events by point, the bank's state after them, and what may be acknowledged."""

    rows: GroupRows
    events: list[tuple[str, Event]]
    state: bytes
    receipts: list[Receipt]


@dataclass(slots=True)
class Group:
    """plan: of the group; bank: its filter; kept_ns: up to when the broker brings again what was not acknowledged
    before a restart, or before another connection. Times are arguments.
    """

    plan: GroupPlan
    bank: Bank
    kept_ns: int = 0
    # The newest stamp of all blocks that came: points without blocks go on, or end, by that.
    until_ns: int = 0
    inboxes: tuple[Inbox, Inbox] = field(init=False)
    standings: Standings = field(init=False)
    messages: int = 0
    faults: int = 0
    _refused: Refusals = field(default_factory=Refusals)
    _reported_s: float = -TELL_AGAIN_S
    # That the newest message came by, None before the first.
    _connection: int | None = None

    def __post_init__(self) -> None:
        settings = self.plan.settings
        addresses = (settings.accelerometer, settings.displacement)
        shared = [NUMBER not in one for one in addresses]
        kinds = [OF_ALL[kind] if one else kind for kind, one in zip((1, 2), shared, strict=True)]
        waiting = Waiting()
        self.inboxes = Inbox(waiting, 0, kinds[0], shared[0]), Inbox(waiting, 1, kinds[1], shared[1])
        self.standings = Standings(len(self.plan.numbers))

    @classmethod
    def begun(cls, plan: GroupPlan, state: bytes | None = None, kept_ns: int = 0) -> "Group":
        """A group that nothing has come for yet, or that goes on from its bank's state; kept_ns: of when that is."""
        settings = plan.settings
        slow_std = settings.displacement_slow_std or settings.displacement_noise_std
        own = BankSettings(
            acceleration_std_m_s2=settings.accelerometer_noise_std * plan.accelerometer_factor,
            displacement_std_m=settings.displacement_noise_std * plan.displacement_factor,
            slow_std_m=slow_std * plan.displacement_factor,
        )
        bank = None if state is None else Bank.restored(state, own)
        # A group that has more or fewer points than before begins anew.
        if bank is None or len(bank) != len(plan.numbers):
            return cls(plan, Bank(len(plan.numbers), own))
        return cls(plan, bank, kept_ns, kept_ns)

    @property
    def topics(self) -> dict[str, tuple[Inbox, int]]:
        """By each topic the inbox of its sensor, and the place in the bank of the point that it is of."""
        found = dict[str, tuple[Inbox, int]]()
        addresses = (self.plan.settings.accelerometer, self.plan.settings.displacement)
        for address, inbox in zip(addresses, self.inboxes, strict=True):
            numbers = self.plan.numbers[:1] if inbox.shared else self.plan.numbers
            found |= {topic_of(address, number): (inbox, place) for place, number in enumerate(numbers)}
        return found

    def name(self, place: int) -> str:
        """The name of the point at a place of the bank."""
        return self.plan.point(self.plan.numbers[place])

    def second(self, now_ns: int) -> GroupSecond:
        """Filter what came, up to the newest stamp of all blocks."""
        taken, lost = self.inboxes[0].waiting.take()
        if lost:
            self._refused.add(SourceFault("overflow", "more came than could be filtered"), lost)
        came = list[tuple[int, PointBlocks]]()
        for inbox in self.inboxes:
            for blocks in self._blocks(inbox, [one for one in taken if one.sensor == inbox.sensor], now_ns):
                self.standings.heard(inbox.sensor, blocks.point, now_ns / NANOSECONDS)
                came.append((inbox.sensor, blocks))
        rows = joined([self._filtered(part) for part in _slices(came)])
        self.standings.given(rows, now_ns / NANOSECONDS)
        self.standings.look(now_ns / NANOSECONDS)
        self._look_at_connection(taken)
        events = [*self._events(), *self._reports(now_ns)]
        return GroupSecond(rows, events, self.bank.state(), [one.receipt for one in taken])

    def _filtered(self, came: Sequence[tuple[int, PointBlocks]]) -> GroupRows:
        """The rows of blocks by their sensor."""
        factors = (self.plan.accelerometer_factor, self.plan.displacement_factor)
        for sensor, blocks in came:
            self.until_ns = max(self.until_ns, int(blocks.end_ns.max()))
            self.bank.push(_in_si(sensor, blocks, factors[sensor]))
        return self.bank.rows(self.until_ns)

    def _blocks(self, inbox: Inbox, taken: Sequence[Message], now_ns: int) -> list[PointBlocks]:
        """Messages as blocks without what cannot be used, which is counted."""
        self.messages += len(taken)
        found = list[PointBlocks]()
        if not inbox.shared:
            places, payloads = [one.place for one in taken], [one.payload for one in taken]
            found = of_points(inbox.kind, places, payloads, self._refused)
        for one in taken if inbox.shared else ():
            try:
                blocks = of_all(inbox.kind, self.plan.settings.points, self.plan.numbers, one.payload)
            except SourceFault as fault:
                self._refused.add(fault)
            else:
                found += [] if blocks is None else [blocks]
        usable = (not_ahead(one, now_ns, self._refused) for one in found)
        return [one for one in usable if one is not None]

    def _look_at_connection(self, taken: Sequence[Message]) -> None:
        connection = taken[-1].receipt.connection if taken else self._connection
        if self._connection not in (None, connection):
            self.kept_ns = self.until_ns
        self._connection = connection

    def _events(self) -> list[tuple[str, Event]]:
        found = []
        for place, time_ns, code in self.bank.events():
            if code is BankCode.LATE and time_ns <= self.kept_ns:
                continue
            kind, text = EVENTS[code]
            if code in REPEATED:
                self._refused.add(SourceFault(kind, f"{self.name(place)}: {text}"))
            else:
                found.append((self.name(place), Event(time_ns, kind, text)))
        return found

    def _reports(self, now_ns: int) -> list[tuple[str, Event]]:
        """What could not be used since that was last an event of the group."""
        if not self._refused.count or now_ns / NANOSECONDS - self._reported_s < TELL_AGAIN_S:
            return []
        refused, self._refused, self._reported_s = self._refused, Refusals(), now_ns / NANOSECONDS
        self.faults += refused.count
        start = f"{self.plan.name}: blocks that could not be used whole: "
        return [
            (self.plan.name, Event(now_ns, code, f"{start}{count}, such as: {refused.texts[code]}"))
            for code, count in refused.counts.items()
        ]


def _slices(came: Sequence[tuple[int, PointBlocks]]) -> list[list[tuple[int, PointBlocks]]]:
    """Blocks by the time that they begin in, the earliest first: of what came while the service was away, one sensor's
    readings are not to wait for those of the other until there is no room.
    """
    if not came:
        return [[]]
    slots = [blocks.t0_ns // SLICE_NS for _, blocks in came]
    numbers = np.unique(np.concatenate(slots))
    if len(numbers) == 1:
        return [list(came)]
    return [
        [(sensor, blocks.part(slot == number)) for (sensor, blocks), slot in zip(came, slots, strict=True)
         if (slot == number).any()]
        for number in numbers
    ]  # fmt: skip


def joined(parts: Sequence[GroupRows]) -> GroupRows:
    """Rows of times that follow one another, those of each point together."""
    if len(parts) == 1:
        return parts[0]
    whole = GroupRows(*(np.concatenate([getattr(one, each.name) for one in parts]) for each in fields(GroupRows)))
    order = np.argsort(whole.point, kind="stable")
    count = whole.count[order].astype(np.int64)
    starts = (np.cumsum(whole.count, dtype=np.int64) - whole.count)[order]
    rows = np.repeat(starts - (np.cumsum(count) - count), count) + np.arange(count.sum())
    return GroupRows(
        whole.point[order], whole.t0_ns[order], whole.dt_ns[order], whole.count[order], whole.status[order],
        whole.displacement_m[rows], whole.std_m[rows], whole.velocity_m_s[rows],
    )  # fmt: skip


def _in_si(sensor: int, blocks: PointBlocks, factor: float) -> BankBlocks:
    """Blocks as the bank takes them."""
    values = blocks.values if factor == 1.0 else factor * blocks.values.astype(np.float64)
    return BankBlocks(BankSensor(sensor), blocks.point, blocks.t0_ns, blocks.dt_ns, blocks.count, values)


def numbered(rows: GroupRows, numbers: range) -> GroupRows:
    """Rows by place in the bank as rows by the group's numbers."""
    if numbers.start == 0 and numbers.step == 1:
        return rows
    return replace(rows, point=(numbers.start + numbers.step * rows.point).astype(np.uint32))


def max_bytes_of(plans: Sequence[GroupPlan]) -> int:
    """Bytes of a message at most: more where one has the blocks of all points of a group."""
    return max([MAX_BYTES, *(HEAD_BYTES + POINT_BYTES * plan.settings.points for plan in plans)])
