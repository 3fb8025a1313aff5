"""Recordings with `[displacement]`: an accelerometer and any slow sensor, as CSV, obeying the model or breaking it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.honest.lines import (
    GRAVITY_M_S2,
    Lines,
    acceleration,
    averaged,
    events,
    low_passed,
    modes,
    passing,
    ringing,
)
from benchmarks.honest.oscillators import Oscillation, Signal
from midspan.records import Floats

LENGTH_S = 120.0


@dataclass
class Scene:
    """One recording before it is written; a kind changes it in place.

    motion: true displacement (m); felt: what the accelerometer is made to measure (m/s²); seen: what the slow sensor
    is made to measure (m); slow_s (n,): its true instants; white_m and error_m (n,): its white noise's standard
    deviation and what it adds together with; keys: further lines of its section; drift_m: standard deviation of what a
    slow error of the sensor adds in 10 s. ahead_s (n,): by how much its clock is ahead, besides the offset;
    stamps_s (m,): the accelerometer's stamps; round_s: to which both clocks' stamps are rounded; range_m_s2: what the
    accelerometer can measure; stretch_s: true times in which rows are also judged by themselves.
    """

    rng: np.random.Generator
    motion: Lines | Oscillation
    rate_hz: float
    slow_s: Floats
    noise_m_s2: float
    noise_m: float
    length_s: float = LENGTH_S
    offset_s: float = 0.0
    keys: str = ""
    gain: float = 1.0
    drift_m: float = 0.0
    felt: Lines | Signal = field(init=False)
    seen: Lines | Oscillation = field(init=False)
    white_m: Floats = field(init=False)
    error_m: Floats = field(init=False)
    added_m_s2: Floats = field(init=False)
    step_m: float = 1e-6
    ahead_s: Floats = field(init=False)
    stamps_s: Floats = field(init=False)
    round_s: float = 1e-9
    range_m_s2: float = np.inf
    stretch_s: tuple[float, float] | None = None
    lost: "np.ndarray[tuple[int], np.dtype[np.bool_]]" = field(init=False)

    def __post_init__(self) -> None:
        self.moves(self.motion)
        self.white_m, self.error_m = np.full(len(self.slow_s), self.noise_m), np.zeros(len(self.slow_s))
        self.added_m_s2, self.lost = np.zeros(len(self.time_s)), np.zeros(len(self.slow_s), dtype=np.bool_)
        self.ahead_s, self.stamps_s = np.zeros(len(self.slow_s)), self.time_s

    def moves(self, motion: Lines | Oscillation) -> None:
        """Give it another motion."""
        self.motion, self.seen = motion, motion
        self.felt = motion.acceleration if isinstance(motion, Oscillation) else acceleration(motion)

    @property
    def time_s(self) -> Floats:
        """The accelerometer's instants."""
        return np.arange(round(self.length_s * self.rate_hz)) / self.rate_hz

    def acceleration(self) -> Floats:
        """What the accelerometer writes, m/s²."""
        noise = self.rng.normal(0, self.noise_m_s2, len(self.time_s))
        value = self.felt.at(self.time_s) + 0.05 + self.added_m_s2 + noise
        return np.clip(value, -self.range_m_s2, self.range_m_s2)


def scene(rng: np.random.Generator, *, band_hz: tuple[float, float] = (0.4, 4.5)) -> Scene:
    """A structure of 1 to 10 mm rms, ordinary sensors, 2 minutes."""
    slow_hz = float(rng.choice([2.0, 5.0, 10.0]))
    rms = 1e-3 * 10 ** rng.uniform(0, 1)
    first = rng.uniform(0, 1 / slow_hz)
    return Scene(
        rng,
        modes(rng, band_hz, rms, length_s=LENGTH_S),
        rate_hz=float(rng.choice([50.0, 100.0, 200.0])),
        slow_s=np.arange(0.3 + first, LENGTH_S - 0.3, 1 / slow_hz),
        noise_m_s2=1e-3 * 10 ** rng.uniform(-0.3, 0.7),
        noise_m=rms * 10 ** rng.uniform(-1.7, -0.5),
    )


