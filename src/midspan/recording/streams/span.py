"""Where two streams overlap in time."""

from datetime import UTC, datetime

import numpy as np

from midspan.errors import DataError
from midspan.records import NANOSECONDS, Nanoseconds

# Two streams share enough when it lasts this long, or holds this many steps of the slower one: a high-speed camera
# records a quarter of a second.
MIN_OVERLAP_S, MIN_OVERLAP_STEPS = 1.0, 100
# Stamps above this are taken for epoch times when they are shown (1980).
EPOCH_FROM_NS = 315_532_800 * NANOSECONDS


def shown(time_ns: int) -> str:
    """A time stamp for a person: seconds, or date and time where it is an epoch."""
    if time_ns >= EPOCH_FROM_NS:
        return datetime.fromtimestamp(time_ns / NANOSECONDS, UTC).isoformat(timespec="milliseconds")
    return f"{time_ns / NANOSECONDS:.3f} s"


def require_overlap(acceleration_ns: Nanoseconds, other_ns: Nanoseconds, section: str) -> None:
    """DataError unless the two streams share a second, or 100 steps of the slower one where that is less.

    section: the other stream's in the settings.
    """
    steps_ns = [float(np.median(np.diff(times))) for times in (acceleration_ns, other_ns) if len(times) > 1]
    least_s = min(MIN_OVERLAP_S, MIN_OVERLAP_STEPS * max(steps_ns, default=np.inf) / NANOSECONDS)
    first = max(int(acceleration_ns[0]), int(other_ns[0]))
    last = min(int(acceleration_ns[-1]), int(other_ns[-1]))
    if last - first >= least_s * NANOSECONDS:
        return
    if other_ns[-1] - other_ns[0] < least_s * NANOSECONDS:
        raise DataError(
            f"{section} must last {least_s:.3g} s or more; it has {len(other_ns)} stamps from "
            f"{shown(int(other_ns[0]))} to {shown(int(other_ns[-1]))}. Check that its file is whole, and its rate."
        )
    raise DataError(
        f"accelerometer and {section} do not overlap in time: the accelerometer runs from "
        f"{shown(int(acceleration_ns[0]))} to {shown(int(acceleration_ns[-1]))}, {section} from "
        f"{shown(int(other_ns[0]))} to {shown(int(other_ns[-1]))}; at least {least_s:.3g} s must "
        f"be shared. Bring the clocks together with {section}.start_s or accelerometer.start_s."
    )


def inside(time_ns: Nanoseconds, first_ns: int, last_ns: int) -> slice:
    """The slice of increasing stamps (n,) that lie from `first_ns` to `last_ns`, both included."""
    return slice(
        int(np.searchsorted(time_ns, first_ns, side="left")), int(np.searchsorted(time_ns, last_ns, side="right"))
    )
