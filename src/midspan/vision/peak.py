"""The sub-pixel peak of the ZNCC surface and its covariance."""

import numpy as np
from numba import njit

from midspan.records import Floats
from midspan.vision.spline import REACH, TAPS, Floats32, translated, weights

BLOCKS = 4  # the residual is watched in 4 by 4 blocks


@njit(cache=True, fastmath=True)
def centred(patch: Floats32, top: int, left: int, rows: int, columns: int) -> Floats32:
    """The window of `patch` at (top, left) without its mean."""
    out = np.empty((rows, columns), dtype=np.float32)
    total = 0.0
    for r in range(rows):
        for c in range(columns):
            out[r, c] = patch[top + r, left + c]
            total += patch[top + r, left + c]
    mean = np.float32(total / (rows * columns))
    for r in range(rows):
        for c in range(columns):
            out[r, c] -= mean
    return out


@njit(cache=True, fastmath=True)
def spline_products(window: Floats32, grid: Floats32) -> Floats:
    """Numerator of the ZNCC surface as spline coefficients (7, 7) over shifts of -3 … 3 px (rows y, columns x).

    `window` (h, w) is the frame's window without its mean, `grid` (h + 6, w + 6) the template's spline coefficients.
    """
    rows, columns = window.shape
    out = np.zeros((TAPS, TAPS))
    for r in range(rows):
        for j in range(TAPS):
            for i in range(TAPS):
                line = np.float32(0.0)
                for c in range(columns):
                    line += window[r, c] * grid[r + 2 * REACH - j, c + 2 * REACH - i]
                out[j, i] += line
    return out


@njit(cache=True)
def powers(x: float, count: int, derivative: int) -> Floats:
    """1, x, x² … (count,), or their first or second derivative by x."""
    out = np.zeros(count)
    for k in range(derivative, count):
        factor = 1.0
        for step in range(derivative):
            factor *= k - step
        out[k] = factor * x ** (k - derivative)
    return out


@njit(cache=True)
def _bilinear(matrix: Floats, left: Floats, right: Floats) -> float:
    total = 0.0
    for j in range(matrix.shape[0]):
        for i in range(matrix.shape[1]):
            total += left[j] * matrix[j, i] * right[i]
    return total


@njit(cache=True)
def _log_zncc(numerator: Floats, norm: Floats, x: float, y: float) -> Floats:
    """Value, slopes x and y, curvatures xx, xy and yy of ln ZNCC (up to a constant) at the shift (x, y)."""
    out = np.full(6, -np.inf)
    wx, wy = np.empty((3, TAPS)), np.empty((3, TAPS))
    count = norm.shape[0]
    px, py = np.empty((3, count)), np.empty((3, count))
    for d in range(3):
        wx[d], wy[d] = weights(x, d), weights(y, d)
        px[d], py[d] = powers(x, count, d), powers(y, count, d)
    n = _bilinear(numerator, wy[0], wx[0])
    if n <= 0.0:
        return out
    nx, ny = _bilinear(numerator, wy[0], wx[1]) / n, _bilinear(numerator, wy[1], wx[0]) / n
    out[0] = np.log(n) - _bilinear(norm, py[0], px[0])
    out[1] = nx - _bilinear(norm, py[0], px[1])
    out[2] = ny - _bilinear(norm, py[1], px[0])
    out[3] = _bilinear(numerator, wy[0], wx[2]) / n - nx * nx - _bilinear(norm, py[0], px[2])
    out[4] = _bilinear(numerator, wy[1], wx[1]) / n - nx * ny - _bilinear(norm, py[1], px[1])
    out[5] = _bilinear(numerator, wy[2], wx[0]) / n - ny * ny - _bilinear(norm, py[2], px[0])
    return out


@njit(cache=True)
def climb(numerator: Floats, norm: Floats) -> tuple[float, float, bool]:
    """Maximise the ZNCC surface over shifts of -1 to 1 px by Newton's method from the whole-pixel peak.

    `numerator` (7, 7) are spline coefficients, `norm` (p, p) the polynomial of ln √(energy of the shifted template).
    Returns the shift x, y in px and whether it is a maximum inside the range.
    """
    x, y = 0.0, 0.0
    for _ in range(25):
        s = _log_zncc(numerator, norm, x, y)
        det = s[3] * s[5] - s[4] * s[4]
        if s[3] < 0.0 and det > 0.0:
            step_x, step_y = (s[4] * s[2] - s[5] * s[1]) / det, (s[4] * s[1] - s[3] * s[2]) / det
        else:  # not yet concave: a short step uphill
            length = np.sqrt(s[1] * s[1] + s[2] * s[2]) + 1e-300
            step_x, step_y = 0.1 * s[1] / length, 0.1 * s[2] / length
        largest = max(abs(step_x), abs(step_y))
        if not np.isfinite(largest):
            return 0.0, 0.0, False
        ratio = min(1.0, 0.5 / max(largest, 1e-300))
        x, y = min(max(x + ratio * step_x, -1.0), 1.0), min(max(y + ratio * step_y, -1.0), 1.0)
        if largest < 1e-9:
            return x, y, max(abs(x), abs(y)) < 1.0
    return x, y, False


