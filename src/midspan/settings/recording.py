"""The whole tree of `recording.toml`: its sensors, the calibration and the fusion."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from midspan.checks import RATE_HZ
from midspan.fusion.methods import LITERAL, METHODS, no_literal_form
from midspan.settings.camera import CameraSettings, InfraredSettings
from midspan.settings.fields import (
    IsNumber,
    Section,
    Time,
    known,
    limited,
    second_is_larger,
)
from midspan.settings.sensors import AccelerometerSettings, DisplacementSettings, RadarSettings, ReferenceSettings

Frequency = Annotated[float, IsNumber, limited(0.0, RATE_HZ.high, "Hz")]


class CalibrationSettings(Section):
    """How scale factor and clock offset are found."""

    window_s: Annotated[tuple[Time, Time] | None, AfterValidator(second_is_larger)] = Field(
        None, description="start and end of the part used, s on the accelerometer's clock; left out: the first minute"
    )
    band_hz: Annotated[tuple[Frequency, Frequency] | None, AfterValidator(second_is_larger)] = Field(
        None,
        description="band of acceleration compared with the camera, Hz; left out: all that rates and noise allow",
    )
    max_offset_s: Annotated[float, IsNumber, Field(ge=0, le=3600)] = Field(
        0.5,
        description="largest clock offset searched for, s; a larger one finds clocks farther apart and is refused more "
        "often as ambiguous",
    )


class FusionSettings(Section):
    """How acceleration and displacement become one."""

    method: Annotated[str, known(METHODS, "method")] = Field("smoother", description="see `midspan methods`")
    lag_s: Annotated[float, IsNumber, limited(1e-6, 3600.0, "s")] = Field(
        0.5, description="delay of the method `lag`, s; longer is nearer to the smoother"
    )
    literal: bool = Field(False, strict=True, description="a paper's method as printed, without guard; radar too")
    switching: Literal["variance", "matches"] = Field(
        "variance", description="how two cameras are believed: both by their variances, or the one with more matches"
    )
    forgetting: Annotated[float, IsNumber, Field(gt=0, lt=1)] = Field(
        0.95, description="factor beta of `adaptive-kalman`; nearer to 1 learns more slowly"
    )

    @model_validator(mode="after")
    def _has_a_literal_form(self) -> "FusionSettings":
        if self.literal and self.method not in LITERAL:
            raise ValueError(no_literal_form(self.method))
        return self


class SiteSettings(Section):
    """Where the structure stands: tells day from night where stamps are dates."""

    latitude_deg: Annotated[float, IsNumber, Field(ge=-90, le=90)] = Field(description="degrees, north positive")
    longitude_deg: Annotated[float, IsNumber, Field(ge=-180, le=180)] = Field(description="degrees, east positive")


class RecordingSettings(Section):
    """The whole of `recording.toml`."""

    name: str = Field("", description="what reports call the recording; left out: its folder's name")
    accelerometer: AccelerometerSettings | None = None
    camera: CameraSettings | None = None
    infrared: InfraredSettings | None = None
    radar: RadarSettings | None = None
    displacement: DisplacementSettings | None = None
    calibration: CalibrationSettings = Field(default_factory=lambda: CalibrationSettings.model_validate({}))
    fusion: FusionSettings = Field(default_factory=lambda: FusionSettings.model_validate({}))
    reference: ReferenceSettings | None = None
    site: SiteSettings | None = None

    @model_validator(mode="after")
    def _has_displacement(self) -> "RecordingSettings":
        if self.accelerometer is None:
            # A camera alone can be tracked and looked at.
            if self.first_camera is None:
                raise ValueError(
                    "must have [accelerometer]; only a recording with [camera] or [infrared] can do without"
                )
            return self
        if self.first_camera is None and self.radar is None and self.displacement is None:
            raise ValueError("must have [camera], [infrared], [radar] or [displacement] beside [accelerometer]")
        return self

    @model_validator(mode="after")
    def _both_axes_have_columns(self) -> "RecordingSettings":
        both = self.first_camera is not None and self.first_camera.direction == "xy"
        if self.accelerometer is None:
            return self
        named = self.accelerometer.value_x or self.accelerometer.value_y
        if both and not named:
            raise ValueError(
                'must name accelerometer.value_x, accelerometer.value_y or both with camera.direction = "xy": the '
                "columns along the image's axes"
            )
        if named and not both:
            raise ValueError(
                'must have camera.direction = "xy" with accelerometer.value_x or value_y; for one axis give '
                "accelerometer.value"
            )
        return self

    @model_validator(mode="after")
    def _two_cameras_measure_one_axis(self) -> "RecordingSettings":
        if self.camera is None or self.infrared is None:
            return self
        if "xy" in (self.camera.direction, self.infrared.direction):
            raise ValueError(
                'must have direction = "x" or "y" in [camera] and [infrared] where there are both; "xy" is for one of '
                "them alone"
            )
        return self

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
        return ("y", "x") if self.accelerometer is not None and self.accelerometer.value_y else ("x", "y")
