"""The whole tree of `recording.toml`: its sensors, the calibration and the fusion."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field, SerializationInfo, model_serializer, model_validator

from midspan.calibration.camera.view import PrintedSteps
from midspan.checks import RATE_HZ
from midspan.fusion.methods import MAX_TAPS, METHODS, MIN_HALF_WINDOW, MIN_TAPS, SPLINE_FRAMES, no_literal_form
from midspan.settings.camera import CameraSettings, InfraredSettings
from midspan.settings.fields import Form, IsNumber, Listed, Section, Time, known, limited, second_is_larger
from midspan.settings.kinds import ACCELEROMETER, AUXILIARY, KINDS, sensors_of
from midspan.settings.sensors import (
    AccelerometerSettings,
    DisplacementSettings,
    GyroscopeSettings,
    InclinometerSettings,
    RadarSettings,
    ReferenceSettings,
    RotationSettings,
    SeriesSettings,
    VelocitySettings,
    turning_axis,
)

if TYPE_CHECKING:
    from midspan.fusion.streams import KalmanSettings, MethodSettings

Frequency = Annotated[float, IsNumber, limited(0.0, RATE_HZ.high, "Hz")]


def _is_a_transition(value: tuple[float, float]) -> tuple[float, float]:
    """Two frequencies above 0 in rising order."""
    if not 0.0 < value[0] < value[1]:
        raise ValueError("must be two frequencies above 0 Hz, the second larger")
    return value


def _is_a_length(value: int) -> int:
    """A number of taps that a filter of whole delay has."""
    if not (value % 2 and MIN_TAPS <= value <= MAX_TAPS):
        raise ValueError(f"must be an odd number from {MIN_TAPS} to {MAX_TAPS}")
    return value


Taps = Annotated[int, IsNumber, AfterValidator(_is_a_length), Form(f"odd, {MIN_TAPS} … {MAX_TAPS}")]


class CalibrationSettings(Section):
    """How scale factor and clock offset are found."""

    window_s: Annotated[tuple[Time, Time] | None, AfterValidator(second_is_larger), Form("2 numbers, rising, s")] = (
        Field(
            None,
            description="start and end on the accelerometer's clock; longer is more certain; default: first minute, "
            "for [displacement] half an hour",
        )
    )
    band_hz: Annotated[
        tuple[Frequency, Frequency] | None, AfterValidator(second_is_larger), Form("2 numbers, rising, Hz")
    ] = Field(
        None,
        description="frequency band that determines the scale; narrower is less certain; default: all, with literal "
        "the papers'",
    )
    literal: bool = Field(
        False, strict=True, description="scale factor and clock offset of a camera by the printed steps"
    )
    spline: bool = Field(
        True,
        strict=True,
        description="with literal: the correlation's peak is interpolated; false: offsets are whole frame intervals",
    )
    max_offset_s: Annotated[float, IsNumber, Field(ge=0, le=3600)] = Field(
        0.5,
        description="largest clock offset to search; less excludes ambiguities, more takes longer",
    )

    def printed(self, camera: CameraSettings | None) -> PrintedSteps | None:
        """How a camera is calibrated as printed, None: by likelihood; with `template` as in that tracker's paper."""
        if not self.literal:
            return None
        template = camera is not None and camera.tracker == "template"
        return PrintedSteps(self.band_hz, self.spline, sampled_first=template)


