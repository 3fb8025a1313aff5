"""A better template than one frame: two samples a pixel, fitted to frames whose sub-pixel places differ.

One frame holds what lies above half a cycle a pixel folded onto lower frequencies; frames at different places fold it
differently, so that together they tell it apart. The spline coefficients minimise the squared differences from all
frames, each at its place, plus a penalty on the fourth power of the Laplacian that stands for how the spectrum of
pictures through a lens falls; conjugate gradients, with the places renewed in between (after Elad and Feuer, 1997,
doi 10.1109/83.650118). Frames at one place only give their average, interpolated smoothly.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats, Region
from midspan.vision.bank import Plane
from midspan.vision.fine_spline import PER_PX, fine_weights, planes, read, refined, spread
from midspan.vision.spline import Floats32
from midspan.vision.texture import values

PAD_PX = 8  # around the window: what low-pass and spline reach for
SAME_PLACE_PX = 0.03  # frames nearer than this are one sample: the blur of it is 1e-4 of any frequency's amplitude
MOST_SAMPLES = 48
FIRST_LOOK = 8  # samples that show how large the noise is
ROUNDS, ITERATIONS = 3, 6  # six preconditioned steps come nearer than twelve plain ones
# Steps that lower the sum of squared differences by less than this share of a frame's noise variance a pixel change the
# template by less than a seventh (the root) of its own noise: no more of them are made.
MIN_STEP_SHARE = 0.02
FIRST_PENALTY, PENALTY_SHARE = 0.01, 0.1
_SMOOTHED_PX = 5
_INNER = np.s_[PAD_PX:-PAD_PX, PAD_PX:-PAD_PX]
_INNER_FINE = np.s_[PER_PX * PAD_PX : -PER_PX * PAD_PX, PER_PX * PAD_PX : -PER_PX * PAD_PX]


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Frames that lie at one place: their mean on the template's pixels (h + 16, w + 16), its level and contrast made
    those of the first; translation (2,) x, y in px less whole pixels; how many frames.
    """

    pixels: Floats32
    shift: Floats
    count: int = 1

    def plus(self, other: "Sample") -> "Sample":
        """Both as one."""
        a, b = self.count, other.count
        mean = (a * self.pixels + np.float32(b) * other.pixels) / np.float32(a + b)
        return Sample(mean.astype(np.float32), (a * self.shift + b * other.shift) / (a + b), a + b)


@dataclass(frozen=True, slots=True, eq=False)
class KeptSamples:
    """What has been kept to learn from: samples at different places, and the frames they are made of."""

    items: tuple[Sample, ...] = ()
    frames: int = 0

    def plus(self, new: Sample) -> "KeptSamples":
        """With one more; frames at the place of another are averaged with it."""
        items = list(self.items)
        apart = np.abs(np.array([item.shift for item in items]).reshape(-1, 2) - new.shift).max(axis=1)
        nearest = int(np.argmin(apart)) if items else -1
        if items and (apart[nearest] < SAME_PLACE_PX or len(items) >= MOST_SAMPLES):
            if apart[nearest] < SAME_PLACE_PX:
                items[nearest] = items[nearest].plus(new)
        else:
            items.append(new)
        return KeptSamples(tuple(items), self.frames + 1)


def sample(
    pixels: NDArray[np.generic], window: Region, translation: Floats, offset: float, like: Floats32 | None
) -> Sample | None:
    """The frame `pixels` less `offset` about the window moved by `translation` (x, y px), level and contrast as `like`.

    None where that leaves the image.
    """
    x, y = (round(float(v)) for v in translation[:2])
    top, left = window.y + y - PAD_PX, window.x + x - PAD_PX
    bottom, right = top + window.height + 2 * PAD_PX, left + window.width + 2 * PAD_PX
    if top < 0 or left < 0 or bottom > pixels.shape[0] or right > pixels.shape[1]:
        return None
    cut = values(pixels[top:bottom, left:right], offset)
    if cut is None:
        return None
    if like is not None:
        cut = cut - cut.mean()
        gain = math.sqrt(_square(like - like.mean()) / max(_square(cut), 1e-60))
        cut *= np.float32(gain)
        cut += like.mean()
    return Sample(cut, np.array([translation[0] - x, translation[1] - y]))


def _square(pixels: Floats32) -> float:
    """Sum of the squares of pixels (rows, columns)."""
    return float(np.vdot(pixels, pixels))


