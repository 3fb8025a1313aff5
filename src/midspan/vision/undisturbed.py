"""A frame that shows the target undisturbed: one pose of the whole window, and the test that its blocks agree with it.

Three sums over the pixels of each block of the window - with the template's slopes along x and y and with the template,
all low-passed, at the nearest phase - are all that is taken from a frame. What they must be is linear in translation,
roll, zoom, gain and the ramps of gain and level across the window; generalised least squares over all blocks gives
those. A block's level drops out of its sums. Kernels that leave each block a gain and ramps of its own (see
`midspan.vision.kernels`) lose 4 % of the precision to them in 25 blocks, and more in smaller ones; here they cost 1 %.
What disturbs a part of the target shows in the rest of its blocks: a frame in which one of them, or all together, have
more of it than noise makes is no such frame, and the blocks are asked one by one (see `midspan.vision.climb`).
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats, Region
from midspan.vision.bank import (
    Plane,
    cropped,
    division_edges,
    held_phases,
    lowpassed,
    phase_slot,
    texture_share,
)
from midspan.vision.blocks import inverse_of, product
from midspan.vision.climb import LARGEST_GAIN, LEAST_GAIN, NEAR_PX, OWN_WEIGHT, Pose
from midspan.vision.kernels import PHASES, Integers
from midspan.vision.learning import PAD_PX, KeptSamples
from midspan.vision.spline import Floats32
from midspan.vision.window_tables import (
    GAIN,
    INVERSE,
    NUMBERS,
    SECOND,
    SPARSE,
    SUMS,
    UNKNOWNS,
    WANTED,
    WEIGHT,
    Bytes,
    Undisturbed,
    build_tables,
)

# Blocks along each axis, and the least size in px for which there are fewer of them: the unknowns of the whole window
# are told apart by many blocks, not by large ones.
DIVISION = (5, 8)
WORST_SQUARE = 30.0  # three normal components reach this sum of squares in one of 25 blocks once in 30 000 frames
MAX_NOISE = 1.5  # times the usual: 66 degrees of freedom about 1.1 of the usual exceed it once in 50 000 frames
MAX_TURN_PX = 0.03  # by roll and zoom at the window's corners: blocks that lie further apart need phases of their own
FAR_PX = 0.25  # a longer step is only roughly known
MAX_TURNS = 6
MIN_BLOCKS = 4
# What roll, zoom, gain and ramps may cost the translation's deviation. They cost 1 to 13 % where texture fills the
# window, and the double where it is one row or column of blocks (a cable before the sky), which also draws it aside.
MAX_COST = 1.2
FITTED, UNLIKE = -1, -2


class Known(NamedTuple):
    """What is known before a frame: the usual noise of a pixel, 0 while no frame has shown it; the noise to be expected
    then; and the covariance (4, 4) of the zero.
    """

    usual: float
    at_first: float
    zero: Floats


class UndisturbedWindow:
    """A template's tables, made phase by phase as frames need them."""

    def __init__(self, plane: Plane, window: Region, smoothing_px: float) -> None:
        size = (window.height, window.width)
        both = plane.grid, lowpassed(plane.grid, smoothing_px)
        self._grids = cropped(both[0], plane.origin, size), cropped(both[1], plane.origin, size)
        self._weight = plane.weight
        down, across = division_edges(window.height, DIVISION), division_edges(window.width, DIVISION)
        x, y = np.meshgrid(
            0.5 * (across[1:] + across[:-1] - window.width), 0.5 * (down[1:] + down[:-1] - window.height)
        )
        held = held_phases(window)
        self._share = texture_share(plane, self._grids[1], smoothing_px, (down, across))
        self._half_px = 0.5 * float(np.hypot(*size))
        self.tables = Undisturbed(
            kernels=np.empty((held, window.height, SUMS, window.width), dtype=np.int8),
            rows=np.zeros((held, SUMS * x.size, NUMBERS)),
            normal=np.zeros((held, UNKNOWNS, WANTED)),
            sparse=np.zeros((held, SUMS, SUMS)),
            phase_in=np.full(held, -1, dtype=np.int64),
            down=down,
            across=across,
            origin=np.array([window.y, window.x], dtype=np.int64),
            centres=np.column_stack([x.ravel(), y.ravel()]),
            zero=np.zeros(4),
        )

    @property
    def covariance(self) -> Floats:
        """Covariance (2, 2) of x and y for noise of variance 1, px²."""
        return np.asarray(np.linalg.inv(self.tables.normal[self._middle(), :WANTED])[:2, :2])

    @cached_property
    def told_apart(self) -> bool:
        """Whether the texture tells translation from roll, zoom, gain and ramps, see `MAX_COST`."""
        rows = self.tables.rows[self._middle()].reshape(-1, SUMS, NUMBERS)
        response, weights = rows[:, :, :UNKNOWNS], rows[:, :, INVERSE : INVERSE + SUMS]
        information = np.einsum("bku,bkm,bmv->uv", response, weights, response)
        if np.linalg.matrix_rank(information) < UNKNOWNS:
            return False
        joint, alone = (np.diag(np.linalg.inv(one)) for one in (information, information[:2, :2]))
        return bool(np.all(joint[:2] < MAX_COST**2 * alone))

    def _middle(self) -> int:
        """The slot of the phase in which nothing has moved."""
        return self._with_phase(PHASES * (PHASES // 2) + PHASES // 2)

    def fit(
        self,
        image: NDArray[np.generic],
        offset: float,
        begin: Floats,
        known: Known,
        *,
        origin: tuple[int, int] | None = None,
    ) -> Pose | None:
        """The pose in `image`, of which `offset` is subtracted, looked for around `begin` (4,).

        origin: row and column of the window in an image that is cut out of a frame. None where the frame is disturbed,
        turned or enlarged, or leaves no whole window.
        """
        if self._half_px * (abs(begin[2]) + abs(begin[3])) > MAX_TURN_PX or not self.told_apart:
            return None
        tables = self.tables if origin is None else self.tables._replace(origin=np.array(origin, dtype=np.int64))
        needed, value, covariance, noise = fit_window(image, offset, tables, begin, known, (0, True))
        while needed >= 0:
            self._with_phase(needed)
            # From where it was: phases that share a slot would take turns for ever.
            turn, rough = int(value[2]), bool(value[3])
            needed, value, covariance, noise = fit_window(image, offset, tables, value, known, (turn, rough))
        return Pose(True, value, covariance, 1.0, noise) if needed == FITTED else None

    def count_from(self, zero: Floats) -> None:
        """Count poses from this one (4,) of the template."""
        self.tables = self.tables._replace(zero=zero)

    def moved(self, samples: KeptSamples) -> Floats | None:
        """How much farther (4,) the samples lie in the template than they were put, in the mean; None: in none."""
        total, count, known = np.zeros(4), 0, Known(0.0, np.inf, np.zeros((4, 4)))
        for item in samples.items:
            found = self.fit(item.pixels, 0.0, np.array([*item.shift, 0.0, 0.0]), known, origin=(PAD_PX, PAD_PX))
            if found is not None:
                total[:2] += item.count * (found.value[:2] - item.shift)
                count += item.count
        return total / count if count else None

    def _with_phase(self, phase: int) -> int:
        """The slot that holds the tables of a phase, made where they are not there."""
        tables = self.tables
        slot = phase_slot(phase, len(tables.phase_in))
        if tables.phase_in[slot] != phase:
            build_tables(self._grids, self._weight, self._share, phase, tables)
        return slot


@njit(cache=True, fastmath=True)
def _products(
    image: NDArray[np.generic],
    level: float,
    kernels: Bytes,
    at: tuple[int, int],
    rows: tuple[int, int, int],
    out: tuple[Floats32, Floats32, Floats32],
) -> None:
    """Fill `out`, (w,) each, with the products of three `kernels` (h, 3, w) with the pixels of an image less a level,
    summed over rows.

    `at`: row and column of the image where the window begins; `rows` of the window: the first, that after the last, and
    the step from one to the next.
    """
    (top, left), width, less = at, kernels.shape[2], np.float32(level)
    a, b, c = out
    for n in range(width):
        a[n], b[n], c[n] = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for r in range(rows[0], rows[1], rows[2]):
        line, k0, k1, k2 = image[top + r, left : left + width], kernels[r, 0], kernels[r, 1], kernels[r, 2]
        # A loop for each: with more in one the compiler no longer takes several pixels at once.
        for n in range(width):
            a[n] += np.float32(k0[n]) * (np.float32(line[n]) - less)
        for n in range(width):
            b[n] += np.float32(k1[n]) * (np.float32(line[n]) - less)
        for n in range(width):
            c[n] += np.float32(k2[n]) * (np.float32(line[n]) - less)


@njit(cache=True)
def _lines_for(width: int) -> tuple[Floats32, Floats32, Floats32]:
    return np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)


@njit(cache=True, fastmath=True)
def _summed(line: Floats32, edges: Integers, out: Floats, first: int) -> None:
    """Put the sums of a `line` (n,) between the `edges` into every third place of `out` from the `first` on."""
    for i in range(len(edges) - 1):
        total = np.float32(0.0)
        # Indices without a sign need no look whether they count from the end.
        for c in range(np.uint64(edges[i]), np.uint64(edges[i + 1])):
            total += line[c]
        out[first + SUMS * i] = total


@njit(cache=True)
def _block_sums(image: NDArray[np.generic], level: float, tables: Undisturbed, at: tuple[int, int, int]) -> Floats:
    """The sums (3 blocks,); `at`: row and column of the image where the window begins, and the slot."""
    top, left, slot = at
    down, across = tables.down, tables.across
    out, columns, lines = np.empty(SUMS * len(tables.centres)), len(across) - 1, _lines_for(across[-1])
    for j in range(len(down) - 1):
        _products(image, level, tables.kernels[slot], (top, left), (down[j], down[j + 1], 1), lines)
        first = SUMS * j * columns
        _summed(lines[0], across, out, first)
        _summed(lines[1], across, out, first + 1)
        _summed(lines[2], across, out, first + 2)
    return out


@njit(cache=True)
def _sparse_shift(
    image: NDArray[np.generic], level: float, tables: Undisturbed, at: tuple[int, int, int]
) -> tuple[float, float]:
    """Shift x, y in px, roughly, from one row in `SPARSE`; zeros where they show nothing."""
    top, left, slot = at
    lines, whole, sums = _lines_for(tables.across[-1]), tables.across[:: len(tables.across) - 1], np.empty(SUMS)
    _products(image, level, tables.kernels[slot], (top, left), (SPARSE // 2, int(tables.down[-1]), SPARSE), lines)
    _summed(lines[0], whole, sums, 0)
    _summed(lines[1], whole, sums, 1)
    _summed(lines[2], whole, sums, 2)
    found = product(tables.sparse[slot], sums)
    if not found[2] > LEAST_GAIN:
        return 0.0, 0.0
    return found[0] / found[2], found[1] / found[2]


@njit(cache=True, fastmath=True)
def _weighed(rows: Floats, normal: Floats, sums: Floats) -> tuple[Floats, Floats]:
    """Score (4,) of x, y, roll and zoom, and all unknowns (9,), of which those four are times the gain."""
    both = np.zeros(UNKNOWNS)
    for n in range(len(sums)):
        for k in range(UNKNOWNS):
            both[k] += rows[n, WEIGHT + k] * sums[n]
    found = both.copy()
    found[:WANTED] = product(inverse_of(normal[:WANTED]), both[:WANTED])
    for k in range(WANTED, UNKNOWNS):
        for m in range(WANTED):
            found[k] -= normal[k, m] * found[m]
    return both[:WANTED], found


@njit(cache=True, fastmath=True)
def _first_order(rows: Floats, sums: Floats, found: Floats, centres: Floats) -> Floats:
    """The sums less what the second order of each block's shift puts there."""
    gain, out = found[GAIN], np.empty(len(sums))
    for b in range(len(centres)):
        x = (found[0] - centres[b, 1] * found[2] + centres[b, 0] * found[3]) / gain
        y = (found[1] + centres[b, 0] * found[2] + centres[b, 1] * found[3]) / gain
        xx, xy, yy = 0.5 * gain * x * x, gain * x * y, 0.5 * gain * y * y
        for n in range(SUMS * b, SUMS * b + SUMS):
            second = rows[n, SECOND:INVERSE]
            out[n] = sums[n] - second[0] * xx - second[1] * xy - second[2] * yy
    return out


@njit(cache=True, fastmath=True)
def _rest(rows: Floats, sums: Floats, found: Floats) -> tuple[float, float, int]:
    """Sum of the squared distances of all blocks from what was found, the largest of one, how many blocks count."""
    total, worst, count = 0.0, 0.0, 0
    rest = np.empty(SUMS)
    for b in range(len(rows) // SUMS):
        for k in range(SUMS):
            row = rows[SUMS * b + k]
            rest[k] = sums[SUMS * b + k]
            for u in range(UNKNOWNS):
                rest[k] -= row[u] * found[u]
        square = 0.0
        for k in range(SUMS):
            row = rows[SUMS * b + k]
            for m in range(SUMS):
                square += rest[k] * row[INVERSE + m] * rest[m]
        total, worst = total + square, max(worst, square)
        count += rows[SUMS * b, INVERSE] > 0.0
    return total, worst, count


@njit(cache=True)
def _phase_at(x: float, y: float) -> tuple[int, int, int, float, float]:
    """Whole pixels down and across, number of the nearest phase, and both together x, y, px; see `quantised`."""
    across, down = int(np.floor(x * PHASES + 0.5)), int(np.floor(y * PHASES + 0.5))
    left, top = (across + PHASES // 2) // PHASES, (down + PHASES // 2) // PHASES
    phase = (across - left * PHASES + PHASES // 2) * PHASES + down - top * PHASES + PHASES // 2
    return top, left, phase, across / PHASES, down / PHASES


@njit(cache=True)
def fit_window(
    image: NDArray[np.generic],
    level: float,
    tables: Undisturbed,
    begin: Floats,
    known: Known,
    so_far: tuple[int, bool],
) -> tuple[int, Floats, Floats, float]:
    """The pose from `begin` (4,) on in `image` (rows, columns), of which `level` is subtracted; both count from zero.

    `so_far`: turns taken, and whether the place is only roughly known. Returns FITTED, the pose (4,), its covariance
    (4, 4) and the noise of a pixel as the blocks show it; the phase whose tables are missing and, in place of the pose,
    the place reached and what was so far; or UNLIKE and nothing of use.
    """
    pose, covariance = np.empty(WANTED), np.empty((WANTED, WANTED))
    x, y, rough = begin[0] + tables.zero[0], begin[1] + tables.zero[1], so_far[1]
    for turn in range(so_far[0], MAX_TURNS):
        top, left, phase, near_x, near_y = _phase_at(x, y)
        top, left = top + tables.origin[0], left + tables.origin[1]
        inside = top >= 0 and left >= 0
        if not (inside and top + tables.down[-1] <= image.shape[0] and left + tables.across[-1] <= image.shape[1]):
            return UNLIKE, pose, covariance, np.inf
        slot = phase_slot(phase, len(tables.phase_in))
        if tables.phase_in[slot] != phase:
            pose[0], pose[1], pose[2], pose[3] = x - tables.zero[0], y - tables.zero[1], turn, rough
            return phase, pose, covariance, np.inf
        if rough:
            dx, dy = _sparse_shift(image, level, tables, (top, left, slot))
            x, y, rough = near_x + dx, near_y + dy, abs(dx) + abs(dy) > FAR_PX
            continue
        rows, normal = tables.rows[slot], tables.normal[slot]
        sums = _block_sums(image, level, tables, (top, left, slot))
        _, found = _weighed(rows, normal, sums)
        if not (found[GAIN] > LEAST_GAIN and found[GAIN] < LARGEST_GAIN):
            return UNLIKE, pose, covariance, np.inf
        first = _first_order(rows, sums, found, tables.centres)
        score, found = _weighed(rows, normal, first)
        gain = found[GAIN]
        x, y = near_x + found[0] / gain, near_y + found[1] / gain
        off = max(abs(x - near_x), abs(y - near_y))
        if off > NEAR_PX and turn + 1 < MAX_TURNS:
            continue
        noise = _noise(rows, first, found, known.usual if known.usual > 0.0 else known.at_first)
        half = 0.5 * np.hypot(float(tables.down[-1]), float(tables.across[-1]))
        turned = half * (abs(found[2]) + abs(found[3])) / gain
        if not np.isfinite(noise) or off > 2.0 * NEAR_PX or turned > MAX_TURN_PX:
            return UNLIKE, pose, covariance, np.inf
        _shrunk((normal, score, gain, noise), known, pose, covariance)
        pose[0], pose[1] = pose[0] + near_x - tables.zero[0], pose[1] + near_y - tables.zero[1]
        return FITTED, pose, covariance, noise
    return UNLIKE, pose, covariance, np.inf


@njit(cache=True)
def _noise(rows: Floats, sums: Floats, found: Floats, expected: float) -> float:
    """Noise of a pixel as the blocks show it; infinite where so few count, or one or all lie further from what was
    found than noise puts them.
    """
    total, worst, count = _rest(rows, sums, found)
    noise = np.sqrt(total / max(SUMS * count - UNKNOWNS, 1))
    likely = worst < WORST_SQUARE * expected * expected and noise < MAX_NOISE * expected
    return float(noise) if count >= MIN_BLOCKS and likely else np.inf


@njit(cache=True)
def _shrunk(fit: tuple[Floats, Floats, float, float], known: Known, pose: Floats, covariance: Floats) -> None:
    """Fill in x, y, roll and zoom (4,), the last two drawn to zero as far as they may be noise, and their covariance
    (4, 4) with that of the zero; few blocks show the noise only roughly, so that its variance and the usual are
    averaged.

    `fit`: normal matrix (4, 4) for a gain of 1, score (4,), gain, noise.
    """
    normal, score, gain, noise = fit
    matrix, right = normal[:WANTED] * gain**2, score * gain
    inverse = inverse_of(matrix)
    plain = product(inverse, right)
    for k in range(2, 4):
        own = noise**2 * inverse[k, k]
        matrix[k, k] += max(noise, 1e-9) ** 2 / (max(plain[k] ** 2 - own, 1e-3 * own) + 1e-300)
    inverse = inverse_of(matrix)
    pose[:] = product(inverse, right)
    variance = noise**2 if known.usual <= 0.0 else (OWN_WEIGHT * noise**2 + known.usual**2) / (OWN_WEIGHT + 1.0)
    covariance[:] = variance * inverse + known.zero
