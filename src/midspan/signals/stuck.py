"""A slow sensor that repeats one value while the structure moves, or is held at the end of its range."""

import numpy as np

from midspan.records import Floats
from midspan.signals.health import CLIPPED_RUN, CREST_STEPS, Mask, overshoot, runs
from midspan.signals.integrate import path

# This many exactly equal values in a row are looked at.
MIN_EQUAL = 5
# A segment is judged in pieces of this length, or of MIN_EQUAL values where these take longer: over a long time
# twice integrated noise is larger than any motion.
PIECE_S = 4.0
# The motion must leave the value's resolution by this many times, and the accelerometer's own noise by far: noise of
# density S, integrated twice over T, spans 0.07 · √(S T³) on average about a parabola, and 0.2 in one of a thousand.
RESOLUTIONS = 2.0
NOISE_SPAN = 0.5
# Values that differ by this share differ by rounding alone.
LAST_DIGITS = 1e-9
# Values this many steps of the resolution from the largest are looked at; one record in a million without an end of the
# range seems to have one.
NEAR_STEPS, RECURS = 100.0, 1e-6
# Differences below this share of the values' span are rounding, not resolution.
ROUNDING = 1e-6


def stuck(time_s: Floats, value: Floats, samples: Floats, *, resolution_m: float) -> Mask:
    """Values (n,) of runs of at least five exactly equal ones over which the structure clearly moved.

    time_s (n,) increasing, value (n,), not-a-number where missing; samples (m, 3): time (s) on the same clock,
    acceleration (m/s²), density of its noise ((m/s²)²/Hz); resolution_m: what the values are rounded to, m (see
    `resolution`). A sensor of coarse resolution may be static while the motion stays within it; and of a parabola in
    time the acceleration tells nothing.
    """
    known = np.flatnonzero(np.isfinite(value))
    mask = np.zeros(len(value), dtype=bool)
    if len(known) < MIN_EQUAL:
        return mask
    equal = runs(np.concatenate(([False], np.diff(value[known]) == 0.0)))
    least = RESOLUTIONS * resolution_m
    for start, end in equal[equal[:, 1] - equal[:, 0] + 1 >= MIN_EQUAL]:
        held = known[start - 1 : end]
        pieces = _pieces(time_s[held])
        if any(moved(time_s[held[a:b]], samples, least) for a, b in pieces):
            mask[held] = True
    return mask


def at_limits(value: Floats, low: float, high: float) -> Mask:
    """Which values (n,) are held at an end of the range; both may have been scaled, so the last digits do not count."""
    return np.asarray((value <= low + LAST_DIGITS * abs(low)) | (value >= high - LAST_DIGITS * abs(high)))


def range_limits(value: Floats) -> tuple[float, float]:
    """The ends of the sensor's range, in the unit of the values (n,), where they are held there; ∓ infinite where not.

    It is held at its smallest or largest value where that comes back, once at least for three values that the slopes
    on both sides would have carried clearly beyond, or for fewer, more often than chance makes it.
    """
    known = value[np.isfinite(value)]
    limits = [-np.inf, np.inf]
    if len(known) < MIN_EQUAL:
        return -np.inf, np.inf
    clear = CREST_STEPS * resolution(known)
    for side, level in enumerate((float(known.min()), float(known.max()))):
        visits = [(int(a), int(b)) for a, b in runs(known == level) if a >= 2 and b + 1 < len(known)]
        beyond = [b - a >= CLIPPED_RUN and overshoot(known, a, b) > clear for a, b in visits]
        if (len(visits) > 1 and any(beyond)) or _recurs(known, level):
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


def piece_length(step_s: float) -> int:
    """How many values, `step_s` apart, are judged together."""
    return max(MIN_EQUAL, int(np.ceil(PIECE_S / step_s)))


def _pieces(time_s: Floats) -> list[tuple[int, int]]:
    """Start and end (exclusive) of pieces long enough to be judged, overlapping by half."""
    count = piece_length(float(np.median(np.diff(time_s))))
    if len(time_s) <= count:
        return [(0, len(time_s))]
    starts = [*range(0, len(time_s) - count, max(count // 2, 1)), len(time_s) - count]
    return [(a, a + count) for a in starts]


def moved(time_s: Floats, samples: Floats, least_m: float) -> bool:
    """Whether the acceleration tells a motion at these instants (k,) that no parabola and no noise explains.

    samples (m, 3): as of `stuck`; they must reach from the first instant to the last. least_m: what it must exceed.
    """
    first, last = np.searchsorted(samples[:, 0], (time_s[0], time_s[-1]))
    near = samples[max(first - 1, 0) : last + 1]
    if len(near) < MIN_EQUAL or near[-1, 0] < time_s[-1] or near[0, 0] > time_s[0]:
        return False
    swept = path(time_s, near[:, 0], near[:, 1])
    length = float(time_s[-1] - time_s[0])
    powers = np.vander((time_s - time_s[0]) / length, 3)
    left = swept - powers @ np.linalg.lstsq(powers, swept, rcond=None)[0]
    return bool(np.ptp(left) > max(least_m, NOISE_SPAN * np.sqrt(np.max(near[:, 2]) * length**3)))
