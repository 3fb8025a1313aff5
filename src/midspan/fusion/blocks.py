"""What the estimator gives out, as records: rows, innovations, and what it decided in the words of the field."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.records import Channel, Estimate, Event, Floats, Innovation, Nanoseconds, joined

# The motion's first velocity lies within three times what the sensors say of its size; of the core too.
VELOCITY_WITHIN = 3.0
# What became of a measurement, in its innovation.
ACCEPTED, REJECTED, REACQUIRED = 0, 1, 2

Codes = NDArray[np.uint8]
# Stamps (n,), and of each axis displacement, variance, velocity, source and status.
RowArrays = tuple[Nanoseconds, Sequence[tuple[Floats, Floats, Floats, Codes, Codes]]]
InnovationArrays = tuple[Nanoseconds, Floats, Floats, NDArray[np.int8]]
# Of the core: what happened (its place in TEXTS), when (ns), to which channel, its size and the standard deviation of
# that (mm; of a clock ms), and of outliers in a row how many and how long (s).
Report = tuple[int, int, int, float, float, int, float]
# Rows or None, innovations of each channel, events, variance of the zero of each axis.
OutputArrays = tuple[RowArrays | None, Sequence[InnovationArrays], Sequence[Report], Sequence[float]]

# Of each code of a report the event's kind and text.
TEXTS = (
    ("late", "Measurements of {sensor} arrived too late and are left out."),
    ("overflow", "More than {max_waiting} measurements wait for samples of acceleration; the oldest are left out."),
    (
        "rejected",
        "{count} consecutive measurements of {name} were rejected over {lasting_s:.2f} s (first innovation "
        "{size_mm:.2f} mm): they contradict the other sensors. The target may have been occluded, or the tracker "
        "followed something else.",
    ),
    (
        "rejected",
        "A measurement of {name} differs from the prediction by {off}, faster than any real motion; it is left out. "
        "Check the sensor and its connection.",
    ),
    (
        "level_shift",
        "The zero of {name} shifted by {off}; the displacement keeps its zero. Check whether the target or the "
        "sensor has moved.",
    ),
    ("level_shift", "The zero of {name} returned to its value before the shift."),
    (
        "acceleration",
        "The prediction differed from {name} by {off}: the acceleration was wrong, and the band is wider there. "
        "Check the accelerometer's range and mounting.",
    ),
    (
        "reacquired",
        "The prediction had drifted: {name} differed by {off}, and the estimator restarted from it.",
    ),
    ("noise", "The noise of {name} rose suddenly: a measurement differs by {off}; its variance is raised."),
    (
        "clock",
        "The clock of {sensor} stepped relative to the accelerometer's: {moved} are added to its time stamps from "
        "here on. Find out what set a clock.",
    ),
)
EVENT_KINDS = frozenset(kind for kind, _ in TEXTS)
# Of these the whole point is reported, not one of its axes.
OF_THE_POINT = ("late", "overflow")


@dataclass(frozen=True, slots=True)
class Rows:
    """What a push gave: rows of each axis, innovations of each channel as the best hypothesis saw them, events.

    zero_variance_m2 (axes,): variance of the datum at the last row, the part that all rows have in common.
    """

    estimates: tuple[Estimate, ...]
    innovations: tuple[Innovation, ...]
    events: tuple[Event, ...]
    zero_variance_m2: tuple[float, ...] = ()


def joined_rows(blocks: Sequence[Rows]) -> Rows:
    """One block out of several, in their order."""
    estimates = [block.estimates for block in blocks if block.estimates]
    innovations = [block.innovations for block in blocks if block.innovations]
    return Rows(
        tuple(joined(axis) for axis in zip(*estimates, strict=True)),
        tuple(joined(channel) for channel in zip(*innovations, strict=True)),
        tuple(event for block in blocks for event in block.events),
        next((block.zero_variance_m2 for block in reversed(blocks) if block.zero_variance_m2), ()),
    )


def rows_of(output: OutputArrays, channels: Sequence[Channel], max_waiting: int) -> Rows:
    """One output of the core as records; max_waiting: this many measurements may wait for samples."""
    rows, innovations, reports, zero = output
    return Rows(
        () if rows is None else tuple(Estimate(rows[0], *axis) for axis in rows[1]),
        tuple(Innovation(*channel) for channel in innovations),
        tuple(_event(report, channels, max_waiting) for report in reports) if reports else (),
        tuple(zero),
    )


def _event(report: Report, channels: Sequence[Channel], max_waiting: int) -> Event:
    code, time_ns, number, size_mm, std_mm, count, lasting_s = report
    (kind, text), channel = TEXTS[code], channels[number]
    reported = text.format(
        sensor=channel.sensor,
        target=channel.target,
        name=f"{channel.sensor}, target {channel.target}",
        off=f"{size_mm:.2f} ± {std_mm:.2f} mm",
        # Of a clock the size is a time.
        moved=f"{size_mm:.1f} ± {std_mm:.1f} ms",
        size_mm=size_mm,
        count=count,
        lasting_s=lasting_s,
        max_waiting=max_waiting,
    )
    return Event(time_ns, kind, reported, 0 if kind in OF_THE_POINT else channel.axis, channel.sensor)