class FusionSettings(Section):
    """How acceleration and displacement become one."""

    method: Annotated[str, known(METHODS, "method")] = Field(
        "smoother", description="fusion method; see `midspan methods`"
    )
    lag_s: Annotated[float, IsNumber, limited(1e-6, 3600.0, "s")] = Field(
        0.5, description="delay of `lag`; longer approaches the smoother's error"
    )
    literal: bool = Field(
        False,
        strict=True,
        description="method as printed in its paper, without outlier handling; radar and tracker predictions too",
    )
    switching: Literal["variance", "matches"] = Field(
        "variance", description="two cameras: weighted by variance, or only the camera with more matches"
    )
    forgetting: Annotated[float, IsNumber, Field(gt=0, lt=1)] = Field(
        0.95, description="`adaptive-kalman`: forgetting factor; nearer to 1 adapts more slowly and steadily"
    )
    input_rule: Literal["held", "mean"] = Field(
        "held",
        description="`adaptive-kalman`, literal: acceleration between two samples: the first one (equation 7) or "
        "their mean",
    )
    first_frames: Annotated[int, IsNumber, Field(ge=1, le=1_000_000)] = Field(
        10, description="`adaptive-kalman`, literal: frames before R is adapted; more gives a smoother start"
    )
    input_noise_m_s2: Annotated[float, IsNumber, limited(1e-12, 1e6, "m/s²")] | None = Field(
        None,
        description="`adaptive-kalman`, literal: square root of Q; too small diverges, too large makes R negative; "
        "default: calibrated",
    )
    start_noise_mm: Annotated[float, IsNumber, limited(1e-9, 1e6, "mm")] | None = Field(
        None,
        description="`adaptive-kalman`, literal: square root of the first R; too small diverges; default: from "
        "calibration and speed",
    )
    start_velocity_mm_s: Annotated[float, IsNumber, limited(0.0, 1e9, "mm/s")] | None = Field(
        None,
        description="`adaptive-kalman`, literal: σ of the initial velocity; default: three times the rms speed",
    )
    half_window: Annotated[int, IsNumber, Field(ge=MIN_HALF_WINDOW, le=1_000_000)] | None = Field(
        None, description="`fir`: half length in samples; more increases the delay; default: 0.5 s, or by cut_off_hz"
    )
    cut_off_hz: Annotated[float, IsNumber, limited(1e-6, RATE_HZ.high, "Hz")] | None = Field(
        None,
        description="`fir`: frequency at which acceleration contributes the share `accuracy`; lower increases the "
        "delay; default: 1.5 / half_window in s",
    )
    accuracy: Annotated[float, IsNumber, Field(gt=0, lt=1)] = Field(
        0.97, description="`fir`: acceleration's share of the amplitude at cut_off_hz"
    )
    transition_hz: Annotated[
        tuple[Frequency, Frequency], AfterValidator(_is_a_transition), Form("2 numbers, rising, Hz")
    ] = Field(
        (0.5, 1.0),
        description="`two-stage-fir`: transition band: displacement alone below it, acceleration alone above it; "
        "wider shortens the delay",
    )
    taps: Taps | None = Field(
        None,
        description="`two-stage-fir`: length of the complementary filters; fewer shortens the delay, leaks more; "
        "default: ripple 0.001",
    )
    anti_alias_taps: Taps | None = Field(
        None,
        description="`two-stage-fir`: length of the anti-aliasing filter; fewer shortens the delay, leaks more; "
        "default: ripple 0.001",
    )
    spline_frames: Annotated[int, IsNumber, Field(ge=0, le=SPLINE_FRAMES)] = Field(
        SPLINE_FRAMES,
        description="`fir`, `two-stage-fir`: later displacements that the spline needs; fewer shortens the delay",
    )

    @model_validator(mode="after")
    def _is_whole(self) -> "FusionSettings":
        if self.literal and not METHODS[self.method].literal:
            raise ValueError(no_literal_form(self.method))
        return self

    def of_method(self, kalman: "KalmanSettings | None" = None) -> "MethodSettings":
        """What a method is run with; kalman: what is known of the axis, the usual where it is left out."""
        from midspan.fusion.streams import KalmanSettings, MethodSettings

        own: dict[str, Any] = {one.name: getattr(self, one.name, None) for one in fields(MethodSettings)}
        own["start_noise_m"] = None if self.start_noise_mm is None else 1e-3 * self.start_noise_mm
        own["start_velocity_m_s"] = None if self.start_velocity_mm_s is None else 1e-3 * self.start_velocity_mm_s
        own["kalman"] = kalman or KalmanSettings()
        return MethodSettings(**own)


class SiteSettings(Section):
    """Where the structure stands: kept with the result; only the published rule of two cameras uses it."""

    latitude_deg: Annotated[float, IsNumber, Field(ge=-90, le=90)] = Field(description="north positive")
    longitude_deg: Annotated[float, IsNumber, Field(ge=-180, le=180)] = Field(description="east positive")


SensorSettings = CameraSettings | RadarSettings | DisplacementSettings


