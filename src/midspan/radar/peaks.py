"""Peaks of range profiles, and the phasors at them."""

import numpy as np

from midspan.radar.channels import MIN_BINS, Phasors
from midspan.records import Floats

# A peak counts from this power ratio to the noise on, and this many are looked at. A weak one has, receivers combined,
# the least ratio at which the phase can be unwrapped (4 dB).
MIN_POWER_RATIO, WEAK_POWER_RATIO, MAX_TARGETS = 10.0, 2.5, 40


def peaks(profiles: Phasors, noise: float, *, weak: bool = False) -> tuple[float, ...]:
    """Fractional bins of the peaks of the mean power, and of the power that changes, of (frames, channels, bins).

    noise: power of one receiver's; weak: also of targets that no single frame shows, but the mean of all does.
    """
    z = np.asarray(profiles)
    if z.shape[2] < MIN_BINS:
        # Stored targets, not a profile.
        return tuple(float(k) for k in range(z.shape[2]))
    power = np.mean(np.abs(z) ** 2, axis=(0, 1))
    changing = np.maximum(power - np.mean(np.abs(z.mean(axis=0)) ** 2, axis=0), 0.0)
    least = (1.0 + WEAK_POWER_RATIO / z.shape[1] if weak else MIN_POWER_RATIO) * noise
    found: dict[int, float] = {}
    for values in (power, changing):
        for k in _summits(values, least):
            if not any(abs(k - known) <= 1 for known in found):
                found[k] = k + _fraction(values[k - 1 : k + 2])
    strongest = sorted(found, key=lambda k: -power[k])[:MAX_TARGETS]
    return tuple(found[k] for k in sorted(strongest))


def _summits(values: Floats, least: float) -> list[int]:
    inner = values[1:-1]
    high = (inner > values[:-2]) & (inner >= values[2:]) & (inner > least)
    return [int(k) + 1 for k in np.flatnonzero(high)]


def _fraction(three: Floats) -> float:
    """Where between -½ and ½ a peak of three powers of a Hann window lies; their logarithms are near a parabola."""
    # Single precision holds no 1e-300.
    low, middle, high = np.log(np.maximum(three.astype(np.float64), 1e-300))
    bend = low - 2.0 * middle + high
    return float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def at_place(profiles: Phasors, place_bin: float) -> Phasors:
    """Phasors (frames, channels) at a fractional bin: the two nearest bins, which a Hann window has in phase."""
    low = min(max(int(np.floor(place_bin)), 0), max(profiles.shape[2] - 2, 0))
    share = place_bin - low
    high = min(low + 1, profiles.shape[2] - 1)
    return np.asarray((1.0 - share) * profiles[..., low] + share * profiles[..., high])
