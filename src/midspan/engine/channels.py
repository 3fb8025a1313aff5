"""The estimator's channels and parameters as a recording's sensors put them together, one after another."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.engine.plain import PlainChain, PlainSettings
from midspan.engine.sensors import PlainSensor
from midspan.fusion.model import Parameter, ParameterKind
from midspan.records import NANOSECONDS, Channel, Nanoseconds, Source, TimeOffset, TimeSeries
from midspan.signals.stuck import resolution

# Rows are coasting when the last accepted measurement is older than this many of the sensor's usual intervals; they
# are lost after this many, and after this many seconds at least.
COASTING_INTERVALS, LOST_INTERVALS, MIN_COASTING_S, MIN_LOST_S = 2.5, 10.0, 0.05, 10.0
# The usual interval of a stream is the median between so many stamps at its beginning: jitter of a tenth of an interval
# then changes it by a hundredth.
FIRST_STAMPS = 100


@dataclass(slots=True)
class Table:
    """The estimator's channels and parameters as they are gathered, sensor by sensor."""

    channels: list[Channel] = field(default_factory=list)
    parameters: list[Parameter] = field(default_factory=list)

    def add(self, channel: Channel) -> int:
        """Put a channel to the table; returns its number."""
        self.channels.append(channel)
        return len(self.channels) - 1

    def uncertain(self, kind: ParameterKind, channels: Sequence[int], std: float) -> None:
        """Put an uncertain value that the channels share to the table, where there is any doubt of it."""
        if 0.0 < std < np.inf:
            self.parameters.append(Parameter(kind, tuple(channels), std))


def interval_s(times: Nanoseconds) -> float:
    """The usual interval (s) between stamps (n,): of the first ones, so that nothing depends on what comes later."""
    return float(np.median(np.diff(times[:FIRST_STAMPS]))) / NANOSECONDS if len(times) > 1 else 0.0


def ages(interval: float) -> tuple[float, float]:
    """Ages (s) of the last accepted measurement from which on rows are coasting and lost, by the usual interval (s)."""
    return max(COASTING_INTERVALS * interval, MIN_COASTING_S), max(LOST_INTERVALS * interval, MIN_LOST_S)


def clock_std_s(offset: TimeOffset) -> float:
    """Standard deviation (s) of a clock offset; one that the motion does not tell has no effect either."""
    return float(np.sqrt(offset.variance)) if np.isfinite(offset.variance) else 0.0


def plain_channel(
    table: Table, calibration: DisplacementCalibration, series: TimeSeries, sensor: str, *, first: bool
) -> PlainSensor:
    """A displacement sensor, and its channel in the table.

    series: its values as read; first: whether its zero is the zero of the displacement.
    """
    step_s = interval_s(series.time_ns)
    coasting_s, lost_s = ages(step_s)
    channel = table.add(
        Channel(
            sensor=sensor,
            source=Source.DISPLACEMENT,
            units_per_m=1.0,
            zero_std_m=0.0 if first else np.inf,
            coasting_s=coasting_s,
            lost_s=lost_s,
        )
    )
    table.uncertain(ParameterKind.SCALE_ERROR, [channel], calibration.relative_std)
    table.uncertain(ParameterKind.CLOCK_OFFSET, [channel], clock_std_s(calibration.offset))
    step_m = calibration.resolution_m
    settings = PlainSettings(
        name=sensor,
        channel=channel,
        variance_m2=calibration.noise_std_m**2,
        step_s=step_s,
        resolution_m=resolution(calibration.scale * series.value) if step_m is None else step_m,
        scale=calibration.scale,
    )
    return PlainSensor(sensor, PlainChain(settings))
