"""`kalman` over a whole record."""

from midspan.fusion.events import gate_events
from midspan.fusion.kalman import KalmanFilter, KalmanSettings
from midspan.fusion.smoother import Smoothed
from midspan.records import Acceleration, Displacement


def filter_record(
    acceleration: Acceleration, displacement: Displacement, settings: KalmanSettings | None = None
) -> Smoothed:
    """Run the causal filter over a whole record.

    acceleration: block of n samples; displacement: block of m measurements on the same clock, in time order. The
    estimate has one row a sample and uses what came before it; `variance_m2` (m,) tells the noise each measurement was
    taken with.
    """
    stream = KalmanFilter(settings)
    stream.push(displacement)
    estimate, innovation, noise = stream.run(acceleration)
    return Smoothed(estimate, innovation, tuple(gate_events(innovation)), noise)
