"""Results and references, of files or in memory, and their comparison."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from midspan.checks import instance, option, path_of
from midspan.errors import DataError, UsageError
from midspan.evaluate import metrics
from midspan.evaluate.metrics import MAX_LAG_S, Band, Comparison
from midspan.recording.result import Result
from midspan.records import TimeSeries
from midspan.settings.load import RECORDING_FILE
from midspan.sinks.metadata import mismatch, read_metadata
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.select import SeriesRequest, named_after, read_series
from midspan.sources.accelerometer.units import measures, si_factor

VALUE = "displacement_mm"
# Taken where neither the file nor the user names a unit: what midspan itself writes.
USUAL_UNIT = "mm"


@dataclass(frozen=True, slots=True)
class StoredResult:
    """A displacement read from a file: `series` in m, and its error band, None where it has none."""

    series: TimeSeries
    band: Band | None


def read_result(path: str | Path, unit: str | None = None, axis: str | None = None) -> StoredResult:
    """Read a result file of any format that `estimate` writes, or any other file of times and displacement.

    unit: of the displacement, over what the file says; left out: the file's own, else mm (reported in `series.notes`).
    axis: image axis "x" or "y" of a result that has both; left out: the main columns, or the only ones. Raises
    UsageError where no channel of displacement can be chosen, DataError for a file that cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        raise UsageError(
            f"{path} is a folder; a result's file is needed. Run `midspan estimate {path} -o result.csv` first, then "
            "name result.csv."
        )
    found = list_channels(path)
    own = column_of(found.names, axis)
    assumed = unit is None and own is None and not any(measures(c.unit, "displacement") for c in found.channels)
    request = SeriesRequest("displacement", value=own, unit=USUAL_UNIT if assumed else unit)
    series = read_series(path, request, channels=found)
    if assumed and named_after(series.name, "acceleration") and not named_after(series.name, "displacement"):
        raise UsageError(
            f"{path}: {series.name!r} is acceleration by its name, and the file has no channel of displacement. Name a "
            "file with displacement, such as a result of `midspan estimate`; --unit mm takes the channel as it is."
        )
    if assumed:
        note = f"{path.name}: no unit in the file; {USUAL_UNIT} assumed."
        series = replace(series, notes=(*series.notes, note))
    std, band = "" if own is None else own.replace("displacement_", "displacement_std_"), None
    for channel in found.channels:
        if channel.name == std and channel.size == len(series.value):
            factor = si_factor(unit or channel.unit or USUAL_UNIT, "displacement", None)
            band = band or Band(channel.values.astype(np.float64) * factor, _zero_std_m(path, axis))
    return StoredResult(series, band)


def _zero_std_m(path: Path, axis: str | None) -> float:
    """The standard deviation of a result's zero by its metadata, m; 0 where they do not tell it."""
    tree = read_metadata(path)
    axes = tree.get("axes")
    second = axes.get(axis) if isinstance(axes, dict) else None
    found = second.get("zero_std_mm") if isinstance(second, dict) else None
    found = tree.get("zero_std_mm") if found is None else found
    return 1e-3 * float(found) if isinstance(found, int | float) and np.isfinite(found) else 0.0


def column_of(names: Sequence[str], axis: str | None) -> str | None:
    """The column of displacement along an image axis in a file with these columns; None where it is no result's file.

    The axis without a column of its own is that of the main columns.
    """
    main = VALUE if VALUE in names else None
    if axis is None or main is None:
        return main
    own = _own(option("axis", axis, ("x", "y")))
    return own if own in names else main


def of_result(result: Result, axis: str | None = None) -> StoredResult:
    """The displacement of a result in memory along an image axis; None: the main one."""
    if axis is not None and result.across is None:
        raise UsageError(f"axis = {axis!r}: the result has one axis only. Leave the axis out.")
    along = result
    if result.across is not None and option("axis", axis or result.axis, ("x", "y")) == result.across.axis:
        along = result.across
    rows = along.estimate
    series = TimeSeries(rows.time_ns, rows.displacement_m)
    return StoredResult(series, Band(np.sqrt(rows.variance_m2), along.zero_std_m))


