"""A recording as a loop over its point's `push`: all records in, everything that came out of them back."""

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Generic, TypeVar

import numpy as np

from midspan.calibration.sensors.auxiliary import MEASURES
from midspan.engine.point import ACCELEROMETER, Output, Point
from midspan.engine.radar_trace import RadarLog
from midspan.engine.sensors import RadarSensor, Seen
from midspan.errors import DataError
from midspan.fusion.blocks import REJECTED, Rows, joined_rows
from midspan.recording.auxiliary import auxiliary_series
from midspan.recording.point import clock_offsets_ns, radar_frames
from midspan.recording.tracked import Side, TrackedCamera, known_sensors
from midspan.records import (
    NANOSECONDS,
    Arrival,
    Channel,
    Complete,
    Estimate,
    Event,
    Frame,
    Innovation,
    Measured,
    Nanoseconds,
    PhaseMeasurement,
    PixelTranslation,
    RangeFrame,
    Readings,
    Tracked,
    joined,
    part,
    places,
)
from midspan.settings.messages import in_words_of, worded

# Readings are pushed this many seconds at once: of a day at once, every stage would hold all of it several times.
BLOCK_S = 600.0
# This many blocks of rows or measurements become one.
JOINED = 512
T = TypeVar("T")

NOTHING_SEEN = (
    "radar: no frame shows any calibrated target. Calibrate again, or check radar.file and for an obstruction in "
    "front of the radar."
)


class Blocks(Generic[T]):
    """Blocks in their order. Those of frames take more memory than what they hold: they are joined on the way."""

    def __init__(self, join: Callable[[Sequence[T]], T], blocks: Sequence[T] = ()) -> None:
        self._join, self._whole, self._last = join, list[T](), list(blocks)

    def add(self, block: T) -> None:
        """Append one."""
        self._last.append(block)
        if len(self._last) >= JOINED:
            self._whole.append(self._join(self._last))
            self._last.clear()

    def __iter__(self) -> Iterator[T]:
        return chain(self._whole, self._last)


@dataclass(slots=True)
class Outcome:
    """What a point gave for a recording: rows, what each sensor measured, events; radars: what their stages found."""

    rows: Blocks[Rows] = field(default_factory=lambda: Blocks(joined_rows))
    measured: dict[str, Blocks[Measured]] = field(default_factory=dict)
    sensor_events: list[Event] = field(default_factory=list)
    events_of: dict[str, list[Event]] = field(default_factory=dict)
    radars: dict[str, RadarLog] = field(default_factory=dict)

    def take(self, outputs: Sequence[Output]) -> None:
        """Keep what a push gave."""
        for output in outputs:
            if isinstance(output, Rows):
                self.rows.add(output)
            elif isinstance(output, Event):
                self.sensor_events.append(output)
            elif isinstance(output, Seen):
                self.sensor_events += output.events
                self.events_of.setdefault(output.sensor, []).extend(output.events)
                if output.sensor in self.radars:
                    self.radars[output.sensor].push([one for one in output.found if isinstance(one, PhaseMeasurement)])
                if output.measured is not None:
                    self.measured.setdefault(output.sensor, Blocks(joined)).add(output.measured)

    def estimate(self, axis: int) -> Estimate:
        """The rows of an axis as one block."""
        return joined([rows.estimates[axis] for rows in self.rows if rows.estimates])

    @property
    def fusion_events(self) -> tuple[Event, ...]:
        """What the estimator decided that is worth an event."""
        return tuple(event for rows in self.rows for event in rows.events)

    def measured_by(self, sensor: str) -> Measured:
        """All that a sensor measured as one block in time order: of an instant and channel the last row that came."""
        found = joined(list(self.measured[sensor]))
        if (np.diff(found.time_ns) >= 0).all():
            return found
        order = np.lexsort((found.channel, found.time_ns))
        number, time_ns = found.channel[order], found.time_ns[order]
        last = np.append((np.diff(number) != 0) | (np.diff(time_ns) != 0), True)
        return part(found, order[last])

    @property
    def placed(self) -> dict[str, Blocks[Measured]]:
        """What was measured by the sensors that tell where the structure is."""
        return {name: blocks for name, blocks in self.measured.items() if name not in MEASURES}

    @property
    def measured_ns(self) -> Nanoseconds:
        """Stamps (n,) of all measurements of where the structure is, sensor by sensor."""
        blocks = [block for listed in self.placed.values() for block in listed]
        return np.concatenate([np.empty(0, dtype=np.int64), *(one.time_ns[np.isfinite(one.value)] for one in blocks)])

    @property
    def zero_variance_m2(self) -> tuple[float, ...]:
        """Variance of the zero of each axis at the end."""
        return next((rows.zero_variance_m2 for rows in reversed(list(self.rows)) if rows.zero_variance_m2), (0.0, 0.0))

    def innovation(self, channel: int) -> Innovation:
        """The innovations of a channel as one block."""
        return joined([rows.innovations[channel] for rows in self.rows if rows.innovations])

    def innovation_along(self, channels: Sequence[Channel], axis: int) -> Innovation:
        """Those of all channels along an axis in the order of time."""
        own = set(places(channels))
        along = [k for k, channel in enumerate(channels) if channel.axis == axis and channel in own]
        found = joined([self.innovation(k) for k in along])
        return part(found, np.argsort(found.time_ns, kind="stable"))


