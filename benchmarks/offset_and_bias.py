"""Accelerometer bias of 0 … 50 mm/s² and clock offsets up to ±200 ms: what they cost with everything learned."""

import numpy as np

from benchmarks.cases import beam, blocks, estimated, fused, rms
from benchmarks.table import goal, show

SEEDS = range(921, 927)
BIASES_MM_S2 = (0.0, 5.0, 20.0, 50.0)
OFFSETS_MS = (-200.0, -20.0, 0.0, 20.0, 200.0)


def one(bias: float, offset_s: float) -> tuple[float, float, float]:
    """RMSE of kalman and smoother (m) and the largest error of the learned offset (s) over the seeds."""
    errors: dict[str, list] = {"kalman": [], "smoother": []}
    off = []
    for seed in SEEDS:
        case = beam(seed, bias=bias, offset_s=offset_s)
        fit = estimated(case.acceleration, case.displacement)
        pair = blocks(
            case.acceleration, case.displacement, fit.input_noise.density, fit.variance_factor, fit.offset.value_s
        )
        off.append(abs(fit.offset.value_s - offset_s))
        for method, found in errors.items():
            found.append(case.inner(fused(*pair, method).displacement_m - case.truth_m))
    return rms(np.array(errors["kalman"])), rms(np.array(errors["smoother"])), max(off)


def main() -> None:
    table = {(b, o): one(1e-3 * b, 1e-3 * o) for b in BIASES_MM_S2 for o in OFFSETS_MS if b == 0.0 or o in (0.0, 200.0)}
    rows = [[b, o, 1e3 * k, 1e3 * s, 1e3 * worst] for (b, o), (k, s, worst) in table.items()]
    show(["bias mm/s²", "offset ms", "kalman RMSE mm", "smoother RMSE mm", "worst offset error ms"], rows)
    plain = table[(0.0, 0.0)]
    for i, method in enumerate(("kalman", "smoother")):
        biased = max(abs(table[(b, 0.0)][i] / plain[i] - 1.0) for b in BIASES_MM_S2)
        goal(f"{method}: change of RMSE by bias", 100 * biased, 3.0, unit="%")
    goal("worst error of the learned offset", 1e3 * max(v[2] for v in table.values()), 1.0, unit="ms")
    goal("smoother: cost of an offset of 200 ms", 100 * (table[(0.0, 200.0)][1] / plain[1] - 1.0), 10.0, unit="%")
