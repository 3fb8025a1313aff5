"""How uncertain the phase of a target really is: its noise as measured, and what else turns in its bin.

The signal-to-noise ratio knows the receiver's noise only. What is common to all receivers (the oscillator) shows in the
phase itself; another reflector in the bin shows in the amplitude, which it modulates as much as it bends the phase.
"""

import numpy as np
from numpy.typing import NDArray

from midspan.radar.evidence import MIN_TURN
from midspan.records import Floats
from midspan.signals.medians import SIGMA_OF_MEDIAN

# Weights of a fourth difference and the sum of their squares: a motion of 4 Hz at 100 Hz is left with 0.4 % of it.
FOURTH, FOURTH_POWER = (1.0, -4.0, 6.0, -4.0, 1.0), 70.0
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
    return float((SIGMA_OF_MEDIAN * np.median(np.abs(fourth))) ** 2 / FOURTH_POWER)


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
    standing still over that of the target; turn_rad: standard deviation of the phase. A bend of e rad changes the slope
    of the phase by up to e where it hardly turns, and by exp(-turn²/2) of that where it turns; half of the turn is
    counted, for what moves half as much. What was taken out is accepted once the phase turns enough to prove it.
    """
    left = 0.0 if np.isnan(modulation_rad) else modulation_rad * np.exp(-(turn_rad**2) / 8.0)
    return float(np.hypot(left, leak_share / np.sqrt(2.0) * np.exp(-(turn_rad**2))))
