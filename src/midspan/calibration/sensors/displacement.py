"""A displacement sensor's part of a calibration: noise, clock offset, and scale where that was estimated."""

import math
from dataclasses import dataclass, replace

from midspan.records import Source, TimeOffset


@dataclass(frozen=True, slots=True)
class DisplacementCalibration:
    """Noise per measurement (m) and clock offset of a displacement sensor, and its scale where that was estimated.

    scale: displacement in one unit read, which is 1 for a sensor of known unit; scale_std: its standard deviation, 0
    where it was not estimated; name: where there are several of these sensors. resolution_m: what its values, scaled,
    are rounded to; None where that is not known. low_m, high_m: the ends of its range, scaled, where it was held there:
    such values are left out. slow_std_m, slow_time_s: standard deviation and correlation time of its slow error
    (first-order Gauss-Markov). exposure_s: time over which it averages. apart_std_m: motion that only one of the
    two sensors may have seen (rms), which the error band holds whole.
    """

    noise_std_m: float
    offset: TimeOffset
    scale: float = 1.0
    scale_std: float = 0.0
    name: str | None = None
    resolution_m: float | None = None
    low_m: float = -math.inf
    high_m: float = math.inf
    slow_std_m: float = 0.0
    slow_time_s: float = math.inf
    exposure_s: float = 0.0
    apart_std_m: float = 0.0

    @property
    def kind(self) -> str:
        """The section that it stands in."""
        return Source.DISPLACEMENT.word

    @property
    def relative_std(self) -> float:
        """Relative standard deviation of the scale."""
        return self.scale_std / abs(self.scale)

    def without_gain(self, gain: float, std: float) -> "DisplacementCalibration":
        """The same in metres: an estimated scale is from an accelerometer of this gain and relative deviation."""
        if self.scale == 1.0:
            return self
        own = self.scale / gain
        return replace(
            self,
            scale=own,
            scale_std=math.hypot(self.scale_std / gain, std * own),
            noise_std_m=self.noise_std_m / gain,
            slow_std_m=self.slow_std_m / gain,
            apart_std_m=self.apart_std_m / gain,
            resolution_m=None if self.resolution_m is None else self.resolution_m / gain,
            low_m=self.low_m / gain,
            high_m=self.high_m / gain,
        )
