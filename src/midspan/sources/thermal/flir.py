"""FLIR files as frames in °C: seq and csq, and those of one frame, fff and JPEG, of which a folder is a sequence."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError, UsageError
from midspan.records import Floats32, Nanoseconds
from midspan.sources.boundary import mapped
from midspan.sources.camera.frames import StoredFrames, file_times, grid, named
from midspan.sources.thermal.fff import (
    Block,
    CameraInfo,
    blocks,
    camera_info,
    counts,
    embedded_block,
    frame_size,
    is_jpeg,
    next_block,
)
from midspan.sources.thermal.temperatures import ThermalRequest, checked_celsius
from midspan.thermal.radiometry import OpticalPath, Planck, celsius_table
from midspan.vision.frame_source import FrameInfo

# With fewer stamps in their order than this share, none is accepted.
MIN_IN_ORDER = 0.95
SUFFIXES = (".fff", ".seq", ".csq", ".fcf")


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a frame lies, its time stamp, and its width and height in px."""

    file: Path
    block: Block
    time_ns: int
    size: tuple[int, int]


class FlirFrames(StoredFrames):
    """Frames of FLIR files in °C, by the calibration and the surroundings that the camera wrote with each one."""

    def __init__(self, files: Sequence[Path], request: ThermalRequest, left_out: int = 0) -> None:
        """`left_out`: the number of pictures without raw counts in the same folder."""
        super().__init__(files[0], request.frames)
        self._files, self._emissivity = list(files), request.emissivity
        self._tables: dict[tuple[Planck, OpticalPath], Floats32] = {}
        self._notes: list[str] = [f"{left_out} pictures without raw counts are left out"] if left_out else []
        self._damage: list[str] = []
        self._places = [place for file in self._files for place in self._walked(file)]
        if not self._places:
            raise DataError(
                f"{self._files[0]} holds no whole FLIR frame with raw counts. Check that the file is whole."
            )
        first = self._places[0].size
        for number, place in enumerate(self._places):
            if place.size != first:
                raise DataError(
                    f"{place.file}: frame {number} must have the size of the first, {first[0]}x{first[1]} px; received "
                    f"{place.size[0]}x{place.size[1]} px. Split the sequence where the camera's format changed."
                )
        with _bytes(self._files[0]) as data:
            self._first = camera_info(data, self._places[0].block)
        self._image(0)
        self._times, note = self._all_times()
        self._notes += [f"{self._first.model or 'FLIR camera'}, {note}"]

    @property
    def info(self) -> FrameInfo:
        """Size and number of frames; temperatures are float32 in °C."""
        (width, height), count = self._places[0].size, len(self._places)
        notes, damage = tuple(self._notes), tuple(self._damage)
        codec = "FLIR records, 16-bit counts"
        return FrameInfo(width, height, 32, count, codec, True, notes, radiometric=True, damage=damage)

    def times_ns(self) -> Nanoseconds:
        """Time stamps from `times`, else the camera's own (ms, since 1970), else a rate; `start_s` is added."""
        return self._times[:: self._request.every]

    def _image(self, number: int) -> Floats32 | None:
        """Temperatures in °C, float32; a damaged frame is passed over and reported in `info`."""
        place = self._places[number]
        with _bytes(place.file) as data:
            try:
                info, raw = camera_info(data, place.block), counts(data, place.block)
            except DataError as error:
                note = f"frame {number} {error}; it is skipped"
                self._damage += [] if note in self._damage else [note]
                return None
        return checked_celsius(self._table(info)[raw], f"{place.file}: frame {number}")

    def _table(self, info: CameraInfo) -> Floats32:
        """Temperature by count; made once for each calibration, which changes with the camera's range only."""
        stated = self._emissivity
        path = info.path if stated is None else replace(info.path, emissivity=stated)
        key = (info.planck, path)
        if key not in self._tables:
            if len(self._tables) > 16:
                self._tables.clear()
            self._tables[key] = celsius_table(info.planck, path)
        return self._tables[key]

    def _walked(self, file: Path) -> list[_Place]:
        with _bytes(file) as data:
            found: list[_Place] = []
            begin: int | None = 0
            while begin is not None:
                try:
                    for block in blocks(data, begin):
                        place = _Place(file, block, camera_info(data, block).time_ns, frame_size(data, block))
                        found.append(place)
                except (DataError, UsageError) as error:
                    raise DataError(f"{file}: frame {len(found)} {error}") from error
                if is_jpeg(file):
                    # One picture, one block; what stands behind it belongs to the camera.
                    return found[:1]
                end = found[-1].block.end if found else 0
                begin = next_block(data, end + 1) if end < len(data) else None
                if begin is not None:
                    self._damage.append(
                        f"{begin - end} bytes of {file.name} before frame {len(found)} are not a complete frame and "
                        "were skipped"
                    )
            if found and end < len(data):
                self._damage.append(f"the last {len(data) - end} bytes of {file.name} are not a complete frame")
            return found

    def _all_times(self) -> tuple[Nanoseconds, str]:
        """Stamps of all frames and how they were found."""
        request, count = self._request, len(self._places)
        if request.times is not None:
            return file_times(request.times, self._files[0], count), f"times from {request.times.name}"
        start_ns = round(request.start_s * 1e9)
        stamps = np.array([place.time_ns for place in self._places], dtype=np.int64)
        # The few frames are left out whose stamp does not fit between those around it.
        wrong = wrong_stamps(stamps)
        if len(wrong):
            self._damage.append(
                f"{len(wrong)} frames ({named(wrong.tolist())}) have stamps out of order and were skipped"
            )
            self._places = [place for k, place in enumerate(self._places) if k not in set(wrong.tolist())]
            stamps = np.delete(stamps, wrong)
        if stamps[0] > 0 and np.all(stamps[1:] > stamps[:-1]):
            begun = datetime.fromtimestamp(int(stamps[0]) / 1e9, UTC).isoformat(timespec="milliseconds")
            return stamps + np.int64(start_ns), f"the camera's stamps, from {begun}"
        rate = request.rate_hz or self._first.rate_hz
        if not rate > 0:
            raise UsageError(f"{self._files[0]}: its time stamps do not increase. Give rate_hz, or times.")
        reported = (
            f"its stamps do not increase: taken as {rate:g} frames a second from start_s = {request.start_s:g} s on"
        )
        self._damage.append(f"{self._files[0].name}: {reported}")
        return grid(len(stamps), Fraction(rate), start_ns), reported


