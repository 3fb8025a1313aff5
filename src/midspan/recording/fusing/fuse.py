"""What is uncertain of a recording's sensors, and the fusion of one series of measurements with it."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.errors import UntrustedError
from midspan.fusion.path import at
from midspan.fusion.runners import MethodSettings, run_method
from midspan.fusion.streams import KalmanSettings, Smoothed
from midspan.recording.in_turn import in_turn
from midspan.recording.streams.span import shown
from midspan.records import Acceleration, Displacement, Estimate, Floats, Nanoseconds, Source


@dataclass(frozen=True, slots=True)
class SensorError:
    """What is uncertain of one sensor: relative standard deviation of its scale, and of its clock in s."""

    source: Source
    relative_scale_std: float = 0.0
    clock_std_s: float = 0.0


@dataclass(frozen=True, slots=True)
class LevelError:
    """From an instant on a sensor's measurements count from a zero that is known to a standard deviation (m) only."""

    source: Source
    from_ns: int
    std_m: float


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
    """What is fused: acceleration, displacement measurements of all sensors, the filter's settings.

    sampled: the acceleration without a sample that was put before the first one, None where there is no such sample;
    zero_ns: the instant that the displacement counts from (the first frame), None for a displacement sensor's own zero;
    level_m: taken off the displacement before fusing, so that a height of 123 m does not start the filter 123 m away;
    errors: what is uncertain of each sensor's calibration; levels: zeros that are uncertain, and errors that come back
    with the motion and do not average out. cameras: what each of two measured, all of it.
    """

    acceleration: Acceleration
    displacement: Displacement
    kalman: KalmanSettings
    zero_ns: int | None = None
    level_m: float = 0.0
    errors: tuple[SensorError, ...] = ()
    levels: tuple[LevelError | CourseError, ...] = ()
    sampled: Acceleration | None = None
    cameras: tuple[Displacement, ...] = ()


def fuse(inputs: FusionInputs, method: str, settings: MethodSettings | None = None) -> tuple[Smoothed, float]:
    """Run a method of `midspan methods`; rows count from the zero, whose variance (m²) is the second result.

    Their variance holds all that is uncertain, as the most that it can be. settings: the keys of [fusion] that single
    methods use; its filter settings are those of `inputs`. Raises UntrustedError where the method ran away.
    """
    settings = replace(settings or MethodSettings(), kalman=inputs.kalman)
    one = method in ("fir", "two-stage-fir")
    measured = in_turn(inputs.displacement) if one else inputs.displacement
    acceleration = inputs.sampled if one and inputs.sampled is not None else inputs.acceleration
    found = run_method(method, acceleration, measured, settings)
    rows = found.estimate
    finite = np.isfinite(rows.displacement_m) & np.isfinite(rows.variance_m2)
    if not finite.all():
        raise UntrustedError(
            f"{method} ran away: its rows must be finite numbers, and from "
            f"{shown(int(rows.time_ns[np.argmin(finite)]))} on they are not. Leave fusion.literal out, or choose "
            "another fusion.method."
        )
    zero_m, variance_m2 = -inputs.level_m, 0.0
    if inputs.zero_ns is not None:
        value, variance = at(rows, np.array([inputs.zero_ns]))
        zero_m, variance_m2 = float(value[0]), float(variance[0])
    variance = rows.variance_m2 + variance_m2 + _uncertain(inputs, rows)
    estimate = replace(rows, displacement_m=rows.displacement_m - zero_m, variance_m2=variance)
    return replace(found, estimate=estimate), variance_m2


def _uncertain(inputs: FusionInputs, rows: Estimate) -> Floats:
    """Variance (n,) of the rows by what is uncertain of the sensors, the whole displacement going with it."""
    variance = np.zeros(len(rows.time_ns))
    for error in inputs.errors:
        clock_s = error.clock_std_s if np.isfinite(error.clock_std_s) else 0.0
        variance += (error.relative_scale_std * rows.displacement_m) ** 2 + (clock_s * rows.velocity_m_s) ** 2
    for zero in inputs.levels:
        if isinstance(zero, CourseError):
            variance += np.interp(rows.time_ns, zero.time_ns, zero.std_m) ** 2
        else:
            variance += np.where(rows.time_ns >= zero.from_ns, zero.std_m**2, 0.0)
    return variance
