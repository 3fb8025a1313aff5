"""From a calibrated recording to its measuring point: channels, what is uncertain of each sensor, and the stages."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from midspan.engine.axis import AxisFigures
from midspan.engine.guard import Guard, GuardSettings
from midspan.engine.merge import Merge
from midspan.engine.order import FIRST_NS
from midspan.engine.plain import PlainChain, PlainSettings
from midspan.engine.point import ACCELEROMETER, Point
from midspan.engine.sensors import CameraSensor, PlainSensor, RadarSensor, Sensor
from midspan.engine.switching import Switch
from midspan.fusion.estimator import Estimator
from midspan.fusion.model import EstimatorSettings, Parameter, ParameterKind
from midspan.fusion.second_pass import Lag
from midspan.recording.calibrate import usual_in_window
from midspan.recording.cameras.tracked import Eye, Known, Side, clock_std_s, known_sensors, offsets_of
from midspan.recording.radar.chain import radar_chain
from midspan.recording.stored.displacement import DisplacementCalibration
from midspan.recording.stored.radar import RadarCalibration
from midspan.recording.streams.measured import frames_used
from midspan.recording.streams.recording import Recording
from midspan.records import NANOSECONDS, Channel, ClockOffset, Nanoseconds, Source
from midspan.signals.stuck import resolution

# Rows are coasting when the last accepted measurement is older than this many of the sensor's usual intervals; they
# are lost after this many, and after this many seconds at least.
COASTING_INTERVALS, LOST_INTERVALS, MIN_COASTING_S, MIN_LOST_S = 2.5, 10.0, 0.05, 10.0
# The usual interval of a stream is the median between so many stamps at its beginning: jitter of a tenth of an interval
# then changes it by a hundredth.
FIRST_STAMPS = 100
# Noise of a target's reference frame over the noise of a frame, as standard deviations (see `vision/usual.py`).
REFERENCE_NOISE = 1.15
# Density of the random walk of a radar's clock beside the accelerometer's, s²/s: it follows a drift of 60 ppm at once.
CLOCK_WALK = 3.6e-9
# The bias is known to no better than this many samples' noise, m/s², and this (a tilt of 0.006°); unknown: this.
BIAS_SAMPLES, MIN_BIAS_STD, UNKNOWN_BIAS_STD = 10.0, 1e-3, 0.3


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


def camera_channels(table: Table, eye: Eye, *, first: bool) -> CameraSensor:
    """A camera's sensor, and its channels in the table; first: whether its zero is the zero of the displacement."""
    coasting_s, lost_s = ages(interval_s(eye.tracking.time_ns))
    rows: list[list[int]] = [[] for _ in eye.tracking.targets]
    along: list[list[int]] = []
    for axis, camera in enumerate(eye.calibrations):
        along.append([])
        mappings = camera.mappings()
        noise = [abs(m.scale_m_per_px) * camera.used[k].noise_std_px for k, m in enumerate(mappings)]
        best = int(np.argmin(noise))
        for k, (target, mapping) in enumerate(zip(eye.tracking.targets, mappings, strict=True)):
            zero_std_m = 0.0 if k == best else REFERENCE_NOISE * float(np.hypot(noise[k], noise[best]))
            channel = Channel(
                sensor=eye.sensor,
                source=eye.source,
                units_per_m=1.0 / mapping.scale_m_per_px,
                target=target.name,
                axis=axis,
                variance_factor=mapping.variance_factor,
                exposure_s=target.chain.blur_s(eye.view.exposure_s),
                zero_std_m=zero_std_m if first else np.inf,
                coasting_s=coasting_s,
                lost_s=lost_s,
            )
            rows[k].append(table.add(channel))
            along[axis].append(rows[k][-1])
    for numbers, camera in zip(along, eye.calibrations, strict=True):
        # An axis without an accelerometer has the other's scale factor.
        shared = numbers if camera.fused else []
        table.uncertain(ParameterKind.SCALE_ERROR, shared or [*numbers, *along[-1]], camera.relative_std)
    every = [number for numbers in along for number in numbers]
    table.uncertain(ParameterKind.CLOCK_OFFSET, every, clock_std_s(eye.calibrations[0].offset))
    return CameraSensor(eye.sensor, eye.tracking.chain, rows, [camera.direction for camera in eye.calibrations])


def plain_channel(table: Table, own: Known, *, moved_m: float, first: bool) -> PlainSensor:
    """A displacement sensor, and its channel in the table; first: whether its zero is the zero of the displacement."""
    known: DisplacementCalibration = own.calibration
    series = own.view.displacement
    step_s = interval_s(series.time_ns)
    coasting_s, lost_s = ages(step_s)
    channel = table.add(
        Channel(
            sensor=own.sensor,
            source=Source.DISPLACEMENT,
            units_per_m=1.0,
            zero_std_m=0.0 if first else np.inf,
            coasting_s=coasting_s,
            lost_s=lost_s,
        )
    )
    table.uncertain(ParameterKind.SCALE_ERROR, [channel], known.relative_std)
    table.uncertain(ParameterKind.CLOCK_OFFSET, [channel], clock_std_s(known.offset))
    settings = PlainSettings(
        name=own.sensor,
        channel=channel,
        variance_m2=known.noise_std_m**2,
        step_s=step_s,
        resolution_m=resolution(known.scale * series.value) if known.resolution_m is None else known.resolution_m,
        scale=known.scale,
    )
    return PlainSensor(own.sensor, PlainChain(settings))


