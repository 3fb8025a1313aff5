"""The sections of `calibration.json` of cameras: their targets, axes and scale factors."""

import dataclasses
import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from midspan.calibration.sensors.camera import CameraCalibration, TargetCalibration
from midspan.errors import UsageError
from midspan.records import Region, ScaleFactor, Source
from midspan.settings.camera import Celsius
from midspan.settings.fields import Duration, Form, region_is_positive, second_is_larger
from midspan.settings.stored.sections import (
    MM,
    Factor,
    Noise,
    Number,
    Ratio,
    Std,
    StdOrInf,
    Stored,
    StoredAccelerometer,
    StoredSensor,
    Text,
    Yes,
    null,
    offset_summary,
    offset_words,
)
from midspan.vision.lens import Lens

Whole = Annotated[int, Field(strict=True)]
Roi = Annotated[tuple[Whole, Whole, Whole, Whole], AfterValidator(region_is_positive)]


def _lens(value: Any) -> Lens | None:
    try:
        return None if value is None else Lens.from_dict(value)
    except (KeyError, TypeError, ValueError, OverflowError, UsageError) as error:
        raise ValueError(f"is no lens: {error}".rstrip(".")) from None


class StoredTarget(Stored):
    """One target of a camera; one that is not used may lack what was not estimated of it."""

    name: Text | None = Field(None, description="of the target")
    roi: Roi = Field(description="its region")
    scale_mm_per_px: Factor | None = Field(None, description="scale factor of this target")
    scale_std_mm_per_px: Std | None = Field(0.0, description="its σ")
    noise_std_px: Annotated[Noise, null(math.nan)] = Field(math.nan, description="noise of one frame's translation")
    variance_factor: Annotated[Ratio, null(math.nan)] = Field(
        math.nan, description="estimated variance over the tracker's own"
    )
    used: Yes = Field(True, description="whether it counts")
    reason: Text = Field("", description="why not")
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

    fields: ClassVar = {"targets": ""}
    scale_mm_per_px: Factor = Field(description="scale factor of the target with the least noise in mm, signed")
    scale_std_mm_per_px: Std = Field(0.0, description="its σ")
    relative_scale_std: Std | None = Field(None, description="relative σ of all targets' scale factors together")
    phase_scale_mm_per_rad: Factor | None = Field(
        None, description="displacement per mean phase of the active pixels (trackers phase and hybrid)"
    )
    apart_std_mm: Std = Field(
        0.0, description="unexplained difference from the accelerometer (rms), included in the band"
    )
    slow_std_mm: Std = Field(0.0, description="σ of its slow error; 0: white noise only")
    slow_time_s: StdOrInf = Field(math.inf, description="correlation time of the slow error")
    slow_hz: Std = Field(0.0, description="frequency of the slow error; 0: first-order Gauss-Markov")
    tilt_std_px: Std = Field(0.0, description="σ of the tilt that the targets show; 0: none")
    tilt_walk_px2_s: Std = Field(0.0, description="density of the tilt's random walk, px²/s")
    tilt_of: Text = Field("", description="camera on the same box whose tilt that is; empty: its own")
    tilt_ratio: Factor = Field(1.0, description="pixels of this camera for a pixel of that one by a tilt, signed")
    noise_std_px: Noise = Field(0.02, description="noise of one frame's translation")
    variance_factor: Ratio = Field(1.0, description="estimated variance over the tracker's own")
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


class StoredCamera(StoredSensor, StoredScale):
    """A camera of light or infrared."""

    fields: ClassVar = {"targets": "", "axis": "", "axes": ""}
    roi: Roi = Field(description="region that was tracked, used by `estimate -c` unless the recording names another")
    direction: Literal["x", "y", "xy"] = Field("y", description="as in the recording")
    axis: Literal["x", "y"] | None = Field(None, description="with both axes: that of the main columns")
    axes: Annotated[StoredAxes | None, Form("section")] = Field(
        None,
        description="with both axes: x and y, each with fused, the keys of a scale, and accelerometer_… for the "
        "accelerometer's",
    )
    left_out: Literal["", "x", "y"] = Field(
        "", description="second axis that could not be estimated; the result then has one"
    )
    tracker: Text = Field("template", description="as in the recording")
    lens: Annotated[Lens | None, BeforeValidator(_lens)] = Field(
        None, description="lens that corrected the pixels, with the keys of [camera.lens]; another lens is refused"
    )
    temperature_range_c: Annotated[tuple[Celsius, Celsius] | None, AfterValidator(second_is_larger)] = Field(
        None, description="infrared: input of the tracker"
    )
    exposure_s: Duration = Field(0.0, description="exposure estimated from the motion, if none was declared")
    literal: Yes = Field(
        False, description="as printed; standard deviations then include the difference from the likelihood's values"
    )

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
        return f"{value:.5g} ± {std:.2g} mm/px along {camera.direction}, {offset_summary(camera.offset)}"

    @staticmethod
    def rows(camera: CameraCalibration) -> list[tuple[str, str]]:
        """The values that the report lists."""
        value, std = 1e3 * camera.scale.value_m_per_px, 1e3 * math.sqrt(camera.scale.variance)
        region, seen = camera.region, camera.temperature_range_c
        return [
            ("scale factor", f"{value:.6g} ± {std:.2g} mm/px ({100 * std / abs(value):.2g} %)"),
            ("clock offset", offset_words(camera.offset)),
            ("noise", f"{camera.noise_std_px:.3g} px ({abs(value) * camera.noise_std_px:.3g} mm) per frame"),
            ("variance factor", f"{camera.variance_factor:.3g}"),
            ("region", f"x {region.x}, y {region.y}, {region.width} × {region.height} px"),
            *([("temperature range", f"{seen[0]:.2f} … {seen[1]:.2f} °C")] if seen else []),
            ("direction, tracker", f"{camera.direction}, {camera.tracker}"),
        ]
