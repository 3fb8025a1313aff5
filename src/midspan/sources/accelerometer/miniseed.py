"""miniSEED (version 2 and 3), read with pymseed."""

from pathlib import Path
from typing import Any

import numpy as np

from midspan.records import Nanoseconds
from midspan.sources.accelerometer.channel import Channel, ChannelSet

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


def read(path: Path) -> ChannelSet:
    """All channels as `NET.STA.LOC.CHA` in counts, with the true time stamp of every sample; gaps stay gaps."""
    from pymseed import MS3TraceList, sourceid2nslc

    channels: list[Channel] = []
    notes: list[str] = []
    traces = MS3TraceList.from_file(str(path), unpack_data=True)
    for trace in traces:
        segments = [s for s in trace if s.numsamples]
        if not segments or segments[0].sampletype not in ("i", "f", "d"):
            notes.append(f"{trace.sourceid} left out: no numbers")
            continue
        segments.sort(key=lambda segment: int(segment.starttime))
        # A copy: the samples belong to the trace list, which goes with this function.
        values = np.concatenate([np.array(s.np_datasamples, dtype=np.float64) for s in segments])
        time_ns = np.concatenate([_times(s) for s in segments])
        network, station, location, code = sourceid2nslc(trace.sourceid)
        name, unit = f"{network}.{station}.{location}.{code}", None
        if station == _OWN_STATION and code in _OWN_CHANNELS:
            name, unit = _OWN_CHANNELS[code]
        if len(segments) > 1:
            notes.append(f"{name}: {len(segments) - 1} gaps")
        channels.append(Channel(name, values, unit, _rate(segments[0]), None, time_ns))
    return ChannelSet(tuple(channels), tuple(notes))


def _rate(segment: Any) -> float:
    """The rate in Hz; a negative number in the file is a sample period in seconds."""
    rate = float(segment.samprate)
    return rate if rate >= 0 else -1.0 / rate


def _times(segment: Any) -> Nanoseconds:
    steps = np.rint(np.arange(int(segment.numsamples)) * (1e9 / _rate(segment))).astype(np.int64)
    return np.asarray(np.int64(segment.starttime) + steps, dtype=np.int64)
