"""What a store writes to its disk, and what it keeps: `python -m benchmarks.live.wear [MINUTES] [POINTS]`.

Points of 100 Hz with acceleration in float32 (white noise, whose bits no code makes fewer) and a camera of 10 frames a
second run through the live engine. What each gives in a second is written as the service writes it: raw records,
rows, events, checkpoints. Bytes written are the pages that this process made dirty (/proc/self/io); every
WRITEBACK_S of the records' time all files are brought to the disk, as the kernel does with what nobody synchronised.
What the file system itself adds (its journal, and the flash's own blocks) is not in it.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.live.day import write
from benchmarks.live.servers import command
from benchmarks.table import goal
from midspan.engine.point import Point
from midspan.progress import silent
from midspan.recording.estimate import Asked
from midspan.recording.run import records_of
from midspan.recording.streams.recording import open_recording
from midspan.recording.tracked import open_tracked_cameras
from midspan.records import NANOSECONDS, Arrival, Readings
from midspan.service.journal import Journal
from midspan.service.opening import Opened, checkpoint
from midspan.service.point import CHECKPOINT_S
from midspan.settings.stored.calibration import load_calibration
from midspan.store.chunk import Chunk
from midspan.store.store import Batch, open_store

MINUTES, POINTS = 32.0, 3
# Begins of the rates: tables and templates are written once.
SETTLE_S = 640.0
# Linux writes back what has been dirty for so long (vm.dirty_expire_centisecs), s.
WRITEBACK_S = 30.0
DAY_S = 86_400.0
GOAL_WRITTEN, GOAL_MB = 3.0, 80.0
# A round second: the blocks of the store begin at multiples of their length.
BEGIN_NS = 20_700 * 86_400 * NANOSECONDS


def seconds(folder: Path) -> Iterator[tuple[float, Batch]]:
    """What a point gives in each second of its recording, and the time since the begin."""
    recording = open_recording(folder)
    calibration = load_calibration(folder / "calibration.json")
    asked = Asked(recording, calibration, "kalman", given=True)
    cameras = open_tracked_cameras(asked.sides, None, silent)
    point: Point = asked.point(asked.sides, cameras, log=False)
    found = Opened(point, Journal("p", {}, calibration=1), {}, {}, {}, {}, 0.0)
    shift_ns = BEGIN_NS - int(recording.acceleration.time_ns[0])
    last_ns, kept_ns = BEGIN_NS, BEGIN_NS
    for _, record in records_of(point, asked.sides, cameras, block_s=0.2):
        if not isinstance(record, Arrival):
            continue
        found.counts[record.stream] = found.counts.get(record.stream, -1) + 1
        found.newest_ns[record.stream] = record.newest_ns
        found.journal.arrived(record)
        found.journal.given(point.push(record))
        now_ns = record.newest_ns + shift_ns
        if isinstance(record.record, Readings) and now_ns - last_ns >= NANOSECONDS:
            batch, last_ns = found.journal.batch(), now_ns
            chunks = [live(chunk, shift_ns) for chunk in batch.chunks]
            checkpoints = {}
            if now_ns - kept_ns >= CHECKPOINT_S * NANOSECONDS:
                checkpoints, kept_ns = {"p": (now_ns, checkpoint(found, folder))}, now_ns
            yield (now_ns - BEGIN_NS) / NANOSECONDS, Batch(chunks, batch.events, checkpoints)


def live(chunk: Chunk, shift_ns: int) -> Chunk:
    """A chunk at a time of today, acceleration as MQTT brings it: in numbers of float32."""
    columns = dict(chunk.columns)
    if chunk.stream == "accelerometer":
        columns["value"] = columns["value"].astype(np.float32).astype(np.float64)
    return replace(chunk, time_ns=chunk.time_ns + shift_ns, columns=columns)


def of_point(batch: Batch, name: str) -> Batch:
    """The same of another point."""
    chunks = [replace(one, point=name) for one in batch.chunks]
    checkpoints = dict.fromkeys((name,) if batch.checkpoints else (), next(iter(batch.checkpoints.values()), None))
    return Batch(chunks, [(name, event) for _, event in batch.events], checkpoints)


def written_bytes() -> int:
    """What this process made dirty so far."""
    lines = Path("/proc/self/io").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("write_bytes"))


def kept_bytes(store: Path) -> int:
    """The sizes of a store's files, but for SQLite's write-ahead logs, which are written again and again."""
    return sum(file.stat().st_size for file in store.rglob("*") if file.is_file() and "sqlite-" not in file.name)


def to_disk(store: Path) -> None:
    """Write back what nobody has synchronised."""
    for file in store.rglob("*"):
        if file.is_file():
            descriptor = os.open(file, os.O_RDONLY)
            os.fdatasync(descriptor)
            os.close(descriptor)


def measured(batches: list[tuple[float, Batch]], where: Path, points: list[str]) -> tuple[float, float]:
    """Bytes written and bytes kept, in a day."""
    store, before, synced_s = open_store(where, points=points), (0.0, 0, 0), 0.0
    for now_s, batch in batches:
        for name in points:
            store.write(of_point(batch, name))
        if now_s - synced_s >= WRITEBACK_S:
            to_disk(where)
            synced_s = now_s
        if not before[0] and now_s >= SETTLE_S:
            store.flush()
            before = (now_s, written_bytes(), kept_bytes(where))
    now_s = batches[-1][0]
    store.flush()
    after = (written_bytes(), kept_bytes(where))
    store.close()
    a_day = DAY_S / (now_s - before[0])
    return a_day * (after[0] - before[1]), a_day * (after[1] - before[2])


def main(minutes: float = MINUTES, count: int = POINTS) -> int:
    """Write, and print what was written and kept."""
    with tempfile.TemporaryDirectory(prefix="midspan-wear-") as name:
        folder = Path(name) / "recording"
        folder.mkdir()
        write(folder, minutes / 60.0, pictures=True)
        subprocess.run(command("calibrate", folder, "--quiet"), check=True)
        batches = list(seconds(folder))
        points = [f"point-{number}" for number in range(count)]
        without = [(now_s, Batch([c for c in one.chunks if c.stream != "camera:0"])) for now_s, one in batches]
        written, kept = measured(batches, Path(name) / "store", points)
        _, of_rows = measured(without, Path(name) / "rows", points)
    print(f"        {count} points: {written / 1e6:.0f} MB written, {kept / 1e6:.0f} MB kept a day")
    goal("written for each byte kept", written / kept, GOAL_WRITTEN)
    goal("rows of 100 Hz with raw acceleration, a day and point", of_rows / count / 1e6, GOAL_MB, unit="MB")
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(float, sys.argv[1:2]), *map(int, sys.argv[2:3])))
