"""From a calibrated recording to its measuring point: channels, what is uncertain of each sensor, and the stages."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import hypot, sqrt

import numpy as np

from midspan.calibration.one_clock import OneClock
from midspan.calibration.whitening import BIAS_WALK_RATIO
from midspan.engine.axis import AxisFigures
from midspan.engine.channels import Table, auxiliary_channel, camera_channels, interval_s
from midspan.engine.guard import Guard, GuardSettings
from midspan.engine.merge import Merge
from midspan.engine.point import ACCELEROMETER, Point, Switch
from midspan.engine.sensors import MIN_STD_PX, RadarSensor, Sensor
from midspan.engine.stream import FIRST_NS
from midspan.fusion.estimator import Estimator, Lag
from midspan.fusion.methods import Method, Pass, named
from midspan.fusion.model import EstimatorSettings
from midspan.fusion.on_series import MakeMethod, OnSeries, SeriesMethod, Usual
from midspan.fusion.streams import KalmanSettings, MethodSettings
from midspan.recording.auxiliary import auxiliary_series
from midspan.recording.calibrate import usual_in_window
from midspan.recording.kinds import ROWS
from midspan.recording.streams.recording import Recording
from midspan.recording.tracked import Side, TrackedCamera, known_sensors, offsets_of
from midspan.records import NANOSECONDS, Channel, ClockOffset, Quantity, RangeFrame, Source, Status
from midspan.settings.plausible import tilt_std_m
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.signals.lines import unresolved
from midspan.signals.stamps import frames_used

# What stands in `papers`, above this room: the rule of two cameras.
SWITCH = "midspan.papers.printed.switching:switch_of"
# The bias is known to no better than this many samples' noise, m/s², and this (a tilt of 0.006°); unknown: this.
BIAS_SAMPLES, MIN_BIAS_STD, UNKNOWN_BIAS_STD = 10.0, 1e-3, 0.3
# A bias that drifts is a random walk that is as far off after the first time, s, of the order of the filter's memory,
# and at the start by as much as it drifts in a calibration's minute.
WALK_S, DRIFT_S = 10.0, 60.0


def figures(side: Side, rate_hz: float) -> AxisFigures:
    """What is usual of an axis's acceleration: as calibrated, where the calibration tells it."""
    own = side.calibration
    return replace(
        own.usual or usual_in_window(side.recording),
        noise_density=own.noise_density(rate_hz),
        motion_noise_s=own.motion_noise_s,
        name=f"accelerometer ({side.recording.accelerometer.file})",
        gain=own.accelerometer_scale,
    )


def bias_std(side: Side) -> float:
    """How well the bias is known at the start, m/s²."""
    own = side.calibration
    known = own.bias_std_m_s2 if np.isfinite(own.bias_std_m_s2) else UNKNOWN_BIAS_STD
    noise, drift = BIAS_SAMPLES * own.noise_std_m_s2, DRIFT_S * own.bias_drift_m_s3
    return float(np.linalg.norm((noise, MIN_BIAS_STD, drift, known)))


def bias_walk(side: Side) -> float:
    """Density of the bias's random walk, (m/s²)²/s: as its noise was estimated with, and what it drifts by."""
    if not side.recording.fused:
        return KalmanSettings().bias_walk
    known = figures(side, side.prepared.rate_hz)
    noise = BIAS_WALK_RATIO * (known.noise_density + known.motion_noise_s * known.variance)
    return max(KalmanSettings().bias_walk, noise + WALK_S * side.calibration.bias_drift_m_s3**2)


def clock_offsets_ns(main: Side, tracked_cameras: Sequence[TrackedCamera]) -> dict[str, int]:
    """What is added to each sensor's stamps (ns) to get the accelerometer's clock."""
    return {name: round(NANOSECONDS * offset.value_s) for name, offset in offsets_of(main, tracked_cameras).items()}


def radar_frames(recording: Recording, radar: RadarSensor) -> Iterator[RangeFrame]:
    """A radar's frames in the bins of its stage."""
    margin_ns = round(recording.max_offset_s * NANOSECONDS)
    used = frames_used(recording.radar.times_ns(), recording.prepared.time_ns, margin_ns)
    for block in recording.radar.slow_time(radar.chain.bins, used.start, used.stop):
        yield from block