def _own(axis: str) -> str:
    """The column of a second axis."""
    return f"displacement_{axis}_mm"


def _is_recording(path: Path) -> bool:
    return path.is_dir() or path.name == RECORDING_FILE or path.suffix == ".toml"


def read_reference(path: str | Path, unit: str | None = None, axis: str | None = None) -> TimeSeries:
    """Read a reference, m: a file of times and displacement, or a recording (folder or its file) with [reference].

    unit: of a file's displacement, as for `read_result`; a recording names its own. Raises DataError for a recording
    without [reference].
    """
    path = Path(path)
    if not _is_recording(path):
        return read_result(path, unit, axis).series
    from midspan.recording.streams.recording import open_recording

    recording = open_recording(path)
    if not recording.has("reference"):
        raise DataError(f"{recording.file}: has no [reference]. Add one, or name the reference's file itself.")
    if unit is not None:
        raise UsageError(f"unit = {unit!r} applies to a file; for {recording.file} set reference.unit.")
    if axis is None or axis == recording.axis or not recording.axis:
        return recording.reference
    across = recording.reference_across
    if across is None:
        raise DataError(
            f"{recording.file}: [reference] holds displacement along {recording.axis}; for the axis {axis!r} its file "
            f'must have a column {_own(axis)} with it, and camera.direction must be "xy". Name the reference\'s file '
            "itself."
        )
    return across


def compare(
    result: Result | str | Path,
    reference: str | Path,
    *,
    unit: str | None = None,
    axis: str | None = None,
    align: str = "none",
    max_lag_s: float = MAX_LAG_S,
) -> Comparison:
    """Compare the displacement of a result with a reference over their common span, as `midspan compare` does.

    result: what `estimate` returned, or any file of `read_result`; reference: a file, or a recording with [reference];
    unit: of the displacement of files that do not say it; axis: "x" or "y", of a result with both; align: the headline
    of the figures, plain ("none"), without the mean error ("zero"), or without lag and mean error ("zero+lag");
    max_lag_s: largest lag looked for, s. Raises UsageError for an axis that there is not, DataError for files that
    cannot be read or have no instants in common.
    """
    reference = path_of("reference", reference)
    if unit is not None:
        instance("unit", unit, str, "the name of a unit of length, such as 'mm'")
    if isinstance(result, Result):
        stored, second = of_result(result, axis), result.across is not None and result.across.axis == axis
    else:
        result = path_of("result", result)
        names = () if axis is None else list_channels(result).names
        if axis is not None and not any(_own(name) in names for name in "xy"):
            raise UsageError(f"axis = {axis!r}: {result.name} has one axis only. Leave the axis out.")
        stored = read_result(result, axis=axis)
        second = axis is not None and _own(axis) in names
    if axis is not None and second and not _is_recording(reference):
        # A file without midspan's columns holds what the user says it does.
        names = list_channels(reference).names
        if VALUE in names and not any(_own(name) in names for name in "xy"):
            raise DataError(
                f"{reference.name}: has {VALUE} but no column {_own(axis)} for the axis {axis!r}. Call the column "
                f"{_own(axis)} if it is along {axis}, or name another reference."
            )
    wanted = read_reference(reference, unit, axis)
    found = metrics.compare(stored.series, wanted, band=stored.band, align=align, max_lag_s=max_lag_s)
    assumed = [line for line in (*stored.series.notes, *wanted.notes) if line.endswith("assumed.")]
    lines = (*stored.series.damage, *wanted.damage, *stored.series.notices, *wanted.notices)
    assumed += [f"{line}." for line in lines]
    apart = [line for path in (result, reference) if not isinstance(path, Result) and (line := mismatch(path))]
    return replace(found, notes=(*apart, *assumed, *found.notes))
