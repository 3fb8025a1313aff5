"""Settings of cameras: what they look at, how it is tracked, their lens, and what a thermal camera has besides."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from midspan.checks import ValueRange
from midspan.errors import UsageError
from midspan.records import ScaleFactor
from midspan.settings.fields import (
    Duration,
    FileName,
    FiniteNumber,
    Form,
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

ROI = Form("4 whole numbers, px")
Celsius = Annotated[float, IsNumber, limited(-273.15, 1e5, "°C")]
TARGET_M = ValueRange(1e-3, 1e6, "m")
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


def _distance(value: object) -> object:
    """A distance in m, or the word for one at which only a rotation shows."""
    if value == "far":
        return value
    if not isinstance(value, int | float) or isinstance(value, bool) or value not in TARGET_M:
        raise ValueError(f'must be a number {TARGET_M}, or "far"')
    return float(value)


class TargetSettings(Section):
    """One of several targets of a camera."""

    roi: Annotated[tuple[int, int, int, int], AfterValidator(region_is_positive), ROI] = Field(
        description="x, y of the upper left corner, width, height"
    )
    name: SensorName | None = Field(None, description="name in reports, warnings and columns; default: its number")
    distance_m: Annotated[float | Literal["far"], BeforeValidator(_distance), Form('number, m, or "far"')] | None = (
        Field(
            None,
            description="distance from the camera, far: only rotation moves it; different ones attribute slow common "
            "motion to tilt",
        )
    )
    distance_std_m: Annotated[float, IsNumber, limited(0.0, 1e6, "m")] = Field(
        0.0, description="σ of distance_m; two distances within it count as equal"
    )

    @property
    def inverse_distance(self) -> tuple[float, float] | None:
        """One over its distance and its standard deviation, 1/m; 0: far; None: unknown."""
        if self.distance_m is None:
            return None
        if isinstance(self.distance_m, str):
            return 0.0, 0.0
        return 1.0 / self.distance_m, self.distance_std_m / self.distance_m**2

    @model_validator(mode="after")
    def _has_a_distance(self) -> "TargetSettings":
        if self.distance_std_m > 0.0 and not isinstance(self.distance_m, float):
            raise ValueError("must have distance_m in m together with distance_std_m")
        return self


class LensSettings(Section):
    """The camera's lens in OpenCV's models: a file that `midspan lens` wrote, or the numbers themselves."""

    file: FileName | None = Field(None, description="lens.json from `midspan lens`, instead of all other keys")
    model: Annotated[str, known(LENS_MODELS, "lens model")] = Field(
        "pinhole", description="OpenCV's camera model; fisheye is for more than about 120°"
    )
    matrix: Annotated[tuple[FiniteNumber, ...] | None, AfterValidator(has_four), Form("4 numbers, px")] = Field(
        None, description="fx, fy, cx, cy; the centre of the first pixel is 0, 0"
    )
    distortion: Annotated[tuple[FiniteNumber, ...] | None, Form("4, 5, 8 or 12 numbers")] = Field(
        None, description="pinhole: k1, k2, p1, p2 and k3 … k6, s1 … s4 in OpenCV's order; fisheye: k1 … k4"
    )
    size: Annotated[tuple[int, int] | None, Form("2 whole numbers, px")] = Field(
        None, description="width and height of the calibration images; must equal those of the recording"
    )

    @model_validator(mode="after")
    def _is_whole(self) -> "LensSettings":
        given = [name for name in ("model", "matrix", "distortion", "size") if name in self.model_fields_set]
        if self.file is not None and given:
            raise ValueError(f"must have either file or the numbers; remove {', '.join(given)}")
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

    name: SensorName | None = Field(None, description="name of the sensor; needed if there are several of a kind")
    file: FileName = Field(
        description="video, folder or glob of images, multi-page TIFF, .npy or .npz stack, or table of a track"
    )
    times: FileName | None = Field(
        None, description="file with a column time_s, one row per frame; overrides all other times"
    )
    rate_hz: Rate | None = Field(
        None, description="frame rate, if the file has no time stamps; overrides a declared slow-motion rate"
    )
    start_s: Time = Field(
        0.0,
        description="added to the container's time stamps; with rate_hz: time of the first frame; ignored with times",
    )
    every: Annotated[int, IsNumber, Field(ge=1, le=1_000_000)] = Field(
        1, description="use every n-th frame; higher is faster and noisier"
    )
    roi: Annotated[tuple[int, int, int, int] | None, AfterValidator(region_is_positive), ROI] = Field(
        None,
        description="x, y of the upper left corner, width, height of the textured target; default: automatic",
    )
    target: tuple[TargetSettings, ...] = Field((), description="several targets instead of roi, each with its own roi")
    automatic_targets: Annotated[int, IsNumber, Field(ge=1, le=6)] = Field(
        1, description="number of targets to select if none is given; more is more robust and slower"
    )
    direction: Literal["x", "y", "xy"] = Field(
        "y", description="image axis of the measured motion: x right, y down, or both"
    )
    exposure_s: Duration | None = Field(
        None,
        description="exposure time, whose averaging is corrected; default: estimated if observable, else included in "
        "the scale's σ",
    )
    readout_s: Duration = Field(0.0, description="rolling shutter: readout time from first to last row")
    scale_mm_per_px: Annotated[float, IsNumber, limited(-1e6, 1e6, "mm/px")] | None = Field(
        None,
        description="displacement per pixel, signed, if known (one target, one axis); default: calibrated",
    )
    scale_std_mm_per_px: Annotated[float, IsNumber, limited(0.0, 1e6, "mm/px")] = Field(
        0.0, description="σ of scale_mm_per_px; more widens the band in proportion to the displacement"
    )
    tilt_std_mdeg: Annotated[float, IsNumber, limited(0.0, 1e5, "mdeg")] = Field(
        0.0,
        description="σ of the camera's tilt; times distance_m it widens the band",
    )
    distance_m: Annotated[float, IsNumber, limited(1e-3, 1e6, "m")] | None = Field(
        None,
        description="distance to the (farthest) target, for tilt_std_mdeg and the check of the scale factor",
    )
    focal_length_mm: Annotated[float, IsNumber, limited(1e-2, 1e5, "mm")] | None = Field(
        None, description="focal length; with pixel_pitch_um and distance_m it checks the scale factor"
    )
    pixel_pitch_um: Annotated[float, IsNumber, limited(1e-2, 1e3, "µm")] | None = Field(
        None, description="pixel pitch on the image sensor at the video's resolution"
    )
    tracker: Annotated[str, known(TRACKERS, "tracker")] = Field(
        DEFAULT_TRACKER, description="tracking method; see `midspan methods`"
    )
    tracker_settings: Annotated[dict[str, Any], Form("table")] = Field(
        default_factory=dict,
        description="settings of this tracker (docs/trackers.md); ignored with another --tracker",
    )
    lens: LensSettings | None = Field(None, description="lens distortion that is corrected")
    reference: Literal["first", "key-frames", "updating"] | None = Field(
        None,
        description="reference frame: the first, several overlapping key frames, or replaced as published; default: "
        "first",
    )
    reference_settings: Annotated[dict[str, Any], Form("table")] = Field(
        default_factory=dict,
        description='of reference = "updating": literal (false), threshold_frames (30), average_frames (10), sigmas '
        "(2), least_matches (10)",
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
            raise ValueError("must not have automatic_targets together with roi or [[camera.target]]")
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
                "must have distance_m (m from camera to target) or a section lens together with tilt_std_mdeg: the "
                "error of a tilt is proportional to the distance"
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

    file: FileName = Field(
        description="stack in °C (.npz, .npy), 16-bit TIFF or PNG, FLIR .seq .csq .fff, radiometric .jpg"
    )
    reference: Literal["first", "key-frames", "updating"] | None = Field(
        None,
        description="reference frame: the first, several overlapping key frames, or replaced as published; default: "
        "key-frames",
    )
    temperature_range_c: Annotated[
        tuple[Celsius, Celsius] | None, AfterValidator(second_is_larger), Form("2 numbers, rising, °C")
    ] = Field(
        None,
        description="temperatures of grey levels 0 and 255; default: unscaled temperatures, for features an "
        "optimised range",
    )
    range_divisions: Annotated[int, IsNumber, Field(ge=1, le=64)] = Field(
        DIVISIONS,
        description="divisions M between the ranges of region and view; (M + 1)² ranges are tried; more is slower",
    )
    kelvin_per_count: Annotated[float, IsNumber, limited(1e-9, 1e3, "K a count")] | None = Field(
        None, description="temperature of one count of 16-bit images; default: estimated from the images"
    )
    zero_k: Annotated[float, IsNumber, limited(-1e6, 1e6, "K")] = Field(
        0.0, description="temperature of count 0 of 16-bit images"
    )
    emissivity: Annotated[float, IsNumber, Field(gt=0, le=1)] | None = Field(
        None,
        description="emissivity of the target; lower moves temperatures away from the ambient one; default: that of "
        "the FLIR file",
    )

    @property
    def reference_rule(self) -> str:
        """How the reference frame is kept: "first", "key-frames" or "updating"."""
        return self.reference or "key-frames"
