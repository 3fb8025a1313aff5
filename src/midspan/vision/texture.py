"""What a patch of image holds: its values, its noise, its gradients."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.errors import UsageError
from midspan.records import Floats, Floats32
from midspan.signals.medians import MEDIAN_DEVIATION

# The quintic B-spline reaches 3 px to either side; a shift of up to 1 px needs the coefficients at -3 … 3.
REACH = 3
TEXTURE_SMOOTHING_PX = 1.5  # noise has mostly gone here, texture that can be tracked has not
PLAUSIBLE_NOISE = 0.03  # "noise" above this share of full scale is fine texture


def gaussian_taps(sigma_px: float) -> Floats:
    """Symmetric Gaussian weights (2 m + 1,) with sum 1, m = 3 sigma rounded up; a single 1 for sigma 0."""
    if sigma_px <= 0.0:
        return np.ones(1)
    m = math.ceil(3.0 * sigma_px)
    taps = np.exp(-0.5 * (np.arange(-m, m + 1) / sigma_px) ** 2)
    return np.asarray(taps / taps.sum(), dtype=np.float64)


def lowpass_taps(smoothing_px: float) -> Floats:
    """Symmetric weights (2 m + 1,) that take out the Nyquist frequency and otherwise keep the image, and a Gaussian.

    Their response 1 - sin⁴(π f) is flat at low and zero at half a cycle per pixel: what a spline cannot move exactly,
    noise above all, would otherwise pull a peak to whole or half pixels.
    """
    flat = np.array([-1.0, 4.0, 10.0, 4.0, -1.0]) / 16.0
    return np.convolve(flat, gaussian_taps(smoothing_px))


def values(pixels: NDArray[np.generic], offset: float) -> Floats32 | None:
    """The pixels (rows, columns) less `offset` as float32; None when more than 2 % of them are not numbers.

    The offset goes first, in full precision: float32 alone would lose a small contrast on a large level.
    """
    return _core.pixel_values(pixels, offset)


def noise_std(image: Floats) -> float:
    """White noise of one image (rows, columns), in its unit, from the median of a filter that is blind to planes.

    Fine texture counts as noise, so that this is an upper bound (after Immerkær, 1996, doi 10.1006/cviu.1996.0060).
    """
    return float(noise_stds(image[None])[0])


def noise_stds(images: Floats) -> Floats:
    """`noise_std` of each of some images (n, rows, columns)."""
    if min(images.shape[1:]) < 3:
        return np.zeros(len(images))
    v = images[:, :-2] - 2.0 * images[:, 1:-1] + images[:, 2:]
    mask = v[:, :, :-2] - 2.0 * v[:, :, 1:-1] + v[:, :, 2:]
    # The mask's weights have the square sum 36.
    return np.asarray(np.median(np.abs(mask).reshape(len(images), -1), axis=1) / (6.0 * MEDIAN_DEVIATION))


@cache
def noise_gains(smoothing_px: float) -> tuple[float, float, float]:
    """What white noise of variance 1 gives after `lowpass_taps`: a pixel's variance, its gradient's variance along one
    axis, and that after filtering once more.
    """
    taps = lowpass_taps(smoothing_px)
    derivative = np.convolve(taps, _slope_response())
    twice = np.convolve(taps, taps)
    return (
        float(np.sum(taps**2) ** 2),
        float(np.sum(derivative**2) * np.sum(taps**2)),
        float(np.sum(np.convolve(derivative, taps) ** 2) * np.sum(twice**2)),
    )


def _slope_response() -> Floats:
    """Response (63,) of the quintic spline's slope at the pixels to a single pixel of value 1."""
    from scipy.ndimage import spline_filter1d

    impulse = np.zeros(57)
    impulse[28] = 1.0
    return np.convolve(spline_filter1d(impulse, order=5), _core.spline_weights(0.0, 1)[::-1])


def gradient_square(raw: Floats32, smoothing_px: float) -> Floats:
    """Mean of g gᵀ (2, 2) over `raw` (rows, columns) after `lowpass_taps`; axes x, y."""
    grid = _core.spline_coefficients(
        _core.smooth(raw, lowpass_taps(smoothing_px).astype(np.float32)).astype(np.float64)
    ).astype(np.float32)
    if min(grid.shape) <= 2 * REACH:
        return np.zeros((2, 2))
    value, slope = _core.spline_weights(0.0, 0), _core.spline_weights(0.0, 1)
    g = np.stack([_core.combine(grid, value, slope).ravel(), _core.combine(grid, slope, value).ravel()]).astype(
        np.float64
    )
    return np.asarray(g @ g.T / g.shape[1], dtype=np.float64)


def full_scale(image: NDArray[np.generic]) -> float:
    """The largest level that the image could show: 255 for 8 bit, else the largest it does show."""
    if image.dtype == np.uint8:
        return 255.0
    wide = np.abs(np.asarray(image, dtype=np.float64))
    return float(np.max(wide[np.isfinite(wide)], initial=0.0))


def check_texture(raw: Floats32, sigma: float, scale: float, region: str) -> None:
    """UsageError when the gradients in `raw` along the weakest direction are no larger than noise `sigma` makes them.

    The noise's mean square gradient scatters by √(2 / independent pixels); four times that is allowed for.
    """
    weakest = max(float(np.linalg.eigvalsh(gradient_square(raw, TEXTURE_SMOOTHING_PX))[0]), 0.0)
    from_noise = sigma**2 * noise_gains(TEXTURE_SMOOTHING_PX)[1]
    independent = max(raw.size / (4.0 * math.pi * TEXTURE_SMOOTHING_PX**2), 1.0)
    limit = from_noise * (1.0 + 4.0 * math.sqrt(2.0 / independent))
    constant = weakest <= (1e-6 * scale) ** 2
    if constant or (weakest < limit and sigma < PLAUSIBLE_NOISE * scale):
        raise UsageError(
            f"camera.roi must hold texture that varies in both directions; {region} has gradients of "
            f"{math.sqrt(weakest):.3g} per px in its weakest direction where noise of {sigma:.3g} alone gives "
            f"{math.sqrt(from_noise):.3g}. Choose a place with edges or corners."
        )
