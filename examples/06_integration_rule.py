"""Why the filter takes the acceleration in by the Numerov rule: amplitude error of twice integrated acceleration.

A sine of each frequency is integrated twice, sample by sample, with the acceleration held (zero-order hold, as in the
usual multi-rate filter), run through trapezoids, and taken in by midspan's own rule. The error is that of the complex
amplitude against the exact displacement -a/ω², so it counts a delay as well as a wrong size.
"""

import numpy as np

RATE_HZ = 100.0
dt = 1.0 / RATE_HZ


def held(a0, a1):
    """Displacement and velocity added in one step, the acceleration held."""
    return 0.5 * dt * dt * a0, dt * a0


def trapezoid(a0, a1):
    """The same by trapezoids."""
    return 0.25 * dt * dt * (a0 + a1), 0.5 * dt * (a0 + a1)


def numerov(a0, a1):
    """The same by midspan's rule: the acceleration's integrals, its slope's share at both ends taken by dt²/12."""
    slope = (a1 - a0) / dt
    return dt * dt * (0.5 * a0 + (a1 - a0) / 6.0 - slope * dt / 12.0), 0.5 * dt * (a0 + a1)


def error(rule, frequency_hz):
    """The rule's steady response x = X·exp(iωt) to a = exp(iωt), against -1/ω²."""
    omega = 2 * np.pi * frequency_hz
    z = np.exp(1j * omega * dt)
    # x and v added in one step, as complex amplitudes: the rules are linear in a0 and a1.
    x0, v0 = rule(1.0, 0.0)
    x1, v1 = rule(0.0, 1.0)
    added_x, added_v = x0 + x1 * z, v0 + v1 * z
    velocity = added_v / (z - 1.0)
    displacement = (dt * velocity + added_x) / (z - 1.0)
    return abs(displacement * -(omega**2) - 1.0)


print("frequency / rate   held      trapezoid  Numerov")
for ratio in (0.01, 0.05, 0.10, 0.15, 0.20, 0.30):
    cells = [100 * error(rule, ratio * RATE_HZ) for rule in (held, trapezoid, numerov)]
    print(f"{ratio:12.2f}     " + "  ".join(f"{cell:7.3f} %" for cell in cells))
