"""A template's kernels for the phases that were needed, and how much each block of it tells."""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats, Region
from midspan.vision.blocks import Mask
from midspan.vision.fine_spline import FINE_TAPS, PER_PX, fine_weights, read, refined
from midspan.vision.kernels import PHASES, Halves, Integers, block_part, build, phase_shift, rounded
from midspan.vision.matching import CONTEXT_PX
from midspan.vision.spline import Floats32
from midspan.vision.texture import gaussian_taps, lowpass_taps, noise_gains, noise_stds, values
from midspan.vision.zncc import smooth as filtered

# Blocks along each axis, and the least size in px for which there are fewer of them.
COARSE, FINE = (5, 20), (8, 10)
LEAST_SHARE = 0.3  # of a block's gradients must be texture, not noise
TEMPLATE_WEIGHT = 4.0  # as measured on four textures: the least scatter
SMOOTHINGS_PX = (0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.4, 1.7, 2.0)
FALL_PX = 8
TYPICAL_PX = 128  # of the window are looked at to choose the low-pass
BANK_BYTES = 24 << 20  # of kernels in one bank: all 64 phases of a region of 256 px, 16 of one of 512 px


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """What kernels are made from: fine spline coefficients `grid` of the window, which begins at the pixel `origin`
    (row, column) of it, and around it; `weight` (h, w) of the window's pixels; standard deviation of the noise of a
    pixel of it.
    """

    grid: Floats32
    origin: tuple[int, int]
    weight: Floats32
    noise_std: float


class Store(NamedTuple):
    """A bank as compiled code takes it.

    grids: fine coefficients (2 h + 7, 2 w + 7) of the template, plain and low-passed; weight (h, w); down, across:
    edges of the blocks; origin: row and column of the window in the reference; kernels (slots, 3 h w), in which each
    block has slots of its own, and steps (blocks, slots, 3): see `project`; warp (blocks, slots, 2, 5): see `build`;
    phase_in (blocks, slots): the phase whose kernels a slot holds, -1: none; centres (blocks, 2) from the window's
    middle, px; information (blocks, 2, 2) and gain_information (blocks,): inverse variances; zero (4,): the pose that
    poses count from.
    """

    grids: tuple[Floats32, Floats32]
    weight: Floats32
    down: Integers
    across: Integers
    origin: Integers
    kernels: Halves
    steps: Floats32
    warp: Floats
    phase_in: Integers
    centres: Floats
    information: Floats
    gain_information: Floats
    zero: Floats


@njit(cache=True)
def block_box(down: Integers, across: Integers, block: int) -> tuple[int, int, int, int]:
    """First row, row after the last, first column, column after the last of the block of that number."""
    j, i = divmod(block, len(across) - 1)
    return down[j], down[j + 1], across[i], across[i + 1]


@njit(cache=True)
def phase_slot(phase: int, count: int) -> int:
    """The slot of a phase among so many; phases share slots where there are fewer of these.

    Neighbouring phases, and those along either axis, have slots of their own where there are 8 of them.
    """
    x, y = divmod(phase, PHASES)
    return (PHASES * x + (3 * x + y) % PHASES) % count


@njit(cache=True)
def slots(store: Store, phase: Integers, wanted: Mask) -> Integers:
    """The slot (blocks,) that holds each block's kernels for its `phase` (blocks,), -1 for those not `wanted`.

    Kernels that are not there are made, in place of those of another phase (see `phase_slot`).
    """
    out = np.full(len(phase), -1, dtype=np.int64)
    for b in range(len(phase)):
        if not wanted[b]:
            continue
        slot = phase_slot(phase[b], len(store.kernels))
        if store.phase_in[b, slot] != phase[b]:
            box = block_box(store.down, store.across, b)
            first, size = block_part(box, store.weight.shape[1])
            made = np.empty(3 * size, dtype=np.float32)
            store.warp[b, slot] = build(store.grids, store.weight, box, phase_shift(phase[b]), made)
            store.steps[b, slot] = rounded(made, store.kernels[slot, 3 * first : 3 * (first + size)])
            store.phase_in[b, slot] = phase[b]
        out[b] = slot
    return out


