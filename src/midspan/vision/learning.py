"""A better template than one frame: two samples a pixel, fitted to frames whose sub-pixel places differ.

One frame holds what lies above half a cycle a pixel aliased onto lower frequencies; frames at different places alias it
differently, so that together they tell it apart. The spline coefficients minimise the squared differences from all
frames, each at its place, plus a penalty on the fourth power of the Laplacian that stands for how the spectrum of
pictures through a lens falls; conjugate gradients, with the places renewed in between (after Elad and Feuer, 1997,
doi 10.1109/83.650118). Frames at one place only give their average, interpolated smoothly.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats, Floats32, Region
from midspan.vision.plane import PER_PX, Plane
from midspan.vision.texture import values

PAD_PX = 8  # around the window: what low-pass and spline reach for
SAME_PLACE_PX = 0.03  # frames nearer than this are one sample: the blur of it is 1e-4 of any frequency's amplitude
MAX_SAMPLES = 48
FIRST_LOOK = 8  # samples that show how large the noise is
ROUNDS, ITERATIONS = 3, 6  # six preconditioned steps come nearer than twelve plain ones
# Steps that lower the sum of squared differences by less than this share of a frame's noise variance a pixel change the
# template by less than a seventh (the root) of its own noise: no more of them are made.
MIN_STEP_SHARE = 0.02
FIRST_PENALTY, PENALTY_SHARE = 0.01, 0.1
_SMOOTHED_PX = 5
_INNER = np.s_[PAD_PX:-PAD_PX, PAD_PX:-PAD_PX]


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
        if items and (apart[nearest] < SAME_PLACE_PX or len(items) >= MAX_SAMPLES):
            if apart[nearest] < SAME_PLACE_PX:
                items[nearest] = items[nearest].plus(new)
        else:
            items.append(new)
        return KeptSamples(tuple(items), self.frames + 1)


def sample(
    pixels: NDArray[np.generic], window: Region, translation: tuple[float, float], offset: float, like: Floats32 | None
) -> Sample | None:
    """The frame `pixels` less `offset` about the window moved by `translation` (x, y px), level and contrast as `like`.

    None where that leaves the image.
    """
    x, y = (round(v) for v in translation)
    top, left = window.y + y - PAD_PX, window.x + x - PAD_PX
    bottom, right = top + window.height + 2 * PAD_PX, left + window.width + 2 * PAD_PX
    if top < 0 or left < 0 or bottom > pixels.shape[0] or right > pixels.shape[1]:
        return None
    cut = values(pixels[top:bottom, left:right], offset)
    if cut is None:
        return None
    seen = cut if like is None else _core.alike(cut, like)
    return Sample(seen, np.array([translation[0] - x, translation[1] - y]))


def learn_plane(samples: KeptSamples) -> Plane:
    """The template that the samples show together, with the weight of each pixel of the window."""
    items = _compiled(samples.items)
    grid = _core.refined(samples.items[0].pixels.astype(np.float64))
    penalty, least = FIRST_PENALTY, 0.0
    weights = _weights(samples.items)
    for turn in range(ROUNDS):
        grid, steps = _fitted(items, weights, grid, penalty, least)
        items.place(grid)
        weights = (*(_down_across(items.shifts)), weights[2])
        if turn == 0:
            noise = _noise_variance(items.residual_square(grid, FIRST_LOOK))
            penalty = PENALTY_SHARE * noise / max(_core.roughness(grid), 1e-30)
            least = MIN_STEP_SHARE * noise * samples.items[0].pixels.size
        elif steps < ITERATIONS:
            break
    square = items.residual_square(grid, len(samples.items))
    noise_std = math.sqrt(_noise_variance(square) / samples.frames)
    return Plane(grid, (PAD_PX, PAD_PX), _weight(square[_INNER]), noise_std)


def fit(samples: Sequence[Sample], start: Floats32, penalty: float) -> Floats32:
    """Fine coefficients (2 h + 7, 2 w + 7) that fit the samples, by conjugate gradients from `start`.

    `penalty`: variance of a frame's noise over that of the coefficients' squared Laplacian.
    """
    return _fitted(_compiled(samples), _weights(samples), start, penalty, 0.0)[0]


def _compiled(samples: Sequence[Sample]) -> _core.LearningSamples:
    """The samples as the core takes them."""
    return _core.LearningSamples(
        [(item.pixels, (float(item.shift[0]), float(item.shift[1])), float(item.count)) for item in samples]
    )


def _weights(samples: Sequence[Sample]) -> tuple[Floats, Floats, Floats]:
    """Weights of the samples' coefficients down and across (n, 9), and their numbers of frames (n,)."""
    count = np.array([float(item.count) for item in samples])
    return (*_down_across([item.shift.tolist() for item in samples]), count)


def _down_across(shifts: Sequence[Sequence[float]]) -> tuple[Floats, Floats]:
    """Weights (n, 9) of the coefficients about a pixel for samples at these places (n, 2) px, down and across."""
    across, down = (np.array([_core.fine_weights(-float(shift[k]), 0) for shift in shifts]) for k in range(2))
    return down, across


def _fitted(
    samples: _core.LearningSamples,
    weights: tuple[Floats, Floats, Floats],
    start: Floats32,
    penalty: float,
    least: float,
) -> tuple[Floats32, int]:
    """The coefficients of `fit`, and how many steps of conjugate gradients they took.

    These are preconditioned by what samples at many places, of these `weights`, make of each frequency: the steps are
    then few. `least`: a step that lowers the sum of squared differences by less is the last.
    """
    rest, factor = samples.spread(), 1.0 / _gain(start.shape, weights, penalty)
    grid, normal = start.copy(), samples.normal(penalty)
    rest -= normal.times(grid)
    direction = _filtered(rest, factor)
    square, steps = float(np.vdot(rest, direction)), 0
    while steps < ITERATIONS:
        steps += 1
        through = normal.times(direction)
        step = square / max(float(np.vdot(direction, through)), 1e-300)
        grid += np.float32(step) * direction
        if step * square < least or steps == ITERATIONS:
            break
        rest -= np.float32(step) * through
        towards = _filtered(rest, factor)
        before, square = square, float(np.vdot(rest, towards))
        direction *= np.float32(square / max(before, 1e-300))
        direction += towards
    return grid, steps


def _gain(shape: tuple[int, ...], weights: tuple[Floats, Floats, Floats], penalty: float) -> Floats32:
    """What samples at many places and the penalty make of each frequency of coefficients (rows, columns).

    `weights` of the samples down and across (n, 9), and their numbers of frames (n,). The places part a frequency from
    those that single frames alias onto it.
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


def _filtered(grid: Floats32, factor: Floats32) -> Floats32:
    """Coefficients (rows, columns) with each frequency times its `factor`, without what goes beyond the edges."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    size = [next_fast_len(n, real=True) for n in grid.shape]
    spectrum = rfft2(grid, s=size)
    spectrum *= factor
    return np.ascontiguousarray(irfft2(spectrum, s=size)[: grid.shape[0], : grid.shape[1]], dtype=np.float32)


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
