"""Whether a place moves as one: its blocks are followed, and compared in time course.

A region across the edge of what moves gives a translation between that of its two parts, which fits the accelerometer
with a wrong scale factor.
"""

from dataclasses import dataclass, field

import numpy as np

from midspan.errors import MidspanError
from midspan.records import Floats, Frame, Region
from midspan.vision.template import TemplateSettings, TemplateTracker

# A place is parted into this many blocks each way, of no fewer pixels than these.
BLOCKS, MIN_BLOCK_PX = 4, 16
# Each sixth frame of a trial is used: blocks need fewer than a scale factor does.
EVERY = 6
# A block moves with the most moved ones where it has this share of their motion, and not where it has less than that.
MOVES, RESTS = 0.75, 0.5
# What a block differs by from its share of the motion, over the motion, where that share shows.
CLEAR = 0.3
# Motion that differs from a block's noise, px rms; share of the frames in which a block must be seen.
MIN_MOTION_PX, SEEN = 0.05, 0.8
# What is left of a place has this many blocks at least.
LEFT = 4


@dataclass(slots=True)
class Blocks:
    """The blocks of a place, followed from the first frame pushed."""

    region: Region
    axis: str
    trackers: list[tuple[int, int, TemplateTracker]] = field(default_factory=list)
    rows: list[list[float]] = field(default_factory=list)

    @property
    def sides(self) -> tuple[int, int]:
        """Width and height of a block, px."""
        return self.region.width // BLOCKS, self.region.height // BLOCKS

    def push(self, frame: Frame) -> None:
        """Follow the blocks into a frame; in the first one they are cut out."""
        wide, high = self.sides
        if min(wide, high) < MIN_BLOCK_PX:
            return
        if not self.rows:
            for j, i in np.ndindex(BLOCKS, BLOCKS):
                place = Region(self.region.x + i * wide, self.region.y + j * high, wide, high)
                try:
                    self.trackers.append((j, i, TemplateTracker(frame, place, TemplateSettings())))
                except MidspanError:
                    continue
        found = [tracker.push(frame) for _, _, tracker in self.trackers]
        self.rows.append([one.x_px if self.axis == "x" else one.y_px for one in found])

    def shares(self) -> Floats:
        """The motion of each block (rows, columns) over that of the most moved ones; NaN where that does not show."""
        shares = np.full((BLOCKS, BLOCKS), np.nan)
        track = np.array(self.rows, dtype=np.float64).reshape(len(self.rows), len(self.trackers))
        seen = np.mean(np.isfinite(track), axis=0) >= SEEN if track.size else np.zeros(0, dtype=np.bool_)
        if not seen.any():
            return shares
        left = track[:, seen]
        left = np.where(np.isfinite(left), left, np.nanmean(left, axis=0))
        left = left - np.mean(left, axis=0)
        most = np.std(left, axis=0) >= 0.9 * np.quantile(np.std(left, axis=0), 0.75)
        common = np.median(left[:, most], axis=1)
        power = float(common @ common)
        if power < len(common) * MIN_MOTION_PX**2:
            return shares
        found = common @ left / power
        clear = np.mean((left - np.outer(common, found)) ** 2, axis=0) < CLEAR**2 * power / len(common)
        for k, share, shown in zip(np.flatnonzero(seen), found, clear, strict=True):
            shares[self.trackers[k][:2]] = share if shown else np.nan
        return shares

    def places(self) -> tuple[Region, ...]:
        """Where to look instead: the place itself where all of it moves as one; else the largest part of it that does,
        and before it a place as large, moved to where that part is at its end. Empty where too little does.
        """
        shares = self.shares()
        if not np.any(shares < RESTS):
            return (self.region,)
        moves, known = ~(shares <= MOVES), shares > MOVES
        best = 0, (0, 0, 0, 0)
        for j, i in np.ndindex(BLOCKS, BLOCKS):
            for height, width in np.ndindex(BLOCKS - j, BLOCKS - i):
                inside = np.s_[j : j + height + 1, i : i + width + 1]
                size = int(np.count_nonzero(known[inside]))
                if size > best[0] and moves[inside].all():
                    best = size, (i, j, width + 1, height + 1)
        if best[0] < LEFT:
            return ()
        (wide, high), (i, j, width, height), whole = self.sides, best[1], self.region
        part = Region(whole.x + i * wide, whole.y + j * high, width * wide, height * high)
        x = _moved(whole.x, (part.x, part.width), whole.width)
        y = _moved(whole.y, (part.y, part.height), whole.height)
        moved = Region(x, y, whole.width, whole.height)
        return (moved, part) if x >= 0 and y >= 0 else (part,)


def _moved(start: int, part: tuple[int, int], length: int) -> int:
    """Where a span of `length` begins that has its part (begin, length) at its end, or begin where that is there."""
    begin, size = part
    if size == length:
        return start
    return begin + size - length if begin == start else begin
