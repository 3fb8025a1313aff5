"""Motions that the papers' tests alone use: sweeps as a shaking table follows them, excitations in turn."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from midspan.records import Floats
from midspan.simulate.motion.motion import Motion, Sines, product, random_motion
from midspan.simulate.motion.sensors import AccelerometerModel

# A force-balance sensor behind a 16-bit converter of some 2 g: one step is 0.6 mm/s².
ACCELEROMETER = AccelerometerModel(rate_hz=100.0, noise_std_m_s2=5e-4, bias_m_s2=0.02)
CAMERA_HZ = 30000 / 1001
Excitation = Callable[[float, np.random.Generator], Motion]  # of its length in s


@dataclass(frozen=True, slots=True)
class Sweep(Motion):
    """A sine whose frequency goes linearly from `start_hz` at time 0 to `stop_hz` at `duration_s`, and on beyond."""

    amplitude_m: float
    start_hz: float
    stop_hz: float
    duration_s: float

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`."""
        slope = 2 * np.pi * (self.stop_hz - self.start_hz) / self.duration_s
        start = 2 * np.pi * self.start_hz
        angle, rate = start * time_s + slope * time_s**2 / 2, start + slope * time_s
        if order == 0:
            return self.amplitude_m * np.sin(angle)
        if order == 1:
            return self.amplitude_m * rate * np.cos(angle)
        return self.amplitude_m * (slope * np.cos(angle) - rate**2 * np.sin(angle))


@dataclass(frozen=True, slots=True)
class TableSweep(Motion):
    """A sweep as a shaking table follows it: beyond `corner_hz` its speed stays and its amplitude falls.

    The amplitude of `sweep` is multiplied by g = 1 / sqrt(1 + (f / corner_hz)²), f being the frequency of the moment.
    """

    sweep: Sweep
    corner_hz: float = 1.0

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`."""
        sweep = self.sweep
        rate = (sweep.stop_hz - sweep.start_hz) / sweep.duration_s / self.corner_hz
        place = sweep.start_hz / self.corner_hz + rate * time_s
        g = 1 / np.sqrt(1 + place**2)
        gain = g, -rate * place * g**3, rate**2 * (3 * place**2 * g**5 - g**3)
        return product(gain, sweep, time_s, order)


@dataclass(frozen=True, slots=True)
class Later(Motion):
    """A motion whose time begins at `start_s`."""

    motion: Motion
    start_s: float

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`."""
        return self.motion.derivative(time_s - self.start_s, order)


def sine(amplitude_m: float, frequency_hz: float) -> Excitation:
    """One sine."""
    return lambda length_s, rng: Sines(np.array([amplitude_m]), np.array([frequency_hz]))


def random(low_hz: float, high_hz: float, std_m: float) -> Excitation:
    """An even spectrum of displacement in a band."""
    return lambda length_s, rng: random_motion((low_hz, high_hz), std_m, rng=rng, lines=120)
