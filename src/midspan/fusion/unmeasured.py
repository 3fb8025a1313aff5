"""What the acceleration alone tells of the displacement, before anything else is measured.

It is off by a straight line, of the velocity that the motion had at the first sample: differences of phase that are
compared with it are constant, where the motion itself turns the phase by more than half a cycle from frame to frame.
"""

from dataclasses import dataclass

import numpy as np

from midspan.records import Floats


@dataclass(frozen=True, slots=True)
class Integrated:
    """The acceleration integrated twice from rest at the first sample.

    time_s: of the last sample, step_s: before it; acceleration, velocity_m_s, displacement_m (axes,): there.
    """

    time_s: float
    step_s: float
    acceleration: Floats
    velocity_m_s: Floats
    displacement_m: Floats

    def at(self, time_s: float, axis: int) -> float:
        """Displacement (m) at a time after the last sample, whose acceleration is held."""
        dt = time_s - self.time_s
        moved = dt * self.velocity_m_s[axis] + 0.5 * dt * dt * self.acceleration[axis]
        return float(self.displacement_m[axis] + moved)


def integrated(before: Integrated | None, samples: Floats, bias_m_s2: Floats) -> Integrated:
    """Integrate samples (s, 1 + 2 axes) of time, acceleration and noise; bias_m_s2 (axes,): what rest measures."""
    axes = len(bias_m_s2)
    time_s, value = samples[:, 0], samples[:, 1 : 1 + axes] - bias_m_s2
    if before is None:
        before = Integrated(float(time_s[0]), 0.0, value[0], np.zeros(axes), np.zeros(axes))
    time_s = np.concatenate(([before.time_s], time_s))
    value = np.concatenate((before.acceleration[None], value))
    dt = np.diff(time_s)[:, None]
    # Sums are taken from sample to sample: they are the same however the record is cut.
    velocity = np.cumsum(np.concatenate((before.velocity_m_s[None], 0.5 * dt * (value[:-1] + value[1:]))), axis=0)
    moved = dt * velocity[:-1] + dt * dt * (2.0 * value[:-1] + value[1:]) / 6.0
    place = np.cumsum(np.concatenate((before.displacement_m[None], moved)), axis=0)
    step_s = float(dt[-1, 0]) or before.step_s
    return Integrated(float(time_s[-1]), step_s, value[-1], velocity[-1], place[-1])
