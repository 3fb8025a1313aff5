"""Motions known exactly: displacement, velocity and acceleration in closed form at any time."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from midspan.checks import finite, positive, refuse, same_length
from midspan.records import Floats
from midspan.signals.acceleration import GRAVITY_M_S2


class Motion:
    """A motion of one degree of freedom, known exactly at times (n,) in s; a kind of motion says `derivative`."""

    __slots__ = ()

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """The displacement (n,) in m (order 0), or its exact derivative in m/s (1) or m/s² (2)."""
        raise NotImplementedError

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement (n,) in m at times (n,) in s."""
        return self.derivative(np.asarray(time_s, dtype=np.float64), 0)

    def velocity(self, time_s: Floats) -> Floats:
        """Velocity (n,) in m/s at times (n,) in s."""
        return self.derivative(np.asarray(time_s, dtype=np.float64), 1)

    def acceleration(self, time_s: Floats) -> Floats:
        """Acceleration (n,) in m/s² at times (n,) in s."""
        return self.derivative(np.asarray(time_s, dtype=np.float64), 2)


@dataclass(frozen=True, slots=True)
class Rest(Motion):
    """A structure that does not move, at `value_m`."""

    value_m: float = 0.0

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`."""
        return np.full_like(time_s, self.value_m if order == 0 else 0.0)


class Sines(Motion):
    """A sum of k sines: Σ amplitude_m · sin(2π frequency_hz t + phase_rad), each an array (k,)."""

    __slots__ = ("amplitude_m", "frequency_hz", "phase_rad")

    def __init__(self, amplitude_m: Floats, frequency_hz: Floats, *, phase_rad: Floats | float = 0.0) -> None:
        self.amplitude_m = np.atleast_1d(finite("amplitude_m", amplitude_m))
        self.frequency_hz = np.atleast_1d(finite("frequency_hz", frequency_hz))
        same_length(amplitude_m=self.amplitude_m, frequency_hz=self.frequency_hz)
        self.phase_rad = np.broadcast_to(finite("phase_rad", phase_rad), self.amplitude_m.shape)

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`: each time a quarter turn further on, times omega."""
        omega = 2 * np.pi * self.frequency_hz
        angle = np.multiply.outer(time_s, omega) + self.phase_rad + order * np.pi / 2
        result: Floats = np.sin(angle) @ (self.amplitude_m * omega**order)
        return result


@dataclass(frozen=True, slots=True)
class Pulse(Motion):
    """A smooth pulse, as a vehicle that crosses slowly makes: height_m · exp(-(t - centre_s)² / (2 width_s²)).

    Its spectrum is a Gaussian of standard deviation 1 / (2π width_s) Hz: 0.02 Hz for 8 s.
    """

    height_m: float
    centre_s: float
    width_s: float

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`."""
        place = (time_s - self.centre_s) / self.width_s
        value: Floats = self.height_m * np.exp(-(place**2) / 2)
        if order == 0:
            return value
        return -place * value / self.width_s if order == 1 else (place**2 - 1) * value / self.width_s**2


@dataclass(frozen=True, slots=True)
class Sum(Motion):
    """The sum of several motions."""

    parts: tuple[Motion, ...]

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`."""
        return sum((part.derivative(time_s, order) for part in self.parts), np.zeros(np.shape(time_s)))


@dataclass(frozen=True, slots=True)
class Scaled(Motion):
    """A motion times a factor, `late_s` later; with a factor in rad/m a rotation, in rad."""

    motion: Motion
    factor: float
    late_s: float = 0.0

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`."""
        return self.factor * self.motion.derivative(np.asarray(time_s) - self.late_s, order)


@dataclass(frozen=True, slots=True)
class Leaning(Motion):
    """A sideways motion as an accelerometer meets it whose axis dips by `tilt` (rad) as it moves: gravity is in it."""

    motion: Motion
    tilt: Motion

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`; of the acceleration what the accelerometer reads."""
        own = self.motion.derivative(time_s, order)
        return own - GRAVITY_M_S2 * self.tilt.derivative(time_s, 0) if order == 2 else own


