"""A stretch of a store as a recording: raw acceleration, readings and tracks, to be computed again by any method."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError, UsageError
from midspan.records import NANOSECONDS
from midspan.service.journal import target_stream
from midspan.service.stored_rows import stored_rows
from midspan.settings.load import RECORDING_FILE
from midspan.settings.stored.calibration import Calibration
from midspan.settings.stored.calibration_file import calibration_from_dict
from midspan.store.chunk import Chunk
from midspan.store.store import Store, StoredCalibration, is_address
from midspan.trees import TreeError, json_tree

ACCELERATION_FILE = "acceleration.npz"
# What messages advise for files, and for a store in its place.
ADVICE = {
    "Sort or correct the rows, or give rate_hz instead.": "Choose a span without them (--from, --to).",
    "Correct the file.": "Choose a span without it (--from, --to).",
    "Give a time stamp for each frame, or cut the recording where its clock is set.": "Choose a span without it "
    "(--from, --to).",
    "Check for lost frames, or split the recording there.": "Choose a span that ends or begins there (--from, --to).",
    "Check the calibration's time_offset_s and the start_s of both.": "Choose another span (--from, --to), or check "
    "the calibration's time_offset_s.",
}


def in_words_of_a_store(text: str, folder: Path, where: str, point: str) -> str:
    """A message about the recording in `folder` as one about the point of the store that it was made of."""
    store = f"{'the PostgreSQL store' if is_address(where) else where}: point {point!r}"
    for file, advice in ADVICE.items():
        text = text.replace(file, advice)
    for path in sorted(folder.glob("*.npz")):
        sensor = "accelerometer" if path.name == ACCELERATION_FILE else path.stem
        text = text.replace(str(path), f"{store}, {sensor}")
    return text.replace(str(folder / RECORDING_FILE), store).replace(str(folder), store)


def stored_recording(
    store: Store, point: str, folder: Path, first_ns: int | None, last_ns: int | None
) -> tuple[Path, Calibration]:
    """Write a point's raw records as a recording into `folder`; returns it with the calibration that was in force.

    Raises DataError where there are none, UsageError for sensors whose raw records cannot be computed again.
    """
    import tomli_w

    known = store.calibration(point) or next(reversed(store.calibrations(point)), None)
    if known is None:
        raise DataError(f"The store has no calibration of {point!r}.")
    # What is stored is along the calibrated axis already.
    calibration = replace(_calibration(known), sensor_axis=None)
    settings = json_tree(known.settings)
    acceleration = stored_rows(store, point, "accelerometer", first_ns, last_ns)
    if acceleration is None or not len(acceleration.time_ns):
        raise DataError(f"The store has no acceleration of {point!r} in that time.")
    tree: dict[str, Any] = {key: value for key, value in settings.items() if key in ("name", "calibration", "fusion")}
    _save(folder / ACCELERATION_FILE, {"time_ns": acceleration.time_ns, **_values(acceleration)})
    tree["accelerometer"] = _accelerometer(settings["accelerometer"], acceleration)
    # Sensors' own clocks may be apart by what the calibration says.
    span = (int(acceleration.time_ns[0]) - 2 * NANOSECONDS, int(acceleration.time_ns[-1]) + 2 * NANOSECONDS)
    for kind in ("camera", "infrared", "displacement", "radar"):
        sections = settings.get(kind, [])
        sections = sections if isinstance(sections, list) else [sections]
        written = [_section(store, point, kind, section, folder, span) for section in sections]
        if written:
            tree[kind] = written if len(written) > 1 else written[0]
    (folder / RECORDING_FILE).write_text(tomli_w.dumps(tree), encoding="utf-8")
    return folder, calibration


def _save(file: Path, arrays: dict[str, NDArray[Any]]) -> None:
    np.savez(file, **arrays)  # type: ignore[arg-type]


def _calibration(known: StoredCalibration) -> Calibration:
    try:
        return calibration_from_dict(json_tree(known.body), f"calibration {known.number} of the store")
    except TreeError as error:
        raise DataError(f"Calibration {known.number} of the store {error}.") from None


def _values(acceleration: Chunk) -> dict[str, NDArray[Any]]:
    value = acceleration.columns["value"]
    return {"value": value} if value.ndim == 1 else {f"value_{k}": value[:, k] for k in range(value.shape[1])}


def _accelerometer(section: dict[str, Any], acceleration: Chunk) -> dict[str, Any]:
    """The section for the file of readings in SI units."""
    kept: dict[str, Any] = {key: section[key] for key in ("scale_std", "estimate_scale", "noise_std") if key in section}
    own: dict[str, Any] = {"file": ACCELERATION_FILE, "time": "time_ns", "unit": "m/s^2", **kept}
    named = [key for key in ("value_x", "value_y") if key in section]
    if acceleration.columns["value"].ndim == 1:
        return {**own, (named[0] if named else "value"): "value"}
    # The main axis comes first: y where the recording has a column along it.
    order = ["value_y", "value_x"] if "value_y" in section else ["value_x", "value_y"]
    own.update({key: f"value_{k}" for k, key in enumerate(order)})
    return own


def _section(
    store: Store, point: str, kind: str, section: dict[str, Any], folder: Path, span: tuple[int, int]
) -> dict[str, Any]:
    """A sensor's section with its files written."""
    name = section.get("name") or kind
    if kind == "radar":
        raise UsageError(
            f"{name}: a radar's raw phasors cannot be computed again from a store; use its rows (`export`)."
        )
    kept = {key: value for key, value in section.items() if key not in ("file", "times", "rate_hz", "start_s", "every")}
    if kind == "displacement":
        found = stored_rows(store, point, name, *span)
        if found is None:
            raise DataError(f"The store has no raw records of {name} in that time.")
        _save(folder / f"{name}.npz", {"time_ns": found.time_ns, "value": found.columns["value"]})
        unit = {"unit": "m", "time": "time_ns", "value": "value"}
        return {**kept, "file": f"{name}.npz", **unit}
    streams = store.streams(point)
    targets = [k for k in range(len(streams)) if target_stream(name, k) in streams]
    columns: dict[str, NDArray[Any]] = {}
    for k in targets:
        found = stored_rows(store, point, target_stream(name, k), *span)
        if found is None:
            raise DataError(f"The store has no track of {name} in that time.")
        columns |= _track(found, f"_{k + 1}" if k else "")
    _save(folder / f"{name}.npz", columns)
    # The regions stand in the calibration; a track has them no more.
    for key in ("roi", "target", "automatic_targets", "temperature_range_c"):
        kept.pop(key, None)
    return {**kept, "file": f"{name}.npz"}


def _track(found: Chunk, end: str) -> dict[str, NDArray[Any]]:
    """A kept track in the columns of a track's table."""
    own = found.columns
    reference = {axis: own[f"reference_variance_{axis}_px2"] for axis in "xy"}
    columns = {f"x_px{end}": own["x_px"], f"y_px{end}": own["y_px"]}
    for axis in "xy":
        columns[f"std_{axis}_px{end}"] = np.sqrt(own[f"variance_{axis}_px2"] + reference[axis])
        columns[f"reference_std_{axis}_px{end}"] = np.sqrt(reference[axis])
    columns |= {f"quality{end}": own["quality"], f"strength{end}": own["strength"]}
    return columns if end else {"time_ns": found.time_ns, **columns}
