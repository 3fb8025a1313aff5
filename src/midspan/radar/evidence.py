"""What speaks for a target being fixed: how much of its motion the accelerometer explains, and what is left."""

import numpy as np

from midspan.radar.alignment import Integrals
from midspan.radar.channels import Phasors
from midspan.radar.circle import fit_circle
from midspan.records import Floats

# A phase that turns less says nothing about clutter or the modulation, rad.
MIN_TURN = 2.0
# Lag of the second differences whose agreement is the coherence, s: it weighs motion of about 1 to 4 Hz.
COHERENCE_LAG_S = 0.12
# Lag that shows what moves on its own at 0.3 to 1 Hz, as the wind moves trees; what is left over it counts as such from
# this many times the variance on that the accelerometer's and the phase's noise make.
OWN_LAG_S, OWN_EXCESS = 0.5, 1.5
# The variance of a second difference of white noise over that of the noise: 1² + 2² + 1².
SECOND_POWER = 6.0


def coherence(los_m: Floats, time_s: Floats, integrals: Integrals, ratio: float, noise_m2: float) -> float:
    """Share of the second differences of the range change (n,) that the accelerometer explains, 0 … 1.

    noise_m2: variance of one frame by the receiver's noise, which is no motion that could be explained.
    """
    second, response = _over(los_m, time_s, integrals, COHERENCE_LAG_S)
    white = SECOND_POWER * noise_m2
    rest = max(float(np.var(second - ratio * response)) - white, 0.0)
    total = float(np.var(second)) - white
    return max(0.0, 1.0 - rest / total) if len(second) and total > 0 else 0.0


def _over(los_m: Floats, time_s: Floats, integrals: Integrals, lag_s: float) -> tuple[Floats, Floats]:
    """Second differences over a lag of the range change (n,), and of the accelerometer's displacement, (k,) each."""
    period = float(np.median(np.diff(time_s)))
    lag = max(1, round(lag_s / period))
    if len(los_m) <= 2 * lag:
        return np.empty(0), np.empty(0)
    second = los_m[2 * lag :] - 2.0 * los_m[lag:-lag] + los_m[: -2 * lag]
    known = np.isfinite(second)
    return second[known], integrals.second_difference(time_s[lag:-lag][known], lag * period)


def own_motion(los_m: Floats, time_s: Floats, integrals: Integrals, ratio: float, noise_m2: float) -> float:
    """Standard deviation (m of range) of what the accelerometer does not explain, beyond both noises."""
    second, response = _over(los_m, time_s, integrals, OWN_LAG_S)
    if len(second) == 0:
        return 0.0
    expected = SECOND_POWER * noise_m2 + ratio**2 * integrals.noise_variance(OWN_LAG_S)
    rest = float(np.var(second - ratio * response))
    return float(np.sqrt((rest - expected) / SECOND_POWER)) if rest > OWN_EXCESS * expected else 0.0


def clutter_share(z: Phasors, phase_rad: Floats) -> float:
    """Amplitude of what is static in the bin as a share of the target's, from phasors (n,) and unwrapped phase (n,).

    It is the distance from zero of the centre of the circle on which the phasors turn. NaN when they turn by less than
    2 rad.
    """
    known = np.isfinite(phase_rad) & np.isfinite(z)
    if np.count_nonzero(known) < 20 or np.ptp(phase_rad[known]) < MIN_TURN:
        return float("nan")
    circle = fit_circle(z[known])
    return min(abs(circle.centre) / max(circle.radius, 1e-300), 1.0)
