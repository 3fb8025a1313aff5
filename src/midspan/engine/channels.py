"""The estimator's channels and parameters as a recording's sensors put them together, one after another."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.engine.averaging import in_displacement_alone
from midspan.engine.plain import PlainChain, PlainSettings
from midspan.engine.sensors import PlainSensor
from midspan.engine.stream import FIRST_NS
from midspan.fusion.model import Parameter, ParameterKind
from midspan.records import NANOSECONDS, Channel, Nanoseconds, Source, TimeOffset, TimeSeries
from midspan.signals.stuck import resolution

# Rows are coasting when the last accepted measurement is older than this many of the sensor's usual intervals; they
# are lost after this many, and after this many seconds at least.
COASTING_INTERVALS, LOST_INTERVALS, MIN_COASTING_S, MIN_LOST_S = 2.5, 10.0, 0.05, 10.0
# The usual interval of a stream is the median between this many stamps at its beginning: jitter of a tenth of an
# interval then changes it by a hundredth.
FIRST_STAMPS = 100
# Relative standard deviation of a scale of a given calibration besides what that states: the sensitivity of ordinary
# accelerometers is within ±5 % of the data sheet's, which is 5 % / sqrt(3) where every value is as likely.
GIVEN_SCALE_STD = 0.03
# Density of the random walk of such a scale, 1/s: sensitivities change by 1 % from one day to the next at most.
SCALE_WALK = 1e-4 / 86400.0
# Averaging over so small a part of the motion (angular frequency times exposure) is its first term to 1e-4.
SLIGHT = 0.1
# The motion tells such a scale only where what the acceleration tells of the displacement is 10 standard deviations of
# the prediction. The acceleration's own noise follows no sensor, which looks like a scale of less: a quarter of the
# prediction's variance is its (a double integrator's filter in its steady state), so that what is left is 1/400 of it.
CLEAR_MOTION = 400.0


@dataclass(slots=True)
class Table:
    """The estimator's channels and parameters as they are gathered, sensor by sensor.

    given: the calibration was not estimated from this recording. gain_std: relative standard deviation of the gain of
    each axis's accelerometer, which is in the scales' of the calibration. in_true_metres: channels of sensors whose
    unit is right, unlike the accelerometer's. motion_hz: middle frequency of the acceleration.
    """

    channels: list[Channel] = field(default_factory=list)
    parameters: list[Parameter] = field(default_factory=list)
    in_true_metres: list[int] = field(default_factory=list)
    given: bool = False
    motion_hz: float = 0.0
    gain_std: tuple[float, ...] = (0.0, 0.0)

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

        Of a given calibration it is estimated, from `GIVEN_SCALE_STD` besides; otherwise the band alone holds it. The
        accelerometer's gain is no part of it: see `gain`.
        """
        relative_std = without_gain(relative_std, self.gain_std[self.channels[channels[0]].axis])
        if not self.given:
            self.uncertain(ParameterKind.SCALE_ERROR, channels, relative_std)
            return
        std = float(np.hypot(relative_std, GIVEN_SCALE_STD))
        self.parameters.append(
            Parameter(ParameterKind.SCALE_ERROR, tuple(channels), std, FIRST_NS, SCALE_WALK, CLEAR_MOTION)
        )

    def by_first_terms(self) -> None:
        """Let displacement sensors together with others average by the first term, at the motion's frequency."""
        if not in_displacement_alone(self.channels):
            self.channels = [
                replace(one, exposure_s=as_first_term(one.exposure_s, self.motion_hz))
                if one.source == Source.DISPLACEMENT
                else one
                for one in self.channels
            ]

    def gain(self, stds: Sequence[float], *, estimated: bool) -> None:
        """Put the error of the accelerometer's gain along each axis to the table; stds: its relative deviations.

        Where there are sensors whose unit is right it is estimated, if wanted; otherwise the band alone holds it, and
        the scales of these sensors are estimated where the calibration is given.
        """
        if self.given and not estimated:
            for number in self.in_true_metres:
                self.scaled([number], 0.0)
        for axis, std in enumerate(stds):
            compared = [number for number, one in enumerate(self.channels) if one.axis == axis]
            learnt = tuple(number for number in compared if number not in self.in_true_metres)
            if estimated and len(learnt) < len(compared) and (self.given or std == 0.0):
                wide = float(np.hypot(std, GIVEN_SCALE_STD))
                own = Parameter(ParameterKind.GAIN_ERROR, learnt, wide, FIRST_NS, SCALE_WALK, CLEAR_MOTION, axis)
                self.parameters.append(own)
            elif std > 0.0:
                self.parameters.append(Parameter(ParameterKind.GAIN_ERROR, learnt, std, axis=axis))


def as_first_term(exposure_s: float, frequency_hz: float) -> float:
    """The exposure (s) whose first term, exposure²/24 of the acceleration, is what averaging takes at a frequency."""
    omega = 2.0 * np.pi * frequency_hz
    if omega * exposure_s < SLIGHT:
        return exposure_s
    return float(np.sqrt(24.0 * (1.0 - np.sinc(frequency_hz * exposure_s)))) / omega


def without_gain(relative_std: float, gain_std: float) -> float:
    """A scale's relative standard deviation relative to the accelerometer: without that of the accelerometer's gain."""
    return float(np.sqrt(max(relative_std**2 - gain_std**2, 0.0)))


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
            slow_std_m=calibration.slow_std_m,
            slow_time_s=calibration.slow_time_s,
            exposure_s=calibration.exposure_s,
        )
    )
    if calibration.relative_std > 0.0 or calibration.scale != 1.0:
        table.scaled([channel], calibration.relative_std)
    else:
        table.in_true_metres.append(channel)
    table.uncertain(ParameterKind.CLOCK_OFFSET, [channel], clock_std_s(calibration.offset))
    step_m = calibration.resolution_m
    settings = PlainSettings(
        name=sensor,
        channel=channel,
        variance_m2=calibration.noise_std_m**2,
        step_s=step_s,
        resolution_m=resolution(calibration.scale * series.value) if step_m is None else step_m,
        scale=calibration.scale,
        low_m=calibration.low_m,
        high_m=calibration.high_m,
    )
    return PlainSensor(sensor, PlainChain(settings))
