"""Recordings of Acconeer's pulsed coherent radars at 60.5 GHz (HDF5): range profiles of the A121, and of the A111's
IQ service.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.radar.chirp import RadarInfo
from midspan.records import Floats, Nanoseconds
from midspan.sources.accelerometer.select import RATE_TOLERANCE
from midspan.sources.boundary import reading, require_memory
from midspan.sources.hdf5_members import dataset, open_hdf5, values
from midspan.sources.radar.radar_source import RadarRequest, RadarSource, stamps
from midspan.trees import json_tree

CARRIER_HZ = 60.5e9
# Where the first session lies in files of the maker's program, and of its version 5.
_SESSIONS = ("sessions/session_0", "session")
_ENTRY = "group_0/entry_0"
_A111_MEMBERS = ("mode", "data", "session_info", "sensor_config_dump")


def reader_of(path: Path) -> type[RadarSource] | None:
    """What reads an HDF5 file that is laid out as recordings of an A121 or A111 are; None for any other."""
    with reading(path, "HDF5"), open_hdf5(path) as file:
        if _session(file):
            return AcconeerRecording
        return A111Recording if all(name in file for name in _A111_MEMBERS) else None


class _Recording(RadarSource):
    """What both recordings have: the data set, the times of its frames (s) and the ranges (m)."""

    kind: str
    _data: Any
    _times_s: Floats
    _range_m: Floats

    def _info(self, notes: list[str]) -> RadarInfo:
        return RadarInfo(
            kind=self.kind,
            carrier_hz=CARRIER_HZ,
            frame_rate_hz=1.0 / float(np.median(np.diff(self._times_s))) if len(self._times_s) > 1 else np.nan,
            frame_count=len(self._times_s),
            channels=1,
            range_m=self._range_m,
            notes=tuple(notes),
        )

    def times_ns(self) -> Nanoseconds:
        """One stamp a frame, or a sweep that is dated on its own, from 0 on, `start_s` added."""
        return stamps(self._path, self._times_s, self._request.start_s)


class AcconeerRecording(_Recording):
    """Sweeps of a recording, each a frame; subsweeps with the transmitter on lie side by side as bins.

    Sweeps of one frame are as far apart as the sweep rate says, which is the sensor's largest where it was left to it
    (the maker's default); where that is not known, or frames overlap by it, the sweeps of a frame are averaged. Frames
    follow each other by the sweep rate in continuous mode, else by the frame rate, else by the ticks of the recorder. A
    loopback subsweep can take out the device's own phase.
    """

    file_kind, kind = "a recording of an Acconeer A121", "Acconeer A121"

    def __init__(self, path: Path, request: RadarRequest) -> None:
        super().__init__(path, request)
        self._data, self._settings, metadata, self._ticks, tick_s = _opened(path)
        self._parts = _parts(self._settings, metadata, float(metadata["base_step_length_m"]))
        self._range_m = np.concatenate([part[1] for part in self._parts if part[2]] or [np.empty(0)])
        if not len(self._range_m):
            raise DataError(f"{path} holds no subsweep with the transmitter on. Record one that measures a range.")
        self._sweep_hz = self._settings.get("sweep_rate") or metadata.get("max_sweep_rate")
        self._times_s = self._stamps(tick_s)

    @property
    def info(self) -> RadarInfo:
        """Sweep rate, ranges and what was noticed."""
        count, sweeps = self._data.shape[:2]
        notes = [f"{count} frames of {sweeps} sweeps, {len(self._range_m)} ranges"]
        if sweeps > 1 and not self._settings.get("sweep_rate"):
            is_split = len(self._times_s) > count
            how = f"follow each other at the sensor's largest, {self._sweep_hz:.5g} Hz" if is_split else "are averaged"
            notes.append(f"no sweep rate was set; the sweeps of a frame {how}")
        if any(not part[2] for part in self._parts):
            notes.append("a loopback subsweep is there to take out the device's own phase")
        return self._info(notes)

    def _phasors(self, first: int, last: int) -> NDArray[np.complexfloating]:
        """All ranges; the phase of the loopback, where there is one, is taken out."""
        sweeps = len(self._times_s) // len(self._data)
        begin = first // sweeps
        raw = self._data[begin : -(-last // sweeps)]
        z = raw["real"].astype(np.float32) + 1j * raw["imag"].astype(np.float32)
        z = (z if sweeps > 1 else z.mean(axis=1)).reshape(-1, self._data.shape[2])
        z = z[first - begin * sweeps : last - begin * sweeps]
        kept: NDArray[np.complexfloating] = np.concatenate([z[:, part[0]] for part in self._parts if part[2]], axis=1)
        loop = [z[:, part[0]] for part in self._parts if not part[2]]
        if loop:
            kept = kept * np.exp(-1j * np.angle(loop[0].mean(axis=1)))[:, None]
        return kept[:, None]

    def _stamps(self, tick_s: float) -> Floats:
        count, sweeps = self._data.shape[:2]
        frame_rate = self._settings.get("frame_rate")
        if self._settings.get("continuous_sweep_mode") and self._sweep_hz:
            return np.asarray(np.arange(count * sweeps) / self._sweep_hz, dtype=np.float64)
        if frame_rate:
            begin = np.arange(count) / frame_rate
        else:
            ticks = np.unwrap(self._ticks.astype(np.float64), period=2.0**32) * tick_s
            begin = ticks - ticks[0]
            if count > 1 and not np.all(np.diff(begin) > 0):
                raise DataError(
                    f"{self._path}: its ticks do not increase from frame to frame, and no rate is given. Record with a "
                    "frame rate."
                )
        frames_s = np.asarray(begin, dtype=np.float64)
        if sweeps == 1 or not self._sweep_hz:
            return frames_s
        sweeps_s = np.asarray(np.add.outer(frames_s, np.arange(sweeps) / self._sweep_hz).ravel())
        # Frames that follow each other at once, by ticks of a ms: only their means have an order.
        is_ordered = self._settings.get("sweep_rate") or np.all(np.diff(sweeps_s) > 0.0)
        return sweeps_s if is_ordered else frames_s


def _opened(path: Path) -> tuple[Any, dict[str, Any], dict[str, Any], NDArray[np.int64], float]:
    """The data set of frames, the sensor's settings, the metadata, the ticks and their length in s."""
    with reading(path, AcconeerRecording.file_kind):
        file = open_hdf5(path)
        session = _session(file)
        entry = f"{session}/{_ENTRY}"
        data = dataset(path, file, f"{entry}/result/frame")
        block = AcconeerRecording.at_a_time
        require_memory(path, 4 * data.nbytes * block // max(len(data), block), "a block of frames")
        groups = json_tree(values(path, file, f"{session}/session_config"))["groups"]
        metadata = json_tree(values(path, file, f"{entry}/metadata"))
        server = json_tree(values(path, file, "server_info"))
        sensor = str(int(values(path, file, f"{entry}/sensor_id")))
        settings = next(iter(groups[0].values())) if sensor not in groups[0] else groups[0][sensor]
        ticks = np.asarray(values(path, file, f"{entry}/result/tick"), dtype=np.int64)
        return data, settings, metadata, ticks, 1.0 / float(server.get("ticks_per_second") or 1000)


def _session(file: Any) -> str:
    """Where the first session with frames lies in an open file; empty where there is none."""
    return next((name for name in _SESSIONS if f"{name}/{_ENTRY}/result/frame" in file), "")


def _parts(settings: dict[str, Any], metadata: dict[str, Any], step_m: float) -> list[tuple[slice, Floats, bool]]:
    """Of each subsweep: its place in a sweep, the ranges of its points (m), and whether it looks outside."""
    parts = []
    for offset, length, sub in zip(
        metadata["subsweep_data_offset"], metadata["subsweep_data_length"], settings["subsweeps"], strict=True
    ):
        points = sub["start_point"] + sub["step_length"] * np.arange(length)
        outside = bool(sub.get("enable_tx", True)) and not sub.get("enable_loopback", False)
        if outside or sub.get("enable_loopback", False):
            parts.append((slice(offset, offset + length), points * step_m, outside))
    return parts


class A111Recording(_Recording):
    """Sweeps of the first sensor of a recording, each a frame of one channel.

    Their times are those of the update rate that was set where the recorder's clock agrees, else the recorder's.
    """

    file_kind, kind = "a recording of an Acconeer A111", "Acconeer A111"

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
        block_bytes = 8 * min(len(self._data), self.at_a_time) * int(np.prod(self._data.shape[1:]))
        require_memory(path, 4 * block_bytes, "a block of frames")
        step_m, first_m = float(info["step_length_m"]), float(info["range_start_m"])
        self._range_m = first_m + step_m * np.arange(self._data.shape[-1])
        self._times_s, self._clock_note = _a111_times(path, len(self._data), settings.get("update_rate"), recorded_s)

    @property
    def info(self) -> RadarInfo:
        """Rate, ranges and what was noticed."""
        notes = [f"{len(self._data)} frames, {len(self._range_m)} ranges", self._clock_note]
        if self._data.ndim == 3 and self._data.shape[1] > 1:
            notes.append(f"the first of {self._data.shape[1]} sensors is used")
        return self._info(notes)

    def _phasors(self, first: int, last: int) -> NDArray[np.complexfloating]:
        """All ranges."""
        raw = self._data[first:last]
        return np.asarray(raw[:, None] if raw.ndim == 2 else raw[:, :1])


def _a111_times(path: Path, count: int, set_hz: float | None, recorded_s: Floats) -> tuple[Floats, str]:
    """Times (count,) from 0 on, s, and where they are from."""
    is_clock = recorded_s.shape == (count,) and count > 1 and bool(np.all(np.diff(recorded_s) > 0.0))
    recorded_hz = (count - 1) / float(recorded_s[-1] - recorded_s[0]) if is_clock else None
    if set_hz and (recorded_hz is None or abs(recorded_hz / set_hz - 1.0) < RATE_TOLERANCE):
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
