"""Slow-time I/Q: one phasor a frame for each channel and range bin, as long monitoring stores it (HDF5, NPY)."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.checks import CARRIER_HZ, RATE_HZ
from midspan.errors import DataError, UsageError
from midspan.radar.chirp import SPEED_OF_LIGHT_M_S, ChirpProfile, RadarInfo, profile_from_json
from midspan.records import NANOSECONDS, Floats, Nanoseconds
from midspan.sources.boundary import reading, require_memory
from midspan.sources.hdf5_members import dataset, open_hdf5, values
from midspan.sources.radar.radar_source import RadarRequest, RadarSource, stamps
from midspan.sources.radar.ti_config import TiSettings, read_settings

_NAMES = ("iq", "slow_time", "frame", "z")


class SlowTimeFile(RadarSource):
    """Phasors (frames), (frames, channels) or (frames, channels, bins): complex, or a last axis of I and Q.

    An HDF5 file holds them as `iq` (complex, or the fields real and imag) or as `i` and `q`; together with them, as
    datasets or attributes, `carrier_hz` or `wavelength_m`, `rate_hz`, `time_s` or `time_ns`, and where known `range_m`
    of each bin, or `chirp`: the fields of `ChirpProfile` as JSON, where all bins of its range profiles are stored. What
    is not in the file comes from radar.config. Growing phase is growing range; NaN marks missing frames.
    """

    file_kind, at_a_time = "slow-time I/Q", 4096

    def __init__(self, path: Path, request: RadarRequest) -> None:
        super().__init__(path, request)
        settings = read_settings(request.config) if request.config else None
        self._read, shape, companions = _opened(path)
        if not 1 <= len(shape) <= 3 or 0 in shape:
            raise DataError(
                f"{path} must hold I/Q of shape (frames), (frames, channels) or (frames, channels, bins); received "
                f"{shape}."
            )
        self._shape = count, channels, bins = (*shape, 1, 1)[:3]
        # Times of all frames, and one block of phasors with its parts.
        block_bytes = 8 * min(count, self.at_a_time) * channels * bins
        require_memory(path, 4 * 8 * count + 3 * block_bytes, "its I/Q")
        if settings is None:
            # The request gives of rate and carrier what does not stand with the samples.
            given = {"rate_hz": request.rate_hz, "carrier_hz": request.carrier_hz}
            if "wavelength_m" in companions:
                given["carrier_hz"] = None
            companions = {key: value for key, value in given.items() if value is not None} | companions
        self._carrier_hz = _carrier(path, companions, settings)
        self._times_ns: Nanoseconds | None = None
        if "time_ns" in companions:
            own_ns = np.asarray(companions["time_ns"])
            if own_ns.shape != (count,) or own_ns.dtype.kind not in "iu" or not np.all(np.diff(own_ns) > 0):
                raise DataError(
                    f"{path}: time_ns must hold {count} increasing whole numbers (ns), one a frame. Correct it."
                )
            self._times_ns = own_ns.astype(np.int64)
        self._times_s = np.asarray(
            self._stamps(companions, settings) if self._times_ns is None else self._times_ns / NANOSECONDS,
            dtype=np.float64,
        )
        self._refuse_nothing()
        self._range_m = np.atleast_1d(np.asarray(companions.get("range_m", np.nan), dtype=np.float64))
        self._chirp = _chirp(path, companions["chirp"], bins) if "chirp" in companions else None
        if self._chirp is not None:
            self._range_m = self._chirp.axis.range_m

    @property
    def info(self) -> RadarInfo:
        """Size, carrier and rate."""
        count, channels, bins = self._shape
        step = float(np.median(np.diff(self._times_s))) if count > 1 else np.nan
        known = len(self._range_m) == bins
        return RadarInfo(
            kind="slow-time I/Q",
            carrier_hz=self._carrier_hz,
            frame_rate_hz=1.0 / step,
            frame_count=count,
            channels=channels,
            range_m=self._range_m if known else np.full(bins, np.nan),
            profile=self._chirp,
        )

    def times_ns(self) -> Nanoseconds:
        """From the file, else evenly spaced; `start_s` is added to what is in seconds."""
        if self._times_ns is not None:
            return self._times_ns
        return stamps(self._path, self._times_s, self._request.start_s)

    def _phasors(self, first: int, last: int) -> NDArray[np.complexfloating]:
        z: NDArray[np.complexfloating] = np.asarray(self._read(first, last))
        return z.reshape(last - first, *self._shape[1:])

    def _refuse_nothing(self) -> None:
        """DataError where no frame holds anything but zeros or NaN, or all hold the same."""
        count = self._shape[0]
        first: NDArray[np.complexfloating] | None = None
        for begin in range(0, count, self.at_a_time):
            z = self._phasors(begin, min(begin + self.at_a_time, count)).reshape(-1, self._shape[1] * self._shape[2])
            z = z[np.isfinite(z).all(axis=1)]
            first = z[0] if first is None and len(z) else first
            if first is not None and (z != first).any():
                return
        if count > 1:
            what = "nothing but missing frames (NaN)" if first is None else f"the same I/Q in all {count} frames"
            raise DataError(f"{self._path} has {what}, without any noise: no radar measured that. Check radar.file.")

    def _stamps(self, companions: dict[str, Any], settings: TiSettings | None) -> Floats:
        count = self._shape[0]
        if "time_s" in companions:
            times = np.asarray(companions["time_s"], dtype=np.float64)
            if times.shape != (count,) or not np.all(np.diff(times) > 0):
                raise DataError(
                    f"{self._path}: time_s must hold {count} increasing times (s), one a frame; received shape "
                    f"{times.shape}. Correct it."
                )
            return times
        rate = float(companions["rate_hz"]) if "rate_hz" in companions else 0.0
        if not rate and settings is not None:
            rate = settings.profile.frame_rate_hz
        if rate not in RATE_HZ:
            raise DataError(
                f"{self._path} must state its rate, {RATE_HZ}; received {rate:g}. Store rate_hz or time_s in it, or "
                "give radar.rate_hz."
            )
        return np.arange(count) / rate


def _chirp(path: Path, given: Any, bins: int) -> ChirpProfile:
    """The chirp of `bins` range bins that an attribute describes."""
    try:
        found = profile_from_json(str(given))
    except (UsageError, TypeError, ValueError) as error:
        raise DataError(f"{path}: chirp must be the settings of a chirp as JSON ({error}). Take it out.") from None
    if found.bins != bins:
        raise DataError(f"{path}: its chirp has {found.bins} range bins, its I/Q {bins}. Take the attribute out.")
    return found


def _carrier(path: Path, companions: dict[str, Any], settings: TiSettings | None) -> float:
    """Frequency that the phase moves with, Hz."""
    if "carrier_hz" in companions:
        value = float(companions["carrier_hz"])
    elif "wavelength_m" in companions:
        value = SPEED_OF_LIGHT_M_S / (float(companions["wavelength_m"]) or np.inf)
    else:
        value = settings.profile.carrier_hz if settings is not None else 0.0
    if value not in CARRIER_HZ:
        raise DataError(
            f"{path} does not state the carrier frequency ({CARRIER_HZ}), so its phase has no scale. Store carrier_hz "
            "or wavelength_m in it, or give radar.carrier_hz."
        )
    return value


def _paired(array: Any) -> NDArray[np.complex64]:
    """Complex numbers of complex ones, of the fields real and imag, or of a last axis of I and Q."""
    # What is no number, or none that fits, is a frame that is missing.
    with np.errstate(invalid="ignore", over="ignore"):
        if array.dtype.kind == "c":
            return np.asarray(array, dtype=np.complex64)
        names = array.dtype.names
        i, q = (array[name] for name in names[:2]) if names else (array[..., 0], array[..., 1])
        return np.asarray(i.astype(np.float32) + 1j * q.astype(np.float32))


def _pair_shape(path: Path, dtype: Any, shape: tuple[int, ...]) -> tuple[int, ...]:
    if dtype.kind == "c" or (dtype.names and len(dtype.names) == 2):
        return shape
    if dtype.kind in "if" and len(shape) >= 2 and shape[-1] == 2:
        return shape[:-1]
    raise DataError(
        f"{path} must hold complex I/Q, or real numbers with a last axis of I and Q; received {dtype} of shape {shape}."
    )


def _opened(path: Path) -> tuple[Any, tuple[int, ...], dict[str, Any]]:
    """What reads the frames from one to another, their shape, and what stands with them."""
    if path.suffix.lower() == ".npy":
        with reading(path, "a NumPy array"):
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        shape = _pair_shape(path, array.dtype, array.shape)
        return lambda first, last: _paired(np.asarray(array[first:last])), shape, {}
    with reading(path, "HDF5"):
        file = open_hdf5(path)
    keys = ("time_s", "time_ns", "range_m", "carrier_hz", "wavelength_m", "rate_hz")
    companions = dict(file.attrs) | {key: values(path, file, key) for key in keys if key in file}
    name = next((name for name in _NAMES if name in file), None)
    if name is not None:
        data = dataset(path, file, name)
        companions = dict(data.attrs) | companions
        return lambda first, last: _paired(data[first:last]), _pair_shape(path, data.dtype, data.shape), companions
    if "i" in file and "q" in file:
        i, q = dataset(path, file, "i"), dataset(path, file, "q")
        if i.shape != q.shape:
            raise DataError(f"{path}: i and q must have the same shape; received {i.shape} and {q.shape}.")
        return lambda first, last: i[first:last] + 1j * q[first:last], i.shape, companions
    raise DataError(f"{path} must hold a dataset iq, or i and q; it holds {', '.join(file) or 'nothing'}.")
