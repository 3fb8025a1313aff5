"""What a `calibration.json` may say: each key with its unit, its range and what holds where it is left out.

Unknown keys are ignored, so that files of other versions can be read. null stands for what is not known.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    WrapValidator,
    model_validator,
)

from midspan.checks import ValueRange, shown
from midspan.errors import DataError, UsageError
from midspan.records import TimeOffset
from midspan.settings.camera import Celsius
from midspan.settings.fields import (
    Carrier,
    Duration,
    IsNumber,
    Time,
    limited,
    region_is_positive,
    second_is_larger,
)
from midspan.settings.kinds import KINDS, Listed, SensorName, sensor_names
from midspan.settings.messages import explain
from midspan.vision.lens import Lens

# The size of any scale or conversion factor.
FACTOR = ValueRange(1e-9, 1e9)
# What a radar's target in use must have, either sign of its factor; its coherence is 1 but for rounding.
USED = {"amplitude": ValueRange(1e-30, 1e30), "conversion_factor": FACTOR, "coherence": ValueRange(0.01, 1.001)}


def _is_a_factor(value: float) -> float:
    if abs(value) not in FACTOR:
        raise ValueError(f"must not be 0, its size {FACTOR}")
    return value


def _lens(value: Any) -> Lens | None:
    try:
        return None if value is None else Lens.from_dict(value)
    except (KeyError, TypeError, ValueError, OverflowError, UsageError) as error:
        raise ValueError(f"is no lens: {error}".rstrip(".")) from None


def _null(unknown: float) -> WrapValidator:
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
# Of a range profile, whose transform has fewer places.
Bin = Annotated[float, IsNumber, limited(0.0, 1e6, "bins")]
Decibel = Annotated[float, IsNumber, limited(-300.0, 300.0, "dB")]
Whole = Annotated[int, Field(strict=True)]
Roi = Annotated[tuple[Whole, Whole, Whole, Whole], AfterValidator(region_is_positive)]
Complex = tuple[Number, Number]
NumberOrNan = Annotated[Number, _null(math.nan)]
NumberOrInf = Annotated[Number, _null(math.inf)]
NumberOrZero = Annotated[Number, _null(0.0)]
StdOrInf = Annotated[Std, _null(math.inf)]
Text = Annotated[str, BeforeValidator(str)]
Yes = Annotated[bool, Field(strict=True)]


class Stored(BaseModel):
    """A part of the file."""

    model_config = ConfigDict(extra="ignore", frozen=True, arbitrary_types_allowed=True, defer_build=True)


class StoredUsual(Stored):
    """What is usual of the acceleration along one axis: from it holes are bridged and clipped samples are found."""

    mean_m_s2: Bias
    variance_m2_s4: Std
    dominant_hz: Std
    low_m_s2: Number
    high_m_s2: Number
    resolution_m_s2: StdOrInf = math.inf
    moved_m: Std


class StoredAccelerometer(Stored):
    """Noise and bias of the accelerometer, and its gain relative to a displacement sensor."""

    noise_std_m_s2: AccelerationNoise
    motion_noise_s: Std = 0.0
    bias_m_s2: Bias = 0.0
    bias_std_m_s2: StdOrInf = math.inf
    bias_drift_m_s3: Number = 0.0
    scale: Factor = 1.0
    scale_std: Std = 0.0
    misfit: Annotated[float, IsNumber, limited(1.0, 1e12)] = 1.0
    slope_rad_m: Number = 0.0
    direction: Annotated[tuple[Component, ...], Field(max_length=2)] = ()
    direction_std: tuple[Std, ...] = ()
    usual: StoredUsual | None = None

    @model_validator(mode="after")
    def _has_pairs(self) -> "StoredAccelerometer":
        if len(self.direction) != len(self.direction_std):
            raise ValueError("must have one direction_std for each component of direction")
        return self


class StoredTarget(Stored):
    """One target of a camera; one that is not used may lack what was not estimated of it."""

    name: Text | None = None
    roi: Roi
    scale_mm_per_px: Factor | None = None
    scale_std_mm_per_px: Std | None = 0.0
    noise_std_px: Annotated[Noise, _null(math.nan)] = math.nan
    variance_factor: Annotated[Ratio, _null(math.nan)] = math.nan
    used: Yes = True
    reason: Text = ""

    @model_validator(mode="after")
    def _has_what_is_used(self) -> "StoredTarget":
        wanted = ["scale_mm_per_px", "noise_std_px", "variance_factor"] if self.used else []
        wanted += ["scale_std_mm_per_px"] if self.scale_mm_per_px is not None else []
        for key in wanted:
            if getattr(self, key) is None or math.isnan(getattr(self, key)):
                raise ValueError(f"{key} is missing")
        return self


class StoredScale(Stored):
    """What is estimated along one image axis; the targets' own values are in `targets`."""

    scale_mm_per_px: Factor
    scale_std_mm_per_px: Std = 0.0
    relative_scale_std: Std | None = None
    phase_scale_mm_per_rad: Factor | None = None
    apart_std_mm: Std = 0.0
    noise_std_px: Noise = 0.02
    variance_factor: Ratio = 1.0
    targets: tuple[StoredTarget, ...] = ()


