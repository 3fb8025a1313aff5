"""What the report draws of a radar's calibration."""

import numpy as np

from midspan.calibration.sensors.radar import RadarDiagnostics
from midspan.radar.channels import noise_variance
from midspan.radar.following import at_place
from midspan.radar.frames import RadarFrames
from midspan.radar.target import Target
from midspan.records import Floats

# Points of the window that are kept for the report.
KEPT = 2000


def diagnostics_of(range_m: Floats, whole: RadarFrames, target: Target) -> RadarDiagnostics:
    """What the report draws of the range profile and of the best target."""
    power = np.zeros(whole.phasors.shape[2])
    for part in np.array_split(np.arange(len(whole.phasors)), max(1, len(whole.phasors) // 256)):
        power += np.sum(np.abs(whole.phasors[part]) ** 2, axis=(0, 1))
    noise = noise_variance(whole.phasors)
    mean = power / (len(whole.phasors) * whole.phasors.shape[1])
    thin = slice(None, None, max(1, len(whole.time_ns) // KEPT))
    z = at_place(whole.phasors[thin], target.place_bin) @ target.weights.conj() / np.sqrt(len(target.weights))
    return RadarDiagnostics(
        range_m=range_m,
        power_db=10.0 * np.log10(np.maximum(mean / max(noise, 1e-300), 1e-6)),
        phasors=np.asarray(z, dtype=np.complex128),
        leak=target.leak,
    )
