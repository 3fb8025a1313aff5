"""Why the printed adaptive noise runs away under an accelerometer bias, and that the guarded form does not.

A structure at rest is measured for 20 minutes at 100 Hz and 10 Hz. `adaptive-kalman` as printed learns the
displacement's noise from the innovations; under a bias b these hold the filter's own error too. The table sets what it
learns together with the balance 1 / (1 - (b/limit)²) with limit = noise · sqrt(10 / 100), which docs/methods.md
derives.

`python examples/09_adaptive_noise_runs_away.py figure.png` also draws it.
"""

import sys

import numpy as np

from midspan import Acceleration, Displacement
from midspan.fusion.runners import run_method
from midspan.fusion.streams import MethodSettings
from midspan.papers.printed.adaptive import PrintedFilter

RATE_HZ, SLOW_HZ, LENGTH_S = 100.0, 10.0, 1200.0
NOISE_A, NOISE_D = 5e-3, 0.5e-3  # m/s² a sample, m
LIMIT = NOISE_A * np.sqrt(SLOW_HZ / RATE_HZ)
SHARES = (0.0, 0.3, 0.6, 0.8, 0.95, 1.05, 2.0)


def at_rest(bias):
    """Both sensors of a structure that does not move, the accelerometer with a bias (m/s²)."""
    rng = np.random.default_rng(1)
    time_s, met_s = np.arange(0, LENGTH_S, 1 / RATE_HZ), np.arange(0, LENGTH_S, 1 / SLOW_HZ)
    acceleration = Acceleration(
        np.rint(1e9 * time_s).astype(np.int64),
        bias + rng.normal(0, NOISE_A, time_s.size),
        np.full(time_s.size, NOISE_A**2 / RATE_HZ),
    )
    displacement = Displacement(
        np.rint(1e9 * met_s).astype(np.int64),
        rng.normal(0, NOISE_D, met_s.size),
        np.full(met_s.size, NOISE_D**2),
        np.full(met_s.size, 4, dtype=np.uint8),
    )
    return acceleration, displacement


def estimated(bias, *, literal):
    """What the innovations are taken to vary by over the true noise, frame by frame, and the rms error in mm.

    As printed it is the estimated noise variance; the guarded form's innovations hold the prediction's variance too.
    """
    acceleration, displacement = at_rest(bias)
    if literal:
        settings = MethodSettings(literal=True, forgetting=0.98)
        printed = PrintedFilter(settings, int(acceleration.time_ns[0]), step_s=1.0 / RATE_HZ, speed_m_s=0.0)
        printed.wait(displacement)
        moved, _, noise = printed.push(acceleration)
        variance = noise[np.isfinite(noise)]
    else:
        found = run_method("adaptive-kalman", acceleration, displacement, MethodSettings(forgetting=0.98))
        moved, variance = found.estimate.displacement_m, found.innovation.variance_m2
    return variance / NOISE_D**2, 1e3 * np.sqrt(np.mean(moved[len(moved) // 2 :] ** 2))


courses = {}
print(f"limit: {1e3 * LIMIT:.2f} mm/s² = {LIMIT / 9.80665e-3:.2f} mg")
print("b / limit   R / true R: balance  as printed   error mm   guarded   error mm")
for share in SHARES:
    balance = 1.0 / (1.0 - share**2) if share < 1.0 else np.inf
    courses[share], error_mm = estimated(share * LIMIT, literal=True)
    guarded, guarded_mm = estimated(share * LIMIT, literal=False)
    half = len(guarded) // 2
    print(
        f"{share:9.2f}   {balance:19.3g}  {np.median(courses[share][half:]):10.3g} {error_mm:10.3g}   "
        f"{np.median(guarded[half:]):7.3f} {guarded_mm:10.3f}"
    )

if len(sys.argv) > 1:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4), layout="constrained")
    axes = figure.subplots()
    for share, course in courses.items():
        minutes = np.arange(course.size) / SLOW_HZ / 60.0
        (line,) = axes.semilogy(minutes[::20], np.maximum(course[::20], 1e-2), label=f"b = {share:g} limit")
        if 0.0 < share < 1.0:
            axes.axhline(1.0 / (1.0 - share**2), color=line.get_color(), linestyle=":", linewidth=1)
    axes.set(xlabel="time (min)", ylabel="estimated R / true R", ylim=(0.5, 1e12))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, ncols=2, title="dotted: balance")
    figure.savefig(sys.argv[1], dpi=120)
