"""The sections of `calibration.json`: keys with unit, range and default, and the record in SI units that each means.

A key stands for the record's field of the same name, in mm for one in m; `Stored.fields` has those of other names. What
is not known is left out, or null where a number can be infinite. Unknown keys are ignored, so that files of other
versions can be read.
"""

import dataclasses
import math
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WrapValidator, model_validator

from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.checks import ValueRange
from midspan.engine.axis import AxisFigures
from midspan.records import TimeOffset
from midspan.settings.fields import (
    Duration,
    Form,
    IsNumber,
    SensorName,
    Time,
    limited,
)
from midspan.signals.lines import Line
from midspan.vision.lens import Lens

MM = 1e3
# The size of any scale or conversion factor.
FACTOR = ValueRange(1e-9, 1e9)


def _is_a_factor(value: float) -> float:
    if abs(value) not in FACTOR:
        raise ValueError(f"must not be 0, its size {FACTOR}")
    return value


def null(unknown: float) -> WrapValidator:
    """What null stands for."""
    return WrapValidator(lambda value, number: unknown if value is None else number(value))


# The squares of all numbers stay finite.
Number = Annotated[float, IsNumber, limited(-1e30, 1e30)]
Std = Annotated[float, IsNumber, limited(0.0, 1e30)]
Factor = Annotated[float, IsNumber, limited(-1e30, 1e30), AfterValidator(_is_a_factor)]
Ratio = Annotated[float, IsNumber, limited(1e-12, 1e12)]
# Noise of one sample, from that of computed data without any (rounding) to the full scale of a shock sensor.
AccelerationNoise = Annotated[float, IsNumber, limited(1e-15, 1e6, "m/s²")]
Bias = Annotated[float, IsNumber, limited(-1e4, 1e4, "m/s²")]
# Of a sensor's axis along a cross axis of the accelerometer, for one along its main axis: up to 84 degrees.
Component = Annotated[float, IsNumber, limited(-10.0, 10.0)]
# From rounding to above any range.
Noise = Annotated[float, IsNumber, limited(1e-15, 1e6, "(px or mm)")]
Complex = tuple[Number, Number]
NumberOrNan = Annotated[Number, null(math.nan)]
NumberOrInf = Annotated[Number, null(math.inf)]
NumberOrZero = Annotated[Number, null(0.0)]
StdOrInf = Annotated[Std, null(math.inf)]
Text = Annotated[str, BeforeValidator(str)]
Yes = Annotated[bool, Field(strict=True)]


class Stored(BaseModel):
    """A part of the file; fields: the record's names of keys that are called otherwise, empty for none."""

    model_config = ConfigDict(extra="ignore", frozen=True, arbitrary_types_allowed=True, defer_build=True)
    fields: ClassVar[dict[str, str]] = {}

    @classmethod
    def field_of(cls, key: str) -> str:
        """The record's field that a key stands for."""
        return cls.fields.get(key, key.replace("_mm", "_m"))

    def values(self, record: type) -> dict[str, Any]:
        """The fields of a record, in SI units, as far as the section holds them."""
        keys = {self.field_of(key): key for key in type(self).model_fields}
        si_values = {}
        for item in dataclasses.fields(record):
            key = keys.get(item.name, item.name)
            value = getattr(self, key, dataclasses.MISSING)
            if value is not dataclasses.MISSING:
                si_values[item.name] = value / MM if "_mm" in key and value is not None else value
        return si_values

    @classmethod
    def tree(cls, record: Any) -> dict[str, Any]:
        """The section of a record, without what is None."""
        si_values = {key: getattr(record, cls.field_of(key), None) for key in cls.model_fields}
        return {
            key: _plain(MM * value if "_mm" in key else value) for key, value in si_values.items() if value is not None
        }


