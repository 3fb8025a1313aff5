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
    out, zero = np.zeros((TAPS, TAPS)), np.float32(0.0)
    for r in range(rows):
        own = window[r]
        for j in range(TAPS):
            line = grid[r + 2 * REACH - j]
            # Seven sums by name: the compiler keeps them in registers, which makes this ten times as fast as a loop.
            a, b, c, d, e, f, g = zero, zero, zero, zero, zero, zero, zero
            for k in range(columns):
                value = own[k]
                a += value * line[k + 6]
                b += value * line[k + 5]
                c += value * line[k + 4]
                d += value * line[k + 3]
                e += value * line[k + 2]
                f += value * line[k + 1]
                g += value * line[k]
            for i, total in enumerate((a, b, c, d, e, f, g)):
                out[j, i] += total
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
def _block_sum(residual: Floats32, basis: Floats32, rows: tuple[int, int], columns: tuple[int, int]) -> Floats:
    """Sums (5,) over a block of the residual, of residual × each plane of `basis` (3, h, w), and of residual²."""
    sums = np.zeros(5)
    left, right = columns
    for r in range(rows[0], rows[1]):
        line, a, b, c = (
            residual[r, left:right],
            basis[0, r, left:right],
            basis[1, r, left:right],
            basis[2, r, left:right],
        )
        # Sums of one row in single precision: the compiler then takes twice as many pixels at once.
        zero = np.float32(0.0)
        level, template, x, y, square = zero, zero, zero, zero, zero
        for k in range(right - left):
            level += line[k]
            template += line[k] * a[k]
            x += line[k] * b[k]
            y += line[k] * c[k]
            square += line[k] * line[k]
        for k, total in enumerate((level, template, x, y, square)):
            sums[k] += total
    return sums


@njit(cache=True)
def block_sums(residual: Floats32, basis: Floats32) -> Floats:
    """Sums (16, 5) of `_block_sum` over 4 by 4 blocks of the window."""
    out = np.empty((BLOCKS * BLOCKS, 5))
    h, w = residual.shape
    for b in range(BLOCKS):
        for a in range(BLOCKS):
            rows = (b * h // BLOCKS, (b + 1) * h // BLOCKS)
            columns = (a * w // BLOCKS, (a + 1) * w // BLOCKS)
            out[b * BLOCKS + a] = _block_sum(residual, basis, rows, columns)
    return out


@njit(cache=True)
def scores(window: Floats32, grid: Floats32, basis: Floats32, shift: Floats) -> tuple[float, float, Floats]:
    """What is left of the frame's window when the shifted template is taken out.

    `window` (h, w) without its mean (overwritten by the residual), `grid` the template's spline coefficients, `basis`
    (3, h, w) the template and its gradients x and y, `shift` (2,) the peak x, y in px. Returns ZNCC, gain and the
    residual's `block_sums` (16, 5), in the template's unit.
    """
    quality, gain = _remove_template(window, translated(grid, shift[0], shift[1]))
    if gain == 0.0:
        return quality, gain, np.zeros((BLOCKS * BLOCKS, 5))
    return quality, gain, block_sums(window, basis)


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
    out = np.empty((2, 2))
    out[0, 0], out[0, 1] = observed[0, 0] * ratio_x, cross
    out[1, 0], out[1, 1] = cross, observed[1, 1] * ratio_y
    return out


@njit(cache=True)
def _solve(matrix: Floats, right: Floats) -> Floats:
    """Solve a positive definite system by elimination; `matrix` and `right` are overwritten."""
    n = right.shape[0]
    for k in range(n):
        pivot = matrix[k, k] if matrix[k, k] > 0.0 else 1e-300
        for i in range(k + 1, n):
            ratio = matrix[i, k] / pivot
            right[i] -= ratio * right[k]
            for j in range(k, n):
                matrix[i, j] -= ratio * matrix[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            right[k] -= matrix[k, j] * right[j]
        right[k] /= matrix[k, k] if matrix[k, k] > 0.0 else 1e-300
    return right


@njit(cache=True)
def jackknife(sums: Floats, moments: Floats) -> tuple[float, float]:
    """Variances x and y (px²) from how the shift changes when one block after the other is left out.

    `sums` (16, 5) from `scores`, `moments` (16, 4, 4) each block's products of 1, template, gradients x and y. Level
    and gain are fitted anew each time.
    """
    count = moments.shape[0]
    matrix, right = np.zeros((4, 4)), np.zeros(4)
    for b in range(count):
        matrix += moments[b]
        right += sums[b, :4]
    x, y = np.empty(count), np.empty(count)
    for b in range(count):
        fit = _solve(matrix - moments[b], right - sums[b, :4])
        x[b], y[b] = fit[2], fit[3]
    return (count - 1) * x.var(), (count - 1) * y.var()


@njit(cache=True)
def variances(sums: Floats, moments: Floats, information: Floats, noise: Floats) -> tuple[float, float]:
    """Variances x and y (px²) of the peak by linear theory.

    `sums` (16, 5) from `scores`, `moments` (16, 4, 4) see `jackknife`. `information` (2, 2, 2): the sum of g gᵀ over
    the filtered template, and the same of the gradients filtered once more. `noise` (4,): pixels in the window, and
    what white noise of variance 1 in the raw image adds to a filtered pixel's variance and to both of `information`.
    The residual holds the noise of frame and template alike, so both are counted. Where the residual is correlated
    (an object in front, a shadow, rotation), the jackknife over blocks replaces the white-noise theory.
    """
    white = sums[:, 4].sum() / (noise[0] - 4.0) / noise[1]
    bread = _inverse(_without_noise(information[0], 0.5 * white * noise[2]))
    meat = white * _without_noise(information[1], 0.5 * white * noise[3])
    model = bread @ meat @ bread
    x, y = jackknife(sums, moments)
    # Under white noise the scatter of 16 blocks exceeds three times its mean about once in 10 000 frames.
    return (x if x > 3.0 * model[0, 0] else model[0, 0]), (y if y > 3.0 * model[1, 1] else model[1, 1])
