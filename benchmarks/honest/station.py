"""An accelerometer on an oscillating structure together with a camera, an infrared camera or a radar."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.honest.frames import BEGIN_S, BETWEEN
from benchmarks.honest.oscillators import Oscillation, Signal, hum
from midspan.records import Floats


@dataclass
class Station:
    """One recording before it is written; a kind changes it in place.

    motion: true displacement; felt: what the accelerometer is made to measure (m/s²); scale: displacement of one pixel
    down the picture (m), or displacement per range for a radar; added_m_s2 (m,): what the accelerometer adds;
    ahead_s (n,): by how much the frames' clock is ahead, besides the offset; true_s (n,): instants of the frames;
    has_scale, has_offset, has_zero: whether there is one true value.
    """

    rng: np.random.Generator
    motion: Oscillation
    frames_hz: float
    scale: float
    length_s: float
    offset_s: float
    noise_m_s2: float = 2e-3
    rate_hz: float = 100.0
    felt: Signal = field(init=False)
    true_s: Floats = field(init=False)
    ahead_s: Floats = field(init=False)
    added_m_s2: Floats = field(init=False)
    has_scale: bool = True
    has_offset: bool = True
    has_zero: bool = True

    def __post_init__(self) -> None:
        self.felt = self.motion.acceleration
        first = BEGIN_S + BETWEEN / self.rate_hz
        count = int((self.length_s - 2 * BEGIN_S) * self.frames_hz)
        self.true_s = first + np.arange(count) / self.frames_hz
        self.ahead_s, self.added_m_s2 = np.zeros(count), np.zeros(len(self.time_s))

    @property
    def time_s(self) -> Floats:
        """The accelerometer's instants (m,)."""
        return np.arange(round(self.length_s * self.rate_hz)) / self.rate_hz

    @property
    def stamps_s(self) -> Floats:
        """The frames' stamps (n,) on their own clock."""
        return self.true_s - self.offset_s + self.ahead_s

    def hums(self) -> None:
        """A machine near the accelerometer's rate, which has no anti-alias filter."""
        self.added_m_s2 = hum(self.rng, self.time_s, rate_hz=self.rate_hz)

    def write_acceleration(self, folder: Path) -> str:
        """Write accel.csv; returns its section of recording.toml."""
        noise = self.rng.normal(0, self.noise_m_s2, len(self.time_s))
        value = self.felt.at(self.time_s) + 0.05 + self.added_m_s2 + noise
        table = np.column_stack((self.time_s, value))
        np.savetxt(folder / "accel.csv", table, "%.9f", ",", header="time_s,accel", comments="")
        return '[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'
