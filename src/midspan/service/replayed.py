"""Recordings as live sources (`replay:RECORDING`): their records at their own pace, as if they came now.

The stamps of all streams of one recording are moved by the same time, so that the recording begins when the site does.
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from midspan.errors import DataError
from midspan.radar.chirp import RadarInfo
from midspan.records import NANOSECONDS, RangeFrame, Readings
from midspan.service.opening import BLOCK_S
from midspan.service.reasons import sentence
from midspan.settings.kinds import ACCELEROMETER, AUXILIARY
from midspan.sources.live.camera import Stamped, StampKind
from midspan.sources.live.instants import SourceFault

if TYPE_CHECKING:
    from midspan.recording.streams.recording import Recording


def _opened(address: str) -> tuple["Recording", str, str, int]:
    """The recording of `replay:RECORDING@START#SENSOR:AXIS`, the sensor, the image axis that is meant where the
    recording has both, and by how much its stamps are moved, so that the accelerometer begins at START (ns UTC).
    """
    from midspan.recording.streams.recording import open_recording

    rest, _, stream = address.removeprefix("replay:").rpartition("#")
    path, _, start = rest.rpartition("@")
    sensor, _, axis = stream.partition(":")
    recording = open_recording(path)
    return recording, sensor, axis, int(start) - int(recording.acceleration.time_ns[0])


def _along(recording: "Recording", axis: str) -> "Recording":
    """A recording along one of its two image axes; one that has a single axis as it is."""
    across = recording.across
    if across is None or axis != across.axis:
        return recording
    if not across.fused:
        raise DataError(f"{recording.file}: accelerometer.value_{axis}: is missing. Name the column along {axis}.")
    return across


def _view(recording: "Recording", sensor: str) -> Any:
    view = next((view for view in recording.views if view.sensor == sensor), None)
    if view is None:
        raise DataError(f"{recording.file}: has no [{sensor}].")
    return view


def readings(address: str) -> Iterator[tuple[float, Readings]]:
    """Blocks of the accelerometer or of another channel, each with the instant (s UTC) that it is due at."""
    recording, sensor, axis, moved_ns = _opened(address)
    if sensor == ACCELEROMETER:
        series = _along(recording, axis).acceleration
    elif sensor in AUXILIARY:
        series = recording.helping(sensor, axis)
    else:
        series = _view(recording, sensor).displacement
    time_ns = series.time_ns + moved_ns
    ends = np.flatnonzero(np.diff((time_ns - time_ns[0]) // round(BLOCK_S * NANOSECONDS))) + 1
    for stamps, value in zip(np.split(time_ns, ends), np.split(series.value[:, None], ends), strict=True):
        yield stamps[-1] / NANOSECONDS, Readings(stamps, value)


def range_frames(address: str) -> Iterator[tuple[float, RangeFrame]]:
    """The range profiles of a radar, each with the instant (s UTC) that it is due at."""
    recording, sensor, _, moved_ns = _opened(address)
    for block in _view(recording, sensor).radar.profiles():
        for frame in block:
            stamp = frame.time_ns + moved_ns
            yield stamp / NANOSECONDS, replace(frame, time_ns=stamp)


def radar_info(address: str, sensor: str) -> RadarInfo:
    """What is known of the radar of a recording at `address`."""
    from midspan.recording.streams.recording import open_recording

    info: RadarInfo = _view(open_recording(address), sensor).radar.info
    return info


def film(address: str) -> Iterator[Stamped]:
    """The frames of a camera, each when it is due; the end is a fault."""
    recording, sensor, _, moved_ns = _opened(address)
    for frame in _view(recording, sensor).frames.frames():
        stamp = frame.time_ns + moved_ns
        left_s = stamp / NANOSECONDS - time.time()
        if left_s > 0:
            time.sleep(left_s)
        elif left_s < -1.0:
            # What was due before the process ran is past, as with any camera.
            continue
        yield Stamped(replace(frame, time_ns=stamp), StampKind.SENDER)
    raise SourceFault("replay_ended", sentence("replay_ended"))
