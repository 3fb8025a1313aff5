"""A recording: its settings and its files, opened when they are first needed."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from midspan.calibration.clock_jumps import LARGEST_S
from midspan.calibration.direction import Direction
from midspan.calibration.radar.clock_steps import ClockStep, lateness_ns, steps_text
from midspan.checks import path_of
from midspan.errors import DataError, MidspanError, UsageError
from midspan.notebook import table
from midspan.notices import Notice
from midspan.recording.streams.radar_clock import steps_of
from midspan.records import NANOSECONDS, Nanoseconds, RangeFrame, Readings, TimeSeries
from midspan.settings.camera import InfraredSettings
from midspan.settings.kinds import AUXILIARY, CAMERAS, KINDS
from midspan.settings.load import load_settings, settings_file
from midspan.settings.recording import RecordingSettings, Sensor
from midspan.settings.sensors import AccelerometerSettings, RotationSettings, SeriesSettings
from midspan.signals.acceleration import PreparedAcceleration, prepare_acceleration, still, with_cross
from midspan.signals.lines import Line, without_lines
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.select import SeriesRequest, read_series
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest
from midspan.sources.radar.formats import open_radar
from midspan.sources.radar.radar_source import RadarRequest, RadarSource, Restamped
from midspan.sources.thermal.formats import open_thermal
from midspan.sources.thermal.temperatures import ThermalRequest
from midspan.sources.zipped import is_inside
from midspan.vision.frame_source import FrameSource

# Share of the shortest stream by which its clock may be off where nothing else is said.
MAX_OFFSET_SHARE = 0.2
# Fewer targets show no six degrees of freedom.
MIN_POSED = 3


@contextmanager
def naming(recording: "Recording") -> Iterator[None]:
    """Put the recording's file before the message of any error raised inside that does not name it already."""
    try:
        yield
    except MidspanError as error:
        text = str(error)
        if str(recording.file) not in text:
            error.args = (f"{recording.file}: {text}",)
        raise


