"""Reading and validating a `recording.toml`."""

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from midspan.checks import instance, option, path_of
from midspan.errors import DataError, UsageError
from midspan.settings.messages import explain
from midspan.settings.recording import RecordingSettings
from midspan.trees import TreeError, read_toml

RECORDING_FILE = "recording.toml"
Model = TypeVar("Model", bound=BaseModel)
# Sections that every recording has, written or not.
OPTIONAL_SECTIONS = ("calibration", "fusion")


def settings_file(path: str | Path) -> Path:
    """The `recording.toml` meant by a folder or by the file itself; DataError where there is none."""
    from midspan.sources.accelerometer.phone import is_phone_log

    path = path_of("path", path)
    if is_phone_log(path):
        raise DataError(f"{path}: is the log of a phone, no recording. Make one with `midspan init {path} [VIDEO]`.")
    hint = f"A recording is a folder with {RECORDING_FILE}, or that file; `midspan demo` writes an example."
    try:
        file = path / RECORDING_FILE if path.is_dir() else path
        if file.is_file():
            return file
        what = "is no regular file" if file.exists() else "not found"
    except (OSError, ValueError) as error:
        # A name that is too long for the file system, or holds a NUL character.
        file, what = path, f"cannot be a file ({getattr(error, 'strerror', None) or error})"
    raise DataError(f"{file}: {what}. {hint}")


def load_settings(path: str | Path, overrides: dict[str, dict[str, Any]] | None = None) -> RecordingSettings:
    """Read and validate a `recording.toml` (a folder or the file).

    overrides: section → key → value, from the command line; they win over the file, in each of several sections of a
    kind. Raises UsageError for anything the file may not say and for overrides of a section that it lacks, DataError
    where there is no file.
    """
    file = settings_file(path)
    try:
        tree = read_toml(file)
    except TreeError as error:
        if file.suffix.lower() != ".toml":
            raise UsageError(
                f"{file}: is not a {RECORDING_FILE}. A recording is a folder with {RECORDING_FILE}, or that file. "
                "With an accelerometer's file put the video after it: `midspan estimate ACCEL VIDEO`."
            ) from None
        raise UsageError(f"{file}: {error}.") from None
    except OSError as error:
        raise DataError(f"{file}: cannot be read ({error.strerror}).") from None
    if not tree:
        raise UsageError(
            f"{file}: is empty. A recording has [accelerometer] and a section for each other sensor, a site has "
            "[store] and [[point]]."
        )
    for section, keys in (overrides or {}).items():
        known = [field.alias or name for name, field in RecordingSettings.model_fields.items() if name != "name"]
        option("section", section, known)
        instance(section, keys, dict, "a dictionary of settings", f"Write {section}={{'KEY': VALUE}}.")
        if section not in tree and section not in OPTIONAL_SECTIONS:
            raise UsageError(
                f"{file}: has no section [{section}] for {', '.join(keys) or 'its keys'}. Add "
                f"[{section}] to the file, or remove these settings."
            )
        given = tree.get(section, {})
        tree[section] = [_changed(one, keys) for one in given] if isinstance(given, list) else _changed(given, keys)
    return validate(tree, str(file))


def _changed(section: Any, keys: dict[str, Any]) -> Any:
    """A section with other values of some keys; what is no section stays for the validation to refuse."""
    if not isinstance(section, dict):
        return section
    if "tracker" in section and keys.get("tracker", section["tracker"]) != section["tracker"]:
        # They belong to the file's own tracker.
        section = {key: value for key, value in section.items() if key != "tracker_settings"}
    return {**section, **keys}


def validate(tree: dict[str, Any], where: str, model: type[Model] = RecordingSettings) -> Model:  # type: ignore[assignment]
    """The settings of a tree of plain values; `where` names it in messages."""
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        lines = [explain(item, tree, model) for item in error.errors()]
        raise UsageError("\n".join(f"{where}: {line}" for line in lines)) from None
