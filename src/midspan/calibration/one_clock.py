"""A sensor's measurements on the accelerometer's clock: jumps of its own clock and its drift found and taken out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.clock import ClockCourse, clock_course, compared
from midspan.calibration.clock_jumps import LARGEST_S, ClockJump, clock_jumps, lateness
from midspan.errors import UntrustedError
from midspan.fusion.path import at
from midspan.fusion.streams import NO_ERRORS, KalmanSettings, filtered, smooth
from midspan.notices import Notice
from midspan.records import NANOSECONDS, Acceleration, Displacement, Event, Floats, Nanoseconds, part
from midspan.signals.stamps import inside, shown

# In this time a cheap quartz (20 ppm) drifts by 2.4 ms; a shorter record is not much longer than its calibration.
MIN_S = 120.0
DRIFT_WINDOW_S, MAX_DRIFT_WINDOWS = 60.0, 240
# A course is corrected when it leaves the calibrated offset by this many of its standard deviations …
SIGNIFICANT = 4.0
# … and by as much as matters: half the calibration's own promise.
MIN_LATE_S = 5e-4
# So much, s, either way of an instant is smoothed to tell what the structure did there.
AROUND_S = 10.0
# Of the measurements in a window of this many seconds at most this share may contradict the acceleration in the end:
# lie this many predicted deviations off.
WINDOW_S, MAX_REJECTED, CONTRADICTS = 8.0, 0.6, 4.0
# Lost or doubled frames are named where a jump is this many intervals to this share of one.
WHOLE = 0.1
# A step is located to a few measurements; where more lie in between, it may as well be a drift.
MAX_BETWEEN = 10


@dataclass(frozen=True, slots=True, eq=False)
class CourseError:
    """A sensor's zero drifts, and is known at stamps (n,) to standard deviations (n,) in m only."""

    time_ns: Nanoseconds
    std_m: Floats


@dataclass(frozen=True, slots=True)
class OneClock:
    """Measurements on one clock, and what there is to report.

    course: the drift that was corrected; jumps: taken out before it; levels: what the displacement may be off by as
    the motion tells a jump so well only, or does not tell which one it was; uneven_s (n,): what the clock is off by
    beyond that at each measurement, where windows tell it.
    """

    measured: Displacement
    warnings: tuple[Notice, ...] = ()
    events: tuple[Event, ...] = ()
    levels: tuple[CourseError, ...] = ()
    jumps: tuple[ClockJump, ...] = ()
    course: ClockCourse | None = None
    uneven_s: Floats | None = None

    def first_ns(self, time_ns: int) -> int:
        """The first measurement's stamp (ns) with the jumps and the drift of its clock taken out."""
        late_s = self.jumps[0].before_s if self.jumps else 0.0
        if self.course is not None:
            late_s += float(self.course.at(np.array([time_ns]))[0])
        return time_ns + round(NANOSECONDS * late_s)

    def also(self, measured: Displacement) -> "OneClock":
        """Other measurements of the same frames on the same clock; what was to tell has been reported.

        Those that may be on either side of a jump are left out.
        """
        moved = _moved(measured, self.jumps)
        value = moved.value_m.copy()
        for jump in self.jumps:
            value[jump.first : jump.last] = np.nan
        moved = replace(moved, value_m=value)
        moved = moved if self.course is None else self.course.corrected(moved)
        return replace(self, measured=moved, warnings=(), events=(), levels=())


def on_one_clock(measured: Displacement, acceleration: Acceleration, sensor: str) -> OneClock:
    """The measurements of one sensor with the drift of its clock taken out, where the record is long and shows one.

    measured: on the accelerometer's clock as calibrated; sensor: its name in messages.
    """
    usable = np.flatnonzero(np.isfinite(measured.value_m))
    if len(usable) < 2 or not acceleration.value_m_s2.any():
        return OneClock(measured)
    length_s = float(measured.time_ns[usable[-1]] - measured.time_ns[usable[0]]) / NANOSECONDS
    if length_s < MIN_S:
        return OneClock(measured)
    course = clock_course(acceleration, measured, window_s=max(DRIFT_WINDOW_S, length_s / MAX_DRIFT_WINDOWS))
    late, std = course.at(course.time_ns), course.std_at(course.time_ns)
    reported, uneven_s = _uneven(course, sensor, measured.time_ns)
    if not np.any((np.abs(late) > SIGNIFICANT * std) & (np.abs(late) > MIN_LATE_S)):
        return OneClock(measured, tuple(reported), uneven_s=uneven_s)
    skew_std = float(np.sqrt(course.covariance[1, 1]))
    text = (
        f"{sensor}: its clock deviates from the calibrated offset by {1e3 * late[0]:+.2f} ms at the start and "
        f"{1e3 * late[-1]:+.2f} ms at the end ({1e6 * course.skew:+.1f} ± {1e6 * skew_std:.1f} ppm); corrected."
    )
    return OneClock(
        course.corrected(measured), (Notice("clock-corrected", text), *reported), course=course, uneven_s=uneven_s
    )


