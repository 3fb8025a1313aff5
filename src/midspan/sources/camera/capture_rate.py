"""The rate at which frames were taken, where a container declares another than it plays at: slow motion, time lapse.

Android and what follows it: the tag `com.android.capture.fps`, frames a second. Sony: `captureFps="119.88p"` next to
`formatFps` in the XML of a box `meta` of an MP4. Apple's slow motion keeps the stamps of taking, and needs neither.
"""

import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

from midspan.notices import Notice
from midspan.records import Nanoseconds
from midspan.signals.health import clock

_TAG = "com.android.capture.fps"
_XML_RATE = re.compile(rb'captureFps="(?P<rate>\d+(?:\.\d+)?)[pi]?"')
# Bytes of a box that are looked through; Sony's XML has two thousand.
_MAX_XML_BYTES = 1 << 20
# Frames that are lost, or that poor light made longer, change the rate by less than this factor.
_MIN_FACTOR = 1.5
# Phones declare up to this rate of ordinary films, too, whose frames poor light can make longer.
_MAX_ORDINARY_HZ = 60.0


def declared_rate(path: Path, tags: Mapping[str, str]) -> float | None:
    """The rate of taking in Hz that a video declares by its container's `tags` or its XML; None where it does not."""
    value = next((text for name, text in tags.items() if name.lower() == _TAG), None)
    if value is None:
        return _xml_rate(path)
    try:
        rate_hz = float(value)
    except ValueError:
        return None
    return rate_hz if 0.0 < rate_hz < float("inf") else None


def _xml_rate(path: Path) -> float | None:
    """The rate of taking in the XML of an MP4's own box `meta`, Hz."""
    with path.open("rb") as file:
        box = _top_box(file, b"meta")
    match = _XML_RATE.search(box)
    return float(match["rate"]) or None if match else None


def _top_box(file: BinaryIO, kind: bytes) -> bytes:
    """The content of an MP4's first box of a kind on the top level; empty where there is none, or no MP4."""
    place = 0
    while len(head := file.read(16)) >= 8:
        size, name = struct.unpack(">I4s", head[:8])
        if place == 0 and name != b"ftyp":
            return b""
        if size == 1 and len(head) == 16:
            (size,) = struct.unpack(">Q", head[8:])
        if size < 8:
            return b""
        if name == kind:
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
    rates = f"its container declares that it was taken at {declared_hz:g} Hz and is played at {played_hz:.6g} Hz"
    if wanted_hz is not None:
        text = f"{rates}; the times are at rate_hz = {wanted_hz:g} Hz as set"
        return _scaled(time_ns, played_hz / wanted_hz), Notice("slow-motion", text)
    if factor > 1.0 and declared_hz <= _MAX_ORDINARY_HZ:
        text = (
            f"{rates}, as slow motion is, or a film that poor light made slower; the times are those of playing. If "
            f"they are {factor:.3g} times too long, give rate_hz = {declared_hz:g}"
        )
        return time_ns, Notice("slow-motion", text)
    text = f"{rates}; the times are those of taking, by {declared_hz:g} Hz. If that is wrong, give the right rate_hz"
    return _scaled(time_ns, played_hz / declared_hz), Notice("slow-motion", text)


def _scaled(time_ns: Nanoseconds, factor: float) -> Nanoseconds:
    """Stamps (n,) stretched about zero; a film of an hour has 2^42 ns, far below the 53 bits of a float."""
    return (time_ns * factor).round().astype("int64")
