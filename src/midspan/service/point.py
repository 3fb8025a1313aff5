"""One point of a live site: calibrating, opening, running, and what of it is kept.

No thread, clock or network is in here: records and ticks are pushed in, work that takes long is asked for as a `Job`
whose result is handed back.
"""

import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

from midspan.engine.point import PointStatus
from midspan.radar.chirp import RadarInfo
from midspan.records import NANOSECONDS, Arrival, Event, Readings, Region
from midspan.service.capture import Capture, is_captured_with
from midspan.service.cutting import wider
from midspan.service.feeding import Absence, Feeding, Waiting
from midspan.service.journal import Journal, RowHealth, carried
from midspan.service.opening import Opened, checkpoint
from midspan.settings.kinds import ACCELEROMETER
from midspan.settings.recording import RecordingSettings
from midspan.settings.site import PointPlan
from midspan.store.chunk import Chunk, join
from midspan.store.store import Batch

# Time and frames (of the slowest camera) that a point is opened from: what a template is made from.
OPENING_S, OPENING_FRAMES = 5.0, 50
# A checkpoint is made so often, s of the records' time, and at the end: as often as blocks. Of a camera it is 100 kB;
# after a kill what came since is computed again, a minute of it in 0.3 s.
CHECKPOINT_S = 320.0
# For so long after a point was opened anew, while both openings run, rows of both that rest on measurements are waited
# for, s.
CARRY_S = 30.0
# A scale that is off by more than this share and this number of standard deviations asks for a new calibration.
SCALE_OFF, SCALE_SURE = 0.02, 4.0
# After a refused calibration the next one waits so long, s.
AGAIN_S = 60.0
# Of a point's calibrations the recordings that are kept: the one in force, and one that is offered.
KEPT_CALIBRATIONS = 2


class Phase(Enum):
    """What a point prepares; its rows go on meanwhile, if it is open.

    STARTING: nothing came yet; it opens with the calibration in force, else calibrates. CAPTURING_…: a recording is
    captured for that. CALIBRATING, OPENING: a job is done. OFFERED: a calibration waits to be accepted, and there are
    no rows. CHANGING_OVER: it is open anew, and the zero has to be carried over. RUNNING: nothing is prepared.
    """

    STARTING = "starting"
    CAPTURING_TO_CALIBRATE = "capturing to calibrate"
    CALIBRATING = "calibrating"
    OFFERED = "offered"
    CAPTURING_TO_OPEN = "capturing to open"
    OPENING = "opening"
    CHANGING_OVER = "changing over"
    RUNNING = "running"


# After a refused job, without rows, a recording is captured for the same again.
AGAIN = {Phase.CALIBRATING: Phase.CAPTURING_TO_CALIBRATE, Phase.OPENING: Phase.CAPTURING_TO_OPEN}
CAPTURING = (Phase.STARTING, *AGAIN.values())


@dataclass(frozen=True, slots=True)
class Job:
    """Work that takes long: "calibrate" the captured recording in `folder`, or "open" the point from it."""

    kind: str
    folder: Path


