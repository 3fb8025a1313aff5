"""What a sensor's displacement may be off by."""

from dataclasses import dataclass

from midspan.records import Floats, Nanoseconds, Source


@dataclass(frozen=True, slots=True, eq=False)
class CourseError:
    """A sensor's zero wanders, and is known at stamps (n,) to standard deviations (n,) in m only.

    source: the sensor, or several whose zeros wander together.
    """

    source: Source | tuple[Source, ...]
    time_ns: Nanoseconds
    std_m: Floats
