"""Recordings of Acconeer's A111 pulsed coherent radar (HDF5): the IQ service's range profiles at 60.5 GHz."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from midspan.errors import DataError
from midspan.radar.chirp import RadarInfo
from midspan.records import Floats, Nanoseconds, RangeFrames
from midspan.sources.boundary import reading
from midspan.sources.declared_size import require_memory
from midspan.sources.hdf5_members import open_hdf5
from midspan.sources.radar.acconeer import CARRIER_HZ, FRAMES_AT_A_TIME
from midspan.sources.radar.radar_source import RadarRequest, RadarSource, at_bins, stamps
from midspan.sources.radar.slow_time import MAX_PHASOR
from midspan.sources.radar.stored import dataset, values
from midspan.trees import json_tree

_MEMBERS = ("mode", "data", "session_info", "sensor_config_dump")
# The recorder's clock may differ from the rate that was set by this share before the clock counts.
_RATE_TOLERANCE = 0.01


class A111Recording(RadarSource):
    """Sweeps of the first sensor of a recording, each a frame of one channel.

    Their times are those of the update rate that was set where the recorder's clock agrees, else the recorder's.
    """

    file_kind = "a recording of an Acconeer A111"

    def __init__(self, path: Path, request: RadarRequest) -> None:
        super().__init__(path, request)
        with reading(path, self.file_kind):
            file = open_hdf5(path)
            mode = _text(values(path, file, "mode"))
            if mode.lower() != "iq":
                raise DataError(
                    f"{path}: displacement needs the phase of the service IQ; this recording of an Acconeer A111 has "
                    f"{mode!r}. Record with the IQ service."
                )
            self._data = dataset(path, file, "data")
            info = json_tree(_text(values(path, file, "session_info")))
            settings = json_tree(_text(values(path, file, "sensor_config_dump")))
            recorded_s = np.asarray(values(path, file, "sample_times")) if "sample_times" in file else np.empty(0)
        if self._data.dtype.kind != "c" or self._data.ndim not in (2, 3) or 0 in self._data.shape:
            raise DataError(
                f"{path}: data must be complex numbers (frames, sensors, ranges); received {self._data.dtype} of shape "
                f"{self._data.shape}. Record with the IQ service."
            )
        block_bytes = 8 * min(len(self._data), FRAMES_AT_A_TIME) * int(np.prod(self._data.shape[1:]))
        require_memory(path, 4 * block_bytes, "a block of frames")
        step_m, first_m = float(info["step_length_m"]), float(info["range_start_m"])
        self._range_m = first_m + step_m * np.arange(self._data.shape[-1])
        self._times_s, self._clock_note = _times(path, len(self._data), settings.get("update_rate"), recorded_s)

    @property
    def info(self) -> RadarInfo:
        """Rate, ranges and what was noticed."""
        notes = [f"{len(self._data)} frames, {len(self._range_m)} ranges", self._clock_note]
        if self._data.ndim == 3 and self._data.shape[1] > 1:
            notes.append(f"the first of {self._data.shape[1]} sensors is used")
        return RadarInfo(
            kind="Acconeer A111",
            carrier_hz=CARRIER_HZ,
            frame_rate_hz=1.0 / float(np.median(np.diff(self._times_s))) if len(self._times_s) > 1 else np.nan,
            frame_count=len(self._data),
            channels=1,
            range_m=self._range_m,
            notes=tuple(notes),
        )

    def times_ns(self) -> Nanoseconds:
        """One stamp a frame, from 0 on, `start_s` added."""
        return stamps(self._path, self._times_s, self._request.start_s)

    def _profiles(self, start: int, stop: int | None) -> Iterator[RangeFrames]:
        """All ranges."""
        times = self.times_ns()
        begin, end, _ = slice(start, stop).indices(len(times))
        for first in range(begin, end, FRAMES_AT_A_TIME):
            last = min(first + FRAMES_AT_A_TIME, end)
            # What does not fit is a frame that is missing.
            with np.errstate(invalid="ignore", over="ignore"):
                raw = np.asarray(self._data[first:last], dtype=np.complex64)
            z = raw if raw.ndim == 2 else raw[:, 0]
            z = np.where(np.abs(z) < MAX_PHASOR, z, np.complex64(np.nan))
            yield RangeFrames(times[first:last], z[:, None, :], np.asarray(np.isfinite(z).all(axis=1)).reshape(-1, 1))

    def _slow_time(self, bins: Floats, start: int, stop: int | None) -> Iterator[RangeFrames]:
        """The ranges that are asked for, by bin."""
        for block in self._profiles(start, stop):
            yield RangeFrames(block.time_ns, at_bins(block.phasors, bins), block.valid)


def is_a111(path: Path) -> bool:
    """Whether an HDF5 file is laid out as recordings of an A111 are."""
    with reading(path, "HDF5"), open_hdf5(path) as file:
        return all(name in file for name in _MEMBERS)


def _times(path: Path, count: int, set_hz: float | None, recorded_s: Floats) -> tuple[Floats, str]:
    """Times (count,) from 0 on, s, and where they are from."""
    is_clock = recorded_s.shape == (count,) and count > 1 and bool(np.all(np.diff(recorded_s) > 0.0))
    recorded_hz = (count - 1) / float(recorded_s[-1] - recorded_s[0]) if is_clock else None
    if set_hz and (recorded_hz is None or abs(recorded_hz / set_hz - 1.0) < _RATE_TOLERANCE):
        return np.arange(count) / float(set_hz), f"times by the update rate of {set_hz:g} Hz"
    if recorded_hz is None:
        raise DataError(
            f"{path}: says nothing of its rate: update_rate is not set and sample_times does not increase. Record with "
            "an update rate."
        )
    was = f"; {set_hz:g} Hz were set" if set_hz else ""
    return np.asarray(recorded_s - recorded_s[0]), f"times by the recorder's clock, {recorded_hz:.5g} Hz{was}"


def _text(value: Any) -> str:
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)
