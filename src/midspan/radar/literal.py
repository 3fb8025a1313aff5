"""Choice of target and conversion factor as printed by Ma et al., for comparison with `target`."""

from dataclasses import dataclass

import numpy as np

from midspan.checks import finite, positive, same_length
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


def _integrated(values: Floats, rate_hz: float) -> Floats:
    steps = 0.5 * (values[1:] + values[:-1]) / rate_hz
    return np.concatenate(([0.0], np.cumsum(steps)))
