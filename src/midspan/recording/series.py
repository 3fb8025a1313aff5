"""What one sensor measured along an axis as one displacement, for pictures and for methods that take one series.

The estimator takes every target by itself; this is the same by hand: relative zeros taken out, inverse variances.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from midspan.engine.targets import combine, relative_zeros
from midspan.records import Channel, Displacement, Floats, Measured, Nanoseconds, Source


@dataclass(frozen=True, slots=True)
class SensorSeries:
    """Displacement (n,) in m that one sensor measured along an axis, on the common clock; NaN where it saw nothing.

    std_m: of each value by itself, with what the sensor's reference adds.
    """

    sensor: str
    source: Source
    time_ns: Nanoseconds
    value_m: Floats
    std_m: Floats

    @property
    def displacement(self) -> Displacement:
        """As measurements; variances are infinite where nothing was seen."""
        variance = np.where(np.isfinite(self.value_m), self.std_m**2, np.inf)
        source = np.full(len(self.time_ns), self.source, dtype=np.uint8)
        return Displacement(self.time_ns, self.value_m, variance, source)


def sensor_series(measured: Measured, channels: Sequence[Channel], sensor: str, axis: int) -> SensorSeries:
    """The series of a sensor's channels along an axis, each with one row a frame (or reading)."""
    numbers = [k for k, channel in enumerate(channels) if channel.sensor == sensor and channel.axis == axis]
    rows = [measured.channel == k for k in numbers]
    per_m = [channels[k].units_per_m for k in numbers]
    factor = [channels[k].variance_factor for k in numbers]
    stamps = np.array([measured.time_ns[own] for own in rows])
    value = np.array([measured.value[own] / g for own, g in zip(rows, per_m, strict=True)])
    white = np.array([measured.variance[own] * f / g**2 for own, f, g in zip(rows, factor, per_m, strict=True)])
    reference = np.array([measured.reference_variance[own] / g**2 for own, g in zip(rows, per_m, strict=True)])
    usable = np.isfinite(value) & np.isfinite(white)
    best = int(np.argmin([np.median(v[u]) if u.any() else np.inf for v, u in zip(white, usable, strict=True)]))
    apart = np.where(usable, value - value[best], np.nan)
    zeros = relative_zeros(apart, white + white[best]) if len(numbers) > 1 else np.zeros(1)
    found = combine(value - zeros[:, None], white, usable)
    late = np.sum(found.weight * (stamps - stamps[0]), axis=0)
    seen = usable.any(axis=0)
    lasting = np.sum(found.weight * np.where(usable, reference, 0.0), axis=0)
    return SensorSeries(
        sensor=sensor,
        source=channels[numbers[0]].source,
        time_ns=stamps[0] + np.rint(late).astype(np.int64),
        value_m=np.where(seen, found.value, np.nan),
        std_m=np.where(seen, np.sqrt(found.variance + lasting), np.nan),
    )
