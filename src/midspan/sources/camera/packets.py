"""What a video's container says of its frames without decoding: stamps, key frames, completeness, rate of taking.

The rate at which frames were taken differs from that of playing in slow motion and time lapse. Android and what follows
it declare it by the tag `com.android.capture.fps`, frames a second; Sony by `captureFps="119.88p"` next to `formatFps`
in the XML of a box `meta` of an MP4. Apple's slow motion keeps the stamps of taking, and needs neither.

FFmpeg reads what is there of a video that breaks off and stays silent. Containers with an index of their frames (MP4,
AVI) are compared with it where the packets are counted, the others' own length with the end of the file.
"""

import re
import struct
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from midspan.errors import DataError
from midspan.notices import Notice
from midspan.records import Nanoseconds
from midspan.signals.health import clock
from midspan.sources.boundary import HEAD_BYTES, head_of

# Containers whose clock starts anywhere: their first stamp counts as zero.
_FREE_RUNNING = ("mpegts", "mpeg")
# A video that holds this share, and at least this long, less than its header declares broke off while it was copied.
MAX_LOST = 0.03
MIN_MISSING_S = 1.0
_TAG = "com.android.capture.fps"
_XML_RATE = re.compile(rb'captureFps="(?P<rate>\d+(?:\.\d+)?)[pi]?"')
# Bytes of a box that are looked through; Sony's XML has two thousand.
_MAX_XML_BYTES = 1 << 20
# Frames that are lost, or that poor light made longer, change the rate by less than this factor.
_MIN_FACTOR = 1.5
# Phones declare up to this rate of ordinary films, too, whose frames poor light can make longer.
_MAX_ORDINARY_HZ = 60.0
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
class Packets:
    """`count` frames; `ticks` (count,) their stamps in order of presentation in units of `time_base` s, or None.

    `keys` are the numbers of key frames in that order, `rates` the frame rates in Hz that the container states;
    `free_running` says that the container's clock starts anywhere. `length_s` is the length that the header declares,
    in s (0: it does not).
    """

    count: int
    ticks: Nanoseconds | None
    keys: tuple[int, ...]
    time_base: Fraction
    rates: tuple[Fraction, ...]
    free_running: bool
    length_s: float

    @property
    def last_s(self) -> float:
        """The last stamp in s; 0 without stamps."""
        return 0.0 if self.ticks is None else float(int(self.ticks[-1]) * self.time_base)

    def key_before(self, number: int) -> int | None:
        """The number of the last key frame at or before frame `number`; None where there is none."""
        place = int(np.searchsorted(np.asarray(self.keys), number, side="right")) - 1
        return self.keys[place] if place >= 0 else None


def scan(path: Path, container: Any) -> Packets:
    """Walk through the packets of an open container; DataError where there are none."""
    import av

    stream = container.streams.video[0]
    stamps: list[int | None] = []
    keys: list[int] = []
    # A damaged tail: what was read before it counts.
    with suppress(av.error.FFmpegError):
        for packet in container.demux(stream):
            if packet.size and not packet.is_discard:
                keys += [len(stamps)] if packet.is_keyframe else []
                stamps.append(packet.pts if packet.pts is not None else packet.dts)
    if not stamps:
        raise DataError(f"{path} holds no frames. Check that the file is whole.")
    rates = tuple(dict.fromkeys(r for r in (stream.average_rate, stream.base_rate, stream.guessed_rate) if r))
    base = Fraction(stream.time_base or 1)
    formats = str(container.format.name).split(",")
    free = any(name in _FREE_RUNNING for name in formats)
    length_s = _length_s(container, stream, formats)
    known = [stamp for stamp in stamps if stamp is not None]
    ticks = np.sort(np.array(known, dtype=np.int64))
    if len(known) < len(stamps) or ticks.size < 1 or np.any(ticks[1:] <= ticks[:-1]):
        return Packets(len(stamps), None, (), base, rates, free, length_s)
    order = np.sort(np.searchsorted(ticks, np.array([stamps[k] for k in keys], dtype=np.int64)))
    return Packets(len(stamps), ticks, tuple(order.tolist()), base, rates, free, length_s)


