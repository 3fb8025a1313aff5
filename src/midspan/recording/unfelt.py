"""A motion of which nothing but measurements is known, smoothed to any stamps."""

import numpy as np

from midspan.calibration.minimum import global_minimum
from midspan.fusion.path import at
from midspan.fusion.streams import NO_ERRORS, KalmanSettings, filtered, smooth
from midspan.records import NANOSECONDS, Acceleration, Displacement, Floats, Nanoseconds, Source, part

# Frames that the changes of a motion are estimated from, and the fewest of them.
LEARNED_FRAMES, MIN_FRAMES = 4000, 30
# Of a gap, in usual steps between measurements.
GAP_STEPS = 3.0
# How far the density of the acceleration of such a motion may be from what its frames say at once, decades.
DECADES = 4.0
# An innovation beyond this many standard deviations counts as that many.
CAPPED = 4.0


def block_of(time_ns: Nanoseconds, value: Floats, variance: Floats) -> Displacement:
    """Measurements (n,) of a camera as a block."""
    return Displacement(time_ns, value, variance, np.full(len(value), Source.CAMERA, dtype=np.uint8))


def smoothed(block: Displacement, time_ns: Nanoseconds) -> tuple[Floats, Floats]:
    """A motion of which nothing but measurements is known, and its variance, at stamps (n,).

    Between measurements its velocity changes by white noise, of a density that makes them likeliest. A motion swings
    back, so that within a gap the density is the largest that measurements apart by up to its half show, and the motion
    is no farther from its mean than it usually is.
    """
    seen = np.isfinite(block.value_m) & np.isfinite(block.variance_m2)
    block = Displacement(block.time_ns[seen], block.value_m[seen], block.variance_m2[seen], block.source[seen])
    step_ns = float(np.median(np.diff(block.time_ns)))
    stamps = np.union1d(time_ns, block.time_ns)
    # Between which measurements each stamp lies, and how many usual steps these are apart.
    after = np.clip(np.searchsorted(block.time_ns, stamps), 1, len(block.time_ns) - 1)
    steps = np.maximum(block.time_ns[after] - block.time_ns[after - 1], np.abs(stamps - block.time_ns[after])) / step_ns
    density = np.full(len(stamps), _density(block))
    apart = 2
    while 2 * apart <= np.max(steps) and len(block.time_ns) // apart >= MIN_FRAMES:
        wider = _density(part(block, slice(None, None, apart)))
        density = np.where(steps >= 2 * apart, np.maximum(density, wider), density)
        apart *= 2
    felt = Acceleration(stamps, np.zeros(len(stamps)), density)
    value, variance = at(smooth(felt, block, unfelt_settings(block)).estimate, time_ns)
    usual, mean = 2.0 * float(np.var(block.value_m)), float(np.mean(block.value_m))
    bridged = steps[np.searchsorted(stamps, time_ns)] >= GAP_STEPS
    share = np.where(bridged, usual / (usual + variance), 1.0)
    return mean + share * (value - mean), share * variance


def _unfelt(time_ns: Nanoseconds, density: float) -> Acceleration:
    return Acceleration(time_ns, np.zeros(len(time_ns)), np.full(len(time_ns), density))


def unfelt_settings(block: Displacement) -> KalmanSettings:
    """Of a motion without an acceleration: no bias, and every measurement as good as its variance says."""
    # Larger than anything that the block holds.
    large = 10.0 * float(np.ptp(block.value_m)) + 100.0 * float(np.sqrt(np.max(block.variance_m2)))
    step_s = float(np.median(np.diff(block.time_ns))) / NANOSECONDS
    return KalmanSettings(
        bias_walk=0.0, displacement_std=large, velocity_std=large / step_s, bias_std=0.0, rates=NO_ERRORS,
        noise_memory=np.inf,
    )  # fmt: skip


def _density(block: Displacement) -> float:
    """Density of the acceleration, (m/s²)²/Hz, by the likelihood of the innovations."""
    block = part(block, slice(0, LEARNED_FRAMES))
    settings, step_s = unfelt_settings(block), float(np.median(np.diff(block.time_ns))) / NANOSECONDS
    # What second differences are, less their noise; of white noise of the density q they are 2/3 q T³.
    bent = np.diff(block.value_m, 2)
    noise = 6.0 * float(np.median(block.variance_m2))
    first = max(float(np.mean(bent**2)) - noise, 1e-3 * noise) / (2.0 / 3.0 * step_s**3)

    def cost(decades: float) -> float:
        density = first * 10.0**decades
        found = filtered(_unfelt(block.time_ns, density), block, settings).innovation
        variance = found.variance_m2[2:]
        return float(np.sum(np.log(variance) + np.minimum(found.value_m[2:] ** 2 / variance, CAPPED**2)))

    return float(first * 10.0 ** global_minimum(cost, -DECADES, 1.0, tried=11, tolerance=0.03))
