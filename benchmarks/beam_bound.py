"""Beam of the two-stage paper, fine-step truth: error against the theoretical bound, coverage of the band."""

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.cases import Beam, beam, blocks, fused, learnt, rms
from benchmarks.table import goal, show
from midspan.evaluate.bound import KnownNoise, exact_bound

# Never used while the filter was made.
SEEDS = range(901, 913)
LIMITS = {"kalman": 1.06, "smoother": 1.05}


def prepared(case: Beam, noise: str) -> tuple:
    """Both blocks with the noise levels as simulated or as learnt."""
    if noise == "known":
        return blocks(case.acceleration, case.displacement, case.noise_std[0] ** 2 / 100.0, case.noise_std[1] ** 2)
    fit = learnt(case.acceleration, case.displacement)
    return blocks(
        case.acceleration, case.displacement, fit.input_noise_density, fit.variance_factor, fit.offset.value_s
    )


def main() -> None:
    cases = [beam(seed) for seed in SEEDS]
    noise = KnownNoise(cases[0].noise_std[0], 100.0, cases[0].noise_std[1], 10.0)
    cubic = [
        c.inner(CubicSpline(c.displacement.time_ns, c.displacement.value)(c.acceleration.time_ns) - c.truth_m)
        for c in cases
    ]
    rows = [["cubic interpolation", "", 1e3 * rms(np.array(cubic)), "", "", ""]]
    verdicts = []
    for method, limit in LIMITS.items():
        bound = exact_bound(noise, method)
        for kind in ("known", "learnt"):
            errors, inside = [], []
            for case in cases:
                estimate = fused(*prepared(case, kind), method)
                error = case.inner(estimate.displacement_m - case.truth_m)
                errors.append(error)
                inside.append(np.mean(np.abs(error) <= 1.96 * case.inner(np.sqrt(estimate.variance_m2))))
            rows.append(
                [method, kind, 1e3 * rms(np.array(errors)), 1e3 * bound, rms(np.array(errors)) / bound, np.mean(inside)]
            )
            verdicts.append((f"{method}, noise {kind}", rms(np.array(errors)) / bound, limit, float(np.mean(inside))))
    show(["method", "noise", "RMSE mm", "bound mm", "ratio", "in 95 % band"], rows)
    for what, ratio, limit, share in verdicts:
        goal(f"{what}: RMSE over bound", ratio, limit)
        goal(f"{what}: distance of the coverage from 95 %", abs(share - 0.95), 0.02)
