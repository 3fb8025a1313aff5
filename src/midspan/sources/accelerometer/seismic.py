"""K-NET and KiK-net, and SAC, read with ObsPy, which is an extra of this package.

K-NET's counts become m/s² by the scale factor of their header, and their start is in UTC without the 15 s of delay that
the header's time has (NIED, K-NET ASCII format). SAC holds numbers whose unit the file does not say surely.
"""

import importlib
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from midspan.errors import UsageError
from midspan.records import Nanoseconds
from midspan.sources.accelerometer.channel import Channel, ChannelSet
from midspan.sources.boundary import require_memory

INSTALL = "pip install 'midspan[seismic]'"
# A number of four bytes (SAC) becomes eight bytes of value, and what they are worked out of; one of K-NET has nine.
_BYTES_OF_A_BYTE = 8


def read_knet(path: Path) -> ChannelSet:
    """The channel of a K-NET or KiK-net file in m/s²."""
    return _read(path, "KNET")


def read_sac(path: Path) -> ChannelSet:
    """The channel of a SAC file, without a unit."""
    return _read(path, "SAC")


def _read(path: Path, kind: str) -> ChannelSet:
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
    channels = [_channel(name or kind, traces, kind, notes) for name, traces in groups.items()]
    return ChannelSet(tuple(channels), tuple(notes))


def _channel(name: str, traces: list[Any], kind: str, notes: list[str]) -> Channel:
    traces.sort(key=lambda trace: trace.stats.starttime.ns)
    values = np.concatenate([np.asarray(trace.data, dtype=np.float64) for trace in traces])
    stats = traces[0].stats
    unit = None
    if kind == "KNET":
        values, unit = values * float(stats.calib), "m/s^2"
        notes.append(f"{name}: counts times the scale factor of the header; the zero is the recorder's")
    return Channel(name, values, unit, float(stats.sampling_rate), None, np.concatenate([_times(t) for t in traces]))


def _times(trace: Any) -> Nanoseconds:
    steps = np.rint(np.arange(int(trace.stats.npts)) * (1e9 / float(trace.stats.sampling_rate))).astype(np.int64)
    return np.asarray(np.int64(trace.stats.starttime.ns) + steps, dtype=np.int64)
