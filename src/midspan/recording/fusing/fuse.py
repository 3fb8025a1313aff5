"""What is uncertain of a recording's sensors, and what is compared to find out."""

from dataclasses import dataclass

from midspan.fusion.streams import KalmanSettings
from midspan.records import Acceleration, Displacement, Floats, Nanoseconds, Source


@dataclass(frozen=True, slots=True)
class SensorError:
    """What is uncertain of one sensor: relative standard deviation of its scale, and of its clock in s."""

    source: Source
    relative_scale_std: float = 0.0
    clock_std_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CourseError:
    """A sensor's zero wanders, and is known at stamps (n,) to standard deviations (n,) in m only.

    source: the sensor, or several whose zeros wander together.
    """

    source: Source | tuple[Source, ...]
    time_ns: Nanoseconds
    std_m: Floats


@dataclass(frozen=True, slots=True)
class FusionInputs:
    """What is compared: acceleration, measurements of all sensors in the order of time, the filter's settings.

    errors: what is uncertain of each sensor's calibration. cameras: what each of several measured, all of it.
    """

    acceleration: Acceleration
    displacement: Displacement
    kalman: KalmanSettings
    errors: tuple[SensorError, ...] = ()
    cameras: tuple[Displacement, ...] = ()
