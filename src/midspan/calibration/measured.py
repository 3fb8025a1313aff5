"""A sensor's measurements as the rows that calibration compares with the acceleration."""

import numpy as np

from midspan.records import NANOSECONDS, Floats, Nanoseconds

# Fewer measurements than this are not calibrated on.
MIN_MEASUREMENTS = 20


def measured_rows(time_ns: Nanoseconds, value: Floats, variance: Floats, origin_ns: int) -> Floats:
    """Rows (m, 3) for calibration: time (s), value counted from its first, variance (infinite where unusable)."""
    usable = np.isfinite(value) & np.isfinite(variance)
    if not usable.any():
        return np.empty((0, 3))
    filled = np.where(usable, value - value[np.argmax(usable)], 0.0)
    return np.column_stack(((time_ns - origin_ns) / NANOSECONDS, filled, np.where(usable, variance, np.inf)))
