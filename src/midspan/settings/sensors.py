"""Settings of the sensors that give one number at a time: accelerometer, displacement, reference."""

from pydantic import Field, model_validator

from midspan.settings.fields import FiniteNumber, Name, NonNegativeNumber, PositiveNumber, Section


class ChannelSettings(Section):
    """Where a channel comes from: a file, its time and value columns, its unit, or a rate where it has no time."""

    file: Name
    time: Name | None = Field(None, description="column of time; left out: found by name, else rate_hz")
    value: Name | None = Field(None, description="column of the values; left out: found when only one can be meant")
    unit: Name | None = Field(None, description="unit of the values; left out: as the file says")
    rate_hz: PositiveNumber | None = Field(None, description="samples a second, where there is no time column")
    start_s: FiniteNumber = Field(0.0, description="time of the first sample, where there is no time column, s")
    noise_std: PositiveNumber | None = Field(
        None,
        description="noise of one sample, in m/s² (accelerometer) or in `unit`; left out: learnt; higher trusts less",
    )


class AccelerometerSettings(ChannelSettings):
    """The accelerometer's file."""

    value_x: Name | None = Field(None, description="column along the image's x axis, with camera.direction = 'xy'")
    value_y: Name | None = Field(None, description="column along the image's y axis, with camera.direction = 'xy'")
    sensitivity: NonNegativeNumber = Field(0.0, description="V per m/s², with unit = 'V'; 0: not used")

    @model_validator(mode="after")
    def _one_way_to_name_a_column(self) -> "AccelerometerSettings":
        if self.value and (self.value_x or self.value_y):
            raise ValueError("must have value for one axis, or value_x and value_y for the image's axes, not both")
        return self


class DisplacementSettings(ChannelSettings):
    """Any other displacement: GNSS, total station, LVDT, level."""

    estimate_offset: bool = Field(
        False, strict=True, description="learn and apply the clock offset to the accelerometer; false: one clock"
    )


class ReferenceSettings(ChannelSettings):
    """A reference that only report and compare look at."""
