"""Seismology's formats: miniSEED (version 2 and 3) with pymseed, also the data records of a full SEED volume; GSE2;
K-NET, KiK-net and SAC with ObsPy, which is an extra of this package.

GSE2: a header WID2 of fixed columns, samples as whole numbers (INT) or packed (CM6), a checksum CHK2. CM6 writes the
second differences with six bits a character: the first of a sample holds its sign (16) and four bits, the others five;
32 says that another follows. Source: GSE 2.0 (Group of Scientific Experts, CRP/243, 1995), waveforms.

K-NET's counts become m/s² by the scale factor of their header, and their start is in UTC without the 15 s of delay that
the header's time has (NIED, K-NET ASCII format). SAC holds numbers whose unit the file does not say surely.
"""

import importlib
import re
import warnings
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError, UsageError
from midspan.records import Nanoseconds
from midspan.sources.accelerometer.channel import Channel, ChannelSet, even_ns
from midspan.sources.boundary import require_memory

# libmseed's status of a stream that ends within a record (MS_ENDOFFILE).
_END_OF_FILE = 1
# That of bytes that are no record of data (MS_NOTSEED).
_NOT_SEED = -2
# Sequence number, and the kind of a control header: volume, abbreviation, station, time span.
_CONTROL_HEADER = re.compile(rb"[0-9]{6}[VAST][ *]")
# The channels of a result that midspan wrote, with their names and units in the other formats; the letter of a second
# image axis stands in the last place.
_OWN_STATION = "MIDSP"
_OWN_CHANNELS = {
    code[: 3 - len(axis)] + axis.upper(): (name.format(f"_{axis}" if axis else ""), unit)
    for axis in ("", "x", "y")
    for code, name, unit in (
        ("DSP", "displacement{}_mm", "mm"),
        ("STD", "displacement_std{}_mm", "mm"),
        ("VEL", "velocity{}_mm_s", "mm/s"),
    )
}
# A word of four bytes holds seven samples at most (Steim 2), so no record holds more than two a byte.
_MAX_SAMPLES_PER_BYTE = 2
_BLOCK = re.compile(rb"^WID2 (?P<header>[^\r\n]*)[\r\n]+(?P<rest>.*?)(?=^WID2 |\Z)", re.MULTILINE | re.DOTALL)
_DATA = re.compile(rb"^DAT2[^\r\n]*[\r\n]+(?P<packed>.*?)^CHK2\s+(?P<checksum>-?\d+)", re.MULTILINE | re.DOTALL)
# Columns of the header behind `WID2 `: first, and behind the last.
_COLUMNS = {
    **{"start": (0, 23), "station": (24, 29), "channel": (30, 33), "auxiliary": (34, 38), "form": (39, 42)},
    **{"count": (43, 51), "rate": (52, 63), "calibration": (64, 74)},
}
_CHARACTERS = b"+-0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
# A sample of 32 bits takes seven characters at most: 4 + 6 · 5 bits.
_MAX_CHARACTERS = 7
_MODULO = 100_000_000
# Eight bytes of a code, of its bits and of a sample, and what they are worked out of.
_GSE2_BYTES_OF_A_BYTE = 48
INSTALL = "pip install 'midspan[seismic]'"
# A number of four bytes (SAC) becomes eight bytes of value, and what they are worked out of; one of K-NET has nine.
_BYTES_OF_A_BYTE = 8


def read_miniseed(path: Path) -> ChannelSet:
    """All channels as `NET.STA.LOC.CHA` in counts, with the true time stamp of every sample; gaps stay gaps.

    Records whose samples do not decode to the last sample that they state (Steim) are left out, like a gap.
    """
    from pymseed import MS3TraceList

    records, said, damage = _records(path)
    channels: list[Channel] = []
    notes = list(said)
    traces = MS3TraceList.from_buffer(records, unpack_data=True) if records else ()
    for trace in traces:
        segments = [s for s in trace if s.numsamples]
        if not segments or segments[0].sampletype not in ("i", "f", "d"):
            notes.append(f"{trace.sourceid} left out: no numbers")
            continue
        segments.sort(key=lambda segment: int(segment.starttime))
        # A copy: the samples belong to the trace list, which goes with this function.
        values = np.concatenate([np.array(s.np_datasamples, dtype=np.float64) for s in segments])
        time_ns = np.concatenate([even_ns(int(s.starttime), int(s.numsamples), _rate(s)) for s in segments])
        name, unit = _name(trace.sourceid), None
        station, code = name.split(".")[1], name.split(".")[-1]
        if station == _OWN_STATION and code in _OWN_CHANNELS:
            name, unit = _OWN_CHANNELS[code]
        if len(segments) > 1:
            notes.append(f"{name}: {len(segments) - 1} gaps")
        channels.append(Channel(name, values, unit, _rate(segments[0]), None, time_ns))
    return ChannelSet(tuple(channels), tuple(notes), damage)


