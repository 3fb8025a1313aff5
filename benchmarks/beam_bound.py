"""Beam of the two-stage paper, fine-step truth: error of every method against the bound, delay, coverage."""

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.cases import Beam, beam, blocks, estimated, fused, rms
from benchmarks.table import goal, show
from midspan.evaluate.bound import KnownNoise, exact_bound

# Never used while the filter was made.
SEEDS = range(901, 913)
# Method, lag in s, goals for RMSE over the bound with known and with learned noise.
METHODS = (
    ("kalman", 0.0, 1.02, 1.05),
    ("lag", 0.1, np.inf, np.inf),
    ("lag", 0.3, 1.05, 1.08),
    ("lag", 0.5, np.inf, np.inf),
    ("smoother", np.inf, 1.03, 1.05),
    ("adaptive-kalman", 0.0, np.inf, np.inf),
    ("adaptive-kalman --literal", 0.0, np.inf, np.inf),
    ("fir", 2.0, np.inf, np.inf),
    ("fir --literal", 1.0, np.inf, np.inf),
    ("two-stage-fir", 4.9, np.inf, np.inf),
    ("two-stage-fir --literal", 4.9, np.inf, np.inf),
)
# Whose bound the methods without one of their own are compared with.
NEXT_TO = {"adaptive-kalman": "kalman", "fir": "smoother", "two-stage-fir": "smoother"}


def prepared(case: Beam, noise: str) -> tuple:
    """Both blocks with the noise levels as simulated or as learned."""
    if noise == "known":
        return blocks(case.acceleration, case.displacement, case.noise_std[0] ** 2 / 100.0, case.noise_std[1] ** 2)
    fit = estimated(case.acceleration, case.displacement)
    return blocks(
        case.acceleration, case.displacement, fit.input_noise.density, fit.variance_factor, fit.offset.value_s
    )


def measured(cases: list[Beam], pairs: list[tuple], method: str, lag_s: float) -> tuple[float, float]:
    """RMSE (m) over all cases and the share of the rows inside ±1.96 standard deviations."""
    errors, inside = [], []
    for case, pair in zip(cases, pairs, strict=True):
        estimate = fused(*pair, method, max(lag_s, 1e-9) if np.isfinite(lag_s) else 0.5)
        error = case.inner(estimate.displacement_m - case.truth_m)
        errors.append(error)
        inside.append(np.mean(np.abs(error) <= 1.96 * case.inner(np.sqrt(estimate.variance_m2))))
    return rms(np.array(errors)), float(np.mean(inside))


def main() -> None:
    cases = [beam(seed) for seed in SEEDS]
    noise = KnownNoise(cases[0].noise_std[0], 100.0, cases[0].noise_std[1], 10.0)
    cubic = [
        c.inner(CubicSpline(c.displacement.time_ns, c.displacement.value)(c.acceleration.time_ns) - c.truth_m)
        for c in cases
    ]
    rows = [["cubic interpolation", "", "", 1e3 * rms(np.array(cubic)), "", "", ""]]
    verdicts = []
    pairs = {kind: [prepared(case, kind) for case in cases] for kind in ("known", "learnt")}
    for method, lag_s, *limits in METHODS:
        name = method.partition(" --")[0]
        bound = exact_bound(noise, NEXT_TO.get(name, name), lag_s=lag_s if name == "lag" else 0.5)
        for kind, limit in zip(pairs, limits, strict=True):
            error, share = measured(cases, pairs[kind], method, lag_s)
            delay = "whole record" if lag_s == np.inf else f"{lag_s:g}"
            rows.append([method, delay, kind, 1e3 * error, 1e3 * bound, error / bound, share])
            if np.isfinite(limit):
                verdicts.append((f"{method} {delay} s, noise {kind}", error / bound, limit, share))
    show(["method", "delay s", "noise", "RMSE mm", "bound mm", "ratio", "in 95 % band"], rows)
    for what, ratio, limit, share in verdicts:
        goal(f"{what}: RMSE over its bound", ratio, limit)
        goal(f"{what}: distance of the coverage from 95 %", abs(share - 0.95), 0.02)
