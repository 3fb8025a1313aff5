"""Following a target through its bins, and what is static in each of them.

A fixed bin loses a target that moves by a good part of it: 7 dB at 40 mm and all at 80 mm for bins of 54 mm. The phase
of a target is the same in every bin of its main lobe, so the phasors are taken where the target is at the time.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.radar.channels import Phasors
from midspan.records import Floats

# Below this excursion (bins) a target needs no following: it would win 0.4 dB.
MIN_EXCURSION_BINS = 0.25
# Bins on each side beyond the target's own that are fetched.
SPARE_BINS = 2
# Steps of the background's fit: each halves what is left.
STEPS = 4
# How far from the frame before a target is looked for without a prediction, bins.
NEAR_BINS = 2.0
# A record's place is looked for in steps of this many bins, on some of its frames.
SEARCHED_STEP, SEARCHED_FRAMES = 1 / 16, 2000


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
    some = np.flatnonzero(known)[:: max(1, np.count_nonzero(known) // SEARCHED_FRAMES)]
    shifts = np.linspace(-search, search, 2 * int(np.ceil(search / SEARCHED_STEP)) + 1)
    power = [np.nansum(np.abs(_weighed(phasors[some], bins, place_bin + s + moved[some])) ** 2) for s in shifts]
    return np.asarray(place_bin + shifts[int(np.argmax(power))] + moved)


def tracked_places(power: Floats, bins: Floats, place_bin: float) -> Floats:
    """Places (n,) of the strongest bin near that of the frame before, from powers (n, k) at bins (k,).

    It begins where the bin of `place_bin` is strongest and goes from there both ways; for a target that leaves its bin.
    """
    home = int(np.argmin(np.abs(bins - place_bin)))
    begin = int(np.argmax(power[:, home]))
    near = np.exp(-np.square(np.arange(-len(bins) + 1, len(bins))) / (2.0 * NEAR_BINS**2))
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


def standing_in_bins(phasors: Phasors, bins: Floats, places: Floats) -> Background:
    """What is static in each bin under a target that turns many times, from phasors (n, k) and its places (n,).

    Each bin is the target's response, turning, and a constant: least squares, the phase taken again without the
    constants found before. Both are distinguished only where the phase turns several times.
    """
    shape = response(bins[None, :] - places[:, None])
    found = np.zeros(len(bins), dtype=np.complex128)
    for _ in range(STEPS):
        z = at_places(phasors - found, bins, places)
        turn = np.exp(1j * np.angle(z))
        for k in range(len(bins)):
            known = np.isfinite(turn) & np.isfinite(phasors[:, k]) & np.isfinite(places)
            columns = np.column_stack((shape[known, k] * turn[known], np.ones(np.count_nonzero(known))))
            found[k] = np.linalg.lstsq(columns, phasors[known, k], rcond=None)[0][1]
    return Background(np.asarray(bins, dtype=np.float64), found)
