"""Live records as an ordinary recording folder: what a point is calibrated on and opened from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from midspan.radar.chirp import RadarInfo, profile_to_json
from midspan.records import NANOSECONDS, Arrival, Frame, RangeFrame, Readings
from midspan.settings.kinds import ACCELEROMETER, AUXILIARY, KINDS, LIVE
from midspan.settings.load import RECORDING_FILE
from midspan.settings.recording import RecordingSettings, Sensor
from midspan.sources.accelerometer.units import SI_UNITS
from midspan.writing import write_whole

# Profiles are written together, this many at a time.
FRAMES_AT_A_TIME = 64
READINGS = {"time": "time_ns", "value": "value"}
# Keys of a channel that are in its unit.
IN_UNIT = ("noise_std", "noise_density", "bias_std")


class Capture:
    """Writes the records of a point's streams into `folder`; `close` makes a recording of it.

    settings: of the point's recordings, in SI units, with the names of the files; radars: what is known of each radar.
    """

    def __init__(self, folder: Path, settings: RecordingSettings, radars: Mapping[str, RadarInfo]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.settings = folder, settings
        self._readings: dict[str, list[Readings]] = {}
        self._films: dict[str, _Film] = {}
        self._profiles: dict[str, _Profiles] = {}
        for name, kind, section in settings.streams:
            brings = LIVE[kind].brings
            if brings is Readings:
                self._readings[name] = []
            elif brings is Frame:
                self._films[name] = _Film(folder / section.file)
            else:
                self._profiles[name] = _Profiles(folder / section.file, radars[name])

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
        """How long all streams that the point cannot do without have recorded together, s."""
        streams = [one.stamps for one in self._pictures]
        streams += [
            [int(blocks[0].time_ns[0]), int(blocks[-1].time_ns[-1])] if blocks else []
            for name, blocks in self._readings.items()
            if name not in AUXILIARY
        ]
        if not all(streams):
            return 0.0
        return max((min(one[-1] for one in streams) - max(one[0] for one in streams)) / NANOSECONDS, 0.0)

    @property
    def frames(self) -> int | None:
        """How many frames the camera or radar with the fewest has brought; None without one."""
        return min((len(one.stamps) for one in self._pictures), default=None)

    @property
    def _pictures(self) -> list["_Film | _Profiles"]:
        return [*self._films.values(), *self._profiles.values()]

    def close(self) -> Path:
        """Finish the files and write the recording.toml; returns the folder."""
        files = {name: section.file for name, _, section in self.settings.streams}
        for name, blocks in self._readings.items():
            if sum(len(one.time_ns) for one in blocks) < 2:
                # Of one that only helps: there was nothing.
                ends = [self._readings[ACCELEROMETER][k].time_ns[k] for k in (0, -1)]
                blocks = [Readings(np.array(ends), np.full((2, 1), np.nan))]
            time_ns = np.concatenate([one.time_ns for one in blocks])
            value = np.concatenate([one.value.reshape(len(one.time_ns), -1)[:, 0] for one in blocks])
            new = np.diff(np.maximum.accumulate(time_ns), prepend=time_ns[0] - 1) > 0
            np.savez(self.folder / files[name], time_ns=time_ns[new], value=value[new])
        self.discard()
        write_whole(self.folder / RECORDING_FILE, _text(self.settings))
        return self.folder

    def discard(self) -> None:
        """Let the files go."""
        for one in self._pictures:
            one.close()


def is_captured_with(folder: Path, settings: RecordingSettings) -> bool:
    """Whether a captured recording has these settings."""
    try:
        return (folder / RECORDING_FILE).read_bytes() == _text(settings)
    except OSError:
        return False


def _text(settings: RecordingSettings) -> bytes:
    import tomli_w

    return tomli_w.dumps(settings.model_dump(mode="json", exclude_none=True, exclude_unset=True)).encode()


class _Film:
    """Frames of one size as a NumPy stack, and their stamps in a second file."""

    def __init__(self, file: Path) -> None:
        self._file, self.stamps = file, list[int]()
        self._open: BinaryIO | None = None
        self._shape: tuple[int, ...] = ()
        self._dtype: np.dtype[Any] = np.dtype(np.uint8)

    def add(self, frame: Frame) -> None:
        """Append a frame; one of another size, or whose stamp is not later, is left out."""
        if self._open is None:
            self._shape, self._dtype = frame.pixels.shape, frame.pixels.dtype
            self._open = self._file.open("wb")
            self._head()
        if frame.pixels.shape != self._shape or (self.stamps and frame.time_ns <= self.stamps[-1]):
            return
        self._open.write(np.ascontiguousarray(frame.pixels).data)
        self.stamps.append(frame.time_ns)

    def close(self) -> None:
        """Write how many frames there are, and their stamps."""
        if self._open is None:
            return
        self._open.seek(0)
        self._head()
        self._open.close()
        self._open = None
        np.savez(times_file(self._file), time_s=np.array(self.stamps, dtype=np.int64))

    def _head(self) -> None:
        """The header, which has room for any number of frames."""
        assert self._open is not None
        description = {"descr": self._dtype.str, "fortran_order": False, "shape": (len(self.stamps), *self._shape)}
        np.lib.format.write_array_header_1_0(self._open, description)


class _Profiles:
    """Range profiles of a radar as slow-time I/Q; channels with a hole are NaN."""

    def __init__(self, file: Path, info: RadarInfo) -> None:
        self._file, self._info, self.stamps = file, info, list[int]()
        self._open: Any = None
        self._waiting: list[NDArray[np.complex64]] = []

    def add(self, frame: RangeFrame) -> None:
        """Append a frame; one whose stamp is not later is left out."""
        if self.stamps and frame.time_ns <= self.stamps[-1]:
            return
        self.stamps.append(frame.time_ns)
        self._waiting.append(np.where(frame.valid[:, None], frame.phasors, np.complex64(np.nan)))
        if len(self._waiting) >= FRAMES_AT_A_TIME:
            self._write()

    def close(self) -> None:
        """Write what waits, and the stamps."""
        if not self.stamps:
            return
        self._write()
        self._open["time_ns"] = np.array(self.stamps, dtype=np.int64)
        self._open["range_m"] = self._info.range_m
        self._open.attrs["carrier_hz"] = self._info.carrier_hz
        if self._info.profile is not None:
            self._open.attrs["chirp"] = profile_to_json(self._info.profile)
        self._open.close()
        self._open, self.stamps = None, []

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
    own = {**READINGS, "unit": "m/s^2", "sensitivity": 0.0}
    # Stamps are UTC: a clock that is farther off than the range has to be set, and is no offset to live with.
    range_s = {"max_offset_s": settings.calibration.max_offset_s}
    changed: dict[str, Any] = {
        "accelerometer": settings.accelerometer.model_copy(update=own),
        "calibration": settings.calibration.model_copy(update=range_s),
    }
    for kind in KINDS:
        listed = [(sensor, _captured(sensor, factors)) for sensor in settings.sensors if sensor.kind == kind]
        changed[f"{kind}s"] = tuple(sensor.settings.model_copy(update=files) for sensor, files in listed)
    for kind, section in settings.auxiliary.items():
        changed[kind] = section.model_copy(update=_in_si(kind, section, factors[kind]))
    return settings.model_copy(update=changed)


def _captured(sensor: Sensor, factors: dict[str, float]) -> dict[str, Any]:
    """What a captured recording says of a sensor besides."""
    own: Any = sensor.settings
    name, brings = Path(own.file).name, KINDS[sensor.kind].brings
    if brings is Readings:
        return {**READINGS, **_in_si(sensor.kind, own, factors[sensor.name])}
    if brings is RangeFrame:
        return {"file": f"{name}.h5", "config": None}
    return {"file": f"{name}.npy", "times": times_file(Path(f"{name}.npy")).name}


def _in_si(kind: str, section: Any, factor: float) -> dict[str, Any]:
    """The keys of a channel with a unit, in the SI unit."""
    given = {key: getattr(section, key, None) for key in IN_UNIT}
    scaled = {key: factor * value for key, value in given.items() if value is not None}
    return {"time": READINGS["time"], "unit": SI_UNITS[LIVE[kind].quantity], **scaled}
