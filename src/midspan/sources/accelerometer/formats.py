"""The logger formats: one table from suffix to reader."""

import importlib
import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from midspan.errors import DataError, UsageError
from midspan.sources.accelerometer.channel import Channel, ChannelSet, Stored, Values
from midspan.sources.boundary import head_of, reading, require_file, require_memory
from midspan.sources.zipped import on_disk


class Format(NamedTuple):
    """A format: its name, the suffixes that choose it, what it is read with, and the module and function that read it.

    head: what its files begin with, where they often have other names (None: the suffix alone chooses).
    """

    name: str
    suffixes: tuple[str, ...]
    reader: str
    module: str
    function: str = "read"
    head: re.Pattern[bytes] | None = None


_OBSPY = "ObsPy (extra seismic)"
_SEED_SUFFIXES = (".mseed", ".msd", ".miniseed", ".ms", ".seed", ".fullseed")
# Sequence number, then the kind of the record: of data (D, R, Q, M), or a control header of a volume. Version 3: MS.
_SEED_HEAD = re.compile(rb"([0-9 \0]{6}[DRQMVAST][ *]|MS\x03)")
# Borehole and surface of KiK-net are numbered.
_KNET_SUFFIXES = (".knet", *(f".{axis}{number}" for axis in ("ew", "ns", "ud") for number in ("", "1", "2")))
# Word 76 of 158 in a SAC header is its version, 6 or 7.
_SAC_HEAD = re.compile(rb"(?s:.{304})([\x06\x07]\0\0\0|\0\0\0[\x06\x07])")

_FORMATS = (
    Format("text columns", (".csv", ".txt", ".dat", ".asc", ".tsv"), "pandas", "text"),
    Format("Parquet", (".parquet", ".pq"), "pyarrow", "parquet"),
    Format("NumPy", (".npy", ".npz"), "numpy", "tree", "read_numpy"),
    Format("MATLAB 5 to 7.3", (".mat",), "scipy, h5py", "tree", "read_matlab"),
    Format("HDF5", (".h5", ".hdf5", ".hdf"), "h5py", "tree", "read_hdf5"),
    Format("Excel workbook", (".xlsx", ".xlsm"), "openpyxl", "text", "read_xlsx"),
    Format("TDMS", (".tdms",), "npTDMS", "tdms"),
    Format("LabVIEW measurement", (".lvm",), "lvm_read", "lvm"),
    Format("miniSEED or full SEED", _SEED_SUFFIXES, "pymseed", "seismic", "read_miniseed", _SEED_HEAD),
    Format("Universal file, dataset 58", (".uff", ".unv", ".58"), "pyuff", "uff"),
    Format("CSMIP and COSMOS V1 and V2", (".v2", ".v2c", ".v1", ".v1c"), "midspan", "strong_motion"),
    Format("K-NET and KiK-net", _KNET_SUFFIXES, _OBSPY, "seismic", "read_knet", re.compile(rb"Origin Time\s+\d{4}/")),
    Format("SAC", (".sac",), _OBSPY, "seismic", "read_sac", _SAC_HEAD),
    Format("GSE2", (".gse", ".gse2"), "midspan", "seismic", "read_gse2", re.compile(rb"(BEGIN GSE2|WID2 )")),
)

FORMATS = tuple(row[:3] for row in _FORMATS)
"""Rows of (name, suffixes, what it is read with)."""

_BY_SUFFIX = {suffix: row for row in _FORMATS for suffix in row.suffixes}


def list_channels(path: Path) -> ChannelSet:
    """All channels of a logger file with what its reader found.

    The suffix chooses the reader; without a known one, as of miniSEED in archives, what the file begins with.
    Raises UsageError for an unknown suffix and DataError for a missing, unreadable or empty file.
    """
    with on_disk(path) as file:
        found = _channels(file)
        if file != path:
            # Nothing is left to be read later.
            found = replace(found, channels=tuple(replace(one, stored=one.values) for one in found.channels))
    return found


def _channels(path: Path) -> ChannelSet:
    """The same of a file on the disk."""
    row = _BY_SUFFIX.get(path.suffix.lower()) or _by_head(path)
    if row is None:
        raise UsageError(
            f"{path}: the suffix must be one of {', '.join(_BY_SUFFIX)}; received {path.suffix!r}. "
            f"{'Save it as .xlsx or .csv' if path.suffix.lower() == '.xls' else 'Rename or convert the file'}."
        )
    require_file(path)
    if path.stat().st_size == 0:
        raise DataError(f"{path} is empty (0 bytes). Give a {row.name} file with data.")
    with reading(path, row.name):
        reader = getattr(importlib.import_module(f"midspan.sources.accelerometer.{row.module}"), row.function)
        found: ChannelSet = reader(path)
    if not found.channels:
        why = "".join(f" {line[:1].upper()}{line[1:]}." for line in (*found.notes, *found.damage))
        raise DataError(
            f"{path} has no numeric channel.{why} Give a {row.name} file with at least one series of numbers."
        )
    return replace(found, channels=tuple(_guarded(path, row, channel) for channel in found.channels))


def _by_head(path: Path) -> Format | None:
    """The format that a file begins as; None where it begins as none, or cannot be read."""
    try:
        require_file(path)
        head = head_of(path)
    except (DataError, OSError):
        return None
    return next((row for row in _FORMATS if row.head is not None and row.head.match(head)), None)


def _guarded(path: Path, row: Format, channel: Channel) -> Channel:
    """The channel with the same care around the reading of its values as there is around that of the file."""
    stored = channel.stored
    if not isinstance(stored, Stored):
        return channel

    def load() -> Values:
        require_memory(path, stored.needed_bytes, f"channel {channel.name!r}")
        with reading(path, row.name):
            return stored.load()

    return replace(channel, stored=replace(stored, load=load))
