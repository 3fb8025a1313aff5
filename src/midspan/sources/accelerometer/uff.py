"""Universal file format, dataset 58 (functions at nodal points, text or binary), read with pyuff."""

from pathlib import Path
from typing import Any

import numpy as np

from midspan.sources.accelerometer.channel import Channel, ChannelSet, distinct

_TIME_FUNCTIONS = (0, 1)
_NONE = ("", "NONE")
_ABSCISSA_IN_TIME = (0, 1, 17)
_UNIT_OF_DATA_TYPE = {8: "m", 11: "m/s", 12: "m/s^2", 17: "s"}
_DIRECTIONS = {1: "+X", -1: "-X", 2: "+Y", -2: "-Y", 3: "+Z", -3: "-Z"}


def read(path: Path) -> ChannelSet:
    """All time functions of dataset 58, named by their first identification line, else by node and direction.

    The unit is the ordinate's label, else SI by the ordinate's data type (displacement, velocity, acceleration).
    """
    import pyuff

    file = pyuff.UFF(str(path))
    types = [int(kind) for kind in file.get_set_types()]
    sets = [file.read_sets(k) for k, kind in enumerate(types) if kind == 58]
    # Dataset 164: lengths divided by this factor are in metres.
    units: dict[str, Any] = next((file.read_sets(k) for k, kind in enumerate(types) if kind == 164), {})
    length = float(units.get("length") or 1.0)
    used = [s for s in sets if s["func_type"] in _TIME_FUNCTIONS and not np.iscomplexobj(s["data"])]
    used = [s for s in used if s.get("abscissa_spec_data_type", 0) in _ABSCISSA_IN_TIME]
    notes = [f"{len(sets) - len(used)} functions that are not of time left out"] if len(used) < len(sets) else []
    channels: list[Channel] = []
    for entry in used:
        channel, said = _channel(entry, length, {channel.name for channel in channels})
        channels.append(channel)
        notes += [note for note in said if note not in notes]
    return ChannelSet(tuple(channels), tuple(notes))


def _channel(entry: dict[str, Any], length: float, taken: set[str]) -> tuple[Channel, list[str]]:
    name = str(entry.get("id1", "")).strip()
    if name.upper() in _NONE:
        name = f"{entry.get('rsp_node', 0)}:{_DIRECTIONS.get(int(entry.get('rsp_dir') or 0), '0')}"
    name = distinct(name, taken)
    label = str(entry.get("ordinate_axis_units_lab", "")).strip()
    kind = int(entry.get("ordinate_spec_data_type") or 0)
    values = np.ascontiguousarray(entry["data"], dtype=np.float64)
    unit, notes = (label, []) if label.upper() not in _NONE else (_UNIT_OF_DATA_TYPE.get(kind), [])
    if unit is not None and not label and length != 1.0 and kind in (8, 11, 12):
        values = values / length
        notes = [f"lengths divided by {length:g} to metres as the file's dataset 164 says"]
    elif unit is not None and label.upper() in _NONE:
        notes = [f"{name}: {unit} by the ordinate's data type {kind}"]
    if entry.get("abscissa_spacing"):
        rate_hz, said = _rate(float(entry["abscissa_inc"]))
        start_ns = round(float(entry["abscissa_min"]) * 1e9)
        return Channel(name, values, unit, rate_hz, start_ns), notes + said
    time_ns = np.rint(np.asarray(entry["x"], dtype=np.float64) * 1e9).astype(np.int64)
    return Channel(name, values, unit, time_ns=time_ns), notes


def _rate(step_s: float) -> tuple[float | None, list[str]]:
    """The rate of an even spacing; the file has six digits of the step, so a whole number of Hz within is meant."""
    if not step_s > 0:
        return None, []
    rate_hz, whole = 1.0 / step_s, float(round(1.0 / step_s))
    last_digit = 0.5 * 10.0 ** (np.floor(np.log10(step_s)) - 5)
    if whole and rate_hz != whole and abs(1.0 / whole - step_s) <= 1.01 * last_digit:
        return whole, [f"rate taken as {whole:g} Hz: the step of {step_s:g} s is rounded to six digits"]
    return rate_hz, []