def _plain(value: Any) -> Any:
    """A value as JSON holds it: null for a number that is not finite, complex numbers as [real, imaginary]."""
    match value:
        case float():
            return float(value) if math.isfinite(value) else None
        case complex():
            return [value.real, value.imag]
        case tuple() | np.ndarray():
            return [_plain(one) for one in (value.tolist() if isinstance(value, np.ndarray) else value)]
        case AxisFigures():
            return StoredUsual.tree(value)
        case Line():
            return StoredLine.tree(value)
        case Lens():
            return value.to_dict()
    return value


class StoredUsual(Stored):
    """What is usual of the acceleration along one axis: from it holes are bridged and clipped samples are found."""

    fields = {"variance_m2_s4": "variance"}
    mean_m_s2: Bias
    variance_m2_s4: Std
    dominant_hz: Std
    low_m_s2: Number
    high_m_s2: Number
    range_low_m_s2: Annotated[Number, null(-math.inf)] = -math.inf
    range_high_m_s2: NumberOrInf = math.inf
    resolution_m_s2: StdOrInf = math.inf
    moved_m: Std


class StoredLine(Stored):
    """A narrow line of the acceleration that is no motion."""

    low_hz: Std
    high_hz: Std
    std_m_s2: Std
    taken_out: bool = True


class StoredAccelerometer(Stored):
    """Noise and bias of the accelerometer, and its gain relative to a displacement sensor."""

    fields = {
        **{"scale": "accelerometer_scale", "scale_std": "accelerometer_scale_std", "slope_rad_m": "slope"},
        **{"direction": "", "direction_std": ""},
    }
    noise_std_m_s2: AccelerationNoise = Field(description="noise per sample, given or estimated")
    motion_noise_s: Std = Field(0.0, description="additional noise density per mean square of the acceleration")
    bias_m_s2: Bias = Field(0.0, description="reading at rest at the end of the window")
    bias_std_m_s2: StdOrInf = Field(math.inf, description="its σ; null: not known")
    bias_drift_m_s3: Number = Field(
        0.0, description="drift rate of the bias; widens its random walk; 0: not observable"
    )
    scale: Factor = Field(1.0, description="gain relative to a displacement sensor; 1 where it was not estimated")
    scale_std: Std = Field(
        0.0,
        description="σ of the gain, else the recording's scale_std; part of all scales' deviations",
    )
    misfit: Annotated[float, IsNumber, limited(1.0, 1e12)] = Field(
        1.0, description="factor on the variance of rows, 1 or more, for innovations that are not white"
    )
    slope_rad_m: Number = Field(
        0.0, description="inclination per displacement, for the correction of gravity; 0: not observable"
    )
    direction: Annotated[tuple[Component, ...], Field(max_length=2)] = Field(
        (), description="with cross_values: sensors' axis along the cross axes, for one along value"
    )
    direction_std: tuple[Std, ...] = Field((), description="σ of direction")
    usual: Annotated[StoredUsual | None, Form("section")] = Field(
        None,
        description="usual mean, variance, frequency, extremes, range and resolution, for detecting gaps and clipping",
    )
    lines: Annotated[tuple[StoredLine, ...], Form("list")] = Field(
        (),
        description="narrow spectral lines without motion: low_hz, high_hz, std_m_s2, taken_out (false: they widen "
        "the band)",
    )

    @model_validator(mode="after")
    def _has_pairs(self) -> "StoredAccelerometer":
        if len(self.direction) != len(self.direction_std):
            raise ValueError("must have one direction_std for each component of direction")
        return self

    def values(self, record: type) -> dict[str, Any]:
        """The fields of a `Calibration` that are the accelerometer's."""
        usual = self.usual and AxisFigures(**self.usual.values(AxisFigures))
        lines = tuple(Line(**one.values(Line)) for one in self.lines)
        return super().values(record) | {"usual": usual, "lines": lines}


