"""Records of several streams in the order of time: who is waited for, for how long, and what comes too late."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.checks import refuse
from midspan.engine.order import AHEAD, GOOD, KINDS, LAST_NS, LATE, is_new, order, spans, words
from midspan.records import (
    NANOSECONDS,
    Arrival,
    ClockOffset,
    Event,
    Frame,
    Health,
    Nanoseconds,
    RangeFrame,
    Readings,
    StreamState,
    Tick,
    Tracked,
    joined,
    part,
)

# A network connection is opened again within this time; for so long a silent stream holds the others back at most.
SILENT_S = 5.0
# Stamps that far ahead of the first stream, in times of the longest silence, are not waited for: memory is bounded.
MAX_AHEAD = 2


@dataclass(frozen=True, slots=True)
class StreamMemory:
    """What is known of a stream.

    newest_ns, late_ns: its newest stamp, and the newest one that came too late, on the common clock; heard_ns: the tick
    at its newest good record; out: silent for too long; fault: code of what is wrong with its newest record; used,
    late, disordered, lost: counts.
    """

    name: str
    newest_ns: int | None = None
    heard_ns: int | None = None
    sequence: int | None = None
    offset_ns: int = 0
    next_offset: ClockOffset | None = None
    out: bool = False
    fault: int = GOOD
    late_ns: int | None = None
    used: int = 0
    late: int = 0
    disordered: int = 0
    lost: int = 0


@dataclass(frozen=True, slots=True)
class MergeState:
    """All that a `Merge` knows; held: what waits in each stream; released_ns: up to where everything was given out."""

    streams: tuple[StreamMemory, ...]
    held: tuple[tuple[Arrival, ...], ...]
    released_ns: int | None
    now_ns: int | None


class Merge:
    """Takes arrivals of several streams and ticks, and gives the records out in the order of time.

    Readings between two frames or events are one block a stream, that of the first stream last.
    streams: their names; the first one keeps the common clock (the accelerometer), at equal stamps the earlier named
    one comes first. lateness_s: the others are waited for until they are so far behind the first one. silent_s: a
    stream from which nothing comes for so long is out until it returns. For a file both are infinite and `finish`
    gives out what is left: then the order of arrival has no effect.

    What comes after its time was given out is left out, reading by reading, and so is what is doubled or backwards in
    its stream; each run of such records is an Event in its stream, at its place among the stream's records.
    """

    def __init__(self, streams: Sequence[str], lateness_s: float = 0.5, silent_s: float = SILENT_S) -> None:
        if not streams or len(set(streams)) < len(streams):
            raise refuse("streams", "one name or more, each once", list(streams))
        if not (lateness_s >= 0.0 and silent_s > 0.0):
            raise refuse("lateness_s and silent_s", "0 or more and above 0 (s)", (lateness_s, silent_s))
        self._names = {name: number for number, name in enumerate(streams)}
        self._lateness_ns, self._silent_ns = _whole(lateness_s), _whole(silent_s)
        self._streams = [StreamMemory(name) for name in streams]
        self._held: list[deque[Arrival]] = [deque() for _ in streams]
        self._released_ns: int | None = None
        self._now_ns: int | None = None

    @property
    def state(self) -> MergeState:
        """All that has an effect on what comes later."""
        held = tuple(tuple(waiting) for waiting in self._held)
        return MergeState(tuple(self._streams), held, self._released_ns, self._now_ns)

    def restore(self, state: MergeState) -> None:
        """Go on from where `state` was read."""
        if [stream.name for stream in state.streams] != list(self._names):
            raise refuse("state", f"of the streams {list(self._names)}", [stream.name for stream in state.streams])
        self._streams = list(state.streams)
        self._held = [deque(waiting) for waiting in state.held]
        self._released_ns, self._now_ns = state.released_ns, state.now_ns

    @property
    def health(self) -> tuple[Health, ...]:
        """How each stream stands."""
        return tuple(self._health(stream) for stream in self._streams)

    def push(self, record: Arrival | Tick | ClockOffset) -> list[Arrival]:
        """Take a record; returns what is due, in the order of time, on the common clock."""
        if isinstance(record, Tick):
            self._tick(record.now_ns)
        elif isinstance(record, ClockOffset):
            number = self._number(record.stream)
            self._streams[number] = replace(self._streams[number], next_offset=record)
        else:
            self._arrive(self._number(record.stream), record)
        return self._release(self._limit())

    def finish(self) -> list[Arrival]:
        """What still waits, in the order of time."""
        return self._release(self._newest())

    def _newest(self) -> int | None:
        """The newest stamp (ns) of all that waits and all that came."""
        waiting = [_stamp(held[-1]) for held in self._held if held]
        came = [stream.newest_ns for stream in self._streams if stream.newest_ns is not None]
        return max((*waiting, *came), default=None)

    def _number(self, name: str) -> int:
        if name not in self._names:
            raise refuse("stream", f"one of {', '.join(self._names)}", name)
        return self._names[name]

    def _tick(self, now_ns: int) -> None:
        self._now_ns = now_ns if self._now_ns is None else max(now_ns, self._now_ns)
        for number, stream in enumerate(self._streams):
            heard_ns = self._now_ns if stream.heard_ns is None else stream.heard_ns
            silent_ns = self._now_ns - heard_ns
            out = stream.out or (self._silent_ns is not None and silent_ns > self._silent_ns)
            if (heard_ns, out) != (stream.heard_ns, stream.out):
                self._streams[number] = replace(stream, heard_ns=heard_ns, out=out)
            if out and not stream.out:
                text = f"{stream.name}: nothing came for {silent_ns / NANOSECONDS:.3g} s; the others no longer wait."
                self._tell(number, "silent", text)

    def _arrive(self, number: int, arrival: Arrival) -> None:
        stream = self._streams[number]
        if stream.sequence is not None and arrival.sequence > stream.sequence + 1:
            lost = arrival.sequence - stream.sequence - 1
            self._streams[number] = replace(stream, lost=stream.lost + lost)
            self._tell(number, "lost", f"{stream.name}: {lost} records were lost on their way.")
        self._streams[number] = stream = replace(self._streams[number], sequence=arrival.sequence)
        if isinstance(arrival.record, Event):
            self._tell(number, arrival.record.kind, arrival.record.text)
            return
        common_ns, self._streams[number] = on_common_clock(_stamps(arrival.record), stream)
        codes, newest_ns = order(common_ns, stream.newest_ns, self._bound(number))
        if self._released_ns is not None:
            codes[(codes == GOOD) & (common_ns <= self._released_ns)] = LATE
        for start, end, code in spans(codes):
            if code == GOOD:
                self._hold(number, arrival, (start, end), common_ns)
            else:
                self._leave_out(number, code, common_ns[start:end], int(newest_ns[start]))

    def _hold(self, number: int, arrival: Arrival, rows: tuple[int, int], common_ns: Nanoseconds) -> None:
        """Let the readings `rows` (start, end) of an arrival wait for their time."""
        stream, record = self._streams[number], arrival.record
        time_ns = common_ns[slice(*rows)]
        if isinstance(record, Readings):
            record = Readings(time_ns, record.value[slice(*rows)])
        elif record.time_ns != time_ns[0]:
            record = replace(record, time_ns=int(time_ns[0]))
        self._heard(number, int(time_ns[-1]), used=stream.used + len(time_ns))
        self._held[number].append(Arrival(arrival.stream, arrival.sequence, record))

    def _leave_out(self, number: int, code: int, common_ns: Nanoseconds, newest_ns: int) -> None:
        """Count readings (n,) with a fault; the first of a run of them is an event."""
        stream = self._streams[number]
        first_ns, late_ns, pause_ns = int(common_ns[0]), stream.late_ns, self._silent_ns
        # A stream that is late now and then is reported once, until it was in time for a while.
        often = late_ns is not None and pause_ns is not None and first_ns - late_ns <= pause_ns and code == LATE
        if is_new(code, stream.fault) and not often:
            text = self._words(code, first_ns, newest_ns)
            self._tell(number, KINDS[code], f"{stream.name}: {text}")
        if code == LATE:
            newest_ns = int(common_ns[-1])
            self._heard(number, newest_ns, fault=code, late=stream.late + len(common_ns), late_ns=newest_ns)
        else:
            disordered = stream.disordered + len(common_ns)
            self._streams[number] = replace(stream, fault=code, disordered=disordered)

    def _heard(self, number: int, newest_ns: int, *, fault: int = GOOD, **counts: Any) -> None:
        """Note a stream's newest stamp and new counts; one that was out is back."""
        stream = self._streams[number]
        if stream.out:
            self._tell(number, "returned", f"{stream.name}: records come again.")
        heard: dict[str, Any] = {"newest_ns": newest_ns, "heard_ns": self._now_ns, "out": False, "fault": fault}
        self._streams[number] = replace(stream, **heard, **counts)

    def _words(self, code: int, time_ns: int, newest_ns: int) -> str:
        """What is wrong with a stamp, as a person should read it."""
        if code == AHEAD:
            ahead_s = (time_ns - (self._streams[0].newest_ns or 0)) / NANOSECONDS
            first = self._streams[0].name
            return f"stamps are {ahead_s:.3g} s ahead of those of {first}; records are left out. Check its clock."
        if code == LATE:
            late_s = ((self._released_ns or 0) - time_ns) / NANOSECONDS
            return f"a record came {late_s:.3g} s after its time was given out; it is left out."
        return words(code, time_ns, newest_ns, "record")

    def _tell(self, number: int, kind: str, text: str) -> None:
        """Put an event behind what waits in its stream."""
        stream = self._streams[number]
        known = [stamp for stamp in (stream.newest_ns, self._released_ns) if stamp is not None]
        # A nanosecond later than the newest: nothing of that stamp may still come, whatever the others do.
        event = Event(max(known, default=0) + 1, kind, text)
        self._held[number].append(Arrival(stream.name, stream.sequence or 0, event))

    def _bound(self, number: int) -> int:
        """The newest stamp (ns) of a stream that can be waited for."""
        first = self._streams[0]
        if number == 0 or self._silent_ns is None or first.out or first.newest_ns is None:
            return LAST_NS
        return first.newest_ns + MAX_AHEAD * self._silent_ns

    def _limit(self) -> int | None:
        """Up to which stamp (ns) everything is due: no live stream can bring anything earlier, or has had its time."""
        live = [stream for stream in self._streams if not stream.out]
        if not live:
            return self._newest()
        newest = [stream.newest_ns for stream in live]
        known = [stamp for stamp in newest if stamp is not None]
        limits = [min(known)] if len(known) == len(live) else []
        first = self._streams[0]
        leading = first.newest_ns if not first.out else max(known, default=None)
        if self._lateness_ns is not None and leading is not None:
            limits.append(leading - self._lateness_ns)
        return max(limits, default=None)

    def _release(self, limit_ns: int | None) -> list[Arrival]:
        """Everything that waits and is not later than `limit_ns`."""
        if limit_ns is None:
            return []
        self._released_ns = limit_ns if self._released_ns is None else max(limit_ns, self._released_ns)
        due: list[Arrival] = []
        while (single := self._first_single()) is not None:
            due += self._blocks(*single)
            due.append(self._held[single[1]].popleft())
        return due + self._blocks(self._released_ns, len(self._held))

    def _first_single(self) -> tuple[int, int] | None:
        """Stamp and stream's number of the first frame or event that is due, at equal stamps of the first stream's."""
        found = []
        for number, held in enumerate(self._held):
            for arrival in held:
                stamp = _stamp(arrival)
                if stamp > (self._released_ns or 0):
                    break
                if not isinstance(arrival.record, Readings):
                    found.append((stamp, number))
                    break
        return min(found, default=None)

    def _blocks(self, until_ns: int, before: int) -> list[Arrival]:
        """All readings up to a stamp as one block a stream; at the stamp itself of streams before a number only.

        Those of the first stream come last.
        """
        numbers = [*range(1, len(self._held)), 0]
        found = [self._block(number, until_ns if number < before else until_ns - 1) for number in numbers]
        return [block for block in found if block is not None]

    def _block(self, number: int, until_ns: int) -> Arrival | None:
        """The readings that wait in a stream, up to a stamp and to the first event, as one block."""
        held, records = self._held[number], []
        while held and isinstance(record := held[0].record, Readings) and record.time_ns[0] <= until_ns:
            arrival = held.popleft()
            if record.time_ns[-1] > until_ns:
                count = int(np.searchsorted(record.time_ns, until_ns, side="right"))
                held.appendleft(Arrival(arrival.stream, arrival.sequence, part(record, slice(count, None))))
                record = part(record, slice(count))
            records.append(record)
        return Arrival(arrival.stream, arrival.sequence, joined(records)) if records else None

    def _health(self, stream: StreamMemory) -> Health:
        state, reason = StreamState.LIVE, ""
        first = self._streams[0]
        if stream.out:
            quiet_ns = (self._now_ns or 0) - (stream.heard_ns or 0)
            state, reason = StreamState.OUT, f"nothing came for {quiet_ns / NANOSECONDS:.3g} s"
        elif stream.newest_ns is None:
            state, reason = StreamState.WAITING, "nothing came yet"
        elif self._released_ns is not None and stream.newest_ns < self._released_ns:
            behind_s = ((first.newest_ns or stream.newest_ns) - stream.newest_ns) / NANOSECONDS
            state, reason = StreamState.BEHIND, f"its stamps are {behind_s:.3g} s behind those of {first.name}"
        counts = (stream.used, stream.late, stream.disordered, stream.lost)
        return Health(stream.name, state, reason, stream.newest_ns, *counts)