@contextmanager
def _bytes(file: Path) -> Iterator[memoryview]:
    """The blocks of a file; those of a JPEG are put together from its segments."""
    if is_jpeg(file):
        yield memoryview(embedded_block(file))
        return
    with mapped(file) as data:
        yield data


def wrong_stamps(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of the frames whose stamps (n,) break the order of the others; none where they are not a few slips.

    Where the clock was set back the frames in between leave no room for those that would be left out.
    """
    nothing: NDArray[np.int64] = np.empty(0, dtype=np.int64)
    if np.all(stamps[1:] > stamps[:-1]):
        return nothing
    kept = _longest_increasing(stamps)
    if len(kept) < MIN_IN_ORDER * len(stamps) or len(kept) < 2:
        return nothing
    steps = np.diff(kept)
    usual = float(np.median(np.diff(stamps[kept]) / steps))
    fits = np.diff(stamps[kept]) > (steps - 0.5) * usual
    wrong: NDArray[np.int64] = np.setdiff1d(np.arange(len(stamps)), kept)
    return wrong if fits.all() else nothing


def _longest_increasing(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of the longest series of stamps (n,) that increase."""
    ends: list[int] = []
    places: list[int] = []
    before: list[int] = []
    for k, stamp in enumerate(stamps.tolist()):
        place = bisect_left(ends, stamp)
        before.append(places[place - 1] if place else -1)
        ends[place : place + 1] = [stamp]
        places[place : place + 1] = [k]
    series = [places[-1]]
    while before[series[-1]] >= 0:
        series.append(before[series[-1]])
    return np.array(series[::-1], dtype=np.int64)
