"""Motions known exactly: displacement, velocity and acceleration in closed form at any time."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from midspan.checks import finite, positive, refuse, same_length
from midspan.records import Floats


class Motion(Protocol):
    """A motion of one degree of freedom; each method takes times (n,) in s and returns an array (n,)."""

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement (n,) in m."""

    def velocity(self, time_s: Floats) -> Floats:
        """Velocity (n,) in m/s, the exact derivative of the displacement."""

    def acceleration(self, time_s: Floats) -> Floats:
        """Acceleration (n,) in m/s², the exact derivative of the velocity."""


@dataclass(frozen=True, slots=True)
class Rest:
    """A structure that does not move, at `value_m`."""

    value_m: float = 0.0

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement (n,) in m at times (n,) in s."""
        return np.full_like(np.asarray(time_s, dtype=np.float64), self.value_m)

    def velocity(self, time_s: Floats) -> Floats:
        """Velocity (n,) in m/s at times (n,) in s."""
        return np.zeros_like(np.asarray(time_s, dtype=np.float64))

    def acceleration(self, time_s: Floats) -> Floats:
        """Acceleration (n,) in m/s² at times (n,) in s."""
        return np.zeros_like(np.asarray(time_s, dtype=np.float64))


class Sines:
    """A sum of k sines: Σ amplitude_m · sin(2π frequency_hz t + phase_rad), each an array (k,)."""

    __slots__ = ("amplitude_m", "frequency_hz", "phase_rad")

    def __init__(self, amplitude_m: Floats, frequency_hz: Floats, *, phase_rad: Floats | float = 0.0) -> None:
        self.amplitude_m = np.atleast_1d(finite("amplitude_m", amplitude_m))
        self.frequency_hz = np.atleast_1d(finite("frequency_hz", frequency_hz))
        same_length(amplitude_m=self.amplitude_m, frequency_hz=self.frequency_hz)
        self.phase_rad = np.broadcast_to(finite("phase_rad", phase_rad), self.amplitude_m.shape)

    def _sum(self, time_s: Floats, order: int) -> Floats:
        # The n-th derivative of a sine is the sine a quarter turn further on, n times, times omega to the n.
        omega = 2 * np.pi * self.frequency_hz
        angle = np.multiply.outer(np.asarray(time_s, dtype=np.float64), omega) + self.phase_rad + order * np.pi / 2
        result: Floats = np.sin(angle) @ (self.amplitude_m * omega**order)
        return result

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement (n,) in m at times (n,) in s."""
        return self._sum(time_s, 0)

    def velocity(self, time_s: Floats) -> Floats:
        """Velocity (n,) in m/s at times (n,) in s."""
        return self._sum(time_s, 1)

    def acceleration(self, time_s: Floats) -> Floats:
        """Acceleration (n,) in m/s² at times (n,) in s."""
        return self._sum(time_s, 2)


@dataclass(frozen=True, slots=True)
class Sweep:
    """A sine whose frequency goes linearly from `start_hz` at time 0 to `stop_hz` at `duration_s`, and on beyond."""

    amplitude_m: float
    start_hz: float
    stop_hz: float
    duration_s: float

    def _angle(self, time_s: Floats) -> tuple[Floats, Floats, float]:
        """The angle in rad, its rate in rad/s and the rate's own rate in rad/s²."""
        time = np.asarray(time_s, dtype=np.float64)
        slope = 2 * np.pi * (self.stop_hz - self.start_hz) / self.duration_s
        start = 2 * np.pi * self.start_hz
        return start * time + slope * time**2 / 2, start + slope * time, slope

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement (n,) in m at times (n,) in s."""
        return self.amplitude_m * np.sin(self._angle(time_s)[0])

    def velocity(self, time_s: Floats) -> Floats:
        """Velocity (n,) in m/s at times (n,) in s."""
        angle, rate, _ = self._angle(time_s)
        return self.amplitude_m * rate * np.cos(angle)

    def acceleration(self, time_s: Floats) -> Floats:
        """Acceleration (n,) in m/s² at times (n,) in s."""
        angle, rate, slope = self._angle(time_s)
        return self.amplitude_m * (slope * np.cos(angle) - rate**2 * np.sin(angle))


@dataclass(frozen=True, slots=True)
class Pulse:
    """A smooth pulse, as a vehicle that crosses slowly makes: height_m · exp(-(t - centre_s)² / (2 width_s²)).

    Its spectrum is a Gaussian of standard deviation 1 / (2π width_s) Hz: 0.02 Hz for 8 s.
    """

    height_m: float
    centre_s: float
    width_s: float

    def _shape(self, time_s: Floats) -> tuple[Floats, Floats]:
        place = (np.asarray(time_s, dtype=np.float64) - self.centre_s) / self.width_s
        return place, self.height_m * np.exp(-(place**2) / 2)

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement (n,) in m at times (n,) in s."""
        return self._shape(time_s)[1]

    def velocity(self, time_s: Floats) -> Floats:
        """Velocity (n,) in m/s at times (n,) in s."""
        place, value = self._shape(time_s)
        return -place * value / self.width_s

    def acceleration(self, time_s: Floats) -> Floats:
        """Acceleration (n,) in m/s² at times (n,) in s."""
        place, value = self._shape(time_s)
        return (place**2 - 1) * value / self.width_s**2


