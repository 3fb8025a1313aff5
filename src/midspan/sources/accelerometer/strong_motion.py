"""Strong-motion files of volume 1 (V1: uncorrected) and 2 (V2: corrected) of CSMIP/CGS and of the COSMOS format 1.20.

A channel is a text header, headers of whole and real numbers, then a block of values under a line that tells their
count, unit and Fortran format; CSMIP has acceleration, velocity and displacement in turn, COSMOS one a section.
Source: COSMOS Strong Motion Data Format 1.20 (2001); CSMIP report OSMS 85-03, volume 2.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from midspan.errors import DataError
from midspan.records import Floats
from midspan.sources.accelerometer.channel import Channel, ChannelSet, distinct

_CSMIP_BLOCK = re.compile(
    r"^\s*(?P<count>\d+)\s+points of (?:raw |uncor\w* )?(?P<kind>accel|veloc|displ)\w* data equally spaced at\s+"
    r"(?P<step>[\d.]+)\s*sec"
    r"(?:,?\s*\(?in\s+(?P<unit>[^\s(),]+?)\)?\.?)?[\s,.]*(?:\((?P<format>[^)]*)\))?\s*$",
    re.IGNORECASE,
)
_COSMOS_BLOCK = re.compile(
    r"^\s*(?P<count>\d+)\s+(?:raw |uncor\w* )?(?P<kind>accel|veloc|displ)\w*\.?\s+pts,.*?units\s*=\s*"
    r"(?P<unit>[^,(]+?)\s*(?:\(\s*\d+\s*\))?\s*,"
    r"\s*Format\s*=\s*\((?P<format>[^)]*)\)",
    re.IGNORECASE,
)
_COSMOS_REALS = re.compile(
    r"^\s*(?P<count>\d+)\s+Real-header values follow on\s+\d+\s+lines.*?Format\s*=\s*\((?P<format>[^)]*)\)",
    re.IGNORECASE,
)
_FORMAT = re.compile(r"^\s*(?P<columns>\d*)\s*[FEGIfegi](?P<width>\d+)")
_CHANNEL = re.compile(r"\bChan\w*\s+(?P<number>\d+)\s*:\s*(?P<direction>[^\s(,]+(?: Deg)?)", re.IGNORECASE)
_START = re.compile(r"start time:\s*(?P<text>[\d/]+,?\s+[\d:.]+)", re.IGNORECASE)

_KINDS = {"accel": "acceleration", "veloc": "velocity", "displ": "displacement"}
_DEFAULT_UNITS = {"accel": "cm/s^2", "veloc": "cm/s", "displ": "cm"}
# Entry 34 of the COSMOS real header (33 counted from zero) is the sample interval in seconds.
_COSMOS_STEP = 33


@dataclass(frozen=True, slots=True)
class _Block:
    """One block of values and where it starts; `first` is the line behind the heading."""

    channel: str
    kind: str
    unit: str
    step_s: float
    count: int
    width: int
    first: int


def read(path: Path) -> ChannelSet:
    """Acceleration, velocity and displacement of each channel as `channel_1_acceleration` … in the file's own unit.

    Times start at zero at the first sample; the header's start time is reported in the notes. Raises DataError where no
    block of values is found or one is shorter than its line says.
    """
    lines = path.read_text(encoding="latin-1").splitlines()
    channels: list[Channel] = []
    notes: list[str] = []
    for block in _blocks(lines):
        values = _numbers(lines, block.first, block.count, block.width)
        if values.size < block.count:
            raise DataError(
                f"{path}, line {block.first}: {block.count} values are announced, {values.size} are there. "
                "The file is cut off; get it again."
            )
        if not block.step_s > 0:
            raise DataError(f"{path}, line {block.first}: the sample interval (s) is missing. Correct the header.")
        scale, unit = _plain_unit(block.unit)
        name = distinct(f"channel_{block.channel}_{_KINDS[block.kind]}", {c.name for c in channels})
        channels.append(Channel(name, values * scale, unit, 1.0 / block.step_s, 0))
    if not channels:
        raise DataError(
            f"{path} has no block of volume-2 values, nor of volume 1 (a line such as '7500 points of accel data "
            "equally spaced at .010 sec' or '7500 acceleration pts, approx 75 secs, units=cm/s^2, Format=(8F10.5)'). "
            "Give a CSMIP or COSMOS V1 or V2 file."
        )
    notes += sorted({f"header: start time {m['text']}, not used" for line in lines[:60] if (m := _START.search(line))})
    directions: dict[str, str] = {}
    for named in filter(None, map(_CHANNEL.search, lines)):
        directions.setdefault(named["number"], named["direction"])
    notes += [f"channel {number}: direction {direction}" for number, direction in directions.items()]
    return ChannelSet(tuple(channels), tuple(notes))


def _blocks(lines: list[str]) -> list[_Block]:
    blocks: list[_Block] = []
    channel, step_s = "1", 0.0
    for k, line in enumerate(lines):
        if not any(c.isalpha() for c in line):
            continue
        if named := _CHANNEL.search(line):
            channel = named["number"]
        elif reals := _COSMOS_REALS.match(line):
            values = _numbers(lines, k + 1, int(reals["count"]), _width(reals["format"], 15))
            step_s = float(values[_COSMOS_STEP]) if values.size > _COSMOS_STEP else 0.0
        elif match := _CSMIP_BLOCK.match(line) or _COSMOS_BLOCK.match(line):
            kind = match["kind"].lower()
            step = float(match.groupdict().get("step") or step_s)
            unit = match["unit"] or _DEFAULT_UNITS[kind]
            blocks.append(_Block(channel, kind, unit, step, int(match["count"]), _width(match["format"], 10), k + 1))
    return blocks


def _width(text: str | None, default: int) -> int:
    match = _FORMAT.match(text or "")
    return int(match["width"]) if match else default


def _numbers(lines: list[str], first: int, count: int, width: int) -> Floats:
    """Up to `count` numbers of `width` characters each; they may touch, so blanks cannot part them."""
    fields: list[float] = []
    for line in map(str.rstrip, lines[first:]):
        for start in range(0, len(line), width):
            if len(fields) == count:
                return np.array(fields)
            try:
                fields.append(float(line[start : start + width]))
            except ValueError:
                return np.array(fields)
    return np.array(fields)


def _plain_unit(unit: str) -> tuple[float, str | None]:
    """Factor and unit: older files count in tenths of g, written g/10; counts of a converter have no unit."""
    text = unit.strip().rstrip(".")
    if text.lower() in ("count", "counts"):
        return 1.0, None
    if re.fullmatch(r"g\s*/\s*10|g\*10\*\*-1", text, re.IGNORECASE):
        return 0.1, "g"
    return 1.0, text
