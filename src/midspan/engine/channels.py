"""The estimator's channels and parameters as a recording's sensors put them together, one after another."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from midspan._core import TEMPLATE_NOISE
from midspan.calibration.sensors.auxiliary import AuxiliaryCalibration, turns_image
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.calibration.sensors.radar import RadarCalibration
from midspan.engine.auxiliary import AuxiliarySensor
from midspan.engine.averaging import in_displacement_alone
from midspan.engine.plain import PlainChain, PlainSettings
from midspan.engine.radar import RadarChain
from midspan.engine.radar_target import FollowedTarget
from midspan.engine.sensors import MIN_STD_PX, CameraSensor, PlainSensor, RadarSensor
from midspan.engine.stream import FIRST_NS
from midspan.engine.tracking import CameraTracking
from midspan.errors import UsageError
from midspan.fusion.model import Parameter, ParameterKind
from midspan.radar.chirp import RadarInfo
from midspan.radar.frames import bin_m_of
from midspan.records import (
    NANOSECONDS,
    Channel,
    Nanoseconds,
    Quantity,
    Source,
    TimeOffset,
    TimeSeries,
    places,
)
from midspan.signals.clipping import resolution

# Rows are coasting when the last accepted measurement is older than this many of the sensor's usual intervals; they
# are lost after this many, and after this many seconds at least.
COASTING_INTERVALS, LOST_INTERVALS, MIN_COASTING_S, MIN_LOST_S = 2.5, 10.0, 0.05, 10.0
# A displacement sensor whose zero has shifted may come back to it slowly, as a GNSS receiver converges in 30 to 300 s
# whose carrier phases are not resolved: critically damped, in twice this time, s (`core/src/estimator/slow.rs`).
REVERTING_S = 60.0
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
# Where the structure is when a target is first used, relative to the best target's first frame, m: more than structures
# move by, and little enough for the estimator's arithmetic compared with variances of (1 µm)².
OTHER_ZERO_STD_M = 0.1
# Density of the random walk of a sensor's clock relative to the accelerometer's, s²/s: it follows a drift of 60 ppm at
# once.
CLOCK_WALK = 3.6e-9
# A tilt is taken as independent from frame to frame: nothing is assumed of how fast a camera nods.
TILT_INTERVALS = 0.25
# Where it is measured it is critically damped at this frequency, Hz: cameras nod with their structure's modes and more
# slowly. By simulations of footbridges 1 to 4 Hz differ by a fifth.
TILT_HZ = 2.0
# A target calibrated for another radar, or moved since, differs in carrier by this share or in range by this many bins.
SAME_CARRIER, SAME_BINS = 1e-5, 0.5


@dataclass(slots=True)
class Table:
    """The estimator's channels and parameters as they are gathered, sensor by sensor.

    given: the calibration was not estimated from this recording. gain_std: relative standard deviation of the gain of
    each axis's accelerometer, which is in the scales' of the calibration. in_true_metres: channels of sensors whose
    unit is right, unlike the accelerometer's. motion_hz: middle frequency of the acceleration. turning: whether a
    camera's tilt, or its rate, is measured.
    """

    channels: list[Channel] = field(default_factory=list)
    parameters: list[Parameter] = field(default_factory=list)
    in_true_metres: list[int] = field(default_factory=list)
    given: bool = False
    motion_hz: float = 0.0
    turning: bool = False
    gain_std: tuple[float, ...] = (0.0, 0.0)

    def add(self, channel: Channel) -> int:
        """Put a channel to the table; returns its number."""
        self.channels.append(channel)
        return len(self.channels) - 1

    def uncertain(self, kind: ParameterKind, channels: Sequence[int], std: float) -> None:
        """Put an uncertain value that the channels share to the table, where there is any doubt of it."""
        if 0.0 < std < np.inf:
            self.parameters.append(Parameter(kind, tuple(channels), std))

    def clocked(self, channels: Sequence[int], std_s: float) -> None:
        """Put the offset of the channels' clock to the table, which is estimated: clocks drift, and are set."""
        self.parameters.append(Parameter(ParameterKind.CLOCK_OFFSET, tuple(channels), std_s, FIRST_NS, CLOCK_WALK))

    def scaled(self, channels: Sequence[int], relative_std: float) -> None:
        """Put the scale error that the channels share to the table.

        Of a given calibration it is estimated, from `GIVEN_SCALE_STD` besides; otherwise the band alone holds it. The
        accelerometer's gain is no part of it: see `gain`.
        """
        gain_std = self.gain_std[self.channels[channels[0]].axis]
        kind, std = ParameterKind.SCALE_ERROR, without_gain(relative_std, gain_std)
        if not self.given:
            self.uncertain(kind, channels, std)
            return
        std = float(np.hypot(std, GIVEN_SCALE_STD))
        self.parameters.append(Parameter(kind, tuple(channels), std, FIRST_NS, SCALE_WALK, CLEAR_MOTION))

    def scaled_with(self, channels: Sequence[int], other: int) -> None:
        """Let channels have the scale error of another channel, with which theirs was estimated."""
        self.parameters = [
            replace(one, channels=(*one.channels, *channels))
            if one.kind == ParameterKind.SCALE_ERROR and other in one.channels
            else one
            for one in self.parameters
        ]

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
            placing = set(places(self.channels))
            compared = [number for number, one in enumerate(self.channels) if one.axis == axis and one in placing]
            learned = tuple(number for number in compared if number not in self.in_true_metres)
            if estimated and len(learned) < len(compared) and (self.given or std == 0.0):
                wide = float(np.hypot(std, GIVEN_SCALE_STD))
                own = Parameter(ParameterKind.GAIN_ERROR, learned, wide, FIRST_NS, SCALE_WALK, CLEAR_MOTION, axis)
                self.parameters.append(own)
            elif std > 0.0:
                self.parameters.append(Parameter(ParameterKind.GAIN_ERROR, learned, std, axis=axis))


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
    known, step_s = calibration, interval_s(series.time_ns)
    coasting_s, lost_s = ages(step_s)
    channel = Channel(
        sensor=sensor,
        source=Source.DISPLACEMENT,
        units_per_m=1.0,
        zero_std_m=0.0 if first else np.inf,
        coasting_s=coasting_s,
        lost_s=lost_s,
        interval_s=step_s,
        reverting_s=REVERTING_S,
        slow_std_m=known.slow_std_m,
        slow_time_s=known.slow_time_s,
        slow_hz=known.slow_hz,
        exposure_s=known.exposure_s,
    )
    number = table.add(channel)
    if known.relative_std > 0.0 or known.scale != 1.0:
        table.scaled([number], known.relative_std)
    else:
        table.in_true_metres.append(number)
    table.clocked([number], clock_std_s(known.offset))
    step_m = resolution(known.scale * series.value) if known.resolution_m is None else known.resolution_m
    settings = PlainSettings(
        sensor, number, known.noise_std_m**2, step_s, step_m, known.scale, low_m=known.low_m, high_m=known.high_m
    )
    return PlainSensor(sensor, PlainChain(settings))


