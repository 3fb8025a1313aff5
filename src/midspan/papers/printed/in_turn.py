"""One sensor at a time, for methods that were made for one series of displacements: the others fill its gaps."""

import numpy as np

from midspan.papers.printed.complementary import LONGEST_STEPS
from midspan.records import NANOSECONDS, Displacement, part
from midspan.signals.health import Mask


def in_turn(measured: Displacement) -> Displacement:
    """The measurements (k,) of the sensor whose turn it is, in time order; those of one sensor as they are.

    measured: (m,) of all sensors, in time order. The turn is that of the sensor whose measurements say most in a
    second; where it measures nothing, that of the next one. Measurements of several sensors at uneven instants are no
    series that a linear filter can be made for: the motion would be aliased.
    """
    sources = [int(code) for code in np.unique(measured.source)]
    if len(sources) < 2:
        return measured
    order = np.argsort(np.argsort([_noise(measured, source) for source in sources]))
    ranks = np.repeat(order[:, None], len(measured.time_ns), axis=1)
    sees = np.stack([_sees(measured, source) for source in sources])
    # Where nobody sees, the best one's frames stay: they tell when it did not.
    turn = np.argmin(np.where(sees, ranks, ranks + len(sources)), axis=0)
    return part(measured, measured.source == np.array(sources, dtype=np.uint8)[turn])


def _noise(measured: Displacement, source: int) -> float:
    """Variance of a sensor's usual measurement times the seconds to the next; infinite where it has none."""
    usable = _usable(measured, source)
    return float(np.median(measured.variance_m2[usable])) * _interval_s(measured, source) if usable.any() else np.inf


def _interval_s(measured: Displacement, source: int) -> float:
    stamps = measured.time_ns[measured.source == source]
    return float(np.median(np.diff(stamps))) / NANOSECONDS if len(stamps) > 1 else 0.0


def _usable(measured: Displacement, source: int) -> Mask:
    usable: Mask = (measured.source == source) & np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2)
    return usable


def _sees(measured: Displacement, source: int) -> Mask:
    """At which stamps (m,) a sensor sees: its own frames, and what lies between two of them that are close enough."""
    usable = _usable(measured, source)
    seen = measured.time_ns[usable]
    if not len(seen):
        return usable
    place = np.searchsorted(seen, measured.time_ns)
    inner = (place > 0) & (place < len(seen))
    gap_ns = seen[np.minimum(place, len(seen) - 1)] - seen[np.maximum(place - 1, 0)]
    return usable | (inner & (gap_ns <= LONGEST_STEPS * _interval_s(measured, source) * NANOSECONDS))
