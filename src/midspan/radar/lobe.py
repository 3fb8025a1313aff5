"""A target between two bins of one frame: where it lies, how much of it and of the noise they hold (Hann window)."""

import math

from midspan.radar.following import MIN_EXCURSION_BINS

# The covariance of neighbouring bins of a Hann window, over the variance of one.
NEIGHBOURS = 2.0 / 3.0


def response_at(distance_bins: float) -> float:
    """`following.response` at one distance."""
    d = abs(distance_bins)
    if d < 1e-9 or abs(d - 1.0) < 1e-9:
        return 1.0 if d < 0.5 else 0.5
    return math.sin(math.pi * d) / (math.pi * d * (1.0 - d * d))


def between(share: float) -> float:
    """Response of two neighbouring bins, weighed linearly, to a target that lies a share of a bin from the lower."""
    return (1.0 - share) * response_at(share) + share * response_at(1.0 - share)


def noise_between(share: float) -> float:
    """Variance of the noise of two neighbouring bins, weighed linearly, over that of one."""
    return 1.0 - 2.0 * (1.0 - NEIGHBOURS) * share * (1.0 - share)


def fraction_between(low: complex, high: complex, value: complex) -> float:
    """Where between two bins a target of phasor `value` lies, -½ to 1½: its responses are as 2 − d to 1 + d."""
    a, b = (low * value.conjugate()).real, (high * value.conjugate()).real
    return min(max((2.0 * b - a) / (a + b), -0.5), 1.5) if a + b > 0.0 else 0.5


def looked_at(z: list[complex], first_bin: float, place: tuple[float, float]) -> float:
    """Fractional bin where a target is met: where it is expected, or at the strongest bin where that is not sure.

    z: phasors of the bins from `first_bin` on; place: expected bin, and how far from it the target may be.
    """
    expected, reach = place
    if not reach > MIN_EXCURSION_BINS:
        return expected
    near = [k for k in range(len(z)) if abs(first_bin + k - expected) <= reach + 0.5] or range(len(z))
    k = max(near, key=lambda bin_: abs(z[bin_]))
    low = k if k + 1 < len(z) and (k == 0 or abs(z[k + 1]) > abs(z[k - 1])) else k - 1
    return first_bin + low + fraction_between(z[low], z[low + 1], z[k])