def auxiliary_channel(
    table: Table, calibration: AuxiliaryCalibration, time_ns: Nanoseconds, tilting: Channel | None, image_axis: str
) -> AuxiliarySensor | None:
    """A sensor that helps others, and its channel in the table.

    time_ns: stamps (n,) of its values. tilting: of the first target of the camera whose tilt it measures, along
    image_axis; None for a velocity. None where no slow error of that camera is a tilt.
    """
    units_per_m, step_s = 1.0, interval_s(time_ns)
    if calibration.measures is not Quantity.VELOCITY:
        if tilting is None or tilting.slow_std_m == 0.0:
            return None
        units_per_m = turns_image(image_axis) * tilting.units_per_m / calibration.focal_px
    channel = Channel(
        sensor=calibration.kind,
        source=Source.PREDICTION,
        units_per_m=units_per_m,
        interval_s=step_s,
        measures=calibration.measures,
        tilt_of="" if tilting is None else tilting.sensor,
        zero_std_m=calibration.zero_std / abs(units_per_m),
        zero_walk_m2_s=calibration.zero_walk / units_per_m**2,
    )
    return AuxiliarySensor(calibration.kind, table.add(channel), calibration.noise_std**2, step_s)


def camera_channels(
    table: Table,
    tracking: CameraTracking,
    calibrations: Sequence[CameraCalibration],
    exposure_s: float | None,
    *,
    first: bool,
    min_std_px: float = MIN_STD_PX,
) -> CameraSensor:
    """A camera's sensor, and its channels in the table.

    calibrations: along each axis, the main one first; first: whether its zero is the zero of the displacement.
    min_std_px: see `CameraSensor`.
    """
    sensor = tracking.settings.sensor
    step_s = interval_s(tracking.time_ns)
    coasting_s, lost_s = ages(step_s)
    # Numbers of the channels along each axis, target by target.
    along: list[list[int]] = []
    for axis, camera in enumerate(calibrations):
        along.append([])
        own_s = camera.exposure_s if exposure_s is None else exposure_s
        mappings = camera.mappings()
        noise = [abs(m.scale_m_per_px) * camera.used[k].noise_std_px for k, m in enumerate(mappings)]
        lead = _tilts_with(table, camera, axis)
        best, slow = camera.best_used, _slow_error(camera, step_s, turning=table.turning or camera.tilt_of != "")
        for k, (target, mapping) in enumerate(zip(tracking.targets, mappings, strict=True)):
            zero_std_m = 0.0 if k == best else TEMPLATE_NOISE * float(np.hypot(noise[k], noise[best]))
            channel = Channel(
                sensor=sensor,
                source=camera.source,
                units_per_m=1.0 / mapping.scale_m_per_px,
                target=target.name,
                axis=axis,
                variance_factor=mapping.variance_factor,
                exposure_s=as_first_term(target.chain.blur_s(own_s), table.motion_hz),
                zero_std_m=zero_std_m if first else np.inf,
                coasting_s=coasting_s,
                lost_s=lost_s,
                interval_s=step_s,
                slow_std_m=slow[0],
                slow_time_s=slow[1],
                slow_hz=slow[2],
                slow_walk_m2_s=camera.tilt_walk_px2_s * mapping.scale_m_per_px**2,
                tilt_of="" if lead is None else camera.tilt_of,
                slow_units_per_m=None if lead is None else camera.tilt_ratio * table.channels[lead].units_per_m,
            )
            along[axis].append(table.add(channel))
    _scale(table, along, calibrations)
    every = [number for numbers in along for number in numbers]
    table.clocked(every, clock_std_s(calibrations[0].offset))
    directions = [camera.direction for camera in calibrations]
    rows = list(zip(*along, strict=True))
    levers = [[mapping.lever_px for mapping in camera.mappings()] for camera in calibrations]
    arms = list(zip(*levers, strict=True))
    return CameraSensor(sensor, tracking.chain, rows, directions, step_s=step_s, min_std_px=min_std_px, levers_px=arms)


