"""Displacement from acceleration over uneven times."""

import numpy as np

from midspan.records import Floats


def path(time_s: Floats, sampled_s: Floats, value: Floats) -> Floats:
    """Displacement (k,) from rest at increasing times (k,), s, by an acceleration (n,), m/s², without its mean.

    sampled_s (n,): its times, s, evenly spaced or not; by the trapezoidal rule twice, which does not delay.
    """
    velocity = _integral(sampled_s, value - np.mean(value))
    return np.asarray(np.interp(time_s, sampled_s, _integral(sampled_s, velocity)))


def _integral(time_s: Floats, value: Floats) -> Floats:
    steps = 0.5 * (value[1:] + value[:-1]) * np.diff(time_s)
    return np.concatenate(([0.0], np.cumsum(steps)))
