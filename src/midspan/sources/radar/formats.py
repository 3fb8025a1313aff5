"""Radar data of any kind: one table from suffix to reader."""

from pathlib import Path

from midspan.checks import option
from midspan.errors import DataError, UsageError
from midspan.radar.layout import ORDERS
from midspan.sources.boundary import reading
from midspan.sources.radar.radar_source import RadarRequest, RadarSource

_HDF5 = (".h5", ".hdf5")

FORMATS = (
    ("raw ADC of a TI mmWave radar with DCA1000", (".bin",), "midspan"),
    ("slow-time I/Q, or a recording of an Acconeer A121 or A111 (IQ)", _HDF5, "h5py"),
    ("slow-time I/Q", (".npy",), "numpy"),
)
"""Rows of (name, suffixes, what it is read with)."""


def open_radar(path: Path, request: RadarRequest) -> RadarSource:
    """The radar data at `path`, by its suffix.

    Raises UsageError for settings out of range or an unknown suffix, DataError for what cannot be read.
    """
    option("radar.iq_order", request.iq_order, ("auto", *ORDERS))
    if not path.is_file():
        raise DataError(f"{path}: not found. Correct radar.file; it counts from the settings file's folder.")
    with reading(path, "radar data"):
        source = _reader(path)(path, request)
        # What they work out of a damaged header fails here.
        _, _ = source.info, source.times_ns()
    return source


def _reader(path: Path) -> type[RadarSource]:
    suffix = path.suffix.lower()
    if suffix == ".bin":
        from midspan.sources.radar.dca1000 import RawCapture

        return RawCapture
    if suffix in _HDF5:
        from midspan.sources.radar.acconeer import reader_of

        if (acconeer := reader_of(path)) is not None:
            return acconeer
    if suffix in (*_HDF5, ".npy"):
        from midspan.sources.radar.slow_time import SlowTimeFile

        return SlowTimeFile
    known = ", ".join(name for _, names, _ in FORMATS for name in names)
    raise UsageError(f"{path} is no radar data that can be read; known suffixes are {known}.")
