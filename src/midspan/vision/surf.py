"""SURF: blobs by box filters on an integral image, and their descriptors of 64 values.

Bay, Tuytelaars and Van Gool, "SURF: speeded up robust features", 2006, doi 10.1007/11744023_32. Derivatives of a
Gaussian are replaced by boxes of sizes 9, 15, 21, 27 … px, a filter of size L standing for the scale 1.2 L / 9 px.
A blob is a maximum of the Hessian's determinant over position and scale, refined by a quadratic in all three.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats
from midspan.vision.spline import Floats32

LAYERS = 4  # filters in an octave; a blob is found in one of the two in the middle
SCALE_OF_SIZE = 1.2 / 9.0
CROSS_WEIGHT = 0.81  # balances the box form of the mixed derivative, 0.9 squared
VALUES = 64
SECTORS = 72  # directions that the responses are sorted into
LARGEST_STEP = 1.0  # a quadratic's peak farther from the largest sample than this is not trusted, in samples
_HALFWAY = np.array([3.0, -25.0, 150.0, 150.0, -25.0, 3.0], dtype=np.float32) / np.float32(256.0)


@dataclass(frozen=True, slots=True)
class SurfSettings:
    """Which blobs are kept.

    octaves: doublings of the filters' size, 1 to 4. threshold: least determinant, in the image's variance or in
    `contrast` where that is less; lower gives more and weaker blobs. most: the strongest so many are kept. upright:
    without orientation, for a camera that rolls less than some 15 degrees; quicker and more distinctive.
    """

    octaves: int = 3
    threshold: float = 0.002
    most: int = 400
    upright: bool = True
    contrast: float = math.inf


@dataclass(frozen=True, slots=True)
class Blobs:
    """Blobs (n,) of an image, strongest first: position x, y and scale in px, and the determinant there.

    `bright` is 1 for a dark blob on bright ground and -1 for the reverse; `descriptor` (n, 64) has unit length.
    """

    x: Floats
    y: Floats
    scale: Floats
    strength: Floats
    bright: NDArray[np.int8]
    descriptor: Floats32


@njit(cache=True)
def integral_image(image: Floats32) -> Floats:
    """Sums (rows + 1, columns + 1) of all pixels above and left: entry (r, c) is the sum of image[:r, :c]."""
    rows, columns = image.shape
    total = np.zeros((rows + 1, columns + 1))
    for r in range(rows):
        line = 0.0
        for c in range(columns):
            line += float(image[r, c])
            total[r + 1, c + 1] = total[r, c + 1] + line
    return total


@njit(cache=True, fastmath=True)
def doubled(image: Floats32) -> Floats32:
    """The image (2 rows - 1, 2 columns - 1) sampled every half pixel, by six-point interpolation, mirrored at edges."""
    rows, columns = image.shape
    tall = np.empty((2 * rows - 1, columns), dtype=np.float32)
    for r in range(rows):
        tall[2 * r] = image[r]
        if r + 1 < rows:
            tall[2 * r + 1] = np.float32(0.0)
            for k in range(6):
                line = image[_mirrored(r - 2 + k, rows)]
                for c in range(columns):
                    tall[2 * r + 1, c] += _HALFWAY[k] * line[c]
    out = np.empty((2 * rows - 1, 2 * columns - 1), dtype=np.float32)
    for r in range(2 * rows - 1):
        line = tall[r]
        for c in range(columns):
            out[r, 2 * c] = line[c]
        for c in range(columns - 1):
            value = np.float32(0.0)
            if 2 <= c < columns - 3:
                for k in range(6):
                    value += _HALFWAY[k] * line[c - 2 + k]
            else:
                for k in range(6):
                    value += _HALFWAY[k] * line[_mirrored(c - 2 + k, columns)]
            out[r, 2 * c + 1] = value
    return out


@njit(cache=True)
def _mirrored(index: int, size: int) -> int:
    if size == 1:
        return 0
    period = 2 * (size - 1)
    index = index % period
    return index if index < size else period - index


@njit(cache=True, fastmath=True)
def hessian(integral: Floats, size: int, step: int) -> tuple[Floats32, Floats32]:
    """Determinant and trace of the Hessian by boxes of `size` px (9, 15, …), at every `step`-th pixel.

    Each is divided by the box's area. Arrays (ceil(rows / step), ceil(columns / step)); 0 where a box leaves the image.
    """
    rows, columns = integral.shape[0] - 1, integral.shape[1] - 1
    determinant = np.zeros(((rows + step - 1) // step, (columns + step - 1) // step), dtype=np.float32)
    trace = np.zeros_like(determinant)
    lobe, half = size // 3, size // 2
    third = lobe // 2
    area = 1.0 / (size * size)
    first = (half + step - 1) // step
    last = (columns - 1 - half) // step if columns > half else -1
    count = last - first + 1
    if count <= 0:
        return determinant, trace
    # Each line is worked on in contiguous parts, all columns at once, and every `step`-th of them is kept.
    begin, width = first * step, step * (count - 1) + 1
    across, along, mixed = np.empty(columns + 1), np.empty(columns + 1), np.empty(columns + 1)
    of_determinant, of_trace = np.empty(width), np.empty(width)
    for i in range(first, determinant.shape[0]):
        r = i * step
        if r + half >= rows:
            break
        lobe_top, lobe_bottom = integral[r - lobe + 1], integral[r + lobe]
        top, third_top = integral[r - half], integral[r - third]
        bottom, third_bottom = integral[r + half + 1], integral[r + third + 1]
        above, here, below, far_below = integral[r - lobe], integral[r], integral[r + 1], integral[r + lobe + 1]
        for c in range(columns + 1):
            across[c] = lobe_bottom[c] - lobe_top[c]
            along[c] = bottom[c] - top[c] - 3.0 * (third_bottom[c] - third_top[c])
            mixed[c] = here[c] - above[c] - (far_below[c] - below[c])
        outer_right, outer_left = _part(across, begin + half + 1, width), _part(across, begin - half, width)
        inner_right, inner_left = _part(across, begin + third + 1, width), _part(across, begin - third, width)
        right, left = _part(along, begin + lobe, width), _part(along, begin - lobe + 1, width)
        far_right, near_right = _part(mixed, begin + lobe + 1, width), _part(mixed, begin + 1, width)
        near_left, far_left = _part(mixed, begin, width), _part(mixed, begin - lobe, width)
        for j in range(width):
            xx = outer_right[j] - outer_left[j] - 3.0 * (inner_right[j] - inner_left[j])
            yy = right[j] - left[j]
            xy = far_right[j] - near_right[j] - near_left[j] + far_left[j]
            of_determinant[j] = (xx * yy - CROSS_WEIGHT * xy * xy) * area * area
            of_trace[j] = (xx + yy) * area
        determinant[i, first : first + count] = of_determinant[::step]
        trace[i, first : first + count] = of_trace[::step]
    return determinant, trace


@njit(cache=True)
def _part(line: Floats, begin: int, width: int) -> Floats:
    return line[begin : begin + width]


@njit(cache=True)
def _is_peak(stack: Floats32, k: int, r: int, c: int) -> bool:
    """Whether no neighbour in scale and position exceeds this sample (of equal ones the first in memory is taken)."""
    value = stack[k, r, c]
    for dk in range(-1, 2):
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                other = stack[k + dk, r + dr, c + dc]
                before = dk < 0 or (dk == 0 and (dr < 0 or (dr == 0 and dc < 0)))
                if other > value or (before and other == value):
                    return False
    return True


@njit(cache=True)
def _refine(stack: Floats32, k: int, r: int, c: int) -> Floats:
    """Offsets (3,) in samples along scale, rows and columns of the quadratic's peak; NaN where it has none nearby."""
    s = stack[k - 1 : k + 2, r - 1 : r + 2, c - 1 : c + 2].astype(np.float64)
    m = s[1, 1, 1]
    g = np.array([s[2, 1, 1] - s[0, 1, 1], s[1, 2, 1] - s[1, 0, 1], s[1, 1, 2] - s[1, 1, 0]]) * 0.5
    a = s[2, 1, 1] + s[0, 1, 1] - 2.0 * m
    b = s[1, 2, 1] + s[1, 0, 1] - 2.0 * m
    d = s[1, 1, 2] + s[1, 1, 0] - 2.0 * m
    ab = 0.25 * (s[2, 2, 1] - s[2, 0, 1] - s[0, 2, 1] + s[0, 0, 1])
    ad = 0.25 * (s[2, 1, 2] - s[2, 1, 0] - s[0, 1, 2] + s[0, 1, 0])
    bd = 0.25 * (s[1, 2, 2] - s[1, 2, 0] - s[1, 0, 2] + s[1, 0, 0])
    minor = np.array([b * d - bd * bd, ad * bd - ab * d, ab * bd - ad * b])
    determinant = a * minor[0] + ab * minor[1] + ad * minor[2]
    out = np.full(3, np.nan)
    if determinant >= 0.0:  # a maximum in three dimensions has three negative curvatures
        return out
    out[0] = -(minor[0] * g[0] + minor[1] * g[1] + minor[2] * g[2]) / determinant
    out[1] = -(minor[1] * g[0] + (a * d - ad * ad) * g[1] + (ab * ad - a * bd) * g[2]) / determinant
    out[2] = -(minor[2] * g[0] + (ab * ad - a * bd) * g[1] + (a * b - ab * ab) * g[2]) / determinant
    if not np.abs(out).max() <= LARGEST_STEP:
        out[:] = np.nan
    return out


