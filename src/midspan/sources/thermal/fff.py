"""FLIR's file format FFF: a block for each frame, each with a directory of records.

Sequences (seq, csq) are such blocks one behind the other. They are found by walking their records: the letters FFF
occur among pixels too. A radiometric JPEG is a picture to look at with such a block in its segments APP1, spread over
several of at most 64 kB: each says which part of how many it is.
"""

import importlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError, UsageError
from midspan.thermal.radiometry import Air, OpticalPath, Planck

_MAGIC = b"FFF\0"
_HEADER_BYTES, _ENTRY_BYTES = 64, 32
_RAW_HEADER_BYTES = 32
_MAX_VERSION = 200  # a little-endian version above this is a big-endian one
_MAX_RECORDS = 1024
_SHORT_TAIL_BYTES = 4  # the last block of a sequence may claim this much more than there is
_MARK = 2  # a record's byte-order mark, read in the right order
_CAMERA_BYTES = 0x38E
_SEARCHED_BYTES = 1 << 24  # at once
_PNG, _JPEG_LS = b"\x89PNG", b"\xff\xd8\xff"

JPEG_SUFFIXES = (".jpg", ".jpeg")
_START, _APP1, _APP3, _SCAN = b"\xff\xd8", 0xE1, 0xE3, 0xDA
_NAME = b"FLIR\0"
_PART_HEAD_BYTES = 8  # the name, a version, the number of the part, the number of the last one
# Counts of two bytes of DJI's smallest thermal camera, 160 × 120 px; pictures of light have no such segments.
_MIN_DJI_COUNT_BYTES = 2 * 160 * 120

Bytes = bytes | memoryview


class RecordKind(IntEnum):
    """What a record of a block holds, of those that are read."""

    RAW = 0x01
    CAMERA = 0x20


@dataclass(frozen=True, slots=True)
class Record:
    """One record of a block: its kind, where it begins in the file and how many bytes it has."""

    kind: int
    offset: int
    length: int


@dataclass(frozen=True, slots=True)
class Block:
    """One frame of a file: where its block begins, its records, and where the next block begins."""

    offset: int
    records: tuple[Record, ...]
    end: int

    def record(self, kind: int) -> Record | None:
        """The first record of a kind."""
        return next((record for record in self.records if record.kind == kind), None)


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """What the camera wrote with a frame: calibration, what lies between, model, time (ns since 1970, 0 where it is
    not set) and nominal rate in Hz (0: not set).
    """

    planck: Planck
    path: OpticalPath
    model: str
    time_ns: int
    rate_hz: float


def blocks(data: Bytes, offset: int = 0) -> Iterator[Block]:
    """The blocks of a file from `offset` on, one behind the other, to the last whole one."""
    while bytes(data[offset : offset + 4]) == _MAGIC and (block := _whole_block(data, offset)) is not None:
        yield block
        offset = block.end


def next_block(data: Bytes, offset: int) -> int | None:
    """Where the next whole frame begins, from `offset` on, after bytes that are none; None where there is no more.

    The letters of a block occur among pixels too: one with raw counts and the camera's record lies behind them.
    """
    while offset < len(data):
        piece = bytes(data[offset : offset + _SEARCHED_BYTES + len(_MAGIC) - 1])
        place = piece.find(_MAGIC)
        while place >= 0:
            if _is_frame(data, offset + place):
                return offset + place
            place = piece.find(_MAGIC, place + 1)
        offset += _SEARCHED_BYTES
    return None


def _is_frame(data: Bytes, offset: int) -> bool:
    """Whether a whole frame begins at `offset`, with counts and a calibration."""
    block = _whole_block(data, offset)
    if block is None:
        return False
    try:
        camera_info(data, block)
        return min(frame_size(data, block)) > 0
    except (DataError, struct.error):
        return False


def _whole_block(data: Bytes, offset: int) -> Block | None:
    """The block at `offset`; None where it does not end within the file."""
    block = _block(data, offset)
    return None if block is None or block.end > len(data) + _SHORT_TAIL_BYTES else block


def _block(data: Bytes, offset: int) -> Block | None:
    """The block at `offset`; None where its directory is cut off, empty or cannot be right."""
    if offset + _HEADER_BYTES > len(data):
        return None
    version = struct.unpack_from("<I", data, offset + 0x14)[0]
    order = ">" if version > _MAX_VERSION else "<"
    start, count = struct.unpack_from(f"{order}II", data, offset + 0x18)
    directory = offset + start
    if count > _MAX_RECORDS or directory + count * _ENTRY_BYTES > len(data):
        return None
    records = []
    for k in range(count):
        kind, *_, place, length = struct.unpack_from(f"{order}HHIIII", data, directory + k * _ENTRY_BYTES)
        if kind and length:
            records.append(Record(kind, offset + place, length))
    if not records:
        return None
    end = max([directory + count * _ENTRY_BYTES, *(record.offset + record.length for record in records)])
    return Block(offset, tuple(records), end)


