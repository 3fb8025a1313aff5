"""How much motion the scale factor needs: one minute of a camera at 10 Hz with a accelerometer.

Simulated pairs, narrow-band random motion about three frequencies, noise of 0.02 px a frame and of 2.5 mm/s² a sample
(100 Hz). For each amount of motion: what `calibrate_scale` says of its own uncertainty, and how far it is off.
"""

import numpy as np

from midspan import Pair, UntrustedError, calibrate_scale
from midspan.simulate.motion.motion import random_motion
from midspan.simulate.motion.sensors import AccelerometerModel, DisplacementSensorModel, simulate_pair

SCALE_M_PER_PX = -1.5e-3
NOISE_PX = 0.02
SEEDS = 5

accelerometer = AccelerometerModel(rate_hz=100.0, noise_std_m_s2=2.5e-3, bias_m_s2=0.03)
camera = DisplacementSensorModel(rate_hz=10.0, noise_std_m=NOISE_PX * abs(SCALE_M_PER_PX), time_offset_s=0.05)


def calibrate(frequency_hz, motion_px, seed):
    """Relative error and relative standard deviation of the scale factor; None where it is refused."""
    rng = np.random.default_rng(seed)
    band = (0.9 * frequency_hz, 1.1 * frequency_hz)
    motion = random_motion(band, motion_px * abs(SCALE_M_PER_PX), rng=rng, lines=24)
    pair = simulate_pair(motion, 60.0, accelerometer=accelerometer, displacement=camera, seed=seed)
    inside = (pair.displacement.time_ns >= 0.5e9) & (pair.displacement.time_ns <= 59.4e9)
    time_s, value = pair.acceleration.time_ns / 1e9, pair.acceleration.value
    translation = pair.displacement.value[inside] / SCALE_M_PER_PX
    variance = np.full(len(translation), NOISE_PX**2)
    samples = np.column_stack((time_s, value - value.mean(), np.ones(len(value))))
    rows = np.column_stack((pair.displacement.time_ns[inside] / 1e9, translation - translation[0], variance))
    try:
        found = calibrate_scale(Pair(samples, rows), 0.2)
    except UntrustedError:
        return None
    error = found.scale.value_m_per_px / SCALE_M_PER_PX - 1
    return error, np.sqrt(found.scale.variance) / abs(SCALE_M_PER_PX)


print("motion rms / noise   0.5 Hz: σ, error     2 Hz: σ, error       5 Hz: σ, error")
for times in (2, 5, 10, 15, 30, 100):
    cells = []
    for frequency_hz in (0.5, 2.0, 5.0):
        found = [row for k in range(SEEDS) if (row := calibrate(frequency_hz, times * NOISE_PX, 1000 * times + k))]
        if len(found) < SEEDS:
            cells.append("refused            ")
            continue
        error, std = np.array(found).T
        cells.append(f"{100 * np.median(std):5.2f} %, {100 * np.sqrt(np.mean(error**2)):5.2f} %   ")
    print(f"{times:6d} ({times * NOISE_PX:4.2f} px)      " + "  ".join(cells))
print("\nrefused: at least one of the recordings was refused.")
print("σ: median of the standard deviations that were given; error: rms of the true errors; five recordings each.")
