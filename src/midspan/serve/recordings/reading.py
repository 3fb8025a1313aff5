"""What the page draws of a recording: its first frame, and traces of result and reference, read where they lie.

Plain values in and out, so that it runs in a process of its own, whose memory holds the newest trace.
"""

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from midspan.errors import DataError, UsageError
from midspan.recording.streams.recording import Recording, open_recording
from midspan.recording.tracking.opening import given_targets
from midspan.records import NANOSECONDS, Floats, Nanoseconds, TimeSeries
from midspan.serve.reading import MAX_ROWS, spectrum_tree
from midspan.serve.viewers import plain
from midspan.service.camera_process import pictured
from midspan.settings.load import RECORDING_FILE
from midspan.settings.stored.calibration import CALIBRATION_FILE
from midspan.sinks.metadata import partner
from midspan.sinks.table import WORDS
from midspan.sources.boundary import reading
from midspan.trees import TreeError, read_json
from midspan.vision.region import check_region

Tree = dict[str, Any]
# As `midspan estimate` writes them without further words.
RESULT_FILE, REPORT_FILE = "result.csv", "report.html"
# Levels of folders that are looked through for recordings, and how many these may be: more are a campaign.
FOLDERS_DEEP, MAX_RECORDINGS = 2, 500
# Of a result's metadata, what a person reads.
SHOWN = ("midspan", "verdict", "method", "delay_s", "zero_std_mm", "axes", "not_in_band", "notices", "events")
MAX_EVENTS = 1000


def recordings_at(where: Path) -> list[Path]:
    """The recording.toml that is meant, or those of the folders below. Raises UsageError for another file, DataError
    where there is none.
    """
    if not where.exists():
        raise DataError(f"{where}: not found. A recording is a folder with {RECORDING_FILE}, or that file.")
    if where.is_file() and where.suffix.lower() != ".toml":
        raise UsageError(
            f"{where}: is not a {RECORDING_FILE}. `midspan init` writes one, `midspan inspect` shows a file."
        )
    if where.is_file() or (where / RECORDING_FILE).is_file():
        return [where if where.is_file() else where / RECORDING_FILE]
    patterns = ["/".join([*["*"] * deep, RECORDING_FILE]) for deep in range(1, FOLDERS_DEEP + 1)]
    found = sorted({file for pattern in patterns for file in where.glob(pattern)})
    if not found:
        raise DataError(
            f"{where}: neither this folder nor its subfolders contain a {RECORDING_FILE}. `midspan init` writes one "
            "for an accelerometer's file and a video."
        )
    if len(found) > MAX_RECORDINGS:
        raise DataError(f"{where}: contains {len(found)} recordings. Name a folder of at most {MAX_RECORDINGS}.")
    return found


def summary(file: str) -> Tree:
    """Name and files of a recording; what is wrong with its settings as `fault`."""
    path = Path(file)
    made = {name: _written_s(path.parent / name) for name in (RESULT_FILE, REPORT_FILE, CALIBRATION_FILE)}
    tree: Tree = {
        "name": path.parent.resolve().name, "folder": str(path.parent), "streams": [], "cameras": [],
        "has_reference": False, "method": "", "fault": "", "changed_s": _written_s(path),
        "result_s": made[RESULT_FILE], "report_s": made[REPORT_FILE], "calibration_s": made[CALIBRATION_FILE],
    }  # fmt: skip
    try:
        recording = open_recording(path)
    except (DataError, UsageError) as error:
        return {**tree, "fault": str(error)}
    return {
        **tree,
        "name": recording.name,
        "streams": [{"name": name, "file": named} for name, named in recording.streams],
        "cameras": [_camera(view) for view in recording.cameras],
        "has_reference": recording.has("reference"),
        "method": recording.settings.fusion.method,
    }


def _camera(view: Recording) -> Tree:
    """A camera with the regions that its settings name; several of them are no longer the page's to draw."""
    camera = view.settings.camera
    targets = () if camera is None else given_targets(camera)
    regions = [[one.region.x, one.region.y, one.region.width, one.region.height] for one in targets]
    return {"name": view.sensor, "kind": view.kind, "regions": regions}


