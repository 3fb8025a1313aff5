"""Radiometric JPEG of FLIR cameras: a picture to look at, and in its segments APP1 the raw counts as an FFF block.

A segment is at most 64 kB, so that the block is spread over several: each says which part of how many it is.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from midspan.errors import DataError
from midspan.sources.thermal.fff import lists_raw_counts

SUFFIXES = (".jpg", ".jpeg")
_START, _APP1, _SCAN = b"\xff\xd8", 0xE1, 0xDA
_NAME = b"FLIR\0"
_HEAD_BYTES = 8  # the name, a version, the number of the part, the number of the last one


def is_jpeg(file: Path) -> bool:
    """Whether a file is a JPEG by its name."""
    return file.suffix.lower() in SUFFIXES


def is_flir_jpeg(file: Path) -> bool:
    """Whether a file is a JPEG in which a FLIR camera wrote raw counts. What cannot be read is not judged.

    The directory in the first part says so: pictures of light of the same camera have records too, but no counts.
    """
    if not is_jpeg(file) or not file.is_file():
        return False
    try:
        with file.open("rb") as data:
            first = next(_parts(data), None)
            return first is not None and lists_raw_counts(data.read(first[2]))
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
            f"{missing[0] + 1}. A program that edits pictures may have left them out; use the camera's own file."
        )
    return b"".join(parts[k] for k in range(last + 1))


def _parts(data: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """The FLIR segments before the picture: number of the part, of the last one, and bytes; the file is at them."""
    for marker, count in segments(data):
        name = data.read(_HEAD_BYTES) if marker == _APP1 and count >= _HEAD_BYTES else b""
        if name.startswith(_NAME) and len(name) == _HEAD_BYTES:
            yield name[6], name[7], count - _HEAD_BYTES


def segments(data: BinaryIO) -> Iterator[tuple[int, int]]:
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
