"""Stacks of images in one array: npy (memory-mapped) and npz."""

import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import Frame, Nanoseconds
from midspan.sources.accelerometer.clock import numbers_to_ns
from midspan.sources.boundary import NpyHeader, read_npy_header, require_memory
from midspan.sources.camera.frames import MAX_MISSING, FrameRequest, StoredFrames, luma, passed_over, require_increasing
from midspan.vision.frame_source import FrameInfo

_NAMES = ("frames", "images", "celsius")
_AXES = (3, 4)
_LOCAL_HEADER_BYTES = 30
_READ_BYTES = 1 << 20  # at once, while a checksum is formed


def holds_stack(path: Path) -> bool:
    """Whether an npy or npz file declares an array that can be frames. What cannot be read is not judged."""
    try:
        if path.suffix.lower() == ".npy":
            with path.open("rb") as file:
                return len(read_npy_header(file).shape) in _AXES
        with zipfile.ZipFile(path) as archive:
            return any(len(_header(archive, member).shape) in _AXES for member in archive.infolist())
    except Exception:  # the readers say what is wrong with it
        return False


class StackFrames(StoredFrames):
    """Frames of an array (frames, rows, columns), or (frames, rows, columns, colours); an npz may hold `time_s` too.

    Frames without numbers are passed over; `info.damage` says which.
    """

    def __init__(self, path: Path, request: FrameRequest) -> None:
        super().__init__(path, request)
        self._passed: set[int] = set()
        array, self._times_s, self._notes = _load(path)
        self._array = np.asarray(array)
        shape, dtype = self._array.shape, self._array.dtype
        if len(shape) not in _AXES or (len(shape) == 4 and shape[3] > 4) or dtype.kind not in "biuf":
            raise DataError(
                f"{path} must hold real numbers of shape (frames, rows, columns); received {dtype} of "
                f"shape {shape}. Rearrange the array."
            )
        if 0 in shape:
            raise DataError(f"{path} must hold one frame or more; received shape {shape}. Check how it was written.")
        require_memory(path, self._array[0].nbytes, "one frame")
        self._count = shape[0]

    @property
    def info(self) -> FrameInfo:
        """Width, height and type of the stack; arrays are lossless."""
        first = luma(self._array[0], reversed_colours=False)
        rows, columns = first.shape
        codec, damage = f"array {self._array.dtype}", tuple(passed_over(self._passed))
        return FrameInfo(columns, rows, 8 * first.dtype.itemsize, self._count, codec, True, self._notes, damage=damage)

    def _own_times(self) -> Nanoseconds:
        """From the member `time_s`, else from the rate."""
        if self._times_s is None:
            return super()._own_times()
        if self._times_s.shape != (self._count,):
            raise DataError(
                f"{self._path}: time_s has {self._times_s.size} values for {self._count} frames. Correct it."
            )
        time_ns = require_increasing(f"{self._path}: time_s", numbers_to_ns(self._times_s, "s")[0])
        return time_ns + np.int64(round(self._request.start_s * 1e9))

    def _image(self, number: int) -> NDArray[np.generic] | None:
        """A frame's luma; grey ones of 8 or 16 bits are read from the mapped file where they are looked at."""
        image = self._array[number]
        is_judged = image.dtype.kind == "f" and not self._request.with_missing
        if is_judged and np.mean(~np.isfinite(image)) > MAX_MISSING:
            self._passed.add(number // self._request.every)
            return None
        return luma(image, reversed_colours=False)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Grey frames of 8 or 16 bits as they lie in the mapped file; others as `StoredFrames` makes them."""
        times, stack, every = self.times_ns(), np.asarray(self._array), self._request.every
        if stack.ndim != 3 or stack.dtype not in (np.uint8, np.uint16) or not stack.flags.c_contiguous:
            yield from super().frames(start, stop)
            return
        indices = range(*slice(start, stop).indices(times.size))
        for index, time_ns in zip(indices, times[indices.start : indices.stop].tolist(), strict=True):
            yield Frame(time_ns, stack[index * every], index)


def _load(path: Path) -> tuple[NDArray[np.generic], NDArray[np.float64] | None, tuple[str, ...]]:
    if path.suffix.lower() == ".npy":
        # Copy on write: what is changed in memory never reaches the file.
        return np.lib.format.open_memmap(path, mode="c"), None, ()
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        name = _stack_name(path, archive, members)
        times_s = None
        if "time_s" in members:
            times_s = np.asarray(_loaded(path, archive, members["time_s"]), dtype=np.float64)
        member = members[name]
        if member.compress_type != zipfile.ZIP_STORED:
            return _loaded(path, archive, member), times_s, (f"stack {name}",)
        array = _mapped(path, member)
        _check_sum(path, archive, member, array)
        return array, times_s, (f"stack {name}",)


def _stack_name(path: Path, archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo]) -> str:
    """The member called frames, images or celsius, else the only one of three or four axes, by the headers alone."""
    for name in _NAMES:
        if name in members:
            return name
    stacks = [name for name, member in members.items() if len(_header(archive, member).shape) in _AXES]
    if len(stacks) != 1:
        raise DataError(
            f"{path} must hold one array frames, images or celsius of shape (frames, rows, columns); it holds "
            f"{', '.join(members) or 'nothing'}. Rename the array."
        )
    return stacks[0]


def _header(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NpyHeader:
    with archive.open(member) as file:
        return read_npy_header(file)


def _loaded(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[np.generic]:
    """A member as an array in memory, which must have room for what its header declares."""
    require_memory(path, max(_header(archive, member).array_bytes, member.file_size), f"its array {member.filename}")
    with archive.open(member) as file:
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def _mapped(path: Path, member: zipfile.ZipInfo) -> NDArray[np.generic]:
    """An array that lies uncompressed in the archive, mapped instead of loaded."""
    with path.open("rb") as file:
        file.seek(member.header_offset)
        local = file.read(_LOCAL_HEADER_BYTES)
        # The local header repeats the name's length and has an extra field of its own length.
        name_bytes, extra_bytes = struct.unpack("<HH", local[26:30])
        file.seek(member.header_offset + _LOCAL_HEADER_BYTES + name_bytes + extra_bytes)
        header = read_npy_header(file)
        order: Literal["F", "C"] = "F" if header.fortran else "C"
        return np.memmap(path, dtype=header.dtype, mode="c", offset=file.tell(), shape=header.shape, order=order)


def _check_sum(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, array: NDArray[np.generic]) -> None:
    """DataError where an array is not what was written; the archive has one checksum for all its frames."""
    try:
        with archive.open(member) as file:
            while file.read(_READ_BYTES):
                pass
    except zipfile.BadZipFile as error:
        frames = array.shape[0] if array.ndim else 0
        raise DataError(
            f"{path}: the checksum (CRC-32) of its array {member.filename.removesuffix('.npy')} is wrong: one or more "
            f"of its {frames} frames have changed since they were written, and which cannot be known. Copy the file "
            "again from where it was made."
        ) from error
