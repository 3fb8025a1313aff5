"""A live point out of a captured recording and its calibration, and out of a checkpoint."""

import heapq
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from midspan.engine.channels import interval_s
from midspan.engine.checkpoint import from_bytes, parts_of, to_bytes
from midspan.engine.point import ACCELEROMETER, Point, PointState
from midspan.engine.sensors import CameraSensor, RadarSensor
from midspan.errors import DataError
from midspan.notices import Notice
from midspan.progress import silent
from midspan.records import (
    NANOSECONDS,
    Arrival,
    Floats,
    PixelTranslation,
    RangeFrame,
    Readings,
    Region,
    Status,
    Tick,
    Tracked,
)
from midspan.service.cutting import around
from midspan.service.journal import TRANSLATION, Journal, target_stream
from midspan.settings.stored.calibration import Calibration
from midspan.store.chunk import Chunk
from midspan.store.store import Store

# The others are waited for so long behind the accelerometer: the first value of a block of a second comes that late. A
# stream that is silent for longer than the second is out.
LATENESS_S, SILENT_S = 1.5, 5.0
# Readings of a captured recording are pushed in blocks of this length: well below what the others are waited for.
BLOCK_S = 0.1
SEPARATOR = b"\n"
# What came before a restart is given with ticks this far apart (ns): below the time after which a sensor is silent.
TICK_NS = NANOSECONDS


@dataclass(frozen=True, slots=True)
class Opened:
    """A point on live records: the engine's point, what keeps its records, and the numbers of the records pushed.

    regions: of each camera, the smallest that holds all its targets, px; bins: of each radar's targets. delay_s: by how
    much a row comes later than its sample at most, s; warnings: of its calibration, that something is to be done about.
    """

    point: Point
    journal: Journal
    counts: dict[str, int]
    newest_ns: dict[str, int]
    regions: dict[str, Region]
    bins: dict[str, Floats]
    delay_s: float
    warnings: tuple[Notice, ...] = ()

    @property
    def has_own_zero(self) -> bool:
        """Whether its sensors have a zero of their own, which every opening counts from: displacement sensors alone."""
        return not any(isinstance(one, CameraSensor | RadarSensor) for one in self.point.sensors.values())

    def takes(self, stream: str) -> bool:
        """Whether the point takes a stream: one that only helps may be left out of its calibration."""
        return stream == ACCELEROMETER or stream in self.point.sensors

    @property
    def scale_std(self) -> float:
        """Relative standard deviation of the least certain scale in use."""
        return max((std for _, std in self.point.scale_errors().values()), default=0.0)


def opened(folder: Path, name: str, calibration: Calibration, number: int, *, push: bool = True) -> Opened:
    """The live point of a captured recording.

    number: of the calibration in the store; it is used for months, so that its scales are uncertain, and followed, as
    those of any given one. push: give the point the recording's own records, from which its rows begin. Raises what
    `estimate` raises.
    """
    # Here, so that a service is back soon, and one of groups never needs them.
    from midspan.recording.estimate import Asked
    from midspan.recording.messages import require_same_sensors
    from midspan.recording.point import clock_offsets_ns
    from midspan.recording.run import records_of
    from midspan.recording.streams.recording import open_recording
    from midspan.recording.tracked import open_tracked_cameras

    recording = open_recording(folder)
    method = recording.settings.fusion.method
    require_same_sensors(recording, calibration)
    asked = Asked(recording, calibration, method, given=True)
    sides = asked.sides
    tracked_cameras = open_tracked_cameras(sides, None, silent)
    point = asked.point(sides, tracked_cameras, log=False, wait_s=(LATENESS_S, SILENT_S))
    motion_m = point.estimator.settings.motion[0][0]
    journal = Journal(name, clock_offsets_ns(sides[0], tracked_cameras), calibration=number, motion_m=motion_m)
    regions = {
        tracked_camera.sensor: around([target.region for target in tracked_camera.tracking.targets])
        for tracked_camera in tracked_cameras
    }
    bins = {name: one.chain.bins for name, one in point.sensors.items() if isinstance(one, RadarSensor)}
    # A lagged row comes up to a quarter of the lag later than that.
    delay_s = 1.25 * point.estimator.lag_samples * interval_s(recording.acceleration.time_ns)
    found = Opened(point, journal, {}, {}, regions, bins, delay_s, calibration.to_act_on)
    if push:
        # Nobody has brought all up to the last frame: what comes after the recording would be too late.
        last_ns = int(recording.acceleration.time_ns[-1]) - round(LATENESS_S * NANOSECONDS)
        for stream, record in records_of(point, sides, tracked_cameras, block_s=BLOCK_S):
            if isinstance(record, Arrival):
                found.counts[stream] = found.counts.get(stream, -1) + 1
                found.newest_ns[stream] = record.newest_ns
            elif record.time_ns > last_ns:
                continue
            journal.given(point.push(record))
    for tracked_camera in tracked_cameras:
        tracked_camera.tracking.close()
    return found


