"""What one sensor measured over a record, in metres: what a report draws as points."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.engine.averaging import in_displacement_alone
from midspan.fusion.path import at
from midspan.fusion.targets import agreeing, combine, relative_zeros
from midspan.records import (
    Acceleration,
    Channel,
    Displacement,
    Estimate,
    Floats,
    Measured,
    Nanoseconds,
    Source,
    part,
)
from midspan.signals.averaging import at_instants


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


def agreed_series(
    sensor: str, source: Source, targets: tuple[Sequence[Displacement], int], path: Estimate
) -> SensorSeries:
    """What a sensor's targets measured together: at each instant the mean of those that agree.

    targets: the displacements of each, one row a frame, and the number of the best. path: the displacement; it bridges
    the milliseconds between targets, and decides where two contradict each other. The stamps are the best target's.
    """
    blocks, best = targets
    if len(blocks) == 1:
        return series_of(sensor, source, blocks[0])
    residual = np.array([block.value_m - at(path, block.time_ns)[0] for block in blocks])
    variance = np.array([block.variance_m2 for block in blocks])
    residual -= relative_zeros(residual, variance)[:, None]
    expected, spread = at(path, blocks[best].time_ns)
    value, own = combine(residual, variance, agreeing(residual, variance, spread))
    return series_of(sensor, source, replace(blocks[best], value_m=value + expected, variance_m2=own))


def channel_series(measured: Measured, channels: Sequence[Channel], sensor: str, path: Estimate) -> SensorSeries:
    """What the channels of a sensor measured, each one row a frame, together; the first one is the best.

    What is uncertain of the zero of all of them is no noise of a frame; of one relative to the others it takes its
    weight.
    """
    rows = [(c, part(measured, measured.channel == k)) for k, c in enumerate(channels) if c.sensor == sensor]
    zeros = np.array([own.reference_variance / channel.units_per_m**2 for channel, own in rows])
    blocks = []
    for (channel, own), zero in zip(rows, zeros - zeros.min(axis=0), strict=True):
        source = np.full(len(own.time_ns), channel.source, dtype=np.uint8)
        variance = channel.variance_factor * own.variance / channel.units_per_m**2 + zero
        blocks.append(Displacement(own.time_ns, own.value / channel.units_per_m, variance, source))
    return agreed_series(sensor, Source(int(blocks[0].source[0])), (blocks, 0), path)


def series_at_instants(
    series: Mapping[str, SensorSeries], channels: Sequence[Channel], axis: int, acceleration: Acceleration
) -> dict[str, SensorSeries]:
    """The series of sensors along an axis, by name, without what their exposures take from fast motion."""
    # The first one of a sensor is its best target's.
    exposures = {one.sensor: one.exposure_s for one in reversed(channels) if one.axis == axis}
    first, found = not in_displacement_alone(channels), {}
    for name, one in series.items():
        measured = at_instants(one.displacement, exposures[name], acceleration, first_term=first)
        found[name] = series_of(name, one.source, measured)
    return found


def taken(series: SensorSeries, measured: Measured) -> SensorSeries:
    """The series with nothing where the estimator was given no measurement of the sensor: another one measured."""
    return replace(series, value_m=np.where(np.isin(series.time_ns, measured.time_ns), series.value_m, np.nan))
