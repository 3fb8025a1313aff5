"""A displacement sensor's part of a calibration: its noise, its clock offset, and its scale where that was learnt."""

import math
from dataclasses import dataclass
from typing import Any

from midspan.recording.stored.json_values import finite_or_none
from midspan.records import TimeOffset


@dataclass(frozen=True, slots=True)
class DisplacementCalibration:
    """Noise per measurement (m) and clock offset of a displacement sensor, and its scale where that was learnt.

    scale: displacement in one unit read, which is 1 for a sensor of known unit; scale_std: its standard deviation, 0
    where it was not learnt.
    """

    noise_std_m: float
    offset: TimeOffset
    scale: float = 1.0
    scale_std: float = 0.0

    @property
    def relative_std(self) -> float:
        """Relative standard deviation of the scale."""
        return self.scale_std / abs(self.scale)

    def to_dict(self) -> dict[str, Any]:
        """The section `displacement` of `calibration.json`: mm and s."""
        tree: dict[str, Any] = {
            "noise_std_mm": 1e3 * self.noise_std_m,
            "time_offset_s": self.offset.value_s,
            "time_offset_std_s": finite_or_none(math.sqrt(self.offset.variance)),
        }
        if self.scale_std > 0.0:
            tree |= {"scale": self.scale, "scale_std": self.scale_std}
        return tree