def _written_s(path: Path) -> float | None:
    try:
        return path.stat().st_mtime
    except OSError:
        return None


def require_regions_inside(file: Path) -> None:
    """Raises UsageError for a region that is not in its camera's picture; one that cannot be read has no size yet."""
    for view in open_recording(file).cameras:
        camera = view.settings.camera
        try:
            info = view.frames.info
        except DataError:
            continue
        for target in () if camera is None else given_targets(camera):
            check_region(target.region, info.width, info.height)


def first_frame(file: str, camera: str) -> tuple[bytes, Tree]:
    """A camera's first frame as JPEG, when it was taken (ns on the camera's clock) and its size, px."""
    view = next((one for one in open_recording(file).cameras if one.sensor == camera), None)
    if view is None or view.frames.tracks:
        raise DataError(f"{camera}: is not a camera of this recording with images.")
    frame = next(view.frames.frames(0, 1), None)
    if frame is None:
        raise DataError(f"{camera}: has no readable frame.")
    picture = pictured(frame)
    return picture.jpeg, {"time_ns": picture.time_ns, "height": picture.shape[0], "width": picture.shape[1]}


@lru_cache(maxsize=3)
def _trace(file: str, what: str, _written: tuple[int, ...]) -> tuple[Nanoseconds, Floats, Floats, Any]:
    """Stamps (n,) in ns, displacement and its deviation, mm, NaN where there is none, and codes of the status."""
    path = Path(file).parent / RESULT_FILE
    if what == "reference":
        found = open_recording(file).reference
        nothing = np.full(len(found.value), np.nan)
        return found.time_ns, 1e3 * found.value, nothing, np.zeros(len(nothing), dtype=np.int8)
    if what == "error":
        time_ns, value, std, status = trace(file, "result")
        true_ns, true, _, _ = trace(file, "reference")
        inside = (time_ns >= true_ns[0]) & (time_ns <= true_ns[-1])
        between = np.interp(time_ns - true_ns[0], true_ns - true_ns[0], true)
        return time_ns, np.where(inside, value - between, np.nan), std, status
    if not path.is_file():
        raise DataError(f"{path.name}: does not exist yet. Estimate the recording first.")
    import pyarrow as pa
    from pyarrow import compute, csv

    with reading(path, "a result"):
        names = _columns(path, what)
        table = csv.read_csv(path, convert_options=csv.ConvertOptions(include_columns=names))
        time_s, value, std = (table[name].to_numpy().astype(np.float64) for name in names[:3])
        words = pa.array(WORDS["status"])
        status = compute.index_in(table[names[3]], value_set=words).to_numpy().astype(np.int8)
    lost = status == WORDS["status"].index("lost")
    return np.round(NANOSECONDS * time_s).astype(np.int64), np.where(lost, np.nan, value), std, status


def _columns(path: Path, what: str) -> list[str]:
    """Time, displacement, its deviation and status: along the main axis, or along the second one."""
    if what == "result":
        return ["time_s", "displacement_mm", "displacement_std_mm", "status"]
    with path.open() as lines:
        header = lines.readline().strip().split(",")
    axis = next((axis for axis in "xy" if f"displacement_{axis}_mm" in header), None)
    if axis is None:
        raise DataError(f"{path.name}: has one axis only.")
    return ["time_s", f"displacement_{axis}_mm", f"displacement_std_{axis}_mm", f"status_{axis}"]


def trace(file: str, what: str) -> tuple[Nanoseconds, Floats, Floats, Any]:
    """Result, the same across (along a second axis), reference or error (result less reference), read again once
    it was written again.
    """
    files = [Path(file).parent / RESULT_FILE, Path(file)]
    return _trace(file, what, tuple(one.stat().st_mtime_ns for one in files if one.exists()))


def span(file: str, what: str) -> Tree:
    """First and last instant of a trace, s, and how many rows it has."""
    time_ns, *_ = trace(file, what)
    return {"from_s": time_ns[0] / NANOSECONDS, "to_s": time_ns[-1] / NANOSECONDS, "rows": len(time_ns)}


