"""Scale factor and clock offset of a camera: rms error, claimed deviation and the Cramér-Rao bound."""

import numpy as np

from benchmarks.table import goal, show
from midspan.calibration.fit import Pair
from midspan.calibration.scale import calibrate_scale
from midspan.calibration.whitening import whiten
from midspan.records import Floats
from midspan.simulate.motion import Motion, Sines, random_motion
from midspan.simulate.sensors import AccelerometerModel, DisplacementSensorModel, simulate_pair

SCALE, OFFSET_S, SEEDS, NOISE_A = 2.289e-3, 0.05, 24, 2e-3
CASES = [("1 Hz tone", 29.97), ("broadband", 10.0), ("3.3 Hz aliased", 3.0)]
NOISES_PX = (0.02, 0.1, 0.5)


def motion_of(kind: str, seed: int) -> Motion:
    """The motions of the table: 3 mm rms, or 8 mm at 0.1 Hz and 3 mm at 3.3 Hz for the aliased camera."""
    rng = np.random.default_rng(seed)
    if kind == "1 Hz tone":
        return Sines(np.array([4.24e-3]), np.array([1.0]), phase_rad=rng.uniform(0, 6.28, 1))
    if kind == "broadband":
        return random_motion((0.3, 8.0), 3e-3, rng=rng, flat="velocity")
    return Sines(np.array([8e-3, 3e-3]), np.array([0.1, 3.3]), phase_rad=rng.uniform(0, 6.28, 2))


def pair_of(motion: Motion, rate_hz: float, noise_px: float, seed: int) -> Pair:
    """A minute of both sensors."""
    seen = simulate_pair(
        motion,
        60.0,
        accelerometer=AccelerometerModel(100.0, NOISE_A, 0.02),
        displacement=DisplacementSensorModel(rate_hz, noise_px * SCALE, OFFSET_S),
        seed=seed,
    )
    time, value = seen.acceleration.time_ns / 1e9, seen.acceleration.value
    met, moved = seen.displacement.time_ns / 1e9, seen.displacement.value / SCALE
    inner = (met > 0.3) & (met < 59.7)
    samples = np.column_stack((time, value - value.mean(), np.ones(len(time))))
    return Pair(samples, np.column_stack((met, moved - moved[inner][0], np.full(len(met), noise_px**2)))[inner])


def cramer_rao(motion: Motion, rate_hz: float, noise_px: float) -> tuple[float, float]:
    """Least std of scale (relative) and offset (s) with known noise levels: the whitened truth and its derivative.

    The innovations of the filter with the true noise levels are white; their derivatives by the ratio and by the
    offset give the Fisher information of both together.
    """
    time = np.arange(6000) / 100.0
    samples = np.column_stack((time, motion.acceleration(time), np.ones(6000)))
    met = np.arange(0.3, 59.7, 1 / rate_hz)
    density = NOISE_A**2 / 100.0 / SCALE**2 / noise_px**2

    def innovations(shift: float) -> tuple[Floats, Floats]:
        rows = np.column_stack((met, np.zeros(len(met)), np.ones(len(met))))
        moved = np.add(rows, (shift, 0.0, 0.0))
        w = whiten(samples, moved, density)
        return w.response / SCALE, w.variance * noise_px**2

    (before, _), (here, variance), (after, _) = (innovations(s) for s in (-1e-4, 0.0, 1e-4))
    n = min(len(before), len(here), len(after))
    by = np.column_stack((here[:n], (after[:n] - before[:n]) / 2e-4))
    information = by.T @ (by / variance[:n, None])
    least = np.sqrt(np.diag(np.linalg.inv(information)))
    return float(least[0]), float(least[1])


def main() -> None:
    rows, ratios, claims = [], [], []
    for kind, rate_hz in CASES:
        for noise_px in NOISES_PX[:1] if "aliased" in kind else NOISES_PX:
            found, least = [], []
            for seed in range(SEEDS):
                motion = motion_of(kind, seed)
                r = calibrate_scale(pair_of(motion, rate_hz, noise_px, 5000 + seed), 0.08)
                found.append(
                    (
                        r.scale.value_m_per_px / SCALE - 1.0,
                        np.sqrt(r.scale.variance) / SCALE,
                        r.search.offset.value_s - OFFSET_S,
                        np.sqrt(r.search.offset.variance),
                    )
                )
                least.append(cramer_rao(motion, rate_hz, noise_px))
            f, c = np.array(found), np.sqrt(np.mean(np.square(least), axis=0))
            scale, offset = np.sqrt(np.mean(f[:, 0] ** 2)), np.sqrt(np.mean(f[:, 2] ** 2))
            scales = [100 * np.mean(f[:, 0]), 100 * scale, 100 * np.mean(f[:, 1]), 100 * c[0]]
            rows.append([kind, rate_hz, noise_px, *scales, 1e3 * offset, 1e3 * np.mean(f[:, 3]), 1e3 * c[1]])
            ratios.append(max(scale / c[0], offset / c[1]))
            claims += [scale / np.sqrt(np.mean(f[:, 1] ** 2)), offset / np.sqrt(np.mean(f[:, 3] ** 2))]
    head = ["motion", "Hz", "px", "bias %", "rms %", "claimed %", "bound %", "offset rms ms", "claimed ms", "bound ms"]
    show(head, rows)
    goal("largest rms over the Cramér-Rao bound (24 seeds: ± 15 %)", float(max(ratios)), 1.4)
    goal("largest rms over claimed deviation", float(max(claims)), 1.4)
    goal("smallest rms over claimed deviation", float(min(claims)), 0.6, at_least=True)