def _scale(table: Table, along: Sequence[Sequence[int]], calibrations: Sequence[CameraCalibration]) -> None:
    """Put the scale errors of a camera's channels, by their axes, to the table."""
    for axis, (numbers, camera) in enumerate(zip(along, calibrations, strict=True)):
        lead = _tilts_with(table, camera, axis)
        if lead is not None and lead not in numbers:
            table.scaled_with(numbers, lead)
            continue
        # An axis without an accelerometer has the other's scale factor.
        shared = numbers if camera.fused else []
        table.scaled(shared or [*numbers, *along[-1]], camera.relative_std)


def _tilts_with(table: Table, camera: CameraCalibration, axis: int) -> int | None:
    """The first channel of the camera whose tilt another one on its box shows too; None: of no other."""
    channels = enumerate(table.channels)
    return next((k for k, one in channels if one.sensor == camera.tilt_of and one.axis == axis), None)


def _slow_error(camera: CameraCalibration, step_s: float, *, turning: bool) -> tuple[float, float, float]:
    """Standard deviation (m by the first target), time (s) and frequency (Hz) of what moves all of an image.

    turning: whether the tilt, or its rate, is measured: then it goes on from frame to frame.
    """
    if camera.tilt_std_px == 0.0:
        return camera.slow_std_m, camera.slow_time_s, camera.slow_hz
    # Relative to the tilt of the first frame it is as uncertain again.
    std_m = np.sqrt(2.0) * camera.tilt_std_px * abs(camera.mappings()[0].scale_m_per_px)
    if turning:
        return float(std_m), 1.0 / (2.0 * np.pi * TILT_HZ), TILT_HZ
    return float(std_m), TILT_INTERVALS * step_s, 0.0


