"""Live records as an ordinary recording folder: what a point is calibrated on and opened from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from midspan.radar.chirp import RadarInfo, profile_to_json
from midspan.records import NANOSECONDS, Arrival, Frame, RangeFrame, Readings
from midspan.settings.kinds import ACCELEROMETER
from midspan.settings.recording import RecordingSettings
from midspan.writing import write_whole

# Profiles are written together, so many at a time.
FRAMES_AT_A_TIME = 64


class Capture:
    """Writes the records of a point's streams into `folder`; `close` makes a recording of it.

    settings: of the point's recordings, in SI units, with the names of the files; radars: what is known of each radar.
    """

    def __init__(self, folder: Path, settings: RecordingSettings, radars: Mapping[str, RadarInfo]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.settings = folder, settings
        self._readings: dict[str, list[Readings]] = {ACCELEROMETER: []}
        self._films: dict[str, _Film] = {}
        self._profiles: dict[str, _Profiles] = {}
        for sensor in settings.sensors:
            if sensor.kind == "displacement":
                self._readings[sensor.name] = []
            elif sensor.kind in ("camera", "infrared"):
                self._films[sensor.name] = _Film(folder / sensor.settings.file)
            else:
                self._profiles[sensor.name] = _Profiles(folder / sensor.settings.file, radars[sensor.name])

    def push(self, arrival: Arrival) -> None:
        """Keep a record."""
        if isinstance(arrival.record, Readings):
            self._readings[arrival.stream].append(arrival.record)
        elif isinstance(arrival.record, Frame):
            self._films[arrival.stream].add(arrival.record)
        elif isinstance(arrival.record, RangeFrame):
            self._profiles[arrival.stream].add(arrival.record)

    @property
    def length_s(self) -> float:
        """How long all streams have recorded together, s."""
        spans = [_span(blocks) for blocks in self._readings.values()] + [one.span for one in self._pictures]
        if any(span is None for span in spans):
            return 0.0
        known = [span for span in spans if span is not None]
        return max((min(last for _, last in known) - max(first for first, _ in known)) / NANOSECONDS, 0.0)

    @property
    def frames(self) -> int | None:
        """How many frames the camera or radar with the fewest has brought; None without one."""
        return min((one.count for one in self._pictures), default=None)

    @property
    def _pictures(self) -> list["_Film | _Profiles"]:
        return [*self._films.values(), *self._profiles.values()]

    def close(self) -> Path:
        """Finish the files and write the recording.toml; returns the folder."""
        import tomli_w

        for name, blocks in self._readings.items():
            time_ns, value = _joined(blocks)
            np.savez(self.folder / self._file(name), time_ns=time_ns, value=value)
        for one in self._pictures:
            one.close()
        tree = self.settings.model_dump(mode="json", exclude_none=True, exclude_unset=True)
        write_whole(self.folder / "recording.toml", tomli_w.dumps(tree).encode())
        return self.folder

    def discard(self) -> None:
        """Let the files go."""
        for one in self._pictures:
            one.close()

    def _file(self, name: str) -> str:
        if name == ACCELEROMETER:
            assert self.settings.accelerometer is not None
            return self.settings.accelerometer.file
        return next(sensor.settings.file for sensor in self.settings.sensors if sensor.name == name)


class _Stamped:
    """What is known of frames by their stamps (ns)."""

    def __init__(self) -> None:
        self._stamps: list[int] = []

    @property
    def count(self) -> int:
        """How many frames there are."""
        return len(self._stamps)

    @property
    def span(self) -> tuple[int, int] | None:
        """Stamps (ns) of the first and last frame."""
        return (self._stamps[0], self._stamps[-1]) if self._stamps else None


class _Film(_Stamped):
    """Frames of one size as a NumPy stack, and their stamps in a second file."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._file = file
        self._open: BinaryIO | None = None
        self._shape: tuple[int, ...] = ()
        self._dtype: np.dtype[Any] = np.dtype(np.uint8)

    def add(self, frame: Frame) -> None:
        """Append a frame; one of another size, or whose stamp is not later, is left out."""
        if self._open is None:
            self._shape, self._dtype = frame.pixels.shape, frame.pixels.dtype
            self._open = self._file.open("wb")
            self._head()
        if frame.pixels.shape != self._shape or (self._stamps and frame.time_ns <= self._stamps[-1]):
            return
        self._open.write(np.ascontiguousarray(frame.pixels).data)
        self._stamps.append(frame.time_ns)

    def close(self) -> None:
        """Write how many frames there are, and their stamps."""
        if self._open is None:
            return
        self._open.seek(0)
        self._head()
        self._open.close()
        self._open = None
        np.savez(times_file(self._file), time_s=np.array(self._stamps, dtype=np.int64))

    def _head(self) -> None:
        """The header, which has room for any number of frames."""
        assert self._open is not None
        description = {"descr": self._dtype.str, "fortran_order": False, "shape": (len(self._stamps), *self._shape)}
        np.lib.format.write_array_header_1_0(self._open, description)