def write(made: Scene, folder: Path) -> None:
    """Write accel.csv, slow.csv and recording.toml."""
    table = np.column_stack((rounded(made.stamps_s, made.round_s), made.acceleration()))
    np.savetxt(folder / "accel.csv", table, "%.9f", ",", header="time_s,accel", comments="")
    value = made.seen.at(made.slow_s) + made.error_m + made.rng.normal(size=len(made.slow_s)) * made.white_m
    value = np.round(value / made.step_m) * made.step_m
    stamps = rounded(made.slow_s - made.offset_s + made.ahead_s, made.round_s)
    rows = np.column_stack((stamps, 1e3 * value))[~made.lost]
    np.savetxt(folder / "slow.csv", rows, "%.9f", ",", header="time_s,height", comments="")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'
        f'[displacement]\nfile = "slow.csv"\ntime = "time_s"\nvalue = "height"\nunit = "mm"\n{made.keys}'
    )


def rounded(time_s: Floats, step_s: float) -> Floats:
    """Stamps (n,) as a clock writes them that counts steps."""
    return np.round(time_s / step_s) * step_s


# ---- kinds that obey the model


def plain(made: Scene) -> None:
    """Modes of 0.4 to 4.5 Hz, nothing else."""


def aliased(made: Scene) -> None:
    """Modes of 2 to 6 Hz before a sensor of 1 Hz."""
    made.slow_s = made.slow_s[:: max(round(1 / np.diff(made.slow_s[:2])[0]), 1)]
    made.rate_hz = 100.0
    made.__post_init__()
    made.moves(modes(made.rng, (2.0, 6.0), 0.5 * made.motion.rms, length_s=LENGTH_S))


def train(made: Scene) -> None:
    """Sags of a second or two while trains pass, and some vibration."""
    at = np.sort(made.rng.uniform(5, 115, 5))
    sag = events(passing(-3 * made.motion.rms, made.rng.uniform(0.6, 2.0)), at, highest_hz=2.0, period_s=300.0)
    made.moves(sag + made.motion.passed(lambda s: 0.3))


def impulse(made: Scene) -> None:
    """Long quiet between impulses that ring."""
    at, f = np.sort(made.rng.uniform(8, 110, 6)), made.rng.uniform(0.8, 3.0)
    push = 4 * made.motion.rms * 2 * np.pi * f
    made.rate_hz = 100.0
    made.__post_init__()
    made.moves(events(ringing(f, 0.02, push), at, highest_hz=9.0, period_s=240.0))


def drift(made: Scene) -> None:
    """The accelerometer's zero walks by 10 mm/s² (1 mg) in a minute."""
    step = made.rng.normal(0, 1e-2 / np.sqrt(60 * made.rate_hz), len(made.time_s))
    made.added_m_s2 = np.cumsum(step)


def gaps(made: Scene) -> None:
    """Two spans of 3 to 8 s without the slow sensor."""
    for start in (made.rng.uniform(20, 50), made.rng.uniform(65, 100)):
        made.lost |= (made.slow_s > start) & (made.slow_s < start + made.rng.uniform(3, 8))


def coarse(made: Scene) -> None:
    """The sensor writes steps of half its noise."""
    made.step_m = 0.5 * made.noise_m


def offset(made: Scene) -> None:
    """Another clock, whose offset is asked for."""
    made.offset_s = made.rng.uniform(-0.3, 0.3)
    made.keys = "estimate_offset = true\n"


# ---- kinds that break it


def gain(made: Scene) -> None:
    """The accelerometer's gain is 2 to 10 % off."""
    made.gain = 1 + made.rng.choice([-1, 1]) * made.rng.uniform(0.02, 0.10)
    made.felt = made.felt.passed(lambda s: made.gain)


def axis(made: Scene) -> None:
    """The accelerometer is turned by 3 to 15 degrees towards an axis that moves as much."""
    angle = np.radians(made.rng.uniform(3, 15))
    cross = acceleration(modes(made.rng, (0.5, 4.0), made.motion.rms, length_s=made.length_s))
    made.gain = float(np.cos(angle))
    made.felt = made.felt.passed(lambda s: np.cos(angle)) + cross.passed(lambda s: np.sin(angle))


