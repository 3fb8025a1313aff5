"""A stretch of readings that do not follow the motion: a sensor that is stuck while its noise goes on, off its place.

Its first reading is far from what those before it let expect, its last one from what those after it do. That it is left
out is judged by likelihood: all readings as they are, or those of the stretch anywhere within the readings' span.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.fit import Fit, Pair, aligned, best_corner
from midspan.calibration.outliers import OUTLIER_LIMIT, both_ways
from midspan.calibration.whitening import NO_SLOW_ERROR
from midspan.records import Floats
from midspan.signals.medians import SIGMA_OF_MEDIAN

# So many readings at least tell that they do not follow a motion: three of them are the line that the acceleration
# leaves open.
MIN_HELD = 8
# What stuck readings move by is far less than the motion (variance): noise alone. A sensor that follows half of the
# motion has 0.25.
MAX_MOVED = 0.1
# Readings of a stretch that are not far off themselves: where the motion passes the place at which the sensor is stuck.
PASSING = 30
# Stretches that are looked for, at most.
STRETCHES = 4


def held_values(pair: Pair, fit: Fit, whole: Floats) -> NDArray[np.bool_]:
    """Which readings (m,) are of stretches in which the sensor was stuck.

    pair, fit: as calibrated; whole (m, 3): the rows of the pair with those that were left out as outliers.
    """
    held = np.zeros(len(whole), dtype=bool)
    # A slow error may be nothing but such a stretch.
    pair = replace(pair, rows=whole, slow=NO_SLOW_ERROR)
    before = best_corner(pair, fit.offset_s)
    for _ in range(STRETCHES):
        rows = whole.copy()
        rows[held, 2] = np.inf
        found = _stretch(replace(pair, rows=rows), before)
        if not len(found):
            break
        found = _with_ends(whole[:, 1], found)
        rows[found, 2] = np.inf
        after = best_corner(replace(pair, rows=rows), fit.offset_s)
        if not _likelier(rows, before, after):
            break
        held[found], before = True, after
    return held


def _stretch(pair: Pair, fit: Fit) -> NDArray[np.int64]:
    """The rows (k,) from the first to the last one of a stretch that is far off and does not follow the motion."""
    index, forwards, backwards = both_ways(pair, fit)
    size = np.minimum(forwards, backwards)
    spread = SIGMA_OF_MEDIAN * float(np.median(size)) if len(size) else 0.0
    far = OUTLIER_LIMIT * spread
    if spread == 0.0 or not np.max(size) > far:
        return index[:0]
    # It begins with the first reading that is far from those before, and ends with the last one far from those after.
    middle = int(np.argmax(size))
    first = _reached(np.flatnonzero(np.isfinite(forwards) & (forwards > far)), middle, -1)
    last = _reached(np.flatnonzero(np.isfinite(backwards) & (backwards > far)), middle, 1)
    inner = slice(first, last + 1)
    return index[inner] if last - first + 1 >= MIN_HELD and _stays(pair, fit, inner) else index[:0]


def _with_ends(value: Floats, segment: NDArray[np.int64]) -> NDArray[np.int64]:
    """The rows of a segment, with neighbours of the same level: there the motion passed where the sensor was stuck."""
    level, far = np.mean(value[segment]), OUTLIER_LIMIT * np.std(value[segment])
    ends = np.array([segment[0] - 1, segment[-1] + 1])
    ends = ends[(ends >= 0) & (ends < len(value))]
    return np.concatenate((segment, ends[np.abs(value[ends] - level) < far]))


def _reached(far: NDArray[np.int64], middle: int, way: int) -> int:
    """How far (one way, -1 or 1) readings that are `far` off (k,) go on from the one in the middle."""
    reached = middle
    for k in (far[far <= middle][::-1] if way < 0 else far[far >= middle]).tolist():
        if abs(k - reached) > PASSING:
            break
        reached = k
    return reached


def _stays(pair: Pair, fit: Fit, inner: slice) -> bool:
    """Whether the readings compared, from one to another, move by far less than the structure did meanwhile, and than
    the others do: where it is the accelerometer that errs, they move on as before.
    """
    here = aligned(pair, fit.offset_s)
    time_s, moved = here.rows[inner, 0], fit.ratio * pair.responses[0].at(here.rows[inner, 0], pair.exposure_s)
    powers = np.vander(time_s - time_s[0], 3)
    moved = moved - powers @ np.linalg.lstsq(powers, moved, rcond=None)[0]
    readings, others = pair.rows[here.index[inner], 1], np.delete(pair.rows[here.index, 1], inner)
    return bool(np.var(readings) < MAX_MOVED * min(np.var(moved), np.var(others)))


def _likelier(rows: Floats, before: Fit, after: Fit) -> bool:
    """Whether the record is likelier with the readings that `after` leaves out being anywhere within all readings."""
    count = len(before.whitened.variance)
    left_out = count - len(after.whitened.variance)
    anywhere = float(np.log(np.ptp(rows[:, 1]))) - 0.5 * (1.0 + np.log(2.0 * np.pi))
    # Two instants are unknown.
    return bool(after.likelihood - before.likelihood - left_out * anywhere > 2.0 * np.log(count))
