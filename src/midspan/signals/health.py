"""What is wrong with a channel: gaps, missing values, frozen stretches, clipping, jitter of its clock."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.records import NANOSECONDS, Floats, Nanoseconds

Mask = NDArray[np.bool_]

# A step in time is a gap when it is longer than this many usual steps.
GAP_STEPS = 1.5
# Equal values count as frozen when they last this long and this many samples; quantisation alone repeats fewer.
FROZEN_S = 1.0
FROZEN_SAMPLES = 50
# A structure at rest before or after the motion may give exactly equal values too: then at the channel's mean, within
# this share of its standard deviation.
REST_SHARE = 0.05
# A level counts as clipped when the largest (or smallest) value is held by runs of at least this many samples.
CLIPPED_RUN = 3
# A crest of a coarsely quantised signal also holds its largest value; its slopes carry it at most this many steps
# beyond.
CREST_STEPS = 3.0


@dataclass(frozen=True, slots=True)
class Clock:
    """rate_hz: of the usual step; jitter_s: rms of the steps about it, gaps left out; gaps: index before each, (g,)."""

    rate_hz: float
    jitter_s: float
    gaps: NDArray[np.int64]
    gap_s: Floats


def clock(time_ns: Nanoseconds, gap_steps: float = GAP_STEPS) -> Clock:
    """Rate, jitter and gaps of increasing time stamps (n,), n at least 2.

    gap_steps: a step longer than this many usual ones is a gap.
    """
    steps = np.diff(time_ns).astype(np.float64) / NANOSECONDS
    usual = float(np.median(steps))
    is_gap = steps > gap_steps * usual
    regular = steps[~is_gap]
    mean = float(np.mean(regular)) if len(regular) else usual
    jitter = float(np.std(regular)) if len(regular) else 0.0
    return Clock(1.0 / mean, jitter, np.flatnonzero(is_gap), steps[is_gap])


def runs(mask: Mask) -> NDArray[np.int64]:
    """Start and end (exclusive) of each run of True, (r, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return edges.reshape(-1, 2)


def frozen(value: Floats, rate_hz: float) -> Mask:
    """Samples (n,) that belong to a stretch of exactly equal values of at least a second; a constant channel is all.

    A stretch at the channel's mean at either end of the record is rest, not frozen.
    """
    mask = np.zeros(len(value), dtype=bool)
    if len(value) < 2:
        return mask
    # A record shorter than that may be frozen as a whole.
    least = max(FROZEN_SAMPLES, min(round(FROZEN_S * rate_hz), len(value)))
    stretches = runs(np.concatenate(([False], np.diff(value) == 0.0)))
    for start, end in stretches[stretches[:, 1] - stretches[:, 0] + 1 >= least]:
        at_edge = start == 1 or end == len(value)
        if not (at_edge and _is_rest(value, start - 1, end)):
            mask[start - 1 : end] = True
    return mask


def _is_rest(value: Floats, start: int, end: int) -> bool:
    """Whether a held stretch lies at the mean of all other samples and is reached gently, as a structure's rest is."""
    others = np.concatenate((value[:start], value[end:]))
    others = others[np.isfinite(others)]
    if not len(others):
        return False
    small = REST_SHARE * float(np.std(others))
    beside = np.concatenate((value[max(start - 5, 0) : start + 1], value[end - 1 : end + 5]))
    return bool(abs(value[start] - np.mean(others)) < small and np.nanmax(np.abs(np.diff(beside))) < small)


def clipped(value: Floats) -> Mask:
    """Samples (n,) held at the channel's largest or smallest value in runs of at least three, as clipping does."""
    mask = np.zeros(len(value), dtype=bool)
    finite = value[np.isfinite(value)]
    if not len(finite):
        return mask
    resolution = 0.0
    for level in (finite.max(), finite.min()):
        for start, end in runs(value == level):
            if end - start < CLIPPED_RUN:
                continue
            resolution = resolution or float(np.min(np.diff(np.unique(finite)), initial=np.inf))
            mask[start:end] = overshoot(value, start, end) > CREST_STEPS * resolution
    return mask


def overshoot(value: Floats, start: int, end: int) -> float:
    """How far the slopes on both sides of a run would carry the signal beyond it, were it not held."""
    before = abs(value[start - 1] - value[start - 2]) if start >= 2 else np.inf
    after = abs(value[end + 1] - value[end]) if end + 1 < len(value) else np.inf
    slope = before + after if np.isfinite(before + after) else 2.0 * min(before, after)
    return float(0.25 * (end - start + 1) * 0.5 * slope)


def bridged(value: Floats, missing: Mask) -> Floats:
    """`value` (n,) with the missing samples on straight lines between their neighbours (held at the ends)."""
    if not missing.any():
        return value
    index = np.arange(len(value))
    known = ~missing
    filled = value.copy()
    filled[missing] = np.interp(index[missing], index[known], value[known])
    return filled


def dominant_frequency(value: Floats, rate_hz: float) -> float:
    """Frequency (Hz) of the zero crossings of `value` about its mean: where most of an acceleration's power lies."""
    centred = value - np.mean(value)
    crossings = np.count_nonzero(np.diff(np.signbit(centred)))
    return 0.5 * crossings * rate_hz / max(len(value), 1)
