"""Long recordings: a sensor's clock that runs faster or slower than the accelerometer's is found and corrected."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.clock import ClockCourse, clock_course
from midspan.notices import Notice
from midspan.records import NANOSECONDS, Acceleration, Displacement, Floats, Nanoseconds

# In this time a cheap quartz (20 ppm) drifts by 2.4 ms; a shorter record is not much longer than its calibration.
MIN_S = 120.0
WINDOW_S, MAX_WINDOWS = 60.0, 240
# A course is corrected when it leaves the calibrated offset by this many of its standard deviations …
SIGNIFICANT = 4.0
# … and by as much as matters: half the calibration's own promise.
MIN_LATE_S = 5e-4


@dataclass(frozen=True, slots=True)
class RunningClock:
    """Measurements on one clock, and what there is to report.

    course: what was corrected; None where nothing was. uneven_s (n,): what the clock is off by beyond that at each
    measurement, where windows tell it; None where it runs evenly.
    """

    measured: Displacement
    warnings: tuple[Notice, ...] = ()
    course: ClockCourse | None = None
    uneven_s: Floats | None = None

    def also(self, measured: Displacement) -> "RunningClock":
        """Other measurements of the same sensor on the same clock; what was to tell has been told."""
        moved = measured if self.course is None else self.course.corrected(measured)
        return replace(self, measured=moved, warnings=())


def on_one_clock(measured: Displacement, acceleration: Acceleration, sensor: str) -> RunningClock:
    """The measurements of one sensor with the drift of its clock taken out, where the record is long and shows one.

    measured: on the accelerometer's clock as calibrated; sensor: its name in messages.
    """
    usable = np.flatnonzero(np.isfinite(measured.value_m))
    if len(usable) < 2 or not acceleration.value_m_s2.any():
        return RunningClock(measured)
    length_s = float(measured.time_ns[usable[-1]] - measured.time_ns[usable[0]]) / NANOSECONDS
    if length_s < MIN_S:
        return RunningClock(measured)
    course = clock_course(acceleration, measured, window_s=max(WINDOW_S, length_s / MAX_WINDOWS))
    late, std = course.at(course.time_ns), course.std_at(course.time_ns)
    told, uneven_s = _jumps(course, sensor, measured.time_ns)
    if not np.any((np.abs(late) > SIGNIFICANT * std) & (np.abs(late) > MIN_LATE_S)):
        return RunningClock(measured, tuple(told), uneven_s=uneven_s)
    skew_std = float(np.sqrt(course.covariance[1, 1]))
    text = (
        f"{sensor}: its clock leaves the calibrated offset by {1e3 * late[0]:+.2f} ms at the start and "
        f"{1e3 * late[-1]:+.2f} ms at the end ({1e6 * course.skew:+.1f} ± {1e6 * skew_std:.1f} ppm); "
        "this was corrected."
    )
    return RunningClock(course.corrected(measured), (Notice("clock-corrected", text), *told), course, uneven_s)


def _jumps(course: ClockCourse, sensor: str, time_ns: Nanoseconds) -> tuple[list[Notice], Floats | None]:
    """A warning where single windows leave the straight line by more than noise: the clock was set, or frames lost; and
    by how much (n,), s, at stamps (n,).
    """
    left = course.lateness_s - course.at(course.time_ns)
    far = (np.abs(left) > 2.0 * SIGNIFICANT * course.std_s) & (np.abs(left) > 2.0 * MIN_LATE_S)
    if not far.any():
        return [], None
    worst = int(np.argmax(np.where(far, np.abs(left), 0.0)))
    known = np.isfinite(left)
    uneven_s = np.interp(time_ns, course.time_ns[known], left[known])
    return [
        Notice(
            "clock-differs",
            f"{sensor}: its clock does not run evenly: around {course.time_ns[worst] / NANOSECONDS:.0f} s it is off by "
            f"{1e3 * left[worst]:+.2f} ms beside a straight line; the error band holds what that makes. Check for lost "
            "frames, or split the recording there.",
        )
    ], uneven_s
