"""Unwrapping inside a filter: the wrapped phase corrects a prediction from the accelerometer.

State: range change u (m), its rate v (m/s) and the bias b (m/s²) of the acceleration in the line of sight. Only the
innovation is wrapped, so no speed is too high while the prediction is within a quarter of a wavelength. The prediction
averages over many frames, so it stays right at signal-to-noise ratios and through fades where the last two phases alone
lead astray.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from midspan.checks import positive, same_length
from midspan.radar.unwrap import BLIND_RAD, UNSURE_CYCLES
from midspan.records import Floats

U, V, B, P00, P01, P02, P11, P12, P22, MISFIT, SEEN, ENERGY_A, ENERGY_D, MIXED = range(14)
LAST, BEFORE, AGE, LAST_A, ORIGIN, WATCHED = range(14, 20)
STATE_SIZE = 20

# Innovations beyond this many standard deviations get a larger variance instead of a full say.
HUBER = 2.5
# The noise of the acceleration is raised and lowered until innovations are as large as predicted: the logarithm of its
# factor follows their squares over this many frames, each counted at most so often, from the start up to a limit; and
# not above what leaves the prediction this narrow (cycles).
MISFIT_FRAMES, MAX_MISFIT, MAX_INFLATED = 40.0, 9.0, 16.0
# At low signal-to-noise ratio the phase's errors have longer tails than the variance says.
FAIR_MISFIT = 1.5
WIDEST_CYCLES = 0.12
# Memory of the watch on the accelerometer, frames.
WATCH_FRAMES = 100.0
# The accelerometer counts as dead when it explains less than this share of the phase's second differences, while these
# are this many times what noise makes.
DEAD_SHARE, DEAD_EXCESS = 0.1, 3.0


@dataclass(frozen=True, slots=True)
class PhaseFilterSettings:
    """How far the accelerometer is trusted.

    noise_density: of the acceleration in the line of sight, (m/s²)²/Hz; higher trusts the radar more.
    scale_error, time_error_s: relative error of the conversion factor and error of the time offset that the filter
    allows for; higher follows a wrongly calibrated accelerometer, lower rides longer through fades.
    start_inflation: natural logarithm of the factor on all of these at the first frame, estimated from then on; 0 where
    the alignment is known, more where it is not.
    bias_walk: growth of the bias' variance, (m/s²)² a second; start_bias_m_s2: its standard deviation at the first
    frame; start_speed_m_s, start_speed_std_m_s: speed of the range there, and how well it is known.
    """

    noise_density: float = 1e-6
    scale_error: float = 0.02
    time_error_s: float = 1e-3
    bias_walk: float = 1e-8
    start_inflation: float = 4.6
    start_bias_m_s2: float = 0.05
    start_speed_m_s: float = 0.0
    start_speed_std_m_s: float = 0.05


@dataclass(frozen=True, slots=True)
class Unwrapped:
    """Unwrapped phase (n,) in rad since the first frame used, its variance, the filter's range change and its variance.

    phase_rad is NaN where the frame was not used; filtered_m (n,) goes on by the accelerometer. `restarts` are the
    frames from which on the cycle is a guess, because the prediction had become too wide; `surprise` is the mean of log
    variance + squared innovation over variance: the smaller, the better predicted; explained: whether the accelerometer
    accounts for the motion, or there is too little of it for a cycle to be lost.
    """

    phase_rad: Floats
    variance_rad2: Floats
    filtered_m: Floats
    filtered_variance_m2: Floats
    restarts: tuple[int, ...]
    surprise: float = np.nan
    explained: bool = True


@njit(cache=True)
def _wrap(angle):  # type: ignore[no-untyped-def]
    return angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))


@njit(cache=True)
def _watch(s, wrapped_phase, unit, step, dt, variance):  # type: ignore[no-untyped-def]
    """Energy of the accelerometer, of the phase's second difference and their product; returns the acceleration missed.

    The result is the variance (m/s²)² of the true acceleration where the accelerometer turns out to be dead, else zero.
    """
    if s[AGE] >= 2.0:
        step = 0.5 * (step + s[LAST_A])
        s[WATCHED] += 1.0
        # Wrapped about what the accelerometer says, so that a strong motion does not look like another one.
        expected = unit * dt * dt * step
        second = (_wrap(wrapped_phase - 2.0 * s[LAST] + s[BEFORE] - expected) + expected) / (unit * dt * dt)
        keep = 1.0 - 1.0 / min(WATCH_FRAMES, s[WATCHED])
        floor = 6.0 * variance / (unit * dt * dt) ** 2
        s[ENERGY_A] = keep * s[ENERGY_A] + (1.0 - keep) * step * step
        s[ENERGY_D] = keep * s[ENERGY_D] + (1.0 - keep) * (second * second - floor)
        s[MIXED] = keep * s[MIXED] + (1.0 - keep) * second * step
        if s[WATCHED] > 10.0 and s[ENERGY_D] > DEAD_EXCESS * floor:
            share = s[MIXED] * s[MIXED] / max(s[ENERGY_A] * s[ENERGY_D], 1e-300)
            if share < DEAD_SHARE or s[MIXED] < 0.0:
                return s[ENERGY_D]
    return 0.0


@njit(cache=True)
def _advance(s, dt, steps, noise, dead):  # type: ignore[no-untyped-def]
    """Predict over `dt`: noise = (density, bias walk, variance of the acceleration's error over the step)."""
    dv, du = (0.0, 0.0) if dead > 0.0 else (steps[0], steps[1])
    bias = 0.0 if dead > 0.0 else s[B]
    half = 0.5 * dt * dt
    s[U] += dt * s[V] + du - half * bias
    s[V] += dv - dt * bias
    p01, p02, p11, p12, p22 = s[P01], s[P02], s[P11], s[P12], s[P22]
    m00 = s[P00] + dt * p01 - half * p02
    m01 = p01 + dt * p11 - half * p12
    m02 = p02 + dt * p12 - half * p22
    m11, m12 = p11 - dt * p12, p12 - dt * p22
    held = noise[2] + dead
    s[P00] = m00 + dt * m01 - half * m02 + noise[0] * dt * dt * dt / 3.0 + held * half * half
    s[P01] = m01 - dt * m02 + noise[0] * half + held * half * dt
    s[P02] = m02
    s[P11] = m11 - dt * m12 + noise[0] * dt + held * dt * dt
    s[P12] = m12
    s[P22] = p22 + noise[1] * dt


@njit(cache=True)
def _meet(s, innovation, variance):  # type: ignore[no-untyped-def]
    """Correct the state by an innovation (m) of given variance, far ones with a larger one; returns the misfit."""
    total = s[P00] + variance
    misfit = innovation * innovation / total
    if misfit > HUBER * HUBER:
        variance += abs(innovation) / HUBER * np.sqrt(total) - total
        total = s[P00] + variance
    k0, k1, k2 = s[P00] / total, s[P01] / total, s[P02] / total
    s[U] += k0 * innovation
    s[V] += k1 * innovation
    s[B] += k2 * innovation
    p00, p01, p02 = s[P00], s[P01], s[P02]
    rest = 1.0 - k0
    s[P00] = rest * rest * p00 + k0 * k0 * variance
    s[P01] = rest * (p01 - k1 * p00) + k0 * k1 * variance
    s[P02] = rest * (p02 - k2 * p00) + k0 * k2 * variance
    s[P11] += k1 * k1 * total - 2.0 * k1 * p01
    s[P12] += k1 * k2 * total - k1 * p02 - k2 * p01
    s[P22] += k2 * k2 * total - 2.0 * k2 * p02
    return misfit


@njit(cache=True)
def _begin(s, phase, variance, unit, usable):  # type: ignore[no-untyped-def]
    """The first usable frame is the zero of the range change."""
    if usable:
        s[SEEN], s[ORIGIN], s[LAST], s[BEFORE], s[AGE] = 1.0, phase, phase, phase, 1.0
        s[P00] = variance / (unit * unit)


@njit(cache=True)
def _run(s, rows, steps, unit, limits, out):  # type: ignore[no-untyped-def]
    """rows: time step, phase, variance; out: phase, filtered, variance, 1 used (2: cycle lost), surprise."""
    density, scale, delay, walk = limits
    for k in range(len(rows)):
        dt, phase, variance = rows[k]
        usable = np.isfinite(phase) and variance < BLIND_RAD * BLIND_RAD
        out[k, 0], out[k, 3], out[k, 4] = np.nan, 0.0, np.nan
        if s[SEEN] == 0.0:
            _begin(s, phase, variance, unit, usable)
            if usable:
                out[k, 0], out[k, 3] = phase, 1.0
            out[k, 1], out[k, 2] = 0.0, s[P00]
            continue
        missed = (scale * steps[k, 2]) ** 2 + (delay * steps[k, 3]) ** 2
        inflated = np.exp(s[MISFIT]) if usable else 1.0
        dead = _watch(s, phase, unit, steps[k, 2] - s[B], dt, variance) if usable else 0.0
        _advance(s, dt, steps[k], (density * inflated, walk, missed * inflated), dead)
        s[LAST_A] = steps[k, 2] - s[B]
        if usable:
            predicted = unit * s[U] + s[ORIGIN]
            difference = _wrap(phase - predicted)
            # The first frames, whose speed is not known yet, are no return from an outage.
            lost = s[WATCHED] > 3.0 and np.sqrt(s[P00]) > UNSURE_CYCLES * 2.0 * np.pi / unit
            spread = s[P00] + variance / (unit * unit)
            misfit = _meet(s, difference / unit, variance / (unit * unit))
            if misfit < 1.0 or np.sqrt(s[P00]) < WIDEST_CYCLES * 2.0 * np.pi / unit:
                rise = (min(misfit, MAX_MISFIT) - FAIR_MISFIT) / MISFIT_FRAMES
                s[MISFIT] = min(max(s[MISFIT] + rise, 0.0), MAX_INFLATED)
            out[k, 4] = np.log(spread) + misfit
            s[BEFORE], s[LAST], s[AGE] = s[LAST], phase, s[AGE] + 1.0
            out[k, 0], out[k, 3] = predicted + difference, 2.0 if lost else 1.0
        else:
            s[AGE] = 0.0
        out[k, 1], out[k, 2] = s[U], s[P00]


class PhaseFilter:
    """The filter over blocks of frames; any cutting into blocks gives the same output.

    phase_per_m: rad per m of range. settings: how far the accelerometer is trusted.
    """

    def __init__(self, phase_per_m: float, settings: PhaseFilterSettings | None = None) -> None:
        self._unit = positive("phase_per_m", phase_per_m, "rad/m")
        self._settings = settings or PhaseFilterSettings()
        self._state = np.zeros(STATE_SIZE)
        self._state[V] = self._settings.start_speed_m_s
        self._state[[P11, P22]] = self._settings.start_speed_std_m_s**2, self._settings.start_bias_m_s2**2
        self._state[MISFIT] = self._settings.start_inflation
        self._time_s: float | None = None

    def push(self, frame_s: Floats, phase_rad: Floats, variance_rad2: Floats, steps: Floats) -> Unwrapped:
        """Unwrap the phases (n,) of frames at `frame_s` (n,), s, on the accelerometer's clock.

        phase_rad: wrapped, NaN where there is none; variance_rad2: of each, half the inverse signal-to-noise ratio;
        steps (n, 4): of `inertial_steps` in the line of sight, the first row being the step to the first of these.
        """
        time = np.asarray(frame_s, dtype=np.float64)
        phase, variance = np.asarray(phase_rad, dtype=np.float64), np.asarray(variance_rad2, dtype=np.float64)
        same_length(frame_s=time, phase_rad=phase, variance_rad2=variance, steps=steps)
        before = time[:1] if self._time_s is None else np.array([self._time_s])
        rows = np.column_stack((np.diff(time, prepend=before), phase, variance))
        out = np.empty((len(time), 5))
        s = self._settings
        limits = (s.noise_density, s.scale_error, s.time_error_s, s.bias_walk)
        _run(self._state, rows, np.ascontiguousarray(steps), self._unit, limits, out)
        self._time_s = float(time[-1]) if len(time) else self._time_s
        return self._told(out, variance)

    def _told(self, out: Floats, variance: Floats) -> Unwrapped:
        used = out[:, 3] > 0
        return Unwrapped(
            phase_rad=out[:, 0] - self._state[ORIGIN],
            variance_rad2=np.where(used, variance, np.inf),
            filtered_m=out[:, 1],
            filtered_variance_m2=out[:, 2],
            restarts=tuple(int(k) for k in np.flatnonzero(out[:, 3] == 2.0)),
            surprise=float(np.nanmean(out[:, 4])) if np.isfinite(out[:, 4]).any() else np.nan,
        )


def unwrap_filtered(
    frame_s: Floats,
    phase_rad: Floats,
    *,
    variance_rad2: Floats,
    steps: Floats,
    phase_per_m: float,
    settings: PhaseFilterSettings | None = None,
) -> Unwrapped:
    """Unwrap a whole record (n,) with a `PhaseFilter`; the arguments are those of its `push`."""
    return PhaseFilter(phase_per_m, settings).push(frame_s, phase_rad, variance_rad2, steps)