def learn_plane(samples: KeptSamples) -> Plane:
    """The template that the samples show together, with the weight of each pixel of the window."""
    items = list(samples.items)
    grid = refined(items[0].pixels.astype(np.float64))
    penalty, least = FIRST_PENALTY, 0.0
    for turn in range(ROUNDS):
        grid, steps = fit(items, grid, penalty, least)
        items = [_placed(item, grid) for item in items]
        if turn == 0:
            noise = _noise_variance(_residual_square(items[:FIRST_LOOK], grid))
            penalty = PENALTY_SHARE * noise / max(_roughness(grid), 1e-30)
            least = MIN_STEP_SHARE * noise * items[0].pixels.size
        elif steps < ITERATIONS:
            break
    square = _residual_square(items, grid)
    noise_std = math.sqrt(_noise_variance(square) / samples.frames)
    return Plane(grid, (PAD_PX, PAD_PX), _weight(square[_INNER]), noise_std)


def fit(items: list[Sample], start: Floats32, penalty: float, least: float = 0.0) -> tuple[Floats32, int]:
    """Fine coefficients (2 h + 7, 2 w + 7) that fit the samples, by conjugate gradients from `start`; how many steps.

    They are preconditioned by what samples at many places make of each frequency: the steps are then few.
    `penalty`: variance of a frame's noise over that of the coefficients' squared Laplacian. `least`: a step that lowers
    the sum of squared differences by less is the last.
    """
    down = np.array([fine_weights(-float(item.shift[1]), 0) for item in items])
    across = np.array([fine_weights(-float(item.shift[0]), 0) for item in items])
    count = np.array([float(item.count) for item in items])

    def normal(grid: Floats32) -> Floats32:
        out: Floats32 = _through(grid, down, across, count)
        out += np.float32(penalty) * _fourth(grid)
        return out

    rest, likely = _spread_all(items, down, across, start.shape), _gain(start.shape, (down, across, count), penalty)
    grid = start.copy()
    rest -= normal(grid)
    direction = _divided(rest, likely)
    square, steps = float(np.vdot(rest, direction)), 0
    while steps < ITERATIONS:
        steps += 1
        through = normal(direction)
        step = square / max(float(np.vdot(direction, through)), 1e-300)
        grid += np.float32(step) * direction
        if step * square < least or steps == ITERATIONS:
            break
        rest -= np.float32(step) * through
        towards = _divided(rest, likely)
        before, square = square, float(np.vdot(rest, towards))
        direction *= np.float32(square / max(before, 1e-300))
        direction += towards
    return grid, steps


def _spread_all(items: list[Sample], down: Floats, across: Floats, shape: tuple[int, ...]) -> Floats32:
    """What all samples give to coefficients of this `shape`."""
    out = np.zeros(shape, dtype=np.float32)
    for item, wy, wx in zip(items, down, across, strict=True):
        spread(item.pixels, item.count * wy, wx, out)
    return out


def _gain(shape: tuple[int, ...], weights: tuple[Floats, Floats, Floats], penalty: float) -> Floats32:
    """What samples at many places and the penalty make of each frequency of coefficients (rows, columns).

    `weights` of the samples down and across (n, 9), and their numbers of frames (n,). The places part a frequency from
    those that single frames fold onto it.
    """
    from scipy.fft import next_fast_len

    down, across, count = weights
    rows, columns = (next_fast_len(size, real=True) for size in shape)
    y = count @ np.abs(np.fft.fft(down, rows)) ** 2 / (PER_PX * count.sum())
    x = count @ np.abs(np.fft.rfft(across, columns)) ** 2 / PER_PX
    fy, fx = np.fft.fftfreq(rows), np.fft.rfftfreq(columns)
    laplacian = np.add.outer(2.0 * np.cos(2.0 * np.pi * fy) - 4.0, 2.0 * np.cos(2.0 * np.pi * fx)).astype(np.float32)
    square = laplacian * laplacian
    return np.asarray(np.outer(y, x) + penalty * square * square, dtype=np.float32)


