"""One validated settings tree: `recording.toml` and nothing else decides what a run does.

Every message names the file, the key, the rule with its unit, the value received and the remedy.
"""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from midspan.checks import nearest, option
from midspan.errors import DataError, UsageError
from midspan.fusion.methods import LITERAL, METHODS, no_literal_form
from midspan.vision.lens import MODELS as LENS_MODELS
from midspan.vision.lens import Lens
from midspan.vision.tracker import DEFAULT_TRACKER, TRACKERS, tracker_settings

RECORDING_FILE = "recording.toml"
# Sections that every recording has, written or not.
OPTIONAL_SECTIONS = ("calibration", "fusion")


def _number(value: object) -> object:
    """A number of TOML: neither a text nor true or false is one."""
    if isinstance(value, bool | str):
        raise ValueError("must be a number")
    return value


IsNumber = BeforeValidator(_number)

PositiveNumber = Annotated[float, IsNumber, Field(gt=0, allow_inf_nan=False)]
NonNegativeNumber = Annotated[float, IsNumber, Field(ge=0, allow_inf_nan=False)]
FiniteNumber = Annotated[float, IsNumber, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1)]


def _region_is_positive(value: tuple[int, int, int, int] | None) -> tuple[int, int, int, int] | None:
    if value is not None and (min(value[:2]) < 0 or min(value[2:]) < 1):
        raise ValueError("must be x, y >= 0 and width, height >= 1, in px")
    return value


def _is_a_word(value: str | None) -> str | None:
    if value is not None and not (value.isascii() and value.replace("-", "_").replace("_", "a").isalnum()):
        raise ValueError("must be a word of letters, digits, _ or -, as it becomes part of columns' names")
    return value


def _has_four(value: tuple[float, ...] | None) -> tuple[float, ...] | None:
    if value is not None and len(value) != 4:
        raise ValueError("must be four numbers, fx, fy, cx, cy, in px")
    return value


def _second_is_larger(value: tuple[float, float] | None) -> tuple[float, float] | None:
    if value is not None and value[1] <= value[0]:
        raise ValueError("must be two numbers, the second larger")
    return value


def _known(table: dict[str, Any], kind: str) -> AfterValidator:
    def check(value: str) -> str:
        if value not in table:
            raise ValueError(f"must be one of {', '.join(table)} ({kind}s of this version). {nearest(value, table)}")
        return value

    return AfterValidator(check)


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ChannelSettings(_Section):
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


class TargetSettings(_Section):
    """One of several targets of a camera."""

    roi: Annotated[tuple[int, int, int, int], AfterValidator(_region_is_positive)] = Field(
        description="x, y, width, height, px"
    )
    name: Annotated[str | None, AfterValidator(_is_a_word)] = Field(
        None, description="what reports and columns call it; left out: its number"
    )


