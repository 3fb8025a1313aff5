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

from midspan.records import Floats, Region
from midspan.vision.spline import REACH, Floats32, coefficients, combine, translated, weights
from midspan.vision.texture import lowpass_taps, values
from midspan.vision.zncc import smooth

SMOOTHING_PX = 0.7
TAPS = lowpass_taps(SMOOTHING_PX).astype(np.float32)
EDGE_PX = 2 * REACH  # of picture around the window: the spline's reach, and what its mirror at the border spoils
CONTEXT_PX = 2  # of frame beyond that, for the same reason
BLOCKS = 4  # a side: light and relief differ from block to block, and so do their errors
TRUST = 0.05  # standard deviation of a mix that pictures leave open, as a share of their contrast
ROUNDS = 6
ENOUGH_PX = 0.01  # a search that steps less has come to rest: what is left is a tenth of the step
ROBUST = 5.0  # residuals of more standard deviations than this count half or less: shadows' edges, things in front
FARTHEST_PX = 1.0  # from where a search begins


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A frame around the target: spline coefficients about the place `whole` (2,; x, y in whole px)."""

    grid: Floats32
    whole: Floats

    def window(self, place: Floats) -> Floats32 | None:
        """The target as it would look at rest, if it lies at `place` (2,) px, with EDGE_PX around it; None if far."""
        x, y = (float(v) for v in self.whole - place)
        return None if max(abs(x), abs(y)) > FARTHEST_PX else translated(self.grid, x, y)


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
    cut = pixels[np.ix_(*lines)]
    finite = cut[np.isfinite(cut)]
    raw = values(cut, float(finite.mean())) if finite.size else None
    if raw is None:
        return None
    grid = coefficients(smooth(raw, TAPS).astype(np.float64))[CONTEXT_PX:-CONTEXT_PX, CONTEXT_PX:-CONTEXT_PX]
    return Sight(np.ascontiguousarray(grid, dtype=np.float32), whole)


@dataclass(frozen=True, slots=True, eq=False)
class Mix:
    """Pictures (pixels, n) of mean 0 and length 1 and a level; their slopes (2, pixels, n) along x and y per px of the
    picture moved, the number of the block that each pixel lies in (pixels,), and how far each pixel keeps to the mix.
    """

    columns: Floats32
    slopes: Floats32
    block: NDArray[np.int64]
    weight: Floats32

    @property
    def pictures(self) -> Floats32:
        """The pictures (pixels, n) without the level."""
        return self.columns[:, :-1]


def mixed(pictures: Sequence[Floats32], offsets: Sequence[Floats]) -> Mix:
    """Pictures of one target (each with EDGE_PX around it), each read `offsets` (2,; -1 to 1 px) farther on."""
    planes = np.stack([_planes(*pair) for pair in zip(pictures, offsets, strict=True)], axis=2)
    rows, columns = (size - 2 * EDGE_PX for size in pictures[0].shape)
    flat = planes.reshape(3, rows * columns, -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    flat /= np.maximum(np.linalg.norm(flat[0], axis=0), 1e-12)
    down, across = np.arange(rows) * BLOCKS // rows, np.arange(columns) * BLOCKS // columns
    weight = np.ones(rows * columns)
    for _ in range(2):
        weight = steadiness(flat[0], weight)[0]
    block = (down[:, None] * BLOCKS + across).ravel()
    columns = np.column_stack([flat[0], np.full(len(block), len(block) ** -0.5)])
    return Mix(columns.astype(np.float32), flat[1:].astype(np.float32), block, weight.astype(np.float32))


def steadiness(pictures: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Weight (pixels,) of mean 1 by how well each pixel of each picture is a mix of the others, and the share (n,) of
    each picture's contrast, squared, that is not. The edge of a shadow that moves is no mix; that is where it counts.
    """
    shared = pictures.T @ (weight[:, None] * pictures) + TRUST**2 * np.eye(pictures.shape[1])
    inverse = np.linalg.inv(shared)
    alone = np.diag(inverse)
    left = (((pictures @ inverse) ** 2) / alone).sum(axis=1)
    fresh = 1.0 / (1.0 + left / max(float(np.median(left)), 1e-300))
    return fresh / fresh.mean(), np.maximum(1.0 / alone - TRUST**2, 0.0)