def _order(data: Bytes, offset: int) -> str:
    """Byte order of a record, which begins with a mark of its own: the file's header may have the other one."""
    return "<" if struct.unpack_from("<H", data, offset)[0] == _MARK else ">"


def camera_info(data: Bytes, block: Block) -> CameraInfo:
    """The camera's record of a block; DataError where it is missing or its calibration cannot be right."""
    record = block.record(RecordKind.CAMERA)
    if record is None or record.length < _CAMERA_BYTES or record.offset + _CAMERA_BYTES > len(data):
        raise DataError("has no record of the camera's calibration; export it with its radiometric data")
    o = _order(data, record.offset)

    def read(code: str, place: int) -> tuple[float, ...]:
        return struct.unpack_from(o + code, data, record.offset + place)

    emissivity, distance, reflected, air_k, window_k, window = read("6f", 0x20)
    (humidity,), (r1, b, f) = read("f", 0x3C), read("3f", 0x58)
    alpha_1, alpha_2, beta_1, beta_2, x = read("5f", 0x70)
    (offset,), (r2,) = read("i", 0x308), read("f", 0x30C)
    stamp_s, stamp_ms = (int(v) for v in read("2I", 0x384))
    rate = float(read("H", 0x464)[0]) if record.length >= 0x466 else 0.0
    air = Air((alpha_1, alpha_2), (beta_1, beta_2), x)
    model = bytes(data[record.offset + 0xD4 : record.offset + 0xF4]).split(b"\0")[0].decode("latin-1").strip()
    try:
        planck = Planck(r1, b, f, float(offset), r2)
    except UsageError as error:
        raise DataError(
            f"has an invalid record of the camera's calibration: {error} Export it with its radiometric data, or as "
            "16-bit TIFF."
        ) from error
    humidity = humidity / 100.0 if humidity > 1.0 else humidity
    path = OpticalPath(emissivity, distance, reflected, air_k, window_k, window or 1.0, humidity, air)
    time_ns = stamp_s * 1_000_000_000 + stamp_ms % 1000 * 1_000_000
    return CameraInfo(planck, path, model, time_ns, rate)


def frame_size(data: Bytes, block: Block) -> tuple[int, int]:
    """Width and height in px of a block's raw image; DataError where it has none."""
    record = block.record(RecordKind.RAW)
    if record is None or record.length <= _RAW_HEADER_BYTES:
        raise DataError("has no record of raw counts; it may hold a picture only")
    width, height = struct.unpack_from(f"{_order(data, record.offset)}HH", data, record.offset + 2)
    return int(width), int(height)


def counts(data: Bytes, block: Block) -> NDArray[np.uint16]:
    """Raw counts (rows, columns) of a block.

    Raises DataError for an image that is cut off or packed in an unknown way, UsageError without a JPEG-LS decoder.
    """
    width, height = frame_size(data, block)
    record = block.record(RecordKind.RAW)
    assert record is not None
    begin = record.offset + _RAW_HEADER_BYTES
    packed = bytes(data[begin : record.offset + record.length])
    if packed[:4] == _PNG:
        image = _from_png(packed)
    elif packed[:3] == _JPEG_LS:
        image = _from_jpeg_ls(packed)
    elif len(packed) >= 2 * width * height:
        plain = np.frombuffer(packed, dtype=f"{_order(data, record.offset)}u2", count=width * height)
        image = plain.astype(np.uint16).reshape(height, width)
    else:
        raise DataError(f"must hold {width} x {height} counts of 2 bytes; its raw record has {len(packed)} bytes")
    if image.shape != (height, width):
        raise DataError(f"states {width} x {height} px, but its image has {image.shape[1]} x {image.shape[0]}")
    return image


