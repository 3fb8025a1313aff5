"""How an opened point gets its records: at once, or later those that came while it could not take them."""

import errno
import pickle
import sqlite3
import tempfile
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from midspan.errors import MidspanError
from midspan.records import NANOSECONDS, Arrival, Event, Frame, RangeFrame, Readings, Region, Tick
from midspan.service.cutting import part_of, whole_frame
from midspan.service.opening import Opened
from midspan.sources.radar.radar_source import at_bins

# Records wait for at most so long: the points of a site are calibrated and opened one after another.
MAX_WAIT_S = 600.0
# The frames of a point that wait take this many bytes of the disk at most; the oldest are dropped then. Regions of
# 256 x 256 px at 25 frames a second, with what is around them, reach it after 160 s, those of 128 x 128 px after 600 s.
MAX_BYTES = 2**30


@dataclass(frozen=True, slots=True)
class FrameInFile:
    """A frame of which a part, of `size` bytes, is in the file under `number`; frame: without its pixels."""

    stream: str
    sequence: int
    frame: Frame
    shape: tuple[int, ...]
    number: int
    size: int


class Waiting:
    """A queue of arrivals. folder: where the file of the frames is made; regions: the part of each camera's that waits.

    dropped: how many frames were dropped because they waited for too long, or took too much room.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.regions: Mapping[str, Region] = {}
        self._records: deque[Arrival | FrameInFile] = deque()
        self._file: sqlite3.Connection | None = None
        self._bytes = self._written = 0
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._records)

    def __iter__(self) -> Iterator[Arrival | FrameInFile]:
        return iter(self._records)

    def append(self, arrival: Arrival) -> None:
        """Let a record wait. Raises OSError where its frame cannot be written."""
        frame = arrival.record
        self._records.append(self._write(arrival, frame) if isinstance(frame, Frame) else arrival)
        newest_ns = _stamp(self._records[-1])
        while newest_ns - _stamp(self._records[0]) > MAX_WAIT_S * NANOSECONDS:
            self._drop(0)
        while self._bytes > MAX_BYTES:
            self._drop(next(k for k, one in enumerate(self._records) if isinstance(one, FrameInFile)))

    def popleft(self) -> Arrival:
        """The record that waits longest. Raises OSError where its frame cannot be read."""
        first = self._records.popleft()
        arrival = first if isinstance(first, Arrival) else self._read(first)
        if not self._records:
            self.close()
        return arrival

    def close(self) -> None:
        """Drop everything; the file's room is free again."""
        self._records.clear()
        self._bytes = 0
        if self._file is not None:
            self._file.close()
            self._file = None

    def _ask(self, question: str, *values: Any) -> list[Any]:
        """What the file's table gives, which is made first; its faults as OSError."""
        try:
            if self._file is None:
                self._folder.mkdir(parents=True, exist_ok=True)
                # The file has no name once it is open: nothing of it is left, however the process ends.
                with tempfile.TemporaryDirectory(dir=self._folder) as folder:
                    file = sqlite3.connect(f"{folder}/frames", isolation_level=None, check_same_thread=False)
                    file.execute("PRAGMA journal_mode = OFF")
                    file.execute("CREATE TABLE part (number INTEGER PRIMARY KEY, body BLOB)")
                self._file = file
            return self._file.execute(question, values).fetchall()
        except sqlite3.Error as error:
            raise OSError(errno.EIO, str(error)) from error

    def _write(self, arrival: Arrival, frame: Frame) -> FrameInFile:
        part, place = part_of(frame.pixels, self.regions.get(arrival.stream))
        self._written += 1
        self._ask("INSERT INTO part VALUES (?, ?)", self._written, pickle.dumps((part, place)))
        self._bytes += part.nbytes
        bare = replace(frame, pixels=np.empty((0, 0), dtype=part.dtype))
        return FrameInFile(arrival.stream, arrival.sequence, bare, frame.pixels.shape, self._written, part.nbytes)

    def _read(self, one: FrameInFile) -> Arrival:
        part, place = pickle.loads(self._ask("SELECT body FROM part WHERE number = ?", one.number)[0][0])
        self._forget(one)
        rows, columns = one.shape
        frame = replace(one.frame, pixels=whole_frame(part, place, (rows, columns)))
        return Arrival(one.stream, one.sequence, frame)

    def _forget(self, one: FrameInFile) -> None:
        self._bytes -= one.size
        self._ask("DELETE FROM part WHERE number = ?", one.number)

    def _drop(self, number: int) -> None:
        one = self._records[number]
        del self._records[number]
        if isinstance(one, FrameInFile):
            self._forget(one)
            self.dropped += 1


def _stamp(one: Arrival | FrameInFile) -> int:
    return one.frame.time_ns if isinstance(one, FrameInFile) else one.newest_ns


# This many of the records that wait are given to the point at once, at least: a tenth of a second of work, after which
# the service answers again. And twice as many as came since the last time, so that the queue becomes shorter.
AT_ONCE, TIMES_AS_MANY = 32, 2
# A sender is waited for when its broker is back: as long again as that was away, since senders double their pauses, but
# so long at least and at most, s: a second for the session, and what paho waits between two attempts at most.
MIN_RETURN_S, MAX_RETURN_S = 5.0, 120.0


@dataclass(slots=True)
class Feeding:
    """Gives records to an opened point; they wait while `hold` is asked for, and behind others that wait.

    waiting: those that came before it was opened are among them, and are kept already. folder: the captured recording
    that it was opened from; since_ns: the newest stamp when that was.
    """

    opened: Opened
    waiting: Waiting
    folder: Path
    since_ns: int
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
                newest_ns = max(self.opened.newest_ns.values(), default=0)
                self._refuse(Event(newest_ns, "damaged", f"A buffered frame cannot be read: {error}."))
                continue
            try:
                if arrival.newest_ns > self._from_ns.get(arrival.stream, -(2**62)):
                    self._run(arrival)
            except MidspanError as error:
                self._refuse(Event(arrival.newest_ns, "damaged", f"{arrival.stream}: {error}"))
        self._refused = self._refused and len(self.waiting) > 0

    def _refuse(self, event: Event) -> None:
        """One that cannot be used leaves the others alone; the first of those that wait together is an event."""
        if not self._refused:
            self._refused = True
            self.opened.journal.given([event])

    def _run(self, arrival: Arrival) -> None:
        found, record = self.opened, arrival.record
        if not found.takes(arrival.stream):
            return
        if isinstance(record, RangeFrame):
            # Of a radar's profile only the bins of its targets.
            record = replace(record, phasors=at_bins(record.phasors[None], found.bins[arrival.stream])[0])
        sequence = found.counts.get(arrival.stream, -1) + 1
        found.counts[arrival.stream] = sequence
        if not isinstance(record, Event):
            found.newest_ns[arrival.stream] = max(arrival.newest_ns, found.newest_ns.get(arrival.stream, -(2**62)))
        numbered = Arrival(arrival.stream, sequence, record)
        if not isinstance(record, Readings):
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