def _length_s(container: Any, stream: Any, formats: list[str]) -> float:
    """The length that the header declares, s; 0 where it does not."""
    if "avi" in formats and stream.frames and stream.average_rate:
        # FFmpeg shortens an AVI's length to what is in the file; its header counts frames.
        return float(stream.frames / stream.average_rate)
    # The stream's own length, too: sound can be longer.
    own_s = float(stream.duration * stream.time_base) if stream.duration else 0.0
    return min((length_s for length_s in ((container.duration or 0) * 1e-6, own_s) if length_s), default=0.0)


def missing_frames(path: Path, packets: Packets, declared: int | None) -> tuple[int, int]:
    """How many of the frames that the header declares are missing at the end, and how many are meant to be left out.

    declared: frames by the header, None where it does not say. It also counts what a player does not show: frames that
    an edit list leaves out, and an AVI's empty chunks, in which a recorder keeps the time of frames it dropped. So no
    more are missing than there is time for behind the last stamp. Raises DataError for a copy that broke off.
    """
    absent = lost = max((declared or packets.count) - packets.count, 0)
    missing_s = 0.0
    if packets.ticks is not None and packets.length_s:
        missing_s = packets.length_s - packets.last_s
        if packets.rates:
            lost = min(lost, max(round(missing_s * float(packets.rates[0])) - 1, 0))
    if lost > MAX_LOST * (declared or 1) or missing_s > max(MAX_LOST * packets.length_s, MIN_MISSING_S):
        what = f"{lost} of {declared} frames" if lost > 0 else f"{missing_s:.1f} of {packets.length_s:.1f} s"
        found = f"{what} that its header declares are not in it"
        remedy = "Copy it again; to use what is there, rewrite it first (ffmpeg -i IN -c copy OUT)."
        if packets.count == 1:
            found, remedy = f"its header declares {packets.length_s:.1f} s, and one frame is in it", "Copy it again."
        raise DataError(f"{path}: the video is truncated: {found}. {remedy}")
    return lost, absent - lost


def without_cut_frame(path: Path, packets: Packets) -> tuple[Packets, str]:
    """The packets without one that the end of the file cuts, and what is cut in words; empty where nothing is."""
    end = _cut_off(path)
    if end is None:
        return packets, ""
    missing = 0
    if packets.ticks is not None and packets.rates:
        held_s = float(packets.ticks[-1] - min(packets.ticks[0], 0)) * float(packets.time_base)
        missing = round((packets.length_s - held_s) * float(packets.rates[0])) - 1
    text = f"{end.text}, about {missing} frames" if missing > 0 else end.text
    if not end.in_frame or packets.count < 2:
        return packets, text
    ticks = None if packets.ticks is None else packets.ticks[:-1]
    return replace(packets, count=packets.count - 1, ticks=ticks), text


def declared_rate(path: Path, tags: Mapping[str, str]) -> float | None:
    """The rate of taking in Hz that a video declares by its container's `tags` or its XML; None where it does not."""
    value = next((text for name, text in tags.items() if name.lower() == _TAG), None)
    if value is None:
        match = _XML_RATE.search(_meta_box(path))
        return float(match["rate"]) or None if match else None
    try:
        rate_hz = float(value)
    except ValueError:
        return None
    return rate_hz if 0.0 < rate_hz < float("inf") else None


def _meta_box(path: Path) -> bytes:
    """The content of an MP4's first box `meta` on the top level; empty where there is none, or no MP4."""
    place = 0
    with path.open("rb") as file:
        while len(head := file.read(16)) >= 8:
            size, name = struct.unpack(">I4s", head[:8])
            if place == 0 and name != b"ftyp":
                break
            if size == 1 and len(head) == 16:
                (size,) = struct.unpack(">Q", head[8:])
            if size < 8:
                break
            if name == b"meta":
                file.seek(place + 8)
                return file.read(min(size - 8, _MAX_XML_BYTES))
            place += size
            file.seek(place)
    return b""


