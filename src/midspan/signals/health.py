"""What is wrong with a channel (gaps, missing values, frozen segments, jitter of its clock), what is not
known of a motion while it is not seen, and how lively it is.

Gain, cross axis sensitivity, attitude and lever arm all make an error in proportion to the motion itself, so that the
noise of an accelerometer is taken as q(t) = q0 + kappa <a²>(t), with the mean square `mean_square`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import NANOSECONDS, Floats, Nanoseconds

Mask = NDArray[np.bool_]

# A step in time is a gap when it is longer than this many usual steps.
MISSED_STEPS = 1.5
# Equal values count as frozen where chance hardly makes such a run (see the core's `equal_runs`), by the share of equal
# neighbours over this time, s, which holds some periods of a motion; at first a share that takes a second at 200 Hz.
EQUAL_MEMORY_S = 5.0
EQUAL_AT_FIRST = 0.9
# A run that ends with a step of at most this many of the smallest ones was rest or chance; what follows a freeze jumps.
REST_STEPS = 1.5
# One or two samples are a spike where they are this many times as far from the mean as the record's standard deviation,
# and as the two samples on either side: a motion that is gone a sample later would be far above the Nyquist frequency,
# and an impact rings.
SPIKE, SPIKE_SAMPLES, NEIGHBOURS = 100.0, 2, 2
# The end of the range is held for a shorter time than this by clipping, and longer by a frozen sensor.
CLIPPED_S = 1.0
# A structure at rest before or after the motion may give exactly equal values too: then at the channel's mean, within
# this share of its standard deviation.
REST_SHARE = 0.05
# Steps up to this many usual ones are jitter or a single lost sample, which the filter takes as they are.
GAP_STEPS = 2.5
# A gap is long when its density is above this share of that of a wholly unknown motion.
LONG_SHARE = 0.1
# Motion is not taken to be slower than this when something has to be bridged.
MIN_HZ = 0.2
# The mean is over about a second: exponential, of this time constant. On real records 0.1 s to 2 s are alike.
MEMORY_S = 0.5


@dataclass(frozen=True, slots=True)
class Clock:
    """rate_hz: of the usual step; jitter_s: rms of the steps about it, gaps left out; gaps: index before each, (g,)."""

    rate_hz: float
    jitter_s: float
    gaps: NDArray[np.int64]
    gap_s: Floats


def clock(time_ns: Nanoseconds, gap_steps: float = MISSED_STEPS) -> Clock:
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


@dataclass(frozen=True, slots=True)
class EqualRuns:
    """Runs of equal values: length (n,) of the run up to each sample, 0 for no number; frozen (n,): the length from
    which on it counts as frozen; share (n,): of equal neighbours before the run.
    """

    length: NDArray[np.int64]
    frozen: NDArray[np.int64]
    share: Floats


def equal_runs(
    value: Floats, rate_hz: float, resolution: float, before: tuple[float, int, float] = (np.nan, 0, EQUAL_AT_FIRST)
) -> EqualRuns:
    """Follow runs of equal values (n,) from `before`: the value, length and share of the sample before the first one.

    resolution: the smallest step of values. Any cutting of the samples gives the same.
    """
    forget = 1.0 / max(EQUAL_MEMORY_S * rate_hz, 1.0)
    contiguous = np.ascontiguousarray(value, dtype=np.float64)
    return EqualRuns(*_core.follow_equal_runs(contiguous, before, forget, REST_STEPS * resolution))


def smallest_step(value: Floats) -> float:
    """The smallest step between the values (n,) that occur; infinite where they all are one."""
    return float(np.min(np.diff(np.unique(value[np.isfinite(value)])), initial=np.inf))


def frozen(value: Floats, rate_hz: float) -> Mask:
    """Samples (n,) that only repeat the one before, in a run that is longer than chance makes it; of a constant
    channel all.

    A run at the channel's mean at either end of the record is rest, not frozen. A run of less than a second at the
    channel's largest or smallest value is left to `clipping.clipped`.
    """
    mask = np.zeros(len(value), dtype=bool)
    if len(value) < 2 or bool(np.all(value == value[0])):
        return ~mask if len(value) > 1 else mask
    found = equal_runs(value, rate_hz, smallest_step(value))
    at_limit = (value == np.fmax.reduce(value)) | (value == np.fmin.reduce(value))
    least = np.where(at_limit, np.fmax(found.frozen, CLIPPED_S * rate_hz), found.frozen)
    for start, end in runs(found.length > 1):
        at_edge = start == 1 or end == len(value)
        long = end - start + 1 >= least[start]
        if long and not (at_edge and _is_rest(value, start - 1, end)):
            mask[start:end] = True
    return mask


def _is_rest(value: Floats, start: int, end: int) -> bool:
    """Whether a held segment lies at the mean of all other samples and is reached gently, as a structure's rest is."""
    others = np.concatenate((value[:start], value[end:]))
    others = others[np.isfinite(others)]
    if not len(others):
        return False
    small = REST_SHARE * float(np.std(others))
    neighbours = np.concatenate((value[max(start - 5, 0) : start + 1], value[end - 1 : end + 5]))
    return bool(abs(value[start] - np.mean(others)) < small and np.nanmax(np.abs(np.diff(neighbours))) < small)


def spikes(value: Floats, mean: float, std: float) -> Mask:
    """Samples (n,) that stand alone, `SPIKE` times as far from `mean` as `std` and as their neighbours."""
    mask = np.zeros(len(value), dtype=bool)
    apart = np.abs(value - mean)
    for start, end in runs(apart > SPIKE * std):
        neighbours = np.concatenate((apart[max(start - NEIGHBOURS, 0) : start], apart[end : end + NEIGHBOURS]))
        mask[start:end] = end - start <= SPIKE_SAMPLES and not (SPIKE * neighbours > apart[start:end].min()).any()
    return mask


def lone_spikes(value: Floats) -> Mask:
    """The spikes of a whole record (n,), by the standard deviation of all but a hundredth of it at either end."""
    known = value[np.isfinite(value)]
    if not len(known):
        return np.zeros(len(value), dtype=bool)
    usual = np.clip(known, *np.quantile(known, (0.01, 0.99)))
    return spikes(value, float(np.mean(usual)), max(float(np.std(usual)), smallest_step(usual)))


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


def missed_share(length_s: float, frequency_hz: float) -> float:
    """Share of a motion's amplitude that a straight line over `length_s` misses, (2 pi f T)²/8, at most 1."""
    return min(1.0, (2.0 * np.pi * frequency_hz * length_s) ** 2 / 8.0)


def unknown_density(value: Floats, rate_hz: float) -> float:
    """Noise density, (m/s²)²/Hz, for a motion like `value` (n,) that was not seen: its variance over its bandwidth."""
    return float(np.var(value)) / max(dominant_frequency(value, rate_hz), MIN_HZ)


def mean_square(value: Floats, mean: float, before: float, rate_hz: float) -> Floats:
    """Mean square (n,) of an acceleration (n,) without its `mean`, over what came up to each sample, m²/s⁴.

    before: the mean square at the sample before the first one. Any cutting of the samples gives the same.
    """
    kept = math.exp(-1.0 / (MEMORY_S * rate_hz))
    return _core.mean_square(np.ascontiguousarray(value, dtype=np.float64), mean, before, kept)
