"""Places that look like the target: known from the first frame, distinguished by where they lie to each other.

A row of equal dots, the windows of a façade or a railing match the target's template at several places. A target that
moves by a good part of their spacing from one frame to the next is aliased: the nearest match need not be the target.
The first frame shows where such places lie from the target and, by its correlation with its own surroundings, where
none is. What a frame shows at these places tells which of them was found, as long as an end of the pattern is in view.
Else the one counts that is clearly more alike, or clearly nearer to the expected place than all others.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats, Floats32, Prediction, Region
from midspan.vision.search import Span, coarse_factor, coarse_span, cut, peaks

# Correlation, over what noise allows, from which on a poorer frame may mistake one place for the other; the automatic
# choice of regions has the same limit. Along a texture of one direction the correlation never falls below it.
MIN_LIKENESS = 0.8
# An alternative counts as out of the question where it lies this many times farther from the expected place than what
# was found: odds of nine to one for a motion whose tails fall as those of a Cauchy distribution.
CLEARLY_FARTHER = 3.0
# Difference of correlations, half of that between a copy of the target (above 0.8) and what is none (usually 0), that
# contradicts a place. Partial cover and blur cost less.
MAX_DIFFERENCE = 0.4
# Energy that the template leaves of the target's place and of an alternative: twice the amplitude. What blur, light and
# noise leave is the same at all of them.
CLEARLY_LESS = 4.0
MAX_ALTERNATIVES = 8  # the nearest: what lies behind another is ruled out by that one's distance


@dataclass(frozen=True, slots=True, eq=False)
class Alternatives:
    """The places (n, 2) x, y in px from the target that look like it in the reference frame; none: all the rest unused.

    pattern: the target, decimated by `factor`, without its mean; `offset` is subtracted from frames. surface: its
    correlation with the reference frame at every `factor` px, whose first value is for the target moved by `corner`
    (2,) px.
    """

    places: Floats
    window: Region
    pattern: Floats32
    factor: int
    offset: float
    surface: Floats
    corner: Floats

    def then(self, moved: Floats) -> float:
        """Correlation of the reference frame with the target moved by `moved` (2,) px; NaN where it is not known."""
        x, y = (round(float(v)) for v in (moved - self.corner) / self.factor)
        rows, columns = self.surface.shape
        if not (0 <= x < columns and 0 <= y < rows):
            return float("nan")
        return float(self.surface[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].max())

    def now(self, image: NDArray[np.generic], moved: Floats) -> float:
        """Correlation of a frame with the target moved by `moved` (2,) px; NaN where that leaves the image."""
        x, y = self.window.x + round(float(moved[0])), self.window.y + round(float(moved[1]))
        span, size = Span(x, x, y, y), (self.window.height, self.window.width)
        inside = min(x, y) >= self.factor and x + size[1] <= image.shape[1] - self.factor
        if not inside or y + size[0] > image.shape[0] - self.factor:
            return float("nan")
        raw = cut(image, span, size, self.factor, self.offset)
        return (
            float("nan") if raw is None else float(_core.zncc_map(_core.shrink(raw, self.factor), self.pattern).max())
        )


def find_alternatives(
    image: NDArray[np.generic], window: Region, template: Floats32, *, offset: float, least: float
) -> Alternatives:
    """The alternatives of the target in `window` of the reference `image`.

    `template`: the target's pixels (h, w) without their mean; `offset`: subtracted from frames; `least`: correlation
    that an alternative must reach.
    """
    factor = coarse_factor(template)
    rows, columns = image.shape
    whole = Span(0, columns - window.width, 0, rows - window.height)
    span = coarse_span(whole, window.x, window.y, template.size, factor)
    # The decimated positions hold the target's own.
    span = Span(window.x - (window.x - span.x0) // factor * factor, span.x1, span.y0, span.y1)
    span = Span(span.x0, span.x1, window.y - (window.y - span.y0) // factor * factor, span.y1)
    small = _core.shrink(template, factor)
    small = (small - small.mean()).astype(np.float32)
    raw = cut(image, span, template.shape, 0, offset)
    surface = np.zeros((1, 1)) if raw is None else _core.zncc_map(_core.shrink(raw, factor), small)
    corner = np.array([span.x0 - window.x, span.y0 - window.y], dtype=np.float64)
    found = Alternatives(np.zeros((0, 2)), window, small, factor, offset, surface, corner)
    if raw is None:
        return found
    # Between two decimated positions a copy correlates less.
    coarse = np.where(surface > least - MAX_DIFFERENCE, surface, 0.0)
    places = []
    for x, y in peaks(coarse, 2 * MAX_ALTERNATIVES, 2):
        place, likeness = _refined(raw, template, (x * factor, y * factor), factor)
        moved = np.array(place) + corner
        if likeness >= least and _apart(found, moved, least):
            places.append(moved)
    places.sort(key=lambda moved: float(np.hypot(*moved)))
    return replace(found, places=np.array(places[:MAX_ALTERNATIVES]).reshape(-1, 2))


def _refined(raw: Floats32, template: Floats32, at: tuple[int, int], reach: int) -> tuple[tuple[int, int], float]:
    """The whole-pixel place x, y in `raw` next to `at` where the template correlates best, and that correlation."""
    height, width = template.shape
    left, top = max(at[0] - reach, 0), max(at[1] - reach, 0)
    part = np.ascontiguousarray(raw[top : at[1] + reach + height, left : at[0] + reach + width])
    surface = _core.zncc_map(part, template)
    y, x = divmod(int(surface.argmax()), surface.shape[1])
    return (left + x, top + y), float(surface[y, x])


def _apart(reference: Alternatives, moved: Floats, least: float) -> bool:
    """Whether the correlation falls between the target and the place `moved` (2,) px from it.

    Where it does not, the texture has one direction, along which the target is poorly known anyway.
    """
    steps = int(np.ceil(np.hypot(*moved) / reference.factor))
    way = [reference.then(moved * k / steps) for k in range(1, steps)]
    return bool(way) and min(way) < least


def identified(
    known: Alternatives,
    image: NDArray[np.generic],
    found: Floats,
    expected: Prediction | None,
    correlation: Callable[[Floats], float],
) -> Floats | None:
    """`found` (2,) px itself if that is the target, the target's place if it is an alternative; None: not known.

    `expected`: where the target is by its motion or a prediction, None where that says nothing. `correlation`: of the
    target with the frame at the sub-pixel peak next to a place (2,) px, 0 where there is none.
    """
    if not len(known.places):
        return found
    where = [found, *(found - known.places)]
    which = _which(known, image, np.array(where), expected, correlation)
    return None if which is None else where[which]


def _which(
    known: Alternatives,
    image: NDArray[np.generic],
    where: Floats,
    expected: Prediction | None,
    correlation: Callable[[Floats], float],
) -> int | None:
    """The number of the target's place among `where` (n, 2) px, the place that was found and those that it may have
    been taken for; None: not known.
    """
    nearest = None if expected is None else _nearest(where, expected, np.ones(len(where), dtype=np.bool_))
    seen, stands = _standing(known, image, where)
    if np.count_nonzero(stands) == 1:
        only = int(np.argmax(stands))
        # The target may be hidden where it is expected, and an alternative in view: that says nothing of a motion.
        return only if nearest is None or nearest == only or seen[nearest] else None
    among = stands if stands.any() else ~stands
    best = _most_alike(np.array([correlation(place) if a else 0.0 for place, a in zip(where, among, strict=True)]))
    if best is None and expected is not None:
        best = _nearest(where, expected, among)
    return best


def _most_alike(correlation: Floats) -> int | None:
    """The place that the template leaves clearly less of than of all others (n,); None where there is none."""
    rest = 1.0 - np.clip(correlation, 0.0, 1.0) ** 2
    order = np.argsort(rest)
    return int(order[0]) if rest[order[1]] > CLEARLY_LESS * rest[order[0]] else None


def _nearest(where: Floats, expected: Prediction, among: NDArray[np.bool_]) -> int | None:
    """The place of `where` (n, 2) `among` (n,) these that is clearly nearest to the expected one; None: none is."""
    std = np.maximum([expected.std_x_px, expected.std_y_px], 1e-6)
    square = np.sum(((where - np.array([expected.x_px, expected.y_px])) / std) ** 2, axis=1)
    order = np.argsort(np.where(among, square, np.inf))
    first, second = 1.0 + square[order[:2]]
    if np.count_nonzero(among) > 1 and not second > CLEARLY_FARTHER**2 * first:
        return None
    return int(order[0])


def _standing(
    known: Alternatives, image: NDArray[np.generic], where: Floats
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which of the places `where` (n, 2) px show the target or a copy, and at which of them the target would make all
    that is seen around what the first frame shows.
    """
    around = (where[:, None, :] + np.vstack([np.zeros(2), known.places])[None, :, :]).reshape(-1, 2)
    _, first = np.unique(np.round(around / (2.0 * known.factor)), axis=0, return_index=True)
    around = around[np.sort(first)]
    own = max(known.now(image, where[0]), 1e-6)
    now = np.array([known.now(image, place) for place in around]) / own
    stands = np.ones(len(where), dtype=np.bool_)
    for k, place in enumerate(where):
        then = np.array([known.then(other - place) for other in around])
        # What lies outside the image, now or then, contradicts nothing.
        stands[k] = not np.any(np.abs(now - then) > MAX_DIFFERENCE)
    seen = np.array([known.now(image, place) for place in where]) / own > 1.0 - MAX_DIFFERENCE
    return seen, stands
