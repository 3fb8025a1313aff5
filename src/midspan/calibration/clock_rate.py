"""The rate of a displacement sensor's clock relative to the accelerometer's, before anything else is estimated.

A clock that gains 200 ppm is 60 ms off at both ends of ten minutes, which looks like noise, an exposure or a gain.
A short window hardly notices it: there offset and rate are searched together, then the window is widened, each time as
far as the line through it is known to a fraction of the motion's period (see `clock.drift`).
"""

from dataclasses import dataclass, replace

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
# A window's course is judged by so many parts of it, of so many measurements at least.
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
    pair = replace(pair, rows=rows, ratio=None, reference=None)
    first, length_s = float(rows[0, 0]), float(rows[-1, 0] - rows[0, 0])
    wide = min(WINDOW_S, WINDOW_SHARE * length_s)
    starts = first + np.linspace(0.0, length_s - wide, WINDOWS)
    tried = [_window(pair, start, start + wide, max_offset_s) for start in starts]
    best = max((one for one in tried if one is not None), key=lambda one: one.fit.gain, default=None)
    if best is None:
        return None
    course = _widened(pair, best)
    if course is None or not _tells(course, length_s) or not _likelier(pair, course, max_offset_s):
        return None
    rate, std = course.skew, float(np.sqrt(course.covariance[1, 1]))
    return ClockRate(rate, std, origin_ns + round(NANOSECONDS * best.middle_s), length_s)


@dataclass(frozen=True, slots=True)
class _Start:
    """A window whose clock was found: its middle (s, on the sensor's clock), rate (s/s) and fit."""

    begin_s: float
    end_s: float
    rate: float
    fit: Fit

    @property
    def middle_s(self) -> float:
        return 0.5 * (self.begin_s + self.end_s)


def _turned(pair: Pair, rate: float, middle_s: float) -> Pair:
    """The pair with stamps that are later by a rate (s/s) from an instant (s) on."""
    rows = pair.rows.copy()
    rows[:, 0] += rate * (rows[:, 0] - middle_s)
    return replace(pair, rows=rows)


def _window(pair: Pair, begin_s: float, end_s: float, max_offset_s: float) -> _Start | None:
    """Offset and rate of the clock in a window of the record by a search over both."""
    rows = pair.rows[(pair.rows[:, 0] >= begin_s) & (pair.rows[:, 0] <= end_s)]
    if len(rows) < MIN_ROWS:
        return None
    around = AROUND_S + max_offset_s
    near = slice(*np.searchsorted(pair.samples[:, 0], (begin_s - around, end_s + around)))
    part = replace(pair, rows=rows, samples=pair.samples[near], outside=None)
    middle, half = 0.5 * (begin_s + end_s), 0.5 * (end_s - begin_s)
    steps = int(np.ceil(MAX_RATE * half / END_S))
    offsets = np.arange(-max_offset_s, max_offset_s + 0.005, min(0.01, 2.0 * max_offset_s))
    best: tuple[float, Pair, float, float, float] | None = None
    for rate in np.arange(-steps, steps + 1) * (END_S / half):
        own = _turned(part, float(rate), middle)
        curve, corner = scan(own, offsets)
        k = int(np.argmax(curve))
        if np.isfinite(curve[k]) and (best is None or curve[k] > best[0]):
            best = float(curve[k]), own, float(offsets[k]), float(corner[k]), float(rate)
    if best is None:
        return None
    _, own, offset, corner_, rate = best
    fit = refine(own, evaluate(own, offset, corner_), float(offsets[1] - offsets[0]))
    return _Start(begin_s, end_s, rate, fit)


def _widened(pair: Pair, start: _Start) -> ClockCourse | None:
    """The course of the clock over the whole record, by windows about that of the start, each twice as wide."""
    fit = start.fit
    samples = pair.samples * np.array([1.0, 1.0, fit.input_density])
    whole = Compared(samples, pair.rows / np.array([1.0, fit.ratio, fit.ratio**2 / fit.noise]))
    time_s, half = whole.rows[:, 0], 0.5 * (start.end_s - start.begin_s)
    line = np.array([fit.offset_s, start.rate])
    while True:
        inside = np.searchsorted(time_s, (start.middle_s - half, start.middle_s + half))
        one = whole.near(int(inside[0]), int(inside[1]), AROUND_S + abs(line[0]) + abs(line[1]) * half)
        course = drift(one, _part_s(one.rows), line=(float(line[0]), float(line[1]), start.middle_s))
        line = np.array([float(course.at(np.array([round(NANOSECONDS * start.middle_s)]))[0]), course.skew])
        if not abs(line[1]) < MAX_RATE:
            return None
        if inside[0] == 0 and inside[1] == len(time_s):
            return course
        half *= 2.0


def _part_s(rows: Floats) -> float:
    """Length of the parts of a window that its course is judged by, s."""
    length_s = float(rows[-1, 0] - rows[0, 0])
    return length_s / max(2, min(PARTS, len(rows) // MIN_PART_ROWS))


def _tells(course: ClockCourse, length_s: float) -> bool:
    """Whether a straight line is what the clock leaves the accelerometer's by."""
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
    """Sum of the weighted squares of lateness (n,) about its mean."""
    return float(weight @ (late - weight @ late / weight.sum()) ** 2)


def _likelier(pair: Pair, course: ClockCourse, max_offset_s: float) -> bool:
    """Whether the record is more likely with the rate than with the best offset alone."""
    offsets = np.arange(-max_offset_s, max_offset_s + 0.005, min(0.01, 2.0 * max_offset_s))
    curve, corner = scan(pair, offsets)
    k = int(np.argmax(curve))
    without = refine(pair, evaluate(pair, float(offsets[k]), float(corner[k])), float(offsets[1] - offsets[0]))
    moved = _turned(pair, course.skew, course.origin_ns / NANOSECONDS)
    fitted = refine(moved, best_corner(moved, course.offset_s), MIN_LATE_S)
    return fitted.likelihood - without.likelihood > MIN_GAIN
