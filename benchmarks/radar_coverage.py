"""Whether the radar's stated deviations cover its errors: clutter in the bin, phase noise, small and large motions."""

from dataclasses import replace

import numpy as np

from benchmarks.radar_chain import AMPLITUDE, CHIRP, WALL_M, accelerometer, chirps, rms
from benchmarks.table import goal, show
from midspan.radar.chirp import RangeAxis
from midspan.radar.following import at_place
from midspan.radar.measurement import TargetFrames, displacement
from midspan.radar.range_profile import averaged, range_profile
from midspan.radar.target import find_targets
from midspan.simulate.motion.motion import random_motion
from midspan.simulate.radar.signal import RadarModel, Reflector, noise_for

BINS, FRAMES = 100, 2000


def draw(seed: int) -> tuple[list[object], float, float] | None:
    """One scene: its row, share of errors within 1.96 deviations, rms of error over deviation; None when refused."""
    rng = np.random.default_rng(seed)
    amplitude, share = 10 ** rng.uniform(-3.7, -1.9), rng.uniform(0, 0.2)
    noise, wobble = rng.choice([5e-5, 3e-3]), rng.uniform(0, 0.02)
    motion = random_motion((0.3, 3.0), amplitude / 2.5, rng=rng)
    other = float(rng.choice([0.0, 0.5, -0.7, 0.9]))
    clutter = Reflector(WALL_M + rng.uniform(-0.06, 0.06), share * AMPLITUDE, other, rng.uniform(-0.6, 0.6))
    factor = float(rng.choice([1.0, 1.2748, -2.0]))
    view = (Reflector(WALL_M, AMPLITUDE, 1 / factor), clutter, Reflector(4.0, 1.5 * AMPLITUDE, 0.0))
    model = RadarModel(view, CHIRP, noise_for(AMPLITUDE, rng.uniform(-5, 20)), phase_noise_rad=wobble)
    axis = RangeAxis(CHIRP.axis.range_m[:BINS], CHIRP.carrier_hz, CHIRP.slope_hz_s)
    samples = accelerometer(motion, 100.0, noise, seed)
    later = replace(model, start_s=50.0)
    first, second = (
        averaged(range_profile(chirps(m, motion, n, seed + k), CHIRP), CHIRP)[:, :, :BINS]
        for k, (m, n) in enumerate(((model, 2 * FRAMES), (later, FRAMES)))
    )
    found = find_targets(first, model.frame_s(2 * FRAMES), samples=samples, axis=axis)
    target = min(found, key=lambda one: abs(one.range_m - WALL_M))
    if target.objection:
        return None
    at = later.frame_s(FRAMES)
    frames = TargetFrames(at, at_place(second, target.place_bin), np.ones((FRAMES, 4), dtype=bool))
    series = displacement(frames, target, samples=samples, phase_per_m=axis.phase_per_m(target.range_m))
    true = motion.displacement(at)
    # The zero is that of the first frame with its noise, and the fusion's to find: left out here.
    error = series.value_m - true
    error, moved = error - np.nanmean(error), true - true.mean()
    deviation = np.sqrt(series.variance_m2 + (target.relative_std * moved) ** 2)
    seen = np.isfinite(error)
    z = error[seen] / deviation[seen]
    row = [1e3 * amplitude, share, other, wobble, 1e6 * rms(error[seen]), 1e6 * float(np.median(deviation[seen]))]
    return row, float(np.mean(np.abs(z) < 1.96)), rms(z)


def main() -> None:
    """Draws of the motion, the clutter and both noises; refused are those whose factor is not known to 2 %."""
    drawn = [draw(seed) for seed in range(30)]
    used = [one for one in drawn if one is not None]
    head = ["mm", "clutter", "its ratio", "phase noise rad", "error µm", "said µm", "within 1.96"]
    show(head, [[*row, f"{100 * within:.1f} %"] for row, within, _ in used])
    print(f"refused: {len(drawn) - len(used)} of {len(drawn)}")
    within = 100 * float(np.mean([one[1] for one in used]))
    goal("errors within 1.96 deviations, at least", within, 93.0, unit="%", at_least=True)
    goal("error over deviation, rms", rms(np.array([one[2] for one in used])), 1.1)
    goal("the same, at least", rms(np.array([one[2] for one in used])), 0.8, at_least=True)
