"""A slow sensor that repeats one value while the structure moves."""

import numpy as np

from midspan.records import Floats
from midspan.signals.health import Mask, runs
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
