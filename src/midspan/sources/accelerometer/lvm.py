"""LabVIEW measurement files (lvm), read with lvm_read; those without LabVIEW's header are columns of text."""

from dataclasses import replace
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from midspan.errors import DataError
from midspan.records import Floats
from midspan.sources.accelerometer import text
from midspan.sources.accelerometer.channel import Channel, ChannelSet
from midspan.sources.accelerometer.last_line import cut_last_line
from midspan.sources.boundary import head_of, require_memory

_FIRST_WORDS = b"LabVIEW Measurement"
# Lines that hold the file's own header.
_HEAD_LINES = 40
# What lvm_read needs for a byte of text: a number of Python (32 bytes) for each field of four characters or more.
_BYTES_OF_A_BYTE = 8


def read(path: Path) -> ChannelSet:
    """The channels of all segments one behind the other; `X_Value` is the time in s where the file has it.

    Where the time starts again in a later segment it is moved by the difference of the segments' date and time. A file
    without a header, as LabVIEW writes with "no headers" and other programs under this suffix, is read as text columns.
    """
    if not head_of(path).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(_FIRST_WORDS):
        try:
            columns = text.read(path)
        except DataError:
            raise DataError(
                f"{path} cannot be read as LabVIEW measurement: it has neither its header nor columns of numbers. "
                "Check that the file is whole."
            ) from None
        return replace(columns, notes=("no header of LabVIEW: read as text columns", *columns.notes))
    require_memory(path, _BYTES_OF_A_BYTE * path.stat().st_size, "its table")
    content, damage = _content(path)
    segments = [content[k] for k in range(content["Segments"])]
    names = [str(name) for name in segments[0]["Channel names"]]
    same = [s for s in segments if [str(n) for n in s["Channel names"]] == names]
    notes = [f"{len(segments) - len(same)} segments with other channels left out"] if len(same) < len(segments) else []
    table = np.vstack([np.asarray(segment["data"], dtype=np.float64) for segment in same])
    if str(content.get("X_Columns", "One")) == "No":
        return ChannelSet(_without_time(names, table, same[0]), tuple(notes), damage)
    time_s, moved = _continued([np.asarray(s["data"])[:, 0] for s in same], [_start(content, s) for s in same])
    notes += ["later segments moved by their date and time"] if moved else []
    units = _units(same[0], len(names) - 1)
    channels = [Channel("X_Value", time_s, "s")]
    for k, name in enumerate(names[1:], start=1):
        if name not in ("Comment", "X_Value") and k < table.shape[1] and not np.isnan(table[:, k]).all():
            channels.append(Channel(name, table[:, k].copy(), units[k - 1]))
    return ChannelSet(tuple(channels), tuple(notes), damage)


def _content(path: Path) -> tuple[dict[Any, Any], tuple[str, ...]]:
    """What lvm_read finds, without a last line that is cut off, and sentences on what the file lacks."""
    import lvm_read

    with path.open(encoding="utf-8", errors="ignore") as file:
        lines = list(islice(file, _HEAD_LINES))
    head = dict(line.strip("\r\n").split("\t", 1) for line in lines if "\t" in line)
    # Without the field Separator the header's own lines show it: Writer_Version is the first of them.
    shown = any(line.startswith("Writer_Version,") for line in lines)
    comma = head.get("Separator", "Comma" if shown else "").strip() == "Comma"
    decimal = head.get("Decimal_Separator", ".").strip() or "."
    cut = cut_last_line(path, encoding="utf-8", delimiter="," if comma else "\t", decimal=decimal)
    if cut is None and not shown:
        # The reader would otherwise leave a pickle next to the user's file, and trust one that it finds.
        content = lvm_read.read(str(path), read_from_pickle=False, dump_file=False)
    else:
        sound = path.read_bytes()[: None if cut is None else cut[0]].decode("utf-8", errors="ignore")
        content = lvm_read.read_str(sound, separator="," if shown else None)
    last = content[content["Segments"] - 1]
    declared, rows = np.nanmax(np.asarray(last.get("Samples") or [0.0], dtype=np.float64)), len(last["data"])
    damage = [cut[1]] if cut is not None and cut[1] else []
    if rows < declared:
        damage.append(f"its last segment is cut off: {rows} of {declared:.0f} samples are in it")
    return content, tuple(damage)


def _without_time(names: list[str], table: Floats, segment: dict[Any, Any]) -> tuple[Channel, ...]:
    steps = segment.get("Delta_X") or [np.nan]
    starts = segment.get("X0") or [0.0]
    units = _units(segment, len(names))
    channels = []
    for k, name in enumerate(names):
        if name == "Comment" or k >= table.shape[1]:
            continue
        step = float(steps[min(k, len(steps) - 1)])
        rate_hz = 1.0 / step if np.isfinite(step) and step > 0 else None
        start_ns = round(float(starts[min(k, len(starts) - 1)]) * 1e9)
        channels.append(Channel(name, table[:, k].copy(), units[k], rate_hz, start_ns if rate_hz else None))
    return tuple(channels)


def _units(segment: dict[Any, Any], count: int) -> list[str | None]:
    labels = [str(label).strip() or None for label in segment.get("Y_Unit_Label", [])]
    return (labels + [None] * count)[:count]


def _start(content: dict[Any, Any], segment: dict[Any, Any]) -> datetime | None:
    """Date and time of a segment; LabVIEW writes more digits of the second than Python reads."""
    date = str(segment.get("Date", content.get("Date", "")))
    clock = str(segment.get("Time", content.get("Time", ""))).replace(",", ".")
    whole, _, fraction = clock.partition(".")
    try:
        return datetime.strptime(f"{date} {whole}.{fraction[:6] or '0'}", "%Y/%m/%d %H:%M:%S.%f")
    except ValueError:
        return None


def _continued(times_s: list[Floats], starts: list[datetime | None]) -> tuple[Floats, bool]:
    first = starts[0]
    pieces = [times_s[0]]
    moved = False
    for time_s, start in zip(times_s[1:], starts[1:], strict=True):
        restarted = time_s.size and pieces[-1].size and time_s[0] <= pieces[-1][-1]
        shift_s = (start - first).total_seconds() if restarted and start and first else 0.0
        moved = moved or shift_s != 0.0
        pieces.append(time_s + shift_s)
    return np.concatenate(pieces), moved
