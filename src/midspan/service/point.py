"""One point of a live site: calibrating, opening, running, and what of it is kept.

No thread, clock or network is in here: records and ticks are pushed in, work that takes long is asked for as a `Job`
whose result is handed back.
"""

from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

from midspan.engine.support import PointStatus
from midspan.radar.info import RadarInfo
from midspan.records import NANOSECONDS, Arrival, Event, Frame, RangeFrame, Readings, Tick
from midspan.service.capture import Capture
from midspan.service.captures import forget
from midspan.service.journal import Journal
from midspan.service.opening import Opened, checkpoint
from midspan.settings.recording import RecordingSettings
from midspan.settings.site import PointPlan
from midspan.sources.radar.radar_source import at_bins
from midspan.store.chunk import Chunk
from midspan.store.store import Batch

# Time and frames (of the slowest camera) that a point is opened from: what a template is made from.
OPENING_S, OPENING_FRAMES = 5.0, 50
# A checkpoint is made so often, s of the records' time.
CHECKPOINT_S = 10.0
# Time that readings wait for at most while a point is being opened (the first opening compiles, and the points of a
# site open one after another), and frames that do.
HELD_S, HELD_FRAMES = 600.0, 200
# A scale that is off by more than this share and this number of standard deviations asks for a new calibration.
SCALE_OFF, SCALE_SURE = 0.02, 4.0
# After a refused calibration the next one waits so long, s.
AGAIN_S = 60.0


class Phase(Enum):
    """What a point does with its records."""

    CAPTURING = "capturing"
    CALIBRATING = "calibrating"
    OFFERED = "offered"
    OPENING = "opening"
    RUNNING = "running"


@dataclass(frozen=True, slots=True)
class Job:
    """Work that takes long: "calibrate" the captured recording in `folder`, or "open" the point from it."""

    kind: str
    folder: Path