@dataclass(slots=True)
class LivePoint:
    """A point of the site.

    settings: of its captured recordings; folder: where these go; radars: what is known of each radar, by the sensor's
    name; number: of the calibration in force, 0 before there is one. follows: rows of an earlier opening are kept.
    """

    plan: PointPlan
    settings: RecordingSettings
    folder: Path
    radars: Mapping[str, RadarInfo] = field(default_factory=dict)
    number: int = 0
    phase: Phase = Phase.STARTING
    reason: str = ""
    job: Job | None = None
    follows: bool = False
    newest_ns: int = 0
    """The newest stamp of the acceleration."""
    _capture: Capture | None = None
    _journal: Journal = field(init=False)
    # What gives the rows, and what was opened anew and runs next to it until the zero is carried over.
    _feeding: Feeding | None = None
    _next: Feeding | None = None
    # What came since the capture that a point is being opened from.
    _waiting: Waiting | None = None
    _absence: Absence = field(default_factory=Absence)
    # What the opening before left to be kept and published.
    _last: list[Batch] = field(default_factory=list)
    _unpublished: Chunk | None = None
    _events: list[Event] = field(default_factory=list)
    _kept_ns: int = 0
    _again_ns: int = 0
    # The calibration whose scale was estimated to be off.
    _doubted: int = 0

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
    def opened(self) -> Opened | None:
        """What gives the rows."""
        return None if self._feeding is None else self._feeding.opened

    @property
    def row_health(self) -> RowHealth:
        """How the rows stand."""
        return RowHealth() if self.opened is None else self.opened.journal.health

    @property
    def disordered(self) -> int:
        """How many readings of the accelerometer were left out since their stamps were wrong."""
        return 0 if self.opened is None else self.opened.point.merge.memory(ACCELEROMETER).disordered

    @property
    def held_up(self) -> str:
        """Why records wait, as a code; empty where they do not."""
        waits = self._feeding is not None and len(self._feeding.waiting) > 0
        return self._absence.reason or "opening" if waits else ""

    @property
    def busy(self) -> bool:
        """Whether a recording is captured or a job is done."""
        return self._capture is not None or self.job is not None

    @property
    def settled_in(self) -> Path:
        """The folder that the point was opened from last."""
        return self.folder if self._feeding is None else self._feeding.folder

    def push(self, arrival: Arrival) -> None:
        """Take a record of one of the point's sensors, its stamps in UTC."""
        record, waiting = arrival.record, self._waiting
        if isinstance(record, Readings):
            if not len(record.time_ns):
                return
            if arrival.stream == ACCELEROMETER:
                self.newest_ns = max(self.newest_ns, int(record.time_ns[-1]))
                self._absence = self._absence.heard()
        if self._feeding is None:
            self._journal.arrived(arrival)
        for one in (self._feeding, self._next):
            if one is not None:
                one.push(arrival, hold=self._absence.waits)
        self._change_over()
        if self.phase in CAPTURING:
            self._captured(arrival)
        if waiting is not None and waiting is self._waiting:
            waiting.append(arrival)

    def tick(self, now_ns: int, *, away: bool = False) -> None:
        """The shell's time; away: whether the broker that brings the acceleration is known to be away."""
        self._absence = self._absence.after(now_ns, away=away)
        if not self._absence.waits:
            for one in (self._feeding, self._next):
                if one is not None:
                    one.tick(now_ns)
            self._change_over()

    def _captured(self, arrival: Arrival) -> None:
        """Capture until there is enough, then ask for the job."""
        if self.newest_ns < self._again_ns:
            return
        if self.phase is Phase.STARTING:
            self.phase = Phase.CAPTURING_TO_OPEN if self.number else Phase.CAPTURING_TO_CALIBRATE
        opens = self.phase is Phase.CAPTURING_TO_OPEN
        if self._capture is None:
            stamp_s = max(arrival.newest_ns, 0) // NANOSECONDS
            folder = self.folder / f"{'opening' if opens else 'calibration'}-{stamp_s}"
            self._capture = Capture(folder, self.settings, self.radars)
        self._capture.push(arrival)
        length_s, frames = self._capture.length_s, self._capture.frames
        if opens and length_s >= OPENING_S and (frames is None or frames >= OPENING_FRAMES):
            self.job, self._waiting = Job("open", self._capture.close()), Waiting(self.folder)
            self._capture, self.phase = None, Phase.OPENING
        elif not opens and length_s >= self.plan.settings.calibration_s:
            self.job = Job("calibrate", self._capture.close())
            self._capture, self.phase = None, Phase.CALIBRATING

    @property
    def stage(self) -> str:
        """What is prepared: capturing, calibrating, opening; empty where nothing is."""
        captures = self.phase in AGAIN.values()
        return "capturing" if captures else self.phase.value if self.phase in AGAIN else ""

    @property
    def capture_left_s(self) -> float:
        """How much longer is captured, s: the rest of the window, or until there are enough frames of the slowest
        camera, after the pause before another try.
        """
        pause_s = max(self._again_ns - self.newest_ns, 0) / NANOSECONDS
        length_s, frames = (0.0, None) if self._capture is None else (self._capture.length_s, self._capture.frames)
        if self.phase is not Phase.CAPTURING_TO_OPEN:
            return pause_s + max(self.plan.settings.calibration_s - length_s, 0.0)
        of_frames_s = length_s * (OPENING_FRAMES - frames) / frames if frames else 0.0
        return pause_s + max(OPENING_S - length_s, of_frames_s, 0.0)

    @property
    def can_calibrate(self) -> bool:
        """Whether nothing of the kind is done already."""
        return not (
            self.busy or self._next is not None or (self.opened is not None and self.phase is not Phase.RUNNING)
        )

    def calibrate(self) -> str:
        """Begin a new calibration, or say why not; the rows go on with the one in force until another is accepted."""
        if not self.can_calibrate:
            return f"{self.name}: is already being calibrated or opened; the command is ignored."
        self.phase, self._again_ns = Phase.CAPTURING_TO_CALIBRATE, self.newest_ns
        return f"{self.name}: records {self.plan.settings.calibration_s:g} s for a new calibration."

    def calibrated(self, number: int, warnings: Sequence[str] = ()) -> None:
        """A calibration came into force: the point opens anew with it. warnings: of one that was made just now."""
        self.number, self.job, self.phase = number, None, Phase.CAPTURING_TO_OPEN
        self._tell("calibrated", f"{self.name}: calibration {number} is in force.")
        self._warn(number, warnings)

    def offered(self, number: int, warnings: Sequence[str] = ()) -> None:
        """A calibration was made that someone has to accept, with its warnings."""
        self.job, self.reason = None, "calibration_offered"
        self.phase = Phase.OFFERED if self.opened is None else Phase.RUNNING
        self._tell("calibration_offered", f"{self.name}: calibration {number} awaits acceptance.")
        self._warn(number, warnings)

    def _warn(self, number: int, warnings: Sequence[str]) -> None:
        for text in warnings:
            self._tell("calibration_warning", f"{self.name}: calibration {number}: {text}")

    def offer_refused(self) -> None:
        """What was offered is not accepted: without rows a calibration is tried again after a while."""
        self.reason = "" if self.reason == "calibration_offered" else self.reason
        if self.phase is Phase.OFFERED:
            self.phase, self._again_ns = Phase.CAPTURING_TO_CALIBRATE, self.newest_ns + round(AGAIN_S * NANOSECONDS)

    def refused(self, why: str) -> None:
        """A calibration or an opening failed: without rows it is tried again after a while."""
        self.job, self.reason = None, "calibration_refused"
        if self._waiting is not None:
            self._waiting.close()
            self._waiting = None
        if self.opened is None:
            self.phase = AGAIN.get(self.phase, self.phase)
            self._again_ns = self.newest_ns + round(AGAIN_S * NANOSECONDS)
        else:
            self.phase = Phase.RUNNING
        self._tell("calibration_refused", f"{self.name}: {why}")

    def narrow(self, regions: Mapping[str, Region]) -> None:
        """While the point is opened, only these parts of its cameras' frames wait."""
        if self._waiting is not None:
            self._waiting.regions = regions

    def is_opened(self, found: Opened, folder: Path | None = None) -> None:
        """The point is open: what waited meanwhile is pushed. One that runs goes on until the zero is carried over.

        folder: that it was opened from; left out: the job's.
        """
        folder = folder or (self.settled_in if self.job is None else self.job.folder)
        waiting = Waiting(self.folder) if self._waiting is None else self._waiting
        waiting.regions = {name: wider(region) for name, region in found.regions.items()}
        fed = Feeding(found, waiting, folder, self.newest_ns)
        self.job, self.reason, self._waiting = None, "", None
        for name in (name for name in self.plan.sources if not found.takes(name)):
            used = f"calibration {found.journal.calibration} and method {self.plan.settings.method}"
            self._tell("calibration_warning", f"{self.name}: {name} is not used with {used}.")
        if self._feeding is None:
            self._feeding, self.phase = fed, Phase.RUNNING
            if self.follows and not found.has_own_zero:
                found.journal.announce_new_datum("the saved state with the previous zero could not be used.")
        else:
            self._next, self.phase = fed, Phase.CHANGING_OVER
        fed.catch_up()
        self._change_over()

    def resumed(self, found: Opened, folder: Path) -> None:
        """The point is open again, from its checkpoint and the folder that it was opened from then; it is opened anew
        where another calibration or other settings came into force since.
        """
        self.follows = False
        self.is_opened(found, folder)
        if found.journal.calibration != self.number or not is_captured_with(folder, self.settings):
            self.phase = Phase.CAPTURING_TO_OPEN

    def drop(self) -> None:
        """Let the point be opened anew: what it was resumed from cannot be used."""
        self._feeding, self.phase = None, Phase.STARTING

    def _change_over(self) -> None:
        """Let the rows come from the point that was opened anew, as soon as the zero can be carried over."""
        if self._next is None or self._feeding is None or len(self._next.waiting) or len(self._feeding.waiting):
            return
        older, newer = self._feeding.opened, self._next.opened
        rows, fresh, zero = older.journal.recent, newer.journal.recent, None
        if rows is not None and fresh is not None and not newer.has_own_zero:
            zero = carried(rows, fresh, older.journal.zero, older.scale_std)
        late = self.newest_ns - self._next.since_ns > CARRY_S * NANOSECONDS
        if zero is None and not (newer.has_own_zero or late or older.point.status is PointStatus.LOST):
            return
        last_ns = older.journal.health.newest_ns
        newer.journal.continue_after(-(2**62) if last_ns is None else last_ns, zero)
        if zero is not None:
            moved, number = f"{1e3 * zero.offset_m:+.3g} ± {1e3 * zero.variance_m2**0.5:.2g}", newer.journal.calibration
            self._tell(
                "zero",
                f"{self.name}: rows now use calibration {number}; their zero was shifted by {moved} mm to match.",
            )
        elif not newer.has_own_zero:
            newer.journal.announce_new_datum("too few measured rows overlap with the previous ones.")
        self._unpublished = older.journal.fresh()
        self._last.append(older.journal.batch())
        self._feeding, self._next = self._next, None
        if self.phase is Phase.CHANGING_OVER:
            self.phase = Phase.RUNNING
        # The store must not go back to the opening before.
        self._kept_ns = 0

    def unseen(self, sensor: str) -> str:
        """Why nothing is measured with one of its sensors though records come: dark, frozen, lost, else nothing."""
        return "" if self.opened is None else self.opened.point.unseen(sensor)

    def fresh(self) -> Chunk | None:
        """The rows since the last time, to be published; `batch` keeps them."""
        both = [self._unpublished, None if self.opened is None else self.opened.journal.fresh()]
        self._unpublished = None
        chunks = [one for one in both if one is not None]
        return join(chunks) if chunks else None

    @property
    def head(self) -> Chunk | None:
        """With `lag` the newest row before it is smoothed: for viewers alone, never kept; None without one."""
        row = None if self.opened is None else self.opened.point.head
        return None if row is None or self.opened is None else self.opened.journal.provisional(row)

    def batch(self, *, last: bool = False) -> Batch:
        """What is to be kept since the last time; with a checkpoint where one is due, or at the end."""
        batches, self._last = [self._journal.batch(), *self._last], []
        kept: dict[str, tuple[int, Sequence[bytes]]] = {}
        if self.opened is not None:
            batches.append(self.opened.journal.batch())
            if last or self.newest_ns - self._kept_ns >= CHECKPOINT_S * NANOSECONDS:
                kept[self.name] = (self.newest_ns, checkpoint(self.opened, self.settled_in))
                self._kept_ns = self.newest_ns
                if not self.busy:
                    forget(self.folder, self.settled_in)
                self._doubt(self.opened)
        events = [*(event for one in batches for event in one.events), *((self.name, event) for event in self._events)]
        self._events = []
        return Batch([chunk for one in batches for chunk in one.chunks], events, kept)

    def _doubt(self, found: Opened) -> None:
        """Calibrate anew, once, where the motion shows that a scale has changed."""
        off = [
            f"{sensor}: the motion shows a scale {100 * error:+.2g} ± {100 * std:.1g} % different from calibration "
            f"{self.number}; the band includes it, and a new calibration starts."
            for sensor, (error, std) in found.point.scale_errors().items()
            if abs(error) > max(SCALE_OFF, SCALE_SURE * std)
        ]
        in_force = found.journal.calibration == self.number
        if off and in_force and self._doubted != self.number and not self.busy:
            self._doubted = self.number
            for line in off:
                self._tell("scale", line)
            self.calibrate()

    def close(self) -> None:
        """End what is being captured, without a result."""
        if self._capture is not None:
            with suppress(OSError):
                self._capture.discard()
            self._capture = None

    def end(self) -> None:
        """End what is captured, and drop what waits."""
        self.close()
        for waiting in (self._waiting, *(one.waiting for one in (self._feeding, self._next) if one is not None)):
            if waiting is not None:
                waiting.close()

    def _tell(self, kind: str, text: str) -> None:
        self._events.append(Event(self.newest_ns, kind, text))


def forget(folder: Path, settled_in: Path) -> None:
    """Remove a point's captured recordings from before the one it was opened from, but for the newest calibrations'."""
    before = settled_in.name.partition("-")[2]
    for kind, kept in (("opening", 0), ("calibration", KEPT_CALIBRATIONS)):
        older = sorted(one for one in folder.glob(f"{kind}-*") if one.name.partition("-")[2] < before)
        for one in older[: max(len(older) - kept, 0)]:
            shutil.rmtree(one, ignore_errors=True)
