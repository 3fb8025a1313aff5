"""What unwrapping the radar's phase rests on: wrapped angles, limits, and what the acceleration does between frames."""

import numpy as np

from midspan.checks import increasing
from midspan.records import Floats

TURN = 2.0 * np.pi
# The phase of a target whose noise reaches this (rad) says nothing about its cycle.
BLIND_RAD = 0.77
# A prediction whose standard deviation exceeds this share of a cycle cannot name the cycle any more.
UNSURE_CYCLES = 0.2


def wrapped(angle: Floats) -> Floats:
    """Angles (…,) in rad brought into -π … π."""
    return np.asarray(np.remainder(np.asarray(angle) + np.pi, TURN) - np.pi)


def inertial_steps(frame_s: Floats, samples: Floats) -> Floats:
    """What the acceleration alone does between frames: (n, 4), row k from frame k-1 to k, row 0 zero.

    frame_s (n,): instants of the frames, s; samples (m, 2): time in s and acceleration in m/s², evenly or not.
    Columns: change of velocity (m/s), change of displacement less velocity times time (m), mean acceleration (m/s²) and
    its mean rate of change (m/s³). Acceleration runs as a cubic spline; outside the samples it is zero.
    """
    from scipy.interpolate import CubicSpline

    frames = np.asarray(increasing("frame_s", frame_s), dtype=np.float64)
    level = float(np.mean(samples[:, 1]))
    # The level is taken out and put back in closed form: its double integral would grow without bound.
    spline = CubicSpline(samples[:, 0], samples[:, 1] - level)
    inside = np.clip(frames, samples[0, 0], samples[-1, 0])
    velocity, place = spline.antiderivative(1)(inside), spline.antiderivative(2)(inside)
    dt, within = np.diff(frames), np.diff(inside)
    out = np.zeros((len(frames), 4))
    out[1:, 0] = np.diff(velocity) + level * within
    out[1:, 1] = np.diff(place) - velocity[:-1] * within + 0.5 * level * within**2
    out[1:, 2] = out[1:, 0] / dt
    out[1:, 3] = np.diff(spline(inside)) / dt
    return out
