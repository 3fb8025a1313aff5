"""Records of several streams in the order of time: who is waited for, for how long, and what comes too late."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.checks import refuse
from midspan.engine.stream import (
    AHEAD,
    BACKWARDS,
    CLOCK_SET,
    DOUBLED,
    FIRST_NS,
    GOOD,
    IMPOSSIBLE,
    KINDS,
    LAST_NS,
    LATE,
    SETTLED_S,
    StreamMemory,
    gone_on,
    order,
    spans,
    take_offset,
)
from midspan.records import (
    NANOSECONDS,
    Arrival,
    ClockOffset,
    Complete,
    Event,
    Frame,
    Nanoseconds,
    RangeFrame,
    Readings,
    Tick,
    Tracked,
    joined,
)

# A network connection is opened again within this time; for so long a silent stream holds the others back at most.
SILENT_S = 5.0
# Stamps that far ahead of the first stream, in times of the longest silence, are not waited for: memory is bounded.
MAX_AHEAD = 2

# What fits into 64 bits.
LIMITS_NS = (-(2**63), 2**63 - 1)

Single = Frame | Tracked | RangeFrame


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
    stream from which nothing comes for so long is out until it returns. For a file both are infinite, `Complete` says
    up to when nobody is waited for, and `finish` gives out what is left: then the order of arrival has no effect.

    What comes after its time was given out is left out, reading by reading, and so is what is doubled or backwards in
    its stream; each run of such records is an Event in its stream, at its place among the stream's records. A clock
    that was set back, or far ahead, for good is taken on from where the stream was, see `engine/stream.py`.
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
    def now_ns(self) -> int | None:
        """The shell's time of the newest tick; None before the first."""
        return self._now_ns

    @property
    def state(self) -> MergeState:
        """All that has an effect on what comes later."""
        held = tuple(tuple(waiting) for waiting in self._held)
        return MergeState(tuple(map(replace, self._streams)), held, self._released_ns, self._now_ns)

    def memory(self, stream: str) -> StreamMemory:
        """What is known of a stream, to be looked at alone."""
        return self._streams[self._names[stream]]

    def restore(self, state: MergeState) -> None:
        """Go on from where `state` was read."""
        if [stream.name for stream in state.streams] != list(self._names):
            raise refuse("state", f"of the streams {list(self._names)}", [stream.name for stream in state.streams])
        self._streams = [replace(stream) for stream in state.streams]
        self._held = [deque(waiting) for waiting in state.held]
        self._released_ns, self._now_ns = state.released_ns, state.now_ns

    def push(self, record: Arrival | Tick | ClockOffset | Complete) -> list[Arrival]:
        """Take a record; returns what is due, in the order of time, on the common clock."""
        if isinstance(record, Complete):
            return self._release(record.time_ns)
        if isinstance(record, Tick):
            self._tick(record.now_ns)
            return self._release(self._limit())
        if record.stream not in self._names:
            raise refuse("stream", f"one of {', '.join(self._names)}", record.stream)
        number = self._names[record.stream]
        if isinstance(record, ClockOffset):
            stream = self._streams[number]
            others = [one for one in stream.offsets if one.from_ns != record.from_ns]
            stream.offsets = tuple(sorted((*others, record), key=lambda one: one.from_ns))
        else:
            self._arrive(number, record)
        return self._release(self._limit())

    def finish(self) -> list[Arrival]:
        """What still waits, in the order of time."""
        return self._release(self._newest())

    def _newest(self) -> int | None:
        """The newest stamp (ns) of all that waits and all that came."""
        waiting = [np.ravel(held[-1].record.time_ns)[0] for held in self._held if held]
        came = [stream.newest_ns for stream in self._streams if stream.newest_ns is not None]
        return max((*map(int, waiting), *came), default=None)

    def _tick(self, now_ns: int) -> None:
        before_ns = now_ns if self._now_ns is None else self._now_ns
        self._now_ns = max(now_ns, before_ns)
        # Between ticks so far apart nobody listened: the process was stopped, and what came meanwhile is on its way.
        deaf = self._silent_ns is not None and self._now_ns - before_ns > self._silent_ns
        for number, stream in enumerate(self._streams):
            stream.pause_ns += self._now_ns - before_ns if deaf else 0
            heard_ns = self._now_ns if stream.heard_ns is None or deaf else stream.heard_ns
            silent_ns = self._now_ns - heard_ns
            out = stream.out or (self._silent_ns is not None and silent_ns > self._silent_ns)
            silent, stream.heard_ns, stream.out = out and not stream.out, heard_ns, out
            if silent:
                came = (
                    "nothing arrived" if stream.fault in (GOOD, LATE) else "no record with a usable time stamp arrived"
                )
                text = f"{came} for {silent_ns / NANOSECONDS:.3g} s; the other streams no longer wait."
                self._tell(number, "silent", f"{stream.name}: {text}")

    def _arrive(self, number: int, arrival: Arrival) -> None:
        """Let a record wait for its time where it is plainly good, which is the usual case."""
        stream, record = self._streams[number], arrival.record
        lost = 0 if stream.sequence is None else max(arrival.sequence - stream.sequence - 1, 0)
        if lost:
            stream.lost += lost
            self._tell(number, "lost", f"{stream.name}: {lost} records were lost in transmission.")
        stream.sequence = arrival.sequence
        if isinstance(record, Event):
            self._tell(number, record.kind, record.text)
            return
        if not isinstance(record, Readings):
            first_ns = last_ns = int(record.time_ns)
            rises = True
        elif len(record.time_ns):
            first_ns, last_ns = int(record.time_ns[0]), int(record.time_ns[-1])
            rises = bool((record.time_ns[1:] > record.time_ns[:-1]).all())
        else:
            return
        good = rises and not stream.offsets and first_ns >= FIRST_NS and last_ns <= LAST_NS
        for before_ns in (FIRST_NS - 1, stream.newest_ns, self._released_ns):
            good = good and (before_ns is None or before_ns < first_ns + stream.offset_ns)
        if good and last_ns + stream.offset_ns <= min(self._bound(number), LAST_NS):
            self._hold(number, arrival, record)
        else:
            self._sort_out(number, arrival, record)

    def _hold(self, number: int, arrival: Arrival, record: Readings | Single) -> None:
        """Let a good record, which has the stream's own stamps, wait for its time on the common clock."""
        stream, used = self._streams[number], 1
        if isinstance(record, Readings):
            used = len(record.time_ns)
            record = Readings(np.asarray(record.time_ns, dtype=np.int64) + stream.offset_ns, record.value)
            newest_ns = int(record.time_ns[-1])
        else:
            newest_ns = int(record.time_ns) + stream.offset_ns
            record = replace(record, time_ns=newest_ns) if stream.offset_ns else record
        self._heard(number, newest_ns, used=used)
        self._held[number].append(Arrival(arrival.stream, arrival.sequence, record))

    def _sort_out(self, number: int, arrival: Arrival, record: Readings | Single) -> None:
        """Let those of a record's readings wait that are good, and leave out the others, run by run."""
        stream, done = self._streams[number], 0
        own_ns = np.atleast_1d(np.clip(record.time_ns, *LIMITS_NS)).astype(np.int64)
        while done < len(own_ns):
            stop = done + take_offset(own_ns[done:], stream)
            part_ns = own_ns[done:stop]
            # Stamps that are no times stay what they are, so that nothing runs over.
            no_times = np.abs(part_ns.astype(np.float64)) > LAST_NS
            common_ns = np.where(no_times, part_ns, part_ns + np.int64(stream.offset_ns))
            codes, newest_ns = order(common_ns, stream.newest_ns, self._bound(number))
            if self._released_ns is not None:
                codes[(codes == GOOD) & (common_ns <= self._released_ns)] = LATE
            first = done
            for start, end, code in spans(codes):
                if code == GOOD:
                    good = slice(first + start, first + end)
                    if isinstance(record, Readings):
                        self._hold(number, arrival, Readings(own_ns[good], record.value[good]))
                    else:
                        self._hold(number, arrival, record)
                    continue
                offset_ns = stream.offset_ns
                count = self._leave_out(number, code, common_ns[start:end], int(newest_ns[start]))
                if start + count < end or stream.offset_ns != offset_ns:
                    stop = first + start + count
                    break
            done = stop

    def _leave_out(self, number: int, code: int, common_ns: Nanoseconds, newest_ns: int) -> int:
        """Count readings (n,) with a fault; the first of a run of them is an event. Returns how many were left out:
        all, or those until it shows that the stream's clock was set.
        """
        stream = self._streams[number]
        known = stream.newest_ns is not None and self._silent_ns is not None
        if code in (BACKWARDS, AHEAD) and known and self._now_ns is not None:
            stream.elsewhere, count = gone_on(stream.elsewhere, code, common_ns.tolist(), self._now_ns)
            common_ns = common_ns[:count]
        first_ns, late_ns, pause_ns = int(common_ns[0]), stream.late_ns, self._silent_ns
        # A stream that is late now and then is reported once, until it was in time for a while.
        often = late_ns is not None and pause_ns is not None and first_ns - late_ns <= pause_ns and code == LATE
        # Of a clock that ran back, the stamp that reaches the newest one again is no fault of its own.
        again = code == stream.fault or (stream.fault, code) == (BACKWARDS, DOUBLED)
        if not again and not often:
            text = self._words(number, code, first_ns, newest_ns)
            self._tell(number, KINDS[code], f"{stream.name}: {text}")
        stream.fault = code
        if code == LATE:
            stream.late_ns = int(common_ns[-1])
            stream.late += len(common_ns)
            self._heard(number, stream.late_ns, fault=code)
        else:
            stream.disordered += len(common_ns)
            self._set_clock(number)
        return len(common_ns)

    def _set_clock(self, number: int) -> None:
        """Where a stream's stamps go on elsewhere for good, let them follow those before."""
        stream = self._streams[number]
        found = stream.elsewhere
        if found is None or stream.newest_ns is None or not found.is_settled(self._now_ns or 0):
            return
        released_ns = stream.newest_ns if self._released_ns is None else self._released_ns
        step_ns = found.step_ns(stream.newest_ns, released_ns)
        if abs(step_ns) < SETTLED_S * NANOSECONDS:
            # Its clock is sound: it follows its own stamps, only the first stream is far behind.
            return
        stream.offset_ns, stream.elsewhere = stream.offset_ns + step_ns, None
        way, by_s = "back" if step_ns > 0 else "ahead", abs(step_ns) / NANOSECONDS
        kept = f"{by_s:.6g} s are {'added to' if step_ns > 0 else 'taken from'} its stamps from here on"
        left_s = (found.last_ns - found.first_ns) / NANOSECONDS
        text = f"{stream.name}: its clock was set {way}; {kept}, and {left_s:.3g} s of records are left out."
        self._tell(number, CLOCK_SET, text)

    def _heard(self, number: int, newest_ns: int, *, used: int = 0, fault: int = GOOD) -> None:
        """Note a stream's newest stamp, and how many records of it are used; one that was out is back."""
        stream = self._streams[number]
        if stream.out:
            self._tell(number, "returned", f"{stream.name}: records arrive again.")
        stream.newest_ns, stream.heard_ns, stream.out, stream.fault = newest_ns, self._now_ns, False, fault
        stream.used, stream.elsewhere, stream.pause_ns = stream.used + used, None, 0

    def _words(self, number: int, code: int, time_ns: int, newest_ns: int) -> str:
        """What is wrong with a stamp, as a person should read it."""
        if code == AHEAD:
            ahead_s = (time_ns - (self._streams[0].newest_ns or 0)) / NANOSECONDS
            first = "those before" if number == 0 else f"those of {self._streams[0].name}"
            return f"time stamps are {ahead_s:.3g} s ahead of {first}; the records are left out. Check its clock."
        if code == LATE:
            late_s = ((self._released_ns or 0) - time_ns) / NANOSECONDS
            return f"a record arrived {late_s:.3g} s after the rows of its time were output; it is left out."
        if code == DOUBLED:
            return "two records have the same time stamp; the second is left out."
        if code == IMPOSSIBLE:
            return f"a time stamp of {time_ns} ns is outside the valid range; the record is left out."
        until = "until they are newer than all before or show that the clock was set"
        return f"time runs backwards by {(newest_ns - time_ns) / NANOSECONDS:.3g} s; records are left out {until}."

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
        if self._silent_ns is None or first.out or first.newest_ns is None:
            return LAST_NS
        if number == 0 and self._now_ns is None:
            # Without ticks a pause of the first stream cannot be distinguished from a clock that was set ahead.
            return LAST_NS
        # While the first stream was out the others went on: its own records come late then, and theirs do not.
        reached_ns = max(first.newest_ns + first.pause_ns, self._released_ns or FIRST_NS)
        return reached_ns + MAX_AHEAD * self._silent_ns

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
        """Everything that waits and is not later than `limit_ns`.

        Readings between two frames or events are one block a stream, that of the first stream last; at the stamp itself
        only those of the streams before that of the frame or event.
        """
        if limit_ns is None:
            return []
        self._released_ns = limit_ns if self._released_ns is None else max(limit_ns, self._released_ns)
        due: list[Arrival] = []
        while True:
            # The first frame or event that is due, at equal stamps of the first stream's.
            firsts = [
                (
                    next((one.record.time_ns for one in held if not isinstance(one.record, Readings)), LAST_NS + 2),
                    number,
                )
                for number, held in enumerate(self._held)
            ]
            until_ns, before = min(firsts)
            found = until_ns <= self._released_ns
            if not found:
                until_ns, before = self._released_ns, len(self._held)
            for number in (*range(1, len(self._held)), 0):
                if self._held[number]:
                    due += self._block(number, until_ns if number < before else until_ns - 1)
            if not found:
                return due
            due.append(self._held[before].popleft())

    def _block(self, number: int, until_ns: int) -> list[Arrival]:
        """The readings that wait in a stream, up to a stamp and to the first event: one block, or none."""
        held, records = self._held[number], []
        while held and isinstance(record := held[0].record, Readings) and record.time_ns[0] <= until_ns:
            arrival = held.popleft()
            if record.time_ns[-1] > until_ns:
                count = int(record.time_ns.searchsorted(until_ns, side="right"))
                rest = Readings(record.time_ns[count:], record.value[count:])
                held.appendleft(Arrival(arrival.stream, arrival.sequence, rest))
                record = Readings(record.time_ns[:count], record.value[:count])
            records.append(record)
        if not records:
            return []
        return [Arrival(arrival.stream, arrival.sequence, records[0] if len(records) == 1 else joined(records))]


def _whole(length_s: float) -> int | None:
    """A length in nanoseconds; None: without end."""
    return None if math.isinf(length_s) else round(length_s * NANOSECONDS)
