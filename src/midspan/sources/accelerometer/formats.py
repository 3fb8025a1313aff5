"""The logger formats: one table from suffix to reader."""

import importlib
from dataclasses import dataclass, replace
from pathlib import Path

from midspan.errors import DataError, UsageError
from midspan.sources.accelerometer.channel import Channel, ChannelSet, Stored, Values
from midspan.sources.boundary import reading, require_file
from midspan.sources.declared_size import require_memory


@dataclass(frozen=True, slots=True)
class Format:
    """A format: its name, the suffixes that choose it, what it is read with, and the module with its `read`."""

    name: str
    suffixes: tuple[str, ...]
    reader: str
    module: str


_PACKAGE = "midspan.sources.accelerometer"

_FORMATS = (
    Format("text columns", (".csv", ".txt", ".dat", ".asc", ".tsv"), "pandas", "text"),
    Format("Parquet", (".parquet", ".pq"), "pyarrow", "parquet"),
    Format("NumPy", (".npy", ".npz"), "numpy", "numpy"),
    Format("MATLAB 5 to 7.3", (".mat",), "scipy, h5py", "matlab"),
    Format("HDF5", (".h5", ".hdf5", ".hdf"), "h5py", "hdf5"),
    Format("Excel workbook", (".xlsx", ".xlsm"), "openpyxl", "xlsx"),
    Format("TDMS", (".tdms",), "npTDMS", "tdms"),
    Format("LabVIEW measurement", (".lvm",), "lvm_read", "lvm"),
    Format("miniSEED", (".mseed", ".msd", ".miniseed"), "pymseed", "miniseed"),
    Format("Universal file, dataset 58", (".uff", ".unv", ".58"), "pyuff", "uff"),
    Format("CSMIP and COSMOS V2", (".v2", ".v2c"), "midspan", "strong_motion"),
)

FORMATS = tuple((row.name, row.suffixes, row.reader) for row in _FORMATS)
"""Rows of (name, suffixes, what it is read with)."""

_BY_SUFFIX = {suffix: row for row in _FORMATS for suffix in row.suffixes}


def list_channels(path: Path) -> ChannelSet:
    """All channels of a logger file with what its reader found; the suffix chooses the reader.

    Raises UsageError for an unknown suffix and DataError for a missing, unreadable or empty file.
    """
    row = _BY_SUFFIX.get(path.suffix.lower())
    if row is None:
        raise UsageError(
            f"{path}: the suffix must be one of {', '.join(_BY_SUFFIX)}; received {path.suffix!r}. "
            "Rename or convert the file."
        )
    require_file(path)
    if path.stat().st_size == 0:
        raise DataError(f"{path} is empty (0 bytes). Give a {row.name} file with data.")
    found = _read(path, row)
    if not found.channels:
        why = "".join(f" {line[:1].upper()}{line[1:]}." for line in (*found.notes, *found.damage))
        raise DataError(
            f"{path} holds no channel of numbers.{why} Give a {row.name} file with one series of numbers or more."
        )
    return found


def _read(path: Path, row: Format) -> ChannelSet:
    with reading(path, row.name):
        module = importlib.import_module(f"{_PACKAGE}.{row.module}")
        found = module.read(path)
    assert isinstance(found, ChannelSet)
    return replace(found, channels=tuple(_guarded(path, row, channel) for channel in found.channels))


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
