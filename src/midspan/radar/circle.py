"""What is static in a target's bin and moves with the radar: the centre of the circle that its phasors turn on.

Leakage and attached parts keep their phase while the target's turns, so the circle is not about zero and the phase is
bent. The centre is found only where the arc is long enough; from a short arc it would do more harm than good. Another
fixed target at another angle turns too and is no centre: that needs the receivers (see `channels`).
"""

from dataclasses import dataclass

import numpy as np

from midspan.radar.channels import Phasors

# The arc (rad) from which the centre is accepted: ±0.2 mm of range at 77 GHz; from ±0.1 mm on it would break even.
MIN_ARC = 1.3
# The scatter about the circle, and the distance of its centre, as shares of its radius, up to which it is one.
MAX_SCATTER, MAX_CENTRE = 0.2, 0.9
# The bow of the arc must stand out of the scatter by this factor: noise pulls the centre of a flat arc towards it.
MIN_BOW = 8.0


@dataclass(frozen=True, slots=True)
class Circle:
    """Centre and radius in the phasors' unit; scatter: standard deviation of the distance from the centre."""

    centre: complex
    radius: float
    scatter: float


def fit_circle(phasors: Phasors) -> Circle:
    """The circle through phasors (n,) in closed form: |z|² = 2 Re(z c*) + r² − |c|² by least squares (Kåsa 1976)."""
    z = np.asarray(phasors)[np.isfinite(phasors)]
    columns = np.column_stack((2.0 * z.real, 2.0 * z.imag, np.ones(len(z))))
    x, y, rest = np.linalg.lstsq(columns, np.abs(z) ** 2, rcond=None)[0]
    centre = complex(x, y)
    distance = np.abs(z - centre)
    return Circle(centre, float(np.sqrt(max(rest + abs(centre) ** 2, 0.0))), float(np.std(distance)))


def standing_still(phasors: Phasors) -> complex:
    """What to subtract from phasors (n,): the circle's centre, or 0 where the arc is too short or it is no circle."""
    known = np.asarray(phasors)[np.isfinite(phasors)]
    if len(known) < 20:
        return 0j
    circle = fit_circle(known)
    arc = float(np.ptp(np.unwrap(np.angle(known - circle.centre))))
    firm = circle.scatter <= MAX_SCATTER * circle.radius and abs(circle.centre) <= MAX_CENTRE * circle.radius
    bow = circle.radius * (1.0 - np.cos(min(arc / 2.0, np.pi)))
    return circle.centre if firm and arc >= MIN_ARC and bow >= MIN_BOW * circle.scatter else 0j
