"""What a user is told of a radar after a run: frames lost, targets seldom seen, new zeros and their deviation."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from midspan.engine.radar_trace import RadarLog
from midspan.records import Estimate, Event

# A target that is seen in a smaller share of the frames is reported.
MIN_SEEN = 0.9
# Events of the radar that are warnings as well.
REPORTED = ("new datum", "contradiction")


def radar_warnings(log: RadarLog, of_source: Sequence[str]) -> list[str]:
    """What the source reported, a sentence on frames that never arrived, and on each target that was seldom seen."""
    found = [*of_source]
    if log.lost:
        share = 100.0 * log.lost / log.frames
        found.append(f"radar: {log.lost} frames ({share:.2g} %) never arrived.")
    for item, used in zip(log.targets, log.used, strict=True):
        if used < MIN_SEEN * log.frames:
            share = 100.0 * used / log.frames
            found.append(f"radar: the target at {item.target.range_m:.2f} m was seen in {share:.3g} % of frames only.")
    return found


def with_levels(events: Sequence[Event], rows: Estimate) -> tuple[Event, ...]:
    """The events with how well the rows know the displacement from each new zero of a target on."""
    known = np.sqrt(rows.variance_m2)
    found = []
    for event in events:
        if event.kind == "new datum":
            std_m = float(np.interp(event.time_ns, rows.time_ns, known))
            told = f"{event.text} The displacement is known to ± {1e3 * std_m:.3g} mm there (one standard deviation)."
            event = replace(event, text=told)
        found.append(event)
    return tuple(found)