def _planes(picture: Floats32, offset: Floats) -> Floats:
    """Values and slopes along x and y (3, rows · columns) of a picture inside its edge, read `offset` farther on."""
    grid = coefficients(picture.astype(np.float64)).astype(np.float32)[REACH:-REACH, REACH:-REACH]
    x, y = (float(v) for v in offset)
    orders = ((0, 0), (0, 1), (1, 0))
    return np.stack([combine(grid, weights(y, down), weights(x, across)).ravel() for down, across in orders]).astype(
        np.float64
    )


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Translation (2,) px and its variance (2,) px² from what blocks contradict each other; `shares` (2, n): how much
    the place of each picture counts for x and for y.
    """

    place: Floats
    variance: Floats
    shares: Floats


def placed(mix: Mix, frame: Sight, start: Floats) -> Placed | None:
    """Where the target lies in a frame, as a mix of pictures; None where that does not come to rest near `start`."""
    place, weight = start, mix.weight
    for _ in range(ROUNDS):
        window = frame.window(place)
        if window is None:
            return None
        seen = window[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX].ravel()
        seen = seen - seen.mean()
        seen /= np.float32(max(float(np.linalg.norm(seen)), 1e-12))
        amount, left, own, slope = _explained(mix, seen, weight)
        information: Floats = (own.T @ slope).astype(np.float64)
        if not np.linalg.det(information) > 1e-12:
            return None
        step = -np.linalg.solve(information, (own.T @ left).astype(np.float64))
        place = place + step
        if np.abs(step).max() < ENOUGH_PX:
            return _described(mix, place, amount, (left, own, information))
        limit = np.float32(max(ROBUST * 1.4826 * float(np.median(np.abs(left))), 1e-12))
        weight = mix.weight / (np.float32(1.0) + (left / limit) ** 2)
    return None


def _explained(mix: Mix, seen: Floats32, weight: Floats32) -> tuple[Floats32, Floats32, Floats32, Floats32]:
    """Amount (n,) of each picture in what is seen, what the mix leaves (pixels,), the mix's slopes (pixels, 2) with
    weights and without what another mix would explain, and as they are.
    """
    weighted = weight[:, None] * mix.columns
    # A small ridge keeps the mix from being a difference of nearly equal pictures; the level is free.
    ridge = np.full(mix.columns.shape[1], TRUST**2)
    ridge[-1] = 0.0
    normal = (weighted.T @ mix.columns).astype(np.float64) + np.diag(ridge)
    inverse = np.asarray(np.linalg.inv(normal), dtype=np.float32)
    amount = np.asarray(inverse @ (weighted.T @ seen), dtype=np.float32)
    slope: Floats32 = (mix.slopes @ amount[:-1]).T
    own = np.asarray(weight[:, None] * slope - weighted @ (inverse @ (weighted.T @ slope)), dtype=np.float32)
    return amount[:-1], seen - mix.columns @ amount, own, slope


def _described(mix: Mix, place: Floats, amount: Floats32, solved: tuple[Floats32, Floats32, Floats]) -> Placed | None:
    """The place with its variance by blocks and its shares, from what `_explained` says of it."""
    left, own, information = solved
    inverse = np.linalg.inv(information)
    scores = np.stack([np.bincount(mix.block, axis * left, BLOCKS**2) for axis in own.T])
    # Two numbers for the place and one for the level are taken from the blocks.
    spread = inverse @ (scores @ scores.T) @ inverse.T * (BLOCKS**2 / (BLOCKS**2 - 3.0))
    shares = np.stack([(inverse[k] @ own.T @ mix.slopes[k]) * amount for k in range(2)])
    return Placed(place, np.diag(spread).copy(), shares)