def best_smoothing_px(plane: Plane, window: Region) -> float:
    """The low-pass (px) that gives the least variance with this signal and noise, by the instrument's formula.

    Variance = mean Z'² over (mean Z' T')², with slopes Z' of the low-passed template, T' of the template; what noise
    adds to Z' counts `TEMPLATE_WEIGHT` times more, because a template's noise also shifts with the frame's phase. The
    means are sums over frequencies: each low-pass is a factor there.
    """
    height, width = (min(size, TYPICAL_PX) for size in (window.height, window.width))
    place = plane.origin[0] + (window.height - height) // 2, plane.origin[1] + (window.width - width) // 2
    fall = np.outer(_fall(height), _fall(width))
    power = _slope_power(_slopes(cropped(plane.grid, place, (height, width))) * fall) / np.mean(fall**2)
    square, noise, variance = plane.noise_std**2, _noise_power(height, width), []
    for sigma in SMOOTHINGS_PX:
        response = _lowpass_response(sigma, height, width)
        own, shared = float(np.vdot(noise, response**2)), float(np.vdot(noise, response))
        clean = max(float(np.vdot(power, response**2)) - square * own, 1e-30)
        along = max(float(np.vdot(power, response)) - square * shared, 1e-30)
        variance.append((clean + TEMPLATE_WEIGHT * square * own) / along**2)
    return SMOOTHINGS_PX[int(np.argmin(variance))]


def _fall(size: int) -> Floats:
    """Weights (size,) that fall off to both ends, whose jump would count as fine detail."""
    end = np.hanning(2 * FALL_PX + 1)[1 : FALL_PX + 1]
    out = np.ones(size)
    out[:FALL_PX], out[-FALL_PX:] = end, end[::-1]
    return out


