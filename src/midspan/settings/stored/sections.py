"""The sections of `calibration.json`: keys with unit, range and default, and the record in SI units that each means.

A key stands for the record's field of the same name, in mm for one in m; `Stored.fields` has those of other names. What
is not known is left out, or null where a number can be infinite. Unknown keys are ignored, so that files of other
versions can be read.
"""

import dataclasses
import math
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WrapValidator, model_validator

from midspan.calibration.sensors.camera import CameraCalibration, TargetCalibration
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.calibration.sensors.radar import RadarCalibration, RadarTarget
from midspan.checks import ValueRange, shown
from midspan.engine.axis import AxisFigures
from midspan.errors import UsageError
from midspan.radar.following import Background
from midspan.radar.target import Target
from midspan.records import Region, ScaleFactor, Source, TimeOffset
from midspan.settings.camera import Celsius
from midspan.settings.fields import (
    Carrier,
    Duration,
    IsNumber,
    SensorName,
    Time,
    limited,
    region_is_positive,
    second_is_larger,
)
from midspan.signals.lines import Line
from midspan.vision.lens import Lens

MM = 1e3
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
        case Background():
            return StoredBackground.tree(value)
        case Lens():
            return value.to_dict()
    return value


def _complex(pairs: tuple[tuple[float, float], ...]) -> NDArray[np.complex128]:
    return np.array([complex(*pair) for pair in pairs])


class StoredUsual(Stored):
    """What is usual of the acceleration along one axis: from it holes are bridged and clipped samples are found."""

    fields = {"variance_m2_s4": "variance"}
    mean_m_s2: Bias
    variance_m2_s4: Std
    dominant_hz: Std
    low_m_s2: Number
    high_m_s2: Number
    range_low_m_s2: Annotated[Number, _null(-math.inf)] = -math.inf
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
    lines: tuple[StoredLine, ...] = ()

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
    lever_px: Number = 0.0

    @model_validator(mode="after")
    def _has_what_is_used(self) -> "StoredTarget":
        wanted = ["scale_mm_per_px", "noise_std_px", "variance_factor"] if self.used else []
        wanted += ["scale_std_mm_per_px"] if self.scale_mm_per_px is not None else []
        for key in wanted:
            if getattr(self, key) is None or math.isnan(getattr(self, key)):
                raise ValueError(f"{key} is missing")
        return self

    def record(self, number: int) -> TargetCalibration:
        """The target, which is called by its number where it has no name."""
        more = {"region": Region(*self.roi), "scale": _factor(self), "name": self.name or str(number)}
        return TargetCalibration(**self.values(TargetCalibration) | more)

    @classmethod
    def tree(cls, record: TargetCalibration) -> dict[str, Any]:
        """The section of a target."""
        return super().tree(record) | _region_tree(record.region) | _factor_tree(record.scale)


class StoredScale(Stored):
    """What is estimated along one image axis; the targets' own values are in `targets`."""

    fields = {"targets": ""}
    scale_mm_per_px: Factor
    scale_std_mm_per_px: Std = 0.0
    relative_scale_std: Std | None = None
    phase_scale_mm_per_rad: Factor | None = None
    apart_std_mm: Std = 0.0
    slow_std_mm: Std = 0.0
    slow_time_s: StdOrInf = math.inf
    slow_hz: Std = 0.0
    noise_std_px: Noise = 0.02
    variance_factor: Ratio = 1.0
    targets: tuple[StoredTarget, ...] = ()

    def along(self) -> dict[str, Any]:
        """The fields of a camera along one image axis; the section's own keys count for its only target in use."""
        common = set(StoredTarget.model_fields) - {"name", "used", "reason"}
        stated = {key: getattr(self, key) for key in common if key in self.model_fields_set}
        alone = sum(target.used for target in self.targets) == 1
        targets = [one.model_copy(update=stated) if alone and one.used else one for one in self.targets]
        records = tuple(one.record(number) for number, one in enumerate(targets, start=1))
        return self.values(CameraCalibration) | {"scale": _factor(self), "targets": records}

    @classmethod
    def tree(cls, record: CameraCalibration) -> dict[str, Any]:
        """The section of a camera along one image axis."""
        targets = [StoredTarget.tree(target) for target in record.targets]
        return super().tree(record) | _factor_tree(record.scale) | {"targets": targets}


def _factor(part: StoredScale | StoredTarget) -> ScaleFactor | None:
    value, std = part.scale_mm_per_px, part.scale_std_mm_per_px or 0.0
    return None if value is None else ScaleFactor(value / MM, (std / MM) ** 2)


def _factor_tree(scale: ScaleFactor | None) -> dict[str, float | None]:
    value, std = (None, None) if scale is None else (MM * scale.value_m_per_px, MM * math.sqrt(scale.variance))
    return {"scale_mm_per_px": value, "scale_std_mm_per_px": std}


def _region_tree(region: Region) -> dict[str, list[int]]:
    return {"roi": [region.x, region.y, region.width, region.height]}


