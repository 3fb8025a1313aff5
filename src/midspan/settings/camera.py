"""Settings of cameras: what they look at, how it is tracked, their lens, and what a thermal camera has besides."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from midspan.errors import UsageError
from midspan.records import ScaleFactor
from midspan.settings.fields import (
    Duration,
    FileName,
    FiniteNumber,
    IsNumber,
    Rate,
    Section,
    SensorName,
    Time,
    has_four,
    known,
    limited,
    region_is_positive,
    second_is_larger,
)
from midspan.thermal.temperature_range import DIVISIONS
from midspan.vision.lens import MODELS as LENS_MODELS
from midspan.vision.lens import Lens
from midspan.vision.tracker import DEFAULT_TRACKER, TRACKERS, UPDATING, tracker_settings

Celsius = Annotated[float, IsNumber, limited(-273.15, 1e5, "°C")]
# Settings of trackers are pixels, shares and counts; each tracker has rules of its own within this.
MAX_TRACKER_SETTING = 1e9


@contextmanager
def _in_words_of(section: str, values: Mapping[str, Any]) -> Iterator[None]:
    """What a tracker or its rule refuses of a section's values, as a message of the section."""
    for key, value in values.items():
        if isinstance(value, int | float) and not abs(value) <= MAX_TRACKER_SETTING:
            raise ValueError(f"{section}: {key} must be a number up to {MAX_TRACKER_SETTING:g}")
    try:
        yield
    except UsageError as error:
        raise ValueError(f"{section}: {error}".rstrip(".")) from None


class TargetSettings(Section):
    """One of several targets of a camera."""

    roi: Annotated[tuple[int, int, int, int], AfterValidator(region_is_positive)] = Field(
        description="x, y, width, height, px"
    )
    name: SensorName | None = Field(None, description="what reports and columns call it; left out: its number")


class LensSettings(Section):
    """The camera's lens in OpenCV's models: a file that `midspan lens` wrote, or the numbers themselves."""

    file: FileName | None = Field(None, description="lens.json of `midspan lens`, instead of all other keys")
    model: Annotated[str, known(LENS_MODELS, "lens model")] = Field("pinhole", description="OpenCV's lens model")
    matrix: Annotated[tuple[FiniteNumber, ...] | None, AfterValidator(has_four)] = Field(
        None, description="fx, fy, cx, cy, px"
    )
    distortion: tuple[FiniteNumber, ...] | None = Field(
        None, description="k1, k2, p1, p2[, k3 …] of a pinhole; k1, k2, k3, k4 of a fisheye"
    )
    size: tuple[int, int] | None = Field(None, description="width, height of the frames it was calibrated for, px")

    @model_validator(mode="after")
    def _is_whole(self) -> "LensSettings":
        given = [name for name in ("model", "matrix", "distortion", "size") if name in self.model_fields_set]
        if self.file is not None and given:
            raise ValueError(f"must have file or the numbers, not both; take file or {', '.join(given)} out")
        if self.file is None and (missing := {"matrix", "distortion", "size"} - set(given)):
            raise ValueError(f"must have file, or matrix, distortion and size; missing: {', '.join(sorted(missing))}")
        if self.file is None:
            try:
                self.lens()
            except UsageError as error:
                raise ValueError(str(error).rstrip(".")) from None
        return self

    def lens(self) -> Lens:
        """The lens that the numbers stand for."""
        fx, fy, cx, cy = self.matrix or ()
        return Lens(self.model, (fx, fy, cx, cy), self.distortion or (), self.size or (0, 0))


