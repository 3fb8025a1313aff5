"""Pixel sums of a mix of pictures: least squares, what blocks contradict each other by, where the mix holds."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats
from midspan.vision.spline import Floats32, combine, weights

Integers = NDArray[np.int64]

# Poles of the quintic B-spline's inverse filter and its gain (Unser, 1999, doi 10.1109/79.799930).
_ROOT = 4436.25**0.5
_POLES = ((67.5 - _ROOT) ** 0.5 + 26.25**0.5 - 6.5, (67.5 + _ROOT) ** 0.5 - 26.25**0.5 - 6.5)
_BEGINNING = 24  # samples that a recursion begins from: the larger pole to that power is 1e-9
_FLAT = 0.1  # of the mean contrast: what a block without texture may differ by


@njit(cache=True, fastmath=True)
def _filtered_down(image: Floats32) -> None:
    """Inverse filter of the quintic B-spline along the first axis, in place, mirrored at the ends."""
    rows, columns = image.shape
    for pole in _POLES:
        z = np.float32(pole)
        gain = np.float32((1.0 - pole) * (1.0 - 1.0 / pole))
        for r in range(rows):
            for c in range(columns):
                image[r, c] *= gain
        power = z
        for r in range(1, min(rows, _BEGINNING)):
            for c in range(columns):
                image[0, c] += power * image[r, c]
            power *= z
        for r in range(1, rows):
            for c in range(columns):
                image[r, c] += z * image[r - 1, c]
        end = np.float32(pole / (pole * pole - 1.0))
        for c in range(columns):
            image[rows - 1, c] = end * (image[rows - 1, c] + z * image[rows - 2, c])
        for r in range(rows - 2, -1, -1):
            for c in range(columns):
                image[r, c] = z * (image[r + 1, c] - image[r, c])


@njit(cache=True)
def spline_grid(image: Floats32) -> Floats32:
    """Coefficients (rows, columns) of the quintic spline through `image` (rows, columns), mirrored at its edges."""
    turned = image.T.copy()
    _filtered_down(turned)
    grid = turned.T.copy()
    _filtered_down(grid)
    return grid


@njit(cache=True, fastmath=True)
def _dot(a: Floats32, b: Floats32) -> float:
    total = np.float32(0.0)
    for p in range(a.shape[0]):
        total += a[p] * b[p]
    return float(total)


@njit(cache=True, fastmath=True)
def explained(
    columns: Floats32, slopes: Floats32, weight: Floats32, seen: Floats32, ridge: Floats
) -> tuple[Floats32, Floats32, Floats32, Floats, Floats]:
    """Weighted least squares of what is `seen` (pixels,) by `columns` (n, pixels), whose slopes are (2, n - 1, pixels).

    Returns the amount (n,) of each, what they leave (pixels,), the mix's slopes with weights and without what another
    mix would explain (2, pixels), and their products with the slopes (2, 2) and with what is left (2,).
    """
    count, pixels = columns.shape
    weighted = np.empty((count, pixels), dtype=np.float32)
    for i in range(count):
        for p in range(pixels):
            weighted[i, p] = weight[p] * columns[i, p]
    normal = np.zeros((count, count))
    right = np.zeros(count)
    for i in range(count):
        right[i] = _dot(weighted[i], seen)
        for j in range(i + 1):
            normal[i, j] = normal[j, i] = _dot(weighted[i], columns[j])
        normal[i, i] += ridge[i]
    inverse = np.linalg.inv(normal)
    amount = (inverse @ right).astype(np.float32)
    left = seen.copy()
    for i in range(count):
        for p in range(pixels):
            left[p] -= amount[i] * columns[i, p]
    own = np.empty((2, pixels), dtype=np.float32)
    information, force = np.zeros((2, 2)), np.zeros(2)
    slope = np.zeros((2, pixels), dtype=np.float32)
    for axis in range(2):
        for i in range(count - 1):
            for p in range(pixels):
                slope[axis, p] += amount[i] * slopes[axis, i, p]
        for i in range(count):
            right[i] = _dot(weighted[i], slope[axis])
        other = (inverse @ right).astype(np.float32)
        for p in range(pixels):
            own[axis, p] = weight[p] * slope[axis, p]
        for i in range(count):
            for p in range(pixels):
                own[axis, p] -= other[i] * weighted[i, p]
        force[axis] = _dot(own[axis], left)
    for a in range(2):
        for b in range(2):
            information[a, b] = _dot(own[a], slope[b])
    return amount, left, own, information, force


@njit(cache=True)
def settled(
    grid: Floats32,
    start: tuple[Floats, Floats],
    mix: tuple[Floats32, Floats32, Floats],
    base: Floats32,
    limits: tuple[int, int, float, float],
) -> tuple[int, Floats, Floats32, tuple[Floats32, Floats32, Floats32, Floats, Floats]]:
    """Place (2,) px at which a mix of pictures is most like a frame, with what is seen there (pixels,) and what
    `explained` says of it; first the number of rounds, 0 where the search does not come to rest.

    `grid`: the frame's spline coefficients about `start`: (the whole px that it is cut at, the place to begin from);
    `mix`: columns, slopes and ridge as for `explained`; `base`: weights (pixels,) that residuals lower further;
    `limits`: px of the grid around the target, most rounds, step in px that is rest, standard deviations of residuals
    that count half.
    """
    whole, place = start[0], start[1].copy()
    edge, rounds, rest, robust = limits
    columns, slopes, ridge = mix
    weight = base
    for turn in range(rounds):
        x, y = whole[0] - place[0], whole[1] - place[1]
        if max(abs(x), abs(y)) > 1.0:
            break
        near = grid[edge : grid.shape[0] - edge, edge : grid.shape[1] - edge]
        seen = combine(near, weights(-y, 0), weights(-x, 0)).ravel()
        seen -= seen.mean()
        told = explained(columns, slopes, weight, seen, ridge)
        left, information, force = told[1], told[3], told[4]
        squares = information[0, 0] * information[1, 1]
        spread = squares - information[0, 1] * information[1, 0]
        if not (squares > 0.0 and spread > 1e-6 * squares):
            break
        place[0] -= (information[1, 1] * force[0] - information[0, 1] * force[1]) / spread
        place[1] -= (information[0, 0] * force[1] - information[1, 0] * force[0]) / spread
        step = max(abs(x - whole[0] + place[0]), abs(y - whole[1] + place[1]))
        if step < rest:
            return turn + 1, place, seen, told
        limit = np.float32(max(robust * 1.4826 * np.median(np.abs(left[base > 0.0])), 1e-12))
        weight = base / (np.float32(1.0) + (left / limit) ** 2)
    none = np.empty(0, dtype=np.float32)
    empty = np.empty((0, 0), dtype=np.float32)
    return 0, place, none, (none, none, empty, np.empty((0, 0)), np.empty(0))


@njit(cache=True, fastmath=True)
def block_scores(own: Floats32, left: Floats32, block: Integers, blocks: int) -> Floats:
    """Products of the slopes (2, pixels) with what is left (pixels,), summed by block: (2, blocks)."""
    out = np.zeros((2, blocks))
    for p in range(left.shape[0]):
        out[0, block[p]] += own[0, p] * left[p]
        out[1, block[p]] += own[1, p] * left[p]
    return out


@njit(cache=True, fastmath=True)
def picture_shares(inverse: Floats, own: Floats32, slopes: Floats32, amount: Floats32) -> Floats:
    """How much the place of each picture counts (2, n) for the target's place along x and y."""
    out = np.zeros((2, slopes.shape[1]))
    pull = np.empty(own.shape[1], dtype=np.float32)
    for axis in range(2):
        first, second = np.float32(inverse[axis, 0]), np.float32(inverse[axis, 1])
        for p in range(own.shape[1]):
            pull[p] = first * own[0, p] + second * own[1, p]
        for i in range(slopes.shape[1]):
            out[axis, i] = _dot(pull, slopes[axis, i]) * amount[i]
    return out


