"""What the core gives out as records: rows, innovations, events."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.decisions import Report, event_of
from midspan.records import Channel, Estimate, Event, Floats, Innovation, Nanoseconds

# The motion's first velocity lies within three times what the sensors say of its size; of the core too.
VELOCITY_WITHIN = 3.0
# What became of a measurement, in its innovation.
ACCEPTED, REJECTED, REACQUIRED = 0, 1, 2

Codes = NDArray[np.uint8]
# Stamps (n,), and of each axis displacement, variance, velocity, source and status.
RowArrays = tuple[Nanoseconds, Sequence[tuple[Floats, Floats, Floats, Codes, Codes]]]
InnovationArrays = tuple[Nanoseconds, Floats, Floats, NDArray[np.int8]]
# Rows or None, innovations of each channel, events, variance of the zero of each axis.
OutputArrays = tuple[RowArrays | None, Sequence[InnovationArrays], Sequence[Report], Sequence[float]]


@dataclass(frozen=True, slots=True)
class Rows:
    """What a push gave: rows of each axis, innovations of each channel as the best hypothesis saw them, events.

    zero_variance_m2 (axes,): variance of the datum at the last row, the part that all rows have in common.
    """

    estimates: tuple[Estimate, ...]
    innovations: tuple[Innovation, ...]
    events: tuple[Event, ...]
    zero_variance_m2: tuple[float, ...] = ()


def estimates_of(rows: RowArrays) -> tuple[Estimate, ...]:
    """The rows of each axis."""
    time_ns, axes = rows
    return tuple(Estimate(time_ns, *one) for one in axes)


def rows_of(output: OutputArrays, channels: Sequence[Channel], max_waiting: int) -> Rows:
    """One output of the core as records."""
    rows, innovations, reports, zero = output
    return Rows(
        () if rows is None else estimates_of(rows),
        tuple(Innovation(*one) for one in innovations),
        tuple(event_of(one, channels, max_waiting) for one in reports),
        tuple(zero),
    )
