"""Photron high-speed recordings: a text header (cih) with the raw frames (mraw)."""

import glob
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import NANOSECONDS, Floats, Frame, Nanoseconds
from midspan.sources.camera.frames import FrameRequest
from midspan.sources.camera.timing import file_times
from midspan.vision.frame_source import FrameInfo, FrameSource

# Keys of the header that the frames cannot be read without.
_WIDTH, _HEIGHT, _COUNT, _BITS, _RATE = "Image Width", "Image Height", "Total Frame", "Color Bit", "Record Rate(fps)"
_BITS_KNOWN = (8, 12, 16)
# No width, count or rate (frames per second) of a recording comes near; stamps are whole nanoseconds.
_MAX_HEADER_NUMBER = 1e9


class PhotronFrames(FrameSource):
    """Monochrome frames of 8, 12 (packed) or 16 bit; `path` is the cih or the mraw file, the other is in the same
    folder.
    """

    def __init__(self, path: Path, request: FrameRequest) -> None:
        self._path, self._request = path, request
        header_file, self._raw_file = _pair(path)
        header = _header(header_file)
        self._columns, self._rows, self._count, self._bits = (
            int(_number(header, key, header_file, least=1.0)) for key in (_WIDTH, _HEIGHT, _COUNT, _BITS)
        )
        self._rate_hz = request.rate_hz or _number(header, _RATE, header_file)
        if header.get("Color Type", "Mono") != "Mono" or self._bits not in _BITS_KNOWN:
            raise DataError(
                f"{header_file}: frames must be monochrome of 8, 12 or 16 bit; received {header.get('Color Type')} of "
                f"{self._bits} bit. Export them from the camera's software as such."
            )
        self._frame_bytes = -(-self._columns * self._rows * self._bits // 8)
        held = self._raw_file.stat().st_size // self._frame_bytes
        if held == 0:
            raise DataError(
                f"{self._raw_file}: must hold frames of {self._frame_bytes} bytes ({self._columns}x{self._rows} px, "
                f"{self._bits} bit); it has {self._raw_file.stat().st_size} bytes. Copy it again."
            )
        self._damage: list[str] = []
        if held < self._count:
            self._damage.append(f"the header promises {self._count} frames, the file holds {held}")
        self._count = min(held, self._count)

    @property
    def info(self) -> FrameInfo:
        """Width, height, bits and number of frames as the header says; raw frames are lossless."""
        codec = f"Photron raw {self._bits} bit"
        damage = tuple(self._damage)
        return FrameInfo(self._columns, self._rows, self._bits, self._count, codec, True, damage=damage)

    def times_ns(self) -> Nanoseconds:
        """Time stamps from `times`, else from the header's rate (or `rate_hz` over it), from `start_s` on."""
        if self._request.times is not None:
            return file_times(self._request.times, self._path, self._count)[:: self._request.every]
        step: Floats = np.arange(0, self._count, self._request.every) / self._rate_hz + self._request.start_s
        return np.rint(step * NANOSECONDS).astype(np.int64)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames, one at a time; 12-bit values are unpacked into 16 bits."""
        times = self.times_ns()
        with self._raw_file.open("rb") as file:
            for index in range(*slice(start, stop).indices(times.size)):
                file.seek(index * self._request.every * self._frame_bytes)
                pixels = _unpacked(np.frombuffer(file.read(self._frame_bytes), dtype=np.uint8), self._bits)
                count = self._rows * self._columns
                yield Frame(int(times[index]), pixels[:count].reshape(self._rows, self._columns), index)


def _pair(path: Path) -> tuple[Path, Path]:
    """Header and raw file, whichever of the two `path` is; DataError where one is missing."""
    found = {item.suffix.lower(): item for item in path.parent.glob(f"{glob.escape(path.stem)}.*")}
    for suffix in (".cih", ".mraw"):
        if suffix not in found:
            raise DataError(
                f"{path.with_suffix(suffix)}: not found. A Photron recording is two files of one name, .cih and .mraw; "
                "keep them together."
            )
    return found[".cih"], found[".mraw"]


def _header(file: Path) -> dict[str, str]:
    """The lines `key : value` of a cih file."""
    text = file.read_text(encoding="latin-1")
    pairs = (line.split(" : ", 1) for line in text.splitlines() if " : " in line)
    return {key.strip(): value.strip() for key, value in pairs}


def _number(header: dict[str, str], key: str, file: Path, least: float = 1e-6) -> float:
    value = header.get(key, "")
    try:
        number = float(value)
    except ValueError:
        number = 0.0
    if not least <= number < _MAX_HEADER_NUMBER:
        raise DataError(
            f"{file}: {key} must be a number from {least:g} to {_MAX_HEADER_NUMBER:g}; received {value!r}. Export the "
            "recording again."
        )
    return number


def _unpacked(raw: NDArray[np.uint8], bits: int) -> NDArray[np.generic]:
    """Pixels of a frame's bytes: 8 and 16 bit (little endian) as they are, 12 bit from three bytes for two pixels."""
    if bits == 8:
        return raw
    if bits == 16:
        return raw.view("<u2").astype(np.uint16)
    whole = raw[: raw.size // 3 * 3].reshape(-1, 3).astype(np.uint16)
    pixels = np.empty((len(whole), 2), dtype=np.uint16)
    pixels[:, 0] = whole[:, 0] << 4 | whole[:, 1] >> 4
    pixels[:, 1] = (whole[:, 1] & 15) << 8 | whole[:, 2]
    rest = raw[raw.size // 3 * 3 :]
    tail = (
        np.array([int(rest[0]) << 4 | int(rest[1]) >> 4], dtype=np.uint16) if rest.size == 2 else np.empty(0, np.uint16)
    )
    return np.concatenate([pixels.ravel(), tail])
