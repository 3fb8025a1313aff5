"""Wrong values of a displacement sensor: frozen, stuck while their noise goes on, or a crowd of outliers.

A segment of stuck values: its first one is far from what those before it let expect, its last one from what those after
it do. That it is left out is judged by likelihood: all values as they are, or those of the segment anywhere within the
values' span.

A crowd: too many values are wrong for a fit of all of them to separate. The path that the acceleration gives is fitted
with slow motion left open, by a loss that is bounded and that narrows (graduated non-convexity: A. Blake and
A. Zisserman, Visual Reconstruction, 1987; S. Geman and D. McClure, 1985). It is one where the values are clearly
likelier as white noise about the path together with a share of them anywhere within their span than as noise whose size
changes from moment to moment: a sensor or an accelerometer that is noisy for a while, or off its place, makes no crowd.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.agreement import least_lead
from midspan.calibration.causes import MIN_READINGS, Comparison, slow_motion
from midspan.calibration.fit import MIN_MEASUREMENTS, Fit, Pair, aligned, best_corner, measured_rows
from midspan.calibration.outliers import OUTLIER_LIMIT, both_ways, shaken_rows
from midspan.calibration.whitening import NO_SLOW_ERROR
from midspan.records import Acceleration, Displacement, Floats, Nanoseconds, seconds
from midspan.signals.clipping import resolution
from midspan.signals.medians import SIGMA_OF_MEDIAN, white_noise
from midspan.signals.stamps import inside
from midspan.signals.stuck import stuck

# This many readings tell that they do not follow a motion: three are the line that the acceleration leaves open.
MIN_HELD = 8
# What stuck readings move by is far less than the motion (variance); a sensor that follows half of it has 0.25.
MAX_MOVED = 0.1
# Readings of a segment that are not far off themselves: where the motion passes the place at which the sensor is stuck.
PASSING = 30
# Segments that are looked for, at most.
MAX_SEGMENTS = 4
# Readings that are fitted at once, and the most of a record, for speed.
PIECE, MAX_READINGS = 600, 100_000
# A reading is wrong beyond this many robust deviations.
LIMIT = 5.0
# The loss narrows by this factor a round, so often: from the readings' span to a hundredth of a percent of it.
NARROWER, ROUNDS = 0.8, 40
# What most readings share is right: fewer than half of them are wrong; of each of BLOCKS parts of the record, at most
# this share, which chance does not reach where it is half of all.
MAX_WRONG, BLOCKS, MAX_OF_BLOCK = 0.5, 6, 0.7
# At least half of the wrong ones lie this many deviations or more from the others.
APART = 7.5
# Fewer are no crowd: a fit of all tells them, and a filter's gate.
MIN_WRONG = 0.1
# Motion is compared down to where the accelerometer's noise, integrated twice, is this share of the readings' variance.
MAX_NOISE_SHARE = 0.01
# Noise alone is of one size in this many readings.
NOISE_READINGS = 20
# The spread is that of the nearest readings: NEAREST of a normal distribution lie within OF_NORMAL deviations.
NEAREST, OF_NORMAL = 0.3, 0.3853


def held_values(pair: Pair, fit: Fit, whole: Floats) -> NDArray[np.bool_]:
    """Which readings (m,) are of segments in which the sensor was stuck.

    pair, fit: as calibrated; whole (m, 3): the rows of the pair with those that were left out as outliers.
    """
    held = np.zeros(len(whole), dtype=bool)
    # A slow error may be nothing but such a segment.
    pair = pair.changed(rows=whole, slow=NO_SLOW_ERROR)
    before = best_corner(pair, fit.offset_s)
    for _ in range(MAX_SEGMENTS):
        rows = whole.copy()
        rows[held, 2] = np.inf
        found = _stuck_segment(pair.changed(rows=rows), before)
        if not len(found):
            break
        # With neighbours of the same level: there the motion passed where the sensor was stuck.
        value = whole[:, 1]
        ends = np.array([found[0] - 1, found[-1] + 1])
        ends = ends[(ends >= 0) & (ends < len(value))]
        level, far = np.mean(value[found]), OUTLIER_LIMIT * np.std(value[found])
        found = np.concatenate((found, ends[np.abs(value[ends] - level) < far]))
        rows[found, 2] = np.inf
        after = best_corner(pair.changed(rows=rows), fit.offset_s)
        # Whether the record is likelier with these readings anywhere within all; two instants are unknown.
        count = len(before.whitened.variance)
        left_out = count - len(after.whitened.variance)
        anywhere = float(np.log(np.ptp(rows[:, 1]))) - 0.5 * (1.0 + np.log(2.0 * np.pi))
        if not after.likelihood - before.likelihood - left_out * anywhere > 2.0 * np.log(count):
            break
        held[found], before = True, after
    return held


def _stuck_segment(pair: Pair, fit: Fit) -> NDArray[np.int64]:
    """The rows (k,) from the first to the last one of a segment that is far off and does not follow the motion."""
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


def _reached(far: NDArray[np.int64], middle: int, way: int) -> int:
    """How far (one way, -1 or 1) readings that are `far` off (k,) go on from the one in the middle."""
    reached = middle
    for k in (far[far <= middle][::-1] if way < 0 else far[far >= middle]).tolist():
        if abs(k - reached) > PASSING:
            break
        reached = k
    return reached


def _stays(pair: Pair, fit: Fit, inner: slice) -> bool:
    """Whether the readings move by far less than the structure meanwhile, and than the others do."""
    own = aligned(pair, fit.offset_s).columns
    time_s = own.rows[inner, 0]
    moved = fit.ratio * pair.responses[0].at(time_s, pair.exposure_s)
    powers = np.vander(time_s - time_s[0], 3)
    moved = moved - powers @ np.linalg.lstsq(powers, moved, rcond=None)[0]
    readings, others = pair.rows[own.index[inner], 1], np.delete(pair.rows[own.index, 1], inner)
    return bool(np.var(readings) < MAX_MOVED * min(np.var(moved), np.var(others)))


def crowd_of_outliers(pair: Pair) -> NDArray[np.bool_]:
    """Which readings (m,) are a crowd of outliers, with those at both ends; none where there is no crowd.

    pair: in m, on one clock with the acceleration.
    """
    crowd = np.zeros(len(pair.rows), dtype=bool)
    usable = np.flatnonzero(np.isfinite(pair.rows[:, 2]) & np.isfinite(pair.rows[:, 1]))
    if not MIN_READINGS <= len(usable) <= MAX_READINGS:
        return crowd
    rows = pair.rows[usable]
    # Where white noise of the acceleration, integrated twice, is little of the rows' variance: of a one-sided density S
    # the variance above f is S / (3 (2π)⁴ f³).
    density = 2.0 * white_noise(pair.samples[:, 1]) ** 2 / pair.sample_rate_hz
    power = max(float(np.var(rows[:, 1])), 1e-300)
    clear_hz = float(np.cbrt(density / (3.0 * (2.0 * np.pi) ** 4 * MAX_NOISE_SHARE * power)))
    compared = Comparison.of(pair.changed(rows=rows), len(usable), clear_hz)
    if len(compared.time_s) < MIN_READINGS:
        return crowd
    differs = compared.value_m - compared.path()(compared.time_s)
    pieces = np.array_split(np.arange(len(differs)), -(-len(differs) // PIECE))
    bases = [slow_motion(compared.time_s[piece], compared.slowest_hz) for piece in pieces]
    left = np.concatenate([_robust(differs[k], q) for k, q in zip(pieces, bases, strict=True)])
    far = np.abs(left) > LIMIT * _spread(left)
    if not far.any():
        return crowd
    # What a slow sensor shows of a structure that rings is no outlier.
    shaken = shaken_rows(pair.changed(rows=rows))[compared.inside]
    # It lies clearly apart from the rest, and is the lesser part everywhere.
    apart = MIN_WRONG < np.mean(far) < MAX_WRONG and not np.median(np.abs(left[far])) < APART * _spread(left)
    apart = apart and all(np.mean(part) < MAX_OF_BLOCK for part in np.array_split(far, BLOCKS))
    if np.mean(shaken[far]) < MAX_WRONG and apart and _gain(left, far) > least_lead(len(left)):
        # At both ends, where the integral is open, none of them can be separated from the others.
        crowd[usable] = True
        crowd[usable[compared.inside]] = far
    return crowd


def _robust(differs: Floats, basis: Floats) -> Floats:
    left = differs - np.median(differs)
    width = 2.0 * float(np.max(np.abs(left)))
    for _ in range(ROUNDS):
        root = 1.0 / (1.0 + (left / max(width, 1e-300)) ** 2)
        left = differs - basis @ np.linalg.lstsq(basis * root[:, None], differs * root, rcond=None)[0]
        width = max(NARROWER * width, _spread(left))
    return np.asarray(left)


def _spread(left: Floats) -> float:
    return float(np.quantile(np.abs(left), NEAREST)) / OF_NORMAL


def _gain(left: Floats, far: NDArray[np.bool_]) -> float:
    """By how much the readings are likelier (logarithm) with a crowd than as noise whose size changes.

    left (n,): what the robust fit leaves; far (n,): the crowd, anywhere within the span.
    """
    inner, share, span = left[~far], float(np.mean(far)), float(np.ptp(left))
    pieces = np.array_split(left, -(-len(left) // NOISE_READINGS))
    without = math.fsum(_noise_alone(piece) for piece in pieces)
    about = _noise_alone(inner) + len(inner) * np.log1p(-share)
    return float(about + np.count_nonzero(far) * (np.log(share) - np.log(span)) - without)


def _noise_alone(left: Floats) -> float:
    """Logarithm of the likelihood of readings (n,) as white noise of the size that they have."""
    return float(-0.5 * len(left) * np.log(2.0 * np.pi * np.e * max(float(np.mean(left**2)), 1e-300)))


@dataclass(frozen=True, slots=True)
class WrongValues:
    """Stamps (k,) of the values that contradict both the acceleration and the rest of the values.

    held: they are frozen, or stuck while their noise goes on; a filter takes the first ones of them for motion. crowd:
    outliers, more than a filter expects, which takes them for something else.
    """

    held: Nanoseconds
    crowd: Nanoseconds

    @property
    def stamps(self) -> Nanoseconds:
        """All of them."""
        return np.union1d(self.held, self.crowd)


def wrong_values(measured: Displacement, acceleration: Acceleration) -> WrongValues:
    """Which values of a displacement sensor are wrong; measured: in metres on the accelerometer's clock."""
    covered = inside(measured.time_ns, int(acceleration.time_ns[0]), int(acceleration.time_ns[-1]))
    time_ns, value = measured.time_ns[covered], measured.value_m[covered]
    if np.count_nonzero(np.isfinite(value)) < MIN_MEASUREMENTS:
        return WrongValues(time_ns[:0], time_ns[:0])
    first = int(time_ns[0])
    pushed = acceleration.value_m_s2 - np.mean(acceleration.value_m_s2)
    shaken = np.column_stack((seconds(acceleration.time_ns, first), pushed, acceleration.noise_density))
    held = stuck(seconds(time_ns, first), value, shaken, resolution_m=resolution(value))
    rows = measured_rows(time_ns, value, np.where(held | ~np.isfinite(value), np.inf, 1.0), first)
    shaken[:, 2] /= np.median(acceleration.noise_density)
    pair = Pair(shaken, rows, 1.0)
    crowd = crowd_of_outliers(pair)
    # Those of a sensor that is stuck, as all that are not wrong show.
    right = pair.rows.copy()
    right[held | crowd, 2] = np.inf
    if np.count_nonzero(np.isfinite(right[:, 2])) >= MIN_MEASUREMENTS:
        right_pair = pair.changed(rows=right)
        held |= held_values(right_pair, best_corner(right_pair, 0.0), pair.rows)
    return WrongValues(time_ns[held], time_ns[crowd & ~held])
