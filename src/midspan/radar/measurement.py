"""From the phasors of a calibrated target to displacement: receivers, blockage, unwrapping and conversion in a row."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from midspan.checks import refuse, same_length
from midspan.errors import UntrustedError
from midspan.radar.aligned import unwrap_aligned
from midspan.radar.alignment import Alignment, Integrals
from midspan.radar.blockage import BlockageMonitor, BlockageSettings
from midspan.radar.channels import Phasors, combined, phase_variance
from midspan.radar.cycles import CycleVerdict, verify_cycles
from midspan.radar.following import LEAST_EXCURSION_BINS, at_places, places_of, standing_in_bins, tracked_places
from midspan.radar.phase_filter import Unwrapped
from midspan.radar.phase_noise import bending, measured_variance, modulation, slip_variance
from midspan.radar.target import Target
from midspan.records import Floats

# A record is gone through again until the places change by less than this, at most so often.
SETTLED_BINS, MOST_PASSES = 0.1, 4
# A target seen in fewer frames than this share is looked for in the other bins.
MOSTLY_SEEN = 0.95
# The prediction of an unseen target is a place to look for it up to this standard deviation, m.
FIRM_M = 5e-3


@dataclass(frozen=True, slots=True)
class TargetSeries:
    """Displacement of the structure seen at one target, arrays (n,): value_m is NaN where it was not seen.

    value_m is conversion factor × change of the range since the first frame used. variance_m2: its variance, infinite
    where not seen: receiver, measured phase noise, what else is in the bin and, where the accelerometer does not
    explain the phase, cycles that may have been lost; not the factor, whose relative standard deviation is that of the
    target and scales with the displacement. noise_variance_m2: the part of it that is new in every frame; the rest, of
    standard deviation `clutter_m`, comes back with the range and does not average out.
    range_change_m: before the factor; predicted_m, predicted_variance_m2: the range change as the filter goes on by the
    accelerometer while nothing is seen; status: `Status` codes; restarts: first frames from which on the cycle was in
    doubt, and verdicts: what became of each; explained: whether the accelerometer accounts for the phase; warnings:
    sentences.
    """

    value_m: Floats
    variance_m2: Floats
    range_change_m: Floats
    status: NDArray[np.uint8]
    restarts: tuple[int, ...]
    verdicts: tuple[CycleVerdict, ...]
    alignment: Alignment | None
    noise_variance_m2: Floats
    predicted_m: Floats
    predicted_variance_m2: Floats
    clutter_m: float
    explained: bool
    warnings: tuple[str, ...]

    @property
    def excursion_m(self) -> float:
        """Largest distance of the range from its median, m, where seen or firmly predicted; for `Target.bins`."""
        firm = np.where(self.predicted_variance_m2 < FIRM_M**2, self.predicted_m, np.nan)
        known = np.where(np.isfinite(self.range_change_m), self.range_change_m, firm)
        known = known[np.isfinite(known)]
        return float(np.max(np.abs(known - np.median(known)), initial=0.0)) if len(known) else 0.0

    @property
    def new_datum(self) -> NDArray[np.bool_]:
        """Frames (n,) from which on the zero is a new one, for `SeveralTargets.push`: the cycle could not be told."""
        out = np.zeros(len(self.value_m), dtype=np.bool_)
        out[[verdict.frame for verdict in self.verdicts if verdict.verdict == "new datum"]] = True
        return out


@dataclass(frozen=True, slots=True)
class TargetFrames:
    """What a source gives of one target: frame_s (n,) on the radar's clock, s; phasors and valid (n, channels).

    coarse_m (n,): range from `range_profile.coarse_range` where it was computed, to check the cycle after outages.
    bins (k,): whole bins of phasors (n, channels, k), `bin_m` apart, so that a target which moves far is followed from
    bin to bin (`Target.bins`).
    """

    frame_s: Floats
    phasors: Phasors
    valid: NDArray[np.bool_]
    coarse_m: Floats | None = None
    bins: Floats | None = None
    bin_m: float = np.nan


def displacement(
    frames: TargetFrames,
    target: Target,
    *,
    samples: Floats,
    phase_per_m: float,
    blockage: BlockageSettings | None = None,
) -> TargetSeries:
    """Displacement at a calibrated target over a record of evenly spaced frames.

    samples (m, 2): time on the accelerometer's clock (s) and acceleration (m/s²); phase_per_m: rad per m of range at
    the target (`ChirpProfile.phase_per_m`). The factor and the offset of `target` are used for the conversion; the
    unwrapping aligns the accelerometer anew and so survives when they are wrong. Raises UntrustedError for a target
    without a conversion factor.
    """
    if not np.isfinite(target.conversion_factor):
        raise UntrustedError(f"The target at {target.range_m:.2f} m cannot be used: {target.objection}.")
    same_length(frame_s=frames.frame_s, phasors=frames.phasors, valid=frames.valid)
    given = (samples, phase_per_m, blockage)
    if frames.bins is None:
        return _measured(combined(frames.phasors, target.weights, frames.valid) - target.leak, frames, target, given)
    bins, seen = _several_bins(frames, target)
    places = np.full(len(seen), target.place_bin)
    still = target.background.at(bins) if target.background is not None else np.full(len(bins), target.leak)
    for turn in range(MOST_PASSES):
        series = _measured(at_places(seen - still, bins, places), frames, target, given)
        if turn == 0 and np.mean(np.isfinite(series.value_m)) < MOSTLY_SEEN:
            # It may have left its bin, not be blocked: the strongest bin of each frame tells.
            places = tracked_places(np.abs(seen - still) ** 2, bins, target.place_bin)
            again = _measured(at_places(seen - still, bins, places), frames, target, given)
            more = np.count_nonzero(np.isfinite(again.value_m)) > np.count_nonzero(np.isfinite(series.value_m))
            series = again if more else series
        before, places = places, _places(seen - still, bins, series, target, frames.bin_m)
        if float(np.max(np.abs(places - before), initial=0.0)) < SETTLED_BINS:
            break
        if target.background is None and np.ptp(places) > 2.0 * LEAST_EXCURSION_BINS:
            # The calibration has not seen these bins; the target has now turned often enough to tell.
            still = standing_in_bins(seen, bins, np.where(np.isfinite(series.value_m), places, np.nan)).phasors
    return series


def _several_bins(frames: TargetFrames, target: Target) -> tuple[Floats, Phasors]:
    """Bins (k,) and phasors (n, k), receivers combined."""
    bins = np.asarray(frames.bins, dtype=np.float64)
    if frames.phasors.ndim != 3 or frames.phasors.shape[2] != len(bins) or not frames.bin_m > 0:
        raise refuse("phasors, bins and bin_m", "(n, channels, bins), (bins,) and > 0 m", frames.phasors.shape)
    seen = [combined(frames.phasors[..., k], target.weights, frames.valid) for k in range(len(bins))]
    return bins, np.stack(seen, axis=1)


def _places(seen: Phasors, bins: Floats, series: TargetSeries, target: Target, bin_m: float) -> Floats:
    """Places (n,) of the target in bins; after each loss of the cycle its place is looked for anew."""
    moved = np.where(np.isfinite(series.range_change_m), series.range_change_m, np.nan) / bin_m
    edges = [0, *np.flatnonzero(series.new_datum), len(moved)]
    parts = [
        places_of(seen[a:b], bins, place_bin=target.place_bin, moved_bins=_bridged(series, moved, a, b, bin_m))
        for a, b in pairwise(edges)
    ]
    return np.concatenate(parts)


def _bridged(series: TargetSeries, moved: Floats, a: int, b: int, bin_m: float) -> Floats:
    """Moved bins (b-a,) with the filter's own prediction where the frame was not used but the prediction is firm."""
    firm = np.sqrt(series.predicted_variance_m2[a:b]) < FIRM_M
    return np.where(np.isfinite(moved[a:b]), moved[a:b], np.where(firm, series.predicted_m[a:b] / bin_m, np.nan))


