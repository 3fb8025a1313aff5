"""Numbers of one picture, and of the difference of two registered ones: sharpness, full scale, frozen blocks, noise."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats
from midspan.signals.medians import MEDIAN_DEVIATION
from midspan.vision.spline import Floats32, weights

BLOCK_PX = 8  # px; codecs cut pictures into such blocks, counted from the corner
REACH_PX = 10  # the cardinal spline has fallen below 1e-3 there
_MASK_SQUARE = 36.0  # of the second difference along both axes


@njit(cache=True, fastmath=True)
def detail(pixels: NDArray[np.generic], every: int) -> tuple[float, float, float]:
    """Mean square difference of pixels two apart along x and along y, and the variance; of one in `every` bands.

    A band is eight rows: whole blocks of rows see a pattern of bricks alike wherever it lies between the pixels.
    """
    rows, columns = pixels.shape
    total, square, across, down = 0.0, 0.0, 0.0, 0.0
    level = float(pixels[rows // 2, columns // 2])
    count = 0
    for r in range(1, rows - 1):
        if (r // BLOCK_PX) % every:
            continue
        for c in range(1, columns - 1):
            value = float(pixels[r, c]) - level
            dx = float(pixels[r, c + 1]) - float(pixels[r, c - 1])
            dy = float(pixels[r + 1, c]) - float(pixels[r - 1, c])
            total += value
            square += value * value
            across += dx * dx
            down += dy * dy
        count += columns - 2
    return across / count, down / count, square / count - (total / count) ** 2


@njit(cache=True)
def sharpness(
    pixels: NDArray[np.generic], every: int, other: tuple[float, float, float], noise: float
) -> tuple[float, float]:
    """Detail along x and y of a picture over that of another (see `detail`), both without the variance of their noise
    and by their contrast; NaN where that is not known.
    """
    now = detail(pixels, every)
    light, dark = _without(now[2], noise), _without(other[2], noise)
    x = _over(_without(now[0], 2.0 * noise) * dark, _without(other[0], 2.0 * noise) * light)
    y = _over(_without(now[1], 2.0 * noise) * dark, _without(other[1], 2.0 * noise) * light)
    return x, y


@njit(cache=True)
def _without(value: float, noise: float) -> float:
    """A detail less its noise; at most half is taken off: where nearly all is noise, what is left says nothing."""
    return max(value - noise, 0.5 * value)


@njit(cache=True)
def _over(value: float, other: float) -> float:
    return value / other if other > 0.0 else np.nan


def share_at_ends(pixels: NDArray[np.generic]) -> float:
    """Share of the pixels that light has driven to the end of the scale, or that have none; the larger of the two.

    Full scale need not be known (10 bits in a file of 16): where light is cut off, many pixels share one value. In 8
    bits that is above 235 or below 16, the ends of a video's range.
    """
    if pixels.size == 0 or pixels.dtype.kind == "f":
        return 0.0
    lowest, highest = (16, 235) if pixels.dtype.itemsize == 1 else (np.iinfo(np.int64).max, 0)
    return _at_ends(pixels, lowest, highest) / pixels.size


@njit(cache=True)
def _at_ends(pixels: NDArray[np.generic], lowest: int, highest: int) -> int:
    """How many pixels have the least value, where that is `lowest` or less, or the largest from `highest` on."""
    low = high = pixels[0, 0]
    for r in range(pixels.shape[0]):
        for value in pixels[r]:
            low, high = min(low, value), max(high, value)
    lows, highs = 0, 0
    if low <= lowest or high >= highest:
        for r in range(pixels.shape[0]):
            for value in pixels[r]:
                lows += value == low
                highs += value == high
    return max(lows if low <= lowest else 0, highs if high >= highest else 0)


@njit(cache=True)
def same(one: NDArray[np.generic], other: NDArray[np.generic]) -> bool:
    """Whether two pictures of one size are equal to the last bit; the first pixel that differs ends it."""
    for r in range(one.shape[0]):
        for c in range(one.shape[1]):
            if one[r, c] != other[r, c]:
                return False
    return True


@njit(cache=True)
def stair_share(pixels: NDArray[np.generic], left: int, top: int) -> float:
    """Share of the codec's blocks that are one flat tone with a step to the next one: what is left of a weak texture.

    `left`, `top`: where the first pixel lies in the picture.
    """
    rows, columns = pixels.shape
    blocks, stairs = 0, 0
    for r in range(-top % BLOCK_PX, rows - BLOCK_PX, BLOCK_PX):
        for c in range(-left % BLOCK_PX, columns - BLOCK_PX, BLOCK_PX):
            blocks += 1
            tone = pixels[r, c]
            flat = True
            for k in range(BLOCK_PX * BLOCK_PX):
                if pixels[r + k // BLOCK_PX, c + k % BLOCK_PX] != tone:
                    flat = False
                    break
            stairs += flat and (pixels[r + BLOCK_PX, c] != tone or pixels[r, c + BLOCK_PX] != tone)
    return stairs / max(blocks, 1)


@njit(cache=True)
def blockiness(pixels: NDArray[np.generic], left: int, top: int) -> float:
    """Steps across the edges of a codec's blocks over those across their middles, less 1; about 0 without such blocks.

    `left`, `top`: where the first pixel lies in the picture.
    """
    rows, columns = pixels.shape
    edge, middle = 1e-9, 1e-9
    for r in range(rows - 1):
        for c in range(columns - 1):
            value = float(pixels[r, c])
            across, down = (left + c + 1) % BLOCK_PX, (top + r + 1) % BLOCK_PX
            if across == 0:
                edge += abs(float(pixels[r, c + 1]) - value)
            elif across == BLOCK_PX // 2:
                middle += abs(float(pixels[r, c + 1]) - value)
            if down == 0:
                edge += abs(float(pixels[r + 1, c]) - value)
            elif down == BLOCK_PX // 2:
                middle += abs(float(pixels[r + 1, c]) - value)
    return edge / middle - 1.0


@njit(cache=True)
def frozen_texture(now: NDArray[np.generic], before: NDArray[np.generic], left: int, top: int) -> tuple[float, float]:
    """Square sums of the differences of neighbours: in the blocks whose pixels are all the same as before, and in all
    (0 where there are none of the former).

    `now`, `before` (rows, columns) from the same place, whose first pixel is at `left`, `top` in the picture: blocks
    are counted from the picture's corner. A block without any texture counts for nothing.
    """
    rows, columns = now.shape
    frozen, whole = 0.0, 0.0
    for r in range(-top % BLOCK_PX, rows - BLOCK_PX + 1, BLOCK_PX):
        for c in range(-left % BLOCK_PX, columns - BLOCK_PX + 1, BLOCK_PX):
            same = True
            for k in range(BLOCK_PX * BLOCK_PX):
                if now[r + k // BLOCK_PX, c + k % BLOCK_PX] != before[r + k // BLOCK_PX, c + k % BLOCK_PX]:
                    same = False
                    break
            if same:
                frozen += _texture(now, r, c)
    if frozen > 0.0:
        for r in range(-top % BLOCK_PX, rows - BLOCK_PX + 1, BLOCK_PX):
            for c in range(-left % BLOCK_PX, columns - BLOCK_PX + 1, BLOCK_PX):
                whole += _texture(now, r, c)
    return frozen, whole


@njit(cache=True)
def _texture(pixels: NDArray[np.generic], row: int, column: int) -> float:
    total = 0.0
    for r in range(row, row + BLOCK_PX - 1):
        for c in range(column, column + BLOCK_PX - 1):
            value = float(pixels[r, c])
            dx, dy = float(pixels[r, c + 1]) - value, float(pixels[r + 1, c]) - value
            total += dx * dx + dy * dy
    return total


@dataclass(frozen=True, slots=True)
class Square:
    """A square of a picture about the target: `pixels` (n, n) and where the target lies in it beyond whole pixels.

    shift: (x, y) of -0.5 to 0.5 px.
    """

    pixels: Floats32
    shift: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Difference:
    """Noise of one picture as the difference of two registered ones shows it, in grey levels.

    fine: in the finest detail, where cameras have most of their noise and codecs leave least of it; broad: over all
    detail. Without a codec the two are the same.
    """

    fine: float
    broad: float


@cache
def _response() -> Floats:
    """Coefficients (2 reach + 1,) of the quintic spline through a single pixel of value 1."""
    from scipy.ndimage import spline_filter1d

    impulse = np.zeros(4 * REACH_PX + 1)
    impulse[2 * REACH_PX] = 1.0
    return np.asarray(spline_filter1d(impulse, order=5)[REACH_PX:-REACH_PX], dtype=np.float64)


def cardinal_taps(shift_px: float) -> Floats:
    """Weights (2 reach + 1,) of the pixels around a point at `shift_px` (-1 to 1) for the quintic spline's value."""
    taps = np.convolve(_response(), weights(shift_px, 0)[::-1])[3:-3][::-1]
    return np.asarray(taps / taps.sum(), dtype=np.float64)


