"""What is reported of a radar after a run: frames lost, targets seldom seen, and which of its events."""

from collections.abc import Sequence

from midspan.engine.radar_trace import RadarLog
from midspan.notices import Notice

# A target that is seen in a smaller share of the frames is reported.
MIN_SEEN = 0.9
# Events of the radar that are warnings as well.
REPORTED = ("new datum", "contradiction")


def radar_warnings(log: RadarLog, of_source: Sequence[Notice]) -> list[Notice]:
    """What the source reported, a sentence on frames that were not usable, and on each target that was seldom seen."""
    found = [*of_source]
    if log.lost:
        share = 100.0 * log.lost / log.frames
        found.append(
            Notice(
                "radar-data",
                f"radar: {log.lost} frames ({share:.2g} %) never arrived or hold interference: more power in all range "
                "bins than usual.",
            )
        )
    for item, used in zip(log.targets, log.used, strict=True):
        if used < MIN_SEEN * log.frames:
            share = 100.0 * used / log.frames
            found.append(
                Notice(
                    "radar-target",
                    f"radar: the target at {item.target.range_m:.2f} m was seen in {share:.3g} % of frames only.",
                )
            )
    return found