# What the keys of the accelerometer along an image axis begin with.
PREFIX = "accelerometer_"


class StoredAxis(StoredScale):
    """One of both image axes, with the noise and bias of its own accelerometer, whose keys have a prefix."""

    noise_std_px: Noise
    variance_factor: Ratio
    fused: Yes = True
    accelerometer: StoredAccelerometer

    @model_validator(mode="before")
    @classmethod
    def _without_prefix(cls, tree: Any) -> Any:
        if not isinstance(tree, dict):
            return tree
        section = {key.removeprefix(PREFIX): value for key, value in tree.items() if str(key).startswith(PREFIX)}
        return tree | {"accelerometer": section}

    @classmethod
    def axis_tree(cls, camera: CameraCalibration, calibration: Any) -> dict[str, Any]:
        """The section of a camera and its accelerometer along one image axis."""
        section = StoredAccelerometer.tree(calibration)
        return cls.tree(camera) | {f"{PREFIX}{key}": value for key, value in section.items()}


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

    @classmethod
    def tree(cls, record: Any) -> dict[str, Any]:
        """The section of a sensor."""
        offset = {
            "time_offset_s": record.offset.value_s,
            "time_offset_std_s": _plain(math.sqrt(record.offset.variance)),
        }
        return super().tree(record) | offset


def _offset(offset: TimeOffset) -> str:
    return f"clock offset {1e3 * offset.value_s:.2f} ± {1e3 * math.sqrt(offset.variance):.2f} ms"


def offset_words(offset: TimeOffset) -> str:
    """A clock offset with its standard deviation, where the motion tells it."""
    if not math.isfinite(offset.variance):
        return f"{1e3 * offset.value_s:+.3f} ms, not determined by the motion"
    return f"{1e3 * offset.value_s:+.3f} ± {1e3 * math.sqrt(offset.variance):.2g} ms"


class StoredCamera(StoredSensor, StoredScale):
    """A camera of light or infrared."""

    fields = {"targets": "", "axis": "", "axes": ""}
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

    def record(self, kind: str) -> CameraCalibration:
        """The camera along its main axis."""
        direction = self.axis if self.direction == "xy" and self.axis is not None else self.direction
        more = {"region": Region(*self.roi), "direction": direction, "source": Source[kind.upper()]}
        return CameraCalibration(**self.along() | more)

    def across(self, main: CameraCalibration) -> tuple[CameraCalibration, StoredAccelerometer]:
        """The same camera along its second axis, and the accelerometer there."""
        assert self.axes is not None
        part = self.axes.x if main.direction == "y" else self.axes.y
        second = dataclasses.replace(main, **part.along(), direction="x" if main.direction == "y" else "y")
        # The best target along this axis may be another one than along the main axis: the one with the axis's scale.
        regions = [target.region for target in second.targets if target.used and target.scale == second.scale]
        return dataclasses.replace(second, region=(*regions, main.region)[0]), part.accelerometer

    @classmethod
    def tree(cls, record: CameraCalibration) -> dict[str, Any]:
        """The section of a camera along its main axis."""
        return super().tree(record) | _region_tree(record.region)

    @staticmethod
    def summary(camera: CameraCalibration) -> str:
        """Scale factor and clock offset."""
        value, std = 1e3 * camera.scale.value_m_per_px, 1e3 * math.sqrt(camera.scale.variance)
        return f"{value:.5g} ± {std:.2g} mm/px along {camera.direction}, {_offset(camera.offset)}"

    @staticmethod
    def rows(camera: CameraCalibration) -> list[tuple[str, str]]:
        """The values that the report lists."""
        value, std = 1e3 * camera.scale.value_m_per_px, 1e3 * math.sqrt(camera.scale.variance)
        region, seen = camera.region, camera.temperature_range_c
        return [
            ("scale factor", f"{value:.6g} ± {std:.2g} mm/px ({100 * std / abs(value):.2g} %)"),
            ("clock offset", offset_words(camera.offset)),
            ("noise", f"{camera.noise_std_px:.3g} px a frame, {abs(value) * camera.noise_std_px:.3g} mm"),
            ("variance factor", f"{camera.variance_factor:.3g}"),
            ("region", f"x {region.x}, y {region.y}, {region.width} × {region.height} px"),
            *([("temperature range", f"{seen[0]:.2f} … {seen[1]:.2f} °C")] if seen else []),
            ("direction, tracker", f"{camera.direction}, {camera.tracker}"),
        ]


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

    fields = {"noise_std_mm": "noise_m", "own_std_mm": "own_m"}
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

    def record(self, offset_s: float) -> RadarTarget:
        """The target; what is not known of it is another thing for one that is used than for one that is not.

        offset_s: of the radar's clock.
        """
        std, own_s, coherence = (0.0, offset_s, 1.0) if self.used else (math.inf, math.nan, 0.0)
        unknown = {"conversion_factor_std": std, "time_offset_s": own_s, "coherence": coherence}
        known = {name: value for name, value in self.values(Target).items() if value is not None}
        known |= {"leak": complex(*self.leak), "weights": _complex(self.weights)}
        if self.background is not None:
            bins, phasors = np.array(self.background.bins), _complex(self.background.phasors)
            known["background"] = Background(bins, phasors)
        return RadarTarget(Target(**unknown | known), self.used, self.reason)