def _records(path: Path) -> tuple[bytes, tuple[str, ...], tuple[str, ...]]:
    """The bytes of all records of data, notes, and sentences on what is damaged."""
    # Records of another kind are passed over: control headers of a SEED volume, noise records. In a file that does not
    # begin as a volume it is not known what they are, and they count as damage.
    from pymseed import MiniSEEDError

    try:
        records, damage, _ = _sound_records(path, False)
        return records, (), damage
    except MiniSEEDError as error:
        if error.status_code != _NOT_SEED:
            raise
        records, damage, other_bytes = _sound_records(path, True)
        if not records and not damage:
            raise
    text = f"{other_bytes} bytes are no records of data"
    with path.open("rb") as file:
        is_volume = _CONTROL_HEADER.match(file.read(8))
    if is_volume:
        return records, (f"{text} (control headers of a SEED volume) and are left out",), damage
    return records, (), (*damage, f"{text} and are left out")


def _name(sourceid: str) -> str:
    from pymseed import sourceid2nslc

    return ".".join(sourceid2nslc(sourceid))


@dataclass(slots=True)
class _Lost:
    """Damaged records of one channel: how many of how many, their samples, and the time of the first one."""

    of: int = 0
    records: int = 0
    samples: int = 0
    first_ns: int = 0


def _sound_records(path: Path, skip: bool) -> tuple[bytes, tuple[str, ...], int]:
    """The bytes of all records that decode as they state, a sentence for each channel that lost some, and how many
    bytes are no records of data; skip: such bytes are passed over, else they are an error.
    """
    from pymseed import MiniSEEDError, MS3Record, get_error_messages

    sound: list[bytes] = []
    count, channels = 0, dict[str, _Lost]()
    cut: tuple[str, ...] = ()
    other_bytes = path.stat().st_size
    reader = iter(MS3Record.from_file(str(path), unpack_data=False, skip_not_data=skip))
    while True:
        try:
            record = next(reader, None)
        except MiniSEEDError as error:
            if not sound or error.status_code != _END_OF_FILE:
                raise
            cut = ("its last record is cut off and left out",)
            break
        if record is None:
            break
        lost = channels.setdefault(record.sourceid, _Lost())
        lost.of += 1
        other_bytes -= int(record.reclen)
        try:
            possible = record.samplecnt <= _MAX_SAMPLES_PER_BYTE * record.reclen
            decoded = possible and record.unpack_data() == record.samplecnt and not get_error_messages()
        except MiniSEEDError:
            decoded = False
        if decoded:
            sound.append(record.record)
            count += record.samplecnt
            continue
        lost.first_ns = lost.first_ns or int(record.starttime)
        lost.records, lost.samples = lost.records + 1, lost.samples + int(record.samplecnt)
    # Samples as they are decoded (4 bytes), as numbers, and their time stamps (8 bytes each).
    require_memory(path, 20 * count, "its samples")
    damage = tuple(
        f"{_name(name)}: {lost.records} of {lost.of} records are damaged (their samples do not end at the last "
        f"value that the record states) and count as missing: {lost.samples} samples, the first at "
        f"{np.datetime64(lost.first_ns, 'ns').astype('datetime64[ms]')} UTC"
        for name, lost in channels.items()
        if lost.records
    )
    return b"".join(sound), damage + cut, other_bytes


def _rate(segment: Any) -> float:
    """The rate in Hz; a negative number in the file is a sample period in seconds."""
    rate = float(segment.samprate)
    return rate if rate >= 0 else -1.0 / rate


