"""miniSEED version 2: displacement, its standard deviation and velocity as 64-bit floats."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from midspan.errors import UsageError
from midspan.records import Nanoseconds
from midspan.sinks.table import ResultTable

# Channel codes on station MIDSP of the experimental network XX.
_CHANNELS = {"displacement_mm": "DSP", "displacement_std_mm": "STD", "velocity_mm_s": "VEL"}
# Along a second image axis: its letter in the last place.
_CHANNELS |= {
    name.replace("_mm", f"_{axis}_mm", 1): code[:2] + axis.upper() for axis in "xy" for name, code in _CHANNELS.items()
}
_SOURCE = "FDSN:XX_MIDSP__{0}_{1}_{2}"


def encode(table: ResultTable) -> Iterator[bytes]:
    """Channels DSP (mm), STD (mm) and VEL (mm/s), of a second axis DSX or DSY and so on, at the median interval.

    A new segment begins after each gap.
    Version 2 because ObsPy and most of seismology read no other; its start times are rounded to the µs. Source, status
    and metadata have no place in the format. Raises UsageError for a table without displacement or with fewer than two
    rows.
    """
    from pymseed import DataEncoding, MS3TraceList

    present = {name: code for name, code in _CHANNELS.items() if name in table.columns}
    if not present or table.time_ns.size < 2:
        raise UsageError(
            f"miniSEED holds {', '.join(_CHANNELS)} of two rows or more; received {table.time_ns.size} rows of "
            f"{', '.join(table.columns)}. Choose .csv, .parquet, .h5 or .mat."
        )
    # The median interval, sharpened by the mean of those near it: a rounded one alone drifts over a long record.
    steps = np.diff(table.time_ns)
    median = float(np.median(steps))
    step_ns = float(steps[np.abs(steps - median) < 0.5 * median].mean())
    traces = MS3TraceList()
    edges = segments(table.time_ns, step_ns)
    for name, code in present.items():
        values = np.ascontiguousarray(table.columns[name], dtype=np.float64)
        for first, last in pairwise(edges):
            start_ns = int(table.time_ns[first])
            traces.add_data(_SOURCE.format(*code), values[first:last], "d", 1e9 / step_ns, starttime=start_ns)
    yield b"".join(traces.generate(encoding=DataEncoding.FLOAT64, format_version=2))


def segments(time_ns: Nanoseconds, step_ns: float) -> NDArray[np.int64]:
    """Edges of the pieces within which every stamp is less than half an interval from the regular grid."""
    edges = [0]
    steps = np.diff(time_ns)
    jumps = np.flatnonzero(np.abs(steps - step_ns) > 0.5 * step_ns) + 1
    for first, last in zip([0, *jumps], [*jumps, time_ns.size], strict=True):
        start = int(first)
        while start < last:
            drift = time_ns[start:last] - time_ns[start] - np.arange(last - start) * step_ns
            off = np.flatnonzero(np.abs(drift) > 0.5 * step_ns)
            start = int(last) if off.size == 0 else start + int(off[0])
            edges.append(start)
    return np.array(edges, dtype=np.int64)
