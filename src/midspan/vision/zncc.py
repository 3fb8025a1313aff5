"""Zero-mean normalised cross-correlation (ZNCC) of a template with every window of a patch."""

import numpy as np
from numba import njit

from midspan.records import Floats
from midspan.vision.spline import Floats32


@njit(cache=True)
def window_energies(patch: Floats32 | Floats, rows: int, columns: int) -> Floats:
    """Sum of squares about the mean of every window of `rows` by `columns` px, from integral images."""
    height, width = patch.shape
    total = np.zeros((height + 1, width + 1))
    square = np.zeros((height + 1, width + 1))
    for r in range(height):
        line = 0.0
        line_square = 0.0
        for c in range(width):
            value = float(patch[r, c])
            line += value
            line_square += value * value
            total[r + 1, c + 1] = total[r, c + 1] + line
            square[r + 1, c + 1] = square[r, c + 1] + line_square
    out = np.empty((height - rows + 1, width - columns + 1))
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            s, e = r + rows, c + columns
            first = total[s, e] - total[r, e] - total[s, c] + total[r, c]
            second = square[s, e] - square[r, e] - square[s, c] + square[r, c]
            out[r, c] = max(second - first * first / (rows * columns), 0.0)
    return out


@njit(cache=True, fastmath=True)
def products(patch: Floats32, template: Floats32) -> Floats:
    """Sum of products of `template` with every window of `patch`; rows in float32, their sum in float64."""
    rows, columns = template.shape
    out = np.zeros((patch.shape[0] - rows + 1, patch.shape[1] - columns + 1))
    for y in range(out.shape[0]):
        for r in range(rows):
            for x in range(out.shape[1]):
                line = np.float32(0.0)
                for c in range(columns):
                    line += patch[y + r, x + c] * template[r, c]
                out[y, x] += line
    return out


@njit(cache=True)
def zncc_map(patch: Floats32, template: Floats32) -> Floats:
    """ZNCC (-1 to 1) of `template` at every whole-pixel position in `patch`.

    `patch` (rows, columns), float32 and roughly free of its mean (float32 sums lose the difference otherwise);
    `template` (h, w), float32 with zero mean. Returns (rows - h + 1, columns - w + 1); 0 where a window is constant.
    """
    norm = 0.0
    for value in template.ravel():
        norm += float(value) * float(value)
    energy = window_energies(patch, template.shape[0], template.shape[1])
    out = products(patch, template)
    # Integral images leave rounding dust of about 1e-16 of the patch's whole energy where a window is constant.
    dust = 1e-12 * (energy.max() + 1e-30)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            product = energy[y, x] * norm
            out[y, x] = out[y, x] / np.sqrt(product) if energy[y, x] > dust and product > 0.0 else 0.0
    return out


def zncc_matrix(patch: Floats, template: Floats) -> Floats:
    """The same in double precision by the Fourier transform, for many positions: equation 2 of the two-stage paper."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    rows, columns = template.shape
    size = [next_fast_len(length, real=True) for length in patch.shape]
    product = irfft2(rfft2(patch, size) * np.conj(rfft2(template, size)), size)
    energy = window_energies(patch, rows, columns)
    product = product[: energy.shape[0], : energy.shape[1]]
    seen = energy > 1e-12 * (np.max(energy) + 1e-30)
    norm = np.sqrt(np.where(seen, energy, 1.0) * np.sum(template**2))
    return np.where(seen, product / norm, 0.0)


@njit(cache=True, fastmath=True)
def smooth(patch: Floats32, taps: Floats32) -> Floats32:
    """Filter `patch` along both axes with the symmetric `taps` (2 m + 1,); the result loses m px on every side."""
    m = taps.shape[0] // 2
    rows, columns = patch.shape[0] - 2 * m, patch.shape[1] - 2 * m
    out = np.zeros((rows, columns), dtype=np.float32)
    line = np.empty(patch.shape[1], dtype=np.float32)
    for r in range(rows):
        line[:] = np.float32(0.0)
        for j in range(taps.shape[0]):
            for c in range(patch.shape[1]):
                line[c] += taps[j] * patch[r + j, c]
        for i in range(taps.shape[0]):
            for c in range(columns):
                out[r, c] += taps[i] * line[c + i]
    return out


@njit(cache=True)
def shrink(patch: Floats32, factor: int) -> Floats32:
    """Means of the blocks of `factor` by `factor` px; what does not fill a block is left out."""
    rows, columns = patch.shape[0] // factor, patch.shape[1] // factor
    out = np.zeros((rows, columns), dtype=np.float32)
    share = np.float32(1.0 / (factor * factor))
    for r in range(rows * factor):
        for c in range(columns * factor):
            out[r // factor, c // factor] += share * patch[r, c]
    return out
