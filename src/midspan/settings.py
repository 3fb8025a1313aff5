"""One validated settings tree: `recording.toml` and nothing else decides what a run does.

Every message names the file, the key, the rule with its unit, the value received and the remedy.
"""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from midspan.checks import nearest, option
from midspan.errors import DataError, UsageError
from midspan.fusion.methods import METHODS
from midspan.vision.tracker import DEFAULT_TRACKER, TRACKERS

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

    sensitivity: NonNegativeNumber = Field(0.0, description="V per m/s², with unit = 'V'; 0: not used")


class DisplacementSettings(ChannelSettings):
    """Any other displacement: GNSS, total station, LVDT, level."""

    estimate_offset: bool = Field(
        False, strict=True, description="learn and apply the clock offset to the accelerometer; false: one clock"
    )


class ReferenceSettings(ChannelSettings):
    """A reference that only report and compare look at."""


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
    direction: Literal["x", "y"] = Field("y", description="image axis of the measured motion: x right, y down")
    exposure_s: NonNegativeNumber | None = Field(None, description="exposure time, s; its averaging is corrected")
    readout_s: NonNegativeNumber = Field(0.0, description="rolling shutter: seconds from first to last row")
    tracker: Annotated[str, _known(TRACKERS, "tracker")] = Field(DEFAULT_TRACKER, description="how the target is found")


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
    lag_s: PositiveNumber = Field(0.5, description="delay of the method `lag`, s; no method of this version uses it")


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
    key = ".".join(str(part) for part in place) or "settings"
    if kind == "extra_forbidden":
        return _unknown(key, [str(part) for part in place], value)
    if kind == "too_long" or (kind == "missing" and isinstance(item["loc"][-1], int)):
        return f"{key}: must have {4 if key.endswith('roi') else 2} numbers; received {list(value)}."
    if kind == "missing":
        return f"{key}: is missing. Add it; `midspan check-config` shows what a file says."
    if kind.startswith(("model_type", "model_attributes", "dict_type")):
        return f"{key}: must be one section, [{key}]; received {value!r}."
    if kind == "string_too_short":
        return f"{key} = {value!r}: must not be empty; leave the key out instead."
    text = str(item["msg"]).removeprefix("Value error, ")
    text = text.replace("Input should", "must").replace("String should", "must")
    return (
        f"{key}: {text}."
        if key == "settings"
        else f"{key} = {_plain(value)}: {text}.".replace("..", ".").replace("?.", "?")
    )


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
