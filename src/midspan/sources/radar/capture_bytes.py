"""The bytes of a raw capture in their order: one file, several that were split, or packets with their headers kept."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.notices import Notice
from midspan.radar.layout import PACKET_BYTES
from midspan.sources.boundary import require_memory

Bytes = NDArray[np.uint8]

# A packet comes late by fewer than this; its count is compared with that of this many packets around it.
LATE_PACKETS, NEIGHBOURS = 64, 5
# Of a capture with more of it absent nothing can be measured.
MAX_ABSENT = 0.9
# Headers are looked for in this many packets; this many of these may be damaged, and this many missing before them.
HEADS_LOOKED_AT, HEADS_DAMAGED, MAX_FIRST_NUMBER = 16, 3, 1000
# A capture is split into fewer files than this; a larger number is a date or the like.
MAX_FILES = 1000
# Headers that some captures keep: number and count of bytes before, with the packet's length between them or without.
_HEADS = {14: (4, 8), 10: (None, 4)}
_SPLIT = re.compile(r"^(.*_)0(\.bin)$", re.IGNORECASE)
# What marks a chirp's own header in the stream.
_CHIRP_HEADS = (bytes.fromhex("dc0ada0c"), bytes.fromhex("dc0adc0a"), bytes.fromhex("0cda0adc"))


def open_bytes(path: Path) -> "CaptureBytes":
    """The payload of a capture, whatever it is packed in. Raises DataError for what cannot be read."""
    files = split_files(path)
    for file in files:
        if file.stat().st_size == 0:
            raise DataError(f"{file} is empty (0 bytes). Check the capture.")
    maps: list[Bytes] = [np.memmap(file, dtype=np.uint8, mode="r") for file in files]
    head = bytes(maps[0][:8])
    if head[:4] in _CHIRP_HEADS:
        raise DataError(
            f"{path} has a header before each chirp (it begins with {head.hex()}), which cannot be read. Capture with "
            "lvdsStreamCfg enableHeader = 0."
        )
    kept = next((size for size in _HEADS if _has_heads(maps[0], size)), None)
    return CaptureBytes(files, maps) if kept is None else _Packets(files, maps, kept)


def split_files(path: Path) -> list[Path]:
    """The files of a capture: `x_Raw_0.bin` is followed by `x_Raw_1.bin` …, as long as they exist."""
    found = _SPLIT.match(path.name)
    files = [path]
    if found:
        while (following := path.with_name(f"{found.group(1)}{len(files)}{found.group(2)}")).is_file():
            files.append(following)
    return files


def missing_files(path: Path) -> list[str]:
    """Names of files that are missing between those of a capture that was split."""
    found, files = _SPLIT.match(path.name), split_files(path)
    if not found:
        return []
    part = re.compile(re.escape(found[1]) + r"(\d+)" + re.escape(found[2]))
    numbers = [int(match[1]) for file in path.parent.glob("*") if (match := part.fullmatch(file.name))]
    last = max([len(files) - 1, *(n for n in numbers if n < MAX_FILES)])
    names = (f"{found[1]}{n}{found[2]}" for n in range(len(files), last))
    return [name for name in names if not path.with_name(name).is_file()]


def _number(data: Bytes, start: int, count: int) -> int:
    return int.from_bytes(bytes(data[start : start + count]), "little")


def _has_heads(data: Bytes, size: int) -> bool:
    """Whether headers of `size` bytes stand where packets begin: the counts of most agree with their numbers."""
    length = PACKET_BYTES
    if size == 14:
        length = _number(data, 4, 4)
        if not 1 <= length <= PACKET_BYTES:
            return False
    begins = range(0, min(len(data) - size, HEADS_LOOKED_AT * (size + length)), size + length)
    if len(begins) < 2:
        return False
    heads = [(_number(data, begin, 4), _number(data, begin + size - 6, 6)) for begin in begins]
    agreeing = sum(1 <= number < MAX_FIRST_NUMBER and count == (number - 1) * length for number, count in heads)
    return agreeing >= max(2, len(heads) - HEADS_DAMAGED)


class CaptureBytes:
    """Random access to the payload of `size` bytes, which stands alone in one or several files."""

    notes: tuple[str, ...] = ()
    warnings: tuple[Notice, ...] = ()

    def __init__(self, files: list[Path], maps: list[Bytes]) -> None:
        self._files = files
        self._ends = np.cumsum([len(data) for data in maps])
        self.size = int(self._ends[-1])
        if len(files) > 1:
            self.notes = (f"{len(files)} files are read as one: {files[0].name} … {files[-1].name}",)

    def read(self, start: int, count: int) -> tuple[Bytes, Bytes | None]:
        """`count` bytes from `start`, and which of them were never received (1); None where that is not known: what was
        lost is zeros, which only their run betrays.
        """
        parts = []
        at = int(np.searchsorted(self._ends, start, side="right"))
        while count > 0 and at < len(self._files):
            first = start - (int(self._ends[at - 1]) if at else 0)
            # Read, not mapped: page faults cost several times what the arithmetic does.
            wanted = min(count, int(self._ends[at]) - start)
            part = np.fromfile(self._files[at], dtype=np.uint8, count=wanted, offset=first)
            parts.append(part)
            start, count, at = start + len(part), count - len(part), at + 1
        return parts[0] if len(parts) == 1 else np.concatenate([np.empty(0, dtype=np.uint8), *parts]), None


class _Packets(CaptureBytes):
    """Packets with their headers: put in order by the count of bytes, holes filled with zeros and known."""

    def __init__(self, files: list[Path], maps: list[Bytes], head: int) -> None:
        if len(maps) > 1:
            require_memory(files[0], sum(len(data) for data in maps), f"the capture in {len(maps)} files")
        data = maps[0] if len(maps) == 1 else np.concatenate(maps)
        length = _number(data, 4, 4) if head == 14 else PACKET_BYTES
        step = head + length
        self._data = data
        whole = len(data) // step
        rows = np.asarray(data[: whole * step]).reshape(whole, step)
        weights = 256 ** np.arange(6, dtype=np.int64)
        counts = rows[:, head - 6 : head].astype(np.int64) @ weights
        starts = np.arange(whole, dtype=np.int64) * step + head
        lengths = np.full(whole, length, dtype=np.int64)
        rest = len(data) - whole * step - head
        if rest > 0:
            counts = np.append(counts, _number(data, whole * step + head - 6, 6))
            starts, lengths = np.append(starts, whole * step + head), np.append(lengths, rest)
        sound = np.ones(len(counts), dtype=np.bool_)
        if len(counts) >= NEIGHBOURS:
            # Damage hits the count of one packet, a gap moves those of all after it.
            padded = np.pad(counts, NEIGHBOURS // 2, mode="reflect")
            usual = np.median(np.lib.stride_tricks.sliding_window_view(padded, NEIGHBOURS), axis=1)
            sound = np.asarray(np.abs(counts - usual) <= LATE_PACKETS * PACKET_BYTES)
        damaged = int(np.count_nonzero(~sound))
        counts, starts, lengths = counts[sound], starts[sound], lengths[sound]
        order = np.argsort(counts, kind="stable")
        self._counts, self._starts, self._lengths = counts[order], starts[order], lengths[order]
        self.size = int((self._counts + self._lengths).max())
        received = int(np.sum(lengths[np.unique(counts, return_index=True)[1]]))
        late = int(np.count_nonzero(np.diff(counts) < 0))
        absent = self.size - received
        if absent > MAX_ABSENT * self.size:
            raise DataError(
                f"{files[0]}: by its packet counters {absent} of {self.size} bytes were not received; at most "
                f"{100 * MAX_ABSENT:g} % may be missing. Check that the file is one capture, and the card's network."
            )
        self.notes = (
            f"{files[0].name} contains packet headers of {head} bytes, which are removed; {absent} of {self.size} "
            f"bytes were not received, {late} packets came late",
        )
        if damaged:
            text = (
                f"radar: {damaged} of {len(sound)} packets in {files[0].name} have a damaged byte counter and are "
                "left out. Copy the file again if the original is whole."
            )
            self.warnings = (Notice("radar-data", text),)

    def read(self, start: int, count: int) -> tuple[Bytes, Bytes | None]:
        """Bytes by their count in the headers."""
        count = max(min(count, self.size - start), 0)
        out, missing = np.zeros(count, dtype=np.uint8), np.ones(count, dtype=np.uint8)
        first = int(np.searchsorted(self._counts, start - PACKET_BYTES, side="left"))
        for k in range(first, len(self._counts)):
            at = int(self._counts[k]) - start
            if at >= count:
                break
            low, high = max(at, 0), min(at + int(self._lengths[k]), count)
            if low < high:
                source = int(self._starts[k]) + low - at
                out[low:high], missing[low:high] = self._data[source : source + high - low], 0
        return out, missing
