"""The measurements of several sensors in one: every later sensor is brought to the zero of the first."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.errors import DataError
from midspan.fusion.path import at
from midspan.fusion.streams import KalmanSettings, smooth
from midspan.recording.fusing.fuse import LevelError
from midspan.recording.streams.span import inside
from midspan.records import Acceleration, Displacement, Floats, Source, joined, part

# The zero beside another sensor is as uncertain as the means of so many parts of the overlap scatter; each needs this
# many measurements, else single ones are taken.
PARTS, LEAST_OF_PART = 8, 3


@dataclass(frozen=True, slots=True)
class Merged:
    """All measurements in time order; levels: how well the zeros of the later sensors are known."""

    measured: Displacement
    levels: tuple[LevelError, ...]
    warnings: tuple[str, ...]


_CHECKED = {
    Source.CAMERA: "camera.roi and the video",
    Source.INFRARED: "infrared.roi and the pictures",
    Source.RADAR: "what the radar sees",
    Source.DISPLACEMENT: "the displacement file",
}


def merged(blocks: Sequence[Displacement], acceleration: Acceleration, kalman: KalmanSettings) -> Merged:
    """Bring all blocks to the zero of the first one by the robust middle of their difference where they overlap.

    A sensor that never overlaps those before it is left out. Raises DataError where nothing is left.
    """
    first, levels, warnings = blocks[0], [], []
    for other in blocks[1:]:
        smoothed = smooth(acceleration, first, kalman).estimate
        seen = first.time_ns[np.isfinite(first.value_m)]
        span = inside(other.time_ns, int(seen[0]), int(seen[-1])) if len(seen) else slice(0, 0)
        apart = other.value_m[span] - at(smoothed, other.time_ns[span])[0]
        apart = apart[np.isfinite(apart)]
        name = Source(int(other.source[0])).word
        if not len(apart):
            before = " or ".join(Source(int(code)).word for code in np.unique(first.source))
            warnings.append(f"{name}: never overlaps the {before}, so its zero is unknown; it was left out.")
            continue
        levels.append(LevelError(Source(int(other.source[0])), int(other.time_ns[0]), _std_of_middle(apart)))
        both = joined([first, replace(other, value_m=other.value_m - float(np.median(apart)))])
        first = part(both, np.argsort(both.time_ns, kind="stable"))
    if not np.isfinite(first.value_m).any():
        tried = dict.fromkeys(int(code) for block in blocks for code in np.unique(block.source))
        told = " and ".join(_CHECKED[Source(code)] for code in tried if Source(code) in _CHECKED)
        raise DataError(f"No frame could be tracked and no displacement is left; check {told or 'the sensors'}.")
    return Merged(first, tuple(levels), tuple(warnings))


def _std_of_middle(apart: Floats) -> float:
    """Standard deviation of the middle of differences (n,): from the scatter of its parts, which slow errors widen."""
    count = PARTS if len(apart) >= PARTS * LEAST_OF_PART else len(apart)
    if count < 2:
        return 0.0
    middles = np.array([np.median(piece) for piece in np.array_split(apart, count)])
    return float(middles.std(ddof=1) / np.sqrt(count))
