"""The rate of a displacement sensor's clock relative to the accelerometer's, before anything else is estimated.

A clock that gains 200 ppm is 60 ms off at both ends of ten minutes, which looks like noise, an exposure or a gain.
A short window hardly notices it: there offset and rate are searched together, then the window is widened, each time as
far as the line through it is known to a fraction of the motion's period (see `clock.drift`).
"""

from dataclasses import dataclass

import numpy as np

from midspan.calibration.clock import ClockCourse, Compared, drift
from midspan.calibration.fit import Fit, Pair, best_corner, evaluate, refine
from midspan.calibration.time_offset import scan
from midspan.records import NANOSECONDS, Floats, Nanoseconds

# No clock gains more (s/s): the worst that was reported is a wearable's 30 s an hour, 8300 ppm.
MAX_RATE = 0.012
# The windows that are tried first are this long, s, and a third of the record at most; how many there are.
WINDOW_S, WINDOW_SHARE, WINDOWS = 40.0, 1.0 / 3.0, 5
# Within a window the clock's rate is tried in steps that move its ends by this, s: an eighth of the period of 2.5 Hz.
END_S = 0.05
# Fewer measurements show no rate.
MIN_ROWS = 30
# A window's course is judged by this many parts of it, of this many measurements at least.
PARTS, MIN_PART_ROWS = 12, 8
# Instants around a window whose acceleration is used, s.
AROUND_S = 5.0
# A rate is applied when it moves the ends by this many of its standard deviations, and by this much, s.
SIGNIFICANT, MIN_LATE_S = 4.0, 5e-4
# … when it makes the record more likely by this (logarithm), as an offset does (`noise.MIN_GAIN`), …
MIN_GAIN = 10.0
# … and when of the course's variance it leaves less than one step and no more than this beyond chance: a clock that
# was set once leaves a quarter, one that was set twice alike a ninth.
MAX_LEFT, CHANCE = 0.05, 3.0


@dataclass(frozen=True, slots=True)
class ClockRate:
    """What must be added to a sensor's stamps: `late` s per s since `reference_ns` on its own clock; std: of it;
    length_s: of the record that shows it.
    """

    late: float
    std: float
    reference_ns: int
    length_s: float = 0.0

    @property
    def offset_variance(self) -> float:
        """What the uncertain rate makes of an offset, on average over the record, s²."""
        return (self.std * self.length_s) ** 2 / 12.0

    @property
    def ppm(self) -> float:
        """By how much the sensor's clock gains on the accelerometer's, 1e-6."""
        return -1e6 * self.late / (1.0 + self.late)

    def even(self, time_ns: Nanoseconds) -> Nanoseconds:
        """The stamps (n,) as of a clock that runs at the accelerometer's rate."""
        return np.asarray(time_ns + np.rint(self.late * (time_ns - self.reference_ns)).astype(np.int64))


def find_clock_rate(pair: Pair, max_offset_s: float, origin_ns: int) -> ClockRate | None:
    """The rate of the sensor's clock, where the motion shows that it is not the accelerometer's.

    pair: displacement with relative variances and acceleration, at any scale; max_offset_s: by how much the clocks
    differ somewhere in the record at most, s; origin_ns: the instant that the pair's times are counted from.
    """
    rows = pair.rows[pair.used(0.0)]
    if len(rows) < MIN_ROWS or max_offset_s <= 0.0:
        return None
    pair = pair.changed(rows=rows, ratio=None, reference=None)
    first, length_s = float(rows[0, 0]), float(rows[-1, 0] - rows[0, 0])
    wide = min(WINDOW_S, WINDOW_SHARE * length_s)
    starts = first + np.linspace(0.0, length_s - wide, WINDOWS)
    tried = [_window(pair, start, start + wide, max_offset_s) for start in starts]
    best = max((one for one in tried if one is not None), key=lambda one: one.fit.gain, default=None)
    if best is None:
        return None
    course = _widened(pair, best)
    if course is None or not _tells(course, length_s):
        return None
    # The record must be more likely with the rate than with the best offset alone.
    _, _, offset_s, corner, step_s = _scanned(pair, max_offset_s)
    without = refine(pair, evaluate(pair, offset_s, corner), step_s)
    moved = _turned(pair, course.skew, course.origin_ns / NANOSECONDS)
    fitted = refine(moved, best_corner(moved, course.offset_s), MIN_LATE_S)
    if not fitted.likelihood - without.likelihood > MIN_GAIN:
        return None
    rate, std = course.skew, float(np.sqrt(course.covariance[1, 1]))
    return ClockRate(rate, std, origin_ns + round(NANOSECONDS * best.middle_s), length_s)


