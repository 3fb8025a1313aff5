"""Clock offsets beyond the range that was searched: over the whole overlap of both streams, sign and offset together.

At a wrong offset a narrow-band motion fits with the wrong sign. So the best fit of a range is compared with those
outside it. At another offset other measurements lie within the acceleration; the others are as likely as without any.
So what counts is the evidence, by how much (logarithm of the likelihood) the acceleration explains the measurements
better than the smoothest motion of no acceleration does.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.agreement import least_lead
from midspan.calibration.fit import Fit, Pair, best_corner, evaluate, refine, with_input_noise
from midspan.calibration.time_offset import AT_ONCE, CANDIDATES, MAX_RATE_HZ, OVERLAP, coarse_corners, likelihoods
from midspan.records import Floats

# Offsets are tried with the measurements that lie within the acceleration at all offsets of a segment, s.
SEGMENT_S = 1.0
# So many measurements are needed to look for another offset.
MIN_ROWS = 20
# So much of a long record is compared at all offsets, s.
PART_S = 120.0
# An offset is that of the clocks, whatever is left, where the acceleration explains more than this share of the
# innovations' power there and at no other offset more than this share of the evidence is found. A tone's alternatives
# have nearly all of it, those of another event hardly any anywhere.
MIN_EXPLAINED, MAX_SHARE = 0.5, 0.5


@dataclass(frozen=True, slots=True)
class Rival:
    """The likeliest fit beyond a range of offsets, its evidence, and that of the best one within the range.

    certain: the lead (either way) that no noise makes.
    """

    fit: Fit
    evidence: float
    within: float
    certain: float

    @property
    def lead(self) -> float:
        """By how much it is the likelier one (logarithm)."""
        return self.evidence - self.within

    @property
    def better(self) -> bool:
        """Whether it is the right one beyond doubt."""
        return self.lead >= self.certain

    @property
    def alike(self) -> bool:
        """Whether noise may have decided between the two."""
        return abs(self.lead) < self.certain


def likeliest_beyond(pair: Pair, near: Fit, within_s: float) -> Rival | None:
    """The likeliest fit at a clock offset beyond ±`within_s`, as far as half of the measurements still overlap.

    pair: with the outliers of the best fit within, `near`, marked, and the ratio None where it is unknown. None where
    nothing farther explains anything.
    """
    # A smaller ratio leaves less of the accelerometer's noise, whichever is true: see `fit.shrinking`.
    reference = abs(near.ratio) if pair.ratio is None else None
    pair = replace(pair, reference=reference, motion_share=0.0, bias_drifts=False)
    offsets = _offsets(pair, within_s)
    step = 1.0 / min(pair.sample_rate_hz, MAX_RATE_HZ)
    scanned = [row for part in offsets for row in zip(part.tolist(), *_scan(pair, part), strict=True)]
    peaks = [scanned[k] for k in _peaks(scanned, step)]
    fits = [refine(pair, evaluate(pair, at, corner), step) for at, _, corner in peaks]
    apart = [fit for fit in fits if abs(fit.offset_s) > within_s and abs(fit.offset_s - near.offset_s) > 2.0 * step]
    if not apart:
        return None
    best = max(apart, key=lambda fit: _evidence(pair, fit))
    near, best = (_with_own_noise(pair, fit, step) for fit in (near, best))
    count = len(pair.used(near.offset_s))
    return Rival(best, _evidence(pair, best), _evidence(pair, near), least_lead(count))


def stands_alone(pair: Pair, fit: Fit) -> bool:
    """Whether the acceleration explains most of the measurements at a fit's offset, and at no other half as well.

    What is left then is an error of a sensor in proportion to the motion, for no offset of another motion does that.
    """
    pair = first_part(pair)
    if not len(pair.used(fit.offset_s)):
        return False
    rival = likeliest_beyond(pair, fit, 0.0)
    if rival is None:
        return False
    explained = 1.0 - float(np.exp(-2.0 * rival.within / len(pair.used(fit.offset_s))))
    return explained > MIN_EXPLAINED and rival.evidence < MAX_SHARE * rival.within


def first_part(pair: Pair) -> Pair:
    """The pair's first measurements, with the acceleration for as long before and after: a long scan takes long."""
    first, last = float(pair.rows[0, 0]), float(pair.rows[0, 0]) + PART_S
    if pair.rows[-1, 0] <= last:
        return pair
    rows = pair.rows[pair.rows[:, 0] <= last]
    near = (pair.samples[:, 0] >= first - PART_S) & (pair.samples[:, 0] <= last + PART_S)
    outside = None if pair.outside is None else pair.outside[near]
    return replace(pair, rows=rows, samples=pair.samples[near], outside=outside, cross=None)