def _uneven(course: ClockCourse, sensor: str, time_ns: Nanoseconds) -> tuple[list[Notice], Floats | None]:
    """A warning where single windows leave the line by more than noise; and by how much (n,), s, at stamps (n,)."""
    left = course.lateness_s - course.at(course.time_ns)
    far = (np.abs(left) > 2.0 * SIGNIFICANT * course.std_s) & (np.abs(left) > 2.0 * MIN_LATE_S)
    if not far.any():
        return [], None
    worst = int(np.argmax(np.where(far, np.abs(left), 0.0)))
    known = np.isfinite(left)
    uneven_s = np.interp(time_ns, course.time_ns[known], left[known])
    text = (
        f"{sensor}: its clock drift is not linear: around {course.time_ns[worst] / NANOSECONDS:.0f} s it deviates by "
        f"{1e3 * left[worst]:+.2f} ms from a straight line; the error band includes it. Check for lost frames, or "
        "split the recording there."
    )
    return [Notice("clock-differs", text)], uneven_s


def one_clock(
    measured: Displacement, acceleration: Acceleration, kalman: KalmanSettings, sensor: str, *, shared: bool = False
) -> OneClock:
    """The measurements of one sensor without the jumps of its clock and, in a long record, without its drift.

    measured: on the accelerometer's clock as calibrated; sensor: its name in messages;
    shared: its clock is the accelerometer's, so that no drift is looked for and the stamps before the first jump stay.
    """
    jumps = _jumps(measured, acceleration, stays=shared)

    def even() -> OneClock:
        moved = _moved(measured, jumps)
        return OneClock(moved) if shared else on_one_clock(moved, acceleration, sensor)

    clock = even()
    if clock.course is not None and not jumps:
        # Relative to a clock that drifts a small jump shows only now.
        jumps = _jumps(clock.measured, acceleration, stays=True)
        clock = even() if jumps else clock
    moved, uneven = clock.measured, tuple[CourseError, ...]()
    if clock.uneven_s is not None:
        std_m = _apart(moved, slice(0, None), clock.uneven_s, acceleration, kalman)
        uneven = (CourseError(moved.time_ns, std_m),)
    if not jumps:
        return replace(clock, levels=uneven)
    _refuse_contradiction(moved, acceleration, kalman, sensor)
    moved, levels = _either_side(moved, jumps, acceleration, kalman)
    events = tuple(_event(measured, jump, sensor) for jump in jumps)
    warnings = (*(Notice("clock-corrected", event.text) for event in events), *clock.warnings)
    return replace(clock, measured=moved, warnings=warnings, events=events, levels=(*levels, *uneven), jumps=jumps)


def _refuse_contradiction(moved: Displacement, acceleration: Acceleration, kalman: KalmanSettings, sensor: str) -> None:
    reported = replace(kalman, rates=NO_ERRORS, noise_memory=np.inf)
    found = filtered(acceleration, moved, reported).innovation
    far = found.value_m**2 > CONTRADICTS**2 * found.variance_m2
    rejected = np.concatenate(([0], np.cumsum(far)))
    first = np.arange(len(found.time_ns))
    last = np.searchsorted(found.time_ns, found.time_ns + round(WINDOW_S * NANOSECONDS))
    whole = last < len(found.time_ns)
    share = np.where(whole, (rejected[last] - rejected[first]) / np.maximum(last - first, 1), 0.0)
    worst = int(np.argmax(share)) if len(share) else 0
    if not len(share) or share[worst] <= MAX_REJECTED:
        return
    begin = int(found.time_ns[worst])
    raise UntrustedError(
        f"{sensor}: its clock jumps, or frames are lost, more often than the motion can show: after correction "
        f"{100 * share[worst]:.0f} % of the measurements from {shown(begin)} to "
        f"{shown(begin + round(WINDOW_S * NANOSECONDS))} still contradict the acceleration. Give a time stamp for "
        "each frame, or cut the recording where the clock is set.",
        more="Frozen readings look the same: leave them out.",
    )