@dataclass(slots=True)
class LivePoint:
    """A point of the site.

    settings: of its captured recordings; folder: where these go; radars: what is known of each radar, by the sensor's
    name; number: of the calibration in force, 0 before there is one.
    """

    plan: PointPlan
    settings: RecordingSettings
    folder: Path
    radars: Mapping[str, RadarInfo] = field(default_factory=dict)
    number: int = 0
    phase: Phase = Phase.CAPTURING
    reason: str = ""
    job: Job | None = None
    opened: Opened | None = None
    _capture: Capture | None = None
    _journal: Journal | None = None
    _held: deque[Arrival] = field(default_factory=deque)
    _events: list[Event] = field(default_factory=list)
    _newest_ns: int = 0
    _kept_ns: int = 0
    _again_ns: int = 0
    # The calibration whose scale was found to be off.
    _doubted: int = 0
    # What is captured for while the point runs: "calibrate", "open" or nothing.
    _wanted: str = ""

    def __post_init__(self) -> None:
        self._journal = Journal(self.plan.name, {})

    @property
    def name(self) -> str:
        """The point's name."""
        return self.plan.name

    @property
    def status(self) -> PointStatus:
        """How the point stands."""
        return self.opened.point.status if self.opened is not None else PointStatus.CALIBRATING

    @property
    def newest_ns(self) -> int:
        """The newest stamp of the acceleration."""
        return self._newest_ns

    def push(self, arrival: Arrival) -> None:
        """Take a record of one of the point's sensors, its stamps in UTC."""
        record = arrival.record
        assert self._journal is not None
        if isinstance(record, Readings) and not len(record.time_ns):
            return
        if arrival.stream == "accelerometer" and isinstance(record, Readings):
            self._newest_ns = max(self._newest_ns, int(record.time_ns[-1]))
        if self.opened is None or self.phase is Phase.OPENING:
            self._journal.arrived(arrival)
        if self.phase is Phase.CAPTURING:
            self._captured(arrival)
        elif self.phase is Phase.OPENING:
            self._hold(arrival)
        elif self.phase is Phase.RUNNING:
            self._run(arrival)
            if self._wanted and self.job is None:
                self._captured(arrival)

    def tick(self, now_ns: int) -> None:
        """The shell's time."""
        if self.phase is Phase.RUNNING and self.opened is not None:
            self.opened.journal.given(self.opened.point.push(Tick(now_ns)))

    def calibrate(self) -> str:
        """Begin a new calibration, or say why not; the rows go on with the one in force until another is accepted."""
        if self.busy or (self._wanted and self.opened is not None):
            return f"{self.name}: is being calibrated or opened already; the command is left out."
        self._wanted = "calibrate"
        if self.opened is None:
            self.phase, self._again_ns = Phase.CAPTURING, self._newest_ns
        return f"{self.name}: records {self.plan.settings.calibration_s:g} s for a new calibration."

    def close(self) -> None:
        """Let go of what is being captured."""
        if self._capture is not None:
            with suppress(OSError):
                self._capture.discard()
            self._capture = None

    @property
    def busy(self) -> bool:
        """Whether a recording is captured or a job is done."""
        return self._capture is not None or self.job is not None

    def calibrated(self, number: int) -> None:
        """A calibration came into force: the point opens anew with it."""
        self.number, self.job, self._wanted = number, None, "open"
        if self.opened is None:
            self.phase = Phase.CAPTURING
        self._tell("calibrated", f"{self.name}: calibration {number} is in force.")

    def offered(self, number: int) -> None:
        """A calibration was made that someone has to accept."""
        self.job, self.reason, self._wanted = None, "calibration_offered", ""
        if self.opened is None:
            self.phase = Phase.OFFERED
        self._tell("calibration_offered", f"{self.name}: calibration {number} waits to be accepted.")

    def is_opened(self, found: Opened) -> None:
        """The point is open: what waited meanwhile is pushed."""
        self.opened, self.job, self.phase, self.reason, self._wanted = found, None, Phase.RUNNING, "", ""
        for arrival in self._held:
            if _stamp(arrival) > found.newest_ns.get(arrival.stream, -(2**62)):
                self._run(arrival)
        self._held.clear()

    def refused(self, why: str) -> None:
        """A calibration or an opening failed: it is tried again after a while."""
        self.job, self.reason = None, "calibration_refused"
        if self.opened is None:
            self.phase = Phase.CAPTURING
            self._again_ns = self._newest_ns + round(AGAIN_S * NANOSECONDS)
        else:
            self._wanted, self.phase = "", Phase.RUNNING
        self._tell("calibration_refused", f"{self.name}: {why}")

    def resumed(self, found: Opened, folder: Path) -> None:
        """The point is open again, from its checkpoint and the folder that it was opened from then."""
        self._opened_in = folder
        self.is_opened(found)

    def unseen(self, sensor: str) -> str:
        """Why nothing is measured with one of its sensors though records come: dark, frozen, lost, else nothing."""
        return "" if self.opened is None else self.opened.point.unseen(sensor)

    def fresh(self) -> Chunk | None:
        """The rows since the last time, to be published; `batch` keeps them."""
        return None if self.opened is None else self.opened.journal.fresh()

    def batch(self, *, last: bool = False) -> Batch:
        """What is to be kept since the last time; with a checkpoint where one is due, or at the end."""
        assert self._journal is not None
        batches = [self._journal.batch()]
        kept: dict[str, tuple[int, bytes]] = {}
        if self.opened is not None:
            batches.append(self.opened.journal.batch())
            if self.phase is Phase.RUNNING and (last or self._newest_ns - self._kept_ns >= CHECKPOINT_S * NANOSECONDS):
                kept[self.name] = (self._newest_ns, checkpoint(self.opened, self.settled_in))
                self._kept_ns = self._newest_ns
                if not self.busy:
                    forget(self.folder, self.settled_in)
                self._doubt(self.opened)
        events = [(self.name, event) for event in self._events]
        self._events = []
        chunks = [chunk for one in batches for chunk in one.chunks]
        return Batch(chunks, [*(event for one in batches for event in one.events), *events], kept)

    def _doubt(self, found: Opened) -> None:
        """Calibrate anew, once, where the motion shows that a scale has changed."""
        off = [
            f"{sensor}: the motion shows a scale {100 * error:+.2g} ± {100 * std:.1g} % off calibration {self.number}; "
            "the band holds it, and a new calibration is made."
            for sensor, (error, std) in found.point.scale_errors().items()
            if abs(error) > max(SCALE_OFF, SCALE_SURE * std)
        ]
        if off and self._doubted != self.number and not self.busy:
            self._doubted = self.number
            for line in off:
                self._tell("scale", line)
            self.calibrate()

    @property
    def settled_in(self) -> Path:
        """The folder that the point was opened from last."""
        return self._opened_in or self.folder

    _opened_in: Path | None = None

    def _captured(self, arrival: Arrival) -> None:
        """Capture until there is enough, then ask for the job."""
        if self._newest_ns < self._again_ns:
            return
        if self._capture is None:
            stamp_s = max(_stamp(arrival), 0) // NANOSECONDS
            self._capture = Capture(
                self.folder / f"{'opening' if self._opens else 'calibration'}-{stamp_s}", self.settings, self.radars
            )
        self._capture.push(arrival)
        length_s, frames = self._capture.length_s, self._capture.frames
        if self._opens and length_s >= OPENING_S and (frames is None or frames >= OPENING_FRAMES):
            self._opened_in = self._capture.close()
            self.job, self.phase = Job("open", self._opened_in), Phase.OPENING
        elif not self._opens and length_s >= self.plan.settings.calibration_s:
            self.job = Job("calibrate", self._capture.close())
            if self.opened is None:
                self.phase = Phase.CALIBRATING
        if self.job is not None:
            self._capture = None

    @property
    def _opens(self) -> bool:
        """Whether what is captured is for opening the point, not for calibrating it."""
        return self._wanted == "open" or (self.number > 0 and self._wanted != "calibrate")

    def _hold(self, arrival: Arrival) -> None:
        """Let a record wait; of frames the oldest is dropped, readings are kept for HELD_S."""
        self._held.append(arrival)
        if isinstance(arrival.record, Frame):
            frames = [one for one in self._held if isinstance(one.record, Frame)]
            if len(frames) > HELD_FRAMES:
                self._held.remove(frames[0])
        while self._held and _stamp(arrival) - _stamp(self._held[0]) > HELD_S * NANOSECONDS:
            self._held.popleft()

    def _run(self, arrival: Arrival) -> None:
        found = self.opened
        assert found is not None
        sequence = found.counts.get(arrival.stream, -1) + 1
        found.counts[arrival.stream] = sequence
        if not isinstance(arrival.record, Event):
            found.newest_ns[arrival.stream] = max(_stamp(arrival), found.newest_ns.get(arrival.stream, -(2**62)))
        numbered = Arrival(arrival.stream, sequence, at_targets(arrival, found))
        found.journal.arrived(numbered)
        found.journal.given(found.point.push(numbered))

    def _tell(self, kind: str, text: str) -> None:
        self._events.append(Event(self._newest_ns, kind, text))


def at_targets(arrival: Arrival, found: Opened) -> Any:
    """A record as the point takes it: of a radar's profile only the bins of its targets."""
    record = arrival.record
    if not isinstance(record, RangeFrame):
        return record
    return replace(record, phasors=at_bins(record.phasors[None], found.bins[arrival.stream])[0])


def _stamp(arrival: Arrival) -> int:
    record = arrival.record
    return int(record.time_ns[-1]) if isinstance(record, Readings) else int(record.time_ns)