class StoredSensor(Stored):
    """What all sensors have: a name where there are several of a kind, and a clock."""

    name: SensorName | None = Field(None, description="of a named sensor; of several a list holds one section each")
    time_offset_s: Time = Field(description="clock offset, added to the sensor's stamps")
    time_offset_std_s: StdOrInf = Field(0.0, description="its σ; null: not known")

    @property
    def offset(self) -> TimeOffset:
        """The clock offset, its variance infinite where it is not known."""
        return TimeOffset(self.time_offset_s, self.time_offset_std_s**2)

    @classmethod
    def tree(cls, record: Any) -> dict[str, Any]:
        """The section of a sensor."""
        offset = {
            "time_offset_s": record.offset.value_s,
            "time_offset_std_s": _plain(math.sqrt(record.offset.variance)),
        }
        return super().tree(record) | offset


def offset_summary(offset: TimeOffset) -> str:
    """A clock offset with its standard deviation, as one line of a summary has it."""
    return f"clock offset {1e3 * offset.value_s:.2f} ± {1e3 * math.sqrt(offset.variance):.2f} ms"


def offset_words(offset: TimeOffset) -> str:
    """A clock offset with its standard deviation, where the motion tells it."""
    if not math.isfinite(offset.variance):
        return f"{1e3 * offset.value_s:+.3f} ms, not determined by the motion"
    return f"{1e3 * offset.value_s:+.3f} ± {1e3 * math.sqrt(offset.variance):.2g} ms"


class StoredDisplacement(StoredSensor):
    """A displacement sensor; its scale is 1 where it was not estimated."""

    noise_std_mm: Noise = Field(description="white noise of one value")
    resolution_m: Std | None = Field(None, description="resolution: smallest step between values")
    low_m: Annotated[Number, null(-math.inf)] = Field(
        -math.inf, description="lower end of its range, if values were clipped there; null: none"
    )
    high_m: NumberOrInf = Field(math.inf, description="upper end of its range, likewise")
    slow_std_mm: Std = Field(0.0, description="σ of its slow error; 0: white noise only")
    slow_time_s: StdOrInf = Field(math.inf, description="correlation time of the slow error")
    slow_hz: Std = Field(0.0, description="frequency of the slow error; 0: first-order Gauss-Markov")
    exposure_s: Duration = Field(0.0, description="averaging time of a value, given or estimated")
    apart_std_mm: Std = Field(
        0.0, description="unexplained difference from the accelerometer (rms), included in the band"
    )
    scale: Factor = Field(1.0, description="displacement per reading, with estimate_scale")
    scale_std: Std = Field(0.0, description="its σ")
    clock_rate: Number = Field(0.0, description="clock drift: added to its stamps per second since clock_reference_s")
    clock_reference_s: Number = Field(0.0, description="instant on its own clock from which clock_rate counts")
    unseen_drift_mm: StdOrInf = Field(
        0.0, description="largest undetectable drift within 10 s, for not_in_band; null: any; 0: not examined"
    )
    unseen_step_mm: StdOrInf = Field(0.0, description="largest undetectable step of its zero, likewise")
    unseen_gap_mm: StdOrInf = Field(0.0, description="largest undetectable step across its longest gap, likewise")

    def record(self, _kind: str) -> DisplacementCalibration:
        """The displacement sensor."""
        return DisplacementCalibration(**self.values(DisplacementCalibration))

    @staticmethod
    def summary(sensor: DisplacementCalibration) -> str:
        """Noise, scale where it was estimated, and clock offset."""
        scale = "" if sensor.scale == 1.0 else f", scale {sensor.scale:.5g} ± {sensor.scale_std:.2g}"
        return f"noise {1e3 * sensor.noise_std_m:.3g} mm{scale}, {offset_summary(sensor.offset)}"

    @staticmethod
    def rows(sensor: DisplacementCalibration) -> list[tuple[str, str]]:
        """The values that the report lists."""
        scale = f"{sensor.scale:.5g} ± {sensor.scale_std:.2g} ({100 * sensor.relative_std:.2g} %), estimated"
        return [
            ("noise", f"{1e3 * sensor.noise_std_m:.4g} mm per measurement"),
            ("clock offset", offset_words(sensor.offset)),
            *([("scale", scale)] if sensor.scale_std > 0.0 else []),
        ]


class StoredNotice(Stored):
    """A warning with its code."""

    code: Text
    severity: Text
    text: Text
