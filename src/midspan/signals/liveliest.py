"""Where in a record the acceleration varies most."""

import numpy as np

from midspan.records import NANOSECONDS, Floats, Nanoseconds

# Stretches that begin so far (s) apart are compared.
LOOK_S = 10.0


def liveliest(time_ns: Nanoseconds, value: Floats, span_ns: tuple[int, int], length_s: float) -> int | None:
    """Where the segment of `length_s` begins (ns) in which values (n,) at times (n,) vary most, each about its mean.

    span_ns: first and last instant that it may contain. None where it is the first one, or only one fits.
    """
    length_ns = round(length_s * NANOSECONDS)
    begins = np.arange(span_ns[0], span_ns[1] - length_ns + 1, round(LOOK_S * NANOSECONDS))
    if len(begins) < 2:
        return None
    low, high = np.searchsorted(time_ns, begins), np.searchsorted(time_ns, begins + length_ns)
    # About the whole's mean first: squares of gravity would leave few digits for the motion.
    centred = value - np.mean(value)
    sums = np.cumsum(np.vstack((np.zeros(2), np.column_stack((centred, centred**2)))), axis=0)
    mean = (sums[high] - sums[low]) / np.maximum(high - low, 1)[:, None]
    best = int(np.argmax(mean[:, 1] - mean[:, 0] ** 2))
    return int(begins[best]) if best else None
