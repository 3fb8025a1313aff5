"""Figure 16 of the two-stage paper again: error over the displacement's noise, and over an error of its time stamps.

The beam of Ma, Liu, Choi and Sohn (40 m; 100 Hz acceleration, 10 Hz displacement), its truth stepped at 4 kHz. `fir`
with a fixed cut-off is the paper's existing technique, `two-stage-fir` its proposed one. Errors are
taken without five seconds at each end. With a folder on the command line, both figures are drawn into it.
"""

import sys
from pathlib import Path

import numpy as np

from midspan import Acceleration, Displacement, smooth
from midspan.fusion.runners import run_method
from midspan.fusion.streams import KalmanSettings, MethodSettings
from midspan.records import Source
from midspan.simulate.motion.beam import paper_beam_motion
from midspan.simulate.motion.sensors import AccelerometerModel, DisplacementSensorModel, noise_std_for, simulate_pair

FIXED = MethodSettings(KalmanSettings(bias=0.02), cut_off_hz=1.0)
METHODS = {
    "fir": lambda a, d: run_method("fir", a, d, FIXED).estimate,
    "two-stage-fir": lambda a, d: run_method("two-stage-fir", a, d).estimate,
    "smoother": lambda a, d: smooth(a, d).estimate,
}
SEEDS, INNER = (11, 12), slice(500, -500)
time_s = np.arange(0, 100, 0.01)
motions = {seed: paper_beam_motion(seed) for seed in SEEDS}


def errors_mm(snr_db, late_s):
    """RMSE in mm of each method, the displacement having `snr_db` and stamps that are `late_s` too late."""
    squares = {name: [] for name in METHODS}
    for seed, motion in motions.items():
        noise = noise_std_for(motion.acceleration(time_s), 40.0), noise_std_for(motion.displacement(time_s), snr_db)
        pair = simulate_pair(
            motion,
            100.0,
            accelerometer=AccelerometerModel(100.0, noise[0], bias_m_s2=0.02),
            displacement=DisplacementSensorModel(10.0, noise[1], time_offset_s=-late_s),
            seed=seed,
        )
        a, d = pair.acceleration, pair.displacement
        acceleration = Acceleration(a.time_ns, a.value, np.full(len(a.value), noise[0] ** 2 / 100.0))
        source = np.full(len(d.value), Source.DISPLACEMENT, dtype=np.uint8)
        displacement = Displacement(d.time_ns, d.value, np.full(len(d.value), noise[1] ** 2), source)
        for name, method in METHODS.items():
            error = method(acceleration, displacement).displacement_m - pair.true_displacement_m
            squares[name].append(np.mean(error[INNER] ** 2))
    return [1e3 * float(np.sqrt(np.mean(squares[name]))) for name in METHODS]


FIGURES = {
    "16a": ("SNR of the displacement, dB", range(20, 101, 10), lambda snr: errors_mm(float(snr), 0.0)),
    "16b": ("error of its time stamps, ms", range(0, 11, 2), lambda ms: errors_mm(40.0, 1e-3 * ms)),
}
results = {}
for name, (label, values, errors) in FIGURES.items():
    results[name] = np.array([errors(value) for value in values])
    print(f"Figure {name}: RMSE in mm over {label}")
    print("        " + "".join(f"{method:>28s}" for method in METHODS))
    for value, row in zip(values, results[name], strict=True):
        print(f"{value:8d}" + "".join(f"{error:28.4f}" for error in row))

if len(sys.argv) > 1:
    from matplotlib.figure import Figure

    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, (label, values, _) in FIGURES.items():
        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        axes = figure.add_subplot(xlabel=label, ylabel="RMSE, mm", title=f"Figure {name} of the two-stage paper, again")
        axes.set_yscale("log")
        for k, method in enumerate(METHODS):
            axes.plot(list(values), results[name][:, k], marker="o", label=method)
        axes.grid(alpha=0.3, which="both")
        axes.legend()
        figure.savefig(folder / f"figure_{name}.png", dpi=120)
        print(f"drawn: {folder / f'figure_{name}.png'}")