def used_when(outcome: Outcome, channels: Sequence[Channel], sensor: str) -> list[tuple[int, int]]:
    """First and last stamp (ns) of each segment in which a sensor's measurements were accepted without a long pause."""
    numbers = [k for k, channel in enumerate(channels) if channel.sensor == sensor]
    met = [outcome.innovation(k) for k in numbers]
    stamps = np.unique(np.concatenate([one.time_ns[one.verdict != REJECTED] for one in met]))
    longest_ns = NANOSECONDS * channels[numbers[0]].coasting_s
    parts = np.split(stamps, 1 + np.flatnonzero(np.diff(stamps) > longest_ns))
    return [(int(own[0]), int(own[-1])) for own in parts if len(own)]


def run(point: Point, sides: Sequence[Side], tracked_cameras: Sequence[TrackedCamera]) -> Outcome:
    """Push all records of a recording into its point."""
    outcome = Outcome()
    for name, sensor in point.sensors.items():
        if isinstance(sensor, RadarSensor):
            outcome.radars[name] = RadarLog(sensor.chain.targets)
    cameras = {tracked_camera.sensor: tracked_camera for tracked_camera in tracked_cameras}
    kept = {tracked_camera.sensor: tracked_camera.tracking.done for tracked_camera in tracked_cameras}
    for name, record in records_of(point, sides, tracked_cameras):
        with in_words_of(name):
            outputs = point.push(record)
        keep(outputs, cameras, kept)
        outcome.take(outputs)
    outputs = point.finish()
    keep(outputs, cameras, kept)
    outcome.take(outputs)
    for name, log in outcome.radars.items():
        if not any(log.used):
            raise DataError(worded(NOTHING_SEEN, name))
    return outcome


def records_of(
    point: Point, sides: Sequence[Side], tracked_cameras: Sequence[TrackedCamera], *, block_s: float = BLOCK_S
) -> Iterator[tuple[str, Arrival | Complete]]:
    """All records of a recording, readings ahead of the frames that they cover; with each the stream that it is from.

    block_s: readings come in blocks of about this length; how they are cut has no effect on any row.
    """
    main = sides[0].recording
    value = np.column_stack([side.recording.acceleration.value for side in sides if side.recording.fused])
    readings = {ACCELEROMETER: Readings(main.acceleration.time_ns, value)}
    feeds: dict[str, Iterator[Tracked | Frame | RangeFrame]] = {
        tracked_camera.sensor: frames_of(tracked_camera) for tracked_camera in tracked_cameras
    }
    for view, known in known_sensors(sides[0]):
        sensor = point.sensors[view.sensor]
        if isinstance(sensor, RadarSensor):
            feeds[view.sensor] = radar_frames(view, sensor)
        else:
            series = view.displacement
            readings[view.sensor] = Readings(known.even(series.time_ns), series.value[:, None])
    for kind, series in auxiliary_series(main, sides[0].calibration.auxiliary).items():
        if kind in point.sensors:
            readings[kind] = Readings(series.time_ns, series.value[:, None])
    offsets_ns = {ACCELEROMETER: 0, **clock_offsets_ns(sides[0], tracked_cameras)}
    blocks, frames = blocks_of(readings, offsets_ns, block_s), in_time(feeds, offsets_ns)
    # At equal stamps the blocks come first.
    for _, name, record in heapq.merge(blocks, frames, key=lambda due: due[0]):
        yield name, record