def _divided(grid: Floats32, gain: Floats32) -> Floats32:
    """Coefficients (rows, columns) with each frequency over its `gain`, without what goes beyond the edges."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    size = [next_fast_len(n, real=True) for n in grid.shape]
    spectrum = rfft2(grid, s=size)
    spectrum /= gain
    return np.ascontiguousarray(irfft2(spectrum, s=size)[: grid.shape[0], : grid.shape[1]], dtype=np.float32)


@njit(cache=True)
def _through(grid: Floats32, down: Floats, across: Floats, count: Floats) -> Floats32:
    """What all samples, of these weights (n, 9) and numbers of frames (n,), make of coefficients: each read, and spread
    again.
    """
    out = np.zeros_like(grid)
    for k in range(len(count)):
        spread(read(grid, count[k] * down[k], across[k]), down[k], across[k], out)
    return out


@njit(cache=True)
def _laplacian(grid: Floats, out: Floats) -> None:
    """Fill `out` with the sum of the four neighbours less four times the value; beyond the edge the value itself."""
    rows, last = grid.shape[0], grid.shape[1] - 1
    for r in range(rows):
        own, up, down, into = grid[r], grid[max(r - 1, 0)], grid[min(r + 1, rows - 1)], out[r]
        # The two edges apart: the rest then runs without a question, several values at once.
        for c in (0, last):
            into[c] = up[c] + down[c] + own[max(c - 1, 0)] + own[min(c + 1, last)] - 4.0 * own[c]
        before, middle, after = own[: last - 1], own[1:last], own[2:]
        up, down, into = up[1:last], down[1:last], into[1:last]
        for c in range(last - 1):
            into[c] = up[c] + down[c] + before[c] + after[c] - 4.0 * middle[c]


@njit(cache=True)
def _powered(grid: Floats32, twice: int) -> Floats:
    """The Laplacian applied two times or, `twice` being 2, four times."""
    out = grid.astype(np.float64)
    other = np.empty_like(out)
    for _ in range(twice):
        _laplacian(out, other)
        _laplacian(other, out)
    return out


def _fourth(grid: Floats32) -> Floats:
    """The Laplacian applied four times: the gradient of half the squared Laplacian's squares."""
    return _powered(grid, 2)


def _roughness(grid: Floats32) -> float:
    """Mean square of the Laplacian's Laplacian."""
    return float(np.mean(_powered(grid, 1)[8:-8, 8:-8] ** 2))


def _expected(item: Sample, grid: Floats32) -> Floats32:
    x, y = (float(v) for v in item.shift)
    return read(grid, fine_weights(-y, 0), fine_weights(-x, 0))


def _residual_square(items: list[Sample], grid: Floats32) -> Floats:
    """Mean square (h + 16, w + 16) of what the fit leaves of one frame."""
    total = sum(item.count * (item.pixels - _expected(item, grid)).astype(np.float64) ** 2 for item in items)
    return np.asarray(total / max(len(items) - 1, 1), dtype=np.float64)


def _noise_variance(square: Floats) -> float:
    """Variance of a frame's noise, from what the fit leaves (`square`), without what moves in front of a part."""
    return float(np.median(_smoothed(square[_INNER])))


def _smoothed(square: Floats) -> Floats:
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(square, _SMOOTHED_PX, mode="mirror"), dtype=np.float64)


def _weight(variance: Floats) -> Floats32:
    """One over the variance (h, w) of a pixel from frame to frame, smoothed, about 1 in the middle.

    It holds shot noise, aliasing at edges and what moves in front, each where it is.
    """
    smooth = _smoothed(variance)
    middle = max(float(np.median(smooth)), 1e-30)
    return np.asarray(1.0 / np.clip(smooth / middle, 0.2, 10.0), dtype=np.float32)


def _placed(item: Sample, grid: Floats32) -> Sample:
    """The sample with its place, level and contrast as the template says: one step of least squares."""
    moved = planes(grid[_INNER_FINE].copy(), float(item.shift[0]), float(item.shift[1]))
    found = np.linalg.solve(*_normal(moved, item.pixels[_INNER].copy()))
    gain = found[2] if found[2] > 0.1 else 1.0
    pixels = ((item.pixels - np.float32(found[3])) / np.float32(gain)).astype(np.float32)
    step = np.clip(found[:2] / gain, -0.1, 0.1)
    return replace(item, pixels=pixels, shift=np.clip(item.shift + step, -0.6, 0.6))


@njit(cache=True, fastmath=True)
def _line_products(a: Floats32, b: Floats32) -> float:
    total = np.float32(0.0)
    for c in range(len(a)):
        total += a[c] * b[c]
    return float(total)


@njit(cache=True)
def _normal(moved: Floats32, pixels: Floats32) -> tuple[Floats, Floats]:
    """Normal matrix (4, 4) and right side (4,) of pixels (h, w) by shift along x and y, gain and level; `moved`
    (3, h, w): values and slopes of what they are compared with.
    """
    matrix, right = np.zeros((4, 4)), np.zeros(4)
    ones = np.ones(pixels.shape[1], dtype=np.float32)
    for r in range(pixels.shape[0]):
        # Products that are sums along one line lose nothing in single precision.
        lines = (moved[1, r], moved[2, r], moved[0, r], ones)
        for i in range(4):
            right[i] += _line_products(lines[i], pixels[r])
            for j in range(i + 1):
                matrix[i, j] += _line_products(lines[i], lines[j])
    for i in range(4):
        # The picture moves with the shift, and its values against the slopes.
        for j in range(i + 1):
            matrix[i, j] *= (-1.0 if i < 2 else 1.0) * (-1.0 if j < 2 else 1.0)
            matrix[j, i] = matrix[i, j]
        right[i] *= -1.0 if i < 2 else 1.0
    return matrix, right
