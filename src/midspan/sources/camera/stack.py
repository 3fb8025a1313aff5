"""Stacks of images in one array: npy (memory-mapped) and npz."""

import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import Frame, Nanoseconds
from midspan.sources.accelerometer.clock import numbers_to_ns
from midspan.sources.camera.frames import FrameInfo, FrameRequest, FrameSource, luma
from midspan.sources.camera.timing import file_times, rate_times

_NAMES = ("frames", "images", "celsius")
_MOST_BYTES_IN_MEMORY = 4 << 30
_LOCAL_HEADER_BYTES = 30


class StackFrames(FrameSource):
    """Frames of an array (frames, rows, columns), or (frames, rows, columns, colours); an npz may hold `time_s` too."""

    def __init__(self, path: Path, request: FrameRequest) -> None:
        self._path = path
        self._request = request
        try:
            self._array, self._times_s, note = _load(path)
        except (ValueError, OSError, EOFError, zipfile.BadZipFile, KeyError) as error:
            # NumPy takes anything else for Python objects, and advises to allow them.
            reason = "it is no array of numbers" if "pickle" in str(error) else str(error)
            raise DataError(
                f"{path} cannot be read as a NumPy stack: {reason}. Check that the file is whole, and an array of "
                "numbers."
            ) from error
        self._notes = [note] if note else []
        shape = self._array.shape
        if (
            self._array.ndim not in (3, 4)
            or (self._array.ndim == 4 and shape[3] > 4)
            or self._array.dtype.kind not in "biuf"
        ):
            raise DataError(
                f"{path} must hold real numbers of shape (frames, rows, columns); received {self._array.dtype} of "
                f"shape {shape}. Rearrange the array."
            )
        if 0 in shape:
            raise DataError(f"{path} must hold one frame or more; received shape {shape}. Check how it was written.")

    @property
    def info(self) -> FrameInfo:
        """Width, height and type of the stack; arrays are lossless."""
        first = luma(np.asarray(self._array[0]), reversed_colours=False)
        rows, columns = first.shape
        depth = 8 * first.dtype.itemsize
        codec = f"array {self._array.dtype}"
        return FrameInfo(columns, rows, depth, self._array.shape[0], codec, True, tuple(self._notes))

    def times_ns(self) -> Nanoseconds:
        """Time stamps from `times`, else the member `time_s`, else the rate."""
        return self._all_times()[:: self._request.every]

    def _all_times(self) -> Nanoseconds:
        count = self._array.shape[0]
        if self._request.times is not None:
            return file_times(self._request.times, self._path, count)
        if self._times_s is None:
            return rate_times(self._path, self._request, count)
        if self._times_s.shape != (count,):
            raise DataError(f"{self._path}: time_s has {self._times_s.size} values for {count} frames. Correct it.")
        time_ns, _ = numbers_to_ns(self._times_s, "s")
        if np.any(time_ns[1:] <= time_ns[:-1]):
            raise DataError(f"{self._path}: time_s must increase from frame to frame (s). Correct it.")
        return time_ns + np.int64(round(self._request.start_s * 1e9))

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames' luma, copied out of the file one at a time."""
        times = self.times_ns()
        for index in range(*slice(start, stop).indices(times.size)):
            image = np.array(self._array[index * self._request.every])
            yield Frame(int(times[index]), luma(image, reversed_colours=False), index)


def _load(path: Path) -> tuple[NDArray[np.generic], NDArray[np.float64] | None, str]:
    if path.suffix.lower() == ".npy":
        return np.load(path, mmap_mode="r", allow_pickle=False), None, ""
    with np.load(path, allow_pickle=False) as archive, zipfile.ZipFile(path) as packed:
        sizes = {name: packed.getinfo(f"{name}.npy") for name in archive.files}
        name = _stack_name(path, archive, list(archive.files))
        times_s = np.asarray(archive["time_s"], dtype=np.float64) if "time_s" in archive.files else None
        member = sizes[name]
        if member.compress_type == zipfile.ZIP_STORED:
            return _mapped(path, member), times_s, f"stack {name}"
        if member.file_size > _MOST_BYTES_IN_MEMORY:
            raise ValueError(
                f"its compressed array {name} needs {member.file_size / 2**30:.1f} GiB of memory, above the limit of "
                f"{_MOST_BYTES_IN_MEMORY / 2**30:.0f} GiB; write it with numpy.savez or as npy"
            )
        return archive[name], times_s, f"stack {name}"


def _stack_name(path: Path, archive: "np.lib.npyio.NpzFile", names: list[str]) -> str:
    """The member called frames, images or celsius, else the only one of three axes."""
    for name in _NAMES:
        if name in names:
            return name
    stacks = [name for name in names if archive[name].ndim in (3, 4)]
    if len(stacks) != 1:
        raise DataError(
            f"{path} must hold one array frames, images or celsius of shape (frames, rows, columns); it holds "
            f"{', '.join(names) or 'nothing'}. Rename the array."
        )
    return stacks[0]


def _mapped(path: Path, member: zipfile.ZipInfo) -> NDArray[np.generic]:
    """An array that lies uncompressed in the archive, mapped instead of loaded."""
    with path.open("rb") as file:
        file.seek(member.header_offset)
        header = file.read(_LOCAL_HEADER_BYTES)
        # The local header repeats the name's length and has an extra field of its own length.
        name_bytes, extra_bytes = struct.unpack("<HH", header[26:30])
        file.seek(member.header_offset + _LOCAL_HEADER_BYTES + name_bytes + extra_bytes)
        version = np.lib.format.read_magic(file)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read_header(file)
        if dtype.hasobject:
            raise ValueError("it holds Python objects")
        return np.memmap(path, dtype=dtype, mode="r", offset=file.tell(), shape=shape, order="F" if fortran else "C")
