"""Which of the things in the radar's view is fixed, and what a metre of the structure does to the range to it.

A target is a peak of the range profile. Its phase is compared with the accelerometer: the ratio, its sign and the clock
offset follow in closed form with their standard deviations; what moves by itself, or shares its bin with something
else, does not agree and is passed over.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.errors import UntrustedError
from midspan.radar.alignment import align
from midspan.radar.channels import (
    LEAST_BINS,
    Phasors,
    channel_weights,
    combined,
    disagreement_rad,
    noise_variance,
    phase_variance,
)
from midspan.radar.chirp import RangeAxis
from midspan.radar.circle import fit_circle, standing_still
from midspan.radar.phase_filter import unwrap_aligned
from midspan.records import Floats

# A peak counts from this power ratio to the noise on, and so many are looked at.
LEAST_POWER_RATIO, MOST_TARGETS = 10.0, 40
# What a target must show to be chosen.
LEAST_COHERENCE, LARGEST_FACTOR, LARGEST_RELATIVE_STD = 0.9, 8.0, 0.02
# Above this share of clutter in the bin a target is passed over while there is a cleaner one.
LARGEST_CLUTTER = 0.3
# The same for a receiver whose phase leaves that of the others by more than this and their noise, rad.
LARGEST_DISAGREEMENT_RAD = 0.15
# A phase that turns less says nothing about clutter, rad.
LEAST_TURN = 2.0
# Lag of the second differences whose agreement is the coherence, s: it weighs motion of about 1 to 4 Hz.
COHERENCE_LAG_S = 0.12


@dataclass(frozen=True, slots=True)
class Target:
    """One target of the calibration.

    place_bin: fractional range bin; range_m; amplitude: median, ADC counts; snr_db: after the transform, receivers
    combined; weights (channels,): of the receivers; disagreement_rad: of the worst receiver; conversion_factor (signed)
    with its standard deviation, and time_offset_s (radar's to accelerometer's clock) with its: NaN where the motion
    does not tell; coherence: share 0 … 1 of the phase's acceleration that the accelerometer explains; clutter:
    amplitude of something else in the bin as a share of the target's, NaN where the phase turns too little to tell;
    leak: what of it stands still and is taken out; noise_m: standard deviation of one frame's displacement.
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

    @property
    def relative_std(self) -> float:
        """Standard deviation of the conversion factor as a share of it."""
        return self.conversion_factor_std / abs(self.conversion_factor) if self.coherence > 0 else np.inf

    @property
    def noise_variance(self) -> float:
        """Variance of the complex noise of the receivers combined, in squared ADC counts."""
        return self.amplitude**2 / 10 ** (self.snr_db / 10)

    @property
    def objection(self) -> str:
        """Why the target cannot be used, in a few words; empty when it can."""
        if not np.isfinite(self.conversion_factor):
            return "its phase does not follow the accelerometer"
        if self.coherence < LEAST_COHERENCE:
            return f"the accelerometer explains only {100 * self.coherence:.0f} % of its motion"
        if abs(self.conversion_factor) > LARGEST_FACTOR:
            return f"its conversion factor {self.conversion_factor:.3g} is beyond ±{LARGEST_FACTOR:g}"
        if self.relative_std > LARGEST_RELATIVE_STD:
            return f"its conversion factor is known to ± {100 * self.relative_std:.1f} % only"
        return ""


def find_targets(
    profiles: Phasors, frame_s: Floats, *, samples: Floats, axis: RangeAxis, max_offset_s: float = 0.15
) -> tuple[Target, ...]:
    """All targets of a calibration window, nearest first, each compared with the accelerometer.

    profiles (frames, channels, bins): complex range profiles at frame_s (frames,), evenly spaced, s on the radar's
    clock; axis: ranges and carrier; samples (m, 2): time on the accelerometer's clock (s) and acceleration (m/s²);
    max_offset_s: largest clock offset searched for.
    """
    noise = noise_variance(profiles)
    return tuple(
        _examined(profiles, place, (frame_s, samples, max_offset_s), axis, noise) for place in peaks(profiles, noise)
    )


