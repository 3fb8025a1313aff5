"""`replay`: a recording through a live point into a store, as fast as it goes or at a multiple of its own time."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from midspan.calibration.sensors.auxiliary import MEASURES
from midspan.checks import option
from midspan.engine.point import Output, Point
from midspan.engine.sensors import Seen
from midspan.errors import UsageError
from midspan.fusion.blocks import Rows
from midspan.fusion.methods import METHODS, Pass, no_literal_form
from midspan.notices import Notice
from midspan.progress import Progress, silent
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.estimate import Asked
from midspan.recording.messages import require_same_sensors
from midspan.recording.point import clock_offsets_ns
from midspan.recording.run import records_of
from midspan.recording.streams.recording import Recording, naming
from midspan.recording.tracked import open_tracked_cameras
from midspan.records import NANOSECONDS, Arrival, Complete, Event, RangeFrame, Readings
from midspan.service.calibrations import settings_json
from midspan.service.journal import ROWS, SHOWN, Journal
from midspan.service.stored_recording import FIRST_NS, LAST_NS
from midspan.settings.group import is_a_point
from midspan.settings.kinds import KINDS
from midspan.settings.stored.calibration import Calibration
from midspan.store.chunk import Chunk
from midspan.store.store import Batch, Store

# The methods that give a row once and for all.
LIVE = tuple(name for name, row in METHODS.items() if row.rows in (Pass.CAUSAL, Pass.LAGGED))
# So much time of the records is written at once; at a given speed readings come in blocks of so much, as loggers send.
BLOCK_S, SENT_S = 1.0, 0.02


@dataclass(frozen=True, slots=True)
class Latency:
    """Time from a sample or a frame to its row as it was given out at a given speed, s: the median, and of 95 %."""

    median_s: float
    of_95_s: float

    @classmethod
    def of(cls, late_s: Sequence[float]) -> "Latency | None":
        """Of all that were measured; None where there are none."""
        return cls(float(np.median(late_s)), float(np.quantile(late_s, 0.95))) if late_s else None


@dataclass(frozen=True, slots=True)
class Replayed:
    """What a replay gave: rows kept, how long they last (s), and what the calibration warned of.

    from_sample, from_frame: of a replay at a given speed.
    """

    rows: int
    length_s: float
    warnings: tuple[Notice, ...]
    from_sample: Latency | None = None
    from_frame: Latency | None = None


def replay(
    recording: Recording,
    store: Store,
    *,
    name: str | None = None,
    calibration: Calibration | None = None,
    method: str = "kalman",
    speed: float | None = None,
    length_s: float | None = None,
    progress: Progress = silent,
    wait: Callable[[float], None] = time.sleep,
) -> Replayed:
    """Push a recording through a live point and keep raw records, rows and events in `store`.

    name: of the point; left out: the recording's. calibration: left out, it is made first. speed: times real time;
    None: as fast as it goes. length_s: it ends after so much of the recording; None: with it. Rows are those of
    `estimate` with the same method. Raises what `calibrate` raises, and UsageError for a point whose rows are as new
    already, another method than those of a live point, or such a name.
    """
    check_method(recording, method)
    name = point_called(name, recording)
    _require_new(store, name, recording)
    given, tracking = calibration is not None, None
    if calibration is None:
        calibration, tracking = calibrate_and_track(recording, progress)
    recording = recording.without_lines(calibration.lines)
    with naming(recording):
        require_same_sensors(recording, calibration)
        asked = Asked(recording, calibration, method, given)
        sides = asked.sides
        tracked_cameras = open_tracked_cameras(sides, tracking, progress)
        point = asked.point(sides, tracked_cameras, log=False)
        axes = recording.settings.axes[: len(sides)] if len(sides) > 1 else ()
        first_ns, last_ns = (int(recording.acceleration.time_ns[k]) for k in (0, -1))
        whole_s = min((last_ns - first_ns) / NANOSECONDS, np.inf if length_s is None else length_s)
        last_ns = last_ns if length_s is None else first_ns + round(whole_s * NANOSECONDS)
        number = _add_calibration(store, name, first_ns, recording, calibration)
        offsets_ns, motion_m = clock_offsets_ns(sides[0], tracked_cameras), point.estimator.settings.motion[0][0]
        journal = Journal(name, offsets_ns, axes=axes, calibration=number, motion_m=motion_m)
        pace = None if speed is None else Pace(speed, offsets_ns, wait)
        player = Player(point, journal, store, pace)
        try:
            for _, record in records_of(point, sides, tracked_cameras, block_s=BLOCK_S if speed is None else SENT_S):
                if length_s is not None and player.newest_ns > last_ns:
                    break
                player.push(record)
                done_s = (player.newest_ns - first_ns) / NANOSECONDS
                progress(max(int(done_s), 0), max(int(whole_s), 1), "replaying")
            player.finish()
        except BaseException:  # the store had nothing as new of this point
            store.forget_since(name, player.oldest_ns, number)
            raise
        store.accept(name, number)
        for tracked_camera in tracked_cameras:
            tracked_camera.tracking.close()
    progress(1, 1, "replaying")
    late = (None, None) if pace is None else (Latency.of(pace.of_samples_s), Latency.of(pace.of_frames_s))
    return Replayed(player.rows, whole_s, tuple(calibration.warnings), *late)


def _require_new(store: Store, name: str, recording: Recording) -> None:
    """UsageError where the store has rows of the point that are as new as the recording."""
    newest_ns = store.newest_ns(name, "rows")
    if newest_ns is not None and newest_ns >= recording.acceleration.time_ns[0]:
        raise UsageError(
            f"The store already has rows of point {name!r} at the recording's time and keeps them. Give another name "
            "(--point), or another store (-o)."
        )


def _add_calibration(store: Store, name: str, first_ns: int, recording: Recording, calibration: Calibration) -> int:
    """Keep the calibration with the recording's settings, not accepted yet; returns its number."""
    radars = {view.sensor: view.radar.info for view in recording.views if KINDS[view.kind].brings is RangeFrame}
    body, settings = json.dumps(calibration.with_even_clocks().to_dict()), settings_json(recording.settings, radars)
    return store.add_calibration(name, first_ns, body, settings, accept=False)


