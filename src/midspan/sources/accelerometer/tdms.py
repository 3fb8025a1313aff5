"""National Instruments TDMS, read with npTDMS."""

import io
import logging
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from midspan.sources.accelerometer.channel import Channel, ChannelSet, numbers
from midspan.sources.boundary import require_memory

_UNITS = ("unit_string", "NI_UnitDescription", "unit", "Unit")
# LabVIEW's zero of time, 1904: a waveform that starts there was never given a start.
_UNSET_BEFORE_NS = int(np.datetime64("1971-01-01", "ns").astype(np.int64))
# The group of a result that midspan wrote.
_RESULT = "midspan"
# A segment's lead-in: its mark, flags, version, and the bytes that follow ("NI: TDMS file format internal structure").
_MARK, _LEAD_IN_BYTES, _BIG_ENDIAN = b"TDSm", 28, 1 << 6


def read(path: Path) -> ChannelSet:
    """All channels as `group/channel`, scaled as the file says; rate and start from the waveform properties.

    Of a file that was cut off, channels of one length keep what all of them have.
    """
    from nptdms import TdmsFile

    channels: list[Channel] = []
    notes: list[str] = []
    with _WithinFile(path) as opened, _quiet(), TdmsFile.open(opened) as file:
        # Of a result that midspan wrote, the name of the column; else the channel's path.
        items = {
            item.name if group.name == _RESULT else f"{group.name}/{item.name}": item
            for group in file.groups()
            for item in group.channels()
        }
        # As the file has them, and as numbers of eight bytes.
        require_memory(path, sum(16 * len(item) for item in items.values()), "its channels")
        # Of channels that should be equally long, what the shortest has.
        last = file.file_status.channel_statuses or {}
        lost = {path: one.expected_length - one.read_length for path, one in last.items()}
        declared = {name: len(item) + lost.get(item.path, 0) for name, item in items.items()}
        for name, item in items.items():
            count = min(len(items[other]) for other in items if declared[other] == declared[name])
            values = numbers(np.asarray(item[:count]))
            if values is None or values.size < 2:
                notes.append(f"{name} left out: no series of numbers")
                continue
            channels.append(_channel(name, values, np.asarray(item[:1]), item.properties))
    cut = "it is cut off: its last segment is not complete, and the rest of it is missing"
    return ChannelSet(tuple(channels), tuple(notes), () if _is_whole(path) else (cut,))


class _WithinFile(io.BufferedReader):
    """A file of which no more is asked for than is left: a damaged length would be allocated before it is read."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """Up to `size` bytes, all that is left where it is negative or None."""
        left = max(self._size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the library's warnings off standard error: what they say is in the damage."""
    from nptdms.log import log_manager

    level = log_manager.log_level
    log_manager.set_level(logging.ERROR)
    try:
        yield
    finally:
        log_manager.set_level(level)


def _is_whole(path: Path) -> bool:
    """Whether the file ends where its last segment does; one that a program never finished has no length."""
    with path.open("rb") as file:
        end = file.seek(0, 2)
        place = 0
        while place < end:
            file.seek(place)
            head = file.read(_LEAD_IN_BYTES)
            if len(head) < _LEAD_IN_BYTES or not head.startswith(_MARK):
                return False
            big = struct.unpack("<I", head[4:8])[0] & _BIG_ENDIAN
            place += _LEAD_IN_BYTES + struct.unpack(">Q" if big else "<Q", head[12:20])[0]
    return place == end


def _channel(name: str, values: Any, first: Any, properties: dict[str, Any]) -> Channel:
    if first.dtype.kind == "M":
        return Channel(name, values, "ns")
    step = properties.get("wf_increment")
    rate_hz = 1.0 / float(step) if step else None
    unit = next((str(properties[key]) for key in _UNITS if properties.get(key)), None)
    start_ns = round(float(properties.get("wf_start_offset") or 0.0) * 1e9)
    begun = properties.get("wf_start_time")
    begun_ns = 0 if begun is None else int(np.datetime64(begun).astype("datetime64[ns]").astype(np.int64))
    start_ns += begun_ns if begun_ns > _UNSET_BEFORE_NS else 0
    return Channel(name, values, unit, rate_hz, (start_ns or None) if rate_hz else None)
