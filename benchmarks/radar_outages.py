"""What is said of the cycle after a blocked view, with clutter in the bin, for a fine and a coarse range."""

from dataclasses import replace

import numpy as np

from benchmarks.radar_chain import accelerometer, sine
from benchmarks.radar_loop import Run, run
from benchmarks.table import goal, show
from midspan.engine.radar_target import FollowedTarget
from midspan.radar.chirp import ChirpProfile, RangeAxis
from midspan.radar.range_profile import bin_kernel
from midspan.radar.target import Target, find_targets
from midspan.records import Floats
from midspan.simulate.motion.motion import Motion, random_motion
from midspan.simulate.radar.signal import LONG_RANGE, SHORT_RANGE, RadarModel, Reflector, noise_for

RANGE_M, AMPLITUDE, START_S = 6.3, 1000.0, 18.0
FRAMES, CALIBRATION = 4000, 1600
RATE, NOISE_M_S2, SETTLED_S = 100.0, 3e-3, 5.0
SAID = ("sure", "by its range", "new datum")


def view(seed: int, chirp: ChirpProfile) -> tuple[RadarModel, Motion, float]:
    """A wall, something else in its bin, and an outage of 0.2 to 10 s of everything that is fixed."""
    rng = np.random.default_rng(9000 + seed)
    speed, length_s = rng.uniform(0.02, 0.3), float(10 ** rng.uniform(-0.7, 1.0))
    frequency = float(rng.uniform(0.3, 3.0))
    swing = random_motion((0.2, 4.0), speed / 15, rng=rng)
    motion = sine(speed / (2 * np.pi * frequency), frequency) if seed % 2 else swing
    blocked = ((START_S, START_S + length_s),)
    other = float(rng.choice([0.0, 0.5, -0.7]))
    clutter = Reflector(
        RANGE_M + float(rng.uniform(-0.5, 0.5)) * chirp.bin_m,
        AMPLITUDE * float(rng.uniform(0.0, 0.15)),
        other,
        blocked=blocked if other else (),
    )
    wall = Reflector(RANGE_M, AMPLITUDE, 1.0, blocked=blocked)
    one = replace(chirp, receivers=1)
    return RadarModel((wall, clutter), one, noise_for(AMPLITUDE, rng.uniform(5.0, 20.0))), motion, length_s


def measured(model: RadarModel, motion: Motion, seed: int) -> tuple[Run, Floats] | None:
    """The wall over 40 s, calibrated on the first 16 s, and its true range change; None when refused."""
    chirp, rng = model.profile, np.random.default_rng(seed)
    kernel = bin_kernel(np.arange(chirp.bins), chirp)[: int(RANGE_M / chirp.bin_m) + 30].T.astype(np.complex64)
    z = np.concatenate([cube[:, 0] @ kernel for cube in model.blocks(motion, FRAMES, rng=rng)])
    at = model.frame_s(FRAMES)
    samples = accelerometer(motion, 41.0, NOISE_M_S2, seed, float(rng.uniform(-0.05, 0.05)))
    axis = RangeAxis(np.arange(z.shape[2]) * chirp.bin_m, chirp.carrier_hz, chirp.slope_hz_s)
    targets = find_targets(z[:CALIBRATION], at[:CALIBRATION], samples=samples, axis=axis)
    wall: Target = min(targets, key=lambda target: abs(target.range_m - RANGE_M))
    if wall.objection:
        return None
    item = FollowedTarget.of(wall, chirp.phase_per_m(RANGE_M), chirp.bin_m, period_s=1 / RATE, bins=z.shape[2])
    frames = (at + wall.time_offset_s, z, np.ones(z.shape[:2], dtype=np.bool_))
    return run([item], frames, samples, NOISE_M_S2**2 / RATE), motion.displacement(at)


def reported(found: Run, moved: Floats, at: Floats, chirp: ChirpProfile, end_s: float) -> str:
    """What is said of the cycle, or `wrong` when it is off and no new datum was declared."""
    count = len(found.phase_rad)
    at = at[:count]
    error = found.phase_rad[:, 0] / chirp.phase_per_m(RANGE_M) - moved[:count]
    jump = np.nanmedian(error[at > end_s + SETTLED_S]) - np.nanmedian(error[at < START_S])
    if found.reference_rad2[-1, 0] > 1.0:
        return "new datum"
    if abs(jump) > chirp.axis.cycle_m / 2:
        return "wrong"
    return "by its range" if any(event.kind == "cycle" for event in found.events) else "sure"


def outages(chirp: ChirpProfile, runs: int = 30) -> int:
    """Table of what is said by length of the outage; returns how many were silently wrong."""
    spans = ((0.0, 0.5), (0.5, 2.0), (2.0, 10.1))
    counts = {span: dict.fromkeys((*SAID, "wrong"), 0) for span in spans}
    flags = refused = 0
    for seed in range(runs):
        model, motion, length_s = view(seed, chirp)
        seen = measured(model, motion, seed)
        if seen is None:
            refused += 1
            continue
        found, moved = seen
        at = model.frame_s(FRAMES)
        verdict = reported(found, moved, at, chirp, START_S + length_s)
        if verdict == "wrong":
            print("   wrong:", seed, f"{length_s:.2f} s", [event.text for event in found.events])
        counts[next(span for span in spans if length_s < span[1])][verdict] += 1
        at = at[: len(found.phase_rad)]
        inside = (at > START_S) & (at < START_S + length_s)
        flags += bool(np.isfinite(found.phase_rad[inside]).any())
    print(f"{chirp.bandwidth_hz / 1e9:.2f} GHz: range bins of {1e3 * chirp.bin_m:.0f} mm")
    show(["outage s", *SAID, "wrong"], [[f"{a:g}-{b:g}", *counts[a, b].values()] for a, b in spans])
    print(f"refused for want of motion: {refused}")
    goal("outages with a value", float(flags), 0.0)
    return sum(row["wrong"] for row in counts.values())


def main() -> None:
    """Both chirps, 30 outages each."""
    for chirp in (SHORT_RANGE, LONG_RANGE):
        goal("silently wrong cycles in 30 outages", float(outages(chirp)), 0.0)
