"""What hangs on a lens and passes before it by day and by night: drops of rain, headlights."""

from dataclasses import dataclass

import numpy as np

from midspan.records import Floats
from midspan.simulate.day.sky import Span
from midspan.simulate.scene.scene import Image

DRYING_S = 8.0  # a drop shrinks to nothing within this many seconds after the rain


class Drops:
    """Drops on a lens of `size_px` (rows, columns): they fall while it rains and dry afterwards, out of focus."""

    __slots__ = ("_end_s", "_place", "_radius_px", "_size_px", "_start_s")

    def __init__(
        self, size_px: tuple[int, int], rain: tuple[Span, ...], *, rng: np.random.Generator, count: int = 14
    ) -> None:
        self._size_px = size_px
        spans = np.array(rain, dtype=np.float64).reshape(-1, 2)
        start, end = np.repeat(spans, count, axis=0).T
        self._start_s: Floats = start + rng.uniform(0.0, 0.8, len(start)) * (end - start)
        self._end_s: Floats = end
        self._place = rng.uniform(0.0, 1.0, (len(start), 2)) * np.array(size_px)
        self._radius_px = rng.uniform(0.02, 0.06, len(start)) * float(np.hypot(*size_px))

    def cover(self, time_s: float) -> Image | None:
        """How much of each pixel (rows, columns) drops cover, 0 to 1; None without any."""
        dry = np.clip((time_s - self._end_s) / DRYING_S, 0.0, 1.0)
        there = np.flatnonzero((time_s >= self._start_s) & (dry < 1.0))
        if not len(there):
            return None
        rows, columns = (np.arange(size, dtype=np.float32) for size in self._size_px)
        clear = np.ones(self._size_px, dtype=np.float32)
        for k in there:
            radius = self._radius_px[k] * (1.0 - dry[k])
            away = np.hypot(rows[:, None] - self._place[k, 0], columns[None, :] - self._place[k, 1])
            # A drop on the lens is far out of focus: its border is a quarter of it wide.
            clear *= np.clip((away - 0.75 * radius) / (0.5 * radius + 0.5), 0.0, 1.0)
        covered: Image = np.float32(1.0) - clear
        return covered


@dataclass(frozen=True, slots=True)
class Headlights:
    """Cars at night, their lamps in row `row_px`, that pass from left to right in `crossing_s` from each of `starts_s`.

    Lamps dazzle `lamp_px` around them, and throw light of `strength` (relative to the full sun) on `reach_px` of the
    wall.
    """

    starts_s: tuple[float, ...] = ()
    row_px: float = 150.0
    crossing_s: float = 3.0
    apart_px: float = 14.0
    lamp_px: float = 2.5
    reach_px: float = 45.0
    strength: float = 0.08

    def place(self, time_s: float) -> float | None:
        """How far across the picture the car is at `time_s`, from 0 to 1; None without one."""
        return next(
            ((time_s - s) / self.crossing_s for s in self.starts_s if 0.0 <= time_s - s < self.crossing_s), None
        )

    def lights(self, size_px: tuple[int, int], time_s: float) -> tuple[Image, Image] | None:
        """Light thrown on the wall and light into the lens (rows, columns), relative to the full sun; None without a
        car.
        """
        place = self.place(time_s)
        if place is None:
            return None
        centre = (size_px[1] + 2 * self.reach_px) * place - self.reach_px
        thrown = self.strength * _spot(size_px, (self.row_px - 0.6 * self.reach_px, centre), self.reach_px)
        lamps = [(self.row_px, centre + side * self.apart_px / 2) for side in (-1.0, 1.0)]
        return thrown, sum((_spot(size_px, lamp, self.lamp_px) for lamp in lamps), np.zeros(size_px, dtype=np.float32))


def _spot(size_px: tuple[int, int], centre: tuple[float, float], std_px: float) -> Image:
    """A Gaussian spot (rows, columns) of height 1 about `centre` (row, column)."""
    down, across = (
        np.exp(-0.5 * ((np.arange(size) - middle) / std_px) ** 2).astype(np.float32)
        for size, middle in zip(size_px, centre, strict=True)
    )
    spot: Image = down[:, None] * across[None, :]
    return spot
