"""Records that wait for a point: readings in memory, the needed part of each frame in a file without a name."""

import errno
import os
import tempfile
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from midspan.records import NANOSECONDS, Arrival, Frame, Readings, Region
from midspan.service.cutting import part_of, whole_frame

# Records wait for at most so long: the points of a site are calibrated and opened one after another.
MAX_WAIT_S = 600.0
# The frames of a point that wait take so many bytes of the disk at most; the oldest are dropped then. Regions of
# 256 x 256 px at 25 frames a second, with what is around them, reach it after 160 s, those of 128 x 128 px after 600 s.
MAX_BYTES = 2**30


@dataclass(frozen=True, slots=True)
class FrameInFile:
    """A frame of which a part of `part_shape` at (x, y) is in the file, from `offset` on; frame: without its pixels."""

    stream: str
    sequence: int
    frame: Frame
    shape: tuple[int, int]
    place: tuple[int, int]
    part_shape: tuple[int, int]
    dtype: np.dtype[Any]
    offset: int

    @property
    def size(self) -> int:
        """How many bytes it takes."""
        return int(np.prod(self.part_shape)) * self.dtype.itemsize


class Waiting:
    """A queue of arrivals. folder: where the file of the frames is made; regions: the part of each camera's that waits.

    dropped: how many frames were dropped because they waited for too long, or took too much room.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.regions: Mapping[str, Region] = {}
        self._records: deque[Arrival | FrameInFile] = deque()
        self._file: Any = None
        # Room in the file that is free again, by size.
        self._free: dict[int, list[int]] = {}
        self._end = 0
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._records)

    def __iter__(self) -> Iterator[Arrival | FrameInFile]:
        return iter(self._records)

    def append(self, arrival: Arrival) -> None:
        """Let a record wait. Raises OSError where its frame cannot be written."""
        frame = arrival.record
        self._records.append(self._written(arrival, frame) if isinstance(frame, Frame) else arrival)
        newest_ns = _stamp(self._records[-1])
        while newest_ns - _stamp(self._records[0]) > MAX_WAIT_S * NANOSECONDS:
            self._drop(0)

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
        self._free.clear()
        self._end = 0
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None

    def _read(self, one: FrameInFile) -> Arrival:
        self._file.seek(one.offset)
        data = bytearray(self._file.read(one.size))
        self._free.setdefault(one.size, []).append(one.offset)
        part = np.frombuffer(data, dtype=one.dtype).reshape(one.part_shape)
        frame = replace(one.frame, pixels=whole_frame(part, one.place, one.shape))
        return Arrival(one.stream, one.sequence, frame)

    def _written(self, arrival: Arrival, frame: Frame) -> FrameInFile:
        part, place = part_of(frame.pixels, self.regions.get(arrival.stream))
        offset = self._room(part.nbytes)
        if self._file is None:
            self._folder.mkdir(parents=True, exist_ok=True)
            # It has no name: nothing of it is left, however the process ends.
            # Without a buffer a full disk shows where it is written to.
            self._file = tempfile.TemporaryFile(dir=self._folder, buffering=0)  # noqa: SIM115
        self._file.seek(offset)
        try:
            if self._file.write(part.tobytes()) < part.nbytes:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            self._free.setdefault(part.nbytes, []).append(offset)
            raise
        rows, columns = frame.pixels.shape
        bare = replace(frame, pixels=np.empty((0, 0), dtype=part.dtype))
        shape = (int(part.shape[0]), int(part.shape[1]))
        return FrameInFile(
            arrival.stream, arrival.sequence, bare, (rows, columns), place, shape, part.dtype, offset
        )  # fmt: skip

    def _room(self, size: int) -> int:
        """Where so many bytes can be written; frames that wait longest make room for them."""
        while not self._free.get(size) and self._end + size > MAX_BYTES:
            oldest = next((k for k, one in enumerate(self._records) if isinstance(one, FrameInFile)), None)
            if oldest is None:
                # What is free is of other sizes.
                self._free.clear()
                self._end = 0
                break
            self._drop(oldest)
        if self._free.get(size):
            return self._free[size].pop()
        offset, self._end = self._end, self._end + size
        return offset

    def _drop(self, number: int) -> None:
        one = self._records[number]
        del self._records[number]
        if isinstance(one, FrameInFile):
            self._free.setdefault(one.size, []).append(one.offset)
            self.dropped += 1


def _stamp(one: Arrival | FrameInFile) -> int:
    return one.frame.time_ns if isinstance(one, FrameInFile) else stamp_of(one)


def stamp_of(arrival: Arrival) -> int:
    """The newest stamp of a record."""
    record = arrival.record
    return int(record.time_ns[-1]) if isinstance(record, Readings) else int(record.time_ns)
