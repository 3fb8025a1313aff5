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


@dataclass(frozen=True, slots=True)
class CycleVerdict:
    """frame: the first one after the outage; verdict: "verified", "shifted" or "new datum"; cycles: by which the phase
    after it was shifted; difference, std: range less phase after against before, in cycles.
    """

    frame: int
    verdict: str
    cycles: int
    difference: float
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
        before, after = _mean(_known(gap[start:first])[-longest:]), _mean(_known(gap[first:end])[:longest])
        verdict = _judged(first, after[0] - before[0], float(np.hypot(before[1], after[1])))
        phase[first:] += 2.0 * np.pi * verdict.cycles
        verdicts.append(verdict)
    return phase, tuple(verdicts)


def _mean(gap: Floats) -> tuple[float, float]:
    """Mean and its standard deviation, from the scatter of the means of its parts, which drift and clutter widen."""
    if len(gap) < LEAST_FRAMES:
        return 0.0, np.inf
    means = np.array([part.mean() for part in np.array_split(gap, PARTS)])
    return float(gap.mean()), float(means.std(ddof=1) / np.sqrt(PARTS))


def _known(gap: Floats) -> Floats:
    return gap[np.isfinite(gap)]


def _judged(frame: int, difference: float, std: float) -> CycleVerdict:
    if not np.isfinite(std):
        return CycleVerdict(frame, "new datum", 0, difference, std)
    cycles = int(np.rint(difference))
    rest = abs(difference - cycles)
    if rest > NEAR_WHOLE or 0.5 - rest < SURE_STD * std:
        return CycleVerdict(frame, "new datum", 0, difference, std)
    return CycleVerdict(frame, "shifted" if cycles else "verified", cycles, difference, std)
