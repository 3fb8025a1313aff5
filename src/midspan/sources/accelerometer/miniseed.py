"""miniSEED (version 2 and 3), read with pymseed; also the data records of a full SEED volume."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from midspan.records import Nanoseconds
from midspan.sources.accelerometer.channel import Channel, ChannelSet
from midspan.sources.boundary import require_memory

# libmseed's status of a stream that ends within a record (MS_ENDOFFILE).
_END_OF_FILE = 1
# That of bytes that are no record of data (MS_NOTSEED).
_NOT_SEED = -2
# Sequence number, and the kind of a control header: volume, abbreviation, station, time span.
_CONTROL_HEADER = re.compile(rb"[0-9]{6}[VAST][ *]")
# The channels of a result that midspan wrote, with their names and units in the other formats.
_OWN_STATION = "MIDSP"
_OWN_CHANNELS = {
    "DSP": ("displacement_mm", "mm"),
    "STD": ("displacement_std_mm", "mm"),
    "VEL": ("velocity_mm_s", "mm/s"),
}
# Along a second image axis its letter stands in the last place.
_OWN_CHANNELS |= {
    code + axis.upper(): (name, unit)
    for axis in "xy"
    for code, name, unit in (
        ("DS", f"displacement_{axis}_mm", "mm"),
        ("ST", f"displacement_std_{axis}_mm", "mm"),
        ("VE", f"velocity_{axis}_mm_s", "mm/s"),
    )
}


# A word of four bytes holds seven samples at most (Steim 2), so no record holds more than two a byte.
_MAX_SAMPLES_PER_BYTE = 2


def read(path: Path) -> ChannelSet:
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
        time_ns = np.concatenate([_times(s) for s in segments])
        name, unit = _name(trace.sourceid), None
        station, code = name.split(".")[1], name.split(".")[-1]
        if station == _OWN_STATION and code in _OWN_CHANNELS:
            name, unit = _OWN_CHANNELS[code]
        if len(segments) > 1:
            notes.append(f"{name}: {len(segments) - 1} gaps")
        channels.append(Channel(name, values, unit, _rate(segments[0]), None, time_ns))
    return ChannelSet(tuple(channels), tuple(notes), damage)


def _records(path: Path) -> tuple[bytes, tuple[str, ...], tuple[str, ...]]:
    """The bytes of all records of data, notes, and sentences on what is damaged.

    Records of another kind are passed over: control headers of a SEED volume, noise records. In a file that does not
    begin as a volume it is not known what they are, and they count as damage.
    """
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
        if _CONTROL_HEADER.match(file.read(8)):
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

    def sentence(self, sourceid: str) -> str:
        """How much of the channel is left out, and where it begins."""
        first = np.datetime64(self.first_ns, "ns").astype("datetime64[ms]")
        return (
            f"{_name(sourceid)}: {self.records} of {self.of} records are damaged (their samples do not end at the last "
            f"value that the record states) and count as missing: {self.samples} samples, the first at {first} UTC"
        )


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
    return (
        b"".join(sound),
        (*(lost.sentence(name) for name, lost in channels.items() if lost.records), *cut),
        other_bytes,
    )


def _rate(segment: Any) -> float:
    """The rate in Hz; a negative number in the file is a sample period in seconds."""
    rate = float(segment.samprate)
    return rate if rate >= 0 else -1.0 / rate


def _times(segment: Any) -> Nanoseconds:
    steps = np.rint(np.arange(int(segment.numsamples)) * (1e9 / _rate(segment))).astype(np.int64)
    return np.asarray(np.int64(segment.starttime) + steps, dtype=np.int64)
