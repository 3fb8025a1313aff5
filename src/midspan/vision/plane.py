"""What a template is compared with frames by: a fine spline, the weight of its pixels, its noise and its low-pass.

A fine spline has two coefficients a pixel along each axis: coefficient k of a line lies k/2 px from its first pixel,
less a margin of four coefficients before and behind.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats, Floats32, Region
from midspan.vision.matching import CONTEXT_PX
from midspan.vision.texture import gaussian_taps, lowpass_taps, noise_stds, values

PER_PX = 2  # coefficients a pixel
TEMPLATE_WEIGHT = 4.0  # as measured on four textures: the least scatter
SMOOTHINGS_PX = (0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.4, 1.7, 2.0)
FALL_PX = 8
TYPICAL_PX = 128  # of the window are looked at to choose the low-pass


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


def best_smoothing_px(plane: Plane, window: Region) -> float:
    """The low-pass (px) that gives the least variance with this signal and noise, by the instrument's formula.

    Variance = mean Z'² over (mean Z' T')², with slopes Z' of the low-passed template, T' of the template; what noise
    adds to Z' counts `TEMPLATE_WEIGHT` times more, because a template's noise also shifts with the frame's phase. The
    means are sums over frequencies: each low-pass is a factor there.
    """
    height, width = (min(size, TYPICAL_PX) for size in (window.height, window.width))
    place = plane.origin[0] + (window.height - height) // 2, plane.origin[1] + (window.width - width) // 2
    fall = np.outer(_fall(height), _fall(width))
    power = _slope_power(_slopes(_core.cropped(plane.grid, place, (height, width))) * fall) / np.mean(fall**2)
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
    around[:, :side, :side] = _slopes(_core.refined(impulse))
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


def first_plane(image: NDArray[np.generic], window: Region, offset: float) -> Plane:
    """The reference image around the window, less `offset`; its values are known to be usable."""
    y0, x0 = max(window.y - CONTEXT_PX, 0), max(window.x - CONTEXT_PX, 0)
    raw = values(image[y0 : window.y + window.height + CONTEXT_PX, x0 : window.x + window.width + CONTEXT_PX], offset)
    assert raw is not None
    weight = np.ones((window.height, window.width), dtype=np.float32)
    return Plane(_core.refined(raw.astype(np.float64)), (window.y - y0, window.x - x0), weight, _block_noise(raw))


def fine_lowpass_taps(smoothing_px: float) -> Floats32:
    """What `lowpass_taps` are (2 m + 1,) for coefficients of a fine spline."""
    flat = np.zeros(PER_PX * 4 + 1)
    flat[::PER_PX] = lowpass_taps(0.0)
    return np.convolve(gaussian_taps(PER_PX * smoothing_px), flat).astype(np.float32)


def _block_noise(raw: Floats32) -> float:
    """Noise of the image: the lower fifth of that of its parts, because fine texture counts as noise."""
    side = 16
    down, across = (size // side for size in raw.shape)
    parts = raw[: down * side, : across * side].reshape(down, side, across, side).swapaxes(1, 2)
    return float(np.quantile(noise_stds(parts.reshape(-1, side, side).astype(np.float64)), 0.2))


def _slopes(grid: Floats32) -> Floats:
    """Slopes along x and y (2, rows, columns)."""
    return np.stack([_core.read_fine(grid, 0.0, 0.0, 0, 1), _core.read_fine(grid, 0.0, 0.0, 1, 0)]).astype(np.float64)
