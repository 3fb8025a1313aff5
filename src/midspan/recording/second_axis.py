"""The second image axis of a result: fused like the first one, or smoothed without an accelerometer."""

from dataclasses import dataclass

import numpy as np

from midspan.errors import DataError
from midspan.fusion.runners import MethodSettings
from midspan.recording.fusing.fuse import FusionInputs, fuse
from midspan.recording.sensor_series import SensorSeries
from midspan.recording.stored.calibration import Calibration
from midspan.records import Estimate, Event, Floats, Innovation, Nanoseconds, part

# Without an accelerometer only a smoother bridges the time between frames.
TRACKED_METHOD = "smoother"


@dataclass(frozen=True, slots=True)
class SecondAxis:
    """Displacement along the second image axis at the rows of the first.

    fused: whether with an accelerometer; method: of the fusion; events: what the gate and the sensors did along it;
    measured: what each sensor measured along it.
    """

    axis: str
    fused: bool
    method: str
    estimate: Estimate
    innovation: Innovation
    events: tuple[Event, ...] = ()
    measured: tuple[SensorSeries, ...] = ()

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


def second_axis(
    inputs: FusionInputs, calibration: Calibration, rows_ns: Nanoseconds, method: str, settings: MethodSettings
) -> SecondAxis:
    """Fuse the second axis with the same method and give the rows (n,) of the first.

    Raises DataError where the two acceleration columns are not of the same instants.
    """
    camera = calibration.first_camera
    assert camera is not None
    fused, _ = fuse(inputs, method, settings) if camera.fused else fuse(inputs, TRACKED_METHOD)
    place = np.minimum(np.searchsorted(fused.estimate.time_ns, rows_ns), len(fused.estimate.time_ns) - 1)
    if not np.array_equal(fused.estimate.time_ns[place], rows_ns):
        raise DataError(
            "accelerometer.value_x and value_y must be of the same instants; their time stamps differ. Bring both into "
            "one file with one time column."
        )
    return SecondAxis(
        axis=camera.direction,
        fused=camera.fused,
        method=method if camera.fused else TRACKED_METHOD,
        estimate=part(fused.estimate, place),
        innovation=fused.innovation,
        events=fused.events,
    )
