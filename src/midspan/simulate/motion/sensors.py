"""Sensors that look at a known motion: sampling, time stamps, noise, bias, drift and clipping."""

from dataclasses import dataclass

import numpy as np

from midspan.checks import finite, positive
from midspan.records import Floats, TimeSeries, nanoseconds
from midspan.simulate.motion.motion import Motion

# The five-point Gauss-Legendre rule on -1 … 1: exact for a polynomial of degree 9 over an exposure.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


def noise_std_for(signal: Floats, snr_db: float) -> float:
    """Standard deviation of the white noise that gives `signal` (n,) a signal-to-noise ratio of `snr_db` decibels.

    The signal's power is its mean square, mean included; the result has the unit of the signal.
    """
    values = finite("signal", signal)
    return float(np.sqrt(np.mean(values**2)) * 10 ** (-snr_db / 20))


def exposed(motion: Motion, centre_s: Floats, *, exposure_s: float) -> Floats:
    """Displacement in m averaged over exposures of `exposure_s` around the times (…,) `centre_s`, same shape."""
    if exposure_s == 0.0:
        return motion.displacement(centre_s)
    moments = np.asarray(centre_s)[..., None] + _NODES * exposure_s / 2
    result: Floats = motion.displacement(moments) @ (_WEIGHTS / 2)
    return result


def _instants(
    rate_hz: float, span_s: tuple[float, float], jitter_s: float, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """The even grid in s from the start of the span up to, not including, its end; when samples are really taken."""
    positive("rate_hz", rate_hz, "Hz")
    count = int(np.ceil((span_s[1] - span_s[0]) * rate_hz - 1e-6))
    grid = span_s[0] + np.arange(count) / rate_hz
    return grid, grid + jitter_s * rng.standard_normal(count) if jitter_s else grid


def frame_stamps(duration_s: float, rate_hz: float, start_s: float, time_offset_s: float) -> Floats:
    """Stamps (n,) in s on a camera's own clock of the frames of a recording that lasts `duration_s` of true time.

    The last tenth of a second is left to the accelerometer, so that an exposure never ends after it.
    """
    usable = duration_s - 0.1 - time_offset_s - start_s
    return start_s + np.arange(int(usable * rate_hz) + 1) / rate_hz


def stepped(stamps_s: Floats, true_s: Floats, clock_step: tuple[float, float]) -> Floats:
    """Stamps (n,) of true times (n,), s, of a clock that is set at a true time by so much (both s)."""
    at_s, step_s = clock_step
    return np.asarray(stamps_s + np.where(true_s >= at_s, step_s, 0.0))


@dataclass(frozen=True, slots=True)
class AccelerometerModel:
    """An accelerometer whose clock is the true time.

    `noise_std_m_s2` is white, per sample; `drift_m_s2_per_root_s` a random walk; `jitter_s` the standard deviation of
    the sampling instants about the even grid, stamped truly or, with `nominal_stamps`, with the grid; its stamps are
    rounded to `stamp_step_s`, where that is not 0.
    """

    rate_hz: float = 100.0
    noise_std_m_s2: float = 0.0
    bias_m_s2: float = 0.0
    drift_m_s2_per_root_s: float = 0.0
    jitter_s: float = 0.0
    nominal_stamps: bool = False
    clip_m_s2: float = np.inf
    stamp_step_s: float = 0.0

    def measure(self, motion: Motion, span_s: tuple[float, float], *, rng: np.random.Generator) -> TimeSeries:
        """What it reads of `motion` over `span_s` (start, end) in s: m/s²."""
        grid, taken = _instants(self.rate_hz, span_s, self.jitter_s, rng)
        drift = np.cumsum(rng.standard_normal(len(grid))) * self.drift_m_s2_per_root_s / np.sqrt(self.rate_hz)
        noise = self.noise_std_m_s2 * rng.standard_normal(len(grid))
        value = motion.acceleration(taken) + self.bias_m_s2 + drift + noise
        clipped = np.clip(value, -self.clip_m_s2, self.clip_m_s2)
        stamps = grid if self.nominal_stamps else taken
        if self.stamp_step_s:
            stamps = np.rint(stamps / self.stamp_step_s) * self.stamp_step_s
        return TimeSeries(nanoseconds(stamps), clipped, "acceleration", "m/s^2")


@dataclass(frozen=True, slots=True)
class DisplacementSensorModel:
    """A sensor of displacement on its own clock: time on the accelerometer's clock = its own + `time_offset_s`.

    `noise_std_m` is white, per sample. With `exposure_s` it averages, stamped at the middle.
    """

    rate_hz: float = 10.0
    noise_std_m: float = 0.0
    time_offset_s: float = 0.0
    exposure_s: float = 0.0

    def measure(self, motion: Motion, span_s: tuple[float, float], *, rng: np.random.Generator) -> TimeSeries:
        """What it reads of `motion` over `span_s` (start, end) in s of the true time: m, stamped on its own clock."""
        grid, _ = _instants(self.rate_hz, span_s, 0.0, rng)
        value = exposed(motion, grid, exposure_s=self.exposure_s) + self.noise_std_m * rng.standard_normal(len(grid))
        return TimeSeries(nanoseconds(grid - self.time_offset_s), value, "displacement", "m")


@dataclass(frozen=True, slots=True)
class Pair:
    """An accelerometer and a displacement sensor on one motion, with the truth at the accelerometer's stamps.

    `acceleration` is on the accelerometer's clock, `displacement` on its own; `true_displacement_m` and
    `true_velocity_m_s` are (n,) like the acceleration; `motion` gives the truth anywhere else.
    """

    acceleration: TimeSeries
    displacement: TimeSeries
    true_displacement_m: Floats
    true_velocity_m_s: Floats
    motion: Motion


def simulate_pair(
    motion: Motion,
    duration_s: float,
    *,
    accelerometer: AccelerometerModel,
    displacement: DisplacementSensorModel,
    seed: int = 0,
) -> Pair:
    """Both sensors on `motion` from time 0 for `duration_s`, with seeded noise. Returns a `Pair`, all SI."""
    span = (0.0, positive("duration_s", duration_s, "s"))
    accelerometer_rng, displacement_rng = np.random.default_rng(seed).spawn(2)
    acceleration = accelerometer.measure(motion, span, rng=accelerometer_rng)
    measured = displacement.measure(motion, span, rng=displacement_rng)
    time = acceleration.time_ns / 1e9
    return Pair(acceleration, measured, motion.displacement(time), motion.velocity(time), motion)