class StoredAxis(StoredScale):
    """One of both image axes, with the noise and bias of its own accelerometer."""

    noise_std_px: Noise
    variance_factor: Ratio
    fused: Yes = True
    accelerometer_noise_std_m_s2: AccelerationNoise
    accelerometer_motion_noise_s: Std = 0.0
    accelerometer_bias_m_s2: Bias = 0.0
    accelerometer_bias_std_m_s2: StdOrInf = math.inf
    accelerometer_bias_drift_m_s3: Number = 0.0
    accelerometer_scale_std: Std = 0.0
    accelerometer_misfit: Annotated[float, IsNumber, limited(1.0, 1e12)] = 1.0
    accelerometer_slope_rad_m: Number = 0.0
    accelerometer_usual: StoredUsual | None = None


class StoredAxes(Stored):
    """Both image axes."""

    x: StoredAxis
    y: StoredAxis


class StoredSensor(Stored):
    """What all sensors have: a name where there are several of a kind, and a clock."""

    name: SensorName | None = None
    time_offset_s: Time
    time_offset_std_s: StdOrInf = 0.0

    @property
    def offset(self) -> TimeOffset:
        """The clock offset, its variance infinite where it is not known."""
        return TimeOffset(self.time_offset_s, self.time_offset_std_s**2)


class StoredCamera(StoredSensor, StoredScale):
    """A camera of light or infrared."""

    roi: Roi
    direction: Literal["x", "y", "xy"] = "y"
    axis: Literal["x", "y"] | None = None
    axes: StoredAxes | None = None
    left_out: Literal["", "x", "y"] = ""
    tracker: Text = "template"
    lens: Annotated[Lens | None, BeforeValidator(_lens)] = None
    temperature_range_c: Annotated[tuple[Celsius, Celsius] | None, AfterValidator(second_is_larger)] = None
    exposure_s: Duration = 0.0
    literal: Yes = False

    @model_validator(mode="after")
    def _has_both_axes(self) -> "StoredCamera":
        if self.direction == "xy" and (self.axis is None or self.axes is None):
            raise ValueError('must hold axis, "x" or "y", and axes with x and y, where direction = "xy"')
        return self


