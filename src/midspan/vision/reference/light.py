"""What another light makes of a target: nearly a mix of the pictures that earlier lights made of it.

Pictures of a rough surface under all lights lie near a space of few dimensions (R. Basri, D. Jacobs, "Lambertian
reflectance and linear subspaces", 2003, doi 10.1109/TPAMI.2003.1177153). Shading that moves over a bump is a motion to
one reference frame, but not to a mix of several; translation and mix are estimated together (G. Hager, P. Belhumeur,
"Efficient region tracking with parametric models of geometry and illumination", 1998, doi 10.1109/34.722606).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats, Floats32, Region
from midspan.signals.medians import SIGMA_OF_MEDIAN
from midspan.vision.texture import REACH, lowpass_taps, values

SMOOTHING_PX = 0.7
TAPS = lowpass_taps(SMOOTHING_PX).astype(np.float32)
EDGE_PX = 2 * REACH  # of picture around the window: the spline's reach, and what its mirror at the border spoils
CONTEXT_PX = 2  # of frame beyond that, for the same reason
CELLS = 6  # a side: where something stands in front is shown by smaller blocks
BLOCKS = 4  # a side: light and relief differ from block to block, and so do their errors
TRUST = 0.05  # standard deviation of a mix that pictures leave open, as a share of their contrast
ROUNDS = 6
ENOUGH_PX = 0.01  # a search that steps less has come to rest: what is left is a tenth of the step
ROBUST = 5.0  # residuals of more standard deviations than this count half or less: shadows' edges, things in front
SINGULAR = 1e-6  # determinant of the information over its diagonal below which a texture has one direction
MAX_OFFSET_PX = 1.0  # from where a search begins, and of a picture from where its frames were found


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """What a mix says of what is seen: the `amount` (n,) of each column, what they leave (`left`, pixels,), the mix's
    slopes with weights and without what another mix would explain (`own`, 2, pixels), and their products with the
    slopes (`information`, 2, 2) and with what is left (`force`, 2,).
    """

    amount: Floats32
    left: Floats32
    own: Floats32
    information: Floats
    force: Floats


def explained(columns: Floats32, slopes: Floats32, weight: Floats32, seen: Floats32, ridge: Floats) -> Explained:
    """Weighted least squares of what is `seen` (pixels,) by `columns` (n, pixels), whose slopes are (2, n - 1, pixels).

    ridge (n,): what is added to the squares of the columns.
    """
    weighted = weight * columns
    inverse = np.linalg.inv((weighted @ columns.T).astype(np.float64) + np.diag(ridge))
    amount = (inverse @ (weighted @ seen)).astype(np.float32)
    left = seen - amount @ columns
    slope = amount[:-1] @ slopes
    other = (slope @ weighted.T @ inverse).astype(np.float32)
    own = weight * slope - other @ weighted
    return Explained(amount, left, own, (own @ slope.T).astype(np.float64), (own @ left).astype(np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A frame around the target: spline coefficients about the place `whole` (2,; x, y in whole px)."""

    grid: Floats32
    whole: Floats

    def window(self, place: Floats) -> Floats32 | None:
        """The target as it would look at rest, if it lies at `place` (2,) px, with EDGE_PX around it; None if far."""
        x, y = (float(v) for v in self.whole - place)
        return None if max(abs(x), abs(y)) > MAX_OFFSET_PX else _core.translated(self.grid, x, y)


def sight(pixels: NDArray[np.generic], region: Region, place: Floats) -> Sight | None:
    """The frame around the target of `region`, which lies near `place` (2,) px; None without values.

    What lies beyond the image continues its border.
    """
    whole = np.rint(place)
    margin = EDGE_PX + REACH + CONTEXT_PX + len(TAPS) // 2
    lines = []
    for first, size, moved, limit in (
        (region.y, region.height, whole[1], pixels.shape[0]),
        (region.x, region.width, whole[0], pixels.shape[1]),
    ):
        lines.append(np.clip(np.arange(first - margin, first + size + margin) + int(moved), 0, limit - 1))
    (top, bottom), (left, right) = ((int(line[0]), int(line[-1]) + 1) for line in lines)
    inner = bottom - top == len(lines[0]) and right - left == len(lines[1])
    cut = pixels[top:bottom, left:right] if inner else pixels[np.ix_(*lines)]
    finite = cut if cut.dtype.kind in "iub" else cut[np.isfinite(cut)]
    raw = values(cut, float(finite.mean())) if finite.size else None
    if raw is None:
        return None
    grid = _core.spline_coefficients(_core.smooth(raw, TAPS).astype(np.float64))[
        CONTEXT_PX:-CONTEXT_PX, CONTEXT_PX:-CONTEXT_PX
    ]
    return Sight(grid.astype(np.float32), whole)


@dataclass(frozen=True, slots=True, eq=False)
class Mix:
    """Pictures (n, pixels) of mean 0 and length 1 and a level; their slopes (2, n, pixels) along x and y per px of the
    picture moved, the number of the block that each pixel lies in (pixels,), and of the smaller cell, and how far each
    pixel keeps to the mix, 0 where one of the pictures does not show the target.
    """

    columns: Floats32
    slopes: Floats32
    block: NDArray[np.int64]
    cell: NDArray[np.int64]
    weight: Floats32

    @property
    def pictures(self) -> Floats32:
        """The pictures (n, pixels) without the level."""
        return self.columns[:-1]

    @property
    def ridge(self) -> Floats:
        """What keeps the mix from being a difference of nearly equal pictures; the level is free."""
        return np.append(np.full(len(self.columns) - 1, TRUST**2), 0.0)


