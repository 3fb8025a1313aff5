"""Which cycle the phase came back on after an outage: checked with the range itself, or declared a new datum.

The beat frequency tells the range without ambiguity, to a millimetre or so a frame; averaged over a stretch it tells
cycles of 1.9 mm apart. Clutter in the bin pulls it; so the scatter of its averages decides whether it is believed.
"""

from dataclasses import dataclass

import numpy as np

from midspan.checks import same_length
from midspan.records import Floats

# A cycle is believed when the difference is near a whole number of cycles and so many standard deviations from where
# the next one begins.
SURE_STD, NEAR_WHOLE = 4.0, 0.25
PARTS = 8
LEAST_FRAMES = 3 * PARTS
# How much faster than the target's phase that of clutter may turn against it: half as much for what moves half as much
# as the target, one for what stands still, more for what moves the other way.
SLOPES = (0.5, 1.0, 1.7)
# Standard deviation per median absolute deviation of a normal distribution.
NORMAL = 1.4826


@dataclass(frozen=True, slots=True)
class CycleVerdict:
    """frame: the first one after the outage; verdict: "verified", "shifted" or "new datum"; cycles: by which the phase
    after it was shifted; std: of range less phase after against before, in cycles.
    """

    frame: int
    verdict: str
    cycles: int
    std: float


def verify_cycles(
    phase_rad: Floats, coarse_m: Floats, *, restarts: tuple[int, ...], phase_per_m: float, longest: int = 1000
) -> tuple[Floats, tuple[CycleVerdict, ...]]:
    """Unwrapped phase (n,) with whole cycles corrected after each outage, and what was found about each.

    phase_rad (n,): NaN where there is none; coarse_m (n,): range from `range_profile.coarse_range`, NaN where there is
    none; restarts: first frames after outages in which the cycle was lost; longest: frames used on each side.
    """
    phase, coarse = np.array(phase_rad, dtype=np.float64), np.asarray(coarse_m, dtype=np.float64)
    same_length(phase_rad=phase, coarse_m=coarse)
    edges = [0, *restarts, len(phase)]
    verdicts = []
    for start, first, end in zip(edges[:-2], edges[1:-1], edges[2:], strict=True):
        # Cycles of range less phase: constant while the cycle is right.
        gap = (coarse * phase_per_m - phase) / (2.0 * np.pi)
        before, after = _side(gap, phase, slice(start, first), -longest), _side(gap, phase, slice(first, end), longest)
        bent = max(_bent(gap[start:first]), _bent(gap[first:end])) * float(np.hypot(before[2], after[2]))
        verdict = _judged(first, after[0] - before[0], float(np.hypot(np.hypot(before[1], after[1]), bent)))
        phase[first:] += 2.0 * np.pi * verdict.cycles
        verdicts.append(verdict)
    return phase, tuple(verdicts)


def _side(gap: Floats, phase: Floats, part: slice, longest: int) -> tuple[float, float, float]:
    """Mean gap of the frames nearest to the outage, its standard deviation, and how unevenly the phase lies in them.

    The deviation is the scatter of the means of parts, which drift and clutter widen. Clutter that turns with the phase
    pulls the range to and fro; where the phase lies evenly, 0, that averages out; where it rests, 1, it does not.
    """
    known = np.flatnonzero(np.isfinite(gap[part]) & np.isfinite(phase[part])) + (part.start or 0)
    known = known[longest:] if longest < 0 else known[:longest]
    if len(known) < LEAST_FRAMES:
        return 0.0, np.inf, 1.0
    means = np.array([some.mean() for some in np.array_split(gap[known], PARTS)])
    uneven = max(float(np.abs(np.mean(np.exp(1j * slope * phase[known])))) for slope in SLOPES)
    return float(gap[known].mean()), float(means.std(ddof=1) / np.sqrt(PARTS)), uneven


def _bent(gap: Floats) -> float:
    """Standard deviation (cycles) of what moves the range slowly, beyond the noise that is new in every frame."""
    known = gap[np.isfinite(gap)]
    if len(known) < LEAST_FRAMES:
        return 0.0
    slow = float(np.median(np.abs(known - np.median(known)))) * NORMAL
    step = float(np.median(np.abs(np.diff(known)))) * NORMAL / np.sqrt(2.0)
    return float(np.sqrt(max(slow**2 - step**2, 0.0)))


def _judged(frame: int, difference: float, std: float) -> CycleVerdict:
    if not np.isfinite(std):
        return CycleVerdict(frame, "new datum", 0, std)
    cycles = int(np.rint(difference))
    rest = abs(difference - cycles)
    if rest > NEAR_WHOLE or 0.5 - rest < SURE_STD * std:
        return CycleVerdict(frame, "new datum", 0, std)
    return CycleVerdict(frame, "shifted" if cycles else "verified", cycles, std)
