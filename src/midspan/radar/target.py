"""Which of the things in the radar's view is fixed, and what a metre of the structure does to the range to it.

A target is a peak of the range profile. Its phase is compared with the accelerometer: the ratio, its sign and the clock
offset follow in closed form with their standard deviations; what moves on its own, or shares its bin with something
else, does not agree and is passed over.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.errors import UntrustedError
from midspan.radar.aligned import unwrap_aligned
from midspan.radar.alignment import Integrals, align
from midspan.radar.channels import (
    MIN_BINS,
    Phasors,
    channel_weights,
    combined,
    combined_bins,
    disagreement_rad,
    noise_variance,
    phase_variance,
)
from midspan.radar.chirp import RangeAxis
from midspan.radar.evidence import (
    clutter_share,
    coherence,
    factor_spread,
    measured_variance,
    modulation,
    own_motion,
    static_centre,
)
from midspan.radar.following import (
    MIN_EXCURSION_BINS,
    Background,
    at_place,
    at_places,
    bins_within,
    peaks,
    places_of,
    static_in_bins,
    tracked_places,
)
from midspan.records import Floats

# What a target must show to be chosen.
MIN_COHERENCE, MAX_FACTOR, MAX_RELATIVE_STD = 0.9, 8.0, 0.02
# Above this share of clutter in the bin a target is passed over while there is a cleaner one.
MAX_CLUTTER = 0.3
# The same for a receiver whose phase leaves that of the others by more than this and their noise, rad.
MAX_DISAGREEMENT_RAD = 0.15
# A target that moves far is met again at most so often, and no more once that makes the coherence worse than by this.
# Before, while it was seen only part of the time, this much of its motion must be explained.
FOLLOWING_PASSES, COHERENCE_LOSS, FOLLOWED_COHERENCE = 4, 0.002, 0.3
# Frames with less than this share of the amplitude that is seen in the best tenth are left out.
FAINT_SHARE, BEST_PERCENTILE = 0.4, 90.0
# Where that happens to more than this share of frames, the target is looked for in this many bins on either side.
OFTEN, TRACKED_BINS = 0.02, 4.0


@dataclass(frozen=True, slots=True)
class Target:
    """One target of the calibration.

    place_bin: fractional range bin; range_m; amplitude: median, ADC counts; snr_db: after the transform, receivers
    combined; weights (channels,): of the receivers; disagreement_rad: of the worst receiver; conversion_factor (signed)
    with its standard deviation, and time_offset_s (radar's to accelerometer's clock) with its: NaN where the motion
    does not tell; coherence: share 0 … 1 of the phase's acceleration that the accelerometer explains; clutter:
    amplitude of something else in the bin as a share of the target's, NaN where the phase turns too little to tell;
    leak: what of it is static and is taken out; noise_m: standard deviation of one frame's displacement.

    background: what is static in every bin that the target moves through, where it moves so far that it must be
    followed; reach_bins: how far it moved; modulation_rad: standard deviation of the phase from what else turns in the
    bin, NaN where it turned too little to tell; phase_noise_rad2: variance of the phase beyond the receiver's noise;
    own_m: standard deviation of the displacement that the target's own motion makes, about the frequency own_hz; where
    that is 0, above about 0.3 Hz.
    """

    place_bin: float
    range_m: float
    amplitude: float
    snr_db: float
    weights: NDArray[np.complex128]
    disagreement_rad: float
    conversion_factor: float = np.nan
    conversion_factor_std: float = np.inf
    time_offset_s: float = np.nan
    time_offset_std_s: float = np.inf
    coherence: float = 0.0
    clutter: float = np.nan
    leak: complex = 0j
    noise_m: float = np.inf
    background: Background | None = None
    reach_bins: float = 0.0
    modulation_rad: float = np.nan
    phase_noise_rad2: float = 0.0
    own_m: float = 0.0
    own_hz: float = 0.0

    @property
    def place(self) -> str:
        """Where it is, in words: its range, or its bin where samples come without ranges."""
        return f"at {self.range_m:.2f} m" if np.isfinite(self.range_m) else f"in bin {self.place_bin:.1f}"

    @property
    def relative_std(self) -> float:
        """Standard deviation of the conversion factor as a share of it."""
        return self.conversion_factor_std / abs(self.conversion_factor) if self.coherence > 0 else np.inf

    def without_gain(self, gain: float, std: float) -> "Target":
        """The same in metres: the factor was estimated from an accelerometer of this gain and relative deviation."""
        factor = self.conversion_factor / gain
        return replace(
            self,
            conversion_factor=factor,
            conversion_factor_std=float(np.hypot(self.conversion_factor_std / gain, std * factor)),
            noise_m=self.noise_m / gain,
            own_m=self.own_m / gain,
        )

    @property
    def noise_variance(self) -> float:
        """Variance of the complex noise of the receivers combined, in squared ADC counts."""
        return self.amplitude**2 / 10 ** (self.snr_db / 10)

    @property
    def bent_rad(self) -> float:
        """Standard deviation of the phase by what else is in the bin, rad."""
        share = 0.0 if np.isnan(self.clutter) or self.leak else self.clutter / np.sqrt(2.0)
        return float(np.nanmax([share, self.modulation_rad]))

    @property
    def bent_m(self) -> float:
        """Standard deviation of the displacement by what else is in the bin, m."""
        receiver = 0.5 * 10 ** (-self.snr_db / 10)
        return self.bent_rad * self.noise_m / float(np.sqrt(receiver + self.phase_noise_rad2))

    def bins(self, excursion_m: float, bin_m: float, count: int | None = None) -> Floats:
        """Whole bins (k,) to fetch so that the target can be followed, for `measurement.TargetFrames.bins`.

        excursion_m: largest change of the range in the record; bin_m: from bin to bin, m; count: bins that there are.
        """
        return bins_within(self.place_bin, max(self.reach_bins, excursion_m / bin_m), count)

    @property
    def objection(self) -> str:
        """Why the target cannot be used, in a few words; empty when it can."""
        if not np.isfinite(self.conversion_factor):
            return "its phase does not follow the accelerometer"
        if self.coherence < MIN_COHERENCE:
            return f"the accelerometer explains only {100 * self.coherence:.0f} % of its motion"
        if abs(self.conversion_factor) > MAX_FACTOR:
            return f"its conversion factor {self.conversion_factor:.3g} is beyond ±{MAX_FACTOR:g}"
        if self.relative_std > MAX_RELATIVE_STD:
            return f"its conversion factor is uncertain by ± {100 * self.relative_std:.1f} %"
        return ""


def find_targets(
    profiles: Phasors,
    frame_s: Floats,
    *,
    samples: Floats,
    axis: RangeAxis,
    max_offset_s: float = 0.15,
    valid: NDArray[np.bool_] | None = None,
) -> tuple[Target, ...]:
    """All targets of a calibration window, nearest first, each compared with the accelerometer.

    profiles (frames, channels, bins): complex range profiles at frame_s (frames,), evenly spaced, s on the radar's
    clock; axis: ranges and carrier; samples (m, 2): time on the accelerometer's clock (s) and acceleration (m/s²);
    max_offset_s: largest clock offset searched for; valid (frames, channels): what was received. What was not may hold
    anything finite, and is not compared.
    """
    profiles = np.asarray(profiles)
    valid = np.ones(profiles.shape[:2], dtype=np.bool_) if valid is None else valid
    whole = profiles[valid.all(axis=1)]
    noise = noise_variance(whole if len(whole) > 1 else profiles)
    window = _Window(profiles, valid, np.asarray(frame_s, dtype=np.float64), samples, max_offset_s, axis, noise)
    found = tuple(_examined(window, place) for place in peaks(profiles, noise))
    if all(target.objection for target in found) and window.profiles.shape[2] >= MIN_BINS:
        found = tuple(_examined(window, place) for place in peaks(profiles, noise, weak=True))
    return tuple(target for k, target in enumerate(found) if not _repeated(target, found[:k]))


@dataclass(frozen=True, slots=True)
class _Window:
    """The calibration window that all targets share; noise: variance of one channel and bin."""

    profiles: Phasors
    valid: NDArray[np.bool_]
    frame_s: Floats
    samples: Floats
    max_offset_s: float
    axis: RangeAxis
    noise: float

    @property
    def bin_m(self) -> float:
        """From bin to bin, m; NaN for stored targets, which cannot be followed."""
        known = self.profiles.shape[2] >= MIN_BINS and len(self.axis.range_m) == self.profiles.shape[2]
        return float(np.median(np.diff(self.axis.range_m))) if known else np.nan

    def seen(self, bins: Floats, weights: NDArray[np.complex128]) -> Phasors:
        """Phasors (frames, k) at whole bins (k,), receivers combined; NaN where nothing was received."""
        return combined_bins(self.profiles[:, :, bins.astype(np.int64)], weights, self.valid)


def _examined(window: _Window, place: float) -> Target:
    """One target with everything that the window tells of it; met again at its own place if it moves far."""
    channels = at_place(window.profiles, place)
    weights = channel_weights(channels)
    seen = combined(channels, weights, window.valid)
    leak = static_centre(seen)
    plain = Target(
        place_bin=place,
        range_m=window.axis.range_at(place),
        amplitude=1.0,
        snr_db=0.0,
        weights=weights,
        disagreement_rad=float(disagreement_rad(channels, weights).max()),
        leak=leak,
    )
    found, change = _compared(plain, seen - leak, window)
    # As those of a target that leaves its bin.
    if np.isfinite(window.bin_m) and np.mean(_faint(seen - leak)) > OFTEN:
        again = _tracked(plain, window)
        found, change = again if again[0].coherence > found.coherence else (found, change)
    reach = float(np.nanmax(np.abs(change - np.nanmedian(change)))) / window.bin_m if len(change) else 0.0
    if found.coherence < FOLLOWED_COHERENCE or not MIN_EXCURSION_BINS < reach < 0.25 * window.profiles.shape[2]:
        return found
    return _followed(found, reach, change, window)


def _faint(z: Phasors) -> NDArray[np.bool_]:
    # What was not received (NaN) is no better than what is faint.
    size = np.abs(z)
    return np.asarray(~(size >= FAINT_SHARE * np.nanpercentile(size, BEST_PERCENTILE)))


def _tracked(plain: Target, window: _Window) -> tuple[Target, Floats]:
    """The target in the strongest bin of each frame, nothing being known of its motion yet."""
    bins = bins_within(plain.place_bin, TRACKED_BINS, window.profiles.shape[2])
    some = window.profiles[:, :, bins.astype(np.int64)]
    places = tracked_places(np.sum(np.abs(some) ** 2, axis=1), bins, plain.place_bin)
    return _compared(replace(plain, leak=0j), at_places(window.seen(bins, plain.weights), bins, places), window)


def _followed(found: Target, reach: float, change_m: Floats, window: _Window) -> Target:
    """The target met again in the bins that it moves through; again as long as that shows more of it."""
    count = window.profiles.shape[2]
    for _ in range(FOLLOWING_PASSES):
        # A target that swings far was found where it turns, not in its middle.
        search = min(max(1.0, reach), TRACKED_BINS)
        bins = bins_within(found.place_bin, reach + search, count)
        seen = window.seen(bins, found.weights)
        places = places_of(seen, bins, place_bin=found.place_bin, moved_bins=change_m / window.bin_m, search=search)
        background = static_in_bins(seen, bins, places)
        place = float(np.median(places))
        met = replace(
            found,
            place_bin=place,
            range_m=window.axis.range_at(place),
            background=background,
            leak=complex(background.at(np.array([place]))[0]),
            reach_bins=reach,
        )
        again, change_m = _compared(met, at_places(seen - background.phasors, bins, places), window)
        again = replace(again, clutter=min(abs(met.leak) / again.amplitude, 1.0))
        if not len(change_m) or again.coherence < found.coherence - COHERENCE_LOSS:
            return found
        known = float(np.nanmax(np.abs(change_m - np.nanmedian(change_m)))) / window.bin_m
        done, found, reach = abs(known - reach) < MIN_EXCURSION_BINS, again, known
        if done:
            break
    return found


def _compared(plain: Target, z: Phasors, window: _Window) -> tuple[Target, Floats]:
    """The target with its conversion factor and its range change (n,), empty where the motion does not tell."""
    unit, frame_s, samples = window.axis.phase_per_m(plain.range_m), window.frame_s, window.samples
    # Averaging the channels divides the noise; interpolating between bins changes it by little.
    noise = window.noise / len(plain.weights)
    faint = _faint(z)
    amplitude = float(np.median(np.abs(z[~faint])))
    snr_db = float(10.0 * np.log10(max(amplitude**2 / noise, 1e-30))) if noise > 0 else np.inf
    plain = replace(plain, amplitude=amplitude, snr_db=snr_db)
    phase, variance = np.angle(z).astype(np.float64), np.where(faint, np.inf, phase_variance(z, noise))
    first = align(
        frame_s, np.where(faint, np.nan, phase), samples=samples, phase_per_m=unit, max_offset_s=window.max_offset_s
    )
    if first is None:
        return plain, np.empty(0)
    moved_s = frame_s + first.offset_s
    unwrapped, found = unwrap_aligned(
        moved_s, phase, variance_rad2=variance, samples=samples, phase_per_m=unit, ratio=first.ratio, max_offset_s=0.02
    )
    ratio, std = (found.ratio, found.ratio_std) if found else (first.ratio, first.ratio_std)
    offset = first.offset_s + (found.offset_s if found else 0.0)
    integrals, time_s = Integrals.of(samples), frame_s + offset
    expected = unit * ratio * integrals.displacement(time_s)
    measured = measured_variance(unwrapped.phase_rad, expected)
    receiver = float(np.median(variance[~faint]))
    beyond = max(measured - receiver, 0.0) if np.isfinite(measured) else 0.0
    bent = modulation(z, unwrapped.phase_rad, noise)
    spread = factor_spread(bent, abs(plain.leak) / amplitude, float(np.nanstd(unwrapped.phase_rad)))
    found_target = replace(
        plain,
        conversion_factor=1.0 / ratio,
        conversion_factor_std=float(np.hypot(std / ratio**2, spread / ratio)),
        time_offset_s=offset,
        time_offset_std_s=found.offset_std_s if found else first.offset_std_s,
        coherence=coherence(unwrapped.phase_rad / unit, time_s, integrals, ratio, receiver / unit**2),
        clutter=clutter_share(z + plain.leak, unwrapped.phase_rad),
        noise_m=abs(1.0 / ratio) * float(np.sqrt(receiver + beyond)) / unit,
        modulation_rad=bent,
        phase_noise_rad2=beyond,
        own_m=abs(1.0 / ratio)
        * own_motion(unwrapped.phase_rad / unit, time_s, integrals, ratio, (receiver + beyond) / unit**2),
    )
    return found_target, unwrapped.phase_rad / unit


def ranked(targets: tuple[Target, ...]) -> tuple[Target, ...]:
    """The usable targets, best first: least expected error of one frame, those with much clutter after the others.

    Raises UntrustedError when none can be used, with what speaks against the strongest.
    """
    usable = [target for target in targets if not target.objection]
    if not usable:
        raise UntrustedError(_no_target(targets))
    return tuple(sorted(usable, key=_order))


def _order(target: Target) -> tuple[bool, float]:
    """Whether the bin holds more than the target; noise and the error that clutter makes, m of displacement."""
    quiet = 3.0 * 10 ** (-target.snr_db / 20) * np.sqrt(len(target.weights))
    shared = bool(target.clutter > MAX_CLUTTER or target.disagreement_rad > MAX_DISAGREEMENT_RAD + quiet)
    # What is static has been taken out. Clutter of a share e turns the phase by up to e rad.
    clutter = 0.0 if np.isnan(target.clutter) or target.leak else target.clutter
    left = 0.0 if np.isnan(target.modulation_rad) else target.modulation_rad
    receiver = 0.5 * 10 ** (-target.snr_db / 10)
    per_rad = target.noise_m / float(np.sqrt(receiver + target.phase_noise_rad2))
    # Clutter also shows as a motion of its own: the larger counts.
    return shared, float(np.hypot(target.noise_m, max(max(clutter, left) * per_rad, target.own_m)))


def _repeated(target: Target, others: tuple[Target, ...]) -> bool:
    """Whether it is a target that moves so far that its first bin and its last one were both taken for a peak."""
    return target.reach_bins > 0 and any(
        other.reach_bins > 0 and abs(other.place_bin - target.place_bin) < 0.5 for other in others
    )


def _no_target(targets: tuple[Target, ...]) -> str:
    if not targets:
        return "The radar detects no target: no peak of the range profile is 4 dB above the noise. Check its aim."
    worst = sorted(targets, key=lambda target: -target.amplitude)[:3]
    reported = "; ".join(f"{target.place} ({target.snr_db:.0f} dB): {target.objection}" for target in worst)
    return (
        f"No fixed target to calibrate the conversion factor on (limits: coherence {MIN_COHERENCE:g}, standard "
        f"deviation {100 * MAX_RELATIVE_STD:g} %, factor ±{MAX_FACTOR:g}). Strongest: {reported}. Calibrate on a "
        "time with more motion, check that both files are of the same event, or aim the radar at something fixed."
    )
