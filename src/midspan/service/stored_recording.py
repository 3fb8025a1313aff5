"""A stretch of a store as a recording: raw acceleration, readings and tracks, to be computed again by any method."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.sensors.radar import RadarCalibration
from midspan.engine.radar_target import FollowedTarget
from midspan.errors import DataError
from midspan.radar.chirp import ChirpProfile, RadarInfo, profile_from_json, profile_to_json
from midspan.radar.frames import bin_m_of
from midspan.records import NANOSECONDS
from midspan.service.calibrations import CHIRPS
from midspan.service.journal import target_stream
from midspan.service.stored_rows import stored_rows
from midspan.settings.load import RECORDING_FILE
from midspan.settings.stored.calibration import Calibration
from midspan.settings.stored.calibration_file import calibration_from_dict
from midspan.store.chunk import Chunk
from midspan.store.store import Store, StoredCalibration, is_address
from midspan.trees import TreeError, json_tree

ACCELERATION_FILE = "acceleration.npz"
# A radar's frames that are written together.
FRAMES_AT_A_TIME = 1024
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


@dataclass(frozen=True, slots=True)
class _Own:
    """The calibration that chose a radar's bins, its number in the store, and the chirps of the point's radars."""

    calibration: Calibration
    number: int
    chirps: dict[str, Any]


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

    Raises DataError where there are none.
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
        if kind == "radar":
            own = _Own(calibration, known.number, settings.get(CHIRPS, {}))
            written = [_radar_section(store, point, section, folder, span, own) for section in sections]
        else:
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


def _radar_section(
    store: Store, point: str, section: dict[str, Any], folder: Path, span: tuple[int, int], own: _Own
) -> dict[str, Any]:
    """A radar's section with its phasors written as slow-time I/Q."""
    name = section.get("name") or "radar"
    radar, chirp = own.calibration.of(name), own.chirps.get(name)
    found = stored_rows(store, point, name, *span, own.number)
    if found is None or not isinstance(radar, RadarCalibration):
        raise DataError(f"The store has no phasors of {name} by calibration {own.number} in that time.")
    profile = None if chirp is None else profile_from_json(json.dumps(chirp))
    _save_slow_time(folder / f"{name}.h5", found, radar, profile)
    of_files = ("file", "config", "rate_hz", "start_s", "iq_order", "carrier_hz")
    return {**{key: value for key, value in section.items() if key not in of_files}, "file": f"{name}.h5"}


def _save_slow_time(file: Path, found: Chunk, radar: RadarCalibration, profile: ChirpProfile | None) -> None:
    """Write phasors of the bins that a calibration needs, each at its place: what lies between two bins into both, and
    zeros where nothing was kept.
    """
    import h5py

    range_m = np.full(1, np.nan) if profile is None else profile.axis.range_m
    info = RadarInfo("store", radar.carrier_hz, np.nan, None, radar.channels, range_m, profile=profile)
    step_m = bin_m_of(info)
    followed = [FollowedTarget.of(one, 1.0, step_m, period_s=1.0, bins=info.bins) for one in radar.used]
    bins = np.unique(np.concatenate([one.bins for one in followed]))
    low = np.floor(bins).astype(np.int64)
    valid = np.asarray(found.columns["valid"], dtype=np.bool_)
    phasors = found.columns["phasors"].reshape(*valid.shape, len(bins))
    shape = (*valid.shape, int(low[-1]) + 2 if profile is None else info.bins)
    with h5py.File(file, "w") as slow_time:
        iq = slow_time.create_dataset("iq", shape, np.complex64, chunks=(1, *shape[1:]), compression="lzf")
        for begin in range(0, len(valid), FRAMES_AT_A_TIME):
            some = slice(begin, begin + FRAMES_AT_A_TIME)
            part = np.where(valid[some, :, None], phasors[some], np.nan)
            block = np.zeros((len(part), *shape[1:]), np.complex64)
            block[:, :, np.minimum(low + 1, shape[2] - 1)] = part
            block[:, :, low] = part
            iq[begin : begin + len(block)] = block
        slow_time["time_ns"] = found.time_ns
        slow_time.attrs["carrier_hz"] = radar.carrier_hz
        if profile is not None:
            slow_time.attrs["chirp"] = profile_to_json(profile)


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