class StoredBackground(Stored):
    """What is static in each bin that a radar's target moves through."""

    bins: Annotated[tuple[Bin, ...], Field(min_length=1)]
    phasors: Annotated[tuple[Complex, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _has_pairs(self) -> "StoredBackground":
        if len(self.bins) != len(self.phasors):
            raise ValueError(f"must have as many phasors as bins; received {len(self.phasors)} and {len(self.bins)}")
        return self


class StoredRadarTarget(Stored):
    """One peak of the range profile."""

    place_bin: Bin
    range_m: NumberOrNan = math.nan
    snr_db: Annotated[Decibel, _null(math.inf)] = math.inf
    amplitude: Number
    conversion_factor: NumberOrNan = math.nan
    conversion_factor_std: Number | None = None
    time_offset_s: Time | None = None
    time_offset_std_s: NumberOrInf = math.inf
    coherence: Number | None = None
    clutter: NumberOrNan = math.nan
    disagreement_rad: NumberOrZero = 0.0
    noise_std_mm: NumberOrInf = math.inf
    reach_bins: Annotated[Bin, _null(0.0)] = 0.0
    modulation_rad: NumberOrNan = math.nan
    phase_noise_rad2: NumberOrZero = 0.0
    own_std_mm: NumberOrZero = 0.0
    own_hz: NumberOrZero = 0.0
    leak: Complex = (0.0, 0.0)
    background: StoredBackground | None = None
    weights: Annotated[tuple[Complex, ...], Field(min_length=1)]
    used: Yes = True
    reason: Text = ""

    @model_validator(mode="after")
    def _can_be_used(self) -> "StoredRadarTarget":
        for key, limits in USED.items() if self.used else ():
            value = getattr(self, key)
            # A factor of either sign.
            size = abs(value) if key == "conversion_factor" else value
            if value is not None and size not in limits:
                raise ValueError(f"{key} of a target in use must be {limits}; received {shown(value)}")
        return self


class StoredRadar(StoredSensor):
    """A radar; its own conversion factor is that of the best target, and counts where somebody has changed it."""

    conversion_factor: Factor
    conversion_factor_std: Std = 0.0
    relative_std: Std | None = None
    variance_factor: Ratio = 1.0
    carrier_hz: Carrier
    channels: Annotated[int, IsNumber, Field(ge=1, le=4096)]
    literal: Yes = False
    targets: tuple[StoredRadarTarget, ...]

    @model_validator(mode="after")
    def _has_a_target(self) -> "StoredRadar":
        used = [target for target in self.targets if target.used]
        if not used:
            raise ValueError("targets must hold a target in use")
        if any(len(target.weights) != self.channels for target in used):
            raise ValueError(f"targets must have weights for {self.channels} channels each")
        return self


class StoredDisplacement(StoredSensor):
    """A displacement sensor; its scale is 1 where it was not estimated."""

    noise_std_mm: Noise
    resolution_m: Std | None = None
    low_m: Annotated[Number, _null(-math.inf)] = -math.inf
    high_m: NumberOrInf = math.inf
    slow_std_mm: Std = 0.0
    slow_time_s: StdOrInf = math.inf
    exposure_s: Duration = 0.0
    apart_std_mm: Std = 0.0
    scale: Factor = 1.0
    scale_std: Std = 0.0
    clock_rate: Number = 0.0
    clock_reference_s: Number = 0.0


class StoredNotice(Stored):
    """A warning with its code."""

    code: Text
    severity: Text
    text: Text


class StoredCalibration(Stored):
    """The whole file; of each kind of sensor one section, or a list of several with a name each."""

    version: Text = ""
    created: Text = ""
    warnings: tuple[Text, ...] = ()
    notices: tuple[StoredNotice, ...] = ()
    accelerometer: StoredAccelerometer
    camera: Annotated[tuple[StoredCamera, ...], Listed] = ()
    infrared: Annotated[tuple[StoredCamera, ...], Listed] = ()
    radar: Annotated[tuple[StoredRadar, ...], Listed] = ()
    displacement: Annotated[tuple[StoredDisplacement, ...], Listed] = ()

    @model_validator(mode="after")
    def _sensors_are_told_apart(self) -> "StoredCalibration":
        cameras = (*self.camera, *self.infrared)
        sensor_names({kind: [sensor.name for sensor in getattr(self, kind)] for kind in KINDS})
        if len(cameras) > 1 and any(camera.direction == "xy" for camera in cameras):
            raise ValueError('must have direction = "x" or "y" in each camera where there are several')
        return self


def validate_calibration(tree: Any, where: str) -> StoredCalibration:
    """The contents of a `calibration.json`; `where` names it in the message of DataError."""
    tree = tree if isinstance(tree, dict) else {}
    try:
        return StoredCalibration.model_validate(tree)
    except ValidationError as error:
        told = explain(error.errors()[0], tree, StoredCalibration).removesuffix(" Add it.")
        raise DataError(f"{where}: {told} Run `midspan calibrate` again.") from None