def _jumps(measured: Displacement, acceleration: Acceleration, *, stays: bool) -> tuple[ClockJump, ...]:
    usable = np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2)
    first, last = int(acceleration.time_ns[0]), int(acceleration.time_ns[-1])
    inner = usable & (measured.time_ns >= first) & (measured.time_ns <= last)
    if np.count_nonzero(inner) < 2 or not acceleration.value_m_s2.any():
        return ()
    one, index = compared(acceleration, measured)
    found = [
        replace(jump, row=int(index[jump.row]), first=int(index[jump.first]), last=int(index[jump.last]))
        for jump in clock_jumps(one)
    ]
    if stays and found:
        found[0] = replace(found[0], before_s=0.0)
    return tuple(found)


def _moved(measured: Displacement, jumps: Sequence[ClockJump]) -> Displacement:
    """The measurements with the jumps taken out of the stamps; what then lies before its predecessor is left out."""
    if not jumps:
        return measured
    time_ns = measured.time_ns + np.rint(NANOSECONDS * lateness(jumps, len(measured.time_ns))).astype(np.int64)
    latest = np.maximum.accumulate(time_ns)
    doubled = np.concatenate(([False], time_ns[1:] <= latest[:-1]))
    # Their stamps are of no account but must grow.
    order = np.arange(len(time_ns))
    return replace(
        measured,
        time_ns=np.maximum.accumulate(latest - order) + order,
        value_m=np.where(doubled, np.nan, measured.value_m),
    )


def _either_side(
    moved: Displacement, jumps: Sequence[ClockJump], acceleration: Acceleration, kalman: KalmanSettings
) -> tuple[Displacement, tuple[CourseError, ...]]:
    """Wider noise of measurements that may be on either side of a jump, and what its deviation, or a rival, changes."""
    variance, levels = moved.variance_m2.copy(), []
    for jump in jumps:
        if jump.last > jump.first:
            near = slice(jump.first, jump.last)
            other_s = np.where(np.arange(jump.first, jump.last) < jump.row, jump.late_s, -jump.late_s)
            variance[near] += _apart(moved, near, other_s, acceleration, kalman) ** 2
        after = slice(jump.row, None)
        open_s = jump.std_s if jump.rival_s is None else jump.rival_s - jump.late_s
        std_m = np.zeros(len(moved.time_ns))
        std_m[after] = _apart(moved, after, np.full(len(std_m) - jump.row, open_s), acceleration, kalman)
        levels.append(CourseError(moved.time_ns, std_m))
    return replace(moved, variance_m2=variance), tuple(levels)


def _apart(
    moved: Displacement, which: slice, other_s: Floats, acceleration: Acceleration, kalman: KalmanSettings
) -> Floats:
    time_ns = moved.time_ns[which]
    around = round((AROUND_S + LARGEST_S) * NANOSECONDS)
    span = (int(time_ns[0]) - around, int(time_ns[-1]) + around)
    # What is looked for must not lead the path.
    companions = replace(moved, value_m=moved.value_m.copy())
    if which.stop is not None:
        companions.value_m[which] = np.nan
    rows = smooth(
        part(acceleration, inside(acceleration.time_ns, *span)),
        part(companions, inside(companions.time_ns, *span)),
        kalman,
    ).estimate
    return at(rows, time_ns + np.rint(NANOSECONDS * other_s).astype(np.int64))[0] - at(rows, time_ns)[0]


def _event(measured: Displacement, jump: ClockJump, sensor: str) -> Event:
    at_ns = int(measured.time_ns[jump.row])
    begin, end = (int(measured.time_ns[k]) for k in (max(jump.first - 1, 0), jump.last))
    interval = float(np.median(np.diff(measured.time_ns))) / NANOSECONDS
    frames = round(jump.late_s / interval)
    # A clock that was set shows a step in the stamps themselves.
    apart = end - begin - (jump.last - max(jump.first - 1, 0)) * interval * NANOSECONDS
    whole = abs(apart) < WHOLE * interval * NANOSECONDS and frames != 0
    whole = whole and abs(jump.late_s - frames * interval) < max(WHOLE * interval, 3.0 * jump.std_s)
    were, lost = "was" if abs(frames) == 1 else "were", "lost" if frames > 0 else "doubled"
    what = f", as if {abs(frames)} of its frames {were} {lost}" if whole else ""
    jumped = "jumped" if jump.last - jump.first <= MAX_BETWEEN else "changed (a step or a drift)"
    text = (
        f"{sensor}: its clock {jumped} between {shown(begin)} and {shown(end)}: {1e3 * jump.late_s:+.2f} ± "
        f"{1e3 * jump.std_s:.2g} ms were added to its time stamps from there on{what}."
    )
    if jump.rival_s is not None:
        text += (
            f" A correction of {1e3 * jump.rival_s:+.1f} ms fits the motion almost as well; the error band includes "
            "the difference."
        )
    return Event(at_ns, "clock", text)
