"""A sensor's measurements beside the acceleration: as rows for calibration, and the frames that are used."""

import numpy as np

from midspan.recording.streams.span import inside
from midspan.records import NANOSECONDS, Floats, Nanoseconds


def measured_rows(time_ns: Nanoseconds, value: Floats, variance: Floats, origin_ns: int) -> Floats:
    """Rows (m, 3) for calibration: time (s), value counted from its first, variance (infinite where unusable)."""
    usable = np.isfinite(value) & np.isfinite(variance)
    if not usable.any():
        return np.empty((0, 3))
    filled = np.where(usable, value - value[np.argmax(usable)], 0.0)
    return np.column_stack(((time_ns - origin_ns) / NANOSECONDS, filled, np.where(usable, variance, np.inf)))


def frames_used(times_ns: Nanoseconds, acceleration_ns: Nanoseconds, margin_ns: int) -> slice:
    """Frames from the first one used: the file's first where the streams start together, else the first in both."""
    overlapping = inside(times_ns, int(acceleration_ns[0]), int(acceleration_ns[-1]) + margin_ns)
    if times_ns[0] >= acceleration_ns[0] - margin_ns:
        return slice(0, overlapping.stop)
    return overlapping
