"""Noise levels learnt from the innovations of a displacement sensor and the accelerometer, and their clock offset."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from midspan.calibration.fit import Fit, Pair, best_corner, corner_range
from midspan.calibration.time_offset import MARKING_ROUNDS, mark_outliers, search_offset, without_lonely_outliers
from midspan.calibration.whitening import whiten
from midspan.records import TimeOffset

# A clock offset is only applied when it is this certain and the likelihood gains this much over none.
CERTAIN_S = 0.02
LEAST_GAIN = 10.0
# A quiet camera sees a motion so well that the two noise levels meet this far above its Nyquist frequency.
FASTEST = 100.0


@dataclass(frozen=True, slots=True)
class NoiseCalibration:
    """Noise levels and clock offset of a displacement sensor.

    variance_factor: learnt variance per unit of the variance given with each measurement; input_noise_density: of the
    acceleration, (m/s²)²/Hz; offset: of the sensor's clock (zero with infinite variance when the motion does not tell);
    scale: the sensor's apparent scale against the accelerometer (1 when both are right) with its standard deviation.
    reversed_gain: how much more likely (logarithm) the measurements are with the opposite sign; negative when they
    are right. factor, factor_std: metres in one metre read, where that was learnt as well: the other figures hold for
    readings times this factor. 1 and 0: readings are taken as they are.
    """

    variance_factor: float
    input_noise_density: float
    offset: TimeOffset
    scale: float
    scale_std: float
    reversed_gain: float = -np.inf
    factor: float = 1.0
    factor_std: float = 0.0


def calibrate_noise(pair: Pair, max_offset_s: float) -> NoiseCalibration:
    """Learn noise levels of a displacement sensor of known unit, and its clock offset where the motion tells it.

    pair: displacement in m (ratio 1) with relative variances, and the acceleration. max_offset_s: 0 leaves the clocks
    be.
    """
    pair = without_lonely_outliers(replace(pair, ratio=1.0))
    pair, still = without_outliers(pair)
    fit, offset = still, TimeOffset(0.0, np.inf)
    if max_offset_s > 0:
        search = search_offset(pair, max_offset_s)
        gain = search.fit.likelihood - best_corner(search.pair, 0.0).likelihood
        if search.offset.variance < CERTAIN_S**2:
            offset = TimeOffset(0.0, search.offset.variance)
            if gain > LEAST_GAIN and abs(search.fit.offset_s) < 0.99 * max_offset_s:
                fit, offset = search.fit, search.offset
    scale, scale_std = _apparent_scale(fit)
    # With the wrong sign nothing fits but the lowest noise, or a clock offset of half a period.
    turned = replace(pair, rows=pair.rows * np.array([1.0, -1.0, 1.0]))
    other = search_offset(turned, max_offset_s).fit if max_offset_s > 0 else best_corner(turned, 0.0)
    reversed_gain = other.likelihood - fit.likelihood
    return NoiseCalibration(fit.noise, fit.input_density, offset, scale, scale_std, reversed_gain)


def without_outliers(pair: Pair) -> tuple[Pair, Fit]:
    """The pair without outliers and its fit at no offset; each round takes out the largest, which hid the smaller."""
    fit = best_corner(pair, 0.0)
    for _ in range(MARKING_ROUNDS):
        cleaned = mark_outliers(pair, fit)
        if cleaned is pair:
            break
        pair, fit = cleaned, best_corner(cleaned, 0.0, fit.corner)
    return pair, best_corner(pair, 0.0)


def _apparent_scale(fit: Fit) -> tuple[float, float]:
    """Displacement measured per displacement of the accelerometer, with its standard deviation."""
    w = fit.whitened
    power = float(np.sum(w.response**2 / w.variance))
    cross = float(np.sum(w.response * w.translation / w.variance))
    return cross / max(power, 1e-300), float(np.sqrt(fit.noise / max(power, 1e-300)))


def learn_motion(pair: Pair) -> float:
    """How strongly a motion without an accelerometer is shaken: density of a white acceleration, (m/s²)²/Hz.

    pair: displacement in m with variances that are right, and samples of zero acceleration: the motion itself is the
    noise of the model. By maximum likelihood of the innovations; the noise is not fitted beside it, which would take a
    motion faster than the frames follow for noise.
    """
    pair = without_lonely_outliers(pair)
    typical = float(np.median(pair.rows[np.isfinite(pair.rows[:, 2]), 2]))
    rows = pair.rows / np.array([1.0, 1.0, typical])
    low, high = corner_range(pair)

    def density(corner: float) -> float:
        return float(np.exp(4.0 * corner)) / pair.rate_hz

    def cost(corner: float) -> float:
        w = whiten(pair.samples, rows, density(corner), pair.exposure_s)
        return float(np.sum(np.log(w.variance) + w.translation**2 / (typical * w.variance)))

    bounds = (np.log(low), np.log(FASTEST * high))
    grid = np.linspace(*bounds, 25)
    best = grid[int(np.argmin([cost(corner) for corner in grid]))]
    step = grid[1] - grid[0]
    found = minimize_scalar(cost, bounds=(best - step, best + step), method="bounded")
    return typical * density(float(found.x))