def checkpoint(found: Opened, folder: Path) -> list[bytes]:
    """All that a restart needs, in parts: the captured recording's folder, the calibration, the engine's state."""
    head = {
        "folder": folder.name,
        "calibration": found.journal.calibration,
        "counts": found.counts,
        "newest_ns": found.newest_ns,
        "rows": found.journal.memory,
    }
    return [json.dumps(head).encode() + SEPARATOR, *parts_of(to_bytes(found.point.state))]


def head_of(kept: bytes) -> dict[str, Any]:
    """What stands before the engine's state in a checkpoint. Raises DataError."""
    head, separator, _ = kept.partition(SEPARATOR)
    try:
        tree = json.loads(head) if separator else None
    except ValueError:
        tree = None
    if not isinstance(tree, dict) or not {"folder", "calibration", "counts", "newest_ns"} <= set(tree):
        raise DataError("The store's checkpoint is damaged; the point starts anew.")
    return tree


def resumed(found: Opened, kept: bytes, store: Store) -> None:
    """Let a point go on from a checkpoint, with the records that the store has kept since then."""
    head = head_of(kept)
    found.point.restore(from_bytes(kept.partition(SEPARATOR)[2], PointState))
    found.counts.update(head["counts"])
    found.newest_ns.update(head["newest_ns"])
    found.journal.remember(head.get("rows", {}))
    newest_ns, now_ns = max(found.newest_ns.values(), default=0), found.point.merge.now_ns
    for arrival in kept_since(found, store):
        if now_ns is not None:
            # The shell's time as it was then, so that a sensor's pause is one, and no clock that was set ahead.
            for tick_ns in range(now_ns + TICK_NS, now_ns + arrival.newest_ns - newest_ns, TICK_NS):
                found.journal.given(found.point.push(Tick(tick_ns)))
                now_ns, newest_ns = tick_ns, newest_ns + TICK_NS
        found.counts[arrival.stream] = arrival.sequence
        found.newest_ns[arrival.stream] = arrival.newest_ns
        found.journal.given(found.point.push(arrival))


def kept_since(found: Opened, store: Store) -> Iterator[Arrival]:
    """The raw records in the store that a point has not seen, in the order of their stamps."""
    feeds = [_readings(found, store, ACCELEROMETER)]
    for name, sensor in found.point.sensors.items():
        if isinstance(sensor, CameraSensor):
            feeds.append(_tracked(found, store, name, len(sensor.channels)))
        elif isinstance(sensor, RadarSensor):
            feeds.append(_phasors(found, store, name))
        else:
            feeds.append(_readings(found, store, name))
    counts = dict(found.counts)
    for _, arrival in heapq.merge(*feeds, key=lambda one: one[0]):
        counts[arrival.stream] = counts.get(arrival.stream, -1) + 1
        yield Arrival(arrival.stream, counts[arrival.stream], arrival.record)


def _chunks(found: Opened, store: Store, stream: str, kept_as: str) -> Iterator[Chunk]:
    newest_ns = store.newest_ns(found.journal.point, kept_as)
    after_ns = found.newest_ns.get(stream)
    if newest_ns is not None and after_ns is not None:
        yield from store.chunks(found.journal.point, kept_as, after_ns + 1, newest_ns)


def _readings(found: Opened, store: Store, stream: str) -> Iterator[tuple[int, Arrival]]:
    for chunk in _chunks(found, store, stream, stream):
        value = np.asarray(chunk.columns["value"], dtype=np.float64).reshape(len(chunk.time_ns), -1)
        # In blocks as short as they came: one stream's chunk of seconds would make the others' readings late.
        ends = np.flatnonzero(np.diff(chunk.time_ns // round(BLOCK_S * NANOSECONDS))) + 1
        for time_ns, part in zip(np.split(chunk.time_ns, ends), np.split(value, ends), strict=True):
            yield int(time_ns[0]), Arrival(stream, 0, Readings(time_ns, part))


def _phasors(found: Opened, store: Store, stream: str) -> Iterator[tuple[int, Arrival]]:
    for chunk in _chunks(found, store, stream, stream):
        if chunk.calibration != found.journal.calibration:
            # Bins of other targets.
            continue
        for k, stamp in enumerate(chunk.time_ns.tolist()):
            valid = np.asarray(chunk.columns["valid"][k], dtype=np.bool_)
            phasors = np.asarray(chunk.columns["phasors"][k], dtype=np.complex64).reshape(len(valid), -1)
            yield stamp, Arrival(stream, 0, RangeFrame(stamp, phasors, valid))


def _tracked(found: Opened, store: Store, stream: str, targets: int) -> Iterator[tuple[int, Arrival]]:
    feeds = [_chunks(found, store, stream, target_stream(stream, k)) for k in range(targets)]
    for chunks in zip(*feeds, strict=True):
        for row, stamp in enumerate(chunks[0].time_ns.tolist()):
            yield stamp, Arrival(stream, 0, Tracked(stamp, stamp, tuple(translation(one, row) for one in chunks)))


def translation(chunk: Chunk, row: int) -> PixelTranslation:
    """A row of a kept track as it came from the tracker."""
    # Stores that were begun by an earlier version have no zoom.
    own: Mapping[str, Any] = {name: chunk.columns[name][row].item() for name in TRANSLATION if name in chunk.columns}
    return PixelTranslation(time_ns=int(chunk.time_ns[row]), **{**own, "status": Status(own["status"])})
