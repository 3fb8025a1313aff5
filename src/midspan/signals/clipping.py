"""A channel that is held at an end of its range: which samples are, where that end lies, the crests as they were."""

from dataclasses import dataclass

import numpy as np

from midspan.records import Floats
from midspan.signals.health import Mask, runs, smallest_step

# From this many equal samples on the slopes alone tell a crest that was cut off: of 60 sound records of ten minutes
# (motion to 10 Hz at 100 Hz, rms 100 steps) one has such a crest. Fewer, 2 at least, lie evenly about a sound crest
# more often (3: in 18 of the 60, 2: in all): they are clipped only where the range ends.
CLIPPED_RUN, SHORTEST_RUN = 4, 2
# A run is cut off where the slopes carry the signal beyond it by this factor more than a rounded parabola's.
CREST = 2.0
# Values this many steps of the resolution from the largest are looked at; one record in a million without an end of the
# range seems to have one.
NEAR_STEPS, RECURS = 100.0, 1e-6
# Differences below this share of the values' span are rounding, not resolution.
ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class Levels:
    """Mean, standard deviation and smallest step of a channel's values, and the ends of its range as of `range_limits`.

    All are in the unit of the values.
    """

    mean: float
    std: float
    resolution: float
    low: float = -np.inf
    high: float = np.inf


def clipped(value: Floats) -> Mask:
    """Samples (n,) held at an end of the range, at whatever level that is; the first of a run is taken as it is."""
    mask = np.zeros(len(value), dtype=bool)
    finite = value[np.isfinite(value)]
    if not len(finite):
        return mask
    levels = Levels(float(np.mean(finite)), float(np.std(finite)), smallest_step(finite), *range_limits(finite))
    for second, end in runs(np.concatenate(([False], np.diff(value) == 0.0))).tolist():
        mask[second:end] = is_clipped(value, (second - 1, end), levels)
    return mask


def is_clipped(value: Floats, run: tuple[int, int], levels: Levels) -> bool:
    """Whether a run (start, end) of equal values (n,) is a crest that was cut off.

    It is one that lies farther than the standard deviation from the mean; a brief one lies at an end of the range.
    """
    start, end = run
    shortest = SHORTEST_RUN if value[start] in (levels.low, levels.high) else CLIPPED_RUN
    if end - start < shortest or not abs(value[start] - levels.mean) > levels.std:
        return False
    return is_cut_off(value, run, levels.resolution, above=value[start] > levels.mean)


def is_cut_off(value: Floats, run: tuple[int, int], resolution: float, *, above: bool) -> bool:
    """Whether the slopes on both sides of a run (start, end) of equal values (n,) would carry it clearly beyond.

    above: it lies at the signal's upper end; the signal comes to it and goes from it on the other side.
    """
    start, end = run
    came = start == 0 or (value[start - 1] < value[start]) == above
    went = end == len(value) or (value[end] < value[start]) == above
    # How many steps beyond it the slopes carry a parabola of which this many samples are rounded to one value.
    count = end - start
    steps = (count + 1) * (count + 2) / (count - 1) ** 2
    return bool(came and went) and overshoot(value, start, end) > CREST * steps * resolution


def overshoot(value: Floats, start: int, end: int) -> float:
    """How far the slopes on both sides of a run would carry the signal beyond it, were it not held."""
    before = abs(value[start - 1] - value[start - 2]) if start >= 2 else np.inf
    after = abs(value[end + 1] - value[end]) if end + 1 < len(value) else np.inf
    slope = before + after if np.isfinite(before + after) else 2.0 * min(before, after)
    return float(0.25 * (end - start + 1) * 0.5 * slope)


def crest(value: Floats, start: int, end: int) -> Floats:
    """The samples (end - start,) of a crest of which a run is left: a cubic with the values and slopes on either side.

    Where a side is missing the crest is as steep there as on the other.
    """
    before = value[start - 1] - value[start - 2] if start >= 2 else np.nan
    after = value[end + 1] - value[end] if end + 1 < len(value) else np.nan
    up = before if np.isfinite(before) else -after
    down = after if np.isfinite(after) else -before
    low = value[start - 1] if start >= 1 else value[start]
    high = value[end] if end < len(value) else value[end - 1]
    if not np.isfinite([up, down, low, high]).all():
        return value[start:end]
    length = end - start + 1
    x = np.arange(1, length) / length
    rise = length * (up * x * (1.0 - x) ** 2 - down * x**2 * (1.0 - x))
    found = low + (high - low) * x**2 * (3.0 - 2.0 * x) + rise
    # The signal was beyond what it was held at.
    return np.asarray(np.maximum(found, value[start]) if up > 0.0 else np.minimum(found, value[start]))


def with_crests(value: Floats, held: Mask) -> Floats:
    """`value` (n,) with the samples that are `held` on the crests that were cut off."""
    if not held.any():
        return value
    drawn = value.copy()
    for start, end in runs(held).tolist():
        first, *rest = crest(value, start - 1, end)
        drawn[start:end] = rest
        # What the first sample of the run was short of is made up for by the next one: the velocity is right then.
        drawn[start] += first - value[start - 1]
    return drawn


def range_limits(value: Floats) -> tuple[float, float]:
    """The ends of the sensor's range, in the unit of the values (n,), where they are held there; ∓ infinite where not.

    It is held at its smallest or largest value where crests were cut off there at least twice, or where it comes back
    there more often than chance makes it.
    """
    known = value[np.isfinite(value)]
    limits = [-np.inf, np.inf]
    if not len(known):
        return -np.inf, np.inf
    step = resolution(known)
    for side, level in enumerate((float(known.min()), float(known.max()))):
        visits = [(int(a), int(b)) for a, b in runs(known == level) if a >= 2 and b + 1 < len(known)]
        brief = [visit for visit in visits if visit[1] - visit[0] >= SHORTEST_RUN]
        cut_off = sum(is_cut_off(known, visit, step, above=side == 1) for visit in brief)
        if cut_off > 1 or _recurs(known, level):
            limits[side] = level
    return limits[0], limits[1]


def _recurs(value: Floats, level: float) -> bool:
    """Whether values (n,) come to their smallest or largest one more often than those of a motion do.

    Of all motions a sine stays near its crests for longest: within d of a crest as the root of d. So of the values
    within this number of steps of the crest one over the root of that number are on it at most. Long runs may be rest.
    """
    from scipy.special import bdtrc

    step = resolution(value)
    steps = min(NEAR_STEPS, 0.5 * float(np.ptp(value)) / step) if step > 0.0 else 0.0
    brief = [int(b - a) for a, b in runs(value == level) if b - a < CLIPPED_RUN]
    near = int(np.count_nonzero(np.abs(value - level) <= steps * step))
    return steps > 1.0 and len(brief) > 1 and float(bdtrc(sum(brief) - 1, near, steps**-0.5)) < RECURS


def resolution(value: Floats) -> float:
    """The smallest step between the values (n,) that occur, in their unit; 0 where they all are one."""
    levels = np.unique(value[np.isfinite(value)])
    steps = np.diff(levels)
    clear = steps[steps > ROUNDING * float(levels[-1] - levels[0])] if len(levels) > 1 else steps
    return float(clear.min()) if len(clear) else 0.0