def blocks_of(
    readings: Mapping[str, Readings], offsets_ns: Mapping[str, int], block_s: float
) -> Iterator[tuple[int, str, Arrival | Complete]]:
    """Readings of several streams in blocks: begin (ns) of each one's span on the common clock, stream and block."""
    first_ns = min((int(one.time_ns[0]) + offsets_ns[name] for name, one in readings.items() if len(one.time_ns)))
    last_ns = max((int(one.time_ns[-1]) + offsets_ns[name] for name, one in readings.items() if len(one.time_ns)))
    step_ns = int(min(NANOSECONDS * block_s, last_ns - first_ns + 1))
    places, counts = dict.fromkeys(readings, 0), dict.fromkeys(readings, 0)
    # What is backwards or doubled is for the engine to judge: a block ends where the stamps first pass its end.
    latest = {name: np.maximum.accumulate(one.time_ns) + offsets_ns[name] for name, one in readings.items()}
    for number in range(1 + int((last_ns - first_ns) // step_ns)):
        for name, one in readings.items():
            end = int(np.searchsorted(latest[name], first_ns + (number + 1) * step_ns))
            if end > places[name]:
                part = Readings(one.time_ns[places[name] : end], one.value[places[name] : end])
                yield first_ns + number * step_ns, name, Arrival(name, counts[name], part)
                places[name], counts[name] = end, counts[name] + 1


def frames_of(tracked_camera: TrackedCamera) -> Iterator[Tracked | Frame]:
    """A camera's frames: first those that were tracked while it was calibrated, with their translations."""
    tracking = tracked_camera.tracking
    for k in range(tracking.done):
        stamp = int(tracking.time_ns[k])
        yield Tracked(stamp, stamp, tuple(target.translation(k) for target in tracking.targets))
    while (frame := tracking.take()) is not None:
        yield frame


def in_time(
    feeds: Mapping[str, Iterator[Tracked | Frame | RangeFrame]], offsets_ns: Mapping[str, int]
) -> Iterator[tuple[int, str, Arrival | Complete]]:
    """The frames of all streams in the order of the common clock, one of each stream read ahead at most; behind the
    last one of an instant, that all streams have brought theirs. With each its stamp and stream.

    offsets_ns: what is added to the stamps of each to get that clock.
    """
    waiting: list[tuple[int, int, str, Tracked | Frame | RangeFrame]] = []
    counts = dict.fromkeys(feeds, 0)

    def read(name: str) -> None:
        record = next(feeds[name], None)
        if record is not None:
            heapq.heappush(waiting, (record.time_ns + offsets_ns[name], list(feeds).index(name), name, record))

    for name in feeds:
        read(name)
    while waiting:
        stamp, _, name, record = heapq.heappop(waiting)
        yield stamp, name, Arrival(name, counts[name], record)
        counts[name] += 1
        read(name)
        if not waiting or waiting[0][0] > stamp:
            yield stamp, name, Complete(stamp)


def keep(outputs: Sequence[Output], cameras: Mapping[str, TrackedCamera], kept: dict[str, int]) -> None:
    """Let the cameras keep what was found in their frames, on their own clocks.

    kept: how many of the following frames of each they have kept already.
    """
    for output in outputs:
        if isinstance(output, Seen) and output.found and output.sensor in cameras:
            kept[output.sensor] -= 1
            if kept[output.sensor] >= 0:
                continue
            tracked_camera = cameras[output.sensor]
            early_ns = -round(NANOSECONDS * tracked_camera.calibrations[0].offset.value_s)
            found = [one for one in output.found if isinstance(one, PixelTranslation)]
            tracked_camera.tracking.keep([one.later(early_ns) for one in found])
