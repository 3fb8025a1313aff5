"""Settings of the sensors that are no cameras: accelerometer, radar, displacement, reference."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from midspan.settings.fields import (
    Carrier,
    Duration,
    FileName,
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


class ChannelSettings(Section):
    """Where a channel comes from: a file, its time and value columns, its unit, or a rate where it has no time."""

    file: FileName
    time: Name | None = Field(None, description="column of time; left out: found by name, else rate_hz")
    value: Name | None = Field(None, description="column of the values; left out: found when only one can be meant")
    unit: Name | None = Field(None, description="unit of the values; left out: as the file says")
    rate_hz: Rate | None = Field(None, description="samples a second, where there is no time column")
    start_s: Time = Field(0.0, description="time of the first sample, where there is no time column, s")
    noise_std: Noise | None = Field(
        None,
        description="noise of one sample, in m/s² (accelerometer) or in `unit`; left out: estimated; more trusts less",
    )


class AccelerometerSettings(ChannelSettings):
    """The accelerometer's file."""

    value_x: Name | None = Field(None, description="column along the image's x axis, with camera.direction = 'xy'")
    value_y: Name | None = Field(None, description="column along the image's y axis, with camera.direction = 'xy'")
    cross_values: Annotated[tuple[Name, ...], Field(max_length=2)] = Field(
        (),
        description="columns of its other axes, in the same unit: the direction of the other sensors' axis is "
        "estimated, so that cross motion of an inclined accelerometer is taken out; left out: it is that of `value`",
    )
    sensitivity: Annotated[float, IsNumber, limited(0.0, 1e6, "V per m/s²")] = Field(
        0.0, description="V per m/s², with unit = 'V'; 0: not used"
    )
    scale_std: Annotated[float, IsNumber, Field(ge=0, le=1)] = Field(
        0.0,
        description="relative standard deviation of its sensitivity, in the band through every scale; 0: not known",
    )
    estimate_scale: bool = Field(
        True,
        strict=True,
        description="together with [displacement]: estimate the accelerometer's gain and take it out; false: it is 1",
    )

    @model_validator(mode="after")
    def _one_way_to_name_a_column(self) -> "AccelerometerSettings":
        if self.value and (self.value_x or self.value_y):
            raise ValueError("must have value for one axis, or value_x and value_y for the image's axes, not both")
        if self.cross_values and not self.value:
            raise ValueError("must have value, the column of the main axis, with cross_values")
        if len({self.value, *self.cross_values}) < 1 + len(self.cross_values):
            raise ValueError("must have columns in cross_values that differ from each other and from value")
        return self


class RadarSettings(Section):
    """A chirp radar on the structure that looks at fixed surroundings."""

    name: SensorName | None = Field(None, description="what it is called where there are several of a kind")
    file: FileName
    config: FileName | None = Field(None, description=".cfg of the mmWave demo or .json of mmWave Studio")
    iq_order: Literal["auto", "IIQQ", "QQII", "IQIQ", "QIQI"] = Field(
        "auto", description="order of I and Q in a raw capture; auto: from the settings and the samples"
    )
    start_s: Time = Field(0.0, description="time of the first frame, s")
    rate_hz: Rate | None = Field(
        None, description="frames a second of slow-time I/Q, where neither file nor config says it"
    )
    carrier_hz: Carrier | None = Field(
        None, description="carrier of slow-time I/Q, where neither file nor config says it, Hz"
    )
    targets: Annotated[int, IsNumber, Field(ge=1, le=8)] = Field(
        3, description="how many fixed targets are used at most; more is steadier when some are blocked"
    )
    target_range_m: Annotated[float, IsNumber, limited(1e-3, 1e5, "m")] | None = Field(
        None, description="use only the target nearest to this range, m; left out: the best ones"
    )


class DisplacementSettings(ChannelSettings):
    """Any other displacement: GNSS, total station, LVDT, level."""

    name: SensorName | None = Field(None, description="what it is called where there are several of a kind")
    estimate_offset: bool | None = Field(
        None,
        strict=True,
        description="true: learn and apply the clock offset to the accelerometer, or refuse; false: one clock; left "
        "out: one clock unless the motion shows an offset, which is then applied",
    )
    estimate_scale: bool = Field(
        False, strict=True, description="learn and apply the scale, with its sign; false: the unit is taken as it is"
    )
    exposure_s: Duration | None = Field(
        None, description="time over which the sensor averages, s; left out: found where the motion tells it"
    )
    receiver: Literal["gnss"] | None = Field(
        None,
        description="gnss: the error band holds a slow error of 3 mm over 100 s where the record shows no other and "
        "noise_time_s is left out; left out: any other sensor",
    )
    noise_time_s: NoiseTime | None = Field(
        None,
        description="correlation time of its slow error (GNSS), s; 0: it has none; left out: estimated where the "
        "data allow it; longer trusts its slow part less",
    )


class ReferenceSettings(ChannelSettings):
    """A reference that only report and compare look at."""
