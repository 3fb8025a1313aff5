"""Settings of the sensors that are no cameras: accelerometer, radar, displacement, reference."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from midspan.settings.fields import (
    Carrier,
    Duration,
    FileName,
    Form,
    IsNumber,
    Name,
    Noise,
    NoiseTime,
    Rate,
    Section,
    SensorName,
    Time,
    limited,
)

Offset = Annotated[float, IsNumber, limited(-1e4, 1e4, "m")]
# Axes of the camera: right, down, along the view.
ALONG = ("x", "y", "z")


class SeriesSettings(Section):
    """Where a series comes from: a file and its time column, or a rate where it has none."""

    file: FileName = Field(description="file of the channel; its suffix or first bytes select the reader")
    time: Name | None = Field(
        None,
        description="column, variable or channel of time (seconds, epoch, ISO 8601); default: detected by name, else "
        "rate_hz",
    )
    rate_hz: Rate | None = Field(None, description="sample rate, if there is no time column; default: the file's rate")
    start_s: Time = Field(
        0.0, description="time of the first sample, or added to the file's clock; ignored with a time column"
    )


class ChannelSettings(SeriesSettings):
    """One channel of a file, with its unit and noise."""

    value: Name | None = Field(
        None,
        description="column, variable or channel of the values, `-NAME` with the other sign; default: the only "
        "suitable one",
    )
    unit: Name | None = Field(None, description="unit of the values; overrides the file's; default: the file's")
    noise_std: Noise | None = Field(
        None,
        description="σ of the white noise per sample, in m/s² or the displacement's unit; higher lowers the sensor's "
        "weight; default: estimated",
    )


class AccelerometerSettings(ChannelSettings):
    """The accelerometer's file."""

    value_x: Name | None = Field(
        None,
        description="column along the image's x axis (right), instead of value; each reads +1 g where it points up",
    )
    value_y: Name | None = Field(None, description="column along the image's y axis (down), instead of value")
    value_z: Name | None = Field(None, description="column along the view; reversed with value_y, where that points up")
    axis: Literal["x", "y", "z"] | None = Field(
        None,
        description="with value_x, value_y, value_z: axis of the result's main columns; default: camera.direction",
    )
    cross_values: Annotated[tuple[Name, ...], Field(max_length=2), Form("1 or 2 texts")] = Field(
        (),
        description="columns of its other axes, in the same unit: cross motion of an inclined accelerometer is removed",
    )
    sensitivity: Annotated[float, IsNumber, limited(0.0, 1e6, "V per m/s²")] = Field(
        0.0, description="volts per m/s²; needed with a unit of voltage, refused with any other"
    )
    scale_std: Annotated[float, IsNumber, Field(ge=0, le=1)] = Field(
        0.0,
        description="relative σ of its sensitivity (0.01: 1 %); widens the band of every row",
    )
    estimate_scale: bool = Field(
        True,
        strict=True,
        description="together with [displacement]: its gain is estimated and corrected; false: the gain is 1",
    )

    camera_offset_m: Annotated[tuple[Offset, Offset, Offset], Form("3 numbers, m")] = Field(
        (0.0, 0.0, 0.0),
        description="from accelerometer to camera along x (right), y (down), z (view); for translation_x_mm …",
    )

    @model_validator(mode="after")
    def _one_way_to_name_a_column(self) -> "AccelerometerSettings":
        if self.value and self.named_axes:
            raise ValueError("must have value for one axis, or value_x, value_y and value_z for several, not both")
        if self.axis and self.axis not in self.named_axes:
            raise ValueError(f"must have value_{self.axis}, the column of that axis, with axis = {self.axis!r}")
        if len({self.column(axis) for axis in self.named_axes}) < len(self.named_axes):
            raise ValueError("must have columns in value_x, value_y and value_z that differ from each other")
        if self.cross_values and not self.value:
            raise ValueError("must have value, the column of the main axis, with cross_values")
        if len({self.value, *self.cross_values}) < 1 + len(self.cross_values):
            raise ValueError("must have columns in cross_values that differ from each other and from value")
        return self

    @property
    def named_axes(self) -> tuple[str, ...]:
        """The axes x, y, z, of which a column is named."""
        return tuple(axis for axis in ALONG if getattr(self, f"value_{axis}"))

    def column(self, axis: str) -> str | None:
        """The column along an axis x, y or z; that of `value` where no axes are named."""
        return getattr(self, f"value_{axis}") if self.named_axes else self.value

    def of_column(self, column: str | None) -> "AccelerometerSettings":
        """The same with one axis, that of a column."""
        return self.model_copy(update={"value": column, "axis": None, **{f"value_{axis}": None for axis in ALONG}})


