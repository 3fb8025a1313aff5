"""Displacement, velocity and variance between the rows of an estimate, at the stamps of another sensor."""

from dataclasses import dataclass

import numpy as np

from midspan.records import Estimate, Floats, Nanoseconds, seconds


def at(path: Estimate, time_ns: Nanoseconds) -> tuple[Floats, Floats]:
    """Displacement (m) and variance (m²) of an estimate at stamps (n,) in ns; beyond its ends as at them.

    Between two rows the displacement is the cubic with the displacements and velocities of both (Hermite): its error
    goes with the fourth power of the interval, where that of a straight line is 5 % of a tone's amplitude with ten rows
    a period. The variance is interpolated by straight lines.
    """
    place = _places(path, time_ns)
    u, h, d, v = place.u, place.h, path.displacement_m, path.velocity_m_s
    displacement: Floats = (
        (1 + 2 * u) * (1 - u) ** 2 * d[place.before]
        + u * (1 - u) ** 2 * h * v[place.before]
        + u * u * (3 - 2 * u) * d[place.after]
        - u * u * (1 - u) * h * v[place.after]
    )
    return displacement, (1 - u) * path.variance_m2[place.before] + u * path.variance_m2[place.after]


def velocity_at(path: Estimate, time_ns: Nanoseconds) -> Floats:
    """Velocity (m/s) of an estimate at stamps (n,) in ns: the slope of the same cubic; beyond its ends as at them."""
    place = _places(path, time_ns)
    u, d, v = place.u, path.displacement_m, path.velocity_m_s
    velocity: Floats = (
        6 * u * (1 - u) * (d[place.after] - d[place.before]) / place.h
        + (1 - u) * (1 - 3 * u) * v[place.before]
        - u * (2 - 3 * u) * v[place.after]
    )
    return velocity


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Of instants (n,): the rows before and after, the time between these (s), and the share of it that has gone."""

    before: Nanoseconds
    after: Nanoseconds
    h: Floats
    u: Floats


def _places(path: Estimate, time_ns: Nanoseconds) -> _Places:
    """Where stamps lie among the rows; an estimate of one row has that one before and after."""
    t = seconds(path.time_ns, int(path.time_ns[0]))
    at_s = np.clip(seconds(time_ns, int(path.time_ns[0])), t[0], t[-1])
    before = np.clip(np.searchsorted(t, at_s, side="right") - 1, 0, max(len(t) - 2, 0))
    after = np.minimum(before + 1, len(t) - 1)
    h = np.where(after > before, t[after] - t[before], 1.0)
    return _Places(before, after, h, (at_s - t[before]) / h)