def _slope_power(slopes: Floats) -> Floats:
    """Power (rows, columns // 2 + 1) of each frequency of two slopes (2, rows, columns); it adds up to the mean square
    of both.
    """
    power = np.sum(np.abs(np.fft.rfft2(slopes)) ** 2, axis=0) / slopes[0].size ** 2
    power[:, 1 : (slopes.shape[2] + 1) // 2] *= 2.0
    return np.asarray(power)


@cache
def _noise_power(height: int, width: int) -> Floats:
    """What `_slope_power` of slopes of white noise of variance 1 is, in a window of this size."""
    side = 41
    impulse = np.zeros((side, side))
    impulse[side // 2, side // 2] = 1.0
    around = np.zeros((2, max(height, side), max(width, side)))
    around[:, :side, :side] = _slopes(refined(impulse))
    power = _slope_power(around) * around[0].size
    rows = np.rint(np.fft.fftfreq(height) * len(power)).astype(int)
    columns = np.rint(np.fft.rfftfreq(width) * around.shape[2]).astype(int)
    return np.asarray(power[np.ix_(rows, columns)] * around[0].size / (height * width))


@cache
def _lowpass_response(smoothing_px: float, height: int, width: int) -> Floats:
    """What `lowpass_taps` make (height, width // 2 + 1) of each frequency of a picture of this size."""

    def along(frequency: Floats) -> Floats:
        flat = 1.0 - np.sin(np.pi * frequency) ** 4
        fine = gaussian_taps(PER_PX * smoothing_px)
        place = np.arange(len(fine)) - len(fine) // 2
        return np.asarray(flat * (np.cos(2.0 * np.pi * np.outer(frequency, place) / PER_PX) @ fine))

    return np.outer(along(np.asarray(np.fft.fftfreq(height))), along(np.asarray(np.fft.rfftfreq(width))))


def make_bank(plane: Plane, window: Region, smoothing_px: float, division: tuple[int, int]) -> Store:
    """The bank of a template in `division` blocks; its kernels are made when they are first needed."""
    both = plane.grid, lowpassed(plane.grid, smoothing_px)
    grids = tuple(cropped(grid, plane.origin, (window.height, window.width)) for grid in both)
    down, across = division_edges(window.height, division), division_edges(window.width, division)
    x, y = np.meshgrid(0.5 * (across[1:] + across[:-1] - window.width), 0.5 * (down[1:] + down[:-1] - window.height))
    count, size = x.size, window.height * window.width
    held = held_phases(window)
    boxes = [block_box(down, across, b) for b in range(count)]
    covariance = np.array([_covariance((grids[0], grids[1]), plane.weight, box) for box in boxes])
    information = _information(covariance, texture_share(plane, grids[1], smoothing_px, (down, across)))
    spread = np.where(np.isfinite(covariance[:, 2, 2]), covariance[:, 2, 2], np.inf)
    return Store(
        grids=(grids[0], grids[1]),
        weight=plane.weight,
        down=down,
        across=across,
        origin=np.array([window.y, window.x], dtype=np.int64),
        kernels=np.empty((held, 3 * size), dtype=np.int16),
        steps=np.ones((count, held, 3), dtype=np.float32),
        warp=np.zeros((count, held, 2, 5)),
        phase_in=np.full((count, held), -1, dtype=np.int64),
        centres=np.column_stack([x.ravel(), y.ravel()]),
        information=information,
        gain_information=np.where(information[:, 0, 0] > 0, 1.0 / np.maximum(spread, 1e-300), 0.0),
        zero=np.zeros(4),
    )


def held_phases(window: Region) -> int:
    """Of how many phases a bank of the window holds the kernels."""
    return int(np.clip(BANK_BYTES // (6 * window.height * window.width), 4, PHASES**2))


def texture_share(plane: Plane, smooth: Floats32, smoothing_px: float, edges: tuple[Integers, Integers]) -> Floats:
    """Share (blocks,) of the low-passed gradients of each block that is texture, not noise; 0 where it is too little.

    `smooth`: fine coefficients (2 h + 7, 2 w + 7) of the low-passed window; `edges` of the blocks down and across.
    """
    down, across = edges
    boxes = [block_box(down, across, b) for b in range((len(down) - 1) * (len(across) - 1))]
    noise = plane.noise_std**2 * noise_gains(smoothing_px)[1] * 2.0
    share = np.clip(1.0 - noise / np.maximum(_gradient_squares(smooth, boxes), 1e-30), 0.0, 1.0)
    return np.where(share > LEAST_SHARE, share, 0.0)


def _covariance(grids: tuple[Floats32, Floats32], weight: Floats32, box: tuple[int, int, int, int]) -> Floats:
    """Noise covariance (3, 3) of the kernels of a block for that noise, infinite where it holds no texture."""
    made = np.empty(3 * block_part(box, weight.shape[1])[1], dtype=np.float32)
    build(grids, weight, box, (0.0, 0.0), made)
    if not made.any():
        return np.full((3, 3), np.inf)
    kernels = made.reshape(3, -1).astype(np.float64)
    return np.asarray((kernels / weight[box[0] : box[1], box[2] : box[3]].ravel()) @ kernels.T)


def division_edges(size: int, division: tuple[int, int]) -> Integers:
    """Edges (n + 1,) of the blocks along an axis of `size` px; `division`: most of them, and their least size, px."""
    count = min(division[0], max(size // division[1], 2))
    return np.array([k * size // count for k in range(count + 1)], dtype=np.int64)


def first_plane(image: NDArray[np.generic], window: Region, offset: float) -> Plane:
    """The reference image around the window, less `offset`; its values are known to be usable."""
    y0, x0 = max(window.y - CONTEXT_PX, 0), max(window.x - CONTEXT_PX, 0)
    raw = values(image[y0 : window.y + window.height + CONTEXT_PX, x0 : window.x + window.width + CONTEXT_PX], offset)
    assert raw is not None
    weight = np.ones((window.height, window.width), dtype=np.float32)
    return Plane(refined(raw.astype(np.float64)), (window.y - y0, window.x - x0), weight, _block_noise(raw))


def cropped(grid: Floats32, origin: tuple[int, int], size: tuple[int, int]) -> Floats32:
    """The coefficients of the pixels from `origin` (row, column) on, `size` (rows, columns) of them."""
    top, left = (PER_PX * k for k in origin)
    down, across = (PER_PX * k + FINE_TAPS - PER_PX for k in size)
    return np.ascontiguousarray(grid[top : top + down, left : left + across])


def lowpassed(grid: Floats32, smoothing_px: float) -> Floats32:
    """Coefficients of the image after `lowpass_taps`."""
    flat = np.zeros(PER_PX * 4 + 1)
    flat[::PER_PX] = lowpass_taps(0.0)
    taps = np.convolve(gaussian_taps(PER_PX * smoothing_px), flat).astype(np.float32)
    return filtered(np.pad(grid, len(taps) // 2, mode="reflect"), taps)


def _block_noise(raw: Floats32) -> float:
    """Noise of the image: the lower fifth of that of its parts, because fine texture counts as noise."""
    side = 16
    down, across = (size // side for size in raw.shape)
    parts = raw[: down * side, : across * side].reshape(down, side, across, side).swapaxes(1, 2)
    return float(np.quantile(noise_stds(parts.reshape(-1, side, side).astype(np.float64)), 0.2))


def _slopes(grid: Floats32) -> Floats:
    """Slopes along x and y (2, rows, columns)."""
    value, slope = fine_weights(0.0, 0), fine_weights(0.0, 1)
    return np.stack([read(grid, value, slope), read(grid, slope, value)]).astype(np.float64)


def _gradient_squares(grid: Floats32, boxes: list[tuple[int, int, int, int]]) -> Floats:
    """Mean of the squared gradient (blocks,), its level taken out."""
    slopes = _slopes(grid)
    return np.array([slopes[:, r0:r1, c0:c1].var(axis=(1, 2)).sum() for r0, r1, c0, c1 in boxes])


def _information(covariance: Floats, share: Floats) -> Floats:
    """Inverse covariance (blocks, 2, 2) of x and y for noise of variance 1; 0 for blocks without texture."""
    out = np.zeros((len(covariance), 2, 2))
    for b, c in enumerate(covariance):
        if np.isfinite(c).all() and share[b] > 0.0:
            out[b] = np.linalg.inv(c[:2, :2]) * share[b]
    return out
