"""How far a displacement sensor's clock drifts from the accelerometer's during a long record.

A measurement that is late by τ is wrong by τ times the velocity. What such an error does to the filter's innovations is
linear, so that one more run of the filter, over the velocity in place of the displacement, gives the regressor; the
lateness of each window of time follows by weighted least squares, with its standard deviation.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.fusion.gate import ACCEPTED, REACQUIRED
from midspan.fusion.kalman import KalmanFilter, KalmanSettings
from midspan.fusion.path import velocity_at
from midspan.fusion.response import linear, standing_still, used_variance
from midspan.fusion.smoother import smooth
from midspan.records import NANOSECONDS, Acceleration, Displacement, Floats, Innovation, Nanoseconds, joined, seconds

PASSES = 3
MEDIAN_OF_SQUARE = 0.4549  # of a normal variable of variance 1


@dataclass(frozen=True, slots=True)
class ClockCourse:
    """Lateness of a sensor's clock over a record: seconds to add to its stamps.

    time_ns, lateness_s, std_s (windows,): middle of each window, what its measurements alone say, and the standard
    deviation of that; infinite where nothing moved. At `origin_ns` the fitted line has `offset_s`, and it changes by
    `skew` s/s; covariance (2, 2) of both.
    """

    time_ns: Nanoseconds
    lateness_s: Floats
    std_s: Floats
    origin_ns: int
    offset_s: float
    skew: float
    covariance: Floats

    def at(self, time_ns: Nanoseconds) -> Floats:
        """Lateness (n,) s by the fitted line at the stamps (n,)."""
        return np.asarray(self.offset_s + self.skew * seconds(time_ns, self.origin_ns))

    def std_at(self, time_ns: Nanoseconds) -> Floats:
        """Standard deviation (n,) s of `at`."""
        t = seconds(time_ns, self.origin_ns)
        c = self.covariance
        return np.asarray(np.sqrt(c[0, 0] + 2.0 * c[0, 1] * t + c[1, 1] * t * t))

    def corrected(self, displacement: Displacement) -> Displacement:
        """The measurements with their lateness taken out of the stamps."""
        late_ns = np.rint(NANOSECONDS * self.at(displacement.time_ns)).astype(np.int64)
        return replace(displacement, time_ns=displacement.time_ns + late_ns)


def clock_course(
    acceleration: Acceleration, displacement: Displacement, settings: KalmanSettings, *, window_s: float = 60.0
) -> ClockCourse:
    """Measure how the displacement's clock runs beside the accelerometer's.

    acceleration, displacement: blocks on clocks that agree to a few milliseconds, one sensor's measurements in time
    order; settings: of the filter; window_s: length of a window, s, longer is less noisy. Gauss-Newton in three steps.
    """
    origin_ns = int(displacement.time_ns[0] // 2 + displacement.time_ns[-1] // 2)
    first, last = int(displacement.time_ns[0]), int(displacement.time_ns[-1])
    count = max(2, round((last - first) / NANOSECONDS / window_s))
    edges = np.linspace(first, last, count + 1).astype(np.int64)
    middles = edges[:-1] // 2 + edges[1:] // 2
    total, line = np.zeros(count), np.zeros(2)
    course = ClockCourse(middles, total, total, origin_ns, 0.0, 0.0, np.zeros((2, 2)))
    for _ in range(PASSES):
        information, gradient = _sums(acceleration, course.corrected(displacement), settings, edges)
        step, covariance = _line(information, gradient, seconds(middles, origin_ns))
        with np.errstate(divide="ignore", invalid="ignore"):
            own = np.where(information > 0, gradient / information, 0.0)
            std = np.where(information > 0, 1.0 / np.sqrt(information), np.inf)
        lateness = course.at(middles) + own
        line = line + step
        course = ClockCourse(middles, lateness, std, origin_ns, float(line[0]), float(line[1]), covariance)
    return course


def _sums(
    acceleration: Acceleration, displacement: Displacement, settings: KalmanSettings, edges: Nanoseconds
) -> tuple[Floats, Floats]:
    """Information (windows,) 1/s² about each window's lateness, and the information times the lateness."""
    fused = smooth(acceleration, displacement, settings)
    found = fused.innovation
    used = (found.verdict == ACCEPTED) | (found.verdict == REACQUIRED)
    variance = used_variance(displacement, found)
    velocity = velocity_at(fused.estimate, displacement.time_ns)
    response = _response(acceleration, replace(displacement, value_m=velocity, variance_m2=variance), settings)
    e, g, s = found.value_m[used], response.value_m, found.variance_m2[used]
    window = np.clip(np.searchsorted(edges, found.time_ns[used], side="right") - 1, 0, len(edges) - 2)
    # The innovations may scatter more than the filter was told.
    noise = max(float(np.median(e**2 / s)) / MEDIAN_OF_SQUARE, 1e-12)
    count = len(edges) - 1
    information = np.bincount(window, g * g / s, count) / noise
    return information, np.bincount(window, e * g / s, count) / noise


def _response(acceleration: Acceleration, error: Displacement, settings: KalmanSettings) -> Innovation:
    """The innovations that the measurements' error alone would give."""
    stream = KalmanFilter(linear(settings))
    stream.push(error)
    return joined([item for item in stream.push(standing_still(acceleration)) if isinstance(item, Innovation)])


def _line(information: Floats, gradient: Floats, time_s: Floats) -> tuple[Floats, Floats]:
    """Offset and skew (2,) through the windows, weighted by their information, and their covariance (2, 2)."""
    columns = np.stack([np.ones_like(time_s), time_s])
    normal = (columns * information) @ columns.T
    covariance = np.linalg.pinv(normal, hermitian=True)
    return np.asarray(covariance @ (columns @ gradient)), np.asarray(covariance)