def peaks(profiles: Phasors, noise: float) -> tuple[float, ...]:
    """Fractional bins of the peaks of the mean power, and of the power that changes, of (frames, channels, bins)."""
    z = np.asarray(profiles)
    if z.shape[2] < LEAST_BINS:
        # Stored targets, not a profile.
        return tuple(float(k) for k in range(z.shape[2]))
    power = np.mean(np.abs(z) ** 2, axis=(0, 1))
    changing = np.maximum(power - np.mean(np.abs(z.mean(axis=0)) ** 2, axis=0), 0.0)
    found: dict[int, float] = {}
    for values in (power, changing):
        for k in _summits(values, LEAST_POWER_RATIO * noise):
            if not any(abs(k - known) <= 1 for known in found):
                found[k] = k + _fraction(values[k - 1 : k + 2])
    strongest = sorted(found, key=lambda k: -power[k])[:MOST_TARGETS]
    return tuple(found[k] for k in sorted(strongest))


def _summits(values: Floats, least: float) -> list[int]:
    inner = values[1:-1]
    high = (inner > values[:-2]) & (inner >= values[2:]) & (inner > least)
    return [int(k) + 1 for k in np.flatnonzero(high)]


def _fraction(three: Floats) -> float:
    """Where between -½ and ½ a peak of three powers of a Hann window lies; their logarithms are near a parabola."""
    low, middle, high = np.log(np.maximum(three, 1e-300))
    bend = low - 2.0 * middle + high
    return float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def at_place(profiles: Phasors, place_bin: float) -> Phasors:
    """Phasors (frames, channels) at a fractional bin: the two nearest bins, which a Hann window has in phase."""
    low = min(max(int(np.floor(place_bin)), 0), max(profiles.shape[2] - 2, 0))
    share = place_bin - low
    high = min(low + 1, profiles.shape[2] - 1)
    return np.asarray((1.0 - share) * profiles[..., low] + share * profiles[..., high])


def _examined(
    profiles: Phasors, place: float, clocks: tuple[Floats, Floats, float], axis: RangeAxis, noise: float
) -> Target:
    """One target with everything that the window tells of it."""
    channels = at_place(profiles, place)
    weights = channel_weights(channels)
    seen = combined(channels, weights)
    leak = standing_still(seen)
    z = seen - leak
    amplitude = float(np.median(np.abs(z)))
    # Averaging the channels divides the noise; interpolating between bins changes it by little.
    noise = noise / len(weights)
    plain = Target(
        place_bin=place,
        range_m=axis.range_at(place),
        amplitude=amplitude,
        snr_db=float(10.0 * np.log10(max(amplitude**2 / noise, 1e-30))) if noise > 0 else np.inf,
        weights=weights,
        disagreement_rad=float(disagreement_rad(channels, weights).max()),
        leak=leak,
    )
    return _compared(plain, z, clocks, axis.phase_per_m(plain.range_m), noise)


def _compared(plain: Target, z: Phasors, clocks: tuple[Floats, Floats, float], unit: float, noise: float) -> Target:
    """The target with its conversion factor, where the accelerometer explains its phase."""
    from dataclasses import replace

    frame_s, samples, max_offset_s = clocks
    phase, variance = np.angle(z).astype(np.float64), phase_variance(z, noise)
    first = align(frame_s, phase, samples=samples, phase_per_m=unit, max_offset_s=max_offset_s)
    if first is None:
        return plain
    moved = (frame_s + first.offset_s, samples)
    unwrapped, found = unwrap_aligned(
        moved[0], phase, variance_rad2=variance, samples=samples, phase_per_m=unit, ratio=first.ratio, max_offset_s=0.02
    )
    ratio, std = (found.ratio, found.ratio_std) if found else (first.ratio, first.ratio_std)
    offset = first.offset_s + (found.offset_s if found else 0.0)
    factor = 1.0 / ratio
    return replace(
        plain,
        conversion_factor=factor,
        conversion_factor_std=abs(factor) * std / abs(ratio),
        time_offset_s=offset,
        time_offset_std_s=found.offset_std_s if found else first.offset_std_s,
        coherence=_coherence(unwrapped.phase_rad / unit, frame_s + offset, samples, ratio),
        clutter=clutter_share(z + plain.leak, unwrapped.phase_rad),
        noise_m=abs(factor) * float(np.sqrt(np.median(variance))) / unit,
    )