def _with_own_noise(pair: Pair, fit: Fit, step_s: float) -> Fit:
    """The fit with what the accelerometer errs by at its offset."""
    own, found = with_input_noise(pair, best_corner(pair, fit.offset_s))
    return refine(own, found, step_s)


def _evidence(pair: Pair, fit: Fit) -> float:
    """By how much (logarithm) a fit is likelier than the smoothest motion without acceleration."""
    return fit.likelihood - best_corner(replace(pair, ratio=0.0), fit.offset_s).likelihood


def _offsets(pair: Pair, within_s: float) -> list[Floats]:
    """Offsets beyond ±`within_s`, in parts, at which at least OVERLAP of the measurements are in the acceleration."""
    time_s = pair.rows[np.isfinite(pair.rows[:, 2]), 0]
    if len(time_s) < MIN_ROWS:
        return []
    first, last = float(pair.responses[0].edges_s[0]), float(pair.samples[-1, 0])
    rate = min(pair.sample_rate_hz, MAX_RATE_HZ)
    grid = np.arange(first - time_s[-1], last - time_s[0], 1.0 / rate)
    count = np.searchsorted(time_s, last - grid, side="right") - np.searchsorted(time_s, first - grid, side="left")
    enough = count >= max(OVERLAP * float(np.max(count, initial=0)), MIN_ROWS)
    found = grid[enough & (np.abs(grid) > within_s)]
    ends = np.flatnonzero(np.diff(found) > 1.5 / rate) + 1
    length = max(round(SEGMENT_S * rate), 1)
    return [part[k : k + length] for part in np.split(found, ends) for k in range(0, len(part), length)]


def _scan(pair: Pair, offsets: Floats) -> tuple[Floats, Floats]:
    """Evidence (k,) at offsets (k,) that follow each other, and the likeliest corner frequency (k,), rad/s."""
    corners = coarse_corners(pair)
    rows = pair.rows[np.intersect1d(pair.used(float(offsets[0])), pair.used(float(offsets[-1])))]
    parts = np.array_split(offsets, min(len(offsets), -(-len(offsets) * len(rows) // AT_ONCE)))
    tables = [likelihoods(pair, rows, part, corners) for part in parts]
    found, without = (np.concatenate(one, axis=1) for one in zip(*tables, strict=True))
    return found.max(axis=0) - without.max(axis=0), corners[np.argmax(found, axis=0)]


def _peaks(scanned: list[tuple[float, float, float]], step_s: float) -> list[int]:
    """Which of the scanned offsets (with evidence and corner) are the highest maxima."""
    at, evidence = (np.array([one[k] for one in scanned]) for k in (0, 1))
    before = np.r_[-np.inf, np.where(np.diff(at) < 1.5 * step_s, evidence[:-1], -np.inf)] if len(at) else at
    after = np.r_[np.where(np.diff(at) < 1.5 * step_s, evidence[1:], -np.inf), -np.inf] if len(at) else at
    peaks = np.flatnonzero((evidence >= before) & (evidence > after))
    return [int(k) for k in peaks[np.argsort(evidence[peaks])[::-1][:CANDIDATES]]]
