"""What stands behind the time history that can be zoomed: every row, sensor and reference, as columns."""

import base64
import json
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from midspan.evaluate.metrics import step_of
from midspan.records import NANOSECONDS, Floats, Nanoseconds, TimeSeries
from midspan.report.material import BAND, Material
from midspan.report.thinning import PAUSE_STEPS, starts

MAX_ORDER = 3
# Of the multiples: differences of the highest order are 2³ times larger, and JavaScript's numbers hold integers to 2⁵³.
MAX_MULTIPLE = 2**48


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """Finite values (n,), given to the nearest multiple of `quantum`, in their unit."""

    value: Floats
    quantum: float


def round_below(fine: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above `fine`, which must be above 0."""
    power = 10.0 ** math.floor(math.log10(fine))
    return float(max(k for k in (1.0, 2.0, 5.0) if k * power <= fine * (1.0 + 1e-9)) * power)


def packed(columns: Sequence[Column]) -> tuple[list[dict[str, Any]], str]:
    """How each column is to be read (quantum, count, order of the differences, bytes a value), and all data as text.

    A column is rounded to whole multiples of its quantum. Differences of the order that makes them smallest, coded
    without sign (0, −1, 1, −2, … as 0, 1, 2, 3, …) and split into bytes of equal weight, are deflated (RFC 1950).
    """
    layout, data = list[dict[str, Any]](), list[bytes]()
    for column in columns:
        multiple = np.clip(np.rint(column.value / column.quantum), -MAX_MULTIPLE, MAX_MULTIPLE).astype(np.int64)
        order, code = min(_codes(multiple), key=lambda found: float(np.sum(np.log2(found[1] + 1.0))))
        width = max(1, (int(code.max(initial=0)).bit_length() + 7) // 8)
        data += [((code >> np.uint64(8 * k)) & np.uint64(255)).astype(np.uint8).tobytes() for k in range(width)]
        layout.append({"quantum": column.quantum, "count": len(code), "order": order, "width": width})
    return layout, base64.b64encode(zlib.compress(b"".join(data), 9)).decode()


def _codes(multiple: Any) -> list[tuple[int, Any]]:
    """Order and codes (n,) without sign of the differences of each order."""
    found = []
    for order in range(MAX_ORDER + 1):
        step = np.diff(multiple, order, prepend=np.zeros(order, dtype=np.int64)) if order else multiple
        found.append((order, ((step << 1) ^ (step >> 63)).astype(np.uint64)))
    return found


# Longer records (an hour at 200 Hz is 720 000 rows) keep the extremes of half as many segments.
MAX_ROWS = 800_000
# A quantum is this share of a standard deviation or less, which rounding widens by 0.02 %, and this share of the range.
QUANTUM_STD, QUANTUM_RANGE = 1 / 16, 1 / 5000
QUANTUM_S = 1e-6
# Of the standard deviations themselves.
QUANTUM_OF_STD = 1 / 500


@dataclass(slots=True)
class Packing:
    """Columns that are collected; equal times of several series are one column."""

    material: Material
    columns: list[Column] = field(default_factory=list)
    stamps: list[tuple[Nanoseconds, int]] = field(default_factory=list)

    def add(self, value: Floats, quantum: float) -> int:
        """A column; its number."""
        self.columns.append(Column(np.asarray(value, dtype=np.float64), quantum))
        return len(self.columns) - 1

    def times(self, time_ns: Nanoseconds) -> int:
        """The column of these times, s after the first row."""
        for known, number in self.stamps:
            if np.array_equal(known, time_ns):
                return number
        t = self.material.clock.at(time_ns) - float(self.material.t[0])
        self.stamps.append((time_ns, self.add(t, QUANTUM_S)))
        return self.stamps[-1][1]

    def series(self, time_ns: Nanoseconds, value: Floats, fine: float, std: Floats | None = None) -> dict[str, Any]:
        """The columns of a series: times, values to `fine` or finer, standard deviations; what is not finite is left
        out, and more than MAX_ROWS are thinned.
        """
        known = np.isfinite(value) & (True if std is None else np.isfinite(std))
        time_ns, value = time_ns[known], value[known]
        at = starts(len(value), MAX_ROWS // 2)
        every = len(at) == len(value)
        if not every:
            time_ns = np.repeat(time_ns[at], 2)
            value = np.column_stack((np.minimum.reduceat(value, at), np.maximum.reduceat(value, at))).ravel()
        quantum = quantum_of(value, fine)
        found: dict[str, Any] = {"time": self.times(time_ns), "value": self.add(value, quantum), "every": every}
        if len(value) > 1:
            found["pause"] = PAUSE_STEPS * float(np.median(np.diff(time_ns[:: 1 if every else 2]))) / NANOSECONDS
        if std is not None:
            std = std[known] if every else np.repeat(np.maximum.reduceat(std[known], at), 2)
            typical = float(np.median(std)) if len(std) else 0.0
            found |= {"typical": typical, "std": self.add(std, round_below(max(typical, 1e-9) * QUANTUM_OF_STD))}
        return found

    def attributes(self, layout: dict[str, Any]) -> dict[str, str]:
        """The attributes of the figure: `data-rows`, the columns, and `data-chart`, what they are."""
        columns, text = packed(self.columns)
        return {"data-rows": text, "data-chart": json.dumps(layout | {"columns": columns})}


def quantum_of(value: Floats, fine: float) -> float:
    """A quantum of `fine` or finer that shows the values in 5000 steps or more, so that no zoom shows any."""
    extent = float(np.ptp(value)) if len(value) else 0.0
    return round_below(max(min(fine or np.inf, QUANTUM_RANGE * extent), 1e-12 * extent, 1e-9))


def chart_of(material: Material) -> tuple[dict[str, str], str]:
    """Attributes of the figure that the script makes a chart of, and in a sentence what the page holds."""
    result, packing = material.result, Packing(material)
    rows, std = result.estimate, result.displacement_std_mm
    own = 1e3 * float(np.sqrt(max(float(np.median(rows.variance_m2)) - result.zero_std_m**2, 0.0)))
    fine = QUANTUM_STD * (own or float(np.median(std)))
    # Half of what the noise of one sample of the acceleration changes the velocity by, mm/s.
    velocity_fine = 0.5 * 1e3 * result.calibration.noise_std_m_s2 * step_of(rows.time_ns)
    main = packing.series(rows.time_ns, result.displacement_mm, fine, std)
    known = np.isfinite(result.displacement_mm) & np.isfinite(std)
    status = rows.status[known].astype(np.float64)
    if not main["every"]:
        status = np.repeat(np.maximum.reduceat(status, starts(len(status), MAX_ROWS // 2)), 2)
    lines = [
        {"name": "displacement", "unit": "mm", "panel": "displacement", "shape": "line"} | main,
        *_reference(packing, fine),
        *_measured(packing),
        {"name": "velocity", "unit": "mm/s", "panel": "velocity", "shape": "line"}
        | packing.series(rows.time_ns, result.velocity_mm_s, velocity_fine),
        *_acceleration(packing),
    ]
    # One value is no line.
    lines = [line for line in lines if len(packing.columns[line["value"]].value) > 1]
    layout = {
        "first": float(material.t[0]),
        "label": material.clock.label,
        "band": BAND,
        "lines": lines,
        "status": packing.add(status, 1.0),
    }
    which = "every row" if main["every"] else "minimum and maximum of short segments"
    quantum = packing.columns[main["value"]].quantum
    return packing.attributes(layout), f"The page contains {which}, rounded to {quantum:g} mm."


def _reference(packing: Packing, fine: float) -> list[dict[str, Any]]:
    reference = packing.material.reference
    if reference is None:
        return []
    found = packing.series(reference.time_ns, reference.value + packing.material.reference_moved_mm, fine)
    return [{"name": "reference", "unit": "mm", "panel": "displacement", "shape": "under"} | found]


def _measured(packing: Packing) -> list[dict[str, Any]]:
    """What the sensors measured, as points."""
    return [
        {"name": one.name, "unit": "mm", "panel": "displacement", "shape": "points"}
        | packing.series(one.time_ns, one.value_mm, QUANTUM_STD * _typical(one.std_mm), one.std_mm)
        for one in packing.material.measured
        if np.isfinite(one.value_mm).any()
    ]


def _acceleration(packing: Packing) -> list[dict[str, Any]]:
    """The acceleration to a quarter of its noise."""
    found: TimeSeries | None = packing.material.acceleration
    if found is None:
        return []
    fine = 0.25 * packing.material.result.calibration.noise_std_m_s2
    columns = packing.series(found.time_ns, found.value, fine)
    return [{"name": "acceleration", "unit": "m/s²", "panel": "acceleration", "shape": "line"} | columns]


def _typical(std: Floats) -> float:
    known = std[np.isfinite(std)]
    return float(np.median(known)) if len(known) else 0.0