def mixed(pictures: Sequence[Floats32], offsets: Sequence[Floats], shown: NDArray[np.bool_] | None = None) -> Mix:
    """Pictures of one target (each with EDGE_PX around it), each read `offsets` (2,; -1 to 1 px) farther on.

    shown (cells,): where all of them show the target; left out: everywhere.
    """
    planes = np.stack([_planes(*pair) for pair in zip(pictures, offsets, strict=True)], axis=1)
    rows, columns = (size - 2 * EDGE_PX for size in pictures[0].shape)
    cell = squares(rows, columns, CELLS)
    clear = np.ones(rows * columns) if shown is None else shown[cell].astype(np.float64)
    planes = planes - (planes @ clear / clear.sum())[:, :, None]
    planes /= np.maximum(np.sqrt(planes[0] ** 2 @ clear), 1e-12)[:, None]
    weight = clear
    for _ in range(2):
        weight = steadiness(planes[0].T, weight)[0]
    level = np.full((1, rows * columns), (rows * columns) ** -0.5)
    return Mix(
        np.concatenate([planes[0], level]).astype(np.float32),
        np.ascontiguousarray(planes[1:], dtype=np.float32),
        squares(rows, columns, BLOCKS),
        cell,
        weight.astype(np.float32),
    )


def squares(rows: int, columns: int, side: int) -> NDArray[np.int64]:
    """Number (rows · columns,) of the block that each pixel lies in, `side` blocks a side."""
    down, across = np.arange(rows) * side // rows, np.arange(columns) * side // columns
    return (down[:, None] * side + across).ravel()


def steadiness(pictures: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Weight (pixels,) of mean 1 by how well each pixel of each picture (pixels, n) is a mix of the others, 0 where it
    was 0, and the share (n,) of each picture's contrast, squared, that is not.

    The edge of a shadow that moves is no mix; that is where it counts.
    """
    shared = pictures.T @ (weight[:, None] * pictures) + TRUST**2 * np.eye(pictures.shape[1])
    inverse = np.linalg.inv(shared)
    alone = np.diag(inverse)
    left = (((pictures @ inverse) ** 2) / alone).sum(axis=1)
    shown = weight > 0.0
    fresh = shown / (1.0 + left / max(float(np.median(left[shown])), 1e-300))
    return fresh / fresh[shown].mean(), np.maximum(1.0 / alone - TRUST**2, 0.0)


def _planes(picture: Floats32, offset: Floats) -> Floats:
    """Values and slopes along x and y (3, rows · columns) of a picture inside its edge, read `offset` farther on."""
    grid = _core.spline_coefficients(picture.astype(np.float64)).astype(np.float32)[REACH:-REACH, REACH:-REACH]
    x, y = (float(v) for v in offset)
    orders = ((0, 0), (0, 1), (1, 0))
    return np.stack(
        [
            _core.combine(grid, _core.spline_weights(y, down), _core.spline_weights(x, across)).ravel()
            for down, across in orders
        ]
    ).astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Translation (2,) px and its variance (2,) px² from what blocks contradict each other; `shares` (2, n): how much
    the place of each picture counts for x and for y; `expected` (pixels,): the mix; `agreement` (cells,): how well it
    is seen.
    """

    place: Floats
    variance: Floats
    shares: Floats
    expected: Floats32
    agreement: Floats


def inside(window: Floats32) -> Floats32:
    """The target (pixels,) of a window, without what is around it and without its mean."""
    seen = window[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX].ravel()
    free: Floats32 = seen - seen.mean()
    return free


def placed(mix: Mix, frame: Sight, start: Floats, shown: Floats32 | None = None) -> Placed | None:
    """Where the target lies in a frame, as a mix of pictures; None where that does not come to rest near `start`.

    shown (pixels,): 0 where something stands in front.
    """
    base = mix.weight if shown is None else mix.weight * shown
    weight, place = base, start
    for _ in range(ROUNDS):
        window = frame.window(place)
        if window is None:
            return None
        seen = inside(window)
        reported = explained(mix.columns, mix.slopes, weight, seen, mix.ridge)
        squares, spread = np.prod(np.diag(reported.information)), np.linalg.det(reported.information)
        if not (squares > 0.0 and spread > SINGULAR * squares):
            return None
        step = np.linalg.solve(reported.information, reported.force)
        place = place - step
        if np.abs(step).max() < ENOUGH_PX:
            return _judged(mix, place, seen, reported)
        limit = np.float32(max(ROBUST * SIGMA_OF_MEDIAN * float(np.median(np.abs(reported.left[base > 0.0]))), 1e-12))
        weight = base / (np.float32(1.0) + (reported.left / limit) ** 2)
    return None


def _judged(mix: Mix, place: Floats, seen: Floats32, reported: Explained) -> Placed:
    """The place (2,) px with its variance from what blocks contradict each other by."""
    inverse = np.linalg.inv(reported.information)
    scores: Floats = np.array(
        [np.bincount(mix.block, own * reported.left, BLOCKS**2) for own in reported.own], dtype=np.float64
    )
    # Two numbers for the place and one for the level are taken from the blocks.
    spread = inverse @ (scores @ scores.T) @ inverse.T * _few(scores)
    pull = (inverse @ reported.own).astype(np.float32)
    shares = np.einsum("ap,aip->ai", pull, mix.slopes) * reported.amount[:-1]
    agreed = _core.cell_agreement(seen, reported.left, mix.cell, CELLS**2)
    return Placed(place, np.diag(spread).copy(), shares.astype(np.float64), seen - reported.left, agreed)


def _few(scores: Floats) -> float:
    """What a variance from so few blocks is to be multiplied by; blocks that nothing is seen of do not count."""
    count = float(np.count_nonzero(scores[0]))
    return count / max(count - 3.0, 0.5)
