"""The calibration of a recording as one record, and its JSON file."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from midspan._version import __version__
from midspan.calibration.direction import Direction
from midspan.calibration.noise import NoiseCalibration
from midspan.calibration.scale import ScaleCalibration
from midspan.calibration.sensors.auxiliary import MEASURES, AuxiliaryCalibration
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.calibration.sensors.radar import RadarCalibration
from midspan.checks import path_of
from midspan.engine.axis import AxisFigures
from midspan.errors import DataError
from midspan.notebook import table
from midspan.notices import NOTICES, Notice, Severity, notice_trees, worst_first
from midspan.settings.fields import Form, Listed
from midspan.settings.kinds import KINDS, sensors_of
from midspan.settings.messages import explain
from midspan.settings.recording import Sensor
from midspan.settings.stored import sections
from midspan.settings.stored.auxiliary import StoredAuxiliary
from midspan.settings.stored.cameras import StoredAxis, StoredCamera
from midspan.settings.stored.radar import StoredRadar
from midspan.signals.lines import Line
from midspan.trees import TreeError, read_json
from midspan.writing import write_whole

CALIBRATION_FILE = "calibration.json"
SensorCalibration = CameraCalibration | RadarCalibration | DisplacementCalibration


def placed(sensors: Sequence[SensorCalibration]) -> dict[str, Any]:
    """The fields of `Calibration` that hold sensors in the order of KINDS."""
    first = {one.kind: one for one in reversed(sensors)}
    return first | {"others": tuple(one for one in sensors if one is not first[one.kind])}


@dataclass(frozen=True, slots=True)
class Calibration:
    """Everything `calibrate` learns about a recording's sensors.

    noise_std_m_s2: white noise of the acceleration per sample; motion_noise_s: what its noise density has besides, per
    mean square of the acceleration (m²/s⁴); bias_m_s2, bias_std_m_s2: the accelerometer's bias at the end of the window
    and its standard deviation, infinite where that is not known; bias_drift_m_s3: how fast it drifts. camera, infrared,
    radar, displacement: the first sensor of each kind; others: further ones, each with its name. accelerometer_scale:
    gain of the accelerometer relative to a displacement sensor, 1 where it cannot be estimated, with its standard
    deviation, which then is that of its sensitivity as given; it is in the scales' standard deviations. misfit: factor
    on the band's variance, as innovations that are not white show. slope: by which the accelerometer leans as it moves,
    so that gravity reaches it, radians a metre. sensor_axis: direction of the other sensors' axis among the
    accelerometer's, None where only one was recorded. auxiliary: what helps the sensors. across: the same along the
    second image axis, with camera.direction = "xy"; where that has no accelerometer, the noise is the motion's own
    acceleration. left_out: the second axis "x" or "y" where nothing could be estimated of it, else empty. usual: what
    is usual of the acceleration, None where the file does not tell it. lines: narrow ones of the acceleration that are
    no motion; noise and all else are those without them. diagnostics: what the estimates rest on, for the report; not
    stored in the file.
    """

    noise_std_m_s2: float
    bias_m_s2: float
    bias_std_m_s2: float = math.inf
    bias_drift_m_s3: float = 0.0
    motion_noise_s: float = 0.0
    camera: CameraCalibration | None = None
    infrared: CameraCalibration | None = None
    radar: RadarCalibration | None = None
    displacement: DisplacementCalibration | None = None
    warnings: tuple[Notice, ...] = ()
    across: "Calibration | None" = None
    left_out: str = ""
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    version: str = __version__
    others: tuple[SensorCalibration, ...] = ()
    accelerometer_scale: float = 1.0
    accelerometer_scale_std: float = 0.0
    misfit: float = 1.0
    slope: float = 0.0
    sensor_axis: Direction | None = None
    auxiliary: tuple[AuxiliaryCalibration, ...] = ()
    usual: AxisFigures | None = None
    lines: tuple[Line, ...] = ()
    diagnostics: "ScaleCalibration | NoiseCalibration | None" = field(default=None, compare=False, repr=False)

    def __repr__(self) -> str:
        return f"Calibration({'; '.join(f'{name} {value}' for name, value in self.summary())})"

    def _repr_html_(self) -> str:
        """What a notebook shows: the values with their standard deviations, and the warnings."""
        return table(f"calibration of {self.created}", self.summary(), self.warnings)

    def summary(self) -> list[tuple[str, str]]:
        """What was estimated of each sensor with its standard deviations, as text; a row a sensor."""
        rows = [(name, KINDS[kind].stored.summary(sensor)) for name, kind, sensor in self.sensors]
        gain_std = self.accelerometer_scale_std
        rows += [(one.kind, StoredAuxiliary.summary(one)) for one in self.auxiliary]
        gain = f", gain {self.accelerometer_scale:.5g} ± {gain_std:.2g}" if gain_std > 0.0 else ""
        return [*rows, ("accelerometer", f"noise {1e3 * self.noise_std_m_s2:.3g} mm/s² per sample{gain}")]

    @property
    def to_act_on(self) -> tuple[Notice, ...]:
        """Its warnings without those that nothing has to be done about, the worst first."""
        return tuple(one for one in worst_first(self.warnings) if one.severity is not Severity.NOTE)

    def gain_std(self, tolerance: float, *, given: bool) -> float:
        """Relative standard deviation of the accelerometer's gain: as calibrated, else its tolerance where given."""
        known = self.accelerometer_scale_std
        return known or tolerance if given else known

    @property
    def first_camera(self) -> CameraCalibration | None:
        """The camera whose zero counts and whose axes the columns belong to, of light or infrared."""
        return self.camera or self.infrared

    def of_kind(self, kind: str) -> tuple[SensorCalibration, ...]:
        """All sensors of one of KINDS."""
        first = getattr(self, kind)
        return (*(() if first is None else (first,)), *(one for one in self.others if one.kind == kind))

    @property
    def sensors(self) -> tuple[tuple[str, str, SensorCalibration], ...]:
        """Name, kind and values of all sensors, in the order camera, infrared, radar, displacement."""
        return sensors_of(self.of_kind)

    def helped_by(self, kind: str) -> AuxiliaryCalibration | None:
        """The values of a sensor that helps others; None where there is none of this kind."""
        return next((one for one in self.auxiliary if one.kind == kind), None)

    def with_even_clocks(self) -> "Calibration":
        """The same for readings that have the rates of their clocks taken out of the stamps."""

        def even(sensor: SensorCalibration) -> SensorCalibration:
            return replace(sensor, clock_rate=0.0) if isinstance(sensor, DisplacementCalibration) else sensor

        return replace(self, **placed([even(one) for _, _, one in self.sensors]))

    def of(self, name: str) -> SensorCalibration | None:
        """The values of the sensor of this name (its kind where it has none); None where there is no such sensor."""
        return next((one for known, _, one in self.sensors if known == name), None)

    def of_sensor(self, sensor: Sensor, companions: Sequence[Sensor] = ()) -> Any:
        """The values of a recording's sensor, None where there are none; companions: the others of the recording.

        They are those of its name, or where one of both has no name those of the only one of its kind.
        """
        named, own = self.of(sensor.name), self.of_kind(sensor.kind)
        if named is not None and named.kind == sensor.kind:
            return named
        alone = len(own) == 1 and sensor.kind not in (other.kind for other in companions)
        return own[0] if alone and (own[0].name is None or sensor.name == sensor.kind) else None

    @property
    def direction(self) -> str:
        """The camera's direction, "x", "y" or "xy"; empty without one."""
        if self.first_camera is None:
            return ""
        return self.first_camera.direction if self.across is None and not self.left_out else "xy"

    def of_axis(self, axis: str, where: str = CALIBRATION_FILE) -> "Calibration":
        """The part of the image axis "x" or "y" where both were calibrated, else itself.

        where: names the calibration in DataError, for an axis that moved too little or had no accelerometer.
        """
        main, second = self.first_camera, None if self.across is None else self.across.first_camera
        if self.direction != "xy" or main is None:
            return self
        if main.direction == axis:
            return replace(self, across=None, left_out="")
        if self.across is None or second is None or not second.fused:
            raise DataError(
                f"{where}: has no scale factor along {axis}: too little motion, or no accelerometer along this axis. "
                "Calibrate on another recording, or let the point calibrate itself."
            )
        return self.across

    def noise_density(self, rate_hz: float) -> float:
        """Two-sided density of the acceleration's noise, (m/s²)²/Hz, at the accelerometer's rate."""
        return self.noise_std_m_s2**2 / rate_hz

    def without_gain(self, gain: float, std: float) -> "Calibration":
        """The same in metres: scales were estimated from an accelerometer of this gain and relative deviation."""
        return replace(self, **placed([one.without_gain(gain, std) for _, _, one in self.sensors]))

    def to_dict(self) -> dict[str, Any]:
        """The contents of `calibration.json`: mm, px, s and m/s²; of a kind with several sensors a list."""
        axis = self.sensor_axis
        tree: dict[str, Any] = {
            "version": self.version,
            "created": self.created,
            "warnings": list(self.warnings),
            "notices": notice_trees(self.warnings),
            "accelerometer": {
                **sections.StoredAccelerometer.tree(self),
                **({} if axis is None else {"direction": list(axis.components), "direction_std": list(axis.std)}),
            },
        }
        for kind, row in KINDS.items():
            listed = [row.stored.tree(one) for one in self.of_kind(kind)]
            if listed and self.of_kind(kind)[0] is self.first_camera:
                listed[0] |= self._second_axis()
            if listed:
                tree[kind] = listed if len(listed) > 1 else listed[0]
        return tree | {one.kind: StoredAuxiliary.tree(one) for one in self.auxiliary}

    def _second_axis(self) -> dict[str, Any]:
        """What the first camera's section has besides where both image axes are measured, or one was left out."""
        first, other = self.first_camera, None if self.across is None else self.across.first_camera
        left_out = {"left_out": self.left_out} if self.left_out else {}
        if self.across is None or first is None or other is None:
            return left_out
        along = StoredAxis.axis_tree
        both = {first.direction: along(first, self), other.direction: along(other, self.across)}
        return left_out | {"direction": "xy", "axis": first.direction, "axes": both}

    def save(self, path: str | Path) -> Path:
        """Write `calibration.json`; a folder gets a file of that name."""
        path = path_of("path", path)
        path = path / CALIBRATION_FILE if path.is_dir() else path
        write_whole(path, (json.dumps(self.to_dict(), indent=2) + "\n").encode())
        return path


