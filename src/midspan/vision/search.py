"""Whole-pixel search for a template: every position nearby, or decimated positions over a large range."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats, Floats32
from midspan.vision.texture import values

COARSE_COST = 40_000_000  # multiplications of one coarse search, at most: some 20 ms
COARSE_SIDE_PX = 10  # a decimated template keeps at least this many pixels on a side
COARSE_CONTRAST = 0.3  # and at least this share of its variance, or decimation has averaged the texture away


@dataclass(frozen=True, slots=True)
class Span:
    """Whole-pixel positions of the window's top left corner: x0 … x1 and y0 … y1, both ends included."""

    x0: int
    x1: int
    y0: int
    y1: int

    @property
    def empty(self) -> bool:
        """Whether there is no position in it."""
        return self.x0 > self.x1 or self.y0 > self.y1

    def around(self, x: int, y: int, radius_x: int, radius_y: int) -> "Span":
        """The part of this span within the radii of (x, y)."""
        return Span(
            max(self.x0, x - radius_x),
            min(self.x1, x + radius_x),
            max(self.y0, y - radius_y),
            min(self.y1, y + radius_y),
        )


def cut(image: NDArray[np.generic], span: Span, size: tuple[int, int], margin: int, offset: float) -> Floats32 | None:
    """The image under all windows (rows, columns) = `size` of the span, with `margin` px more on every side.

    Values less `offset`; None when too many pixels have no value.
    """
    top, bottom = span.y0 - margin, span.y1 + size[0] + margin
    left, right = span.x0 - margin, span.x1 + size[1] + margin
    return values(image[top:bottom, left:right], offset)


def coarse_factor(template: Floats32) -> int:
    """By how much (8, 4, 2 or 1) the template may be decimated and keep its texture."""
    variance = float(template.var())
    for factor in (8, 4, 2):
        small = _core.shrink(template, factor)
        if min(small.shape) >= COARSE_SIDE_PX and float(small.var()) >= COARSE_CONTRAST * variance:
            return factor
    return 1


def coarse_span(span: Span, x: int, y: int, template_pixels: int, factor: int) -> Span:
    """The span, cut down around (x, y) when searching all of it would cost too much."""
    per_position = max(template_pixels // factor**2, 1)
    width, height = span.x1 - span.x0 + 1, span.y1 - span.y0 + 1
    allowed = COARSE_COST // per_position * factor**2
    if width * height <= allowed:
        return span
    radius = int(np.sqrt(allowed) / 2)
    x, y = min(max(x, span.x0), span.x1), min(max(y, span.y0), span.y1)
    return span.around(x, y, radius, radius)


def coarse_positions(
    image: NDArray[np.generic], template: Floats32, span: Span, *, factor: int, offset: float
) -> list[tuple[int, int]]:
    """Up to three separate positions x, y in `span` where the decimated template correlates best, best first."""
    raw = cut(image, span, template.shape, 0, offset)
    if raw is None:
        return []
    small, target = _core.shrink(raw, factor), _core.shrink(template, factor)
    if small.shape[0] < target.shape[0] or small.shape[1] < target.shape[1]:
        return []
    surface = _core.zncc_map(small, (target - target.mean()).astype(np.float32))
    return [(span.x0 + x * factor, span.y0 + y * factor) for x, y in peaks(surface, 3, 3)]


def peaks(surface: Floats, count: int, separation: int) -> list[tuple[int, int]]:
    """Columns x and rows y of the largest positive values of `surface`, at least `separation` apart, best first."""
    left = surface.copy()
    found: list[tuple[int, int]] = []
    while len(found) < count:
        y, x = divmod(int(left.argmax()), left.shape[1])
        if left[y, x] <= 0.0:
            break
        found.append((x, y))
        left[max(y - separation, 0) : y + separation + 1, max(x - separation, 0) : x + separation + 1] = -1.0
    return found
