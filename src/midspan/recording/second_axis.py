"""The second image axis of a result: fused like the first one, or smoothed without an accelerometer."""

from dataclasses import dataclass

import numpy as np

from midspan.engine.sensor_series import SensorSeries
from midspan.records import Estimate, Event, Floats, Innovation


@dataclass(frozen=True, slots=True)
class SecondAxis:
    """Displacement along the second image axis at the rows of the first.

    fused: whether with an accelerometer; method: of the fusion; events: what the gate and the sensors did along it;
    measured: what each sensor measured along it; zero_std_m: as of a result.
    """

    axis: str
    fused: bool
    method: str
    estimate: Estimate
    innovation: Innovation
    events: tuple[Event, ...] = ()
    measured: tuple[SensorSeries, ...] = ()
    zero_std_m: float = 0.0

    @property
    def displacement_mm(self) -> Floats:
        """Displacement of each row, mm."""
        return 1e3 * self.estimate.displacement_m

    @property
    def displacement_std_mm(self) -> Floats:
        """Standard deviation of each row's displacement, mm."""
        return 1e3 * np.sqrt(self.estimate.variance_m2)

    @property
    def velocity_mm_s(self) -> Floats:
        """Velocity of each row, mm/s."""
        return 1e3 * self.estimate.velocity_m_s
