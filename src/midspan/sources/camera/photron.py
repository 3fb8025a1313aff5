"""Photron high-speed recordings: a text header (cih) with the raw frames (mraw)."""

import glob
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import NANOSECONDS, Nanoseconds
from midspan.sources.camera.frames import FrameRequest, StoredFrames
from midspan.vision.frame_source import FrameInfo

# Keys of the header that the frames cannot be read without.
_SIZES, _RATE = ("Image Width", "Image Height", "Total Frame", "Color Bit"), "Record Rate(fps)"
_BITS_KNOWN = (8, 12, 16)
# No width, count or rate (frames per second) of a recording comes near; stamps are whole nanoseconds.
_MAX_HEADER_NUMBER = 1e9


class PhotronFrames(StoredFrames):
    """Monochrome frames of 8, 12 (packed) or 16 bit; `path` is the cih or the mraw file, the other is in the same
    folder.
    """

    def __init__(self, path: Path, request: FrameRequest) -> None:
        super().__init__(path, request)
        header_file, self._raw_file = _pair(path)
        # Lines `key : value`.
        pairs = (
            line.split(" : ", 1) for line in header_file.read_text(encoding="latin-1").splitlines() if " : " in line
        )
        header = {key.strip(): value.strip() for key, value in pairs}
        self._columns, self._rows, self._count, self._bits = (
            int(_number(header, key, header_file, least=1.0)) for key in _SIZES
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
        promised = f"the header declares {self._count} frames, the file has {held}"
        self._damage = (promised,) if held < self._count else ()
        self._count = min(held, self._count)

    @property
    def info(self) -> FrameInfo:
        """Width, height, bits and number of frames as the header says; raw frames are lossless."""
        codec = f"Photron raw {self._bits} bit"
        return FrameInfo(self._columns, self._rows, self._bits, self._count, codec, True, damage=self._damage)

    def _own_times(self) -> Nanoseconds:
        """From the header's rate (or `rate_hz` over it), from `start_s` on."""
        times_s = np.arange(self._count) / self._rate_hz + self._request.start_s
        return np.rint(times_s * NANOSECONDS).astype(np.int64)

    def _image(self, number: int) -> NDArray[np.generic]:
        data = np.fromfile(self._raw_file, np.uint8, self._frame_bytes, offset=number * self._frame_bytes)
        return _unpacked(data, self._bits)[: self._rows * self._columns].reshape(self._rows, self._columns)


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
    # A last half triple holds one pixel.
    whole = np.pad(raw, (0, -raw.size % 3)).reshape(-1, 3).astype(np.uint16)
    return np.column_stack((whole[:, 0] << 4 | whole[:, 1] >> 4, (whole[:, 1] & 15) << 8 | whole[:, 2])).ravel()