@dataclass(frozen=True, slots=True)
class Later:
    """A motion whose time begins at `start_s`."""

    motion: Motion
    start_s: float

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement (n,) in m at times (n,) in s."""
        return self.motion.displacement(np.asarray(time_s) - self.start_s)

    def velocity(self, time_s: Floats) -> Floats:
        """Velocity (n,) in m/s at times (n,) in s."""
        return self.motion.velocity(np.asarray(time_s) - self.start_s)

    def acceleration(self, time_s: Floats) -> Floats:
        """Acceleration (n,) in m/s² at times (n,) in s."""
        return self.motion.acceleration(np.asarray(time_s) - self.start_s)


@dataclass(frozen=True, slots=True)
class Sum:
    """The sum of several motions."""

    parts: tuple[Motion, ...]

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement (n,) in m at times (n,) in s."""
        return sum((part.displacement(time_s) for part in self.parts), np.zeros(np.shape(time_s)))

    def velocity(self, time_s: Floats) -> Floats:
        """Velocity (n,) in m/s at times (n,) in s."""
        return sum((part.velocity(time_s) for part in self.parts), np.zeros(np.shape(time_s)))

    def acceleration(self, time_s: Floats) -> Floats:
        """Acceleration (n,) in m/s² at times (n,) in s."""
        return sum((part.acceleration(time_s) for part in self.parts), np.zeros(np.shape(time_s)))


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
class Window:
    """A motion that is at rest before `start_s` and after `stop_s`, with a smooth ramp of `ramp_s` inside at each end.

    The ramp has continuous derivatives of every order, so acceleration shows no step where the motion begins.
    """

    motion: Motion
    start_s: float = -np.inf
    stop_s: float = np.inf
    ramp_s: float = 1.0

    def _gain(self, time_s: Floats) -> tuple[Floats, Floats, Floats]:
        """The window and its first two derivatives in 1, 1/s and 1/s²."""
        time = np.asarray(time_s, dtype=np.float64)
        up = _smooth_step((time - self.start_s) / self.ramp_s)
        down = _smooth_step((self.stop_s - time) / self.ramp_s)
        rate = (up[1] * down[0] - up[0] * down[1]) / self.ramp_s
        bend = (up[2] * down[0] - 2 * up[1] * down[1] + up[0] * down[2]) / self.ramp_s**2
        return up[0] * down[0], rate, bend

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement (n,) in m at times (n,) in s."""
        return self._gain(time_s)[0] * self.motion.displacement(time_s)

    def velocity(self, time_s: Floats) -> Floats:
        """Velocity (n,) in m/s at times (n,) in s."""
        gain, rate, _ = self._gain(time_s)
        return rate * self.motion.displacement(time_s) + gain * self.motion.velocity(time_s)

    def acceleration(self, time_s: Floats) -> Floats:
        """Acceleration (n,) in m/s² at times (n,) in s."""
        gain, rate, bend = self._gain(time_s)
        moved = bend * self.motion.displacement(time_s) + 2 * rate * self.motion.velocity(time_s)
        return moved + gain * self.motion.acceleration(time_s)


@dataclass(frozen=True, slots=True)
class FineSteps:
    """A motion known at fine, even steps from `start_s`: displacement, velocity and acceleration, arrays (n,).

    Between the steps it is the quintic that meets all three at both ends, so displacement, velocity and acceleration
    are continuous and derivatives of each other. Outside the steps it is an error.
    """

    start_s: float
    step_s: float
    displacement_m: Floats
    velocity_m_s: Floats
    acceleration_m_s2: Floats

    def _quintic(self, time_s: Floats) -> tuple[Floats, list[Floats]]:
        """Place (n,) within each step in 0 … 1 and the six coefficients of the quintic in it, lowest first."""
        place = (np.asarray(time_s, dtype=np.float64) - self.start_s) / self.step_s
        last = len(self.displacement_m) - 1
        if np.any(place < -1e-9) or np.any(place > last + 1e-9):
            raise refuse("time_s", f"within the {last * self.step_s:g} s that were computed", "times outside")
        first = np.clip(np.floor(place + 1e-9).astype(np.int64), 0, last - 1)
        h = self.step_s
        x0, x1 = self.displacement_m[first], self.displacement_m[first + 1]
        v0, v1 = h * self.velocity_m_s[first], h * self.velocity_m_s[first + 1]
        a0, a1 = h * h * self.acceleration_m_s2[first] / 2, h * h * self.acceleration_m_s2[first + 1] / 2
        rise, slope, bend = x1 - x0 - v0 - a0, v1 - v0 - 2 * a0, a1 - a0
        cubic = 10 * rise - 4 * slope + bend
        quartic = -15 * rise + 7 * slope - 2 * bend
        return place - first, [x0, v0, a0, cubic, quartic, 6 * rise - 3 * slope + bend]

    def displacement(self, time_s: Floats) -> Floats:
        """Displacement (n,) in m at times (n,) in s."""
        u, c = self._quintic(time_s)
        return c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))))

    def velocity(self, time_s: Floats) -> Floats:
        """Velocity (n,) in m/s at times (n,) in s."""
        u, c = self._quintic(time_s)
        return (c[1] + u * (2 * c[2] + u * (3 * c[3] + u * (4 * c[4] + u * 5 * c[5])))) / self.step_s

    def acceleration(self, time_s: Floats) -> Floats:
        """Acceleration (n,) in m/s² at times (n,) in s."""
        u, c = self._quintic(time_s)
        return (2 * c[2] + u * (6 * c[3] + u * (12 * c[4] + u * 20 * c[5]))) / self.step_s**2


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