class _Profiles(_Stamped):
    """Range profiles of a radar as slow-time I/Q; channels with a hole are NaN."""

    def __init__(self, file: Path, info: RadarInfo) -> None:
        super().__init__()
        self._file, self._info = file, info
        self._open: Any = None
        self._waiting: list[NDArray[np.complex64]] = []

    def add(self, frame: RangeFrame) -> None:
        """Append a frame; one whose stamp is not later is left out."""
        if self._stamps and frame.time_ns <= self._stamps[-1]:
            return
        self._stamps.append(frame.time_ns)
        self._waiting.append(np.where(frame.valid[:, None], frame.phasors, np.complex64(np.nan)))
        if len(self._waiting) >= FRAMES_AT_A_TIME:
            self._write()

    def close(self) -> None:
        """Write what waits, and the stamps."""
        if not self._stamps:
            return
        self._write()
        self._open["time_ns"] = np.array(self._stamps, dtype=np.int64)
        self._open["range_m"] = self._info.range_m
        self._open.attrs["carrier_hz"] = self._info.carrier_hz
        if self._info.profile is not None:
            self._open.attrs["chirp"] = profile_to_json(self._info.profile)
        self._open.close()
        self._open, self._stamps = None, []

    def _write(self) -> None:
        import h5py

        if self._open is None:
            shape = self._waiting[0].shape
            self._open = h5py.File(self._file, "w")
            self._open.create_dataset("iq", (0, *shape), np.complex64, maxshape=(None, *shape), chunks=(1, *shape))
        if self._waiting:
            iq, block = self._open["iq"], np.stack(self._waiting)
            iq.resize(len(iq) + len(block), axis=0)
            iq[-len(block) :] = block
            self._waiting = []


def times_file(film: Path) -> Path:
    """The file of a film's stamps: the reader takes whole numbers of this size as ns."""
    return film.with_name(f"{film.stem}-times.npz")


def capture_settings(settings: RecordingSettings, factors: dict[str, float]) -> RecordingSettings:
    """A point's settings for its recordings: readings in SI units, films as stacks with their stamps.

    factors: SI units in one unit of each channel's readings, by the sensor's name.
    """
    assert settings.accelerometer is not None
    own = {"unit": "m/s^2", "sensitivity": 0.0, "time": "time_ns", "value": "value"}
    # Stamps are UTC: a clock that is farther off than the range has to be set, and is no offset to live with.
    range_s = {"max_offset_s": settings.calibration.max_offset_s}
    changed: dict[str, Any] = {
        "accelerometer": settings.accelerometer.model_copy(update=own),
        "calibration": settings.calibration.model_copy(update=range_s),
    }
    films: dict[str, list[Any]] = {kind: [] for kind in ("cameras", "infrareds", "radars")}
    plain = []
    for sensor in settings.sensors:
        if sensor.kind in ("camera", "infrared"):
            name = f"{Path(sensor.settings.file).name}.npy"
            files = {"file": name, "times": times_file(Path(name)).name}
            films[f"{sensor.kind}s"].append(sensor.settings.model_copy(update=files))
        elif sensor.kind == "radar":
            own_files = {"file": f"{Path(sensor.settings.file).name}.h5", "config": None}
            films["radars"].append(sensor.settings.model_copy(update=own_files))
        elif sensor.kind == "displacement":
            noise: float | None = getattr(sensor.settings, "noise_std", None)
            scaled = None if noise is None else noise * factors[sensor.name]
            # A clock that gains on the accelerometer's is refused: live nothing takes its rate out.
            is_sought = bool(getattr(sensor.settings, "estimate_offset", False))
            plain.append(sensor.settings.model_copy(
                update={
                    "unit": "m", "time": "time_ns", "value": "value", "noise_std": scaled, "estimate_offset": is_sought
                }
            ))  # fmt: skip
    changed |= {kind: tuple(listed) for kind, listed in films.items()} | {"displacements": tuple(plain)}
    return settings.model_copy(update=changed)


def _span(blocks: list[Readings]) -> tuple[int, int] | None:
    return (int(blocks[0].time_ns[0]), int(blocks[-1].time_ns[-1])) if blocks else None


def _joined(blocks: list[Readings]) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) and values (n,) with increasing stamps."""
    time_ns = np.concatenate([one.time_ns for one in blocks])
    value = np.concatenate([one.value.reshape(len(one.time_ns), -1)[:, 0] for one in blocks])
    newest = np.maximum.accumulate(time_ns)
    new = np.concatenate(([True], time_ns[1:] > newest[:-1]))
    return time_ns[new], value[new]
