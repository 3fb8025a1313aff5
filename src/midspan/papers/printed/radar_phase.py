"""The radar as printed by Ma et al.: target and factor by trial, unwrapping by equations 12–16, to compare with.

"Structural displacement estimation using accelerometer and FMCW millimeter wave radar", sections 3.1 and 3.2,
doi:10.1016/j.ymssp.2022.109582.
"""

from dataclasses import dataclass

import numpy as np

from midspan import _core
from midspan.checks import finite, positive, same_length
from midspan.radar.channels import Phasors
from midspan.radar.chirp import SPEED_OF_LIGHT_M_S, RadarInfo
from midspan.radar.measurement import TargetSeries
from midspan.radar.target import Target
from midspan.records import Floats

CUT_OFF_HZ = 0.5
GRID = (0.5, 2.0, 0.001)
# Left out at both ends, where the filter has not settled, s.
EDGE_S = 4.0


@dataclass(frozen=True, slots=True)
class GridFactor:
    """The factor of least error and that error E (m)."""

    conversion_factor: float
    error_m: float


def unwrap_aided(phase_rad: Floats, acceleration_m_s2: Floats, *, period_s: float, phase_per_m: float) -> Floats:
    """Unwrapped phase (n,) in rad, predicted from the last two phases and the acceleration.

    phase_rad: (n,), NaN where a frame is missing; acceleration_m_s2: (n,) in the line of sight at the frames'
    instants (structural acceleration divided by the conversion factor); period_s: from frame to frame;
    phase_per_m: rad per m of range. The first two frames must not wrap.

    The prediction carries √6 of the phase's noise, so it needs about 12 dB, and it does not recover from a wrong cycle.
    Ma et al., "Structural displacement estimation using accelerometer and FMCW millimeter wave radar", equations 12-15.
    """
    phase = np.asarray(phase_rad, dtype=np.float64)
    acceleration = finite("acceleration_m_s2", acceleration_m_s2)
    same_length(phase_rad=phase, acceleration_m_s2=acceleration)
    return _core.unwrap_aided(np.ascontiguousarray(phase), acceleration * period_s**2, phase_per_m)


def high_passed(displacement_m: Floats, rate_hz: float) -> Floats:
    """Displacement (n,) without what is below 0.5 Hz: Butterworth of order 4, forwards and backwards."""
    from scipy.signal import butter, sosfiltfilt

    sections = butter(4, CUT_OFF_HZ, btype="highpass", fs=positive("rate_hz", rate_hz, "Hz"), output="sos")
    return np.asarray(sosfiltfilt(sections, np.asarray(displacement_m) - np.mean(displacement_m)))


def grid_factor(los_m: Floats, acceleration_m_s2: Floats, rate_hz: float) -> GridFactor:
    """Conversion factor by trial from 0.5 to 2, steps 1 and 2 of section 3.1.

    los_m (n,): range change; acceleration_m_s2 (n,): at the same instants. Compared are both displacements above
    0.5 Hz; the accelerometer's is integrated twice by trapezoids. A factor beyond the grid or negative is not found.
    Ma et al., "Structural displacement estimation using accelerometer and FMCW millimeter wave radar", figure 5.
    """
    los, acceleration = finite("los_m", los_m), finite("acceleration_m_s2", acceleration_m_s2)
    same_length(los_m=los, acceleration_m_s2=acceleration)
    speed = _integrated(acceleration - acceleration.mean(), rate_hz)
    edge = int(EDGE_S * rate_hz)
    inertial = high_passed(_integrated(speed - speed.mean(), rate_hz), rate_hz)[edge : len(los) - edge]
    seen = high_passed(los, rate_hz)[edge : len(los) - edge]
    factors = np.arange(GRID[0], GRID[1] + GRID[2] / 2, GRID[2])
    # Mean of (f s − d)² over the samples is a parabola in f.
    power = factors**2 * np.mean(seen**2) - 2.0 * factors * np.mean(seen * inertial) + np.mean(inertial**2)
    errors = np.sqrt(np.maximum(power, 0.0))
    best = int(np.argmin(errors))
    return GridFactor(float(factors[best]), float(errors[best]))


def best_on_grid(los_m: Floats, acceleration_m_s2: Floats, rate_hz: float) -> tuple[int, tuple[GridFactor, ...]]:
    """Step 3: the target of least error among range changes (targets, n), and the result of each."""
    results = tuple(grid_factor(los, acceleration_m_s2, rate_hz) for los in los_m)
    return int(np.argmin([result.error_m for result in results])), results


def printed_phase_per_m(info: RadarInfo) -> float:
    """Phase in rad that one metre more of range adds, by the ramp's start frequency; the carrier without a ramp."""
    hertz = info.carrier_hz if info.profile is None else info.profile.start_frequency_hz
    return 4.0 * np.pi * hertz / SPEED_OF_LIGHT_M_S


def printed_change(z: Phasors, acceleration_m_s2: Floats, *, period_s: float, phase_per_m: float) -> Floats:
    """Range change (n,) in m since the first two frames on end that were received, NaN before; equations 12 to 16.

    z (n,): phasors of one receiver at one bin, NaN where missing; acceleration_m_s2 (n,): in the line of sight at the
    frames' instants, without its mean; period_s: from frame to frame; phase_per_m: rad per m of range.
    """
    out = np.full(len(z), np.nan)
    known = np.isfinite(z)
    both = np.flatnonzero(known[:-1] & known[1:])
    if not len(both):
        return out
    since = slice(int(both[0]), None)
    phase = np.where(known, np.angle(np.where(known, z, 1.0)), np.nan).astype(np.float64)[since]
    unwrapped = unwrap_aided(phase, acceleration_m_s2[since], period_s=period_s, phase_per_m=phase_per_m)
    out[since] = (unwrapped - unwrapped[0]) / phase_per_m
    return out


def acceleration_at(samples: Floats, time_s: Floats) -> Floats:
    """Acceleration (n,) at times (n,), without its mean."""
    value = np.interp(time_s, samples[:, 0], samples[:, 1])
    return np.asarray(value - np.mean(value))


def printed_series(z: Phasors, frame_s: Floats, level: Floats, given: tuple[Target, float]) -> TargetSeries:
    """The target's displacement at phasors (n,) of an even grid; given: target, rad per m of range.

    Its variance is E², the only error that the chain knows.
    """
    target, unit = given
    period_s = float(np.median(np.diff(frame_s)))
    factor = target.conversion_factor
    change = printed_change(z, level / factor, period_s=period_s, phase_per_m=unit)
    seen = np.isfinite(z) & np.isfinite(change)
    change = np.where(seen, change, np.nan)
    return TargetSeries(factor * change, np.where(seen, target.noise_m**2, np.inf), change)


def _integrated(values: Floats, rate_hz: float) -> Floats:
    steps = 0.5 * (values[1:] + values[:-1]) / rate_hz
    return np.concatenate(([0.0], np.cumsum(steps)))
