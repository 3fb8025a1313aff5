"""Time stamps: segments of them as slices, and how a person reads one."""

from datetime import UTC, datetime

import numpy as np

from midspan.records import NANOSECONDS, Nanoseconds

# Stamps above this are taken for epoch times when they are shown (1980).
EPOCH_FROM_NS = 315_532_800 * NANOSECONDS


def shown(time_ns: int) -> str:
    """A time stamp for a person: seconds, or date and time where it is an epoch."""
    if time_ns >= EPOCH_FROM_NS:
        return datetime.fromtimestamp(time_ns / NANOSECONDS, UTC).isoformat(timespec="milliseconds")
    return f"{time_ns / NANOSECONDS:.3f} s"


def inside(time_ns: Nanoseconds, first_ns: int, last_ns: int) -> slice:
    """The slice of increasing stamps (n,) that lie from `first_ns` to `last_ns`, both included."""
    return slice(
        int(np.searchsorted(time_ns, first_ns, side="left")), int(np.searchsorted(time_ns, last_ns, side="right"))
    )


def frames_used(times_ns: Nanoseconds, acceleration_ns: Nanoseconds, margin_ns: int) -> slice:
    """Frames from the first one used: the file's first where the streams start together, else the first in both."""
    overlapping = inside(times_ns, int(acceleration_ns[0]), int(acceleration_ns[-1]) + margin_ns)
    if times_ns[0] >= acceleration_ns[0] - margin_ns:
        return slice(0, overlapping.stop)
    return overlapping