def on_common_clock(own_ns: Nanoseconds, stream: StreamMemory) -> tuple[Nanoseconds, StreamMemory]:
    """Stamps (n,) of a stream's clock on the common one; a next offset holds from its stamp on, and for good."""
    change = stream.next_offset
    begins = np.flatnonzero(own_ns >= change.from_ns) if change else np.empty(0, dtype=np.int64)
    if change is None or not len(begins):
        return _moved(own_ns, stream.offset_ns), stream
    first = int(begins[0])
    common_ns = np.concatenate((_moved(own_ns[:first], stream.offset_ns), _moved(own_ns[first:], change.offset_ns)))
    return common_ns, replace(stream, offset_ns=change.offset_ns, next_offset=None)


def _moved(time_ns: Nanoseconds, offset_ns: int) -> Nanoseconds:
    """Stamps (n,) plus an offset; those that are no times stay what they are, so that nothing runs over."""
    if offset_ns == 0:
        return time_ns
    return np.where(np.abs(time_ns.astype(np.float64)) > LAST_NS, time_ns, time_ns + np.int64(offset_ns))


def _stamps(record: Readings | Frame | Tracked | RangeFrame | Event) -> Nanoseconds:
    if isinstance(record, Readings):
        return np.asarray(record.time_ns, dtype=np.int64)
    return np.array([record.time_ns], dtype=np.int64)


def _stamp(arrival: Arrival) -> int:
    """The first stamp of a record that waits."""
    record = arrival.record
    return int(record.time_ns[0]) if isinstance(record, Readings) else record.time_ns


def _whole(length_s: float) -> int | None:
    """A length in nanoseconds; None: without end."""
    return None if math.isinf(length_s) else round(length_s * NANOSECONDS)
