"""Recordings as live sources (`replay:RECORDING`): their records at their own pace, as if they came now.

The stamps of all streams of one recording are moved by the same time, so that the recording begins when the site does.
"""

import time
from collections.abc import Iterator
from dataclasses import replace

from midspan.errors import DataError
from midspan.radar.chirp import RadarInfo
from midspan.recording.streams.recording import Recording, open_recording
from midspan.records import NANOSECONDS, RangeFrame, Readings
from midspan.sources.live.camera import Stamped, StampKind

# Readings come in blocks of this length.
BLOCK_S = 0.1


def parts(address: str) -> tuple[Recording, str, int]:
    """The recording of `replay:RECORDING@START#SENSOR`, the sensor's name and when it begins (ns UTC)."""
    rest, _, sensor = address.removeprefix("replay:").rpartition("#")
    path, _, start = rest.rpartition("@")
    return open_recording(path), sensor, int(start)


def readings(address: str) -> Iterator[tuple[float, Readings]]:
    """Blocks of the accelerometer or of a displacement sensor, each with the instant (s UTC) that it is due at."""
    recording, sensor, start_ns = parts(address)
    series = recording.acceleration
    if sensor != "accelerometer":
        series = next(view for view in recording.views if view.sensor == sensor).displacement
    time_ns = series.time_ns + (start_ns - int(recording.acceleration.time_ns[0]))
    step_ns = round(BLOCK_S * NANOSECONDS)
    number = (time_ns - time_ns[0]) // step_ns
    begin = 0
    for k in range(1, len(time_ns) + 1):
        if k == len(time_ns) or number[k] != number[begin]:
            yield time_ns[k - 1] / NANOSECONDS, Readings(time_ns[begin:k], series.value[begin:k, None])
            begin = k


def range_frames(address: str) -> Iterator[tuple[float, RangeFrame]]:
    """The range profiles of a radar, each with the instant (s UTC) that it is due at."""
    recording, sensor, start_ns = parts(address)
    moved_ns = start_ns - int(recording.acceleration.time_ns[0])
    source = next(view for view in recording.views if view.sensor == sensor).radar
    for block in source.profiles():
        for frame in block:
            stamp = frame.time_ns + moved_ns
            yield stamp / NANOSECONDS, replace(frame, time_ns=stamp)


def radar_info(address: str, sensor: str) -> RadarInfo:
    """What is known of the radar of a recording at `address`."""
    recording = open_recording(address)
    view = next((view for view in recording.views if view.sensor == sensor), None)
    if view is None:
        raise DataError(f"{recording.file}: has no [{sensor}].")
    return view.radar.info


def film(address: str) -> Iterator[Stamped]:
    """The frames of a camera, each when it is due; the end is a fault."""
    from midspan.sources.live.instants import SourceFault

    recording, sensor, start_ns = parts(address)
    view = next((view for view in recording.views if view.sensor == sensor), None)
    if view is None:
        raise DataError(f"{recording.file}: has no [{sensor}].")
    moved_ns = start_ns - int(recording.acceleration.time_ns[0])
    for frame in view.frames.frames():
        stamp = frame.time_ns + moved_ns
        left_s = stamp / NANOSECONDS - time.time()
        if left_s > 0:
            time.sleep(left_s)
        elif left_s < -1.0:
            # What was due before the process ran is past, as with any camera.
            continue
        yield Stamped(replace(frame, time_ns=stamp), StampKind.SENDER)
    raise SourceFault("ended", "the recording that is replayed has ended")