@njit(cache=True, fastmath=True)
def _remove_template(window: Floats32, moved: Floats32) -> tuple[float, float]:
    """Turn `window` into the residual in the template's unit; returns ZNCC and gain (0, 0 without a match)."""
    rows, columns = window.shape
    mean, product, energy, own = np.float32(moved.mean()), 0.0, 0.0, 0.0
    for r in range(rows):
        for c in range(columns):
            moved[r, c] -= mean
            product += window[r, c] * moved[r, c]
            energy += moved[r, c] * moved[r, c]
            own += window[r, c] * window[r, c]
    if product <= 0.0:
        return 0.0, 0.0
    inverse = np.float32(energy / product)
    for r in range(rows):
        for c in range(columns):
            window[r, c] = window[r, c] * inverse - moved[r, c]
    return product / np.sqrt(energy * own), product / energy


@njit(cache=True, fastmath=True)
def _block_sum(residual: Floats32, gradient: Floats32, rows: tuple[int, int], columns: tuple[int, int]) -> Floats:
    """Sums over a block of residual × gradient x, residual × gradient y and residual²."""
    x, y, square = 0.0, 0.0, 0.0
    for r in range(rows[0], rows[1]):
        for c in range(columns[0], columns[1]):
            x += residual[r, c] * gradient[0, r, c]
            y += residual[r, c] * gradient[1, r, c]
            square += residual[r, c] * residual[r, c]
    return np.array([x, y, square])


@njit(cache=True)
def scores(window: Floats32, grid: Floats32, gradient: Floats32, shift: Floats) -> tuple[float, float, Floats]:
    """What is left of the frame's window when the shifted template is taken out.

    `window` (h, w) without its mean (overwritten by the residual), `grid` the template's spline coefficients,
    `gradient` (2, h, w) along x and y, `shift` (2,) the peak x, y in px. Returns ZNCC, gain and, for 4 by 4 blocks,
    the sums (16, 3) of residual × gradient x, residual × gradient y and residual², in the template's unit.
    """
    blocks = np.zeros((BLOCKS * BLOCKS, 3))
    quality, gain = _remove_template(window, translated(grid, shift[0], shift[1]))
    if gain == 0.0:
        return quality, gain, blocks
    h, w = window.shape
    for b in range(BLOCKS):
        for a in range(BLOCKS):
            rows = (b * h // BLOCKS, (b + 1) * h // BLOCKS)
            columns = (a * w // BLOCKS, (a + 1) * w // BLOCKS)
            blocks[b * BLOCKS + a] = _block_sum(window, gradient, rows, columns)
    return quality, gain, blocks


@njit(cache=True)
def _inverse(a: Floats) -> Floats:
    det = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    out = np.empty((2, 2))
    out[0, 0], out[0, 1] = a[1, 1] / det, -a[0, 1] / det
    out[1, 0], out[1, 1] = -a[1, 0] / det, a[0, 0] / det
    return out


@njit(cache=True)
def _without_noise(observed: Floats, noise: float) -> Floats:
    """Take the noise's own gradients out of a 2 by 2 gradient matrix, leaving at least a tenth of each axis."""
    ratio_x = max(1.0 - noise / observed[0, 0], 0.1)
    ratio_y = max(1.0 - noise / observed[1, 1], 0.1)
    cross = observed[0, 1] * min(ratio_x, ratio_y)
    return np.array([[observed[0, 0] * ratio_x, cross], [cross, observed[1, 1] * ratio_y]])


@njit(cache=True)
def variances(blocks: Floats, fisher: Floats, coloured: Floats, noise: Floats) -> tuple[float, float]:
    """Variances x and y (px²) of the peak by linear theory.

    `blocks` (16, 3) from `scores`; `fisher` (2, 2) sum of g gᵀ over the smoothed template; `coloured` (2, 2) the same
    of the gradients smoothed once more; `noise` (4,): pixels in the window, and what white noise of variance 1 in the
    raw image adds to a smoothed pixel's variance, to `fisher` and to `coloured`. The residual holds the noise of frame
    and template alike, so both are counted. Where the residual is correlated over the blocks (an object in front,
    a shadow, rotation), the blocks' scatter replaces the white-noise theory.
    """
    white = blocks[:, 2].sum() / (noise[0] - 4.0) / noise[1]
    bread = _inverse(_without_noise(fisher, 0.5 * white * noise[2]))
    meat = white * _without_noise(coloured, 0.5 * white * noise[3])
    model = bread @ meat @ bread
    count = blocks.shape[0]
    score = np.empty((count, 2))
    for axis in range(2):  # at the peak the sums add to nothing but what the template's noise has in common everywhere
        score[:, axis] = blocks[:, axis] - blocks[:, axis].mean()
    scatter = bread @ (score.T @ score * (count / (count - 3.0))) @ bread
    x, y = model[0, 0], model[1, 1]
    # Under white noise the scatter of 13 free blocks exceeds three times its mean about once in 10 000 frames.
    if scatter[0, 0] > 3.0 * x:
        x = scatter[0, 0]
    if scatter[1, 1] > 3.0 * y:
        y = scatter[1, 1]
    return x, y