@dataclass(frozen=True, slots=True)
class Sensor:
    """One sensor of a recording: its name (its kind where it has none), its kind of KINDS and its section."""

    name: str
    kind: str
    settings: SensorSettings


class RecordingSettings(Section):
    """The whole of `recording.toml`; of each kind of sensor there may be several."""

    name: str = Field("", description="name in reports; default: the folder's name")
    accelerometer: AccelerometerSettings | None = None
    cameras: Annotated[tuple[CameraSettings, ...], Listed] = Field((), alias="camera")
    infrareds: Annotated[tuple[InfraredSettings, ...], Listed] = Field((), alias="infrared")
    radars: Annotated[tuple[RadarSettings, ...], Listed] = Field((), alias="radar")
    displacements: Annotated[tuple[DisplacementSettings, ...], Listed] = Field((), alias="displacement")
    velocity: VelocitySettings | None = None
    gyroscope: GyroscopeSettings | None = None
    inclinometer: InclinometerSettings | None = None
    calibration: CalibrationSettings = Field(default_factory=lambda: CalibrationSettings.model_validate({}))
    fusion: FusionSettings = Field(default_factory=lambda: FusionSettings.model_validate({}))
    reference: ReferenceSettings | None = None
    site: SiteSettings | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> "RecordingSettings":
        own, camera = self.accelerometer, self.first_camera
        both = camera is not None and camera.direction == "xy"
        if own is None and camera is None:
            raise ValueError(
                "has no [accelerometer]. Add the section; only [camera] and [infrared] can do without it, for "
                "`midspan track`"
            )
        if not any(self.of_kind(kind) for kind in KINDS):
            raise ValueError(
                "has [accelerometer] only. Add the section of a sensor that measures displacement: [camera], "
                "[infrared], [radar] or [displacement]"
            )
        if own is not None and both and not (own.value_x or own.value_y):
            raise ValueError(
                'must name accelerometer.value_x, accelerometer.value_y or both with camera.direction = "xy": the '
                "columns along the image's axes"
            )
        if own is not None and own.named_axes:
            self._check_axis(own)
        if own is not None and own.cross_values and (self.fusion.literal or self.calibration.band_hz is not None):
            key = "fusion.literal" if self.fusion.literal else "calibration.band_hz"
            raise ValueError(f"must not have accelerometer.cross_values with {key}: remove one of them")
        cameras = (*self.cameras, *self.infrareds)
        if len(cameras) > 1 and "xy" in [one.direction for one in cameras]:
            raise ValueError(
                'must have direction = "x" or "y" in each [camera] and [infrared] where there are several; "xy" is for '
                "one of them alone"
            )
        self._auxiliary_fits()
        sensors_of(self.of_kind)
        for kind in KINDS if self.fusion.literal else ():
            if len(listed := self.of_kind(kind)) > 1:
                raise ValueError(
                    f"[[{kind}]] must be one section with fusion.literal; received {len(listed)}. A printed method "
                    f"takes one sensor of each kind: keep one [{kind}], or remove fusion.literal"
                )
        if self.fusion.literal and self.radars and len(self.sensors) > 1:
            raise ValueError(
                "fusion.literal = true with [radar]: the printed radar takes no other sensor. Remove [camera], "
                "[infrared] and [displacement], or fusion.literal"
            )
        return self

    def _auxiliary_fits(self) -> None:
        """ValueError where a sensor that helps others cannot."""
        for kind, section in self.auxiliary.items():
            if self.fusion.literal:
                raise ValueError(f"must not have [{kind}] with fusion.literal: remove one of them")
            if not isinstance(section, RotationSettings):
                continue
            if self.first_camera is None:
                raise ValueError(f"must have [camera] or [infrared] with [{kind}]: it measures the camera's tilt")
            if not section.about(self.axes[0]):
                about = turning_axis(self.axes[0])
                raise ValueError(
                    f"must name {kind}.value_{about} with camera.direction = {self.axes[0]!r}: a rotation about the "
                    f"image's {about} axis moves the image along {self.axes[0]}"
                )

    def _check_axis(self, own: AccelerometerSettings) -> None:
        """ValueError where the columns along the axes do not fit what the camera sees."""
        camera, names = self.first_camera, ", ".join(f"accelerometer.value_{axis}" for axis in own.named_axes)
        if camera is None:
            if not own.axis and len(own.named_axes) > 1:
                raise ValueError(f"must have accelerometer.axis, the axis of the motion, with {names} and no camera")
            return
        seen = camera.direction
        if own.axis and own.axis not in seen:
            remedy = f'camera.direction = "{own.axis}"' if own.axis != "z" else "another sensor for motion along it"
            raise ValueError(
                f'accelerometer.axis = "{own.axis}" must be an axis of camera.direction = "{seen}", as the camera '
                f"sees no motion along {own.axis}. Remove axis, or use {remedy}"
            )
        if seen not in ("xy", *own.named_axes):
            raise ValueError(
                f'must have accelerometer.value_{seen}, the column along camera.direction = "{seen}", with {names}. '
                "Add it, or correct camera.direction"
            )

    @model_serializer(mode="wrap")
    def _as_written(self, plain: Callable[[Any], dict[str, Any]], info: SerializationInfo) -> dict[str, Any]:
        """The tree as the file has it: a single section of a kind is no list."""
        tree = {type(self).model_fields[key].alias or key: value for key, value in plain(self).items()}
        for kind in [one for one in KINDS if one in tree]:
            listed = tree.pop(kind)
            if listed or not info.exclude_none:
                tree[kind] = listed if len(listed) > 1 else (*listed, None)[0]
        return tree

    def calibrated_as_printed(self) -> "RecordingSettings":
        """The same with cameras calibrated as printed, and with trackers as printed where they have such a form."""
        calibration = self.calibration.model_copy(update={"literal": True})
        return self.model_copy(
            update={
                "calibration": calibration,
                "cameras": tuple(camera.as_printed() for camera in self.cameras),
                "infrareds": tuple(camera.as_printed() for camera in self.infrareds),
            }
        )

    def of_kind(self, kind: str) -> tuple[SensorSettings, ...]:
        """The sections of one of KINDS."""
        return getattr(self, f"{kind}s")  # type: ignore[no-any-return]

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """All sensors besides the accelerometer: cameras, thermal cameras, radars, displacement sensors."""
        return tuple(Sensor(*one) for one in sensors_of(self.of_kind))

    @property
    def auxiliary(self) -> dict[str, SeriesSettings]:
        """The sections of AUXILIARY that there are, by their kind."""
        return {kind: section for kind in AUXILIARY if (section := getattr(self, kind)) is not None}

    @property
    def streams(self) -> tuple[tuple[str, str, Any], ...]:
        """Name, kind and section of the accelerometer, where there is one, and of all sensors, those that help last."""
        own = () if self.accelerometer is None else ((ACCELEROMETER, ACCELEROMETER, self.accelerometer),)
        return (*own, *sensors_of(self.of_kind), *((kind, kind, one) for kind, one in self.auxiliary.items()))

    @property
    def camera(self) -> CameraSettings | None:
        """The first [camera]."""
        return (*self.cameras, None)[0]

    @property
    def infrared(self) -> InfraredSettings | None:
        """The first [infrared]."""
        return (*self.infrareds, None)[0]

    @property
    def radar(self) -> RadarSettings | None:
        """The first [radar]."""
        return (*self.radars, None)[0]

    @property
    def displacement(self) -> DisplacementSettings | None:
        """The first [displacement]."""
        return (*self.displacements, None)[0]

    @property
    def first_camera(self) -> CameraSettings | None:
        """The camera whose zero counts and whose axes the columns belong to: [camera], else [infrared]."""
        return self.camera or self.infrared

    @property
    def axes(self) -> tuple[str, ...]:
        """The image axes that a result is made for, the one of the main columns first; empty without a camera."""
        if self.first_camera is None:
            return ()
        if self.first_camera.direction != "xy":
            return (self.first_camera.direction,)
        own = self.accelerometer
        main = "x" if own is None else own.axis or ("y" if own.value_y else "x")
        return (main, "x" if main == "y" else "y")

    @property
    def acceleration_column(self) -> str | None:
        """The column of the acceleration along the main axis; None where none is named."""
        own = self.accelerometer
        if own is None or not own.named_axes:
            return None if own is None else own.value
        return own.column((*self.axes, own.axis or own.named_axes[0])[0])