def times_of_taking(
    time_ns: Nanoseconds, declared_hz: float | None, wanted_hz: float | None
) -> tuple[Nanoseconds, Notice | None]:
    """Stamps (n,) of when frames were taken, from those of playing them, with what was done where the rates differ.

    declared_hz: rate of taking by the container, Hz (None: it declares none); wanted_hz: by the settings, which wins.
    """
    if declared_hz is None or len(time_ns) < 2:
        return time_ns, None
    played_hz = clock(time_ns).rate_hz
    factor = declared_hz / played_hz
    if 1.0 / _MIN_FACTOR < factor < _MIN_FACTOR:
        return time_ns, None
    text = f"its container declares capture at {declared_hz:g} Hz and playback at {played_hz:.6g} Hz"
    if wanted_hz is not None:
        taken_hz, text = wanted_hz, f"{text}; the times are at rate_hz = {wanted_hz:g} Hz as set"
    elif factor > 1.0 and declared_hz <= _MAX_ORDINARY_HZ:
        taken_hz = played_hz
        text += (
            f" (slow motion, or a reduced rate in poor light); the playback times are used. If they are {factor:.3g} "
            f"times too long, give rate_hz = {declared_hz:g}"
        )
    else:
        taken_hz = declared_hz
        text += f"; the capture times at {declared_hz:g} Hz are used. If that is wrong, give the right rate_hz"
    # A film of an hour has 2^42 ns, far below the 53 bits of a float.
    return (time_ns * (played_hz / taken_hz)).round().astype("int64"), Notice("slow-motion", text)


@dataclass(frozen=True, slots=True)
class _CutOff:
    """How a file ends too early, in words; `in_frame`: whether FFmpeg may give the frame that is cut as a whole one."""

    text: str
    in_frame: bool


def _cut_off(path: Path) -> _CutOff | None:
    """How a video file ends too early; None where it is whole, or where its container does not say."""
    size = path.stat().st_size
    head = head_of(path)
    check = next((check for begins, check in _CHECKS if begins(head)), None)
    # A header that cannot be taken apart says nothing about the end.
    with path.open("rb") as file, suppress(struct.error, IndexError, ValueError):
        return check(file, size) if check else None
    return None


def _short(missing: int, declared: int) -> _CutOff | None:
    text = f"the file is cut off: {missing} of the {declared} bytes that its header declares are missing"
    return _CutOff(text, False) if missing > 0 else None


def _y4m(file: BinaryIO, size: int) -> _CutOff | None:
    line = file.readline(HEAD_BYTES)
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
    return _CutOff(f"the file is cut off: frame {whole} has {rest} of {frame} bytes", False) if rest else None


def _gif(file: BinaryIO, size: int) -> _CutOff | None:
    file.seek(max(size - HEAD_BYTES, 0))
    if file.read().rstrip(b"\0").endswith(b";"):
        return None
    return _CutOff("the file is cut off: the byte that ends a GIF is missing", True)


def _packet_bytes(head: bytes) -> int | None:
    """The bytes of a packet where these are the first of a transport stream."""
    for count in _TRANSPORT_PACKETS:
        first = 4 if count == 192 else 0
        places = range(first, min(len(head), first + _SYNCS * count), count)
        if len(places) == _SYNCS and all(head[k] == _SYNC for k in places):
            return count
    return None


def _transport(file: BinaryIO, size: int) -> _CutOff | None:
    packet = _packet_bytes(file.read(HEAD_BYTES))
    assert packet is not None
    rest = size % packet
    return _CutOff(f"the file is cut off: its last packet has {rest} of {packet} bytes", True) if rest else None


def _matroska(file: BinaryIO, size: int) -> _CutOff | None:
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


def _asf(file: BinaryIO, size: int) -> _CutOff | None:
    (header,) = struct.unpack("<Q", file.read(24)[16:])
    file.seek(0)
    data = file.read(min(header, 1 << 20))
    place = data.index(_ASF_PROPERTIES)
    (declared,) = struct.unpack_from("<Q", data, place + 40)
    (flags,) = struct.unpack_from("<I", data, place + 88)
    # While it is broadcast a stream has no length.
    return None if flags & 1 else _short(declared - size, declared)


_Check = Callable[[BinaryIO, int], _CutOff | None]
_CHECKS: tuple[tuple[Callable[[bytes], bool], _Check], ...] = (
    (lambda head: head.startswith(b"YUV4MPEG2 "), _y4m),
    (lambda head: head.startswith((b"GIF87a", b"GIF89a")), _gif),
    (lambda head: head.startswith(b"\x1a\x45\xdf\xa3"), _matroska),
    (lambda head: head.startswith(_ASF), _asf),
    (lambda head: _packet_bytes(head) is not None, _transport),
)
