"""What speaks for a target being fixed: how much of its motion the accelerometer explains, and what is left."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.radar.alignment import Integrals
from midspan.radar.channels import Phasors
from midspan.radar.own_motion import EXCESS
from midspan.records import Floats
from midspan.signals.medians import SIGMA_OF_MEDIAN

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


def static_centre(phasors: Phasors) -> complex:
    """What to subtract from phasors (n,): the circle's centre, or 0 where the arc is too short or it is no circle."""
    known = np.asarray(phasors)[np.isfinite(phasors)]
    if len(known) < 20:
        return 0j
    circle = fit_circle(known)
    arc = float(np.ptp(np.unwrap(np.angle(known - circle.centre))))
    firm = circle.scatter <= MAX_SCATTER * circle.radius and abs(circle.centre) <= MAX_CENTRE * circle.radius
    bow = circle.radius * (1.0 - np.cos(min(arc / 2.0, np.pi)))
    return circle.centre if firm and arc >= MIN_ARC and bow >= MIN_BOW * circle.scatter else 0j


# A phase that turns less says nothing about clutter or the modulation, rad.
MIN_TURN = 2.0
# Lag of the second differences whose agreement is the coherence, s: it weighs motion of about 1 to 4 Hz.
COHERENCE_LAG_S = 0.12
# Lag that shows what moves on its own at 0.3 to 1 Hz, as the wind moves trees, s.
OWN_LAG_S = 0.5
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
    return float(np.sqrt((rest - expected) / SECOND_POWER)) if rest > EXCESS * expected else 0.0


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


# Weights of a fourth difference: a motion of 4 Hz at 100 Hz is left with 0.4 % of it.
FOURTH = (1.0, -4.0, 6.0, -4.0, 1.0)
# Fewer frames say nothing about the modulation, nor does a phase that turns too little.
MIN_FRAMES = 50
# From this turn on (rad) the amplitude also changes because the target moves across its bin: smooth in the range.
MIGRATING_TURN = 40.0
# A modulation below this share of the receiver's own is none: its level is known no better.
MIN_EXCESS = 0.05


def measured_variance(phase_rad: Floats, expected_rad: Floats) -> float:
    """Variance (rad²) of the white noise of an unwrapped phase (n,), NaN where there is none; NaN for short records.

    expected_rad (n,): what the accelerometer says of it, up to a slow drift; zeros where there is none.
    """
    if len(phase_rad) < MIN_FRAMES:
        return float("nan")
    fourth = np.convolve(np.asarray(phase_rad) - expected_rad, FOURTH, mode="valid")
    fourth = fourth[np.isfinite(fourth)]
    if len(fourth) < MIN_FRAMES:
        return float("nan")
    return float((SIGMA_OF_MEDIAN * np.median(np.abs(fourth))) ** 2 / np.dot(FOURTH, FOURTH))


def modulation(phasors: NDArray[np.complexfloating], phase_rad: Floats, noise: float) -> float:
    """Standard deviation (rad) of the phase that something else in the bin makes, from the amplitude's modulation.

    phasors (n,) and their unwrapped phase (n,), NaN where not used; noise: variance of the complex noise. NaN where the
    phase turns too little for it to show: then it is a constant share of the motion, and in the conversion factor.
    """
    known = np.isfinite(phase_rad) & np.isfinite(phasors)
    amplitude, phase = np.abs(phasors[known]).astype(np.float64), np.asarray(phase_rad)[known]
    if len(phase) < MIN_FRAMES or np.ptp(phase) < MIN_TURN:
        return float("nan")
    level = np.full(len(phase), np.median(amplitude))
    if np.ptp(phase) > MIGRATING_TURN:
        place = (phase - phase.mean()) / np.ptp(phase)
        level = np.polyval(np.polyfit(place, amplitude, 4), place)
    receiver = 0.5 * noise
    excess = np.mean((amplitude - level) ** 2) - receiver
    firm = excess > max(MIN_EXCESS, 4.0 * np.sqrt(2.0 / len(phase))) * receiver
    return float(np.sqrt(excess) / np.median(amplitude)) if firm else 0.0


def factor_spread(modulation_rad: float, leak_share: float, turn_rad: float) -> float:
    """Relative standard deviation of the conversion factor from what else is in the bin, to be added to its own.

    modulation_rad: of the phase (NaN: not known, then nothing is added); leak_share: amplitude of what was taken out as
    static over that of the target; turn_rad: standard deviation of the phase. A bend of e rad changes the slope
    of the phase by up to e where it hardly turns, and by exp(-turn²/2) of that where it turns; half of the turn is
    counted, for what moves half as much. What was taken out is accepted once the phase turns enough to prove it.
    """
    left = 0.0 if np.isnan(modulation_rad) else modulation_rad * np.exp(-(turn_rad**2) / 8.0)
    return float(np.hypot(left, leak_share / np.sqrt(2.0) * np.exp(-(turn_rad**2))))