@njit(cache=True)
def _peaks(stack: Floats32, trace: Floats32, sizes: NDArray[np.int64], step: int, threshold: float) -> Floats:
    """Blobs (n, 5) of an octave: x, y in px, filter size, determinant and sign of the trace."""
    found = np.empty((stack.shape[1] * stack.shape[2] // 4 + 1, 5))
    n = 0
    for k in range(1, stack.shape[0] - 1):
        rim = (sizes[k + 1] // 2 + step - 1) // step + 1
        for r in range(rim, stack.shape[1] - rim):
            line = stack[k, r]
            for c in range(rim, stack.shape[2] - rim):
                value = line[c]
                if value <= threshold or value < line[c + 1] or value < line[c - 1]:
                    continue  # most samples end here
                if not _is_peak(stack, k, r, c):
                    continue
                offset = _refine(stack, k, r, c)
                if np.isnan(offset[0]) or n == found.shape[0]:
                    continue
                found[n, 0] = (c + offset[2]) * step
                found[n, 1] = (r + offset[1]) * step
                found[n, 2] = sizes[k] + offset[0] * (sizes[k + 1] - sizes[k])
                found[n, 3] = value
                found[n, 4] = 1.0 if trace[k, r, c] >= 0.0 else -1.0
                n += 1
    return found[:n]


def filter_sizes(octave: int) -> NDArray[np.int64]:
    """Box sizes (4,) in px of the octave 0, 1, …: 9, 15, 21, 27; 15, 27, 39, 51; 27, 51, 75, 99; …"""
    return np.asarray(3 * (2 ** (octave + 1) * np.arange(1, LAYERS + 1) + 1), dtype=np.int64)


def find_blobs(integral: Floats, settings: SurfSettings, variance: float) -> Floats:
    """Blobs (n, 5) strongest first: x, y (px), filter size (px), determinant, sign of the trace.

    `integral` (rows + 1, columns + 1) from `integral_image`; `variance` scales the threshold.
    """
    found = []
    for octave in range(settings.octaves):
        sizes, step = filter_sizes(octave), 2**octave
        if int(sizes[-1]) + 2 * step > min(integral.shape) - 1:
            break
        layers = [hessian(integral, int(size), step) for size in sizes]
        stack, trace = np.stack([d for d, _ in layers]), np.stack([t for _, t in layers])
        found.append(_peaks(stack, trace, sizes, step, settings.threshold * variance))
    if not found:
        return np.empty((0, 5))
    every = np.concatenate(found)
    return np.asarray(every[np.argsort(-every[:, 3], kind="stable")[: settings.most]])


@njit(cache=True)
def haar(integral: Floats, x: float, y: float, reach: int) -> tuple[float, float]:
    """Haar wavelets along x and y about the pixel nearest to (x, y): right less left half, lower less upper half.

    Each is a square of 2 `reach` px; what lies outside the image is left out.
    """
    rows, columns = integral.shape[0] - 1, integral.shape[1] - 1
    c, r = round(x), round(y)
    left, right = min(max(c - reach, 0), columns), min(max(c + reach, 0), columns)
    top, bottom = min(max(r - reach, 0), rows), min(max(r + reach, 0), rows)
    c, r = min(max(c, 0), columns), min(max(r, 0), rows)
    top_left, top_right = integral[top, left], integral[top, right]
    bottom_left, bottom_right = integral[bottom, left], integral[bottom, right]
    across = bottom_right - top_right + bottom_left - top_left - 2.0 * (integral[bottom, c] - integral[top, c])
    down = bottom_right - bottom_left + top_right - top_left - 2.0 * (integral[r, right] - integral[r, left])
    return across, down


@njit(cache=True)
def orientation(integral: Floats, x: float, y: float, scale: float) -> float:
    """Direction (radian, x towards y) of the largest sum of Haar responses in a sector of 60 degrees, within 6 s."""
    reach = max(round(2.0 * scale), 1)
    sums = np.zeros((SECTORS, 2))
    for i in range(-5, 6):
        for j in range(-5, 6):
            if i * i + j * j < 36:
                weight = np.exp(-(i * i + j * j) / 12.5)
                dx, dy = haar(integral, x + j * scale, y + i * scale, reach)
                sector = int((np.arctan2(dy, dx) + np.pi) * (SECTORS / (2.0 * np.pi))) % SECTORS
                sums[sector, 0] += weight * dx
                sums[sector, 1] += weight * dy
    best, direction = -1.0, 0.0
    for start in range(SECTORS):
        sx, sy = 0.0, 0.0
        for k in range(start, start + SECTORS // 6):
            sx += sums[k % SECTORS, 0]
            sy += sums[k % SECTORS, 1]
        if sx * sx + sy * sy > best:
            best = sx * sx + sy * sy
            direction = np.arctan2(sy, sx)
    return float(direction)


@njit(cache=True)
def _describe(integral: Floats, blob: Floats, window: Floats, out: Floats32) -> None:
    """Sums of dx, dy, |dx|, |dy| over 4 by 4 fields of 5 by 5 Haar responses, in the blob's frame."""
    scale = blob[2] * SCALE_OF_SIZE
    reach = max(round(scale), 1)
    angle = orientation(integral, blob[0], blob[1], scale)
    cos, sin = math.cos(angle), math.sin(angle)
    for i in range(20):
        v = i - 9.5
        for j in range(20):
            u = j - 9.5
            x, y = blob[0] + scale * (cos * u - sin * v), blob[1] + scale * (sin * u + cos * v)
            hx, hy = haar(integral, x, y, reach)
            weight = window[i] * window[j]
            du, dv = weight * (cos * hx + sin * hy), weight * (cos * hy - sin * hx)
            place = 4 * (4 * (i // 5) + j // 5)
            out[place] += du
            out[place + 1] += dv
            out[place + 2] += abs(du)
            out[place + 3] += abs(dv)


@njit(cache=True)
def _describe_upright(integral: Floats, blob: Floats, window: Floats, out: Floats32) -> None:
    """The same sums without orientation: all wavelets lie on 20 rows and 20 columns, which are looked up once."""
    rows, columns = integral.shape[0] - 1, integral.shape[1] - 1
    scale = blob[2] * SCALE_OF_SIZE
    reach = max(round(scale), 1)
    left, centre, right = np.empty(20, np.int64), np.empty(20, np.int64), np.empty(20, np.int64)
    for j in range(20):
        c = round(blob[0] + scale * (j - 9.5))
        left[j], right[j] = min(max(c - reach, 0), columns), min(max(c + reach, 0), columns)
        centre[j] = min(max(c, 0), columns)
    for i in range(20):
        r = round(blob[1] + scale * (i - 9.5))
        top, bottom = integral[min(max(r - reach, 0), rows)], integral[min(max(r + reach, 0), rows)]
        middle = integral[min(max(r, 0), rows)]
        for j in range(20):
            at_left, at_centre, at_right = left[j], centre[j], right[j]
            sides = bottom[at_right] + bottom[at_left] - top[at_right] - top[at_left]
            dx = sides - 2.0 * (bottom[at_centre] - top[at_centre])
            all_below = bottom[at_right] - bottom[at_left] + top[at_right] - top[at_left]
            dy = all_below - 2.0 * (middle[at_right] - middle[at_left])
            weight = window[i] * window[j]
            du, dv = weight * dx, weight * dy
            place = 4 * (4 * (i // 5) + j // 5)
            out[place] += du
            out[place + 1] += dv
            out[place + 2] += abs(du)
            out[place + 3] += abs(dv)


@njit(cache=True)
def _to_unit_length(out: Floats32) -> None:
    norm = 0.0
    for value in out:
        norm += float(value) * float(value)
    if norm > 0.0:
        out *= np.float32(1.0 / math.sqrt(norm))


@njit(cache=True)
def describe(integral: Floats, blobs: Floats, upright: bool) -> Floats32:
    """Descriptors (n, 64) of unit length of the blobs (n, 5) found by `find_blobs`."""
    out = np.zeros((blobs.shape[0], VALUES), dtype=np.float32)
    window = np.exp(-((np.arange(20) - 9.5) ** 2) / (2.0 * 3.3 * 3.3))
    for k in range(blobs.shape[0]):
        if upright:
            _describe_upright(integral, blobs[k], window, out[k])
        else:
            _describe(integral, blobs[k], window, out[k])
        _to_unit_length(out[k])
    return out


def detect_surf(image: Floats32, settings: SurfSettings) -> Blobs:
    """The blobs of `image` (rows, columns), float32, with their descriptors."""
    # What lies outside the image counts as its mean, so that the level does not enter the descriptors at its edge.
    integral = integral_image(image - image.mean(dtype=np.float64).astype(np.float32))
    blobs = find_blobs(integral, settings, min(float(np.var(image)), settings.contrast))
    return Blobs(
        x=blobs[:, 0],
        y=blobs[:, 1],
        scale=blobs[:, 2] * SCALE_OF_SIZE,
        strength=blobs[:, 3],
        bright=blobs[:, 4].astype(np.int8),
        descriptor=describe(integral, blobs, settings.upright),
    )