class Recording:
    """A folder with `recording.toml` and the files it names; see `open_recording`."""

    def __init__(self, file: Path, settings: RecordingSettings) -> None:
        self.file, self.settings = file, settings
        self._whole: Recording | None = None
        # Of a view: what it is a view of, and its sensor.
        self._alongside: Recording | None = None
        self._own: Sensor | None = None
        # Of the accelerometer with several axes: the one that the acceleration is along, once it is calibrated.
        self._axis: Direction | None = None
        # Narrow lines that are taken out of the acceleration.
        self.lines: tuple[Line, ...] = ()
        # Whether a camera whose targets show all six degrees of freedom is calibrated by its poses.
        self.posed = False
        # A camera that is dark before this instant is used from it on.
        self.sees_from_ns: int | None = None
        # About so much is to be added to the stamps of a view's frames for them to be on the accelerometer's clock, s.
        self.late_s = 0.0

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {file}" for name, file in self.streams)
        return f"Recording({str(self.file)!r}, {self.name!r}: {shown})"

    def _repr_html_(self) -> str:
        """What a notebook shows: the file of each stream."""
        return table(f"{self.name} ({self.file})", self.streams)

    @property
    def streams(self) -> list[tuple[str, str]]:
        """Name and file of each stream, the accelerometer's first and the reference's last."""
        last = self.settings.reference
        named = [*self.settings.streams, *([] if last is None else [("reference", "", last)])]
        return [(name, section.file) for name, _, section in named]

    @property
    def folder(self) -> Path:
        """The folder that paths in the settings are relative to."""
        return self.file.parent

    @property
    def name(self) -> str:
        """The recording's name, or its folder's; of two files theirs."""
        whole = self.folder.resolve().name if self.file.suffix == ".toml" else self.file.name
        return self.settings.name or whole

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """All sensors besides the accelerometer, in the order camera, infrared, radar, displacement."""
        return self.settings.sensors

    def has(self, section: str) -> bool:
        """Whether the settings have a section of this name."""
        return getattr(self.settings, section) is not None

    def path(self, name: str, key: str) -> Path:
        """The file that a setting names; DataError where it is missing. Globs and folders are left to the reader."""
        path = self.folder / name
        try:
            found = path.exists() or is_inside(path)
        except OSError as error:
            raise DataError(f"{self.file}: {key} = {name!r}: cannot be read ({error.strerror}).") from None
        if not found and not any(sign in name for sign in "*?["):
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
        """The camera's exposure time, s; None where it is not stated."""
        camera = self.settings.first_camera
        return None if camera is None else camera.exposure_s

    @property
    def own(self) -> Sensor:
        """The sensor of this view, or the first one of all."""
        return self._own or self.sensors[0]

    @property
    def sensor(self) -> str:
        """The name of this view's sensor."""
        return self.own.name

    @property
    def kind(self) -> str:
        """The kind of this view's sensor, one of KINDS."""
        return self.own.kind

    @property
    def companions(self) -> tuple[Sensor, ...]:
        """The other sensors of the recording that this is a view of."""
        return tuple(sensor for sensor in self.root.sensors if sensor.name != self.sensor)

    @property
    def gives_zero(self) -> bool:
        """Whether the zero of this view's sensor is that of the displacement: the first one's."""
        return self.root.sensors[0].name == self.sensor

    @property
    def root(self) -> "Recording":
        """The recording that this is a view of."""
        above = self._alongside or self._whole
        return self if above is None else above.root

    @cached_property
    def views(self) -> "tuple[Recording, ...]":
        """The recording as each of its sensors sees it, alone, the one whose zero counts first.

        A thermal camera stands in its view as if it were the camera.
        """
        if self._own is not None or (len(self.sensors) == 1 and not self.settings.infrareds):
            return (self,)
        nothing: dict[str, Any] = {"reference": None, **{f"{kind}s": () for kind in KINDS}}
        found = []
        for sensor in self.sensors:
            place = "cameras" if sensor.kind in CAMERAS else f"{sensor.kind}s"
            found.append(self._with(nothing | {place: (sensor.settings,)}, _alongside=self, _own=sensor))
        return tuple(found)

    def _with(self, changed: dict[str, Any], **marks: Any) -> "Recording":
        """The recording with other settings, and what it is a view of."""
        view = Recording(self.file, self.settings.model_copy(update=changed))
        vars(view).update({"lines": self.lines, "posed": self.posed} | marks)
        return view

    def seeing(self, first_ns: int, last_ns: int, from_ns: int) -> "Recording":
        """The same recording calibrated from `first_ns` to `last_ns`, its camera's frames used from `from_ns` on."""
        span = (first_ns / NANOSECONDS, last_ns / NANOSECONDS)
        window = self.settings.calibration.model_copy(update={"window_s": span})
        marks: dict[str, Any] = {"sees_from_ns": from_ns, "late_s": self.late_s}
        return self._with({"calibration": window}, _alongside=self, _own=self.own, **marks)

    def later(self, offset_s: float) -> "Recording":
        """The same view where its frames' clock offset is about `offset_s`, beyond what is searched; else itself."""
        if abs(offset_s - self.late_s) <= self.max_offset_s:
            return self
        marks: dict[str, Any] = {"sees_from_ns": self.sees_from_ns, "late_s": offset_s, "frames": self.frames}
        return self._with({}, _alongside=self, _own=self.own, **marks)

    @property
    def late_ns(self) -> int:
        """About so much is to be added to the stamps of a view's frames for them to be on the accelerometer's clock."""
        return round(self.late_s * NANOSECONDS)

    @property
    def clocks_open(self) -> bool:
        """Whether nothing is said of how far the clocks may be apart."""
        return "max_offset_s" not in self.settings.calibration.model_fields_set

    @property
    def cameras(self) -> "tuple[Recording, ...]":
        """The recording as each of its cameras sees it, the one whose zero counts first."""
        return tuple(view for view in self.views if view.kind in CAMERAS) if self.sensors else ()

    @cached_property
    def across(self) -> "Recording | None":
        """The same recording along the second image axis, with camera.direction = "xy"; None without one.

        Its frames are these; its acceleration is the column of that axis, or absent where the axis is tracked only.
        """
        if len(self.settings.axes) < 2 or self.settings.accelerometer is None:
            return None
        if self.views[0] is not self:
            return self.views[0].across
        axis, accelerometer = self.settings.axes[1], self.accelerometer
        assert self.settings.camera is not None
        sensor = accelerometer.of_column(getattr(accelerometer, f"value_{axis}"))
        camera = self.settings.camera.model_copy(update={"direction": axis})
        changed = {"accelerometer": sensor, "cameras": (camera,), "reference": None}
        # Lines were found along the main axis alone.
        return self._with(changed, _whole=self, _own=self.own, late_s=self.late_s, lines=())

    @property
    def fused(self) -> bool:
        """Whether this axis has an acceleration of its own; the second one of "xy" may be tracked only."""
        return self._whole is None or self.accelerometer.value is not None

    @property
    def accelerometer(self) -> AccelerometerSettings:
        """The section [accelerometer]; UsageError where there is none: only `track` and `inspect` do without."""
        if self.settings.accelerometer is None:
            raise UsageError(
                f"{self.file}: has no [accelerometer], which calibration and estimation need. Add the section, or "
                "follow the camera alone with `midspan track`."
            )
        return self.settings.accelerometer

    def along(self, axis: Direction | None) -> "Recording":
        """The same with the acceleration along a calibrated axis; UsageError where its columns are others."""
        named, wanted = self.accelerometer.cross_values, 0 if axis is None else len(axis.components)
        if len(named) != wanted:
            raise UsageError(
                f"{self.file}: accelerometer.cross_values: names {len(named)} columns, and the calibration was made "
                f"with {wanted}. Name the same ones, or calibrate again."
            )
        return self if axis is None else self._with({}, _axis=axis)

    @cached_property
    def acceleration(self) -> TimeSeries:
        """The accelerometer's channel, m/s², on its own clock."""
        if self._alongside is not None:
            return self._alongside.acceleration
        own = self.accelerometer.of_column(self.settings.acceleration_column)
        main = self._series("accelerometer", own, "acceleration")
        main = replace(main, value=without_lines(main.time_ns, main.value, self.lines))
        if self._axis is None:
            return main
        every = self._with_cross(main)
        return replace(main, value=np.where(every.missing, np.nan, every.along(self._axis.components).value_m_s2))

    @cached_property
    def accelerometer_axes(self) -> dict[str, TimeSeries]:
        """The acceleration along each axis x, y, z of the camera whose column is named, m/s², at common times."""
        own = self.root.accelerometer
        sections = {axis: own.of_column(own.column(axis)) for axis in own.named_axes}
        series = {axis: self._series("accelerometer", one, "acceleration") for axis, one in sections.items()}
        if len({one.time_ns.tobytes() for one in series.values()}) > 1:
            raise DataError(
                f"{own.file}: the columns along {', '.join(series)} must have the same times. Export them in one table."
            )
        return series

    @cached_property
    def prepared(self) -> PreparedAcceleration:
        """The acceleration with missing samples bridged and marked; none (zero) along an axis that is tracked only."""
        if self._whole is not None and not self.fused:
            return still(self._whole.prepared)
        if self._alongside is not None:
            return self._alongside.prepared
        if self._axis is None and self.accelerometer.cross_values:
            return self._with_cross(self.acceleration).of_lines(self.lines)
        return prepare_acceleration(self.acceleration, f"accelerometer ({self.accelerometer.file})").of_lines(
            self.lines
        )

    def without_lines(self, lines: tuple[Line, ...]) -> "Recording":
        """The same without narrow lines of the acceleration that are no motion; itself where these are out of it."""
        return self if lines == self.lines else self._with({}, lines=lines)

    def by_pose(self) -> "Recording":
        """The same with its cameras calibrated by their poses where these are seen, for an estimate of this record."""
        camera = self.settings.first_camera
        return self if camera is None or len(camera.target) < MIN_POSED else self._with({}, posed=True)

    def _with_cross(self, main: TimeSeries) -> PreparedAcceleration:
        """The main axis and the others, each bridged as its own."""
        own, where = self.accelerometer, f"accelerometer ({self.accelerometer.file}"
        sections = [own.model_copy(update={"value": name}) for name in own.cross_values]
        cross = [self._series("accelerometer", one, "acceleration") for one in sections]
        if any(not np.array_equal(one.time_ns, main.time_ns) for one in cross):
            raise DataError(f"{where}): the columns of cross_values have other times than {own.value!r}.")
        names = zip((main, *cross), (own.value, *own.cross_values), strict=True)
        first, *others = (prepare_acceleration(one, f"{where}, {name})") for one, name in names)
        return with_cross(first, others)

    @cached_property
    def displacement(self) -> TimeSeries:
        """The channel of [displacement], m, on its own clock."""
        section, key = self._section("displacement")
        return self._series(key, section, "displacement")

    @cached_property
    def auxiliary(self) -> dict[str, TimeSeries]:
        """What helps the sensors, by its kind; of a rotation that which moves the image along its main axis."""
        root = self.root
        return root.auxiliary if root is not self else {kind: self.helping(kind) for kind in self.settings.auxiliary}

    def helping(self, kind: str, axis: str = "") -> TimeSeries:
        """The channel of one of AUXILIARY, SI, which may hold no number: others do without it.

        axis: of the image that its rotation moves, left out: the main one. DataError where it has no such channel.
        """
        section, axis = self.settings.auxiliary.get(kind), axis or self.axis
        if not isinstance(section, RotationSettings):
            return self._series(kind, section, AUXILIARY[kind].quantity, optional=True)
        if (column := section.about(axis)) is None:
            raise DataError(f"{self.file}: {kind}: has no column of the rotation that moves the image along {axis}.")
        return self._series(kind, section, AUXILIARY[kind].quantity, column, optional=True)

    @property
    def max_offset_s(self) -> float:
        """The largest clock offset that a camera's or radar's calibration looks for, s.

        As set; where it is not set no more than a fifth of the shortest stream, of which both ends are left out by it.
        """
        wanted = self.settings.calibration
        if not self.clocks_open:
            return wanted.max_offset_s
        streams = [self.prepared.time_ns, *self.frame_times]
        shortest = min((int(times[-1] - times[0]) for times in streams if len(times)), default=0)
        return min(wanted.max_offset_s, MAX_OFFSET_SHARE * shortest / NANOSECONDS)

    @property
    def frame_times(self) -> tuple[Nanoseconds, ...]:
        """Stamps (n,) of the frames of each camera and radar, ns on its own clock, where that is not far off."""
        cameras = [view.frames.times_ns() + view.late_ns for view in self.cameras]
        return (*cameras, *(view.radar.times_ns() for view in self.views if KINDS[view.kind].brings is RangeFrame))

    @property
    def channel_warnings(self) -> tuple[Notice, ...]:
        """What is wrong with the acceleration and with the file of each [displacement], as they were read."""
        reported = list(self.prepared.warnings)
        for view in self.views:
            if KINDS[view.kind].brings is Readings:
                where = f"{view.sensor} ({view.own.settings.file})"
                reported += [Notice("file-damaged", f"{where}: {line}.") for line in view.displacement.damage]
                reported += [one.worded(f"{where}: {one}.") for one in view.displacement.notices]
        for kind, series in self.auxiliary.items():
            where = f"{kind} ({self.settings.auxiliary[kind].file})"
            reported += [Notice("file-damaged", f"{where}: {line}.") for line in series.damage]
            reported += [one.worded(f"{where}: {one}.") for one in series.notices]
        return tuple(reported)

    @cached_property
    def reference(self) -> TimeSeries:
        """The channel of [reference], m, on the accelerometer's clock."""
        return self._series("reference", self.settings.reference, "displacement")

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
        camera, key = self._section(*CAMERAS)
        times = None if camera.times is None else self.path(camera.times, f"{key}.times")
        request = FrameRequest(times=times, rate_hz=camera.rate_hz, start_s=camera.start_s, every=camera.every)
        path = self.path(camera.file, f"{key}.file")
        if isinstance(camera, InfraredSettings):
            return open_thermal(
                path, ThermalRequest(request, camera.kelvin_per_count, camera.zero_k, camera.emissivity)
            )
        return open_frames(path, request)

    @cached_property
    def radar(self) -> RadarSource:
        """The radar's frames, stamped by one clock where the file's was set and the motion tells it."""
        if not self.radar_steps:
            return self.radar_file
        time_ns = self.radar_file.times_ns()
        return Restamped(self.radar_file, time_ns + lateness_ns(self.radar_steps, len(time_ns)))

    @property
    def radar_notices(self) -> tuple[Notice, ...]:
        """What there is to report of the radar's clock."""
        return steps_text(self.radar_steps, self.radar_file.times_ns(), self.sensor)

    @cached_property
    def radar_steps(self) -> tuple[ClockStep, ...]:
        """Steps of the radar's clock; none for methods as printed."""
        section = self.settings.radar
        if section is None or self.settings.accelerometer is None or self.settings.fusion.literal:
            return ()
        reach_s = self.settings.calibration.max_offset_s + LARGEST_S
        return steps_of(self.radar_file, self.prepared, section.target_range_m, reach_s)

    @cached_property
    def radar_file(self) -> RadarSource:
        """The radar's frames as the file has them."""
        radar, key = self._section("radar")
        request = RadarRequest(
            config=None if radar.config is None else self.path(radar.config, f"{key}.config"),
            iq_order=radar.iq_order,
            start_s=radar.start_s,
            rate_hz=radar.rate_hz,
            carrier_hz=radar.carrier_hz,
        )
        return open_radar(self.path(radar.file, f"{key}.file"), request)

    def _section(self, *kinds: str) -> tuple[Any, str]:
        """The section of this view's sensor, or of the first one of these kinds, and how messages call it."""
        own = self._own or next((sensor for sensor in self.sensors if sensor.kind in kinds), None)
        if own is None:
            raise DataError(f"{self.file}: has no [{kinds[0]}] section.")
        listed = self.root.settings.of_kind(own.kind)
        return own.settings, own.kind if len(listed) < 2 else f"{own.kind}[{1 + listed.index(own.settings)}]"

    @property
    def own_files(self) -> set[Path]:
        """The files that make up the recording, resolved: results must not be written over them."""
        own = (section for _, _, section in self.settings.streams)
        parts: list[Any] = [self.settings.reference, *own]
        lenses = [getattr(part, "lens", None) for part in parts]
        keys = ("file", "times", "config")
        names = [name for part in (*parts, *lenses) for key in keys if (name := getattr(part, key, None))]
        return {self.file.resolve(), *((self.folder / name).resolve() for name in names)}

    def _series(
        self,
        section: str,
        channel: SeriesSettings | None,
        quantity: str,
        column: str | None = None,
        *,
        optional: bool = False,
    ) -> TimeSeries:
        if channel is None:
            raise DataError(f"{self.file}: has no [{section}] section.")
        request = SeriesRequest(
            quantity=quantity,
            time=channel.time,
            value=column or getattr(channel, "value", None),
            unit=getattr(channel, "unit", None),
            sensitivity=getattr(channel, "sensitivity", 0.0) or None,
            rate_hz=channel.rate_hz,
            start_s=channel.start_s,
            optional=optional,
        )
        return read_series(self.path(channel.file, f"{section}.file"), request)


def open_recording(path: str | Path, **overrides: dict[str, Any]) -> Recording:
    """Open a recording: a folder that holds `recording.toml`, or that file.

    overrides: settings that win over the file, a dictionary a section, for example `camera={"roi": (10, 20, 64, 64)}`.
    Nothing but the settings is read yet. Raises UsageError for wrong settings, DataError where there is no recording.
    """
    return Recording(settings_file(path), load_settings(path, overrides))


def opened(recording: Recording | str | Path) -> Recording:
    """A recording, opened where it is given by its path."""
    if isinstance(recording, Recording):
        return recording
    return open_recording(path_of("recording", recording))


def open_with_cameras(path: str | Path, changed: dict[str, Any], **overrides: dict[str, Any]) -> Recording:
    """The same with settings (key → value) that win over the file in every camera section that it has."""
    recording = open_recording(path, **overrides)
    if not changed:
        return recording
    sections = [section for section in CAMERAS if recording.has(section)]
    return open_recording(path, **overrides, **{section: dict(changed) for section in sections})