def zero_instant(
    main: Side,
    tracked_cameras: Sequence[TrackedCamera],
    sensors: Mapping[str, Sensor],
    ran: Mapping[str, OneClock] | None = None,
) -> int | None:
    """The instant (ns) that the displacement counts from: a camera's first frame, at its target's row, or a radar's;
    None: the sensor's own zero.

    sensors: the stages by name. ran: how the sensors' clocks ran, by name, where that is known. Of two cameras the
    first one's; where that one was dark when it began, the first frame of either.
    """
    offsets_ns = clock_offsets_ns(main, tracked_cameras)
    firsts = [(tracked_camera.sensor, tracked_camera.zero_ns) for tracked_camera in tracked_cameras]
    if not tracked_cameras:
        # The first sensor's zero is that of the displacement.
        view, radar = next((view, sensors[view.sensor]) for view, _ in known_sensors(main))
        if isinstance(radar, RadarSensor):
            # Its phase counts from the first frame used, which is looked for and given up again.
            before = radar.chain.state
            seen = (one for frame in radar_frames(view, radar) for one in radar.chain.push(frame))
            first = next((one for one in seen if one.status == Status.TRACKING), None)
            radar.chain.restore(before)
            firsts = [] if first is None else [(view.sensor, (*first.earlier, first)[0].time_ns)]
    stamps = [
        stamp if ran is None else ran[name].first_ns(stamp)
        for name, stamp in ((name, stamp + offsets_ns[name]) for name, stamp in firsts)
    ]
    return min(stamps) if tracked_cameras and tracked_cameras[0].begins_dark else next(iter(stamps), None)


def tilting(channels: Sequence[Channel]) -> Channel | None:
    """The first target of the first camera along the main axis, whose tilt moves all of an image; None without one."""
    cameras = (Source.CAMERA, Source.INFRARED)
    return next((one for one in channels if one.source in cameras and one.axis == 0), None)


def unseen_std_m(main: Side, tracked_cameras: Sequence[TrackedCamera], axis: int) -> float:
    """What the tilt of the cameras, their contradiction of the accelerometer and its logger's low-pass make of the
    displacement along an axis, m: of several the most.
    """
    seen = []
    for tracked_camera in tracked_cameras:
        camera, known = tracked_camera.view.settings.camera, tracked_camera.calibrations[axis]
        seen.append(hypot(0.0 if camera is None else tilt_std_m(camera, known), known.apart_std_m))
        # By the focal length's error the tilt that is taken off is too large or too small.
        turning = main.calibration.helped_by("gyroscope") if len(seen) == 1 and len(known.used) == 1 else None
        if turning is not None:
            off = turning.focal_std_px / turning.focal_px * known.tilt_std_px
            seen[-1] = hypot(seen[-1], off * abs(known.scale.value_m_per_px))
    # A displacement sensor's own zero has no part of it, and each row holds it once, not twice.
    lost = [known.apart_std_m / sqrt(2.0) for _, known in known_sensors(main) if known.kind == Source.DISPLACEMENT.word]
    return max((*seen, *(lost if axis == 0 else ())), default=0.0)


def estimator_settings(
    table: Table, sides: Sequence[Side], tracked_cameras: Sequence[TrackedCamera], sensors: Mapping[str, Sensor]
) -> EstimatorSettings:
    """What the estimator is given of a recording's axes and sensors."""
    # What else is in the bin of a radar's best target makes an error of its phase at the zero, m: it does not average
    # out while the structure is where it was.
    known = [one for _, one in known_sensors(sides[0])][:1]
    bent_m = known[0].bent_m if not tracked_cameras and known and known[0].kind == Source.RADAR.word else 0.0
    return EstimatorSettings(
        channels=tuple(table.channels),
        axes=len(sides),
        parameters=tuple(table.parameters),
        bias_m_s2=tuple(side.calibration.bias_m_s2 / side.calibration.accelerometer_scale for side in sides),
        bias_std_m_s2=tuple(bias_std(side) for side in sides),
        bias_walk=max(bias_walk(side) for side in sides),
        motion=tuple(figures(side, 1.0).motion if side.recording.fused else (0.0, 0.0) for side in sides),
        zero_ns=zero_instant(sides[0], tracked_cameras, sensors),
        misfit=tuple(side.calibration.misfit for side in sides),
        lean=tuple(GRAVITY_M_S2 * side.calibration.slope for side in sides),
        unseen_std_m=tuple(unseen_std_m(sides[0], tracked_cameras, axis) for axis in range(len(sides))),
        unseen_zero_std_m=(bent_m, *(0.0 for _ in sides[1:])),
    )


def guard_of(sides: Sequence[Side], rate_hz: float) -> Guard:
    """The guard of the accelerometer's axes, which knows where lines that are taken out are not resolved."""
    usual = tuple(figures(side, rate_hz) for side in sides if side.recording.fused)
    main = sides[0]
    return Guard(GuardSettings(rate_hz, usual, doubtful=unresolved(main.prepared.time_ns, main.recording.lines)))