def colour(made: Scene) -> None:
    """The sensor has a Gauss-Markov error of 5 to 60 s and 1 to 3 times its white noise, as GNSS has."""
    tau, std = made.rng.uniform(5, 60), made.rng.uniform(1, 3) * made.noise_m
    keep = np.exp(-np.diff(made.slow_s) / tau)
    made.error_m = std * made.rng.normal(size=len(made.slow_s))
    for k, a in enumerate(keep, start=1):
        made.error_m[k] = a * made.error_m[k - 1] + np.sqrt(1 - a * a) * made.error_m[k]
    made.drift_m = std * np.sqrt(2 * (1 - np.exp(-10 / tau)))


def step(made: Scene) -> None:
    """The sensor's level shifts once or twice by 3 to 20 times its noise."""
    for at in made.rng.uniform(15, 105, int(made.rng.integers(1, 3))):
        size = made.rng.choice([-1, 1]) * made.rng.uniform(3, 20) * made.noise_m
        made.error_m += np.where(made.slow_s > at, size, 0.0)


def rain(made: Scene) -> None:
    """The sensor's noise is ten times as large for two spans of 4 to 20 s."""
    for start in (made.rng.uniform(10, 45), made.rng.uniform(65, 95)):
        made.white_m[(made.slow_s > start) & (made.slow_s < start + made.rng.uniform(4, 20))] *= 10.0


def outliers(made: Scene) -> None:
    """Every fifth to tenth value is 20 to 60 times the noise off, in bursts of 1 to 6."""
    share, k = made.rng.uniform(0.10, 0.20), 0
    while k < len(made.slow_s):
        burst = int(made.rng.integers(1, 7))
        off = made.rng.choice([-1, 1], burst) * made.rng.uniform(20, 60, burst) * made.noise_m
        made.error_m[k : k + burst] += off[: len(made.error_m) - k]
        k += burst + max(int(made.rng.exponential(burst * (1 - share) / share)), 1)


def rtk(made: Scene) -> None:
    """A GNSS receiver loses its fixed solution twice: 3 to 12 s of a float solution, 0.2 to 0.4 m off and drifting."""
    for start in (made.rng.uniform(5, 50), made.rng.uniform(60, 105)):
        inside = (made.slow_s > start) & (made.slow_s < start + made.rng.uniform(3, 12))
        off = made.rng.choice([-1, 1]) * made.rng.uniform(0.2, 0.4)
        made.error_m[inside] = off + np.cumsum(made.rng.normal(0, 0.01, np.count_nonzero(inside)))


def exposure(made: Scene) -> None:
    """The sensor averages over 50 to 90 % of its interval and does not say so."""
    made.seen = averaged(made.motion, made.rng.uniform(0.5, 0.9) * float(made.slow_s[1] - made.slow_s[0]))


def logger(made: Scene) -> None:
    """The accelerometer's logger has a low-pass of 5 to 12 Hz, 4th to 8th order."""
    corner, order = made.rng.uniform(5, 12), int(made.rng.choice([4, 6, 8]))
    made.felt = low_passed(made.felt, corner, order)


def tilt(made: Scene) -> None:
    """A tower of 20 to 60 m leans as it moves: gravity reaches the horizontal accelerometer."""
    slope = 1.5 / made.rng.uniform(20, 60)  # slope at the top of a cantilever per displacement there, 1/m
    made.felt = made.motion.passed(lambda s: s**2 - GRAVITY_M_S2 * slope)


def flicker(made: Scene) -> None:
    """The accelerometer has 1/f noise that meets its white noise at 2 to 10 Hz."""
    f = np.fft.rfftfreq(len(made.time_s), 1 / made.rate_hz)
    shape = np.sqrt(made.rng.uniform(2, 10) / np.maximum(f, 1 / made.length_s))
    white = np.fft.rfft(made.rng.normal(0, made.noise_m_s2, len(made.time_s)))
    made.added_m_s2 = np.fft.irfft(white * shape, len(made.time_s))


Change = Callable[[Scene], None]
OBEYING: tuple[Change, ...] = (plain, aliased, train, impulse, drift, gaps, coarse, offset)
BREAKING: tuple[Change, ...] = (gain, axis, colour, step, rain, outliers, rtk, exposure, logger, tilt, flicker)
