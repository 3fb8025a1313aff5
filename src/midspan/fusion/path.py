"""Displacement, velocity and variance between the rows of an estimate, at the stamps of another sensor."""

import numpy as np

from midspan.records import Estimate, Floats, Nanoseconds, seconds


def at(path: Estimate, time_ns: Nanoseconds) -> tuple[Floats, Floats]:
    """Displacement (m) and variance (m²) of an estimate at stamps (n,) in ns; beyond its ends as at them.

    Between two rows the displacement is the cubic with the displacements and velocities of both (Hermite): its error
    goes with the fourth power of the interval, where that of a straight line is 5 % of a tone's amplitude with ten rows
    a period. The variance is interpolated by straight lines.
    """
    origin = int(path.time_ns[0])
    t = seconds(path.time_ns, origin)
    at_s = np.clip(seconds(time_ns, origin), t[0], t[-1])
    return _cubic(t, path, at_s), np.interp(at_s, t, path.variance_m2)


def _cubic(t: Floats, path: Estimate, at_s: Floats) -> Floats:
    d, v = path.displacement_m, path.velocity_m_s
    if len(t) < 2:
        return np.full(len(at_s), d[0])
    k = np.clip(np.searchsorted(t, at_s, side="right") - 1, 0, len(t) - 2)
    h = t[k + 1] - t[k]
    u = (at_s - t[k]) / h
    between: Floats = (
        (1 + 2 * u) * (1 - u) ** 2 * d[k]
        + u * (1 - u) ** 2 * h * v[k]
        + u * u * (3 - 2 * u) * d[k + 1]
        - u * u * (1 - u) * h * v[k + 1]
    )
    return between
