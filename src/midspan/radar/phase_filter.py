"""Unwrapping inside a filter: the wrapped phase corrects a prediction from the accelerometer.

State: range change u (m), its rate v (m/s) and the bias b (m/s²) of the acceleration in the line of sight. Only the
innovation is wrapped, so no speed is too high while the prediction is within a quarter of a wavelength. The prediction
averages over many frames, so it stays right at signal-to-noise ratios and through fades where the last two phases alone
lead astray.
"""

from dataclasses import dataclass

import numpy as np

from midspan import _core
from midspan.checks import positive, same_length
from midspan.records import Floats


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


class PhaseFilter:
    """The filter over blocks of frames; any cutting into blocks gives the same output.

    phase_per_m: rad per m of range. settings: how far the accelerometer is trusted.
    """

    def __init__(self, phase_per_m: float, settings: PhaseFilterSettings | None = None) -> None:
        s = settings or PhaseFilterSettings()
        self._follower = _core.PhaseFollower(
            positive("phase_per_m", phase_per_m, "rad/m"),
            (s.noise_density, s.scale_error, s.time_error_s, s.bias_walk),
            (s.start_speed_m_s, s.start_speed_std_m_s, s.start_bias_m_s2, s.start_inflation),
        )
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
        rows = np.column_stack((np.diff(time, prepend=before), phase, variance, steps))
        found = self._follower.push(rows)
        self._time_s = float(time[-1]) if len(time) else self._time_s
        used, surprise = np.isfinite(found[:, 0]), found[:, 4]
        return Unwrapped(
            phase_rad=found[:, 0] - self._follower.origin,
            variance_rad2=np.where(used, variance, np.inf),
            filtered_m=found[:, 1],
            filtered_variance_m2=found[:, 2],
            restarts=tuple(int(k) for k in np.flatnonzero(found[:, 3])),
            surprise=float(np.nanmean(surprise)) if np.isfinite(surprise).any() else np.nan,
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