class CameraSettings(Section):
    """A camera: on the structure, looking at fixed surroundings, or on a tripod, looking at the structure."""

    name: SensorName | None = Field(None, description="what it is called where there are several of a kind")
    file: FileName
    times: FileName | None = Field(None, description="file with a column time_s, one row a frame")
    rate_hz: Rate | None = Field(None, description="frames a second, where the file has no time stamps")
    start_s: Time = Field(0.0, description="time of the first frame, s")
    every: Annotated[int, IsNumber, Field(ge=1, le=1_000_000)] = Field(
        1, description="use every n-th frame; higher is faster"
    )
    roi: Annotated[tuple[int, int, int, int] | None, AfterValidator(region_is_positive)] = Field(
        None, description="x, y, width, height, px; left out: chosen"
    )
    target: tuple[TargetSettings, ...] = Field((), description="several targets instead of roi, each with its own roi")
    automatic_targets: Annotated[int, IsNumber, Field(ge=1, le=6)] = Field(
        1, description="how many targets are chosen where none is given; more is steadier and slower"
    )
    direction: Literal["x", "y", "xy"] = Field(
        "y", description="image axis of the measured motion: x right, y down, or both"
    )
    exposure_s: Duration | None = Field(None, description="exposure time, s; its averaging is corrected")
    readout_s: Duration = Field(0.0, description="rolling shutter: seconds from first to last row")
    scale_mm_per_px: Annotated[float, IsNumber, limited(-1e6, 1e6, "mm/px")] | None = Field(
        None, description="displacement for one pixel, signed, of a target of known size; left out: calibrated"
    )
    scale_std_mm_per_px: Annotated[float, IsNumber, limited(0.0, 1e6, "mm/px")] = Field(
        0.0, description="its standard deviation, mm/px; more widens the band as the motion grows"
    )
    tilt_std_mdeg: Annotated[float, IsNumber, limited(0.0, 1e5, "mdeg")] = Field(
        0.0, description="standard deviation of the camera's own tilt, mdeg, in the band; 0: not in it"
    )
    distance_m: Annotated[float, IsNumber, limited(1e-3, 1e6, "m")] | None = Field(
        None, description="from camera to target, for tilt_std_mdeg; left out: from lens and scale factor"
    )
    focal_length_mm: Annotated[float, IsNumber, limited(1e-2, 1e5, "mm")] | None = Field(
        None, description="of the lens; with pixel_pitch_um and distance_m the scale factor is checked"
    )
    pixel_pitch_um: Annotated[float, IsNumber, limited(1e-2, 1e3, "µm")] | None = Field(
        None, description="from pixel to pixel on the image sensor, at the video's resolution"
    )
    tracker: Annotated[str, known(TRACKERS, "tracker")] = Field(DEFAULT_TRACKER, description="how the target is found")
    tracker_settings: dict[str, Any] = Field(
        default_factory=dict,
        description="settings of the tracker by name, see docs/trackers.md; left out: its defaults",
    )
    lens: LensSettings | None = Field(None, description="the lens's distortion; left out: none is corrected")
    reference: Literal["first", "key-frames", "updating"] | None = Field(
        None, description="the frame that each one is compared with: the first, several, or a new one; left out: first"
    )
    reference_settings: dict[str, Any] = Field(
        default_factory=dict,
        description='settings of reference = "updating" by name, see docs/infrared.md; left out: its defaults',
    )

    @property
    def reference_rule(self) -> str:
        """How the reference frame is kept: "first", "key-frames" or "updating"."""
        return self.reference or "first"

    @model_validator(mode="after")
    def _is_whole(self) -> "CameraSettings":
        names, rois = self.target_names, [target.roi for target in self.target]
        if self.roi is not None and self.target:
            raise ValueError("must have roi for one target or [[camera.target]] for several, not both")
        if self.automatic_targets > 1 and (self.roi is not None or self.target):
            raise ValueError("must leave automatic_targets out where roi or [[camera.target]] says what to track")
        if len(set(names)) < len(names):
            raise ValueError(f"must give each [[camera.target]] its own name; received {', '.join(names)}")
        if len(set(rois)) < len(rois):
            raise ValueError("must give each [[camera.target]] its own roi; two are the same")
        optics = (self.focal_length_mm, self.pixel_pitch_um)
        if any(optics) and not (all(optics) and self.distance_m):
            raise ValueError("must have focal_length_mm, pixel_pitch_um and distance_m together: they give mm/px")
        if self.scale_mm_per_px is None and self.scale_std_mm_per_px > 0.0:
            raise ValueError("must have scale_mm_per_px together with scale_std_mm_per_px")
        if self.scale_mm_per_px == 0.0:
            raise ValueError("must have a scale_mm_per_px other than 0")
        one_axis = self.direction != "xy" and len(self.target) <= 1 and self.automatic_targets == 1
        if self.scale_mm_per_px is not None and not one_axis:
            raise ValueError('must have one target and direction = "x" or "y" together with scale_mm_per_px')
        if self.tilt_std_mdeg > 0.0 and self.distance_m is None and self.lens is None:
            raise ValueError(
                "must have distance_m, the metres from camera to target, or a section lens with the focal length, "
                "together with tilt_std_mdeg: what a tilt makes of the displacement grows with the distance"
            )
        if self.tracker_settings:
            with _in_words_of("tracker_settings", self.tracker_settings):
                tracker_settings(self.tracker, **self.tracker_settings)
        if self.reference_settings:
            if self.reference_rule != "updating":
                raise ValueError('must have reference = "updating" together with reference_settings')
            with _in_words_of("reference_settings", self.reference_settings):
                import_module(UPDATING).updating_settings(self.tracker, None, self.reference_settings)
        return self

    def as_printed(self) -> Self:
        """The same with the tracker as printed where it has such a form, and the settings do not say otherwise."""
        if not hasattr(tracker_settings(self.tracker), "literal"):
            return self
        return self.model_copy(update={"tracker_settings": {"literal": True, **self.tracker_settings}})

    @property
    def known_scale(self) -> ScaleFactor | None:
        """The scale factor that is known beforehand."""
        if self.scale_mm_per_px is None:
            return None
        return ScaleFactor(1e-3 * self.scale_mm_per_px, (1e-3 * self.scale_std_mm_per_px) ** 2)

    @property
    def target_names(self) -> tuple[str, ...]:
        """The name of each target that is given; its number where it has none."""
        return tuple(target.name or str(number) for number, target in enumerate(self.target, start=1))


class InfraredSettings(CameraSettings):
    """A thermal camera on the structure that looks at fixed surroundings: its temperatures too."""

    reference: Literal["first", "key-frames", "updating"] | None = Field(
        None, description="the frame that each is compared with: the first, several, or a new one; left out: several"
    )
    temperature_range_c: Annotated[tuple[Celsius, Celsius] | None, AfterValidator(second_is_larger)] = Field(
        None, description="°C shown in 256 grey levels; left out: temperatures as they are, or optimised for features"
    )
    range_divisions: Annotated[int, IsNumber, Field(ge=1, le=64)] = Field(
        DIVISIONS, description="equal parts M between region and whole view that ranges are made of; more is slower"
    )
    kelvin_per_count: Annotated[float, IsNumber, limited(1e-9, 1e3, "K a count")] | None = Field(
        None, description="K a count of 16-bit pictures; left out: as the file says"
    )
    zero_k: Annotated[float, IsNumber, limited(-1e6, 1e6, "K")] = Field(
        0.0, description="temperature of count 0 of 16-bit pictures, K"
    )
    emissivity: Annotated[float, IsNumber, Field(gt=0, le=1)] | None = Field(
        None, description="of the target, 0 to 1; left out: the one in a FLIR file"
    )

    @property
    def reference_rule(self) -> str:
        """How the reference frame is kept: "first", "key-frames" or "updating"."""
        return self.reference or "key-frames"
