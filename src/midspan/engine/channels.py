"""The estimator's channels and parameters as a recording's sensors put them together, one after another."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.engine.order import FIRST_NS
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
# Relative standard deviation of a scale of a given calibration besides what that states: the sensitivity of ordinary
# accelerometers is within ±5 % of the data sheet's, which is 5 % / sqrt(3) where every value is as likely.
GIVEN_SCALE_STD = 0.03
# Density of the random walk of such a scale, 1/s: sensitivities change by 1 % from one day to the next at most.
SCALE_WALK = 1e-4 / 86400.0
# The motion tells such a scale only where what the acceleration tells of the displacement is 10 standard deviations of
# the prediction. The acceleration's own noise follows no sensor, which looks like a scale of less: a quarter of the
# prediction's variance is its (a double integrator's filter in its steady state), so that what is left is 1/400 of it.
CLEAR_MOTION = 400.0


@dataclass(slots=True)
class Table:
    """The estimator's channels and parameters as they are gathered, sensor by sensor.

    given: the calibration was not estimated from this recording.
    """

    channels: list[Channel] = field(default_factory=list)
    parameters: list[Parameter] = field(default_factory=list)
    given: bool = False

    def add(self, channel: Channel) -> int:
        """Put a channel to the table; returns its number."""
        self.channels.append(channel)
        return len(self.channels) - 1

    def uncertain(self, kind: ParameterKind, channels: Sequence[int], std: float) -> None:
        """Put an uncertain value that the channels share to the table, where there is any doubt of it."""
        if 0.0 < std < np.inf:
            self.parameters.append(Parameter(kind, tuple(channels), std))

    def scaled(self, channels: Sequence[int], relative_std: float) -> None:
        """Put the scale error that the channels share to the table.

        Of a given calibration it is estimated, from `GIVEN_SCALE_STD` besides; otherwise the band alone holds it.
        """
        if not self.given:
            self.uncertain(ParameterKind.SCALE_ERROR, channels, relative_std)
            return
        std = float(np.hypot(relative_std, GIVEN_SCALE_STD))
        self.parameters.append(
            Parameter(ParameterKind.SCALE_ERROR, tuple(channels), std, FIRST_NS, SCALE_WALK, CLEAR_MOTION)
        )


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
    table.scaled([channel], calibration.relative_std)
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
