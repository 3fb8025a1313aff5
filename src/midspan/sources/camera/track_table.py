"""What was tracked before, in place of frames: a table that `midspan track` or another program wrote.

Columns `x_px`, `y_px` (empty or NaN: lost) and time (`time_s`, or `time_ns` since 1970); optional `std_x_px`,
`std_y_px`, `quality`, `strength`, `reference_std_x_px`, `reference_std_y_px`. Those of a further target, or of all, end
with `_` and its name.
"""

import zipfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from midspan.errors import DataError
from midspan.records import Floats, Frame, Nanoseconds, PixelTrack, Region, Status
from midspan.sources.accelerometer.channel import Channel
from midspan.sources.accelerometer.clock import numbers_to_ns
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.camera.frames import FrameRequest, rate_times, require_increasing
from midspan.trees import TreeError, read_json
from midspan.vision.frame_source import NOWHERE, FrameInfo, FrameSource, StoredTrack

# Where a table does not say how sure it is: what a good tracker reaches, px. Calibration estimates the true one.
USUAL_STD_PX = 0.01


def holds_tracks(path: Path) -> bool:
    """Whether a table has the columns of a track. What cannot be read is not judged."""
    try:
        if path.suffix.lower() == ".npz":
            # Its names alone: what is damaged is left to the reader of stacks.
            with zipfile.ZipFile(path) as archive:
                names = {name.removesuffix(".npy") for name in archive.namelist()}
        else:
            names = set(list_channels(path).names)
    except Exception:  # the reader of tables says what is wrong with it
        return False
    return bool(_ends(names))


def _ends(names: Iterable[str]) -> list[str]:
    """What the columns of each target end with, in their order."""
    known = dict.fromkeys(names)
    ends = [name.removeprefix("x_px") for name in known if name == "x_px" or name.startswith("x_px_")]
    return [end for end in ends if f"y_px{end}" in known]


class TrackFrames(FrameSource):
    """The frames that a track was made from: their times, and what was found in them."""

    def __init__(self, path: Path, request: FrameRequest) -> None:
        found = list_channels(path)
        columns = {channel.name: channel for channel in found.channels}
        step = request.every
        self._time_ns = _times(path, columns, request)[::step]
        regions: dict[str, Region] = {}
        with suppress(OSError, TreeError, KeyError, TypeError, ValueError):
            # Where the `.json` of the table tells them.
            targets = read_json(path.with_suffix(".json"))["targets"]
            regions = {str(one["name"]): Region(*(int(v) for v in one["roi"])) for one in targets}
        names = {end: end.removeprefix("_") for end in _ends(columns)}
        if "" in names:
            names[""] = next((name for name in regions if name not in names.values()), "1")
        self.tracks = tuple(
            _track(columns, end, self._time_ns, step, (name, regions.get(name, NOWHERE))) for end, name in names.items()
        )
        self._damage = found.damage

    @property
    def info(self) -> FrameInfo:
        """What is known of the frames: only where the targets were."""
        width = max(one.region.x + one.region.width for one in self.tracks)
        height = max(one.region.y + one.region.height for one in self.tracks)
        return FrameInfo(width, height, 8, len(self._time_ns), "track", None, damage=self._damage)

    def times_ns(self) -> Nanoseconds:
        """Time stamps (n,)."""
        return self._time_ns

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """There are none: raises DataError."""
        raise DataError("A track contains results, not images; this needs the images.")


def _times(path: Path, columns: dict[str, Channel], request: FrameRequest) -> Nanoseconds:
    """Stamps (n,) from the table's column of time, else from the rate."""
    count = columns[f"x_px{_ends(columns)[0]}"].size
    named = next((columns[name] for name in ("time_ns", "time_s", "time", "t") if name in columns), None)
    if request.rate_hz is not None or named is None:
        time_ns = rate_times(path, request, count)
    else:
        time_ns = numbers_to_ns(named.values, named.unit)[0]
    return require_increasing(f"{path}: times", time_ns)


def _track(
    columns: dict[str, Channel], end: str, time_ns: Nanoseconds, step: int, placed: tuple[str, Region]
) -> StoredTrack:
    """One target's columns; `end`: of their names; placed: its own name, and where it was."""

    def column(name: str, otherwise: float) -> Floats:
        channel = columns.get(f"{name}{end}")
        if channel is None:
            return np.full(len(time_ns), otherwise)
        return np.asarray(channel.values, dtype=np.float64)[::step]

    x, y = column("x_px", np.nan), column("y_px", np.nan)
    seen = np.isfinite(x) & np.isfinite(y)
    reference = np.column_stack((column("reference_std_x_px", 0.0), column("reference_std_y_px", 0.0))) ** 2
    variance = np.column_stack((column("std_x_px", USUAL_STD_PX), column("std_y_px", USUAL_STD_PX))) ** 2
    # What the reference makes is part of the deviations of a track's file.
    single = np.where(seen[:, None], np.maximum(variance - reference, 0.0), np.inf)
    quality = np.where(seen, column("quality", 1.0), 0.0)
    x, y = np.where(seen, x, np.nan), np.where(seen, y, np.nan)
    status = np.where(seen, Status.TRACKING, Status.LOST).astype(np.uint8)
    unknown = np.full(len(time_ns), np.nan)
    rows = PixelTrack(time_ns, x, y, single[:, 0], single[:, 1], quality, status, unknown, unknown)
    strength = np.where(seen, column("strength", 100.0), 0.0)
    return StoredTrack(*placed, rows, strength, np.where(seen[:, None], reference, 0.0))