def difference(now: Square, then: Square) -> Difference:
    """The noise (grey levels) of `now` against `then`, moved to the same place and brought to the same contrast."""
    across = cardinal_taps(then.shift[0] - now.shift[0])
    down = cardinal_taps(then.shift[1] - now.shift[1])
    broad, fine = _differences(now.pixels, then.pixels, across.astype(np.float32), down.astype(np.float32))
    # White noise of variance 1 in both pictures, as it comes out of the difference and of the mask on it.
    second = np.array([1.0, -2.0, 1.0])
    moved = float(np.sum(across**2) * np.sum(down**2))
    masked = float(np.sum(np.convolve(across, second) ** 2) * np.sum(np.convolve(down, second) ** 2))
    return Difference(
        fine=_spread(fine) / math.sqrt(_MASK_SQUARE + masked),
        broad=_spread(broad[::2]) / math.sqrt(1.0 + moved),
    )


@njit(cache=True)
def _spread(values: Floats32) -> float:
    """Standard deviation of a normal variable whose median distance from 0 is that of `values`."""
    return float(np.median(np.abs(values))) / MEDIAN_DEVIATION


@njit(cache=True, fastmath=True)
def _differences(now: Floats32, then: Floats32, across: Floats32, down: Floats32) -> tuple[Floats32, Floats32]:
    """`now` less `then` filtered with the taps, within REACH_PX of the edges; and its second difference in x and y."""
    n = now.shape[0]
    m = n - 2 * REACH_PX
    level_now, level_then = np.float32(now.mean()), np.float32(then.mean())
    gain = np.float32(np.sqrt((now.var() + 1e-12) / (then.var() + 1e-12)))
    lines = np.zeros((m, n), dtype=np.float32)
    for r in range(m):
        for j in range(2 * REACH_PX + 1):
            w = gain * down[j]
            for c in range(n):
                lines[r, c] += w * (then[r + j, c] - level_then)
    broad = np.empty((m, m), dtype=np.float32)
    for r in range(m):
        for c in range(m):
            broad[r, c] = now[r + REACH_PX, c + REACH_PX] - level_now
        for j in range(2 * REACH_PX + 1):
            w = across[j]
            for c in range(m):
                broad[r, c] -= w * lines[r, c + j]
    fine = np.empty((m - 2, m - 2), dtype=np.float32)
    for r in range(m - 2):
        for c in range(m - 2):
            upper = broad[r, c] - 2 * broad[r, c + 1] + broad[r, c + 2]
            middle = broad[r + 1, c] - 2 * broad[r + 1, c + 1] + broad[r + 1, c + 2]
            lower = broad[r + 2, c] - 2 * broad[r + 2, c + 1] + broad[r + 2, c + 2]
            fine[r, c] = upper - 2 * middle + lower
    return broad, fine
