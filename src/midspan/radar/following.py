"""Following a target through its bins, and what is static in each of them.

A fixed bin loses a target that moves by a good part of it: 7 dB at 40 mm and all at 80 mm for bins of 54 mm. The phase
of a target is the same in every bin of its main lobe, so the phasors are taken where the target is at the time.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.radar.channels import MIN_BINS, Phasors
from midspan.records import Floats

# Below this excursion (bins) a target needs no following: it would win 0.4 dB.
MIN_EXCURSION_BINS = 0.25
# Bins on each side beyond the target's own that are fetched.
SPARE_BINS = 2


@dataclass(frozen=True, slots=True)
class Background:
    """What is static: bins (k,) and its phasor in each (k,), receivers combined, ADC counts."""

    bins: Floats
    phasors: NDArray[np.complex128]

    def at(self, bins: Floats) -> NDArray[np.complex128]:
        """Its phasors at other bins (m,), linearly between those known; zero beyond."""
        parts = [np.interp(bins, self.bins, part, 0.0, 0.0) for part in (self.phasors.real, self.phasors.imag)]
        return np.asarray(parts[0] + 1j * parts[1])


def response(distance_bins: Floats) -> Floats:
    """Response (…,) of a Hann window to a target this many bins (…,) away: 1 at 0, ½ at 1, 0 at 2."""
    d = np.asarray(distance_bins, dtype=np.float64)
    at_one = np.abs(np.abs(d) - 1.0) < 1e-9
    return np.asarray(np.where(at_one, 0.5, np.sinc(d) / np.where(at_one, 1.0, 1.0 - d * d)))


def bins_within(place_bin: float, reach_bins: float, count: int | None = None) -> Floats:
    """Whole bins (k,) in which a target is met that moves by up to `reach_bins` about `place_bin`; count: of all."""
    low, high = np.floor(place_bin - reach_bins) - SPARE_BINS, np.ceil(place_bin + reach_bins) + SPARE_BINS
    return np.arange(max(low, 0.0), (high if count is None else min(high, count - 1.0)) + 1.0)


def at_places(phasors: Phasors, bins: Floats, places: Floats) -> Phasors:
    """Phasors (n,) of (n, k) at whole bins (k,), each taken at its own place (n,), of the amplitude at the peak."""
    place = np.clip(np.where(np.isfinite(places), places, bins[0]), bins[0], bins[-1])
    low = np.minimum(np.floor(place - bins[0]).astype(np.int64), max(len(bins) - 2, 0))
    share = place - bins[0] - low
    row = np.arange(len(phasors))
    value = (1.0 - share) * phasors[row, low] + share * phasors[row, np.minimum(low + 1, len(bins) - 1)]
    return np.asarray(value / ((1.0 - share) * response(share) + share * response(1.0 - share)))


def places_of(phasors: Phasors, bins: Floats, *, place_bin: float, moved_bins: Floats, search: float = 1.0) -> Floats:
    """Places (n,) in bins of a target that moves by `moved_bins` (n,), NaN where not known, about a common place.

    That place is the one, within `search` bins of `place_bin`, where the phasors (n, k) hold most power.
    """
    known = np.isfinite(moved_bins)
    if not known.any():
        return np.full(len(moved_bins), place_bin)
    n = np.arange(len(moved_bins))
    moved = np.interp(n, n[known], moved_bins[known]) - np.median(moved_bins[known])
    some = np.flatnonzero(known)[:: max(1, np.count_nonzero(known) // 2000)]
    # In sixteenths of a bin, on some 2000 frames.
    shifts = np.linspace(-search, search, 2 * int(np.ceil(16 * search)) + 1)
    power = [np.nansum(np.abs(_weighed(phasors[some], bins, place_bin + s + moved[some])) ** 2) for s in shifts]
    return np.asarray(place_bin + shifts[int(np.argmax(power))] + moved)


def tracked_places(power: Floats, bins: Floats, place_bin: float) -> Floats:
    """Places (n,) of the strongest bin near that of the frame before, from powers (n, k) at bins (k,).

    It begins where the bin of `place_bin` is strongest and goes from there both ways; for a target that leaves its bin.
    """
    home = int(np.argmin(np.abs(bins - place_bin)))
    begin = int(np.argmax(power[:, home]))
    # A target moves by some two bins from one frame to the next at most.
    near = np.exp(-np.square(np.arange(-len(bins) + 1, len(bins))) / (2.0 * 2.0**2))
    out = np.empty(len(power))
    for frames in (range(begin, len(power)), range(begin, -1, -1)):
        k = home
        for t in frames:
            weighed = power[t] * near[len(bins) - 1 - k : 2 * len(bins) - 1 - k]
            k = int(np.argmax(weighed)) if weighed[k] == weighed[k] else k
            out[t] = bins[k]
    return out


def _weighed(phasors: Phasors, bins: Floats, places: Floats) -> Phasors:
    """Projection (n,) of phasors (n, k) on a target at the places (n,)."""
    shape = response(bins[None, :] - places[:, None])
    return np.asarray((phasors * shape).sum(axis=1) / np.sqrt((shape**2).sum(axis=1)))


def static_in_bins(phasors: Phasors, bins: Floats, places: Floats) -> Background:
    """What is static in each bin under a target that turns many times, from phasors (n, k) and its places (n,).

    Each bin is the target's response, turning, and a constant: least squares, the phase taken again without the
    constants found before. Both are distinguished only where the phase turns several times.
    """
    shape = response(bins[None, :] - places[:, None])
    found = np.zeros(len(bins), dtype=np.complex128)
    # Each step halves what is left.
    for _ in range(4):
        z = at_places(phasors - found, bins, places)
        turn = np.exp(1j * np.angle(z))
        for k in range(len(bins)):
            known = np.isfinite(turn) & np.isfinite(phasors[:, k]) & np.isfinite(places)
            columns = np.column_stack((shape[known, k] * turn[known], np.ones(np.count_nonzero(known))))
            found[k] = np.linalg.lstsq(columns, phasors[known, k], rcond=None)[0][1]
    return Background(np.asarray(bins, dtype=np.float64), found)


def response_at(distance_bins: float) -> float:
    """`following.response` at one distance."""
    d = abs(distance_bins)
    if d < 1e-9 or abs(d - 1.0) < 1e-9:
        return 1.0 if d < 0.5 else 0.5
    return math.sin(math.pi * d) / (math.pi * d * (1.0 - d * d))


def between(share: float) -> float:
    """Response of two neighbouring bins, weighed linearly, to a target that lies a share of a bin from the lower."""
    return (1.0 - share) * response_at(share) + share * response_at(1.0 - share)


def noise_between(share: float) -> float:
    """Variance of the noise of two neighbouring bins, weighed linearly, over that of one."""
    # The covariance of neighbouring bins of a Hann window is 2/3 of the variance of one.
    return 1.0 - 2.0 * (1.0 - 2.0 / 3.0) * share * (1.0 - share)


def fraction_between(low: complex, high: complex, value: complex) -> float:
    """Where between two bins a target of phasor `value` lies, -½ to 1½: its responses are as 2 − d to 1 + d."""
    a, b = (low * value.conjugate()).real, (high * value.conjugate()).real
    return min(max((2.0 * b - a) / (a + b), -0.5), 1.5) if a + b > 0.0 else 0.5


def looked_at(z: list[complex], first_bin: float, place: tuple[float, float]) -> float:
    """Fractional bin where a target is met: where it is expected, or at the strongest bin where that is not sure.

    z: phasors of the bins from `first_bin` on; place: expected bin, and how far from it the target may be.
    """
    expected, reach = place
    if not reach > MIN_EXCURSION_BINS:
        return expected
    near = [k for k in range(len(z)) if abs(first_bin + k - expected) <= reach + 0.5] or range(len(z))
    k = max(near, key=lambda bin_: abs(z[bin_]))
    low = k if k + 1 < len(z) and (k == 0 or abs(z[k + 1]) > abs(z[k - 1])) else k - 1
    return first_bin + low + fraction_between(z[low], z[low + 1], z[k])


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
        inner = values[1:-1]
        high = (inner > values[:-2]) & (inner >= values[2:]) & (inner > least)
        for k in map(int, np.flatnonzero(high) + 1):
            if not any(abs(k - known) <= 1 for known in found):
                found[k] = k + _fraction(values[k - 1 : k + 2])
    strongest = sorted(found, key=lambda k: -power[k])[:MAX_TARGETS]
    return tuple(found[k] for k in sorted(strongest))


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
