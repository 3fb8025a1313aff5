"""The sections of `calibration.json` of sensors that help others: velocity, gyroscope, inclinometer."""

import math
from typing import Any

from pydantic import Field

from midspan.calibration.sensors.auxiliary import MEASURES, AuxiliaryCalibration
from midspan.records import Quantity
from midspan.settings.fields import Time
from midspan.settings.stored.sections import Ratio, Std, StdOrInf, StoredSensor, offset_summary

UNITS = {Quantity.VELOCITY: "m/s", Quantity.TILT: "rad", Quantity.TILT_RATE: "rad/s"}


class StoredAuxiliary(StoredSensor):
    """A velocity sensor, a gyroscope or an inclinometer, in SI units."""

    time_offset_s: Time = Field(0.0, description="clock offset, added to the sensor's stamps")
    noise_std: Ratio = Field(description="white noise of one value, m/s, rad/s or rad")
    zero_std: StdOrInf = Field(math.inf, description="σ of its zero, same unit; null: not known")
    zero_walk: Std = Field(0.0, description="density of the zero's random walk, unit²/s")
    focal_px: Ratio = Field(1.0, description="focal length of the camera, px/rad; of a velocity 1")
    focal_std_px: Std = Field(0.0, description="its σ")
    verified: bool = Field(True, description="whether the motion shows its sign and scale")

    @classmethod
    def tree(cls, record: Any) -> dict[str, Any]:
        """The section of a record."""
        return {key: value for key, value in super().tree(record).items() if key != "name"}

    def record(self, kind: str) -> AuxiliaryCalibration:
        """What the section means."""
        made: dict[str, Any] = {"kind": kind, "offset": self.offset}
        return AuxiliaryCalibration(**made | super().values(AuxiliaryCalibration))

    @staticmethod
    def summary(sensor: AuxiliaryCalibration) -> str:
        """Its values in a line."""
        focal = ""
        if sensor.measures is not Quantity.VELOCITY:
            focal = f", focal length {sensor.focal_px:.5g} ± {sensor.focal_std_px:.2g} px"
        unit = UNITS[MEASURES[sensor.kind]]
        return f"noise {sensor.noise_std:.3g} {unit}{focal}, {offset_summary(sensor.offset)}"
