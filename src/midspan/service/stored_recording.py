"""A segment of a store: its rows as a result table, its raw records as a recording that any method computes again."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan._version import __version__
from midspan.calibration.sensors.radar import RadarCalibration
from midspan.checks import nearest
from midspan.engine.radar_target import FollowedTarget
from midspan.errors import DataError, UsageError
from midspan.radar.chirp import ChirpProfile, RadarInfo, profile_from_json, profile_to_json
from midspan.radar.frames import bin_m_of
from midspan.records import NANOSECONDS, RangeFrame, Readings, member_name, member_of, seconds
from midspan.service.calibrations import CHIRPS
from midspan.service.journal import NEW_DATUM, rows_stream, target_stream
from midspan.settings.kinds import AUXILIARY, KINDS, LIVE
from midspan.settings.load import RECORDING_FILE
from midspan.settings.stored.calibration import Calibration, calibration_from_dict
from midspan.sinks.table import ResultTable
from midspan.sources.accelerometer.units import SI_UNITS
from midspan.store.chunk import Chunk, join
from midspan.store.store import Store, is_address
from midspan.trees import TreeError, json_tree

FIRST_NS, LAST_NS = -(2**62), 2**62


def instant(text: str | None, option: str) -> int | None:
    """An instant in ns UTC of ISO 8601 (without a zone: UTC) or of seconds since 1970; None where it is left out."""
    if text is None:
        return None
    if re.fullmatch(r"[+-]?\d+(\.\d*)?", text.strip()):
        seconds_text, _, rest = text.strip().partition(".")
        sign = -1 if seconds_text.startswith("-") else 1
        return int(seconds_text) * NANOSECONDS + sign * int(rest[:9].ljust(9, "0") or 0)
    try:
        found = datetime.fromisoformat(text.strip())
    except ValueError:
        raise UsageError(
            f"{option}: must be an instant like 2026-11-22T10:00:00Z or seconds since 1970; received {text!r}."
        ) from None
    zoned = found if found.tzinfo else found.replace(tzinfo=UTC)
    whole = zoned.replace(microsecond=0)
    return round(whole.timestamp()) * NANOSECONDS + zoned.microsecond * 1000


def chosen_point(store: Store, name: str | None) -> str:
    """The point that is meant: the named one, or the only one. Raises UsageError, DataError for a store without any."""
    known = store.points
    if not known:
        raise DataError("The store has no rows yet.")
    if name is None:
        if len(known) > 1:
            raise UsageError(f"--point must be one of {_listed(known)}; the store has several points. Name one.")
        return known[0]
    if name not in known:
        raise UsageError(f"--point must be one of {_listed(known)}; received {name!r}. {nearest(name, known)}")
    return name


def _listed(points: Sequence[str]) -> str:
    """Points by name, of several of a group the first and the last one and how many there are."""
    numbers = dict[str, list[int]]()
    for point in points:
        group, number = member_of(point) or (point, -1)
        numbers.setdefault(group, []).append(number)
    parts = list[str]()
    for group, own in sorted(numbers.items()):
        names = [group if number < 0 else member_name(group, number) for number in sorted(own)]
        parts += names if len(names) < 4 else [f"{names[0]} to {names[-1]} ({len(names)} points)"]
    return ", ".join(parts)


def stored_rows(
    store: Store, point: str, stream: str, first_ns: int | None, last_ns: int | None, calibration: int | None = None
) -> Chunk | None:
    """A stream's rows from `first_ns` to `last_ns` as one block, None where there are none.

    calibration: only those of this one; None: of all.
    """
    newest_ns = store.newest_ns(point, stream)
    if newest_ns is None:
        return None
    found = list(
        store.chunks(point, stream, FIRST_NS if first_ns is None else first_ns, min(last_ns or LAST_NS, newest_ns))
    )
    found = [one for one in found if calibration in (None, one.calibration)]
    return join(found) if found else None


def stored_table(store: Store, point: str, first_ns: int | None, last_ns: int | None) -> ResultTable:
    """The rows of a point in the columns of a result, with the calibrations and events that belong to them.

    Where the zero is another one from some row on there is a column `datum`, which counts the zeros. Raises DataError
    where there are no rows.
    """
    rows = stored_rows(store, point, rows_stream(), first_ns, last_ns)
    if rows is None or not len(rows.time_ns):
        raise DataError(f"The store has no rows of {point!r} in that time.")
    columns: dict[str, Any] = {
        "time_s": seconds(rows.time_ns, 0),
        **_columns(rows, ""),
        "source": rows.columns["source"],
    }
    columns["status"] = rows.columns["status"]
    for axis in "xy":
        second = stored_rows(store, point, rows_stream(axis), int(rows.time_ns[0]), int(rows.time_ns[-1]))
        if second is not None and np.array_equal(second.time_ns, rows.time_ns):
            columns |= {**_columns(second, f"_{axis}"), f"status_{axis}": second.columns["status"]}
    datums = np.array(store.event_times(point, NEW_DATUM, int(rows.time_ns[-1])), dtype=np.int64)
    number = np.searchsorted(datums, rows.time_ns, side="right")
    if number[-1] > number[0]:
        columns["datum"] = number
    span = (int(rows.time_ns[0]), int(rows.time_ns[-1]))
    return ResultTable(columns=columns, time_ns=rows.time_ns, metadata=_metadata(store, point, rows, span))


def _columns(rows: Chunk, axis: str) -> dict[str, Any]:
    return {
        f"displacement{axis}_mm": 1e3 * rows.columns["displacement_m"],
        f"displacement_std{axis}_mm": 1e3 * rows.columns["std_m"].astype(np.float64),
        f"velocity{axis}_mm_s": 1e3 * rows.columns["velocity_m_s"].astype(np.float64),
    }


def _metadata(store: Store, point: str, rows: Chunk, span: tuple[int, int]) -> dict[str, object]:
    """Calibrations of the rows' time and events, as plain values; the zero's deviation is that of the last row."""
    return {
        "midspan": __version__,
        "point": point,
        "zero_std_mm": 1e3 * float(rows.columns["zero_std_m"][-1]),
        "calibrations": [
            {"number": one.number, "made_s": one.made_ns / NANOSECONDS, "state": one.state, **json.loads(one.body)}
            for one in store.calibrations(point)
        ],
        "events": [
            {"time_s": event.time_ns / NANOSECONDS, "kind": event.kind, "text": event.text}
            for event in store.events(point, *span)
        ],
    }


ACCELERATION_FILE = "acceleration.npz"
# A radar's frames that are written together.
FRAMES_AT_A_TIME = 1024
# What messages advise for files, and for a store in its place.
ADVICE = {
    "Sort or correct the rows, or give rate_hz instead.": "Choose a span without them (--from, --to).",
    "Correct the file.": "Choose a span without it (--from, --to).",
    "Give a time stamp for each frame, or cut the recording where the clock is set.": "Choose a span without it "
    "(--from, --to).",
    "Check for lost frames, or split the recording there.": "Choose a span that ends or begins there (--from, --to).",
    "Check the calibration's time_offset_s and the start_s of both.": "Choose another span (--from, --to), or check "
    "the calibration's time_offset_s.",
}


@dataclass(frozen=True, slots=True)
class _Segment:
    """A point's records of a span (ns) that go into a folder; calibration: that chose the radars' bins, with its number
    in the store; chirps: of the radars.
    """

    store: Store
    point: str
    folder: Path
    span: tuple[int, int]
    calibration: Calibration
    number: int
    chirps: dict[str, Any]

    def section(self, kind: str, settings: dict[str, Any]) -> dict[str, Any]:
        """A sensor's section with its file written."""
        name, row = settings.get("name") or kind, LIVE[kind]
        kept = {key: value for key, value in settings.items() if key not in row.of_files}
        if row.brings is RangeFrame:
            return {**kept, "file": self._radar(kind, name)}
        columns: dict[str, NDArray[Any]] = {}
        if row.brings is Readings:
            found = self._rows(name, f"raw records of {name}")
            columns = {"time_ns": found.time_ns, "value": found.columns["value"]}
            named = [key for key in kept if row.turns and key.startswith("value_")] or ["value"]
            kept |= {"unit": SI_UNITS[row.quantity], "time": "time_ns", **dict.fromkeys(named, "value")}
        else:
            streams = self.store.streams(self.point)
            for k in [k for k in range(len(streams)) if target_stream(name, k) in streams]:
                columns |= _track(self._rows(target_stream(name, k), f"track of {name}"), f"_{k + 1}" if k else "")
        np.savez(self.folder / f"{name}.npz", **columns)  # type: ignore[arg-type]
        return {**kept, "file": f"{name}.npz"}

    def _radar(self, kind: str, name: str) -> str:
        """A radar's phasors written as slow-time I/Q."""
        radar: Any = self.calibration.of(name)
        chirp, what = self.chirps.get(name), f"phasors of {name} by calibration"
        found = self._rows(name, f"{what} {self.number}", self.number)
        if radar is None or radar.kind != kind:
            raise DataError(f"The store has no {what} {self.number} in that time.")
        profile = None if chirp is None else profile_from_json(json.dumps(chirp))
        _save_slow_time(self.folder / f"{name}.h5", found, radar, profile)
        return f"{name}.h5"

    def _rows(self, stream: str, what: str, calibration: int | None = None) -> Chunk:
        found = stored_rows(self.store, self.point, stream, *self.span, calibration)
        if found is None:
            raise DataError(f"The store has no {what} in that time.")
        return found


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
    try:
        calibration = calibration_from_dict(json_tree(known.body), f"calibration {known.number} of the store")
    except TreeError as error:
        raise DataError(f"Calibration {known.number} of the store {error}.") from None
    # What is stored is along the calibrated axis already.
    calibration = replace(calibration, sensor_axis=None)
    settings = json_tree(known.settings)
    acceleration = stored_rows(store, point, "accelerometer", first_ns, last_ns)
    if acceleration is None or not len(acceleration.time_ns):
        raise DataError(f"The store has no acceleration of {point!r} in that time.")
    tree: dict[str, Any] = {key: value for key, value in settings.items() if key in ("name", "calibration", "fusion")}
    value = acceleration.columns["value"]
    values = {"value": value} if value.ndim == 1 else {f"value_{k}": value[:, k] for k in range(value.shape[1])}
    np.savez(folder / ACCELERATION_FILE, time_ns=acceleration.time_ns, **values)  # type: ignore[arg-type]
    tree["accelerometer"] = _accelerometer(settings["accelerometer"], acceleration)
    # Sensors' own clocks may be apart by what the calibration says.
    span = (int(acceleration.time_ns[0]) - 2 * NANOSECONDS, int(acceleration.time_ns[-1]) + 2 * NANOSECONDS)
    segment = _Segment(store, point, folder, span, calibration, known.number, settings.get(CHIRPS, {}))
    kept = store.streams(point)
    for kind in (*KINDS, *(one for one in AUXILIARY if one in kept)):
        sections = settings.get(kind, [])
        written = [segment.section(kind, one) for one in (sections if isinstance(sections, list) else [sections])]
        if written:
            tree[kind] = written if len(written) > 1 else written[0]
    (folder / RECORDING_FILE).write_text(tomli_w.dumps(tree), encoding="utf-8")
    return folder, calibration


def _accelerometer(section: dict[str, Any], acceleration: Chunk) -> dict[str, Any]:
    """The section for the file of readings in SI units."""
    kept: dict[str, Any] = {key: section[key] for key in ("scale_std", "estimate_scale", "noise_std") if key in section}
    own: dict[str, Any] = {"file": ACCELERATION_FILE, "time": "time_ns", "unit": "m/s^2", **kept}
    named = [key for key in ("value_x", "value_y") if key in section]
    if acceleration.columns["value"].ndim == 1:
        return {**own, (named[0] if len(named) == 1 else "value"): "value"}
    # The main axis comes first: y where the recording has a column along it and names no other.
    main = section.get("axis") or "y"
    own.update({f"value_{axis}": f"value_{k}" for k, axis in enumerate((main, "x" if main == "y" else "y"))})
    return {**own, "axis": main}


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