@njit(cache=True)
def agreement(seen: Floats32, left: Floats32, cell: Integers, cells: int) -> Floats:
    """How well what is expected is `seen` (both `pixels`,; `left`: the difference), in each of so many cells: 1 alike,
    0 unrelated or one of them without contrast, which is what a thing in front leaves; the level is free.

    For cells of equal contrast this is their correlation. Cells without texture agree while nothing is seen in them.
    """
    sums = np.zeros((cells, 7))
    for p in range(seen.shape[0]):
        s, d = float(seen[p]), float(left[p])
        e = s - d
        line = sums[cell[p]]
        line[0] += 1.0
        line[1] += s
        line[2] += s * s
        line[3] += e
        line[4] += e * e
        line[5] += d
        line[6] += d * d
    energy = np.zeros((3, cells))
    for b in range(cells):
        n = max(sums[b, 0], 1.0)
        for k in range(3):
            energy[k, b] = (sums[b, 2 + 2 * k] - sums[b, 1 + 2 * k] ** 2 / n) / n
    # What even the better cells are off by is noise.
    floor = 2.0 * (_FLAT * energy[1].mean() + 2.0 * np.sort(energy[2])[cells // 8]) + 1e-12
    agreed: Floats = 1.0 - energy[2] / (energy[0] + energy[1] + floor)
    return agreed