class RadarSettings(Section):
    """A chirp radar on the structure that looks at fixed surroundings."""

    name: SensorName | None = Field(None, description="name of the sensor; needed if there are several of a kind")
    file: FileName = Field(description="raw ADC .bin of DCA1000, slow-time I/Q .h5 or .npy, Acconeer .h5")
    config: FileName | None = Field(
        None, description=".cfg of the mmWave demo or .json of mmWave Studio; required for a .bin"
    )
    iq_order: Literal["auto", "IIQQ", "QQII", "IQIQ", "QIQI"] = Field(
        "auto", description="order of I and Q in a .bin; auto: from config and samples"
    )
    start_s: Time = Field(0.0, description="start of the first frame, on the radar's own clock")
    rate_hz: Rate | None = Field(None, description="frame rate of slow-time I/Q, if neither file nor config has it")
    carrier_hz: Carrier | None = Field(None, description="carrier of slow-time I/Q, if neither file nor config has it")
    targets: Annotated[int, IsNumber, Field(ge=1, le=8)] = Field(
        3, description="largest number of fixed targets to use; more tolerates occlusion better"
    )
    target_range_m: Annotated[float, IsNumber, limited(1e-3, 1e5, "m")] | None = Field(
        None, description="use only the target nearest to this range, within 0.5 m; default: the best ones"
    )


class DisplacementSettings(ChannelSettings):
    """Any other displacement: GNSS, total station, LVDT, level."""

    name: SensorName | None = Field(None, description="name of the sensor; needed if there are several of a kind")
    estimate_offset: bool | None = Field(
        None,
        strict=True,
        description="true: estimate the clock offset or refuse; false: common clock; default: correct an offset that "
        "the motion shows",
    )
    estimate_scale: bool = Field(
        False,
        strict=True,
        description="true: estimate the scale with its sign, or refuse; false: use the unit as stated",
    )
    exposure_s: Duration | None = Field(
        None,
        description="averaging time of one value; longer corrects more; 0: none; default: estimated if observable",
    )
    receiver: Literal["gnss"] | None = Field(
        None,
        description="gnss: the band includes a slow error of 3 mm over 100 s unless the record shows another",
    )
    noise_time_s: NoiseTime | None = Field(
        None,
        description="correlation time of its slow error; longer gives slow changes less weight; 0: none; default: "
        "estimated if observable",
    )


class VelocitySettings(ChannelSettings):
    """Velocity along the accelerometer's axis, positive in its direction: laser vibrometer, Doppler radar."""


def turning_axis(direction: str) -> str:
    """The camera's axis about which a rotation moves the image along its axis "x" or "y"."""
    return "y" if direction == "x" else "x"


class RotationSettings(SeriesSettings):
    """A series of rotation about the camera's axes."""

    value_x: Name | None = Field(None, description="column of the rotation about the image's x axis (right): pitch")
    value_y: Name | None = Field(None, description="column of the rotation about the image's y axis (down): yaw")
    value_z: Name | None = Field(None, description="column of the rotation about the line of sight: roll")
    unit: Name | None = Field(None, description="unit of the values; overrides the file's; default: the file's")

    @model_validator(mode="after")
    def _names_a_column(self) -> "RotationSettings":
        if not (self.value_x or self.value_y or self.value_z):
            raise ValueError(
                "must name value_x, value_y or value_z: a column of the rotation about one of the camera's axes, "
                "right-handed"
            )
        return self

    def about(self, direction: str) -> str | None:
        """The column of the rotation that moves the image along its axis "x" or "y"."""
        return getattr(self, f"value_{turning_axis(direction)}")  # type: ignore[no-any-return]


class GyroscopeSettings(RotationSettings):
    """A gyroscope in the camera's box, on the accelerometer's clock."""

    noise_density: Annotated[float, IsNumber, limited(1e-9, 1e6)] | None = Field(
        None, description="white noise in unit/√Hz; higher lowers its weight; default: estimated"
    )
    bias_std: Annotated[float, IsNumber, limited(0.0, 1e6)] | None = Field(
        None, description="σ of its bias in unit; larger takes longer to settle; default: 0.3 °/s"
    )


class InclinometerSettings(RotationSettings):
    """An inclinometer in the camera's box, on the accelerometer's clock: slow angles."""

    noise_std: Noise | None = Field(
        None, description="σ of the white noise per sample, in unit; higher lowers its weight; default: estimated"
    )


class ReferenceSettings(ChannelSettings):
    """A reference that only report and compare look at."""
