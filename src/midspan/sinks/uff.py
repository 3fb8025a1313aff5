"""Universal file format: one dataset 58 a column, binary with 64-bit floats."""

from pathlib import Path

import numpy as np

from midspan.errors import UsageError
from midspan.records import Floats
from midspan.sinks.table import UNITS, ResultTable, codes, is_text

_DATA_TYPE = {"time_s": 17, "displacement_mm": 8, "displacement_std_mm": 8, "velocity_mm_s": 11}
_TIME_RESPONSE = 1
_GENERAL = 1


def write(path: Path, table: ResultTable) -> None:
    """Every column as a time response named by its first line, its unit (mm, not m) in the ordinate's label.

    The abscissa is even, from the first time stamp at the median interval; the exact times are the function `time_s`.
    Words become codes. Binary (58b), since the text form has twelve digits only. Raises UsageError below two rows.
    """
    import pyuff

    if table.time_ns.size < 2:
        raise UsageError(f"A universal file needs two rows or more; received {table.time_ns.size}. Choose .csv.")
    step_s = float(np.median(np.diff(table.time_ns))) * 1e-9
    first_s = float(table.time_ns[0]) * 1e-9
    abscissa = np.asarray(first_s + np.arange(table.time_ns.size) * step_s, dtype=np.float64)
    path.unlink(missing_ok=True)
    file = pyuff.UFF(str(path))
    for number, (name, values) in enumerate(table.columns.items(), start=1):
        coded = codes(name, values)
        if coded is None and is_text(values):
            continue
        numbers = np.array(values if coded is None else coded, dtype=np.float64)
        file.write_sets(_dataset(number, name, abscissa, step_s, numbers), "add")
    if not path.is_file():
        raise UsageError(f"A universal file needs columns of numbers; received {', '.join(table.columns)}.")


def _dataset(number: int, name: str, abscissa: Floats, step_s: float, values: Floats) -> dict[str, object]:
    kind = _DATA_TYPE.get(name, _GENERAL)
    return {
        "type": 58,
        "binary": 1,
        "func_type": _TIME_RESPONSE,
        "func_id": number,
        "rsp_node": number,
        "rsp_dir": 0,
        "ref_node": 0,
        "ref_dir": 0,
        "data": values,
        "x": abscissa,
        "id1": name,
        "abscissa_spacing": 1,
        "abscissa_inc": step_s,
        "abscissa_spec_data_type": 17,
        "abscissa_axis_lab": "time",
        "abscissa_axis_units_lab": "s",
        "ordinate_spec_data_type": kind,
        "ordinate_axis_lab": name[:20],
        "ordinate_axis_units_lab": UNITS.get(name, "NONE"),
        "orddenom_spec_data_type": 0,
        "z_axis_spec_data_type": 0,
    }
