"""What of a result's rows, innovations and events is worth telling, in sentences."""

from collections.abc import Mapping, Sequence

import numpy as np

from midspan.fusion.blocks import REJECTED
from midspan.records import NANOSECONDS, Estimate, Event, Innovation, Measured, Nanoseconds, Status
from midspan.signals.stamps import shown

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


def unmeasured_ends(sampled_ns: Nanoseconds, measured: Mapping[str, Sequence[Measured]], rows: Estimate) -> list[str]:
    """A sentence where the rows begin or end more than a second inside the span of acceleration and measurements.

    sampled_ns (n,): stamps of the acceleration; measured: the blocks of each sensor.
    """
    stamps = [block.time_ns for listed in measured.values() for block in listed]
    first, last = int(rows.time_ns[0]), int(rows.time_ns[-1])
    begun = max(min(int(one[0]) for one in stamps), int(sampled_ns[0]))
    ended = min(max(int(one[-1]) for one in stamps), int(sampled_ns[-1]))
    late_s, early_s = (first - begun) / NANOSECONDS, (ended - last) / NANOSECONDS
    span = f"{shown(begun)} to {shown(first)}"
    late = [f"Nothing was measured from {span}; the result begins there, {late_s:.1f} s late."]
    text = f"The target was lost from {shown(last)} to the end; the result stops there, {early_s:.1f} s early."
    return (late if late_s > 1.0 else []) + ([text] if early_s > 1.0 else [])
