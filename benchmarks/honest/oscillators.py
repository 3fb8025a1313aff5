"""Motions of oscillators under random forces, integrated exactly, and the random courses of a sensor's own error.

The force is linear between its steps, so that the first-order hold is no approximation: displacement and acceleration
are exact at every step. Between the steps both are cubic splines, whose error at 5 Hz is a ten-millionth.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from midspan.records import Floats

STEP_HZ = 400.0
MARGIN_S = 2.0  # before and after a recording, for exposures, clocks and read-out


@dataclass(frozen=True)
class Signal:
    """A signal at every step (n,), from MARGIN_S before a recording on, in its own unit."""

    value: Floats

    @cached_property
    def _spline(self) -> Any:
        from scipy.interpolate import CubicSpline

        return CubicSpline(np.arange(len(self.value)) / STEP_HZ - MARGIN_S, self.value)

    def at(self, time_s: Floats) -> Floats:
        """The signal at times of any shape."""
        return np.asarray(self._spline(time_s))

    @property
    def rms(self) -> float:
        """Root of the mean square about the mean."""
        return float(np.std(self.value))


@dataclass(frozen=True)
class Oscillation:
    """A motion: displacement (m) and its acceleration (m/s²)."""

    displacement: Signal
    acceleration: Signal

    def at(self, time_s: Floats) -> Floats:
        """Displacement in m at times of any shape."""
        return self.displacement.at(time_s)

    @property
    def rms(self) -> float:
        """Standard deviation of the displacement, m."""
        return self.displacement.rms

    def __add__(self, other: "Oscillation") -> "Oscillation":
        return Oscillation(
            Signal(self.displacement.value + other.displacement.value),
            Signal(self.acceleration.value + other.acceleration.value),
        )


def steps(length_s: float) -> int:
    """How many steps a path of a recording of `length_s` has."""
    return int((length_s + 2 * MARGIN_S) * STEP_HZ)


def driven(frequency_hz: float, damping: float, force: Floats) -> tuple[Floats, Floats]:
    """Displacement and velocity (n,) of x" + 2 ζ ω x' + ω² x = force (n,), which is linear between the steps."""
    from scipy.signal import cont2discrete, lfilter, ss2tf

    w = 2 * np.pi * frequency_hz
    dynamics = np.array([[0.0, 1.0], [-w * w, -2 * damping * w]])
    system = (dynamics, np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1)))
    a, b, c, d, _ = cont2discrete(system, 1 / STEP_HZ, method="foh")
    upper, lower = ss2tf(a, b, c, d)
    x, v = (lfilter(one, lower, force) for one in upper)
    return np.asarray(x), np.asarray(v)


def oscillator(
    rng: np.random.Generator, frequency_hz: float, rms: float, *, length_s: float, damping: float = 0.015
) -> Oscillation:
    """A mode under a random force that falls off above four times its frequency, as wind, walkers and traffic do.

    It has swung for five decay times when the recording begins. rms: over the recording.
    """
    from scipy.signal import butter, sosfilt

    count = steps(length_s)
    before = int(5 * STEP_HZ / (2 * np.pi * frequency_hz * damping))
    low_pass = butter(4, 4 * frequency_hz + 1, fs=STEP_HZ, output="sos")
    force = sosfilt(low_pass, rng.normal(size=before + count))
    x, v = driven(frequency_hz, damping, force)
    w = 2 * np.pi * frequency_hz
    a = force - 2 * damping * w * v - w * w * x
    scale = rms / np.std(x[before:])
    return Oscillation(Signal(scale * x[before:]), Signal(scale * a[before:]))


def oscillators(
    rng: np.random.Generator, frequencies_hz: Sequence[float], rms: float, *, length_s: float
) -> Oscillation:
    """Modes together, each of less displacement the higher it is."""
    f = np.asarray(frequencies_hz)
    size = rng.uniform(0.5, 1.0, len(f)) * f[0] / f
    size *= rms / np.sqrt(np.sum(size**2))
    parts = [oscillator(rng, *one, length_s=length_s) for one in zip(f, size, strict=True)]
    return sum(parts[1:], start=parts[0])


def in_band(rng: np.random.Generator, band_hz: tuple[float, float], rms: float, *, length_s: float) -> Oscillation:
    """Two to four modes in a band."""
    edges = np.geomspace(*band_hz, int(rng.integers(2, 5)) + 1)
    return oscillators(rng, rng.uniform(edges[:-1], edges[1:]), rms, length_s=length_s)


def on_a_spring(felt: Signal, frequency_hz: float, damping: float) -> Signal:
    """What an accelerometer measures on a railing of its own resonance whose foot is accelerated by `felt`.

    The railing's bend y obeys y" + 2 ζ ω y' + ω² y = -felt; the accelerometer moves with foot and bend together:
    felt + y" = -(2 ζ ω y' + ω² y), which is felt / (1 - f²/f_r²) far from the resonance.
    """
    y, speed = driven(frequency_hz, damping, -felt.value)
    w = 2 * np.pi * frequency_hz
    return Signal(-(2 * damping * w * speed + w * w * y))


def gauss_markov(rng: np.random.Generator, time_s: Floats, *, std: float, correlation_s: float) -> Floats:
    """A stationary Gauss-Markov process (n,) at increasing times (n,)."""
    keep = np.exp(-np.diff(time_s) / correlation_s)
    path = std * rng.normal(size=len(time_s))
    for k, a in enumerate(keep, start=1):
        path[k] = a * path[k - 1] + np.sqrt(1 - a * a) * path[k]
    return path


def hum(rng: np.random.Generator, time_s: Floats, *, rate_hz: float) -> Floats:
    """What a machine adds to an accelerometer without an anti-alias filter: m/s² (n,) at the sampling instants (n,).

    It shakes with 10 to 200 mm/s² at a multiple of the sampling rate and 0.2 to 5 Hz besides, where its displacement
    is less than a micrometre; its speed follows its load by 0.01 Hz. In the samples it is a narrow line at 0.2 to 5 Hz.
    """
    frequency = rng.integers(1, 3) * rate_hz + rng.choice([-1, 1]) * 10 ** rng.uniform(np.log10(0.2), np.log10(5.0))
    swing = gauss_markov(rng, time_s, std=0.01, correlation_s=20.0)
    turns = frequency * time_s + np.cumsum(swing) / rate_hz
    return np.asarray(10 ** rng.uniform(-2, np.log10(0.2)) * np.sin(2 * np.pi * (turns + rng.uniform())))


def after(time_s: Floats, start_s: float, size: float) -> Floats:
    """A step (n,) of `size` from `start_s` on."""
    return np.where(time_s >= start_s, size, 0.0)
