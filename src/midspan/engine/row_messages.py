"""What of a result's rows, innovations, events and radar frames is worth reporting, in sentences."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from midspan.engine.radar_trace import RadarLog
from midspan.fusion.blocks import REJECTED
from midspan.notices import Notice
from midspan.records import NANOSECONDS, Estimate, Event, Innovation, Measured, Nanoseconds, Status
from midspan.signals.stamps import shown

# A share of rejections above this is worth a warning.
NOTABLE_REJECTED = 0.02
# Events of one kind that are warnings.
MAX_WARNED = 3
# A sensor's clock that was set is set once or twice in a record; one of more steps runs unevenly.
MAX_CLOCK_STEPS = 2
# Coasting is reported where it holds more than this share of the rows' summed variance. Less widens the rms band by
# 2.5 % at most, and each row's own band says it.
NOTABLE_VARIANCE = 0.05
# Under which code an event of each kind is reported.
EVENT_CODES = {
    "rejected": "outliers",
    "noise": "outliers",
    "late": "outliers",
    "overflow": "outliers",
    "level_shift": "zero-shifted",
    "acceleration": "acceleration-wrong",
    "reacquired": "acceleration-wrong",
    "clock": "clock-differs",
    "rate": "method-rates",
    "literal": "literal",
    "frozen": "frozen",
    "lost": "lost",
    "new datum": "radar-zero",
    "contradiction": "radar-zero",
}
# A target that is seen in a smaller share of the frames is reported.
MIN_SEEN = 0.9
# What to do where nothing was measured.
SEEN = "Keep the target visible and lit in all frames."
# Events of the radar that are warnings as well.
REPORTED = ("new datum", "contradiction")


def event_warnings(events: tuple[Event, ...]) -> list[Notice]:
    """The texts of the events but of those that say that all is well again; of what comes often only how often."""
    found = list[Notice]()
    events = tuple(event for event in events if event.kind != "seen")
    for kind in dict.fromkeys(event.kind for event in events):
        of_kind = [event for event in events if event.kind == kind]
        texts = _clock_texts(of_kind) if kind == "clock" else [event.text for event in of_kind]
        if len(texts) > MAX_WARNED:
            texts[MAX_WARNED:] = [f"The events list {len(texts) - MAX_WARNED} more."]
        found += [Notice(EVENT_CODES[kind], text) for text in texts]
    return found


def _clock_texts(events: Sequence[Event]) -> list[str]:
    """The texts of steps of clocks; of a sensor whose clock was corrected at many instants one sentence."""
    found = list[str]()
    for sensor in dict.fromkeys(event.sensor for event in events):
        steps = [event for event in events if event.sensor == sensor]
        if len(steps) <= MAX_CLOCK_STEPS:
            found += [event.text for event in steps]
            continue
        name, steps_ns = sensor or "a sensor", [event.time_ns for event in steps]
        found.append(
            f"The clock of {name} runs unevenly relative to the accelerometer's: its time stamps were corrected "
            f"{len(steps_ns)} times from {shown(min(steps_ns))} to {shown(max(steps_ns))}. Likely causes: time stamps "
            "at arrival with a varying delay, or a clock set over a network. Use the sensor's own time stamps. The "
            "events list each correction."
        )
    return found


def rejected_share(innovation: Innovation) -> float:
    """Share of the measurements that were met and rejected."""
    return float(np.mean(innovation.verdict == REJECTED)) if len(innovation.verdict) else 0.0


def shares(innovation: Innovation, rows: Estimate, along: str = "") -> list[Notice]:
    """A sentence for many rejected measurements, and for rows that none supports; along: a second axis in words."""
    found = []
    rejected = rejected_share(innovation)
    if rejected > NOTABLE_REJECTED:
        text = f"{100 * rejected:.1f} % of the measurements{along} were rejected as outliers. Check the innovations in "
        text += "the report: the target was occluded or moves on its own."
        found.append(Notice("outliers", text))
    for status in (Status.COASTING, Status.LOST):
        own = rows.status == status
        held = float(np.sum(rows.variance_m2[own])) / float(np.sum(rows.variance_m2))
        if own.any() and (status is Status.LOST or held > NOTABLE_VARIANCE):
            share, widest = 100.0 * float(np.mean(own)), 1.96e3 * float(np.sqrt(np.max(rows.variance_m2[own])))
            text = (
                f"{share:.2g} % of the rows{along} are {status.word} (no measurement): their 95 % band is up to ± "
                f"{widest:.3g} mm. Keep the target visible; the report shows when it was not."
            )
            found.append(Notice(status.word, text))
    return found


def unmeasured_ends(
    sampled_ns: Nanoseconds, measured: Mapping[str, Iterable[Measured]], rows: Estimate
) -> list[Notice]:
    """A sentence where the rows begin or end more than a second inside the span of acceleration and measurements.

    sampled_ns (n,): stamps of the acceleration; measured: the blocks of each sensor.
    """
    stamps = [block.time_ns for listed in measured.values() for block in listed]
    first, last = int(rows.time_ns[0]), int(rows.time_ns[-1])
    begun = max(min(int(one[0]) for one in stamps), int(sampled_ns[0]))
    ended = min(max(int(one[-1]) for one in stamps), int(sampled_ns[-1]))
    late_s, early_s = (first - begun) / NANOSECONDS, (ended - last) / NANOSECONDS
    span = f"{shown(begun)} to {shown(first)}"
    late = [Notice("lost", f"No measurement from {span}; the result begins {late_s:.1f} s late. {SEEN}")]
    text = f"The target was lost from {shown(last)} to the end; the result ends {early_s:.1f} s early. {SEEN}"
    return (late if late_s > 1.0 else []) + ([Notice("lost", text)] if early_s > 1.0 else [])


def radar_warnings(log: RadarLog, of_source: Sequence[Notice]) -> list[Notice]:
    """What the source reported, a sentence on frames that were not usable, and on each target that was seldom seen."""
    found = [*of_source]
    if log.lost:
        text = (
            f"radar: {log.lost} frames ({100.0 * log.lost / log.frames:.2g} %) are missing or have interference "
            "(raised power in all range bins). Check the network and for other radars nearby."
        )
        found.append(Notice("radar-data", text))
    for item, used in zip(log.targets, log.used, strict=True):
        if used < MIN_SEEN * log.frames:
            share = 100.0 * used / log.frames
            text = f"radar: the target {item.target.place} was visible in only {share:.3g} % of the frames. "
            text += "Aim at an unobstructed target."
            found.append(Notice("radar-target", text))
    return found