class StoredRadar(StoredSensor):
    """A radar; its own conversion factor is that of the best target, and counts where somebody has changed it."""

    fields = {"targets": ""}
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

    def record(self, _kind: str) -> RadarCalibration:
        """The radar; the section's own conversion factor is that of the best target."""
        best, *others = sorted((one.record(self.time_offset_s) for one in self.targets), key=lambda item: not item.used)
        factor = {"conversion_factor": self.conversion_factor, "conversion_factor_std": self.conversion_factor_std}
        target = dataclasses.replace(best.target, **factor)  # type: ignore[arg-type]
        spread = best.target.relative_std if self.relative_std is None else self.relative_std
        more = {"targets": (dataclasses.replace(best, target=target), *others), "relative_std": spread}
        return RadarCalibration(**self.values(RadarCalibration) | more)

    @classmethod
    def tree(cls, record: RadarCalibration) -> dict[str, Any]:
        """The section of a radar; range and noise of the best target inform alone."""
        best = StoredRadarTarget.tree(record.best)
        of_best = {key: best[key] for key in ("conversion_factor", "conversion_factor_std", "noise_std_mm")}
        targets = [
            StoredRadarTarget.tree(one.target) | {"used": one.used, "reason": one.reason} for one in record.targets
        ]
        return super().tree(record) | of_best | {"target_range_m": best["range_m"], "targets": targets}

    @staticmethod
    def summary(radar: RadarCalibration) -> str:
        """Conversion factor, range of the target and clock offset."""
        target = radar.targets[0].target
        value, std = target.conversion_factor, target.conversion_factor_std
        return f"conversion factor {value:.5g} ± {std:.2g}, target {target.place}, {_offset(radar.offset)}"

    @staticmethod
    def rows(radar: RadarCalibration) -> list[tuple[str, str]]:
        """The values that the report lists."""
        best = radar.best
        value, std = best.conversion_factor, best.conversion_factor_std
        return [
            ("conversion factor", f"{value:.6g} ± {std:.2g} ({100 * std / abs(value):.2g} %)"),
            ("range", f"{best.range_m:.3f} m" if math.isfinite(best.range_m) else "not known"),
            ("clock offset", offset_words(radar.offset)),
            ("noise", f"{1e3 * best.noise_m:.3g} mm a frame of displacement"),
            ("variance factor", f"{radar.variance_factor:.3g}"),
            ("carrier", f"{radar.carrier_hz / 1e9:.5f} GHz"),
        ]


class StoredDisplacement(StoredSensor):
    """A displacement sensor; its scale is 1 where it was not estimated."""

    noise_std_mm: Noise
    resolution_m: Std | None = None
    low_m: Annotated[Number, _null(-math.inf)] = -math.inf
    high_m: NumberOrInf = math.inf
    slow_std_mm: Std = 0.0
    slow_time_s: StdOrInf = math.inf
    slow_hz: Std = 0.0
    exposure_s: Duration = 0.0
    apart_std_mm: Std = 0.0
    scale: Factor = 1.0
    scale_std: Std = 0.0
    clock_rate: Number = 0.0
    clock_reference_s: Number = 0.0
    unseen_drift_mm: StdOrInf = 0.0
    unseen_step_mm: StdOrInf = 0.0
    unseen_gap_mm: StdOrInf = 0.0

    def record(self, _kind: str) -> DisplacementCalibration:
        """The displacement sensor."""
        return DisplacementCalibration(**self.values(DisplacementCalibration))

    @staticmethod
    def summary(sensor: DisplacementCalibration) -> str:
        """Noise, scale where it was estimated, and clock offset."""
        scale = "" if sensor.scale == 1.0 else f", scale {sensor.scale:.5g} ± {sensor.scale_std:.2g}"
        return f"noise {1e3 * sensor.noise_std_m:.3g} mm{scale}, {_offset(sensor.offset)}"

    @staticmethod
    def rows(sensor: DisplacementCalibration) -> list[tuple[str, str]]:
        """The values that the report lists."""
        scale = f"{sensor.scale:.5g} ± {sensor.scale_std:.2g} ({100 * sensor.relative_std:.2g} %), estimated"
        return [
            ("noise", f"{1e3 * sensor.noise_std_m:.4g} mm a measurement"),
            ("clock offset", offset_words(sensor.offset)),
            *([("scale", scale)] if sensor.scale_std > 0.0 else []),
        ]


class StoredNotice(Stored):
    """A warning with its code."""

    code: Text
    severity: Text
    text: Text
