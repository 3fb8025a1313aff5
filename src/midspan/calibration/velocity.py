"""A velocity sensor and an accelerometer: noise, clock offset and sign.

Acceleration integrated is the velocity but for a bias that drifts. Both are compared without their running means, which
the integration's drift is in; sampled at the same instants, both lose the same motion with them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from midspan.calibration.sensors.auxiliary import AuxiliaryCalibration
from midspan.errors import DataError, UntrustedError
from midspan.records import Floats, TimeOffset, TimeSeries, seconds
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.medians import SIGMA_OF_MEDIAN

# Length of the running mean, s: below its inverse the acceleration's drift exceeds a vibrometer's.
MEAN_S = 2.0
# Fewer values tell nothing.
MIN_VALUES = 50
# The velocity must be the integrated acceleration to this share, and as certain as this many standard deviations.
MAX_GAIN, CERTAIN = 0.2, 5.0
# A vibrometer's zero drifts by this share of its noise in a second, as a random walk.
WALK_SHARE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class _Sampled:
    """A velocity and the integrated acceleration (n,) at its instants."""

    measured: Floats
    integrated: Floats

    @property
    def turned(self) -> "_Sampled":
        """The same with the measured velocity's sign changed."""
        return _Sampled(-self.measured, self.integrated)

    @property
    def gain(self) -> tuple[float, float]:
        """The measured velocity over the integrated one, and its standard deviation."""
        power = float(self.integrated @ self.integrated)
        gain = float(self.integrated @ self.measured) / power
        left = self.measured - gain * self.integrated
        return gain, float(np.sqrt(left @ left / len(left) / power))


def fit_velocity(
    prepared: PreparedAcceleration, series: TimeSeries, *, max_offset_s: float, noise_std: float | None = None
) -> AuxiliaryCalibration:
    """Calibrate a velocity sensor, whose unit is taken as right; max_offset_s: of its clock; noise_std: as given, m/s.

    Raises UntrustedError where its velocity is not that of the accelerometer, DataError for too few values.
    """
    origin_ns = int(prepared.time_ns[0])
    felt_s = seconds(prepared.time_ns, origin_ns)
    acceleration = prepared.value_m_s2 - np.mean(prepared.value_m_s2)
    steps = 0.5 * (acceleration[1:] + acceleration[:-1]) * np.diff(felt_s)
    velocity = np.concatenate(([0.0], np.cumsum(steps)))
    time_s = seconds(series.time_ns, origin_ns)
    inner = (time_s > felt_s[0] + max_offset_s) & (time_s < felt_s[-1] - max_offset_s) & np.isfinite(series.value)
    if np.count_nonzero(inner) < MIN_VALUES:
        raise DataError(
            f"velocity: {np.count_nonzero(inner)} values lie within the accelerometer's record; at least {MIN_VALUES} "
            "are needed. Check the times of both files and velocity.start_s."
        )
    time_s, value = time_s[inner], series.value[inner]
    width = max(round(MEAN_S / float(np.median(np.diff(time_s)))), 3)

    def at(offset_s: float) -> _Sampled:
        return _Sampled(_lively(value, width), _lively(np.interp(time_s + offset_s, felt_s, velocity), width))

    step_s = float(np.median(np.diff(felt_s)))
    offset_s, offset_std_s, left = _offset(at, max_offset_s, step_s)
    turned = _offset(lambda offset_s: at(offset_s).turned, max_offset_s, step_s)
    if turned[2] < left:
        raise UntrustedError(
            "velocity: it is opposite to the integrated acceleration. Positive is the accelerometer's positive "
            "direction: change the sign of its values, or of the accelerometer's."
        )
    found = at(offset_s)
    gain, gain_std = found.gain
    if abs(gain - 1.0) > max(MAX_GAIN, CERTAIN * gain_std) or gain_std > MAX_GAIN:
        raise UntrustedError(
            f"velocity: it is {gain:.3g} ± {gain_std:.2g} times the integrated acceleration (clock offset "
            f"{offset_s:+.3g} s); 1 is expected. Check velocity.unit, and that both files are of the same event and "
            "direction."
        )
    # From value to value the integrated acceleration hardly drifts.
    steps = np.diff(found.measured - found.integrated)
    noise = noise_std or float(SIGMA_OF_MEDIAN * np.median(np.abs(steps)) / np.sqrt(2.0))
    offset = TimeOffset(offset_s, offset_std_s**2)
    return AuxiliaryCalibration("velocity", noise, offset, np.inf, (WALK_SHARE * noise) ** 2)


def _lively(value: Floats, width: int) -> Floats:
    """Values (n,) without their running mean, which is not known near the ends."""
    mean = np.convolve(value, np.ones(width) / width, mode="valid")
    first = (width - 1) // 2
    return np.asarray(value[first : first + len(mean)] - mean)


def _offset(at: Callable[[float], _Sampled], max_offset_s: float, step_s: float) -> tuple[float, float, float]:
    """The offset (s) at which both differ least, its standard deviation, and by what (mean square) they differ then."""
    offsets = step_s * np.arange(-np.floor(max_offset_s / step_s), np.floor(max_offset_s / step_s) + 1)

    def left(offset_s: float) -> float:
        # Whatever the gain, so that a wrong unit hides no sign.
        found = at(offset_s)
        gain = max(found.gain[0], 0.0)
        return float(np.mean((found.measured - gain * found.integrated) ** 2))

    costs = np.array([left(one) for one in offsets])
    best = int(np.argmin(costs))
    if not 0 < best < len(offsets) - 1:
        return float(offsets[best]), float(step_s), float(costs[best])
    before, here, after = costs[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    moved = 0.5 * (before - after) / bend
    count = len(at(float(offsets[best])).measured)
    # The cost is the noise's variance plus the bend's half times the square of the offset, in steps.
    std_s = step_s * np.sqrt(2.0 * max(here, 1e-300) / bend / count)
    return float(offsets[best] + step_s * moved), float(std_s), float(here)
