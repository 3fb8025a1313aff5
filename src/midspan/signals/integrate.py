"""Displacement from acceleration over uneven times."""

import numpy as np

from midspan.records import Floats


def path(time_s: Floats, sampled_s: Floats, value: Floats) -> Floats:
    """Displacement (k,) from rest at increasing times (k,), s, by an acceleration (n,), m/s², without its mean.

    sampled_s (n,): its times, s, evenly spaced or not; by the trapezoidal rule twice, which does not delay. Between two
    of them, and in a gap, it is a parabola, as a constant makes it.
    """
    pushed = value - np.mean(value)
    along = np.interp(time_s, sampled_s, _integral(sampled_s, _integral(sampled_s, pushed)))
    k = np.clip(np.searchsorted(sampled_s, time_s, side="right") - 1, 0, len(sampled_s) - 2)
    since_s, until_s = np.maximum(time_s - sampled_s[k], 0.0), np.maximum(sampled_s[k + 1] - time_s, 0.0)
    return np.asarray(along - 0.5 * np.interp(time_s, sampled_s, pushed) * since_s * until_s)


def _integral(time_s: Floats, value: Floats) -> Floats:
    steps = 0.5 * (value[1:] + value[:-1]) * np.diff(time_s)
    return np.concatenate(([0.0], np.cumsum(steps)))
