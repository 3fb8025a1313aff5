"""What is estimated of one sensor: its calibration, and what it implies of the accelerometer, as its bias.

The mean of the acceleration over T seconds holds (v_end − v_start)/T of the motion. The filter of `whitening` has the
bias as a state, and the displacement by the other sensor. A short window hardly shows the accelerometer's noise: the
bias is averaged over the noise by how likely each value is, with the prior of `fit`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from midspan.calibration.agreement import Misfit
from midspan.calibration.direction import Direction
from midspan.calibration.fit import Fit, Pair, aligned, corner_range, evaluate
from midspan.notices import Notice
from midspan.records import Displacement, Floats, InputNoise

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

    def acceleration(open_part: Floats, ratio: float) -> float:
        # With the part of the acceleration outside a band, which does not decide the ratio.
        own = open_part[1] + (open_part[3] if pair.outside is not None else 0.0)
        return float(open_part[0] / ratio - own)

    def own_variance(one: Fit) -> float:
        own = one.noise * one.whitened.bias_variance / one.ratio**2
        if pair.ratio is not None:
            return own
        # A ratio that is known is none of the unknowns; else the bias goes with it.
        return float(own + (one.whitened.bias[0] / one.ratio**2) ** 2 * one.ratio_variance)

    corners = fit.corner * np.exp(np.arange(-REACH, REACH + STEP, STEP))
    fits = [fit, *(here.fit(float(corner)) for corner in corners if low <= corner <= high and corner != fit.corner)]
    likelihood = np.array([one.likelihood for one in fits])
    weight = np.exp(likelihood - np.max(likelihood))
    value = np.array([acceleration(one.whitened.bias, one.ratio) for one in fits])
    mean = float(np.average(value, weights=weight))
    spread = (value - mean) ** 2 + np.array([own_variance(one) for one in fits])
    variance = float(np.average(spread, weights=weight))
    if pair.bias_drifts:
        # The slope of white noise of density S over T, 12 S / T³ (variance), was taken out with it: at the end 3 S / T.
        variance += 3.0 * fit.input_density / float(here.columns.rows[-1, 0] - here.columns.rows[0, 0])
    if 0.0 < offset_std_s < np.inf:
        late = evaluate(pair, fit.offset_s + offset_std_s, fit.corner)
        variance += (acceleration(late.whitened.bias, late.ratio) - value[0]) ** 2
    return Bias(pair.level_m_s2 + mean, float(np.sqrt(variance)), 0.0 - acceleration(here.columns.cubic[1], fit.ratio))


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
    deviation of the scale is made of, by the names of `scale.PARTS`. gyroscope: what was found of one on a camera's
    box. moved: the displacement that a radar tells in the calibration window, on the accelerometer's clock.
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
    gyroscope: Any = None
    moved: Displacement | None = None
