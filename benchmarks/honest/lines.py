"""Motions as sums of sines: every linear sensor (derivative, exposure, low-pass, tilt) is a factor on each sine."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats

Complex = NDArray[np.complex128]
GRAVITY_M_S2 = 9.80665
ROWS_AT_A_TIME = 2000  # bounds the memory: 2000 instants times 2000 sines are 32 MB


@dataclass(frozen=True)
class Lines:
    """x(t) = Re Σ c exp(jωt): complex amplitudes (k,) in the signal's unit, frequencies (k,) in Hz."""

    amplitude: Complex
    frequency_hz: Floats

    @property
    def omega(self) -> Floats:
        """Angular frequencies (k,) in rad/s."""
        return np.asarray(2 * np.pi * self.frequency_hz)

    def passed(self, response: Callable[[Complex], Complex | Floats | complex]) -> "Lines":
        """The signal behind a linear system of complex `response` at s = jω (k,)."""
        return Lines(np.asarray(self.amplitude * response(1j * self.omega)), self.frequency_hz)

    def __add__(self, other: "Lines") -> "Lines":
        both = (self.amplitude, other.amplitude), (self.frequency_hz, other.frequency_hz)
        return Lines(np.concatenate(both[0]), np.concatenate(both[1]))

    def at(self, time_s: Floats) -> Floats:
        """The signal (n,) at the times (n,)."""
        parts = np.array_split(time_s, len(time_s) // ROWS_AT_A_TIME + 1)
        size, phase = np.abs(self.amplitude), np.angle(self.amplitude)
        return np.concatenate([np.cos(np.multiply.outer(part, self.omega) + phase) @ size for part in parts])

    @property
    def rms(self) -> float:
        """Root of the mean square over a long time."""
        return float(np.sqrt(np.sum(np.abs(self.amplitude) ** 2) / 2))


def acceleration(motion: Lines) -> Lines:
    """The second derivative."""
    return motion.passed(lambda s: s**2)


def averaged(motion: Lines, exposure_s: float) -> Lines:
    """The mean over an exposure around each instant."""
    return motion.passed(lambda s: np.sinc(s.imag * exposure_s / (2 * np.pi)))


def low_passed(signal: Lines, corner_hz: float, order: int) -> Lines:
    """Behind an analogue Butterworth low-pass."""
    poles = butterworth(corner_hz, order)
    return signal.passed(lambda s: np.prod(-poles / (s[:, None] - poles), axis=1))


def butterworth(corner_hz: float, order: int) -> Complex:
    """Its poles (order,) in rad/s; its delay at low frequencies is the sum of -1/pole."""
    angle = np.pi * (2 * np.arange(1, order + 1) + order - 1) / (2 * order)
    return np.asarray(2 * np.pi * corner_hz * np.exp(1j * angle))


def mode(rng: np.random.Generator, frequency_hz: float, rms_m: float, *, length_s: float) -> Lines:
    """A mode with 1 % of damping under random force: sines under its resonance, which never repeat in `length_s`."""
    width = 0.04 * frequency_hz + 0.02
    count = int(2 * width * length_s) + 12
    f = frequency_hz + width * (2 * (np.arange(count) + rng.uniform(0.1, 0.9, count)) / count - 1)
    gain = 1 / np.abs(frequency_hz**2 - f**2 + 2j * 0.01 * frequency_hz * f)
    c = gain * (rng.normal(size=count) + 1j * rng.normal(size=count))
    return Lines(c * rms_m * np.sqrt(2 / np.sum(np.abs(c) ** 2)), f)


def modes(rng: np.random.Generator, band_hz: tuple[float, float], rms_m: float, *, length_s: float) -> Lines:
    """Two to four modes in a band, each of less displacement the higher it is."""
    count = int(rng.integers(2, 5))
    edges = np.geomspace(*band_hz, count + 1)
    f = rng.uniform(edges[:-1], edges[1:])
    size = rng.uniform(0.5, 1.0, count) * (f / f[0]) ** -1.0
    size *= rms_m / np.sqrt(np.sum(size**2))
    found = mode(rng, f[0], size[0], length_s=length_s)
    for frequency, rms in zip(f[1:], size[1:], strict=True):
        found = found + mode(rng, frequency, rms, length_s=length_s)
    return found


def events(spectrum: Callable[[Floats], Complex], at_s: Floats, *, highest_hz: float, period_s: float) -> Lines:
    """One event at each instant (m,), of Fourier transform `spectrum` (m s) at frequencies (k,): a Fourier series.

    Mean and all that repeats after `period_s` belong to it, so the period is chosen longer than the recording.
    """
    f = np.arange(1, int(highest_hz * period_s)) / period_s
    turns = np.exp(-2j * np.pi * np.multiply.outer(f, at_s)).sum(axis=1)
    return Lines(spectrum(f) * turns * 2 / period_s, f)


def ringing(frequency_hz: float, damping: float, push_m_s: float) -> Callable[[Floats], Complex]:
    """Fourier transform of an oscillator after a soft push (a Gaussian of 40 ms) that gives it `push_m_s`."""
    w0 = 2 * np.pi * frequency_hz

    def spectrum(f: Floats) -> Complex:
        w = 2 * np.pi * f
        soft = np.exp(-((0.04 * w) ** 2) / 2)
        return np.asarray(push_m_s * soft / (w0**2 - w**2 + 2j * damping * w0 * w))

    return spectrum


def passing(depth_m: float, width_s: float) -> Callable[[Floats], Complex]:
    """Fourier transform of a smooth sag while something heavy passes: a Gaussian of standard deviation `width_s`."""
    return lambda f: np.asarray(depth_m * width_s * np.sqrt(2 * np.pi) * np.exp(-((2 * np.pi * f * width_s) ** 2) / 2))