class StoredCalibration(sections.Stored):
    """The whole file; of each kind of sensor one section, or a list of several with a name each."""

    version: sections.Text = Field("", description="of midspan")
    created: sections.Text = Field("", description="when it was made, UTC")
    warnings: tuple[sections.Text, ...] = Field((), description="list of sentences")
    notices: Annotated[tuple[sections.StoredNotice, ...], Form("list")] = Field(
        (), description="the same with severity and code"
    )
    accelerometer: sections.StoredAccelerometer
    camera: Annotated[tuple[StoredCamera, ...], Listed] = ()
    infrared: Annotated[tuple[StoredCamera, ...], Listed] = ()
    radar: Annotated[tuple[StoredRadar, ...], Listed] = ()
    displacement: Annotated[tuple[sections.StoredDisplacement, ...], Listed] = ()
    velocity: StoredAuxiliary | None = None
    gyroscope: StoredAuxiliary | None = None
    inclinometer: StoredAuxiliary | None = None
    gravity: StoredAuxiliary | None = None

    @model_validator(mode="after")
    def _sensors_are_reported_apart(self) -> "StoredCalibration":
        cameras = (*self.camera, *self.infrared)
        sensors_of(lambda kind: getattr(self, kind))
        if len(cameras) > 1 and any(camera.direction == "xy" for camera in cameras):
            raise ValueError('must have direction = "x" or "y" in each camera where there are several')
        return self