def series(file: str, what: str, from_s: float, to_s: float, count: int | None) -> bytes:
    """Rows from `from_s` until before `to_s`, or least, largest and mean of `count` equal buckets, as JSON."""
    time_ns, value, std, status = trace(file, what)
    first, end = np.searchsorted(time_ns, [round(NANOSECONDS * from_s), round(NANOSECONDS * to_s)])
    words = (*WORDS["status"], None)
    if count is not None:
        edges = NANOSECONDS * np.linspace(from_s, to_s, count + 1)
        tree = bucketed(edges, time_ns, value, std)
        return json.dumps({"time": edges[:-1].astype(np.int64).tolist(), **tree}, separators=(",", ":")).encode()
    if end - first > MAX_ROWS:
        raise DataError(f"from_s, to_s: must span at most {MAX_ROWS} rows; received {end - first}. Request buckets.")
    tree = {
        "time": time_ns[first:end].tolist(),
        "displacement_mm": plain(value[first:end]),
        "displacement_std_mm": plain(std[first:end]),
        "status": [words[code] for code in status[first:end].tolist()],
    }
    return json.dumps(tree, separators=(",", ":")).encode()


def bucketed(edges: Floats, time_ns: Nanoseconds, value: Floats, std: Floats) -> Tree:
    """Least, largest, mean, largest deviation and number of the rows between edges (k + 1,) in ns; null without any."""
    starts = np.searchsorted(time_ns, edges)
    some = np.flatnonzero(np.diff(starts) > 0)
    at, inside = starts[:-1][some], slice(0, int(starts[-1]))
    known = np.isfinite(value[inside])
    count = np.add.reduceat(known.astype(np.int64), at) if len(some) else np.empty(0)
    total = np.add.reduceat(np.where(known, value[inside], 0.0), at) if len(some) else np.empty(0)

    def filled(part: Floats) -> list[float | None]:
        every = np.full(len(edges) - 1, np.nan)
        every[some] = part
        return plain(every)

    def of(reduce: Any, values: Floats) -> list[float | None]:
        return filled(reduce.reduceat(values[inside], at) if len(some) else np.empty(0))

    return {
        "displacement_mm_min": of(np.fmin, value),
        "displacement_mm_max": of(np.fmax, value),
        "displacement_mm_mean": filled(total / np.where(count > 0, count, np.nan)),
        "displacement_std_mm": of(np.fmax, std),
        "status": [],
        "rows": [0 if n is None else n for n in filled(count)],
    }


def spectrum_of(file: str, what: str, from_s: float, to_s: float) -> Tree:
    """Spectrum and natural frequencies of a part of a trace."""
    time_ns, value, _, _ = trace(file, what)
    first, end = np.searchsorted(time_ns, [round(NANOSECONDS * from_s), round(NANOSECONDS * to_s)])
    known = np.flatnonzero(np.isfinite(value[first:end])) + first
    return spectrum_tree(TimeSeries(time_ns[known], 1e-3 * value[known]))


def result(file: str) -> Tree:
    """What stands with the result's rows: method, warnings, what is not in the band, events, calibration."""
    path = partner(Path(file).parent / RESULT_FILE)
    try:
        tree = read_json(path)
    except OSError as error:
        raise DataError(f"{path.name}: cannot be read ({error.strerror}). Estimate the recording first.") from None
    except TreeError as error:
        raise DataError(f"{path.name}: {error}.") from None
    found = {name: tree.get(name) for name in SHOWN}
    return {**found, "events": (found["events"] or [])[-MAX_EVENTS:], "calibration": tree.get("calibration", {})}


def calibration(file: str) -> Tree:
    """The recording's calibration.json."""
    path = Path(file).parent / CALIBRATION_FILE
    try:
        found = read_json(path)
    except OSError as error:
        raise DataError(f"{path.name}: cannot be read ({error.strerror}). Calibrate the recording first.") from None
    except TreeError as error:
        raise DataError(f"{path.name}: {error}.") from None
    return found if isinstance(found, dict) else {}