def read_gse2(path: Path) -> ChannelSet:
    """The channels as `STA.CHA` in counts without a unit; gaps stay gaps. A block with a wrong checksum is left out."""
    require_memory(path, _GSE2_BYTES_OF_A_BYTE * path.stat().st_size, "its samples")
    groups: dict[str, list[tuple[Nanoseconds, NDArray[np.int64], float]]] = {}
    notes: list[str] = []
    damage: list[str] = []
    for block in _BLOCK.finditer(path.read_bytes()):
        text = block["header"].decode("latin-1")
        field = {name: text[first:last].strip() for name, (first, last) in _COLUMNS.items()}
        name = ".".join(part for part in (field["station"], field["auxiliary"], field["channel"]) if part)
        try:
            samples = _gse2_samples(block["rest"], field["form"], int(field["count"]))
            rate_hz = float(field["rate"])
            times = _gse2_times(field["start"], len(samples), rate_hz)
        except (ValueError, OverflowError) as error:
            damage.append(f"{name}: a block is damaged and left out: {error}")
            continue
        groups.setdefault(name, []).append((times, samples, rate_hz))
        note = f"{name}: its header has a calibration of {field['calibration']} nm a count, which is not applied"
        if note not in notes and field["calibration"]:
            notes.append(note)
    if not groups and not damage:
        raise DataError(f"{path} has no header WID2. Give a GSE2 file with waveforms.")
    channels = []
    for name, parts in groups.items():
        parts.sort(key=lambda part: int(part[0][0]))
        values = np.concatenate([samples for _, samples, _ in parts]).astype(np.float64)
        time_ns = np.concatenate([times for times, _, _ in parts])
        channels.append(Channel(name, values, None, parts[0][2], None, time_ns))
    return ChannelSet(tuple(channels), tuple(notes), tuple(damage))


def _gse2_times(start: str, count: int, rate_hz: float) -> Nanoseconds:
    begin = datetime.strptime(start, "%Y/%m/%d %H:%M:%S.%f").replace(tzinfo=UTC)
    if not 0.0 < rate_hz < float("inf"):
        raise ValueError(f"its rate is {rate_hz} Hz")
    return even_ns(int(begin.timestamp()) * 1_000_000_000 + begin.microsecond * 1_000, count, rate_hz)


def _gse2_samples(rest: bytes, form: str, count: int) -> NDArray[np.int64]:
    """The samples of a block; ValueError where they are not what its header and checksum state."""
    data = _DATA.search(rest)
    if data is None:
        raise ValueError("no samples between DAT2 and CHK2")
    if form not in ("INT", "CM6"):
        raise ValueError(f"samples in the form {form!r}; INT and CM6 are read")
    found = _unpacked(data["packed"]) if form == "CM6" else np.array(data["packed"].split(), dtype=np.int64)
    if not count or len(found) != count:
        raise ValueError(f"{len(found)} of {count} samples are there")
    # The writer keeps the sum's sign while it takes multiples off, and may state its size alone.
    left = sum(int(part.sum()) for part in np.array_split(found, 1 + len(found) // 1_000_000)) % _MODULO
    if abs(int(data["checksum"])) not in (left, _MODULO - left):
        raise ValueError("its checksum is wrong")
    return found


def _unpacked(packed: bytes) -> NDArray[np.int64]:
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


def read_knet(path: Path) -> ChannelSet:
    """The channel of a K-NET or KiK-net file in m/s²."""
    return _read_obspy(path, "KNET")


def read_sac(path: Path) -> ChannelSet:
    """The channel of a SAC file, without a unit."""
    return _read_obspy(path, "SAC")


def _read_obspy(path: Path, kind: str) -> ChannelSet:
    try:
        obspy = importlib.import_module("obspy")
    except ImportError:
        raise UsageError(f"{path}: this format is read with ObsPy, which is not installed. Run: {INSTALL}") from None
    require_memory(path, _BYTES_OF_A_BYTE * path.stat().st_size, "its samples")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # An open file: in a path the library would read patterns and addresses.
        with path.open("rb") as file:
            stream = obspy.read(file, format=kind, check_compression=False)
    groups: dict[str, list[Any]] = {}
    for trace in stream:
        groups.setdefault(trace.id.strip("."), []).append(trace)
    notes: list[str] = []
    channels = [_obspy_channel(name or kind, traces, kind, notes) for name, traces in groups.items()]
    return ChannelSet(tuple(channels), tuple(notes))


def _obspy_channel(name: str, traces: list[Any], kind: str, notes: list[str]) -> Channel:
    traces.sort(key=lambda trace: trace.stats.starttime.ns)
    # Numbers that are none, as a damaged file has, say so when they are converted.
    with np.errstate(invalid="ignore"):
        values = np.concatenate([np.asarray(trace.data, dtype=np.float64) for trace in traces])
    stats = traces[0].stats
    unit = None
    if kind == "KNET":
        values, unit = values * float(stats.calib), "m/s^2"
        notes.append(f"{name}: counts times the scale factor of the header; the zero is the recorder's")
    times = [even_ns(t.stats.starttime.ns, int(t.stats.npts), float(t.stats.sampling_rate)) for t in traces]
    return Channel(name, values, unit, float(stats.sampling_rate), None, np.concatenate(times))
