"""Videos that break off: what a container states of its own length, compared with the end of the file.

FFmpeg reads what is there and stays silent. Containers with an index of their frames (MP4, AVI) are compared with it
instead, where the packets are counted.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

_HEAD_BYTES = 1024
# Bytes of a packet of a transport stream, plain, with a time stamp of 4 bytes before it, with 16 bytes of parity.
_TRANSPORT_PACKETS = (188, 192, 204)
_SYNC = 0x47
_SYNCS = 4  # in a row
# The element of Matroska that holds all others.
_SEGMENT = 0x18538067
# Samples of luma and colour for four pixels in the kinds of Y4M.
_Y4M_SAMPLES = {"420": 6, "411": 6, "422": 8, "444": 12, "mono": 4}
_ASF = bytes.fromhex("3026b2758e66cf11a6d900aa0062ce6c")
_ASF_PROPERTIES = bytes.fromhex("a1dcab8c47a9cf118ee400c00c205365")


@dataclass(frozen=True, slots=True)
class CutOff:
    """How a file ends too early, in words; `in_frame`: whether FFmpeg may give the frame that is cut as a whole one."""

    text: str
    in_frame: bool


def cut_off(path: Path) -> CutOff | None:
    """How a video file ends too early; None where it is whole, or where its container does not say."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
        file.seek(0)
        check = next((check for begins, check in _CHECKS if begins(head)), None)
        try:
            return check(file, size) if check else None
        except (struct.error, IndexError, ValueError):
            # A header that cannot be taken apart says nothing about the end.
            return None


def _short(missing: int, declared: int) -> CutOff | None:
    if missing <= 0:
        return None
    return CutOff(f"the file is cut off: {missing} of the {declared} bytes that its header declares are missing", False)


def _y4m(file: BinaryIO, size: int) -> CutOff | None:
    line = file.readline(_HEAD_BYTES)
    keys = {word[:1]: word[1:] for word in line.decode("ascii", "replace").split()[1:]}
    kind = keys.get("C", "420")
    width, height = int(keys["W"]), int(keys["H"])
    samples = next((count for name, count in _Y4M_SAMPLES.items() if kind.startswith(name)), 0)
    deep = any(kind.endswith(bits) for bits in ("p9", "p10", "p12", "p14", "p16", "mono16"))
    if not samples or "alpha" in kind or file.read(6) != b"FRAME\n":
        return None
    across, down = (width + 1) // 2 * 2, (height + 1) // 2 * 2
    # Planes of colour are rounded up to whole samples; that of luma is not.
    colour = (samples - 4) * {6: across * down, 8: across * height, 12: width * height, 4: 0}[samples] // 4
    if kind.startswith("411"):
        colour = 2 * ((width + 3) // 4) * height
    frame = (width * height + colour) * (2 if deep else 1) + len(b"FRAME\n")
    whole, rest = divmod(size - len(line), frame)
    return CutOff(f"the file is cut off: frame {whole} has {rest} of {frame} bytes", False) if rest else None


def _gif(file: BinaryIO, size: int) -> CutOff | None:
    file.seek(max(size - _HEAD_BYTES, 0))
    if file.read().rstrip(b"\0").endswith(b";"):
        return None
    return CutOff("the file is cut off: the byte that ends a GIF is missing", True)


def _packet_bytes(head: bytes) -> int | None:
    """The bytes of a packet where these are the first of a transport stream."""
    for count in _TRANSPORT_PACKETS:
        first = 4 if count == 192 else 0
        places = range(first, min(len(head), first + _SYNCS * count), count)
        if len(places) == _SYNCS and all(head[k] == _SYNC for k in places):
            return count
    return None


def _transport(file: BinaryIO, size: int) -> CutOff | None:
    packet = _packet_bytes(file.read(_HEAD_BYTES))
    assert packet is not None
    rest = size % packet
    return CutOff(f"the file is cut off: its last packet has {rest} of {packet} bytes", True) if rest else None


def _matroska(file: BinaryIO, size: int) -> CutOff | None:
    place = 0
    while place < size:
        kind, begin, count = _element(file, place)
        if kind == _SEGMENT and count is None:
            # Written without going back: its clusters may have sizes of their own.
            place = begin
            continue
        if count is None:
            return None
        if begin + count > size:
            return _short(begin + count - size, begin + count)
        place = begin + count
    return None


def _element(file: BinaryIO, place: int) -> tuple[int, int, int | None]:
    """An element's kind, where its content begins, and how many bytes it has; None where it does not say."""
    file.seek(place)
    head = file.read(16)
    kind_bytes = 9 - head[0].bit_length()
    size_bytes = 9 - head[kind_bytes].bit_length()
    if kind_bytes > 4 or size_bytes > 8 or kind_bytes + size_bytes > len(head):
        raise ValueError("no element")
    kind = int.from_bytes(head[:kind_bytes], "big")
    most = (1 << 7 * size_bytes) - 1
    count = int.from_bytes(head[kind_bytes : kind_bytes + size_bytes], "big") & most
    return kind, place + kind_bytes + size_bytes, None if count == most else count


def _asf(file: BinaryIO, size: int) -> CutOff | None:
    (header,) = struct.unpack("<Q", file.read(24)[16:])
    file.seek(0)
    data = file.read(min(header, 1 << 20))
    place = data.index(_ASF_PROPERTIES)
    (declared,) = struct.unpack_from("<Q", data, place + 40)
    (flags,) = struct.unpack_from("<I", data, place + 88)
    # While it is broadcast a stream has no length.
    return None if flags & 1 else _short(declared - size, declared)


_Check = Callable[[BinaryIO, int], CutOff | None]
_CHECKS: tuple[tuple[Callable[[bytes], bool], _Check], ...] = (
    (lambda head: head.startswith(b"YUV4MPEG2 "), _y4m),
    (lambda head: head.startswith((b"GIF87a", b"GIF89a")), _gif),
    (lambda head: head.startswith(b"\x1a\x45\xdf\xa3"), _matroska),
    (lambda head: head.startswith(_ASF), _asf),
    (lambda head: _packet_bytes(head) is not None, _transport),
)