def load_calibration(path: str | Path, *, axis: str = "") -> Calibration:
    """Read a `calibration.json` (or the folder that holds it).

    axis: the image axis "x" or "y" that is wanted of one with both; empty: all that is in it. Raises DataError naming
    file and key where it is missing, damaged or holds a value that cannot be, and for an axis that it does not have.
    """
    path = path_of("path", path)
    path = path / CALIBRATION_FILE if path.is_dir() else path
    try:
        tree = read_json(path)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}). `midspan calibrate` writes one.") from None
    except TreeError as error:
        raise DataError(f"{path}: {error}. Run `midspan calibrate` again.") from None
    found = calibration_from_dict(tree, str(path))
    return found.of_axis(axis, str(path)) if axis else found


def calibration_from_dict(tree: Any, where: str = CALIBRATION_FILE) -> Calibration:
    """The calibration that `Calibration.to_dict` describes; keys that only inform may be missing.

    where: names the tree in messages. Raises DataError for a value that cannot be.
    """
    tree = tree if isinstance(tree, dict) else {}
    try:
        stored = StoredCalibration.model_validate(tree)
    except ValidationError as error:
        text = explain(error.errors()[0], tree, StoredCalibration).removesuffix(" Add it.")
        raise DataError(f"{where}: {text} Run `midspan calibrate` again.") from None
    # Earlier versions wrote no codes.
    codes = {one.text: one.code for one in stored.notices if one.code in NOTICES}
    own, first = stored.accelerometer, (*stored.camera, *stored.infrared, None)[0]
    sensors = [part.record(kind) for kind in KINDS for part in getattr(stored, kind)]
    helping = tuple(part.record(kind) for kind in MEASURES if (part := getattr(stored, kind)) is not None)
    made: dict[str, Any] = {"created": stored.created, "version": stored.version}
    found = Calibration(
        **own.values(Calibration),
        **placed(sensors),
        **made,
        warnings=tuple(Notice(codes.get(text, "uncoded"), text) for text in stored.warnings),
        left_out="" if first is None else first.left_out,
        auxiliary=helping,
        sensor_axis=Direction(own.direction, own.direction_std) if own.direction else None,
    )
    main = found.first_camera
    if first is None or main is None or first.direction != "xy":
        return found
    camera, accelerometer = first.across(main)
    made |= {camera.kind: camera}
    across = Calibration(**accelerometer.values(Calibration), **made)
    return replace(found, across=across)
