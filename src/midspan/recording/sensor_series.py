"""What one sensor measured over a record, in metres: what a report draws as points."""

from dataclasses import dataclass

import numpy as np

from midspan.records import Displacement, Floats, Nanoseconds, Source


@dataclass(frozen=True, slots=True, eq=False)
class SensorSeries:
    """Measurements value_m (n,) of one sensor at time_ns (n,) on the accelerometer's clock, std_m (n,) of each.

    sensor: its name; source: how the result's rows that rest on it are marked. NaN where nothing was measured. The zero
    is the sensor's own.
    """

    sensor: str
    source: Source
    time_ns: Nanoseconds
    value_m: Floats
    std_m: Floats

    @property
    def displacement(self) -> Displacement:
        """The series as measurements; variances are infinite where nothing was measured."""
        variance = np.where(np.isfinite(self.value_m), self.std_m**2, np.inf)
        source = np.full(len(self.time_ns), self.source, dtype=np.uint8)
        return Displacement(self.time_ns, self.value_m, variance, source)


def series_of(sensor: str, source: Source, measured: Displacement) -> SensorSeries:
    """The measurements of a sensor as a series."""
    seen = np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2)
    value = np.where(seen, measured.value_m, np.nan)
    std = np.sqrt(np.where(seen, measured.variance_m2, np.nan))
    return SensorSeries(sensor, source, measured.time_ns, value, std)
