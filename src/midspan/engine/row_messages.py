"""What of a result's rows, innovations and events is worth telling, in sentences."""

import numpy as np

from midspan.fusion.blocks import REJECTED
from midspan.records import Estimate, Event, Innovation, Status
from midspan.signals.health import runs
from midspan.signals.stamps import shown

# A share of rejections above this is worth a warning.
NOTABLE_REJECTED = 0.02
# Events of one kind that are warnings.
MAX_WARNED = 3


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


def event_warnings(events: tuple[Event, ...]) -> list[str]:
    """The texts of the events; of a kind that comes often only how often."""
    found = []
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
        share = float(np.mean(rows.status == status))
        if share > 0.0:
            found.append(f"{100 * share:.2g} % of the rows{along} are {status.word}: no measurement supports them.")
    return found
