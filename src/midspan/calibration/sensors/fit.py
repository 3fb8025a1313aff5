"""What is estimated of one sensor: its calibration, and what it implies of the accelerometer."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from midspan.calibration.agreement import Misfit
from midspan.calibration.bias import Bias
from midspan.calibration.direction import Direction
from midspan.notices import Notice
from midspan.records import InputNoise

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
