"""The filter and the smoother on plain arrays, for people who bring their own sensors and their own loop.

A displacement sensor of 10 Hz with 0.2 mm of noise meets an accelerometer of 100 Hz. The motion has a mode at 8.3 Hz,
above what 10 Hz can follow; the filter does not mind, because it compares at the exact instants.
"""

import numpy as np

from midspan import Acceleration, Displacement, Estimate, KalmanFilter, smooth
from midspan.evaluate.bound import KnownNoise, closed_bound
from midspan.records import Source, nanoseconds

rng = np.random.default_rng(7)
noise = KnownNoise(
    acceleration_std_m_s2=5e-3, acceleration_rate_hz=100.0, displacement_std_m=2e-4, displacement_rate_hz=10.0
)
slow, fast = 2 * np.pi * 0.2, 2 * np.pi * 8.3


def displacement_m(time_s):
    """The true displacement, m."""
    return 6e-3 * np.sin(slow * time_s) + 2e-3 * np.sin(fast * time_s)


def acceleration_m_s2(time_s):
    """Its second derivative, m/s²."""
    return -6e-3 * slow**2 * np.sin(slow * time_s) - 2e-3 * fast**2 * np.sin(fast * time_s)


time_s = np.arange(0, 120, 1 / 100)  # the accelerometer's clock
measured_s = np.arange(0.003, 119, 1 / 10)  # its own instants, never on the accelerometer's grid

acceleration = Acceleration(
    time_ns=nanoseconds(time_s),
    value_m_s2=acceleration_m_s2(time_s) + 0.02 + rng.normal(0, 5e-3, len(time_s)),  # with a constant bias
    noise_density=np.full(len(time_s), noise.acceleration_density),
)
displacement = Displacement(
    time_ns=nanoseconds(measured_s),
    value_m=displacement_m(measured_s) + rng.normal(0, 2e-4, len(measured_s)),
    variance_m2=np.full(len(measured_s), 2e-4**2),
    source=np.full(len(measured_s), Source.DISPLACEMENT, dtype=np.uint8),
)


def report(name, estimate):
    """Print the error of an estimate compared with the least that the noise allows."""
    middle = slice(1000, -1000)  # without ten seconds at each end, where the filter settles
    error = (estimate.displacement_m - displacement_m(estimate.time_ns / 1e9))[middle]
    inside = np.mean(np.abs(error) <= 1.96 * np.sqrt(estimate.variance_m2[middle]))
    bound = closed_bound(noise, name)
    rms = np.sqrt(np.mean(error**2))
    print(f"{name:9s} rms error {1e3 * rms:.4f} mm, bound {1e3 * bound:.4f} mm, inside ±1.96 σ: {100 * inside:.1f} %")


# Causal, as a stream: push blocks in time order, here one second at a time. Displacement goes first.
stream = KalmanFilter()
blocks = []
for start in range(0, len(time_s), 100):
    rows = slice(start, start + 100)
    last_ns = acceleration.time_ns[rows][-1]
    due = (displacement.time_ns <= last_ns) & (displacement.time_ns > last_ns - 1_000_000_000)
    stream.push(Displacement(*(getattr(displacement, f)[due] for f in displacement.__slots__)))
    outputs = stream.push(Acceleration(*(getattr(acceleration, f)[rows] for f in acceleration.__slots__)))
    blocks += [item for item in outputs if isinstance(item, Estimate)]
blocks += [item for item in stream.finish() if isinstance(item, Estimate)]
causal = Estimate(*(np.concatenate([getattr(b, f) for b in blocks]) for f in Estimate.__slots__))
report("kalman", causal)

# Over the whole record at once.
smoothed = smooth(acceleration, displacement)
report("smoother", smoothed.estimate)
innovation = smoothed.innovation.value_m / np.sqrt(smoothed.innovation.variance_m2)
print(f"innovations: mean square {np.mean(innovation[20:] ** 2):.2f} (1 when the noise levels are right)")