def _measured(
    z: Phasors, frames: TargetFrames, target: Target, given: tuple[Floats, float, BlockageSettings | None]
) -> TargetSeries:
    """The series from phasors (n,), leakage taken out."""
    samples, unit, blockage = given
    blocked = BlockageMonitor(target.amplitude, blockage).push(np.abs(z))
    variance = np.where(blocked, np.inf, phase_variance(z, target.noise_variance))
    unwrapped, alignment = unwrap_aligned(
        frames.frame_s + target.time_offset_s,
        np.angle(z).astype(np.float64),
        variance_rad2=variance,
        samples=samples,
        phase_per_m=unit,
        ratio=1.0 / target.conversion_factor,
    )
    phase, verdicts = _verified(unwrapped, frames, unit)
    noise = unwrapped.variance_rad2 + _beyond(unwrapped, alignment, frames, target, (samples, unit))
    bent = _bent(z, unwrapped.phase_rad, target)
    lasting = np.full(len(phase), bending(bent, unwrapped.phase_rad))
    if not unwrapped.explained:
        lasting = lasting + slip_variance(unwrapped.innovation_rad)
    factor = target.conversion_factor
    scale = (factor / unit) ** 2
    return TargetSeries(
        value_m=factor * phase / unit,
        variance_m2=scale * (noise + lasting),
        range_change_m=phase / unit,
        status=unwrapped.status,
        restarts=unwrapped.restarts,
        verdicts=verdicts,
        alignment=alignment,
        noise_variance_m2=scale * noise,
        predicted_m=unwrapped.filtered_m,
        predicted_variance_m2=unwrapped.filtered_variance_m2,
        clutter_m=abs(factor) * bent / unit,
        explained=unwrapped.explained,
        warnings=_warnings(unwrapped, verdicts, target),
    )


