"""GSE2 waveforms: a header WID2 of fixed columns, samples as whole numbers (INT) or packed (CM6), a checksum CHK2.

CM6 writes the second differences with six bits a character: the first of a sample holds its sign (16) and four bits,
the others five; 32 says that another follows. Source: GSE 2.0 (Group of Scientific Experts, CRP/243, 1995), waveforms.
"""

import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import Nanoseconds
from midspan.sources.accelerometer.channel import Channel, ChannelSet
from midspan.sources.boundary import require_memory

_BLOCK = re.compile(rb"^WID2 (?P<header>[^\r\n]*)[\r\n]+(?P<rest>.*?)(?=^WID2 |\Z)", re.MULTILINE | re.DOTALL)
_DATA = re.compile(rb"^DAT2[^\r\n]*[\r\n]+(?P<packed>.*?)^CHK2\s+(?P<checksum>-?\d+)", re.MULTILINE | re.DOTALL)
# Columns of the header behind `WID2 `: first, and behind the last.
_COLUMNS = {
    "start": (0, 23),
    "station": (24, 29),
    "channel": (30, 33),
    "auxiliary": (34, 38),
    "form": (39, 42),
    "count": (43, 51),
    "rate": (52, 63),
    "calibration": (64, 74),
}
_CHARACTERS = b"+-0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
# A sample of 32 bits takes seven characters at most: 4 + 6 · 5 bits.
_MAX_CHARACTERS = 7
_MODULO = 100_000_000
# Eight bytes of a code, of its bits and of a sample, and what they are worked out of.
_BYTES_OF_A_BYTE = 48


def read(path: Path) -> ChannelSet:
    """The channels as `STA.CHA` in counts without a unit; gaps stay gaps. A block with a wrong checksum is left out."""
    require_memory(path, _BYTES_OF_A_BYTE * path.stat().st_size, "its samples")
    groups: dict[str, list[tuple[Nanoseconds, NDArray[np.int64], float]]] = {}
    notes: list[str] = []
    damage: list[str] = []
    for block in _BLOCK.finditer(path.read_bytes()):
        text = block["header"].decode("latin-1")
        field = {name: text[first:last].strip() for name, (first, last) in _COLUMNS.items()}
        name = ".".join(part for part in (field["station"], field["auxiliary"], field["channel"]) if part)
        try:
            samples = _samples(block["rest"], field["form"], int(field["count"]))
            rate_hz = float(field["rate"])
            times = _times(field["start"], len(samples), rate_hz)
        except (ValueError, OverflowError) as error:
            damage.append(f"{name}: a block is damaged and left out: {error}")
            continue
        groups.setdefault(name, []).append((times, samples, rate_hz))
        note = f"{name}: its header has a calibration of {field['calibration']} nm a count, which is not applied"
        if note not in notes and field["calibration"]:
            notes.append(note)
    if not groups and not damage:
        raise DataError(f"{path} has no header WID2. Give a GSE2 file with waveforms.")
    return ChannelSet(tuple(_channel(name, parts) for name, parts in groups.items()), tuple(notes), tuple(damage))


def _channel(name: str, parts: list[tuple[Nanoseconds, NDArray[np.int64], float]]) -> Channel:
    parts.sort(key=lambda part: int(part[0][0]))
    values = np.concatenate([samples for _, samples, _ in parts]).astype(np.float64)
    return Channel(name, values, None, parts[0][2], None, np.concatenate([times for times, _, _ in parts]))


def _times(start: str, count: int, rate_hz: float) -> Nanoseconds:
    begin = datetime.strptime(start, "%Y/%m/%d %H:%M:%S.%f").replace(tzinfo=UTC)
    if not 0.0 < rate_hz < float("inf"):
        raise ValueError(f"its rate is {rate_hz} Hz")
    start_ns = int(begin.timestamp()) * 1_000_000_000 + begin.microsecond * 1_000
    return np.asarray(np.int64(start_ns) + np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64), dtype=np.int64)


def _samples(rest: bytes, form: str, count: int) -> NDArray[np.int64]:
    """The samples of a block; ValueError where they are not what its header and checksum state."""
    data = _DATA.search(rest)
    if data is None:
        raise ValueError("no samples between DAT2 and CHK2")
    if form not in ("INT", "CM6"):
        raise ValueError(f"samples in the form {form!r}; INT and CM6 are read")
    found = unpacked(data["packed"]) if form == "CM6" else np.array(data["packed"].split(), dtype=np.int64)
    if not count or len(found) != count:
        raise ValueError(f"{len(found)} of {count} samples are there")
    # The writer keeps the sum's sign while it takes multiples off, and may state its size alone.
    left = sum(int(part.sum()) for part in np.array_split(found, 1 + len(found) // 1_000_000)) % _MODULO
    if abs(int(data["checksum"])) not in (left, _MODULO - left):
        raise ValueError("its checksum is wrong")
    return found


def unpacked(packed: bytes) -> NDArray[np.int64]:
    """The samples of CM6 characters, blanks and line ends among them; ValueError for what is none."""
    table = np.full(256, -1, dtype=np.int64)
    table[np.frombuffer(_CHARACTERS, dtype=np.uint8)] = np.arange(64)
    codes = table[np.frombuffer(b"".join(packed.split()), dtype=np.uint8)]
    if not codes.size or codes.min() < 0 or codes[-1] & 32:
        raise ValueError("characters that CM6 does not have, or an end amid a sample")
    last = np.flatnonzero((codes & 32) == 0)
    first = np.concatenate(([0], last[:-1] + 1))
    if (last - first).max() >= _MAX_CHARACTERS:
        raise ValueError("a sample of more than 32 bits")
    bits = codes & 31
    bits[first] &= 15
    place = np.repeat(last, last - first + 1) - np.arange(len(codes))
    differences = np.add.reduceat(bits << (5 * place), first)
    differences[(codes[first] & 16) != 0] *= -1
    return np.asarray(np.cumsum(np.cumsum(differences)), dtype=np.int64)