@dataclass(frozen=True, slots=True)
class Window(Motion):
    """A motion that is at rest before `start_s` and after `stop_s`, with a smooth ramp of `ramp_s` inside at each end.

    The ramp has continuous derivatives of every order, so acceleration shows no step where the motion begins.
    """

    motion: Motion
    start_s: float = -np.inf
    stop_s: float = np.inf
    ramp_s: float = 1.0

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`."""
        up = _smooth_step((time_s - self.start_s) / self.ramp_s)
        down = _smooth_step((self.stop_s - time_s) / self.ramp_s)
        gain = up[0] * down[0]
        rate = (up[1] * down[0] - up[0] * down[1]) / self.ramp_s
        bend = (up[2] * down[0] - 2 * up[1] * down[1] + up[0] * down[2]) / self.ramp_s**2
        return product((gain, rate, bend), self.motion, time_s, order)


def product(gain: tuple[Floats, Floats, Floats], motion: Motion, time_s: Floats, order: int) -> Floats:
    """Derivative (n,) of a gain times a motion; gain: (n,) with its first and second derivative in 1/s and 1/s²."""
    value, rate, bend = gain
    moved = motion.derivative(time_s, 0)
    if order == 0:
        return value * moved
    if order == 1:
        return rate * moved + value * motion.derivative(time_s, 1)
    return bend * moved + 2 * rate * motion.derivative(time_s, 1) + value * motion.derivative(time_s, 2)


def _smooth_step(place: Floats) -> tuple[Floats, Floats, Floats]:
    """A step from 0 to 1 over places 0 … 1 and its first two derivatives; every derivative is continuous.

    The step is 1 / (1 + exp(1/p - 1/(1-p))); it is exactly 0 before and 1 after.
    """
    inner = np.clip(place, 1e-3, 1 - 1e-3)  # beyond, the step differs from 0 or 1 by less than exp(-998)
    exponent = np.clip(1 / (1 - inner) - 1 / inner, -700.0, 700.0)
    step = 1 / (1 + np.exp(-exponent))
    first = 1 / inner**2 + 1 / (1 - inner) ** 2
    second = -2 / inner**3 + 2 / (1 - inner) ** 3
    slope = step * (1 - step)
    return (
        np.where(place <= 0, 0.0, np.where(place >= 1, 1.0, step)),
        np.where((place <= 0) | (place >= 1), 0.0, slope * first),
        np.where((place <= 0) | (place >= 1), 0.0, slope * ((1 - 2 * step) * first**2 + second)),
    )


@dataclass(frozen=True, slots=True)
class FineSteps(Motion):
    """A motion known at fine, even steps from `start_s`: displacement, velocity and acceleration, arrays (n,).

    Between the steps it is the quintic that meets all three at both ends, so displacement, velocity and acceleration
    are continuous and derivatives of each other. Outside the steps it is an error.
    """

    start_s: float
    step_s: float
    displacement_m: Floats
    velocity_m_s: Floats
    acceleration_m_s2: Floats

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`."""
        place = (time_s - self.start_s) / self.step_s
        last = len(self.displacement_m) - 1
        if np.any(place < -1e-9) or np.any(place > last + 1e-9):
            raise refuse("time_s", f"within the {last * self.step_s:g} s that were computed", "times outside")
        first = np.clip(np.floor(place + 1e-9).astype(np.int64), 0, last - 1)
        h, u = self.step_s, place - first
        x0, x1 = self.displacement_m[first], self.displacement_m[first + 1]
        v0, v1 = h * self.velocity_m_s[first], h * self.velocity_m_s[first + 1]
        a0, a1 = h * h * self.acceleration_m_s2[first] / 2, h * h * self.acceleration_m_s2[first + 1] / 2
        rise, slope, bend = x1 - x0 - v0 - a0, v1 - v0 - 2 * a0, a1 - a0
        c3 = 10 * rise - 4 * slope + bend
        c4 = -15 * rise + 7 * slope - 2 * bend
        c5 = 6 * rise - 3 * slope + bend
        if order == 0:
            return x0 + u * (v0 + u * (a0 + u * (c3 + u * (c4 + u * c5))))
        if order == 1:
            return (v0 + u * (2 * a0 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))) / h
        return (2 * a0 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5))) / h**2


def random_motion(
    band_hz: tuple[float, float], std_m: float, *, rng: np.random.Generator, lines: int = 60, flat: str = "displacement"
) -> Sines:
    """A stationary random motion in a band, as many sines of random phase at jittered frequencies.

    `std_m` is its standard deviation in m; `flat` says which of displacement, velocity or acceleration has an even
    spectrum over `band_hz` (low, high). A narrow band of a few tenths of a hertz is a mode with slow random modulation.
    The sum repeats no sooner than `lines` / width of the band.
    """
    low, high = band_hz
    positive("std_m", std_m, "m")
    if not 0 <= low < high:
        raise refuse("band_hz", "a pair low < high in Hz", band_hz)
    order = {"displacement": 0, "velocity": 1, "acceleration": 2}.get(flat)
    if order is None:
        raise refuse("flat", "displacement, velocity or acceleration", flat)
    frequency = low + (high - low) * (np.arange(lines) + rng.uniform(0.05, 0.95, lines)) / lines
    weight = frequency**-order
    amplitude = weight * std_m * np.sqrt(2 / np.sum(weight**2))
    return Sines(amplitude, frequency, phase_rad=rng.uniform(0, 2 * np.pi, lines))


def modes(
    *bands: tuple[float, float, float, int], start_s: float, ramp_s: float
) -> Callable[[np.random.Generator], Motion]:
    """A motion to be drawn: the sum of `random_motion` in bands of (low Hz, high Hz, std in m, lines), each a mode that
    comes and goes or a slow sag; at rest before `start_s`.
    """
    return lambda rng: Window(
        Sum(tuple(random_motion((low, high), std_m, rng=rng, lines=n) for low, high, std_m, n in bands)),
        start_s=start_s,
        ramp_s=ramp_s,
    )
