"""What the whole record shows of a displacement sensor's values: which of them are wrong, seen afterwards."""

import numpy as np

from midspan.calibration.crowd import crowd_of_outliers
from midspan.calibration.fit import Pair, best_corner
from midspan.calibration.held_values import held_values
from midspan.calibration.measured import MIN_MEASUREMENTS, measured_rows
from midspan.records import Acceleration, Displacement, Nanoseconds, seconds
from midspan.signals.health import Mask
from midspan.signals.stamps import inside
from midspan.signals.stuck import resolution, stuck


def wrong_values(measured: Displacement, acceleration: Acceleration) -> Nanoseconds:
    """Stamps (k,) of the values that contradict both the acceleration and the rest of the values.

    measured: in metres on the accelerometer's clock. They are frozen, or stuck while their noise goes on, or a crowd of
    outliers; a filter takes the first ones of them for motion.
    """
    covered = inside(measured.time_ns, int(acceleration.time_ns[0]), int(acceleration.time_ns[-1]))
    time_ns, value = measured.time_ns[covered], measured.value_m[covered]
    if np.count_nonzero(np.isfinite(value)) < MIN_MEASUREMENTS:
        return time_ns[:0]
    first = int(time_ns[0])
    pushed = acceleration.value_m_s2 - np.mean(acceleration.value_m_s2)
    shaken = np.column_stack((seconds(acceleration.time_ns, first), pushed, acceleration.noise_density))
    wrong = stuck(seconds(time_ns, first), value, shaken, resolution_m=resolution(value))
    rows = measured_rows(time_ns, value, np.where(wrong | ~np.isfinite(value), np.inf, 1.0), first)
    density = float(np.median(acceleration.noise_density))
    pair = Pair(shaken / np.array([1.0, 1.0, density]), rows, 1.0)
    wrong |= crowd_of_outliers(pair)
    return time_ns[wrong | _held(pair, wrong)]


def _held(pair: Pair, wrong: Mask) -> Mask:
    """Values (m,) of a sensor that is stuck, as all that are not `wrong` (m,) show."""
    rows = pair.rows.copy()
    rows[wrong, 2] = np.inf
    right = Pair(pair.samples, rows, 1.0)
    if np.count_nonzero(np.isfinite(rows[:, 2])) < MIN_MEASUREMENTS:
        return np.zeros(len(rows), dtype=bool)
    return held_values(right, best_corner(right, 0.0), pair.rows)