def check_method(recording: Recording, method: str) -> None:
    """UsageError for a method that is none of a live point, or that has no form as printed."""
    option("method", method, LIVE)
    if recording.settings.fusion.literal and not METHODS[method].literal:
        raise UsageError(f"{recording.file}: fusion: {no_literal_form(method)}.")


class Player:
    """Gives records to a point and what comes out of it to a store, a block of readings at a time.

    Rows are kept in the streams' common span, as in a result: from the first to the last measurement.
    """

    def __init__(self, point: Point, journal: Journal, store: Store, pace: "Pace | None" = None) -> None:
        self._point, self._journal, self._store, self._pace = point, journal, store, pace
        self._first_ns, self._last_ns, self._written_ns = LAST_NS, FIRST_NS, FIRST_NS
        # Rows since the last measurement.
        self._held: list[Chunk] = []
        # What was written begins here.
        self.oldest_ns = LAST_NS
        self.newest_ns, self.rows = FIRST_NS, 0

    def push(self, record: Arrival | Complete) -> None:
        """One record; what came before a new block of readings is written."""
        if isinstance(record, Arrival) and isinstance(record.record, Readings):
            if self.newest_ns >= self._written_ns + round(BLOCK_S * NANOSECONDS):
                self._write()
                self._written_ns = self.newest_ns
            self.newest_ns = max(self.newest_ns, int(record.record.time_ns[-1]))
        if self._pace is not None and isinstance(record, Arrival):
            self._pace.arrived(record)
        self._journal.arrived(record)
        outputs = self._point.push(record)
        if self._pace is not None:
            self._pace.given(outputs)
        self._take(outputs)

    def finish(self) -> None:
        """The end of all records."""
        self._take(self._point.finish())
        self._write()

    def _take(self, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if isinstance(output, Seen) and output.measured is not None and output.sensor not in MEASURES:
                stamps = output.measured.time_ns[np.isfinite(output.measured.value)]
                self._first_ns = min([self._first_ns, *stamps[:1].tolist()])
                self._last_ns = max([self._last_ns, *stamps[-1:].tolist()])
        self._journal.given(outputs)

    def _write(self) -> None:
        batch = self._journal.batch()
        chunks = [one for one in batch.chunks if one.shown != SHOWN]
        rows = [*self._held, *(one for one in batch.chunks if one.shown == SHOWN)]
        self._held = [late for one in rows if len((late := one.rows(one.time_ns > self._last_ns)).time_ns)]
        for one in rows:
            kept = one.rows((one.time_ns >= self._first_ns) & (one.time_ns <= self._last_ns))
            if len(kept.time_ns):
                chunks.append(kept)
                self.rows += len(kept.time_ns) if kept.stream == ROWS else 0
        self.oldest_ns = min([self.oldest_ns, *(int(one.time_ns[0]) for one in chunks)])
        if chunks or batch.events:
            self._store.write(Batch(chunks, batch.events))


class Pace:
    """Lets records arrive when their own time, times a speed, has gone by, and measures how late their rows are.

    offsets_ns: what is added to each stream's stamps. of_samples_s: from each sample of the acceleration to its row;
    of_frames_s: from each frame to the first row that is not before it.
    """

    def __init__(self, speed: float, offsets_ns: Mapping[str, int], wait: Callable[[float], None]) -> None:
        self._speed, self._offsets_ns, self._wait = speed, offsets_ns, wait
        self._begun: tuple[int, float] | None = None
        self._frames_ns: list[int] = []
        self.of_samples_s: list[float] = []
        self.of_frames_s: list[float] = []

    def arrived(self, record: Arrival) -> None:
        """Wait until a record is due."""
        newest_ns = record.newest_ns + self._offsets_ns.get(record.stream, 0)
        if self._begun is None:
            self._begun = (newest_ns, time.monotonic())
        left_s = -self._late_s(newest_ns)
        if left_s > 0:
            self._wait(left_s)
        if not isinstance(record.record, Readings | Event):
            self._frames_ns.append(newest_ns)

    def given(self, outputs: Sequence[Output]) -> None:
        """Note how late the rows are."""
        for output in outputs:
            if not isinstance(output, Rows) or not output.estimates or not len(output.estimates[0].time_ns):
                continue
            stamps = output.estimates[0].time_ns
            self.of_samples_s += [self._late_s(stamp) for stamp in stamps.tolist()]
            self.of_frames_s += [self._late_s(stamp) for stamp in self._frames_ns if stamp <= stamps[-1]]
            self._frames_ns = [stamp for stamp in self._frames_ns if stamp > stamps[-1]]

    def _late_s(self, time_ns: int) -> float:
        """By how much more the clock has gone on than the records."""
        if self._begun is None:
            return 0.0
        return time.monotonic() - self._begun[1] - (time_ns - self._begun[0]) / NANOSECONDS / self._speed


def point_name(text: str) -> str:
    """A point's name out of any text: 64 letters, digits, - and _ at most."""
    named = "".join(sign if sign.isascii() and (sign.isalnum() or sign in "-_") else "-" for sign in text)
    return named[:64] or "point"


def point_called(given: str | None, recording: Recording) -> str:
    """The point that is meant: of this name, which is checked, or named after the recording. Raises UsageError."""
    try:
        return point_name(recording.name) if given is None else is_a_point(given)
    except ValueError as error:
        raise UsageError(f"--point {error}; received {given!r}. Give another name.") from None