def _coherence(los_m: Floats, time_s: Floats, samples: Floats, ratio: float) -> float:
    """Share of the second differences of the range change (n,) that the accelerometer explains, 0 … 1."""
    from midspan.radar.alignment import Integrals

    period = float(np.median(np.diff(time_s)))
    lag = max(1, round(COHERENCE_LAG_S / period))
    second = los_m[2 * lag :] - 2.0 * los_m[lag:-lag] + los_m[: -2 * lag]
    response = ratio * Integrals.of(samples).second_difference(time_s[lag:-lag], lag * period)
    known = np.isfinite(second)
    y, x = second[known] - second[known].mean(), response[known] - response[known].mean()
    total = float(y @ y)
    return max(0.0, 1.0 - float((y - x) @ (y - x)) / total) if total > 0 else 0.0


def clutter_share(z: Phasors, phase_rad: Floats) -> float:
    """Amplitude of what stands still in the bin as a share of the target's, from phasors (n,) and unwrapped phase (n,).

    It is the distance from zero of the centre of the circle on which the phasors turn. NaN when they turn by less than
    2 rad.
    """
    known = np.isfinite(phase_rad) & np.isfinite(z)
    if np.count_nonzero(known) < 20 or np.ptp(phase_rad[known]) < LEAST_TURN:
        return float("nan")
    circle = fit_circle(z[known])
    return min(abs(circle.centre) / max(circle.radius, 1e-300), 1.0)


def ranked(targets: tuple[Target, ...]) -> tuple[Target, ...]:
    """The usable targets, best first: least expected error of one frame, those with much clutter after the others.

    Raises UntrustedError when none can be used, with what speaks against the strongest.
    """
    usable = [target for target in targets if not target.objection]
    if not usable:
        raise UntrustedError(_no_target(targets))
    return tuple(sorted(usable, key=lambda target: (_shared(target), _expected_m(target))))


def _shared(target: Target) -> bool:
    """Whether the bin holds more than the target: much clutter, or receivers that see different phases."""
    quiet = 3.0 * 10 ** (-target.snr_db / 20) * np.sqrt(len(target.weights))
    return bool(target.clutter > LARGEST_CLUTTER or target.disagreement_rad > LARGEST_DISAGREEMENT_RAD + quiet)


def _expected_m(target: Target) -> float:
    """Noise and the error that clutter makes, m of displacement."""
    # What stands still has been taken out.
    clutter = 0.0 if np.isnan(target.clutter) or target.leak else target.clutter
    # Clutter of a share e turns the phase by up to e rad.
    per_rad = target.noise_m * 10 ** (target.snr_db / 20) * np.sqrt(2.0)
    return float(np.hypot(target.noise_m, clutter * per_rad))


def _no_target(targets: tuple[Target, ...]) -> str:
    if not targets:
        return "The radar sees no target: no peak of the range profile stands 10 dB above the noise. Check its aim."
    worst = sorted(targets, key=lambda target: -target.amplitude)[:3]
    told = "; ".join(f"{target.range_m:.2f} m ({target.snr_db:.0f} dB): {target.objection}" for target in worst)
    return (
        f"No fixed target to calibrate the conversion factor on (limits: coherence {LEAST_COHERENCE:g}, standard "
        f"deviation {100 * LARGEST_RELATIVE_STD:g} %, factor ±{LARGEST_FACTOR:g}). Strongest: {told}. Calibrate on a "
        "time with more motion, check that both files are of the same event, or aim the radar at something fixed."
    )
