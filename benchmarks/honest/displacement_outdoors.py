"""What happens to a displacement sensor and its accelerometer outdoors: clocks, loggers, GNSS, worn gauges."""

import numpy as np

from benchmarks.honest.displacement import LENGTH_S, Change, Scene
from benchmarks.honest.oscillators import MARGIN_S, STEP_HZ, after, gauss_markov, in_band
from benchmarks.honest.oscillators import hum as machine
from midspan.records import Floats

BANDS_HZ = ((0.15, 1.5), (0.3, 2.0), (0.6, 6.0))  # a long span, a building, a footbridge


def installation(
    rng: np.random.Generator,
    *,
    band_hz: tuple[float, float] | None = None,
    slow_hz: float = 10.0,
    rms_m: float | None = None,
    noise_m: float = 2e-4,
    rate_hz: float = 100.0,
) -> Scene:
    """Oscillators of 2 to 5 mm rms under random forces, a gauge of 0.2 mm at 10 Hz, an accelerometer of 2 mm/s²."""
    rms_m = float(rng.uniform(2e-3, 5e-3)) if rms_m is None else rms_m
    band_hz = band_hz or BANDS_HZ[rng.integers(len(BANDS_HZ))]
    slow_s = np.arange(0.3 + rng.uniform(0, 1 / slow_hz), LENGTH_S - 0.5, 1 / slow_hz)
    motion = in_band(rng, band_hz, rms_m, length_s=LENGTH_S)
    return Scene(rng, motion, rate_hz, slow_s, noise_m_s2=2e-3, noise_m=noise_m)


def gnss(rng: np.random.Generator) -> Scene:
    """GNSS at 5 Hz, 3 mm, on a long span of 5 to 30 mm rms at 0.15 to 1.5 Hz."""
    rms = float(5e-3 * 6 ** rng.uniform())
    return installation(rng, band_hz=BANDS_HZ[0], slow_hz=5.0, rms_m=rms, noise_m=3e-3)


def calm(made: Scene) -> None:
    """Nothing is broken."""


def float_(made: Scene) -> None:
    """An RTK solution converges after a float one: 60 to 100 mm off, exp(-t/25 s), and fixed again 40 s later."""
    start = made.rng.uniform(40, 60)
    age = made.slow_s - start
    off = made.rng.choice([-1, 1]) * made.rng.uniform(0.060, 0.100) * np.exp(-age / 25.0)
    made.error_m, made.stretch_s = np.where((age >= 0) & (age < 40), off, 0.0), (start, start + 40.0)


def clockstep(made: Scene) -> None:
    """The slow sensor's clock is set by 20, 60 or 300 ms, forwards or back, somewhere in the middle."""
    step = made.rng.choice([-1, 1]) * made.rng.choice([0.02, 0.06, 0.3])
    made.ahead_s = after(made.slow_s, made.rng.uniform(30, 80), step)


def accstep(made: Scene) -> None:
    """The accelerometer's clock is set forwards by 20, 60 or 300 ms."""
    made.stamps_s = made.time_s + after(made.time_s, made.rng.uniform(30, 80), made.rng.choice([0.02, 0.06, 0.3]))


def accdrift(made: Scene) -> None:
    """The accelerometer's clock is 50 to 200 ppm fast or slow, and by a fifth of that less as it warms up in 60 s."""
    rate = made.rng.choice([-1, 1]) * made.rng.uniform(50e-6, 200e-6)
    warming = 60.0 * (1 - np.exp(-made.time_s / 60.0))
    made.stamps_s = made.time_s + rate * (made.time_s - 0.2 * warming)


def backlater(made: Scene) -> None:
    """The slow sensor is away for 15 to 40 s, and its clock is 5 to 50 ms off afterwards."""
    start = made.rng.uniform(30, 50)
    end = start + made.rng.uniform(15, 40)
    made.lost |= (made.slow_s > start) & (made.slow_s < end)
    made.ahead_s = after(made.slow_s, end, made.rng.choice([-1, 1]) * made.rng.uniform(5e-3, 50e-3))


def rounding(made: Scene) -> None:
    """Stamps in whole 10 ms (a logger at 200 Hz), or in whole 1 ms (400 Hz, late by 0.4 ms or so): some are equal."""
    coarse = made.rng.uniform() < 0.5
    made.rate_hz, made.round_s = (200.0, 0.010) if coarse else (400.0, 0.001)
    made.__post_init__()
    late = np.zeros(len(made.time_s)) if coarse else np.abs(made.rng.normal(0, 0.7e-3, len(made.time_s)))
    made.stamps_s = np.maximum.accumulate(made.time_s + late)


def hum(made: Scene) -> None:
    """No anti-alias filter, and a machine near the accelerometer's rate: a narrow line in the acceleration alone."""
    made.added_m_s2 = machine(made.rng, made.time_s, rate_hz=made.rate_hz)


def backlash(made: Scene) -> None:
    """The gauge's linkage has a play of 0.05 to 0.5 mm: it follows only after the play is taken up."""
    grid = np.arange(int((LENGTH_S + MARGIN_S) * STEP_HZ)) / STEP_HZ
    true = made.seen.at(grid)
    moved = play(true, float(10 ** made.rng.uniform(np.log10(5e-5), np.log10(5e-4))))
    made.error_m = np.interp(made.slow_s, grid, moved - true)


def play(true_m: Floats, width_m: float) -> Floats:
    """Output (n,) of a linkage with a play of `width_m` whose input is `true_m` (n,)."""
    out = np.empty(len(true_m))
    last = true_m[0]
    for k, value in enumerate(true_m):
        last = min(max(last, value - width_m / 2), value + width_m / 2)
        out[k] = last
    return out


def level(made: Scene) -> None:
    """An automatic level that writes whole steps of 1 to 5 mm, and moves by 0.4 to 2 of them, rms."""
    made.step_m = float(made.rng.choice([1e-3, 2e-3, 5e-3]))
    made.slow_s = made.slow_s[::2]
    made.__post_init__()
    size = made.step_m * made.rng.uniform(0.4, 2.0)
    made.moves(in_band(made.rng, BANDS_HZ[made.rng.integers(2)], size, length_s=LENGTH_S))


def multipath(made: Scene) -> None:
    """GNSS multipath of 2 to 8 mm, which takes 40 to 300 s to change: no record of two minutes shows it."""
    tau, std = made.rng.uniform(40, 300), made.rng.uniform(2e-3, 8e-3)
    made.error_m = gauss_markov(made.rng, made.slow_s, std=std, correlation_s=tau)
    made.drift_m = std * np.sqrt(2 * (1 - np.exp(-10 / tau)))


def clip(made: Scene) -> None:
    """The accelerometer's range is exceeded by 1 to 5 % of its samples."""
    size = np.abs(made.felt.at(made.time_s) + 0.05)
    made.range_m_s2 = float(np.quantile(size, 1 - made.rng.uniform(0.01, 0.05)))


OF_GNSS: tuple[Change, ...] = (float_, multipath)
# There is no one true scale: a play takes more of a small swing, a clipped swing is smaller than it was.
WITHOUT_SCALE: tuple[Change, ...] = (backlash, clip)
