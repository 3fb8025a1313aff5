"""The tables by which an undisturbed frame is fitted: what the sums over each block respond to, at one phase.

See `midspan.vision.undisturbed`. The tables of a phase are made when a frame first needs them.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats
from midspan.vision.bank import phase_slot
from midspan.vision.blocks import inverse_of
from midspan.vision.fine_spline import curvatures, planes
from midspan.vision.kernels import Integers, phase_shift
from midspan.vision.spline import Floats32

Bytes = NDArray[np.int8]
# Kernels are whole numbers of 8 bits, a quarter of the memory that they are read from in each frame. What they respond
# to is computed from these: their rounding only costs precision, less than a thousandth of it.
LARGEST = 127.0
SUMS = 3  # a block: with the slopes along x and y, and with the template
# What the sums are linear in: x, y, roll, zoom; gain, its ramps across and down, the level's ramps across and down.
UNKNOWNS, WANTED, GAIN = 9, 4, 4
# After a sum's response to each unknown and its weight in each: what it has of the second order of a shift (dx²/2,
# dx dy, dy²/2), and its row of the block's inverse covariance.
WEIGHT, SECOND, INVERSE, NUMBERS = UNKNOWNS, 2 * UNKNOWNS, 2 * UNKNOWNS + 3, 2 * UNKNOWNS + 6
RESPONSES = UNKNOWNS + 3 + SUMS
SPARSE = 5  # one row in so many is looked at first: nearly always that leads to the phase whose tables are exact
CHUNK = 3  # rows at once: their products stay in the nearest cache


class Undisturbed(NamedTuple):
    """The window's tables as compiled code takes them.

    kernels (slots, h, 3, w): row after row the three that the blocks' sums are taken with; rows (slots, 3 blocks, 24):
    for each sum what is listed above; normal (slots, 9, 4): the normal matrix (4, 4) of x, y, roll, zoom, and how much
    of each goes into the other unknowns; sparse (slots, 3, 3): see `_sparse`; phase_in (slots,): the phase that a slot
    holds, -1: none; down, across: edges of the blocks; origin: row and column of the window in the reference; centres
    (blocks, 2) from the window's middle, px; zero (4,): the pose that poses count from.
    """

    kernels: Bytes
    rows: Floats
    normal: Floats
    sparse: Floats
    phase_in: Integers
    down: Integers
    across: Integers
    origin: Integers
    centres: Floats
    zero: Floats


@njit(cache=True, fastmath=True)
def _dot(line: Floats32, other: Floats32) -> float:
    total = np.float32(0.0)
    for c in range(len(line)):
        total += line[c] * other[c]
    return float(total)


@njit(cache=True, fastmath=True)
def _added(line: Floats32, other: Floats32, out: Floats32) -> None:
    """Add to `out` (columns,) the products of two lines (columns,)."""
    for c in range(len(line)):
        out[c] += line[c] * other[c]


@njit(cache=True)
def _members(across: Integers) -> Floats32:
    """Which columns (w, blocks) lie in which block of a row of blocks: 1, else 0."""
    out = np.zeros((across[-1], len(across) - 1), dtype=np.float32)
    for i in range(len(across) - 1):
        out[across[i] : across[i + 1], i] = 1.0
    return out


@njit(cache=True)
def _spread_out(values: Floats32, across: Integers) -> Floats32:
    """Lines (n, columns) that hold in each block its own value (n, blocks)."""
    out = np.empty((len(values), across[-1]), dtype=np.float32)
    for k in range(len(values)):
        for i in range(len(across) - 1):
            out[k, across[i] : across[i + 1]] = values[k, i]
    return out


@njit(cache=True, fastmath=True)
def _instruments(smooth: Floats32, weight: Floats32, rows: tuple[int, int], across: Integers, kernels: Bytes) -> None:
    """Fill the `rows` from the first to before the last, a row of blocks, of `kernels` (h, 3, w) with low-passed slopes
    along x and y (both negative) and values, weighted, each without its block's mean, as whole numbers of 8 bits.

    `smooth` (3, h, w): values and slopes; `weight` (h, w): one over the noise variance.
    """
    # Lines are taken out of whole arrays: only of those the compiler knows that they have no gaps.
    (top, bottom), columns = rows, weight.shape[1]
    totals, ones = np.zeros((SUMS + 1, columns), dtype=np.float32), np.ones(columns, dtype=np.float32)
    for r in range(top, bottom):
        for k in range(SUMS):
            _added(weight[r], smooth[k, r], totals[k])
        _added(weight[r], ones, totals[SUMS])
    sums = totals @ _members(across)
    means = _spread_out(sums[:SUMS] / sums[SUMS], across)
    largest = np.zeros((SUMS, columns), dtype=np.float32)
    for r in range(top, bottom):
        for k in range(SUMS):
            own, most, mean, w = smooth[k, r], largest[k], means[k], weight[r]
            for c in range(columns):
                value = abs(w[c] * (own[c] - mean[c]))
                most[c] = value if value > most[c] else most[c]
    factors = np.empty((SUMS, len(across) - 1), dtype=np.float32)
    for k in range(SUMS):
        for i in range(len(across) - 1):
            most = largest[k, across[i] : across[i + 1]].max()
            factors[k, i] = (LARGEST if k == 0 else -LARGEST) / most if most > 0.0 else 0.0
    scale = _spread_out(factors, across)
    for r in range(top, bottom):
        for k in range(SUMS):
            own, mean, w, factor, into = smooth[k, r], means[k], weight[r], scale[k], kernels[r, (k + 2) % SUMS]
            for c in range(columns):
                into[c] = np.int8(np.rint(factor[c] * w[c] * (own[c] - mean[c])))


@njit(cache=True, fastmath=True)
def _model(
    planes: tuple[Floats32, Floats32], rows: tuple[int, int], places: tuple[Floats32, float], out: Floats32
) -> None:
    """Fill the first 12 rows of `out` (15, n) with how the pixels of some rows change with x, y, roll and zoom about
    their block's middle, gain, ramps of gain and of level about that, in px, and with the second order of a shift.

    `planes`: values and slopes, and curvatures (3, h, w), of the `rows` from the first to before the last; `places`: x
    (w,) of each column from its block's middle, and y of the first row, px.
    """
    moved, curved = planes
    x, width = places[0], np.uint64(moved.shape[2])
    for r in range(rows[0], rows[1]):
        y, at = np.float32(places[1] + r - rows[0]), np.uint64(r - rows[0]) * width
        for c in range(width):
            out[0, at + c], out[1, at + c] = -moved[1, r, c], -moved[2, r, c]
        for c in range(width):
            out[2, at + c] = y * moved[1, r, c] - x[c] * moved[2, r, c]
            out[3, at + c] = -x[c] * moved[1, r, c] - y * moved[2, r, c]
        for c in range(width):
            out[4, at + c], out[5, at + c] = moved[0, r, c], x[c] * moved[0, r, c]
            out[6, at + c] = y * moved[0, r, c]
        for c in range(width):
            out[7, at + c], out[8, at + c] = x[c], y
        for m in range(3):
            for c in range(width):
                out[UNKNOWNS + m, at + c] = curved[m, r, c]


@njit(cache=True, fastmath=True)
def _lines(kernels: Bytes, weight: Floats32, rows: tuple[int, int], out: Floats32, scaled: Floats32) -> None:
    """Fill `out` (3, n) with the kernels (h, 3, w) of the `rows` from the first to before the last, and the last three
    rows of `scaled` (15, n) with those over the `weight` (h, w).
    """
    width = np.uint64(weight.shape[1])
    for r in range(rows[0], rows[1]):
        at = np.uint64(r - rows[0]) * width
        for k in range(SUMS):
            for c in range(width):
                out[k, at + c] = np.float32(kernels[r, k, c])
            for c in range(width):
                scaled[UNKNOWNS + 3 + k, at + c] = np.float32(kernels[r, k, c]) / weight[r, c]


@njit(cache=True, fastmath=True)
def _accumulated(lines: Floats32, model: Floats32, size: int, out: Floats32) -> None:
    """Add to `out` (3 m, n) the products of the first so many columns of 3 `lines` with those of a `model` (m, n)."""
    count = np.uint64(size)
    for k in range(len(lines)):
        for m in range(len(model)):
            row = k * len(model) + m
            for n in range(count):
                out[row, n] += lines[k, n] * model[m, n]


@njit(cache=True, fastmath=True)
def _folded(lines: Floats32, width: int) -> Floats32:
    """Lines (n, width) that are the sums of the parts of so many columns of `lines` (n, m width)."""
    out, columns = np.zeros((len(lines), width), dtype=np.float32), np.uint64(width)
    for k in range(len(lines)):
        for first in range(np.uint64(0), np.uint64(lines.shape[1]), columns):
            for c in range(columns):
                out[k, c] += lines[k, first + c]
    return out


@njit(cache=True)
def _responses(
    planes: tuple[Floats32, Floats32], weight: Floats32, kernels: Bytes, box: tuple[int, int], across: Integers
) -> Floats32:
    """Responses (3, 15, blocks) of the sums of a row of blocks to what `_model` lists; the last three are the sums'
    covariance for noise of scale 1.

    `planes`: values and slopes, and curvatures (3, h, w); `weight` (h, w); `kernels` (h, 3, w); `box`: first row, row
    after the last.
    """
    (top, bottom), width = box, across[-1]
    response = np.zeros((SUMS * RESPONSES, CHUNK * width), dtype=np.float32)
    model = np.empty((RESPONSES, CHUNK * width), dtype=np.float32)
    lines, middles = np.empty((SUMS, CHUNK * width), dtype=np.float32), 0.5 * (across[:-1] + across[1:] - 1.0)
    x = np.arange(width).astype(np.float32)
    for i in range(len(middles)):
        x[across[i] : across[i + 1]] -= np.float32(middles[i])
    for row in range(top, bottom, CHUNK):
        rows = row, min(row + CHUNK, bottom)
        _model(planes, rows, (x, row - 0.5 * (top + bottom - 1)), model)
        _lines(kernels, weight, rows, lines, model)
        _accumulated(lines, model, (rows[1] - rows[0]) * width, response)
    return (_folded(response, width) @ _members(across)).reshape((SUMS, RESPONSES, len(across) - 1))


@njit(cache=True)
def _inverse_covariance(covariance: Floats, share: float) -> Floats:
    """Inverse covariance (3, 3) of a block's sums for noise of scale 1, times the share of them that is texture; zeros
    where there is none.
    """
    slopes = covariance[0, 0] * covariance[1, 1] - covariance[0, 1] ** 2
    if share <= 0.0 or slopes <= 1e-6 * covariance[0, 0] * covariance[1, 1]:
        return np.zeros((SUMS, SUMS))
    for k in range(SUMS):
        covariance[k, k] *= 1.0 + 1e-9
    return share * inverse_of(covariance)


@njit(cache=True)
def build_tables(
    grids: tuple[Floats32, Floats32], weight: Floats32, share: Floats, phase: int, tables: Undisturbed
) -> None:
    """Make the tables of a phase: from the fine coefficients (2 h + 7, 2 w + 7) of the template and of the low-passed
    one, the pixels' `weight` (h, w) and the `share` (blocks,) of each block that is texture.
    """
    x, y = phase_shift(phase)
    slot, across = phase_slot(phase, len(tables.phase_in)), tables.across
    moved, curved, smooth = planes(grids[0], x, y), curvatures(grids[0], x, y), planes(grids[1], x, y)
    kernels = tables.kernels[slot]
    for j in range(len(tables.down) - 1):
        box = tables.down[j], tables.down[j + 1]
        _instruments(smooth, weight, box, across, kernels)
        response = _responses((moved, curved), weight, kernels, box, across)
        for i in range(len(across) - 1):
            for k in range(SUMS):
                _take_row(tables, (slot, j * (len(across) - 1) + i, k), response[k, :, i])
    for b in range(len(share)):
        own = tables.rows[slot, SUMS * b : SUMS * (b + 1)]
        own[:, INVERSE:] = _inverse_covariance(own[:, INVERSE:].copy(), share[b])
    _weigh(tables.rows[slot], tables.normal[slot])
    tables.sparse[slot] = _sparse(moved, kernels)
    tables.phase_in[slot] = phase


@njit(cache=True)
def _sparse(moved: Floats32, kernels: Bytes) -> Floats:
    """What turns the sums over one row in `SPARSE` into x and y times the gain, and the gain (3, 3); zeros if nothing.

    `moved` (3, h, w): values and slopes; `kernels` (h, 3, w).
    """
    response, line = np.zeros((SUMS, SUMS)), np.empty(kernels.shape[2], dtype=np.float32)
    for r in range(SPARSE // 2, len(kernels), SPARSE):
        for k in range(SUMS):
            line[:] = kernels[r, k]
            for m in range(SUMS):
                part = _dot(line, moved[(m + 1) % SUMS, r])
                response[k, m] += part if m == 2 else -part
    # An instrument's response to what it is made of is positive: elimination needs no pivots.
    out = inverse_of(response) if np.linalg.det(response) > 0.0 else np.zeros((SUMS, SUMS))
    return out if np.isfinite(out).all() else np.zeros((SUMS, SUMS))


@njit(cache=True)
def _take_row(tables: Undisturbed, at: tuple[int, int, int], seen: Floats32) -> None:
    """Fill in what one sum of a block responds to, `at` being its slot, block and number: `seen` (15,) is about the
    block's middle, which moves as the window turns and grows and lies somewhere on the ramps.
    """
    slot, block, k = at
    x, y = tables.centres[block, 0], tables.centres[block, 1]
    row = tables.rows[slot, SUMS * block + k]
    row[:UNKNOWNS] = seen[:UNKNOWNS]
    row[2] += x * seen[1] - y * seen[0]
    row[3] += x * seen[0] + y * seen[1]
    row[5] += x * seen[4]
    row[6] += y * seen[4]
    # Ramps are 1 across the window, not 1 a pixel.
    row[5:UNKNOWNS:2] /= tables.across[-1]
    row[6:UNKNOWNS:2] /= tables.down[-1]
    row[SECOND:] = seen[UNKNOWNS:]


@njit(cache=True)
def _weigh(rows: Floats, normal: Floats) -> None:
    """Fill in the weights by which the sums (3 blocks, 24) give the unknowns, and their `normal` (9, 4).

    x, y, roll and zoom come from their score, the sums times these weights, through the normal matrix; the others from
    the sums times theirs, less what x, y, roll and zoom put there.
    """
    count = len(rows)
    response = rows[:, :UNKNOWNS].copy()
    weighted = np.zeros((count, UNKNOWNS))
    for n in range(count):
        first = n - n % SUMS
        for k in range(SUMS):
            weighted[n] += rows[n, INVERSE + k] * response[first + k]
    whole = response.T @ weighted
    for k in range(UNKNOWNS):
        whole[k, k] = whole[k, k] * (1.0 + 1e-9) + 1e-300
    others = inverse_of(np.ascontiguousarray(whole[WANTED:, WANTED:]))
    share = others @ np.ascontiguousarray(whole[WANTED:, :WANTED])
    normal[:WANTED] = whole[:WANTED, :WANTED] - np.ascontiguousarray(whole[:WANTED, WANTED:]) @ share
    normal[WANTED:] = share
    rest = np.ascontiguousarray(weighted[:, WANTED:])
    rows[:, WEIGHT : WEIGHT + WANTED] = weighted[:, :WANTED] - rest @ share
    rows[:, WEIGHT + WANTED : SECOND] = rest @ others
