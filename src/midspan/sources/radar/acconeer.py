"""Recordings of Acconeer's A121 pulsed coherent radar (HDF5): complex range profiles at 60.5 GHz."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.radar.chirp import RadarInfo
from midspan.records import Floats, Nanoseconds, RangeFrames
from midspan.sources.boundary import reading
from midspan.sources.declared_size import require_memory
from midspan.sources.hdf5_members import open_hdf5
from midspan.sources.radar.radar_source import RadarRequest, RadarSource, at_bins, stamps
from midspan.sources.radar.stored import dataset, values
from midspan.trees import json_tree

CARRIER_HZ = 60.5e9
FRAMES_AT_A_TIME = 512
# Where the first session lies in files of the maker's program, and of its version 5.
_SESSIONS = ("sessions/session_0", "session")
_ENTRY = "group_0/entry_0"


class AcconeerRecording(RadarSource):
    """Sweeps of a recording, each a frame; subsweeps with the transmitter on lie side by side as bins.

    Sweeps of one frame are as far apart as the sweep rate says, which is the sensor's largest where it was left to it
    (the maker's default); where that is not known, or frames overlap by it, the sweeps of a frame are averaged. Frames
    follow each other by the sweep rate in continuous mode, else by the frame rate, else by the ticks of the recorder. A
    loopback subsweep can take out the device's own phase.
    """

    file_kind = "a recording of an Acconeer A121"

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
        if self.has_loopback:
            notes.append("a loopback subsweep is there to take out the device's own phase")
        return RadarInfo(
            kind="Acconeer A121",
            carrier_hz=CARRIER_HZ,
            frame_rate_hz=1.0 / float(np.median(np.diff(self._times_s))) if len(self._times_s) > 1 else np.nan,
            frame_count=len(self._times_s),
            channels=1,
            range_m=self._range_m,
            notes=tuple(notes),
        )

    @property
    def has_loopback(self) -> bool:
        """Whether there is a subsweep of the device itself, whose phase a target's can be referred to."""
        return any(not part[2] for part in self._parts)

    def times_ns(self) -> Nanoseconds:
        """One stamp a sweep, or a frame whose sweeps are averaged, from 0 on, `start_s` added."""
        return stamps(self._path, self._times_s, self._request.start_s)

    def _profiles(self, start: int, stop: int | None) -> Iterator[RangeFrames]:
        """All ranges; the phase of the loopback, where there is one, is taken out."""
        times = self.times_ns()
        sweeps = len(times) // len(self._data)
        begin, end, _ = slice(start, stop).indices(len(times))
        for first in range(begin // sweeps, -(-end // sweeps), FRAMES_AT_A_TIME):
            last = min(first + FRAMES_AT_A_TIME, -(-end // sweeps))
            raw = self._data[first:last]
            z = raw["real"].astype(np.float32) + 1j * raw["imag"].astype(np.float32)
            z = (z if sweeps > 1 else z.mean(axis=1)).reshape(-1, self._data.shape[2])
            low, high = max(begin - first * sweeps, 0), min(end - first * sweeps, len(z))
            block = self._ranges(z[low:high])
            stamps = times[first * sweeps + low : first * sweeps + high]
            valid = np.asarray(np.isfinite(block).all(axis=1)).reshape(-1, 1)
            yield RangeFrames(stamps, block[:, None, :], valid)

    def _slow_time(self, bins: Floats, start: int, stop: int | None) -> Iterator[RangeFrames]:
        """The ranges that are asked for, by bin."""
        for block in self._profiles(start, stop):
            yield RangeFrames(block.time_ns, at_bins(block.phasors, bins), block.valid)

    def _ranges(self, z: NDArray[np.complexfloating]) -> NDArray[np.complex64]:
        kept = np.concatenate([z[:, part[0]] for part in self._parts if part[2]], axis=1)
        loop = [z[:, part[0]] for part in self._parts if not part[2]]
        if loop:
            kept = kept * np.exp(-1j * np.angle(loop[0].mean(axis=1)))[:, None]
        return np.asarray(kept, dtype=np.complex64)

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

    if not path.is_file():
        raise DataError(f"{path}: not found. Correct radar.file; it counts from the settings file's folder.")
    with reading(path, AcconeerRecording.file_kind):
        file = open_hdf5(path)
        session = _session(file)
        entry = f"{session}/{_ENTRY}"
        data = dataset(path, file, f"{entry}/result/frame")
        require_memory(
            path, 4 * data.nbytes * FRAMES_AT_A_TIME // max(len(data), FRAMES_AT_A_TIME), "a block of frames"
        )
        groups = json_tree(values(path, file, f"{session}/session_config"))["groups"]
        metadata = json_tree(values(path, file, f"{entry}/metadata"))
        server = json_tree(values(path, file, "server_info"))
        sensor = str(int(values(path, file, f"{entry}/sensor_id")))
        settings = next(iter(groups[0].values())) if sensor not in groups[0] else groups[0][sensor]
        ticks = np.asarray(values(path, file, f"{entry}/result/tick"), dtype=np.int64)
        return data, settings, metadata, ticks, 1.0 / float(server.get("ticks_per_second") or 1000)


def is_acconeer(path: Path) -> bool:
    """Whether an HDF5 file is laid out as Acconeer's recordings are."""

    with reading(path, "HDF5"), open_hdf5(path) as file:
        return bool(_session(file))


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