def measuring_point(
    sides: Sequence[Side],
    tracked_cameras: Sequence[TrackedCamera],
    method: Method,
    wanted: MethodSettings,
    *,
    given: bool = False,
    log: bool = True,
    wait_s: tuple[float, float] = (np.inf, np.inf),
) -> Point:
    """The point of a recording's axes and sensors that gives a method's rows.

    log: keep what was decided, for a second pass over the whole. wait_s: how long other streams are waited for behind
    the accelerometer's, and after what silence no longer; those of a recording for ever.
    """
    main = sides[0]
    recording, usual = main.recording, main.calibration.usual or usual_in_window(main.recording)
    gain_stds = tuple(side.calibration.accelerometer_scale_std for side in sides)
    on_series = method.takes_series(literal=wanted.literal)
    known = {one.kind: one for one in main.calibration.auxiliary}
    helping = {} if on_series else auxiliary_series(recording, main.calibration.auxiliary)
    turning = any(known[kind].measures in (Quantity.TILT, Quantity.TILT_RATE) for kind in helping)
    table = Table(given=given, motion_hz=usual.dominant_hz, gain_std=gain_stds, turning=turning)
    # As printed, the filter's own deviation bounds the search, however small it is.
    min_std_px = 0.0 if on_series and method.predicts else MIN_STD_PX
    sensors = _stages(table, main, tracked_cameras, usual.moved_m, min_std_px)
    table.by_first_terms()
    tilts = tilting(table.channels)
    for kind, series in helping.items():
        time_ns = series.time_ns[np.isfinite(series.value)]
        sensor = auxiliary_channel(table, known[kind], time_ns, tilts, recording.axis)
        sensors |= {} if sensor is None else {kind: sensor}
    stds = [side.calibration.gain_std(recording.accelerometer.scale_std, given=given) for side in sides]
    table.gain(stds, estimated=recording.accelerometer.estimate_scale)
    offsets_ns = clock_offsets_ns(main, tracked_cameras)
    settings = estimator_settings(table, sides, tracked_cameras, sensors)
    if method.follows_noise:
        settings = replace(settings, noise_memory=wanted.noise_memory)
    merge = Merge([ACCELEROMETER, *sensors], *wait_s)
    for name in sensors:
        merge.push(ClockOffset(name, offsets_ns[name], FIRST_NS))
    rate_hz = 1.0 / interval_s(main.recording.acceleration.time_ns)
    guard = guard_of(sides, rate_hz)
    unmeasured = [side.calibration.noise_density(rate_hz) for side in sides if not side.recording.fused]
    one_at_a_time = recording.settings.fusion.switching == "matches" and len(tracked_cameras) > 1
    switch: Switch | None = named(SWITCH)(recording, tracked_cameras) if one_at_a_time else None
    estimator: Estimator | Lag | OnSeries
    if on_series:
        names = list(sensors) if switch is not None else list(sensors)[:1]
        methods = [_along(side, named(method.on_series), wanted, settings, names[0]) for side in sides]
        estimator = OnSeries(settings, methods, names, log=log)
    elif method.rows is Pass.LAGGED:
        estimator = Lag(settings, max(1, round(wanted.lag_s * rate_hz)))
    else:
        estimator = Estimator(settings, log=log)
    return Point(merge, guard, sensors, estimator, unmeasured, switch)


def _stages(
    table: Table, main: Side, tracked_cameras: Sequence[TrackedCamera], moved_m: float, min_std_px: float
) -> dict[str, Sensor]:
    """The stages of all sensors that tell where the structure is, by name, and their channels in the table."""
    sensors: dict[str, Sensor] = {}
    for number, tracked_camera in enumerate(tracked_cameras):
        sensors[tracked_camera.sensor] = camera_channels(
            table,
            tracked_camera.tracking,
            tracked_camera.calibrations,
            tracked_camera.view.exposure_s,
            first=number == 0,
            min_std_px=min_std_px,
        )
    for view, known in known_sensors(main):
        more = {"moved_m": moved_m, "first": not sensors, "bias_m_s2": main.kalman.bias}
        sensors[view.sensor] = ROWS[view.kind].stage(table, view, known, **more)
    return sensors


def _along(
    side: Side, make: MakeMethod, wanted: MethodSettings, settings: EstimatorSettings, sensor: str
) -> SeriesMethod | None:
    """The method of one series along an axis; None where nothing is felt along it."""
    if not side.recording.fused:
        return None
    moved_m, omega = figures(side, side.prepared.rate_hz).motion
    frame_s = next(one.interval_s for one in settings.channels if one.sensor == sensor)
    usual = Usual(interval_s(side.recording.acceleration.time_ns), frame_s, omega * moved_m)
    return make(replace(wanted, kalman=side.kalman), usual)
