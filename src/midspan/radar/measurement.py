"""From the phasors of a calibrated target in a calibration window to its displacement, looking both ways in time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.checks import refuse, same_length
from midspan.errors import UntrustedError
from midspan.radar.aligned import Unwrapped, unwrap_aligned
from midspan.radar.blockage import blocked
from midspan.radar.channels import Phasors, combined, combined_bins, phase_variance
from midspan.radar.following import MIN_EXCURSION_BINS, at_places, places_of, static_in_bins, tracked_places
from midspan.radar.target import FOLLOWING_PASSES, Target
from midspan.records import Floats

# The frames are gone through again until the places change by less than this.
SETTLED_BINS = 0.1
# A target seen in fewer frames than this share is looked for in the other bins.
MOSTLY_SEEN = 0.95
# The prediction of an unseen target is a place to look for it up to this standard deviation, m.
FIRM_M = 5e-3


@dataclass(frozen=True, slots=True)
class TargetSeries:
    """Displacement of the structure seen at one target, arrays (n,): NaN where it was not seen.

    range_change_m: change of the range since the first frame used; value_m: the same times the conversion factor;
    variance_m2: of value_m, as the radar's stage states it: new in every frame, infinite where not seen; restarts:
    first frames from which on the cycle was in doubt.
    """

    value_m: Floats
    variance_m2: Floats
    range_change_m: Floats
    restarts: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class TargetFrames:
    """What a source gives of one target: frame_s (n,) on the radar's clock, s; phasors and valid (n, channels).

    bins (k,): whole bins of phasors (n, channels, k), `bin_m` apart, so that a target which moves far is followed from
    bin to bin (`Target.bins`).
    """

    frame_s: Floats
    phasors: Phasors
    valid: NDArray[np.bool_]
    bins: Floats | None = None
    bin_m: float = np.nan


def displacement(frames: TargetFrames, target: Target, *, samples: Floats, phase_per_m: float) -> TargetSeries:
    """Displacement at a calibrated target over evenly spaced frames.

    samples (m, 2): time on the accelerometer's clock (s) and acceleration (m/s²); phase_per_m: rad per m of range at
    the target (`ChirpProfile.phase_per_m`). Raises UntrustedError for a target without a conversion factor.
    """
    if not np.isfinite(target.conversion_factor):
        raise UntrustedError(f"The target {target.place} cannot be used: {target.objection}.")
    same_length(frame_s=frames.frame_s, phasors=frames.phasors, valid=frames.valid)
    given = (frames.frame_s + target.time_offset_s, samples, phase_per_m)
    if frames.bins is None:
        z = combined(frames.phasors, target.weights, frames.valid) - target.leak
        return _series(_unwrapped(z, target, given), target, phase_per_m)
    bins = np.asarray(frames.bins, dtype=np.float64)
    if frames.phasors.ndim != 3 or frames.phasors.shape[2] != len(bins) or not frames.bin_m > 0:
        raise refuse("phasors, bins and bin_m", "(n, channels, bins), (bins,) and > 0 m", frames.phasors.shape)
    seen = combined_bins(frames.phasors, target.weights, frames.valid)
    places = np.full(len(seen), target.place_bin)
    still = target.background.at(bins) if target.background is not None else np.full(len(bins), target.leak)
    for turn in range(FOLLOWING_PASSES):
        found = _unwrapped(at_places(seen - still, bins, places), target, given)
        if turn == 0 and np.mean(np.isfinite(found.phase_rad)) < MOSTLY_SEEN:
            # It may have left its bin, not be blocked: the strongest bin of each frame tells.
            places = tracked_places(np.abs(seen - still) ** 2, bins, target.place_bin)
            again = _unwrapped(at_places(seen - still, bins, places), target, given)
            more = np.count_nonzero(np.isfinite(again.phase_rad)) > np.count_nonzero(np.isfinite(found.phase_rad))
            found = again if more else found
        moved = _moved_m(found, phase_per_m) / frames.bin_m
        before, places = places, places_of(seen - still, bins, place_bin=target.place_bin, moved_bins=moved)
        if float(np.max(np.abs(places - before), initial=0.0)) < SETTLED_BINS:
            break
        if target.background is None and np.ptp(places) > 2.0 * MIN_EXCURSION_BINS:
            # The target was not found to go through these bins; it has now turned often enough to tell.
            still = static_in_bins(seen, bins, np.where(np.isfinite(found.phase_rad), places, np.nan)).phasors
    return _series(found, target, phase_per_m)


def _unwrapped(z: Phasors, target: Target, given: tuple[Floats, Floats, float]) -> Unwrapped:
    """Phase of phasors (n,) without what is static; given: instants (n,) in s, samples, rad per m of range."""
    frame_s, samples, unit = given
    hidden = blocked(np.abs(z), target.amplitude, target.noise_variance)
    variance = np.where(hidden, np.inf, phase_variance(z, target.noise_variance))
    return unwrap_aligned(
        frame_s,
        np.angle(z).astype(np.float64),
        variance_rad2=variance,
        samples=samples,
        phase_per_m=unit,
        ratio=1.0 / target.conversion_factor,
    )[0]


def _moved_m(found: Unwrapped, unit: float) -> Floats:
    """Change of the range (n,), as the filter predicts it where the frame was not used but the prediction is firm."""
    firm = np.where(np.sqrt(found.filtered_variance_m2) < FIRM_M, found.filtered_m, np.nan)
    return np.where(np.isfinite(found.phase_rad), found.phase_rad / unit, firm)


def _series(found: Unwrapped, target: Target, unit: float) -> TargetSeries:
    """An unwrapped phase in metres."""
    factor = target.conversion_factor
    white = found.variance_rad2 + target.phase_noise_rad2 + target.bent_rad**2
    change = found.phase_rad / unit
    return TargetSeries(factor * change, (factor / unit) ** 2 * white, change, found.restarts)