class LensSettings(_Section):
    """The camera's lens in OpenCV's models: a file that `midspan lens` wrote, or the numbers themselves."""

    file: Name | None = Field(None, description="lens.json of `midspan lens`, instead of all other keys")
    model: Annotated[str, _known(LENS_MODELS, "lens model")] = Field("pinhole", description="OpenCV's lens model")
    matrix: Annotated[tuple[FiniteNumber, ...] | None, AfterValidator(_has_four)] = Field(
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


class CameraSettings(_Section):
    """A camera on the structure that looks at fixed surroundings."""

    file: Name
    times: Name | None = Field(None, description="file with a column time_s, one row a frame")
    rate_hz: PositiveNumber | None = Field(None, description="frames a second, where the file has no time stamps")
    start_s: FiniteNumber = Field(0.0, description="time of the first frame, s")
    every: Annotated[int, IsNumber, Field(ge=1)] = Field(1, description="use every n-th frame; higher is faster")
    roi: Annotated[tuple[int, int, int, int] | None, AfterValidator(_region_is_positive)] = Field(
        None, description="x, y, width, height, px; left out: chosen"
    )
    target: tuple[TargetSettings, ...] = Field((), description="several targets instead of roi, each with its own roi")
    automatic_targets: Annotated[int, IsNumber, Field(ge=1, le=6)] = Field(
        1, description="how many targets are chosen where none is given; more is steadier and slower"
    )
    direction: Literal["x", "y", "xy"] = Field(
        "y", description="image axis of the measured motion: x right, y down, or both"
    )
    exposure_s: NonNegativeNumber | None = Field(None, description="exposure time, s; its averaging is corrected")
    readout_s: NonNegativeNumber = Field(0.0, description="rolling shutter: seconds from first to last row")
    tracker: Annotated[str, _known(TRACKERS, "tracker")] = Field(DEFAULT_TRACKER, description="how the target is found")
    tracker_settings: dict[str, Any] = Field(
        default_factory=dict, description="settings of the tracker by name, see docs/methods.md; left out: its defaults"
    )
    lens: LensSettings | None = Field(None, description="the lens's distortion; left out: none is corrected")

    @model_validator(mode="after")
    def _targets_are_told_apart(self) -> "CameraSettings":
        if self.roi is not None and self.target:
            raise ValueError("must have roi for one target or [[camera.target]] for several, not both")
        if self.automatic_targets > 1 and (self.roi is not None or self.target):
            raise ValueError("must leave automatic_targets out where roi or [[camera.target]] says what to track")
        names = self.target_names
        if len(set(names)) < len(names):
            raise ValueError(f"must give each [[camera.target]] its own name; received {', '.join(names)}")
        rois = [target.roi for target in self.target]
        if len(set(rois)) < len(rois):
            raise ValueError("must give each [[camera.target]] its own roi; two are the same")
        return self

    @model_validator(mode="after")
    def _tracker_knows_its_settings(self) -> "CameraSettings":
        if self.tracker_settings:
            try:
                tracker_settings(self.tracker, **self.tracker_settings)
            except UsageError as error:
                raise ValueError(f"tracker_settings: {error}".rstrip(".")) from None
        return self

    @property
    def target_names(self) -> tuple[str, ...]:
        """The name of each target that is given; its number where it has none."""
        return tuple(target.name or str(number) for number, target in enumerate(self.target, start=1))


class CalibrationSettings(_Section):
    """How scale factor and clock offset are found."""

    window_s: Annotated[tuple[FiniteNumber, FiniteNumber] | None, AfterValidator(_second_is_larger)] = Field(
        None, description="start and end of the part used, s on the accelerometer's clock; left out: the first minute"
    )
    band_hz: Annotated[tuple[NonNegativeNumber, PositiveNumber] | None, AfterValidator(_second_is_larger)] = Field(
        None,
        description="band of acceleration compared with the camera, Hz; left out: all that rates and noise allow",
    )
    max_offset_s: Annotated[float, IsNumber, Field(ge=0, le=3600)] = Field(
        0.5, description="largest clock offset searched for, s"
    )


class FusionSettings(_Section):
    """How acceleration and displacement become one."""

    method: Annotated[str, _known(METHODS, "method")] = Field("smoother", description="see `midspan methods`")
    lag_s: PositiveNumber = Field(0.5, description="delay of the method `lag`, s; longer is nearer to the smoother")
    literal: bool = Field(False, strict=True, description="a paper's method exactly as printed, without guard")
    forgetting: Annotated[float, IsNumber, Field(gt=0, lt=1)] = Field(
        0.95, description="factor beta of `adaptive-kalman`; nearer to 1 learns more slowly"
    )

    @model_validator(mode="after")
    def _has_a_literal_form(self) -> "FusionSettings":
        if self.literal and self.method not in LITERAL:
            raise ValueError(no_literal_form(self.method))
        return self


class RecordingSettings(_Section):
    """The whole of `recording.toml`."""

    name: str = ""
    accelerometer: AccelerometerSettings
    camera: CameraSettings | None = None
    displacement: DisplacementSettings | None = None
    calibration: CalibrationSettings = Field(default_factory=lambda: CalibrationSettings.model_validate({}))
    fusion: FusionSettings = Field(default_factory=lambda: FusionSettings.model_validate({}))
    reference: ReferenceSettings | None = None

    @model_validator(mode="after")
    def _has_displacement(self) -> "RecordingSettings":
        if self.camera is None and self.displacement is None:
            raise ValueError("must have a [camera] or a [displacement] section beside [accelerometer]")
        return self

    @model_validator(mode="after")
    def _both_axes_have_columns(self) -> "RecordingSettings":
        both = self.camera is not None and self.camera.direction == "xy"
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

    @property
    def axes(self) -> tuple[str, ...]:
        """The image axes that a result is made for, the one of the main columns first; empty without a camera."""
        if self.camera is None:
            return ()
        if self.camera.direction != "xy":
            return (self.camera.direction,)
        return ("y", "x") if self.accelerometer.value_y else ("x", "y")


def settings_file(path: str | Path) -> Path:
    """The `recording.toml` meant by a folder or by the file itself; DataError where there is none."""
    path = Path(path)
    file = path / RECORDING_FILE if path.is_dir() else path
    if not file.is_file():
        hint = f"a folder with {RECORDING_FILE}, or that file"
        raise DataError(f"{file}: not found. A recording is {hint}; `midspan demo` makes one to look at.")
    return file


def load_settings(path: str | Path, overrides: dict[str, dict[str, Any]] | None = None) -> RecordingSettings:
    """Read and validate a `recording.toml` (a folder or the file).

    overrides: section → key → value, from the command line; they win over the file. Raises UsageError for anything the
    file may not say, DataError where there is no file.
    """
    file = settings_file(path)
    try:
        tree = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{file}: is not valid TOML: {error}. Text values need quotes.") from None
    except OSError as error:
        raise DataError(f"{file}: cannot be read ({error.strerror}).") from None
    for section, keys in (overrides or {}).items():
        option("section", section, RecordingSettings.model_fields)
        given = tree.get(section, {})
        if isinstance(given, dict) and (section in tree or section in OPTIONAL_SECTIONS):
            if section == "camera" and "tracker" in given and keys.get("tracker", given["tracker"]) != given["tracker"]:
                # They belong to the file's own tracker.
                given = {key: value for key, value in given.items() if key != "tracker_settings"}
            tree[section] = {**given, **keys}
    return validate(tree, str(file))


def validate(tree: dict[str, Any], where: str) -> RecordingSettings:
    """The settings of a tree of plain values; `where` names it in messages."""
    try:
        return RecordingSettings.model_validate(tree)
    except ValidationError as error:
        lines = [_explain(item) for item in error.errors()]
        raise UsageError("\n".join(f"{where}: {line}" for line in lines)) from None


# Sections of a recording.toml that other versions of midspan read.
OTHER_SECTIONS = ("infrared", "radar")


def _explain(item: Any) -> str:
    """One sentence for one of pydantic's errors."""
    place, kind, value = list(item["loc"]), item["type"], item["input"]
    if place and isinstance(place[-1], int) and kind in ("missing", "int_type", "float_type"):
        place = place[:-1]
    key = _key(place)
    if kind == "extra_forbidden":
        return _unknown(key, [str(part) for part in place if not isinstance(part, int)], value)
    if kind == "too_long" or (kind == "missing" and isinstance(item["loc"][-1], int)):
        return f"{key}: must have {4 if key.endswith('roi') else 2} numbers; received {list(value)}."
    if kind == "missing":
        return f"{key}: is missing. Add it; `midspan check-config` shows what a file says."
    if kind == "tuple_type" and key == "camera.target":
        return f"{key}: must be a list, one [[camera.target]] for each target; received {value!r}."
    if kind.startswith(("model_type", "model_attributes", "dict_type")):
        return f"{key}: must be one section, [{key}]; received {value!r}."
    if kind == "string_too_short":
        return f"{key} = {value!r}: must not be empty; leave the key out instead."
    text = str(item["msg"]).removeprefix("Value error, ")
    text = text.replace("Input should", "must").replace("String should", "must")
    return (
        f"{key}: {text}."
        if key == "settings" or isinstance(value, dict)
        else f"{key} = {_plain(value)}: {text}.".replace("..", ".").replace("?.", "?")
    )


def _key(place: list[Any]) -> str:
    """A place of the tree as it is written; of a list the entry's number, counted from 1."""
    text = ".".join(f"[{part + 1}]" if isinstance(part, int) else str(part) for part in place)
    return text.replace(".[", "[") or "settings"


def _plain(value: Any) -> str:
    return repr(list(value)) if isinstance(value, tuple) else repr(value)


def _unknown(key: str, place: list[str], value: Any) -> str:
    if len(place) == 1 and place[0] in OTHER_SECTIONS:
        return f"{key}: this version of midspan does not read [{key}]. Take the section out."
    known = _keys_at(place[:-1])
    if len(place) == 1:
        known = [name for name in known if name != "name"] if isinstance(value, dict) else ["name"]
    what = "section" if isinstance(value, dict) else "key"
    hint = nearest(place[-1], known)
    return f"{key}: is not a known {what}. {hint + ' ' if hint else ''}Known: {', '.join(known)}."


def _keys_at(place: list[str]) -> list[str]:
    """The keys that are known at a place of the tree."""
    model: Any = RecordingSettings
    for name in place:
        annotation = model.model_fields[name].annotation
        options = [annotation, *getattr(annotation, "__args__", ())]
        model = next(option for option in options if hasattr(option, "model_fields"))
    return list(model.model_fields)