@dataclass(frozen=True, slots=True)
class _Start:
    """A window whose clock was found: its middle (s, on the sensor's clock), half its length, rate (s/s) and fit."""

    middle_s: float
    half_s: float
    rate: float
    fit: Fit


def _turned(pair: Pair, rate: float, middle_s: float) -> Pair:
    rows = pair.rows.copy()
    rows[:, 0] += rate * (rows[:, 0] - middle_s)
    return pair.changed(rows=rows)


def _window(pair: Pair, begin_s: float, end_s: float, max_offset_s: float) -> _Start | None:
    rows = pair.rows[(pair.rows[:, 0] >= begin_s) & (pair.rows[:, 0] <= end_s)]
    around = AROUND_S + max_offset_s
    near = slice(*np.searchsorted(pair.samples[:, 0], (begin_s - around, end_s + around)))
    if len(rows) < MIN_ROWS or near.stop - near.start < MIN_ROWS:
        return None
    part = pair.changed(rows=rows, samples=pair.samples[near], outside=None)
    middle, half = 0.5 * (begin_s + end_s), 0.5 * (end_s - begin_s)
    steps = int(np.ceil(MAX_RATE * half / END_S))
    rates = [float(rate) for rate in np.arange(-steps, steps + 1) * (END_S / half)]
    scanned = [(*_scanned(_turned(part, rate, middle), max_offset_s), rate) for rate in rates]
    best = max((one for one in scanned if np.isfinite(one[0])), key=lambda one: one[0], default=None)
    if best is None:
        return None
    _, pair, offset_s, corner, step_s, rate = best
    return _Start(middle, half, rate, refine(pair, evaluate(pair, offset_s, corner), step_s))


def _scanned(pair: Pair, max_offset_s: float) -> tuple[float, Pair, float, float, float]:
    """The largest likelihood of a scan over offsets, the pair, that offset and corner frequency, and the step (s)."""
    offsets = np.arange(-max_offset_s, max_offset_s + 0.005, min(0.01, 2.0 * max_offset_s))
    curve, corner = scan(pair, offsets)
    k = int(np.argmax(curve))
    return float(curve[k]), pair, float(offsets[k]), float(corner[k]), float(offsets[1] - offsets[0])


def _widened(pair: Pair, start: _Start) -> ClockCourse | None:
    """The course of the clock over the whole record, by windows about that of the start, each twice as wide."""
    fit = start.fit
    samples = pair.samples * np.array([1.0, 1.0, fit.input_density])
    whole = Compared(samples, pair.rows / np.array([1.0, fit.ratio, fit.ratio**2 / fit.noise]))
    time_s, half = whole.rows[:, 0], start.half_s
    line = np.array([fit.offset_s, start.rate])
    while True:
        inside = np.searchsorted(time_s, (start.middle_s - half, start.middle_s + half))
        one = whole.near(int(inside[0]), int(inside[1]), AROUND_S + abs(line[0]) + abs(line[1]) * half)
        part_s = float(one.rows[-1, 0] - one.rows[0, 0]) / max(2, min(PARTS, len(one.rows) // MIN_PART_ROWS))
        course = drift(one, part_s, line=(float(line[0]), float(line[1]), start.middle_s))
        line = np.array([float(course.at(np.array([round(NANOSECONDS * start.middle_s)]))[0]), course.skew])
        if not abs(line[1]) < MAX_RATE:
            return None
        if inside[0] == 0 and inside[1] == len(time_s):
            return course
        half *= 2.0


def _tells(course: ClockCourse, length_s: float) -> bool:
    end_s, std = 0.5 * length_s * abs(course.skew), 0.5 * length_s * float(np.sqrt(course.covariance[1, 1]))
    if not (end_s > SIGNIFICANT * std and end_s > MIN_LATE_S):
        return False
    known = np.isfinite(course.std_s)
    weight, late = 1.0 / course.std_s[known] ** 2, course.lateness_s[known]
    total = _about_mean(weight, late)
    left = float(weight @ (late - course.at(course.time_ns[known])) ** 2)
    steps = [_about_mean(weight[:k], late[:k]) + _about_mean(weight[k:], late[k:]) for k in range(1, len(late))]
    # A clock that was set once is no other rate.
    if left > min(steps, default=np.inf):
        return False
    return bool(left < MAX_LEFT * total + len(late) + CHANCE * np.sqrt(2.0 * len(late)))


def _about_mean(weight: Floats, late: Floats) -> float:
    return float(weight @ (late - weight @ late / weight.sum()) ** 2)
