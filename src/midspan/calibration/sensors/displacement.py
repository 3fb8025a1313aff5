"""A displacement sensor's part of a calibration: noise, clock offset, and scale where that was estimated."""

import math
from dataclasses import dataclass, replace

from midspan.calibration.clock_rate import ClockRate
from midspan.records import NANOSECONDS, Nanoseconds, Source, TimeOffset


@dataclass(frozen=True, slots=True)
class DisplacementCalibration:
    """Noise per measurement (m) and clock offset of a displacement sensor, and its scale where that was estimated.

    scale: displacement in one unit read, which is 1 for a sensor of known unit; scale_std: its standard deviation, 0
    where it was not estimated; name: where there are several of these sensors. resolution_m: what its values, scaled,
    are rounded to; None where that is not known. low_m, high_m: the ends of its range, scaled, where it was held there:
    such values are left out. slow_std_m, slow_time_s, slow_hz: standard deviation, correlation time and frequency of
    its slow error (0 Hz: first-order Gauss-Markov). exposure_s: time over which it averages. apart_std_m: motion that
    only one of the two sensors may have seen (rms), which the error band holds whole. clock_rate: what is added to its
    stamps for each second since `clock_reference_s` on its own clock, before the offset, in a record that holds that
    instant.
    unseen_drift_m, unseen_step_m, unseen_gap_m: how far it may have drifted within 10 s, and its zero have stepped,
    anywhere and across its longest gap, without that showing in the calibration's record; 0: nothing was looked for.
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
    slow_hz: float = 0.0
    exposure_s: float = 0.0
    apart_std_m: float = 0.0
    clock_rate: float = 0.0
    clock_reference_s: float = 0.0
    unseen_drift_m: float = 0.0
    unseen_step_m: float = 0.0
    unseen_gap_m: float = 0.0

    def even(self, time_ns: Nanoseconds) -> Nanoseconds:
        """The stamps (n,) as of a clock that runs at the accelerometer's rate; of another record, which does not hold
        the instant that the rate counts from, they stay.
        """
        reference_ns = round(NANOSECONDS * self.clock_reference_s)
        if self.clock_rate == 0.0 or not len(time_ns) or not time_ns[0] <= reference_ns <= time_ns[-1]:
            return time_ns
        return ClockRate(self.clock_rate, 0.0, reference_ns).even(time_ns)

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
            unseen_drift_m=self.unseen_drift_m / gain,
            unseen_step_m=self.unseen_step_m / gain,
            unseen_gap_m=self.unseen_gap_m / gain,
            resolution_m=None if self.resolution_m is None else self.resolution_m / gain,
            low_m=self.low_m / gain,
            high_m=self.high_m / gain,
        )
