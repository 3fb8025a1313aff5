"""How an opened point gets its records: at once, or later those that came while it could not take them."""

from dataclasses import dataclass, field, replace
from typing import Any

from midspan.errors import MidspanError
from midspan.records import NANOSECONDS, Arrival, Event, RangeFrame, Readings, Tick
from midspan.service.opening import Opened
from midspan.service.waiting import Waiting, stamp_of
from midspan.sources.radar.radar_source import at_bins

# So many of the records that wait are given to the point at once, at least: a tenth of a second of work, after which
# the service answers again. And twice as many as came since the last time, so that the queue becomes shorter.
AT_ONCE, TIMES_AS_MANY = 32, 2
# A sender is waited for when its broker is back: as long again as that was away, since senders double their pauses, but
# so long at least and at most, s: a second for the session, and what paho waits between two attempts at most.
MIN_RETURN_S, MAX_RETURN_S = 5.0, 120.0


@dataclass(slots=True)
class Feeding:
    """Gives records to an opened point; they wait while `hold` is asked for, and behind others that wait.

    waiting: those that came before it was opened are among them, and are kept already.
    """

    opened: Opened
    waiting: Waiting
    _from_ns: dict[str, int] = field(default_factory=dict)
    # Whether the engine knows how late it is before it gets what waited.
    _released: bool = True
    _ticked: bool = False
    _refused: bool = False
    _came: int = 0

    def __post_init__(self) -> None:
        self._from_ns = dict(self.opened.newest_ns)

    def push(self, arrival: Arrival, *, hold: bool) -> None:
        """Give a record to the point, or let it wait; readings are kept at once."""
        if isinstance(arrival.record, Readings):
            self.opened.journal.arrived(arrival)
        if hold or len(self.waiting):
            self._released = self._released and not hold
            self._came += 1
            self.waiting.append(arrival)
        else:
            self._run(arrival)

    def tick(self, now_ns: int) -> None:
        """Give a part of what waits to the point, and the shell's time where nothing waits any more."""
        if not self._released:
            # That nobody listened meanwhile has to be known before the first record.
            self._released = True
            if self._ticked:
                self._give(Tick(now_ns))
        self.catch_up()
        if not len(self.waiting):
            self._ticked = True
            self._give(Tick(now_ns))

    def catch_up(self) -> None:
        """Give a part of what waits to the point."""
        count, self._came = max(AT_ONCE, TIMES_AS_MANY * self._came), 0
        for _ in range(min(len(self.waiting), count)):
            try:
                arrival = self.waiting.popleft()
            except OSError as error:
                self._refuse(Event(self._newest_ns, "damaged", f"A frame that waited cannot be read: {error}."))
                continue
            if stamp_of(arrival) > self._from_ns.get(arrival.stream, -(2**62)):
                self._run_late(arrival)
        self._refused = self._refused and len(self.waiting) > 0

    def _run_late(self, arrival: Arrival) -> None:
        """One that cannot be used leaves the others alone; the first of those that wait together is an event."""
        try:
            self._run(arrival)
        except MidspanError as error:
            self._refuse(Event(stamp_of(arrival), "damaged", f"{arrival.stream}: {error}"))

    def _refuse(self, event: Event) -> None:
        if not self._refused:
            self._refused = True
            self.opened.journal.given([event])

    @property
    def _newest_ns(self) -> int:
        return max(self.opened.newest_ns.values(), default=0)

    def _run(self, arrival: Arrival) -> None:
        found = self.opened
        sequence = found.counts.get(arrival.stream, -1) + 1
        found.counts[arrival.stream] = sequence
        if not isinstance(arrival.record, Event):
            found.newest_ns[arrival.stream] = max(stamp_of(arrival), found.newest_ns.get(arrival.stream, -(2**62)))
        numbered = Arrival(arrival.stream, sequence, at_targets(arrival, found))
        if not isinstance(arrival.record, Readings):
            found.journal.arrived(numbered)
        self._give(numbered)

    def _give(self, record: Arrival | Tick) -> None:
        self.opened.journal.given(self.opened.point.push(record))


@dataclass(frozen=True, slots=True)
class Absence:
    """Of the broker that brings the acceleration: since_ns, when it was found away; until_ns: up to when its sender is
    waited for after it came back.
    """

    since_ns: int | None = None
    until_ns: int | None = None

    def after(self, now_ns: int, *, away: bool) -> "Absence":
        """At a tick."""
        if away:
            return Absence(now_ns if self.since_ns is None else self.since_ns)
        if self.since_ns is not None:
            least_ns, most_ns = (round(one * NANOSECONDS) for one in (MIN_RETURN_S, MAX_RETURN_S))
            return Absence(None, now_ns + min(max(now_ns - self.since_ns, least_ns), most_ns))
        return Absence() if self.until_ns is not None and now_ns >= self.until_ns else self

    def heard(self) -> "Absence":
        """After a record of the accelerometer."""
        return self if self.since_ns is not None else Absence()

    @property
    def waits(self) -> bool:
        """Whether the accelerometer is waited for."""
        return self.since_ns is not None or self.until_ns is not None

    @property
    def reason(self) -> str:
        """Why it is waited for, as a code; empty where it is not."""
        return "broker_gone" if self.since_ns is not None else "silent" if self.waits else ""


def at_targets(arrival: Arrival, found: Opened) -> Any:
    """A record as the point takes it: of a radar's profile only the bins of its targets."""
    record = arrival.record
    if not isinstance(record, RangeFrame):
        return record
    return replace(record, phasors=at_bins(record.phasors[None], found.bins[arrival.stream])[0])
