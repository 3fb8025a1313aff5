"""The size that the header of a picture declares, before a library allocates it."""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from midspan.errors import DataError

_BIG_TIFF = 43
_WIDTH, _HEIGHT, _BITS, _PACKING, _SAMPLES = 256, 257, 258, 259, 277
# Ways to pack a TIFF that lose something: JPEG, old and new.
_LOSSY = (6, 7)
# The codes of whole numbers in a directory of a TIFF, by the number of a field's kind.
_WHOLE = {1: "B", 3: "H", 4: "I", 16: "Q"}
# Markers of JPEG that begin a frame and so hold its size; the others of their range hold tables.
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_PNG_SAMPLES = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}


@dataclass(frozen=True, slots=True)
class Page:
    """A page of a TIFF: the bytes that its pixels declare, and whether they are packed with a loss."""

    picture_bytes: int
    lossy: bool


def picture_bytes(data: bytes | memoryview) -> int:
    """The bytes that the pixels of a picture take by its header; 0 where the header does not say, or is unknown."""
    try:
        return _declared_bytes(data, bytes(data[:4]))
    except (struct.error, IndexError, ValueError, DataError):
        # The library that decodes it says what is wrong.
        return 0


def _declared_bytes(data: bytes | memoryview, magic: bytes) -> int:
    deep, samples = False, 3
    if magic in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return max((page.picture_bytes for page in pages(data)), default=0)
    if magic == b"\x89PNG":
        width, height, bits, kind = struct.unpack_from(">IIBB", data, 16)
        deep, samples = bits > 8, _PNG_SAMPLES.get(kind, 4)
    elif magic.startswith(b"BM"):
        width, height, _, bits = struct.unpack_from("<iiHH", data, 18)
        samples = max(bits // 8, 3)
    elif magic == b"GIF8":
        width, height = struct.unpack_from("<HH", data, 6)
        samples = 4  # it is decoded into colours with transparency
    elif magic.startswith(b"\xff\xd8"):
        place = 2
        while (mark := struct.unpack_from(">BBH", data, place))[0] == 0xFF and mark[1] not in _FRAMES:
            place += 2 + mark[2]
        if mark[0] != 0xFF:
            return 0
        bits, height, width, samples = struct.unpack_from(">BHHB", data, place + 4)
        deep = bits > 8
    elif re.match(rb"P[1-6]", magic):
        text = re.sub(rb"#[^\n]*\n", b" ", bytes(data[:1024])).split()
        width, height = int(text[1]), int(text[2])
        deep, samples = text[0] not in (b"P1", b"P4") and int(text[3]) > 255, 3 if text[0] in (b"P3", b"P6") else 1
    else:
        return 0
    return int(abs(width) * abs(height) * samples * (2 if deep else 1))


def pages(data: bytes | memoryview) -> Iterator[Page]:
    """The pages of a TIFF in their order; DataError where one lies behind the end of the file, or a second time."""
    order = {b"II": "<", b"MM": ">"}.get(bytes(data[:2]))
    if order is None or len(data) < 16:
        return
    big = struct.unpack_from(order + "H", data, 2)[0] == _BIG_TIFF
    code, entry_bytes = ("Q", 20) if big else ("I", 12)
    count_code = "Q" if big else "H"
    (place,) = struct.unpack_from(order + code, data, 8 if big else 4)
    known: dict[int, int] = {}
    while place:
        if place in known:
            raise DataError(
                f"is damaged: its list of pages leads from page {len(known)} back to page {known[place]}. Write it "
                "again"
            )
        known[place] = len(known) + 1
        first = place + struct.calcsize(order + count_code)
        try:
            (count,) = struct.unpack_from(order + count_code, data, place)
            (following,) = struct.unpack_from(order + code, data, first + count * entry_bytes)
        except (struct.error, OverflowError) as error:
            raise DataError(
                f"is cut off: its page {len(known)} is at byte {place}, and the file has {len(data)} bytes. Copy it "
                "again"
            ) from error
        entries = range(first, first + count * entry_bytes, entry_bytes)
        fields = dict(_field(data, order, k, big) for k in entries)
        sample_bytes = fields.get(_SAMPLES, 1) * max(-(-fields.get(_BITS, 1) // 8), 1)
        yield Page(fields.get(_WIDTH, 0) * fields.get(_HEIGHT, 0) * sample_bytes, fields.get(_PACKING) in _LOSSY)
        place = following


def _field(data: bytes | memoryview, order: str, place: int, big: bool) -> tuple[int, int]:
    """The tag of a field and its first value, where that is a whole number; 0 where it is not, or lies elsewhere."""
    tag, kind = struct.unpack_from(order + "HH", data, place)
    (count,) = struct.unpack_from(order + ("Q" if big else "I"), data, place + 4)
    code = _WHOLE.get(kind)
    if code is None or tag not in (_WIDTH, _HEIGHT, _BITS, _PACKING, _SAMPLES):
        return tag, 0
    room, value = (8, place + 12) if big else (4, place + 8)
    try:
        if count * struct.calcsize("<" + code) > room:
            (value,) = struct.unpack_from(order + ("Q" if big else "I"), data, value)
        return tag, int(struct.unpack_from(order + code, data, value)[0])
    except (struct.error, OverflowError):
        return tag, 0
