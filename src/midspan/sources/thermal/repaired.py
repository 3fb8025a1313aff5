"""Frames of temperatures without holes: dead pixels are filled, frames with too many of them passed over; all told."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import Frame, Nanoseconds
from midspan.thermal.dead_pixels import filled, stuck_pixels
from midspan.vision.frame_source import FrameInfo, FrameSource

# A frame of which more is missing is not used: what was filled would be tracked.
MAX_MISSING = 0.2
# Frames spread over the file that tell which pixels are stuck, and the memory they may take.
_LOOKED_AT = 32
_MAX_BYTES = 200_000_000
_MAX_NAMED = 3


class RepairedFrames(FrameSource):
    """Frames in °C of another source, every value a number; `info.damage` tells what was filled and passed over."""

    def __init__(self, source: FrameSource, name: str) -> None:
        """`name`: of the file, for messages. Raises DataError where no frame that is looked at can be used."""
        self._source, self._name = source, name
        self._passed: set[int] = set()
        self._holes: dict[int, int] = {}
        first = next(iter(source.frames(0, 1)), None)
        if first is None or _missing_share(first.pixels) > MAX_MISSING:
            _ = self._stuck

    @property
    def info(self) -> FrameInfo:
        """What is known of the source, and so far of its damage."""
        known = self._source.info
        return replace(known, damage=(*known.damage, *self._damage()))

    def times_ns(self) -> Nanoseconds:
        """Time stamps of the source."""
        return self._source.times_ns()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames in °C without holes; those of which more than a fifth is missing are passed over."""
        stuck = self._stuck
        for frame in self._source.frames(start, stop):
            holes = ~np.isfinite(frame.pixels)
            missing = int(np.count_nonzero(holes))
            if missing > MAX_MISSING * holes.size:
                self._passed.add(frame.index)
                continue
            if missing:
                self._holes[frame.index] = missing
            dead = holes | stuck
            yield replace(frame, pixels=filled(frame.pixels, dead)) if dead.any() else frame

    @cached_property
    def _stuck(self) -> NDArray[np.bool_]:
        """Pixels (rows, columns) that are stuck, by frames from all over the file."""
        known = self._source.info
        count = min(_LOOKED_AT, max(_MAX_BYTES // max(4 * known.width * known.height, 1), 1))
        places = np.unique(np.linspace(0, len(self.times_ns()) - 1, count).astype(int))
        usable = []
        refused: DataError | None = None
        for k in places:
            try:
                seen = next(iter(self._source.frames(int(k), int(k) + 1)), None)
            except DataError as error:
                # Told where the frames are read in their order: the first that is wrong counts.
                refused = refused or error
                continue
            if seen is not None and _missing_share(seen.pixels) <= MAX_MISSING:
                usable.append(seen.pixels)
        if not usable and refused is not None:
            raise refused
        if not usable:
            raise DataError(
                f"{self._name} must hold temperatures in °C; of the {len(places)} frames looked at all have more than "
                f"{100 * MAX_MISSING:g} % of their values missing (all its values are missing, or most). Check how "
                "it was written."
            )
        return stuck_pixels(np.stack(usable).astype(np.float32, copy=False))

    def _damage(self) -> list[str]:
        told = []
        # Not before they were looked for: opening a file reads its first frame only.
        stuck = self.__dict__.get("_stuck")
        if stuck is not None and stuck.any():
            places = np.argwhere(stuck)
            named = ", ".join(f"({x}, {y})" for y, x in places[:_MAX_NAMED])
            more = f" and {len(places) - _MAX_NAMED} more" if len(places) > _MAX_NAMED else ""
            told.append(f"{len(places)} stuck pixels, at (x, y) = {named}{more}, are filled from their neighbours")
        if self._holes:
            told.append(
                f"{len(self._holes)} frames have missing values (NaN), at most {max(self._holes.values())} a frame, "
                "filled from their neighbours"
            )
        if self._passed:
            numbers = sorted(self._passed)
            named = ", ".join(str(k) for k in numbers[:_MAX_NAMED]) + (" …" if len(numbers) > _MAX_NAMED else "")
            told.append(
                f"{len(numbers)} frames ({named}) have more than {100 * MAX_MISSING:g} % of their values missing "
                "(NaN) and were passed over"
            )
        return told


def _missing_share(pixels: NDArray[np.generic]) -> float:
    return float(np.mean(~np.isfinite(pixels)))
