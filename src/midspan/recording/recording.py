"""A recording: its settings and its files, opened when they are first needed."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

from midspan.errors import DataError, MidspanError
from midspan.recording.acceleration import PreparedAcceleration, prepare_acceleration, still
from midspan.records import TimeSeries
from midspan.settings.load import load_settings, settings_file
from midspan.settings.recording import RecordingSettings
from midspan.settings.sensors import ChannelSettings
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.select import SeriesRequest, read_series
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest, FrameSource


@contextmanager
def naming(recording: "Recording") -> Iterator[None]:
    """Put the recording's file before the message of any error raised inside that does not name it already."""
    try:
        yield
    except MidspanError as error:
        text = str(error)
        if str(recording.file) in text:
            raise
        raise type(error)(f"{recording.file}: {text}") from None


class Recording:
    """A folder with `recording.toml` and the files it names; see `open_recording`."""

    def __init__(self, file: Path, settings: RecordingSettings) -> None:
        self.file, self.settings = file, settings
        self._whole: Recording | None = None

    def __repr__(self) -> str:
        sensors = [name for name in ("accelerometer", "camera", "displacement", "reference") if self.has(name)]
        return f"Recording({str(self.file)!r}, {self.name!r}: {', '.join(sensors)})"

    @property
    def folder(self) -> Path:
        """The folder that paths in the settings are relative to."""
        return self.file.parent

    @property
    def name(self) -> str:
        """The recording's name, or its folder's."""
        return self.settings.name or self.folder.resolve().name

    def has(self, section: str) -> bool:
        """Whether the settings have a section of this name."""
        return getattr(self.settings, section) is not None

    def path(self, name: str, key: str) -> Path:
        """The file that a setting names; DataError where it is missing. Globs and folders are left to the reader."""
        path = self.folder / name
        if not path.exists() and not any(sign in name for sign in "*?["):
            raise DataError(
                f"{self.file}: {key} = {name!r}: no such file in the folder {str(self.folder)!r}. Paths are "
                f"relative to {self.file.name}."
            )
        return path

    @property
    def axis(self) -> str:
        """The image axis "x" or "y" of the main columns; empty without a camera."""
        return (*self.settings.axes, "")[0]

    @property
    def exposure_s(self) -> float | None:
        """The camera's exposure time, s; None where it is not told."""
        return None if self.settings.camera is None else self.settings.camera.exposure_s

    @cached_property
    def across(self) -> "Recording | None":
        """The same recording along the second image axis, with camera.direction = "xy"; None without one.

        Its frames are these; its acceleration is the column of that axis, or absent where the axis is tracked only.
        """
        if len(self.settings.axes) < 2:
            return None
        axis, accelerometer = self.settings.axes[1], self.settings.accelerometer
        column = accelerometer.value_x if axis == "x" else accelerometer.value_y
        assert self.settings.camera is not None
        sensor = accelerometer.model_copy(update={"value": column, "value_x": None, "value_y": None})
        camera = self.settings.camera.model_copy(update={"direction": axis})
        changed = {"accelerometer": sensor, "camera": camera, "displacement": None, "reference": None}
        view = Recording(self.file, self.settings.model_copy(update=changed))
        view._whole = self
        return view

    @property
    def fused(self) -> bool:
        """Whether this axis has an acceleration of its own; the second one of "xy" may be tracked only."""
        return self._whole is None or self.settings.accelerometer.value is not None

    @cached_property
    def acceleration(self) -> TimeSeries:
        """The accelerometer's channel, m/s², on its own clock."""
        return self._series("accelerometer", "acceleration")

    @cached_property
    def prepared(self) -> PreparedAcceleration:
        """The acceleration with missing samples bridged and marked; none (zero) along an axis that is tracked only."""
        if self._whole is not None and not self.fused:
            return still(self._whole.prepared)
        return prepare_acceleration(self.acceleration, f"accelerometer ({self.settings.accelerometer.file})")

    @cached_property
    def displacement(self) -> TimeSeries:
        """The channel of [displacement], m, on its own clock."""
        return self._series("displacement", "displacement")

    @cached_property
    def reference(self) -> TimeSeries:
        """The channel of [reference], m, on the accelerometer's clock."""
        return self._series("reference", "displacement")

    @cached_property
    def reference_across(self) -> TimeSeries | None:
        """The reference along the second image axis, m: the column displacement_x_mm or _y_mm of [reference]'s file.

        None where there is no second axis or no such column.
        """
        wanted = self.settings.reference
        if self.across is None or wanted is None:
            return None
        column = f"displacement_{self.across.axis}_mm"
        path = self.path(wanted.file, "reference.file")
        if column not in list_channels(path).names:
            return None
        request = SeriesRequest("displacement", time=wanted.time, value=column, unit=wanted.unit or "mm")
        return read_series(path, request)

    @cached_property
    def frames(self) -> FrameSource:
        """The camera's frames."""
        if self._whole is not None:
            return self._whole.frames
        camera = self.settings.camera
        if camera is None:
            raise DataError(f"{self.file}: has no [camera] section.")
        times = None if camera.times is None else self.path(camera.times, "camera.times")
        request = FrameRequest(times=times, rate_hz=camera.rate_hz, start_s=camera.start_s, every=camera.every)
        return open_frames(self.path(camera.file, "camera.file"), request)

    @property
    def own_files(self) -> set[Path]:
        """The files that make up the recording, resolved: results must not be written over them."""
        parts = (getattr(self.settings, name) for name in ("accelerometer", "camera", "displacement", "reference"))
        names = [name for part in parts if part for name in (part.file, getattr(part, "times", None)) if name]
        camera = self.settings.camera
        names += [camera.lens.file] if camera and camera.lens and camera.lens.file else []
        return {self.file.resolve(), *((self.folder / name).resolve() for name in names)}

    def _own_axis(self, channel: ChannelSettings) -> str | None:
        """The column of the main axis where columns are named by the image's axes."""
        return getattr(channel, f"value_{self.axis}", None)

    def _series(self, section: str, quantity: str) -> TimeSeries:
        channel: ChannelSettings = getattr(self.settings, section)
        sensitivity = getattr(channel, "sensitivity", 0.0) or None
        request = SeriesRequest(
            quantity=quantity,
            time=channel.time,
            value=channel.value or self._own_axis(channel),
            unit=channel.unit,
            sensitivity=sensitivity,
            rate_hz=channel.rate_hz,
            start_s=channel.start_s,
        )
        return read_series(self.path(channel.file, f"{section}.file"), request)


def open_recording(path: str | Path, **overrides: dict[str, Any]) -> Recording:
    """Open a recording: a folder that holds `recording.toml`, or that file.

    overrides: settings that win over the file, a dictionary a section, for example `camera={"roi": (10, 20, 64, 64)}`.
    Nothing but the settings is read yet. Raises UsageError for wrong settings, DataError where there is no recording.
    """
    return Recording(settings_file(path), load_settings(path, overrides))
