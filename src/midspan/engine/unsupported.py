"""Stretches of a result that no measurement supports for so long that they are `lost`, told as events."""

import numpy as np

from midspan.records import Estimate, Event, Status
from midspan.signals.health import runs
from midspan.signals.stamps import shown


def unsupported_events(rows: Estimate) -> tuple[Event, ...]:
    """An event for each stretch of rows (n,) without measurements that comes to be lost."""
    return tuple(
        _unsupported(rows, start, stop)
        for start, stop in runs(rows.status != Status.TRACKING)
        if np.any(rows.status[start:stop] == Status.LOST)
    )


def _unsupported(rows: Estimate, start: int, stop: int) -> Event:
    widest = 1.96e3 * float(np.sqrt(np.max(rows.variance_m2[start:stop])))
    first, last = (int(rows.time_ns[i]) for i in (start, stop - 1))
    text = (
        f"No measurement supports the rows from {shown(first)} to {shown(last)}: the acceleration alone carries them, "
        f"at worst within ± {widest:.3g} mm (95 %)."
    )
    return Event(first, "lost", text)
