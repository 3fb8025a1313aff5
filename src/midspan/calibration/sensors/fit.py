"""What is estimated of one sensor: its calibration, and what it implies of the accelerometer, as its bias.

The mean of the acceleration over T seconds holds (v_end − v_start)/T of the motion. The filter of `whitening` has the
bias as a state, and the displacement by the other sensor. A short window hardly shows the accelerometer's noise: the
bias is averaged over the noise by how likely each value is, with the prior of `fit`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from midspan.calibration.agreement import Misfit
from midspan.calibration.direction import Direction
from midspan.calibration.fit import Aligned, Fit, Pair, aligned, corner_range, evaluate
from midspan.notices import Notice
from midspan.records import InputNoise

# Logarithms of the corner frequency, relative to the best fit's, that are averaged over: reach and step.
REACH, STEP = 3.0, 0.25


@dataclass(frozen=True, slots=True)
class Bias:
    """The accelerometer's bias at the end of what a calibration looked at, and its standard deviation, m/s².

    drift_m_s3: the rate at which it drifts there, 0 where none shows.
    """

    value_m_s2: float
    std_m_s2: float
    drift_m_s3: float = 0.0


def bias_of(pair: Pair, fit: Fit, offset_std_s: float = 0.0) -> Bias:
    """The bias that a pair implies, given its best fit.

    What is uncertain of the noise, of the ratio and of the clock offset (s) is in the deviation.
    """
    here, (low, high) = aligned(pair, fit.offset_s), corner_range(pair)
    corners = fit.corner * np.exp(np.arange(-REACH, REACH + STEP, STEP))
    fits = [fit, *(here.fit(float(corner)) for corner in corners if low <= corner <= high and corner != fit.corner)]
    likelihood = np.array([one.likelihood for one in fits])
    weight = np.exp(likelihood - np.max(likelihood))
    value = np.array([_bias(pair, one) for one in fits])
    mean = float(np.average(value, weights=weight))
    spread = (value - mean) ** 2 + np.array([_variance(pair, one) for one in fits])
    variance = float(np.average(spread, weights=weight))
    if pair.bias_drifts:
        # The slope of white noise of density S over T, 12 S / T³ (variance), was taken out with it: at the end 3 S / T.
        variance += 3.0 * fit.input_density / float(here.rows[-1, 0] - here.rows[0, 0])
    if 0.0 < offset_std_s < np.inf:
        late = evaluate(pair, fit.offset_s + offset_std_s, fit.corner)
        variance += (_bias(pair, late) - _bias(pair, fit)) ** 2
    return Bias(pair.level_m_s2 + mean, float(np.sqrt(variance)), _drift(here, fit))


def _drift(here: Aligned, fit: Fit) -> float:
    """The rate of the bias, m/s³; 0 where it does not drift."""
    own = here.cubic[1, 1] + (here.cubic[1, 3] if here.pair.outside is not None else 0.0)
    return float(own - here.cubic[1, 0] / fit.ratio)


def _bias(pair: Pair, fit: Fit) -> float:
    """The filter's bias after the last sample, m/s² from the samples' level."""
    whole = fit.whitened.bias
    # With the part of the acceleration outside a band, which does not decide the ratio.
    own = whole[1] + (whole[3] if pair.outside is not None else 0.0)
    return float(whole[0] / fit.ratio - own)


def _variance(pair: Pair, fit: Fit) -> float:
    """Variance (m/s²)² of the bias with the noise levels of a fit."""
    own = fit.noise * fit.whitened.bias_variance / fit.ratio**2
    # A ratio that is known is none of the unknowns; else the bias goes with it.
    return own if pair.ratio is not None else own + (fit.whitened.bias[0] / fit.ratio**2) ** 2 * fit.ratio_variance


Calibrated = TypeVar("Calibrated")
Diagnostics = TypeVar("Diagnostics")


# Not slotted: Python 3.11 cannot make a frozen, slotted record by the name of a generic alias.
@dataclass(frozen=True)
class SensorFit(Generic[Calibrated, Diagnostics]):
    """What was estimated of a sensor, of a camera along one axis.

    input_noise: of the acceleration; without an accelerometer the motion's own. bias: of the accelerometer, None
    without one. diagnostics: what the values rest on, None where the calibration holds it. gain,
    gain_std: of the accelerometer relative to the sensor, 0 where that does not tell it. misfit: how far the
    innovations are from white. slope: by which the accelerometer leans as it moves, radians a metre. direction: of the
    sensor's axis, None where the accelerometer's other axes were not recorded. parts: what the relative standard
    deviation of the scale is made of, by the names of `scale.PARTS`.
    """

    calibration: Calibrated
    input_noise: InputNoise
    bias: Bias | None = None
    warnings: tuple[Notice, ...] = ()
    diagnostics: Diagnostics | None = None
    gain: float = 1.0
    gain_std: float = 0.0
    misfit: Misfit = field(default_factory=Misfit)
    slope: float = 0.0
    direction: Direction | None = None
    parts: Mapping[str, float] = field(default_factory=dict)