def radar_chain(
    calibration: RadarCalibration, info: RadarInfo, sensor: str = "radar", moved_m: float = 0.0
) -> tuple[RadarChain, tuple[Channel, ...]]:
    """The stage of the calibrated targets, best first, and one channel each, whose measurements are phases in rad.

    The frames must hold the stage's `bins`: `source.slow_time(chain.bins)`. moved_m: standard deviation of the
    structure's usual displacement.
    """
    bin_m, period_s = bin_m_of(info), 1.0 / info.frame_rate_hz
    targets = tuple(
        FollowedTarget.of(
            target, info.axis.phase_per_m(target.range_m), bin_m, period_s=period_s, bins=info.bins, moved_m=moved_m
        )
        for target in calibration.used
    )
    channels = tuple(
        Channel(
            sensor,
            Source.RADAR,
            units_per_m=item.phase_per_m / item.target.conversion_factor,
            target=str(k + 1),
            variance_factor=calibration.variance_factor,
            zero_std_m=OTHER_ZERO_STD_M if k else first_zero_std_m(item),
        )
        for k, item in enumerate(targets)
    )
    return RadarChain(targets, sensor), channels


def radar_channels(
    table: Table,
    calibration: RadarCalibration,
    info: RadarInfo,
    *,
    sensor: str,
    step_s: float,
    moved_m: float,
    first: bool,
    **_: float,
) -> RadarSensor:
    """A radar's sensor, and its channels in the table.

    step_s: its usual interval; moved_m: standard deviation of the usual displacement; first: whether its zero is that
    of the displacement.
    """
    coasting_s, lost_s = ages(step_s)
    chain, channels = radar_chain(calibration, info, sensor, moved_m)
    numbers = [
        table.add(
            replace(
                channel,
                coasting_s=coasting_s,
                lost_s=lost_s,
                interval_s=step_s,
                zero_std_m=channel.zero_std_m if first else np.inf,
            )
        )
        for channel in channels
    ]
    table.scaled(numbers, calibration.relative_std)
    table.clocked(numbers, clock_std_s(calibration.offset))
    return RadarSensor(sensor, chain, numbers)


def require_same_radar(info: RadarInfo, calibration: RadarCalibration) -> None:
    """UsageError where the calibration belongs to other settings of the radar."""
    if abs(info.carrier_hz / calibration.carrier_hz - 1.0) > SAME_CARRIER:
        made, has = f"at a carrier of {calibration.carrier_hz / 1e9:.6g} GHz", f"{info.carrier_hz / 1e9:.6g} GHz"
        raise UsageError(f"radar: the calibration was made {made}, this recording has {has}. Calibrate again.")
    if info.channels != calibration.channels:
        made, has = f"with {calibration.channels} channels", str(info.channels)
        raise UsageError(f"radar: the calibration was made {made}, this recording has {has}. Calibrate again.")
    bin_m = float(np.median(np.diff(info.range_m))) if info.bins > 1 else np.nan
    for target in calibration.used:
        if target.place_bin > info.bins - 1:
            raise UsageError(
                f"radar: the calibration's target is at bin {target.place_bin:.1f}, this recording has {info.bins} "
                "bins. Calibrate again."
            )
        range_m = info.axis.range_at(target.place_bin)
        if abs(range_m - target.range_m) > SAME_BINS * bin_m:
            raise UsageError(
                f"radar: the calibration's target at {target.range_m:.3f} m would be at {range_m:.3f} m with this "
                "recording's settings. Calibrate again."
            )


def first_zero_std_m(item: FollowedTarget) -> float:
    """Standard deviation of the zero that the best target's first frame gives, m of displacement."""
    bent_m = abs(item.target.conversion_factor) * item.target.bent_rad / item.phase_per_m
    return math.hypot(item.target.noise_m, bent_m)
