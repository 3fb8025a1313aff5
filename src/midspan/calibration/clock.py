"""How a sensor's clock runs relative to the accelerometer's: its offset in windows of time, and the line through them.

A measurement whose stamp is early by τ is the displacement τ later. The innovations of one filter (see `whitening`) and
how they change with τ give, in each window, the score and the information about τ: its estimate and its deviation.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.whitening import SETTLING, Response, integrated, usable, whiten_columns
from midspan.records import NANOSECONDS, Acceleration, Displacement, Floats, Nanoseconds, nanoseconds, seconds
from midspan.signals.medians import MEDIAN_OF_SQUARE

# Gauss-Newton steps of the line: the first leaves little of what a cheap quartz makes of an hour.
PASSES = 4
# Innovations are clipped at this many standard deviations.
CLIPPED = 3.0
# Change of a lateness that slopes are taken over, s.
SLOPE_STEP_S = 1e-4
# Least information about an offset, 1/s², that counts as any.
NO_INFORMATION = 1e-30


@dataclass(frozen=True)
class Compared:
    """Rows (m, 3) of a sensor's time (s), displacement (m) and variance (m², finite), in time order, and samples (n, 3)
    of time, acceleration (m/s²) and its noise density ((m/s²)²/Hz).
    """

    samples: Floats
    rows: Floats

    @cached_property
    def response(self) -> Response:
        """The acceleration integrated twice."""
        whole = integrated(self.samples)
        return replace(whole, pieces=whole.pieces / np.array([1.0, self.density]))

    @cached_property
    def density(self) -> float:
        """The usual noise density of the acceleration, (m/s²)²/Hz."""
        return float(np.median(self.samples[:, 2]))

    @cached_property
    def level(self) -> np.polynomial.Polynomial:
        """The parabola of time (s) that integration leaves open, m."""
        time_s = self.rows[:, 0]
        return np.polynomial.Polynomial.fit(time_s, self.rows[:, 1] - self.response.at(time_s), 2)

    def innovations(self, late_s: Floats, wider_m: float = 0.0) -> Floats:
        """Innovations (m, c) of stamps that are late_s (m, c) later, in standard deviations.

        wider_m: added to each measurement's noise. The first ones, which settle the unknown start, are 0.
        """
        time_s, variance = self.rows[:, 0], self.rows[:, 2] + wider_m**2
        unit, at = float(np.median(variance)), time_s[:, None] + late_s
        values = self.rows[:, 1:2] - self.response.at(at) - self.level(at)
        rows = np.column_stack((time_s, variance / unit))
        w = whiten_columns(rows, values, self.response.pieces, self.density / unit, late_s=late_s)
        found = np.zeros_like(values)
        found[SETTLING:] = w.columns / np.sqrt(unit * w.variance)[:, None]
        return found

    def slopes(self, late_s: Floats, change: Floats) -> Floats:
        """How innovations change, 1/s, with a parameter that moves the stamps by it times `change` (m, c).

        late_s (m, 1): how late the stamps are.
        """
        ahead, behind = (self.innovations(late_s + step * change) for step in (SLOPE_STEP_S, -SLOPE_STEP_S))
        return (ahead - behind) / (2.0 * SLOPE_STEP_S)

    def near(self, begin: int, end: int, margin_s: float) -> "Compared":
        """Rows of a segment, with the samples up to a margin around them."""
        rows = self.rows[begin:end]
        edges = np.searchsorted(self.samples[:, 0], (rows[0, 0] - margin_s, rows[-1, 0] + margin_s))
        return Compared(self.samples[slice(*edges)], rows)

    def since(self, begin: int) -> "Compared":
        """The rows from one on, with all samples, which are integrated once."""
        part = Compared(self.samples, self.rows[begin:])
        vars(part).update(response=self.response, density=self.density)
        return part


def compared(acceleration: Acceleration, displacement: Displacement) -> tuple[Compared, NDArray[np.int64]]:
    """What is compared of two blocks, its times counted from the first sample, and which measurements these are."""
    first = int(acceleration.time_ns[0])
    pushed = acceleration.value_m_s2 - np.mean(acceleration.value_m_s2)
    samples = np.column_stack((seconds(acceleration.time_ns, first), pushed, acceleration.noise_density))
    variance = np.where(np.isfinite(displacement.value_m), displacement.variance_m2, np.inf)
    rows = np.column_stack((seconds(displacement.time_ns, first), displacement.value_m, variance))
    index = usable(rows, 0.0, (0.0, float(samples[-1, 0])))
    # A stamp that goes back is none.
    time_s = rows[index, 0]
    index = index[np.r_[True, time_s[1:] > np.maximum.accumulate(time_s)[:-1]]] if len(index) else index
    return Compared(samples, rows[index]), index


@dataclass(frozen=True, slots=True)
class Knots:
    """What windows of a record say of a clock: the first row of each, its lateness (s) beyond that of the stamps, the
    information about it (1/s²; its deviation is 1/√information), and the mean clipped square of its innovations.
    """

    first: NDArray[np.int64]
    late_s: Floats
    information: Floats
    square: Floats


def knots(one: Compared, late_s: Floats, edges: NDArray[np.int64]) -> Knots:
    """Lateness in windows that begin at rows `edges` (w,), of stamps that are late_s (m,) later."""
    r = one.innovations(late_s[:, None])[:, 0]
    g = one.slopes(late_s[:, None], np.ones((len(r), 1)))[:, 0]
    # The innovations may scatter more than the noise levels say.
    noise = max(float(np.median(r**2)) / MEDIAN_OF_SQUARE, 1.0)
    limit = CLIPPED * np.sqrt(noise)
    information = np.add.reduceat(g * g, edges) / noise
    score = -np.add.reduceat(g * np.clip(r, -limit, limit), edges) / noise
    calm = max(calm_variance(r), 1.0)
    square = np.add.reduceat(np.minimum(r**2 / calm, CLIPPED**2), edges) / np.diff([*edges, len(r)])
    return Knots(edges, score / np.maximum(information, NO_INFORMATION), information, square)


def calm_variance(r: Floats) -> float:
    """Variance of the calmest quarter of innovations (n,) in time: after a jump of a clock all are large."""
    return min(float(np.median(part**2)) for part in np.array_split(r, 4) if len(part)) / MEDIAN_OF_SQUARE


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


def clock_course(acceleration: Acceleration, displacement: Displacement, *, window_s: float = 60.0) -> ClockCourse:
    """Measure how the displacement's clock runs relative to the accelerometer's.

    acceleration, displacement: blocks on clocks that agree to a fraction of the motion's period, one sensor's
    measurements in time order; window_s: length of a window, s, longer is less noisy.
    """
    return drift(compared(acceleration, displacement)[0], window_s, int(acceleration.time_ns[0]))


def drift(
    one: Compared, window_s: float, first_ns: int = 0, line: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> ClockCourse:
    """How a clock runs, by Gauss-Newton steps of the line; first_ns: the instant that times are counted from; line: the
    one to start from, its lateness (s) at the third value (s) and its change (s/s).
    """
    time_s = one.rows[:, 0]
    count = max(2, round((time_s[-1] - time_s[0]) / window_s))
    bounds = np.linspace(time_s[0], time_s[-1], count + 1)
    edges, kept = np.unique(np.searchsorted(time_s, bounds[:-1]), return_index=True)
    at_s, middle = 0.5 * (bounds[:-1] + bounds[1:])[kept], 0.5 * float(time_s[0] + time_s[-1])
    late = np.array([line[0] + line[1] * (middle - line[2]), line[1]])
    columns = np.stack((np.ones_like(at_s), at_s - middle))
    for _ in range(PASSES):
        found = knots(one, late[0] + late[1] * (time_s - middle), edges)
        known = np.maximum(found.information, NO_INFORMATION)
        covariance = np.asarray(np.linalg.pinv((columns * known) @ columns.T, hermitian=True), dtype=float)
        lateness = late @ columns + found.late_s
        late = late + covariance @ (columns @ (known * found.late_s))
    std = np.where(known > NO_INFORMATION, 1.0 / np.sqrt(known), np.inf)
    at_ns, middle_ns = nanoseconds(at_s) + first_ns, round(NANOSECONDS * middle) + first_ns
    return ClockCourse(at_ns, lateness, std, middle_ns, float(late[0]), float(late[1]), covariance)