def _from_png(packed: bytes) -> NDArray[np.uint16]:
    """Counts in a PNG: some cameras write the two bytes of a count in the wrong order for this format."""
    # In the right order neighbours differ by what the scene changes and the sensor's noise; in the wrong one their low
    # bytes, which are noise, count 256 times. The median in the camera's record can be that of another moment.
    import cv2

    found = cv2.imdecode(np.frombuffer(packed, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if found is None or found.ndim != 2 or found.dtype != np.uint16:
        raise DataError("holds a PNG that cannot be read as 16-bit counts")
    image = np.asarray(found, dtype=np.uint16)
    swapped = image.byteswap()
    return swapped if _roughness(swapped) < _roughness(image) else image


def _roughness(image: NDArray[np.uint16]) -> int:
    """The sum of what neighbouring pixels of an image (rows, columns) differ by, along both axes."""
    values = image.astype(np.int64)
    return sum(int(np.abs(np.diff(values, axis=axis)).sum()) for axis in (0, 1))


def _from_jpeg_ls(packed: bytes) -> NDArray[np.uint16]:
    """Counts (rows, columns) of lossless JPEG, by a small library that is an extra of this package."""
    try:
        library = importlib.import_module("jpeg_ls")
    except ImportError:
        raise UsageError(
            "Compressed FLIR sequences (csq) need a JPEG-LS decoder, which is not installed. Run: pip "
            "install 'midspan[csq]'"
        ) from None
    try:
        image = np.asarray(library.decode(np.frombuffer(packed, dtype=np.uint8)))
    except Exception as error:  # the library's own errors have no common base
        raise DataError(f"holds a JPEG-LS image that cannot be decoded: {error}") from error
    if image.dtype != np.uint16 or image.ndim != 2:
        raise DataError(f"must hold 16-bit counts of one plane; its JPEG-LS image is {image.dtype} {image.shape}")
    return image


def is_jpeg(file: Path) -> bool:
    """Whether a file is a JPEG by its name."""
    return file.suffix.lower() in JPEG_SUFFIXES


def is_flir_jpeg(file: Path) -> bool:
    """Whether a file is a JPEG in which a FLIR camera wrote raw counts. What cannot be read is not judged.

    The directory in the first part says so: pictures of light of the same camera have records too, but no counts.
    """
    if not is_jpeg(file) or not file.is_file():
        return False
    try:
        with file.open("rb") as data:
            first = next(_parts(data), None)
            head = data.read(first[2]) if first else b""
        block = _block(head, 0) if head.startswith(_MAGIC) else None
        return block is not None and block.record(RecordKind.RAW) is not None
    except (OSError, struct.error):
        return False


def embedded_block(file: Path) -> bytes:
    """The FFF block of a FLIR JPEG; DataError where a part of it is missing."""
    parts: dict[int, bytes] = {}
    last = 0
    with file.open("rb") as data:
        for number, last, count in _parts(data):
            parts[number] = data.read(count)
            if len(parts[number]) < count:
                raise DataError(f"{file} is cut off in part {number + 1} of {last + 1} of its raw data. Copy it again.")
    missing = [k for k in range(last + 1) if k not in parts]
    if missing:
        raise DataError(
            f"{file}: {len(missing)} of the {last + 1} parts of its raw data are missing, the first is part "
            f"{missing[0] + 1}. An image editor may have removed them; use the camera's own file."
        )
    return b"".join(parts[k] for k in range(last + 1))


def _parts(data: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """The FLIR segments before the picture: number of the part, of the last one, and bytes; the file is at them."""
    for marker, count in _segments(data):
        name = data.read(_PART_HEAD_BYTES) if marker == _APP1 and count >= _PART_HEAD_BYTES else b""
        if name.startswith(_NAME) and len(name) == _PART_HEAD_BYTES:
            yield name[6], name[7], count - _PART_HEAD_BYTES


def _segments(data: BinaryIO) -> Iterator[tuple[int, int]]:
    """The segments of a JPEG before its picture: marker and bytes of content; the file is at the content."""
    if data.read(2) != _START:
        return
    place = 2
    while len(head := data.read(4)) == 4:
        mark, marker, count = struct.unpack(">BBH", head)
        if mark != 0xFF or marker == _SCAN or count < 2:
            return
        yield marker, count - 2
        place += 2 + count
        data.seek(place)


def refuse_dji(file: Path) -> None:
    """Raise DataError for a JPEG in whose segments a DJI camera wrote counts. What cannot be read is not judged."""
    if not is_jpeg(file) or not file.is_file():
        return
    is_made, count_bytes = False, 0
    try:
        with file.open("rb") as data:
            for marker, count in _segments(data):
                is_made = is_made or (marker == _APP1 and b"DJI" in data.read(count))
                count_bytes += count if marker == _APP3 else 0
    except OSError:
        return
    if is_made and count_bytes >= _MIN_DJI_COUNT_BYTES:
        raise DataError(
            f"{file}: a thermal JPEG of DJI. Only DJI's Thermal SDK converts its 16-bit counts to temperatures; "
            "without it only 8-bit grey levels are available. Convert the files to float TIFF in °C (dji_irp -a "
            "measure of that SDK), or give them to [camera] as pictures."
        )
