"""From the phasors of a calibrated target to displacement: receivers, blockage, unwrapping and conversion in a row."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.checks import same_length
from midspan.radar.alignment import Alignment
from midspan.radar.blockage import BlockageMonitor, BlockageSettings
from midspan.radar.channels import Phasors, combined, phase_variance
from midspan.radar.cycles import CycleVerdict, verify_cycles
from midspan.radar.phase_filter import unwrap_aligned
from midspan.radar.target import Target
from midspan.records import Floats


@dataclass(frozen=True, slots=True)
class TargetSeries:
    """Displacement of the structure seen at one target, arrays (n,): value_m is NaN where it was not seen.

    value_m is conversion factor × change of the range since the first frame used; variance_m2 from the measured
    signal-to-noise ratio, infinite where not seen; range_change_m: before the factor; status: `Status` codes;
    restarts, verdicts: frames after outages in which the cycle was lost, and what the range says about each.
    """

    value_m: Floats
    variance_m2: Floats
    range_change_m: Floats
    status: NDArray[np.uint8]
    restarts: tuple[int, ...]
    verdicts: tuple[CycleVerdict, ...]
    alignment: Alignment | None


@dataclass(frozen=True, slots=True)
class TargetFrames:
    """What a source gives of one target: frame_s (n,) on the radar's clock, s; phasors and valid (n, channels).

    coarse_m (n,): range from `range_profile.coarse_range` where it was computed, to check the cycle after outages.
    """

    frame_s: Floats
    phasors: Phasors
    valid: NDArray[np.bool_]
    coarse_m: Floats | None = None


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
    unwrapping aligns the accelerometer anew and so survives when they are wrong.
    """
    same_length(frame_s=frames.frame_s, phasors=frames.phasors, valid=frames.valid)
    z = combined(frames.phasors, target.weights, frames.valid) - target.leak
    blocked = BlockageMonitor(target.amplitude, blockage).push(np.abs(z))
    variance = np.where(blocked, np.inf, phase_variance(z, target.noise_variance))
    unwrapped, alignment = unwrap_aligned(
        frames.frame_s + target.time_offset_s,
        np.angle(z).astype(np.float64),
        variance_rad2=variance,
        samples=samples,
        phase_per_m=phase_per_m,
        ratio=1.0 / target.conversion_factor,
    )
    phase = unwrapped.phase_rad
    verdicts: tuple[CycleVerdict, ...] = ()
    if frames.coarse_m is not None and unwrapped.restarts:
        coarse = np.where(np.isfinite(phase), frames.coarse_m, np.nan)
        phase, verdicts = verify_cycles(phase, coarse, restarts=unwrapped.restarts, phase_per_m=phase_per_m)
    factor = target.conversion_factor
    return TargetSeries(
        value_m=factor * phase / phase_per_m,
        variance_m2=(factor / phase_per_m) ** 2 * unwrapped.variance_rad2,
        range_change_m=phase / phase_per_m,
        status=unwrapped.status,
        restarts=unwrapped.restarts,
        verdicts=verdicts,
        alignment=alignment,
    )
