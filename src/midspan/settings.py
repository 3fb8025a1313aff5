"""One validated settings tree: `recording.toml` and nothing else decides what a run does.

Every message names the file, the key, the rule with its unit, the value received and the remedy.
"""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from midspan.checks import nearest
from midspan.errors import DataError, UsageError
from midspan.fusion.methods import METHODS
from midspan.vision.tracker import DEFAULT_TRACKER, TRACKERS

RECORDING_FILE = "recording.toml"

PositiveNumber = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegativeNumber = Annotated[float, Field(ge=0, allow_inf_nan=False)]
FiniteNumber = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1)]


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


class ReferenceSettings(ChannelSettings):
    """A reference that only report and compare look at."""


class CameraSettings(_Section):
    """A camera on the structure that looks at fixed surroundings."""

    file: Name
    times: Name | None = Field(None, description="file with a column time_s, one row a frame")
    rate_hz: PositiveNumber | None = Field(None, description="frames a second, where the file has no time stamps")
    start_s: FiniteNumber = Field(0.0, description="time of the first frame, s")
    every: Annotated[int, Field(ge=1)] = Field(1, description="use every n-th frame; higher is faster")
    roi: tuple[int, int, int, int] | None = Field(None, description="x, y, width, height, px; left out: chosen")
    direction: Literal["x", "y"] = Field("y", description="image axis of the measured motion: x right, y down")
    exposure_s: NonNegativeNumber | None = Field(None, description="exposure time, s; its averaging is corrected")
    readout_s: NonNegativeNumber = Field(0.0, description="rolling shutter: seconds from first to last row")
    tracker: Annotated[str, _known(TRACKERS, "tracker")] = Field(DEFAULT_TRACKER, description="how the target is found")

    @model_validator(mode="after")
    def _region_is_positive(self) -> "CameraSettings":
        if self.roi is not None and (min(self.roi[:2]) < 0 or min(self.roi[2:]) < 1):
            raise ValueError(f"roi: must be x, y >= 0 and width, height >= 1, in px; received {list(self.roi)}")
        return self


class CalibrationSettings(_Section):
    """How scale factor and clock offset are found."""

    window_s: tuple[FiniteNumber, FiniteNumber] | None = Field(
        None, description="start and end of the part used, s on the accelerometer's clock; left out: the first minute"
    )
    band_hz: tuple[NonNegativeNumber, PositiveNumber] | None = Field(
        None,
        description="band of acceleration compared with the camera, Hz; left out: all that rates and noise allow",
    )
    max_offset_s: Annotated[float, Field(ge=0, le=3600)] = Field(
        0.5, description="largest clock offset searched for, s"
    )

    @model_validator(mode="after")
    def _in_order(self) -> "CalibrationSettings":
        for name in ("window_s", "band_hz"):
            pair = getattr(self, name)
            if pair is not None and pair[1] <= pair[0]:
                raise ValueError(f"{name}: must be two numbers, the second larger; received {list(pair)}")
        return self


class FusionSettings(_Section):
    """How acceleration and displacement become one."""

    method: Annotated[str, _known(METHODS, "method")] = Field("smoother", description="see `midspan methods`")
    lag_s: PositiveNumber = Field(0.5, description="delay of the method `lag`, s")


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
        if section in tree or section in ("fusion", "calibration"):
            tree[section] = {**tree.get(section, {}), **keys}
    return validate(tree, str(file))


def validate(tree: dict[str, Any], where: str) -> RecordingSettings:
    """The settings of a tree of plain values; `where` names it in messages."""
    try:
        return RecordingSettings.model_validate(tree)
    except ValidationError as error:
        lines = [_explain(item) for item in error.errors()]
        raise UsageError("\n".join(f"{where}: {line}" for line in lines)) from None


def _explain(item: Any) -> str:
    """One sentence for one of pydantic's errors."""
    place = [str(part) for part in item["loc"]]
    key = ".".join(place) or "the file"
    kind, value = item["type"], item["input"]
    if kind == "extra_forbidden":
        known = _keys_at(place[:-1])
        what = "section" if isinstance(value, dict) else "key"
        return f"{key}: is not a known {what}. {nearest(place[-1], known)} Known: {', '.join(known)}.".replace(
            "  ", " "
        )
    if kind == "missing":
        return f"{key}: is missing. Add it; `midspan formats` and the guide show an example."
    text = str(item["msg"]).removeprefix("Value error, ").replace("Input should", "must")
    if kind == "value_error":
        return f"{key}: {text}" if not place else f"{key} = {value!r}: {text}".rstrip()
    return f"{key} = {value!r}: {text}."


def _keys_at(place: list[str]) -> list[str]:
    """The keys that are known at a place of the tree."""
    model: Any = RecordingSettings
    for name in place:
        annotation = model.model_fields[name].annotation
        options = [annotation, *getattr(annotation, "__args__", ())]
        model = next(option for option in options if hasattr(option, "model_fields"))
    return list(model.model_fields)
