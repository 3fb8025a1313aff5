"""Unwrapping of the radar's phase: from one frame to the next, and with the accelerometer's help."""

import numpy as np

from midspan import _core
from midspan.checks import finite, increasing, same_length
from midspan.records import Floats

TURN = 2.0 * np.pi
# The phase of a target whose noise reaches this (rad) says nothing about its cycle.
BLIND_RAD = 0.77
# A prediction whose standard deviation exceeds this share of a cycle cannot name the cycle any more.
UNSURE_CYCLES = 0.2


def wrapped(angle: Floats) -> Floats:
    """Angles (…,) in rad brought into -π … π."""
    return np.asarray(np.remainder(np.asarray(angle) + np.pi, TURN) - np.pi)


def unwrap_aided(phase_rad: Floats, acceleration_m_s2: Floats, *, period_s: float, phase_per_m: float) -> Floats:
    """Unwrapped phase (n,) in rad, predicted from the last two phases and the acceleration.

    phase_rad: (n,), NaN where a frame is missing; acceleration_m_s2: (n,) in the line of sight at the frames'
    instants (structural acceleration divided by the conversion factor); period_s: from frame to frame;
    phase_per_m: rad per m of range. The first two frames must not wrap.

    The prediction carries √6 of the phase's noise, so it needs about 12 dB, and it does not recover from a wrong cycle.
    Ma et al., "Structural displacement estimation using accelerometer and FMCW millimeter wave radar", equations 12-15.
    """
    phase = np.asarray(phase_rad, dtype=np.float64)
    acceleration = finite("acceleration_m_s2", acceleration_m_s2)
    same_length(phase_rad=phase, acceleration_m_s2=acceleration)
    return _core.unwrap_aided(np.ascontiguousarray(phase), acceleration * period_s**2, phase_per_m)


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
