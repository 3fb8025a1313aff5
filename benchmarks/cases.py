"""Simulated inputs that several benchmarks share."""

from dataclasses import dataclass

import numpy as np

from midspan.calibration.fit import Pair
from midspan.calibration.noise import NoiseCalibration, calibrate_noise
from midspan.fusion.runners import run_method
from midspan.fusion.streams import MethodSettings
from midspan.records import Acceleration, Displacement, Estimate, Floats, Source, TimeSeries, nanoseconds
from midspan.simulate.motion.beam import paper_beam_motion
from midspan.simulate.motion.sensors import AccelerometerModel, DisplacementSensorModel, noise_std_for, simulate_pair

RATE_HZ, SLOW_HZ, SNR_DB = 100.0, 10.0, 40.0
MAX_OFFSET_S = 0.5


@dataclass(frozen=True)
class Beam:
    """The beam of the two-stage paper (finely stepped), 100 Hz and 10 Hz, 40 dB each; noise_std: m/s², m."""

    acceleration: TimeSeries
    displacement: TimeSeries
    truth_m: Floats
    noise_std: tuple[float, float]

    def inner(self, values: Floats) -> Floats:
        """Without five seconds at each end, as the paper does."""
        return values[500:-500]


def beam(seed: int, *, bias: float = 0.0, offset_s: float = 0.0, duration_s: float = 100.0) -> Beam:
    """A beam record with seeded phases and noise."""
    motion = paper_beam_motion(seed, duration_s=duration_s)
    time = np.arange(0, duration_s, 1 / RATE_HZ)
    noise = (noise_std_for(motion.acceleration(time), SNR_DB), noise_std_for(motion.displacement(time), SNR_DB))
    pair = simulate_pair(
        motion,
        duration_s,
        accelerometer=AccelerometerModel(RATE_HZ, noise[0], bias),
        displacement=DisplacementSensorModel(SLOW_HZ, noise[1], offset_s),
        seed=seed,
    )
    return Beam(pair.acceleration, pair.displacement, pair.true_displacement_m, noise)


def blocks(
    acceleration: TimeSeries, displacement: TimeSeries, density: float, variance: float, offset_s: float = 0.0
) -> tuple[Acceleration, Displacement]:
    """Both series as the filter takes them."""
    count = len(displacement.value)
    return (
        Acceleration(acceleration.time_ns, acceleration.value, np.full(len(acceleration.value), density)),
        Displacement(
            displacement.time_ns + round(1e9 * offset_s),
            displacement.value,
            np.full(count, variance),
            np.full(count, Source.DISPLACEMENT, dtype=np.uint8),
        ),
    )


def estimated(
    acceleration: TimeSeries, displacement: TimeSeries, max_offset_s: float = MAX_OFFSET_S
) -> NoiseCalibration:
    """Noise levels and clock offset from the two series alone."""
    origin = int(acceleration.time_ns[0])
    time_s, met_s = ((series.time_ns - origin) / 1e9 for series in (acceleration, displacement))
    usable = np.isfinite(displacement.value)
    inner = (met_s > time_s[0] + max_offset_s) & (met_s < time_s[-1] - max_offset_s)
    value = acceleration.value - np.mean(acceleration.value)
    samples = np.column_stack((time_s, value, np.ones(len(value))))
    rows = np.column_stack((met_s, np.where(usable, displacement.value, 0.0), np.where(usable, 1.0, np.inf)))
    return calibrate_noise(Pair(samples, rows[inner], 1.0), max_offset_s)


def fused(acceleration: Acceleration, displacement: Displacement, method: str, lag_s: float = 0.5) -> Estimate:
    """The estimate of a method of `midspan methods`; with " --literal" behind its name as printed."""
    name, _, literal = method.partition(" --")
    return run_method(name, acceleration, displacement, MethodSettings(literal=bool(literal), lag_s=lag_s)).estimate


def even(rate_hz: float, length_s: float) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Even stamps from 0 up to, not including, `length_s`, ns."""
    return nanoseconds(np.arange(int(length_s * rate_hz)) / rate_hz)


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
