"""National Instruments TDMS, read with npTDMS."""

from pathlib import Path
from typing import Any

import numpy as np

from midspan.sources.accelerometer.channel import Channel, ChannelSet, numbers

_UNITS = ("unit_string", "NI_UnitDescription", "unit", "Unit")
# LabVIEW's zero of time, 1904: a waveform that starts there was never given a start.
_UNSET_BEFORE_NS = int(np.datetime64("1971-01-01", "ns").astype(np.int64))


def read(path: Path) -> ChannelSet:
    """All channels as `group/channel`, scaled as the file says; rate and start from the waveform properties."""
    from nptdms import TdmsFile

    channels: list[Channel] = []
    notes: list[str] = []
    with path.open("rb") as opened, TdmsFile.open(opened) as file:
        for group in file.groups():
            for item in group.channels():
                values = numbers(np.asarray(item[:]))
                if values is None or values.size < 2:
                    notes.append(f"{group.name}/{item.name} left out: no series of numbers")
                    continue
                channels.append(_channel(f"{group.name}/{item.name}", values, np.asarray(item[:1]), item.properties))
    return ChannelSet(tuple(channels), tuple(notes))


def _channel(name: str, values: Any, first: Any, properties: dict[str, Any]) -> Channel:
    if first.dtype.kind == "M":
        return Channel(name, values, "ns")
    step = properties.get("wf_increment")
    rate_hz = 1.0 / float(step) if step else None
    unit = next((str(properties[key]) for key in _UNITS if properties.get(key)), None)
    return Channel(name, values, unit, rate_hz, _start_ns(properties) if rate_hz else None)


def _start_ns(properties: dict[str, Any]) -> int | None:
    offset_ns = round(float(properties.get("wf_start_offset") or 0.0) * 1e9)
    start = properties.get("wf_start_time")
    if start is None:
        return offset_ns or None
    start_ns = int(np.datetime64(start).astype("datetime64[ns]").astype(np.int64))
    return (start_ns + offset_ns) if start_ns > _UNSET_BEFORE_NS else (offset_ns or None)
