"""What of a result's rows, innovations and events is worth telling, in sentences."""

import numpy as np

from midspan.fusion.blocks import REJECTED
from midspan.records import Estimate, Event, Innovation, Status

# A share of rejections above this is worth a warning.
NOTABLE_REJECTED = 0.02
# Events of one kind that are warnings.
MAX_WARNED = 3


def event_warnings(events: tuple[Event, ...]) -> list[str]:
    """The texts of the events but of those that say that all is well again; of what comes often only how often."""
    found = []
    events = tuple(event for event in events if event.kind != "seen")
    for kind in dict.fromkeys(event.kind for event in events):
        texts = [event.text for event in events if event.kind == kind]
        rest = (
            [f"{len(texts) - MAX_WARNED} more such stretches stand in the events."] if len(texts) > MAX_WARNED else []
        )
        found += [*texts[:MAX_WARNED], *rest]
    return found


def rejected_share(innovation: Innovation) -> float:
    """Share of the measurements that were met and rejected."""
    return float(np.mean(innovation.verdict == REJECTED)) if len(innovation.verdict) else 0.0


def shares(innovation: Innovation, rows: Estimate, along: str = "") -> list[str]:
    """A sentence for many rejected measurements, and for rows that none supports; along: a second axis in words."""
    found = []
    rejected = rejected_share(innovation)
    if rejected > NOTABLE_REJECTED:
        found.append(f"{100 * rejected:.1f} % of the measurements{along} were rejected as outliers.")
    for status in (Status.COASTING, Status.LOST):
        own = rows.status == status
        if own.any():
            share, widest = 100.0 * float(np.mean(own)), 1.96e3 * float(np.sqrt(np.max(rows.variance_m2[own])))
            found.append(
                f"{share:.2g} % of the rows{along} are {status.word}: no measurement supports them; they are known to "
                f"± {widest:.3g} mm at worst (95 %)."
            )
    return found