def _verified(unwrapped: Unwrapped, frames: TargetFrames, unit: float) -> tuple[Floats, tuple[CycleVerdict, ...]]:
    """Unwrapped phase and the verdict on every restart; without ranges each is a new datum."""
    phase = unwrapped.phase_rad
    if not unwrapped.restarts:
        return phase, ()
    coarse = np.full(len(phase), np.nan) if frames.coarse_m is None else frames.coarse_m
    coarse = np.where(np.isfinite(phase), coarse, np.nan)
    return verify_cycles(phase, coarse, restarts=unwrapped.restarts, phase_per_m=unit)


def _beyond(
    unwrapped: Unwrapped,
    alignment: Alignment | None,
    frames: TargetFrames,
    target: Target,
    given: tuple[Floats, float],
) -> float:
    """Variance of the phase's white noise beyond the receiver's, rad²: as measured here, else in the calibration."""
    samples, unit = given
    expected = np.zeros(len(frames.frame_s))
    if alignment is not None:
        at = frames.frame_s + target.time_offset_s + alignment.offset_s
        expected = unit * alignment.ratio * Integrals.of(samples).displacement(at)
    known = np.isfinite(unwrapped.variance_rad2)
    measured = measured_variance(unwrapped.phase_rad, expected)
    if not np.isfinite(measured) or not known.any():
        return target.phase_noise_rad2
    return max(measured - float(np.median(unwrapped.variance_rad2[known])), 0.0)


def _bent(z: Phasors, phase: Floats, target: Target) -> float:
    """Standard deviation (rad) of the phase from what else is in the bin: of the record or of the calibration."""
    share = 0.0 if np.isnan(target.clutter) or target.leak else target.clutter / np.sqrt(2.0)
    known = [share, target.modulation_rad, modulation(z, phase, target.noise_variance)]
    return float(np.nanmax(known))


def _warnings(unwrapped: Unwrapped, verdicts: tuple[CycleVerdict, ...], target: Target) -> tuple[str, ...]:
    told = []
    if not unwrapped.explained:
        told.append(
            f"The accelerometer does not explain the phase of the target at {target.range_m:.2f} m: it was unwrapped "
            "without it, and cycles may be lost unseen when the motion is fast or the signal weak. Check that the "
            "accelerometer works and that both files are of the same event."
        )
    lost = sum(verdict.verdict == "new datum" for verdict in verdicts)
    if lost:
        told.append(
            f"After {lost} of {len(verdicts)} interruptions the cycle of the target at {target.range_m:.2f} m could "
            "not be told: the displacement goes on from a new zero there."
        )
    return tuple(told)
