"""When a camera lost its target for more than a few seconds, and when it saw it again: events, and what to warn of."""

import numpy as np

from midspan.engine.sensor_series import SensorSeries
from midspan.records import NANOSECONDS, Event
from midspan.signals.health import Mask, runs
from midspan.signals.stamps import shown

# So many seconds, and so many usual intervals, without a measurement are worth an event.
LOST_S, LOST_INTERVALS = 3.0, 5.0


def lost_events(seen: SensorSeries, dark: Mask) -> tuple[Event, ...]:
    """An event `lost` where a camera's target is lost for more than a few seconds, and one `seen` where it is back.

    dark (n,): frames that were black.
    """
    found = []
    for start, end, black in _stretches(seen, dark):
        sensor, time_ns = seen.sensor, seen.time_ns
        since = int(time_ns[start])
        back = end < len(time_ns)
        lasting = (int(time_ns[end if back else -1]) - since) / NANOSECONDS
        why = "it is dark" if black else "the target is lost"
        until = f"for {lasting:.1f} s" if back else f"to the end, {lasting:.1f} s later"
        found.append(Event(since, "lost", f"{sensor}: {why} {until}"))
        if back:
            found.append(Event(int(time_ns[end]), "seen", f"{sensor}: the target is seen again"))
    return tuple(found)


def lost_warnings(seen: SensorSeries, dark: Mask) -> tuple[str, ...]:
    """A sentence where the target was lost in the light, for all such stretches together; the night is no fault."""
    time_ns = seen.time_ns
    stretches = [(start, end) for start, end, black in _stretches(seen, dark) if not black]
    lost = [(int(time_ns[start]), int(time_ns[min(end, len(time_ns) - 1)]), end) for start, end in stretches]
    if not lost:
        return ()
    total = sum(to - since for since, to, _ in lost) / NANOSECONDS
    since, to, last = max(lost, key=lambda one: one[1] - one[0])
    end = "the end" if last == len(time_ns) else shown(to)
    many = f" in {len(lost)} stretches, the longest" if len(lost) > 1 else ""
    return (
        f"{seen.sensor}: the target was lost for {total:.1f} s{many} from {shown(since)} to {end}; nothing was "
        "measured with this camera then. Look at what stood in front of it, and at its region.",
    )


def _stretches(seen: SensorSeries, dark: Mask) -> list[tuple[int, int, bool]]:
    """First row, the row after the last one, and whether it is dark, of each long segment without a measurement."""
    time_ns, blind = seen.time_ns, ~np.isfinite(seen.value_m)
    if not blind.any() or blind.all():
        return []
    usual = float(np.median(np.diff(time_ns))) / NANOSECONDS
    least_ns = round(max(LOST_S, LOST_INTERVALS * usual) * NANOSECONDS)
    found = []
    for start, end in runs(blind):
        lasting = int(time_ns[min(end, len(blind) - 1)]) - int(time_ns[start])
        if lasting > least_ns:
            found.append((start, end, bool(np.mean(dark[start:end]) > 0.5)))
    return found