def radar_channels(table: Table, own: Known, *, moved_m: float, first: bool) -> RadarSensor:
    """A radar's sensor, and its channels in the table.

    moved_m: standard deviation of the usual displacement; first: whether its zero is that of the displacement.
    """
    known: RadarCalibration = own.calibration
    coasting_s, lost_s = ages(interval_s(own.view.radar.times_ns()))
    chain, channels = radar_chain(known, own.view.radar.info, own.sensor, moved_m)
    numbers = [
        table.add(
            replace(channel, coasting_s=coasting_s, lost_s=lost_s, zero_std_m=channel.zero_std_m if first else np.inf)
        )
        for channel in channels
    ]
    table.uncertain(ParameterKind.SCALE_ERROR, numbers, known.relative_std)
    clock = ParameterKind.CLOCK_OFFSET
    table.parameters.append(Parameter(clock, tuple(numbers), clock_std_s(known.offset), 0, CLOCK_WALK))
    return RadarSensor(own.sensor, chain, numbers)


# The stage of sensors that are no cameras, by their kind.
STAGES: dict[str, Callable[..., Sensor]] = {"radar": radar_channels, "displacement": plain_channel}


def figures(side: Side, rate_hz: float) -> AxisFigures:
    """What is usual of an axis's acceleration: as calibrated, where the calibration tells it."""
    known = side.calibration.usual or usual_in_window(side.recording)
    name = f"accelerometer ({side.recording.accelerometer.file})"
    return replace(known, noise_density=side.calibration.noise_density(rate_hz), name=name)


def bias_std(side: Side) -> float:
    """How well the bias is known at the start, m/s²."""
    known = side.calibration.bias_std_m_s2
    noise = BIAS_SAMPLES * side.calibration.noise_std_m_s2
    return float(np.hypot(np.hypot(noise, MIN_BIAS_STD), known if np.isfinite(known) else UNKNOWN_BIAS_STD))


def clock_offsets_ns(main: Side, eyes: Sequence[Eye]) -> dict[str, int]:
    """What is added to each sensor's stamps (ns) to get the accelerometer's clock."""
    return {name: round(NANOSECONDS * offset.value_s) for name, offset in offsets_of(main, eyes).items()}


def radar_frames_used(recording: Recording) -> slice:
    """The frames of a view's radar that are used."""
    margin_ns = round(recording.max_offset_s * NANOSECONDS)
    return frames_used(recording.radar.times_ns(), recording.prepared.time_ns, margin_ns)


def zero_instant(main: Side, eyes: Sequence[Eye]) -> int | None:
    """The instant (ns) that the displacement counts from: a camera's first frame; None: the sensor's own zero.

    Of two cameras the first one's; where that one was dark when it began, the first frame of either. A radar's phase
    counts from its first frame, whose noise is in its zero.
    """
    if not eyes:
        return None
    offsets_ns = clock_offsets_ns(main, eyes)
    firsts = [int(eye.tracking.time_ns[0]) + offsets_ns[eye.sensor] for eye in eyes]
    return min(firsts) if eyes[0].begins_dark else firsts[0]


def estimator_settings(table: Table, sides: Sequence[Side], zero_ns: int | None) -> EstimatorSettings:
    """What the estimator is given of a recording's axes and sensors."""
    return EstimatorSettings(
        channels=tuple(table.channels),
        axes=len(sides),
        parameters=tuple(table.parameters),
        bias_m_s2=tuple(side.calibration.bias_m_s2 for side in sides),
        bias_std_m_s2=tuple(bias_std(side) for side in sides),
        motion=tuple(figures(side, 1.0).motion if side.recording.fused else (0.0, 0.0) for side in sides),
        zero_ns=zero_ns,
    )


def measuring_point(
    sides: Sequence[Side], eyes: Sequence[Eye], *, lag_s: float | None = None, noise_memory: float | None = None
) -> Point:
    """The point of a recording's axes and sensors.

    lag_s: rows are given out so much later, smoothed; noise_memory: measurements over which their noise is followed.
    """
    main, table = sides[0], Table()
    recording = main.recording
    moved_m = (main.calibration.usual or usual_in_window(recording)).moved_m
    sensors: dict[str, Sensor] = {}
    for number, eye in enumerate(eyes):
        sensors[eye.sensor] = camera_channels(table, eye, first=number == 0)
    for own in known_sensors(main):
        sensors[own.sensor] = STAGES[own.view.kind](table, own, moved_m=moved_m, first=not sensors)
    offsets_ns = clock_offsets_ns(main, eyes)
    settings = estimator_settings(table, sides, zero_instant(main, eyes))
    settings = settings if noise_memory is None else replace(settings, noise_memory=noise_memory)
    merge = Merge([ACCELEROMETER, *sensors], lateness_s=np.inf, silent_s=np.inf)
    for name in sensors:
        merge.push(ClockOffset(name, offsets_ns[name], FIRST_NS))
    measured = [side for side in sides if side.recording.fused]
    rate_hz = 1.0 / interval_s(main.recording.acceleration.time_ns)
    guard = Guard(GuardSettings(rate_hz, tuple(figures(side, rate_hz) for side in measured)))
    unmeasured = [side.calibration.noise_density(rate_hz) for side in sides if side not in measured]
    one_at_a_time = recording.settings.fusion.switching == "matches" and len(eyes) > 1
    switch = Switch((eyes[0].sensor, eyes[1].sensor)) if one_at_a_time else None
    lag = None if lag_s is None else max(1, round(lag_s * rate_hz))
    estimator = Estimator(settings, log=True) if lag is None else Lag(settings, lag)
    return Point(merge, guard, sensors, estimator, unmeasured, switch)
