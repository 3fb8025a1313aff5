"""Acceleration that is missing, as the radar itself saw the motion: for unwrapping only, never for the fusion."""

import numpy as np
from numpy.typing import NDArray

from midspan.recording.radar.clock import Seen
from midspan.records import NANOSECONDS, Floats, seconds

# Shorter gaps are bridged well enough, s; the phase is looked at from so long before to so long after each, s.
LEAST_GAP_S, REACH_S = 0.05, 0.3
# The acceleration is the curvature of a quartic through so much of the phase, s, and of this many frames at least.
FITTED_S, LEAST_FRAMES = 0.2, 7
# The target must be seen in this share of the frames, with this share of its amplitude.
LEAST_SEEN, LEAST_SHARE = 0.9, 0.3


def gaps_filled(samples: Floats, gaps_ns: NDArray[np.int64], seen: Seen) -> Floats:
    """Samples (m, 2) with those of gaps (k, 2) put in from the curvature of the best target's phase.

    gaps_ns: last stamp before and first one after each, with the origin of the samples and of `seen`. A motion too fast
    for plain unwrapping, or a target that is not seen, leaves a gap as it is bridged.
    """
    time_s = seconds(seen.time_ns, 0) + seen.offset_s
    step_s = float(np.median(np.diff(samples[:, 0])))
    level = float(np.mean(samples[:, 1]))
    for first, last in gaps_ns / NANOSECONDS:
        if last - first <= LEAST_GAP_S:
            continue
        near = slice(*np.searchsorted(time_s, (first - REACH_S, last + REACH_S)))
        curved = _curvature(time_s[near], np.asarray(seen.phasors)[near], seen)
        if curved is None:
            continue
        at = np.arange(first + step_s, last - 0.5 * step_s, step_s)
        filled = np.column_stack((at, level + np.interp(at, *curved)))
        before, after = samples[samples[:, 0] <= first + 1e-9], samples[samples[:, 0] >= last - 1e-9]
        samples = np.concatenate((before, filled, after))
    return samples


def _curvature(time_s: Floats, z: NDArray[np.complex64], seen: Seen) -> tuple[Floats, Floats] | None:
    """Instants (s) and structural acceleration (m/s²) by the phase; None where it does not show them."""
    from scipy.signal import savgol_filter

    known = np.isfinite(z) & (np.abs(z) > LEAST_SHARE * seen.amplitude)
    if len(z) < 3 or np.mean(known) < LEAST_SEEN:
        return None
    period = float(np.median(np.diff(time_s)))
    width = max(LEAST_FRAMES, 2 * round(0.5 * FITTED_S / period) + 1)
    even = np.arange(time_s[0], time_s[-1], period)
    if len(even) < width:
        return None
    moved = np.unwrap(np.angle(z[known]).astype(np.float64)) / (seen.phase_per_m * seen.ratio)
    place = np.interp(even, time_s[known], moved)
    return even, np.asarray(savgol_filter(place, width, 4, deriv=2, delta=period), dtype=np.float64)
