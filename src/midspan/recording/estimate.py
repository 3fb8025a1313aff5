"""`estimate`: the main job, from a recording to displacement at the accelerometer's rate with its error band."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from midspan.calibration.accelerometer_clock import refuse_forward_step
from midspan.calibration.displacement.learn import MANY_LEFT_OUT
from midspan.calibration.displacement.wrong_values import WrongValues, wrong_values
from midspan.calibration.one_clock import OneClock
from midspan.calibration.scale_check import Sensed, fitting
from midspan.calibration.unfelt import (
    measured_rows,
    refuse_contradicted,
    refuse_lost_cycles,
    refuse_steps_unseen,
    refuse_unfelt,
    refuse_wide,
)
from midspan.checks import option, path_of
from midspan.engine.channels import interval_s, without_gain
from midspan.engine.point import Point
from midspan.engine.row_messages import REPORTED, event_warnings, radar_warnings, shares, unmeasured_ends
from midspan.engine.second_look import (
    clocks,
    left_out_event,
    on_clock,
    on_its_clock,
    once_more,
    ran_apart,
    with_scales,
    without_steps,
)
from midspan.engine.sensor_series import CameraResult, SensorSeries, camera_result, camera_series, series_at_instants
from midspan.engine.sensors import Sensor
from midspan.engine.tracking import CameraTracking
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.fusion.blocks import REJECTED, joined_rows
from midspan.fusion.estimator import Estimator, Lag
from midspan.fusion.methods import METHODS, Method, Pass, no_literal_form
from midspan.fusion.model import EstimatorSettings
from midspan.fusion.on_series import OnSeries
from midspan.fusion.streams import MethodSettings
from midspan.notices import Notice, once
from midspan.progress import Progress, silent
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.kinds import ROWS
from midspan.recording.messages import (
    left_out,
    no_overlap,
    refuse_rejections,
    refuse_run_away,
    require_same_sensors,
    uncalibrated,
)
from midspan.recording.point import figures, measuring_point, zero_instant
from midspan.recording.pose import Rows, camera_pose
from midspan.recording.result import Result
from midspan.recording.run import Blocks, Outcome, run, used_when
from midspan.recording.streams.recording import Recording, naming, opened
from midspan.recording.tracked import (
    Side,
    TrackedCamera,
    clocks_shared,
    known_sensors,
    open_tracked_cameras,
    side_of,
)
from midspan.records import Estimate, Event, Innovation, Readings, Source, part
from midspan.settings.kinds import KINDS
from midspan.settings.messages import renamed
from midspan.settings.stored.calibration import Calibration, load_calibration
from midspan.settings.two_files import (
    Choices,
    draft,
    in_words_of_two_files,
    is_second_file,
    is_sensor_file,
    settings_of,
)
from midspan.signals.stamps import inside, shown
from midspan.sources.accelerometer.phone import is_phone_log

# Events of a first pass that may come of values that are wrong.
CONTRADICTS = frozenset({"rejected", "clock", "level_shift", "acceleration", "reacquired", "frozen", "lost", "noise"})


def estimate(
    recording: Recording | str | Path,
    calibration: Calibration | str | Path | None = None,
    *,
    method: str | None = None,
    tracking: CameraTracking | None = None,
    given: bool | None = None,
    video: str | Path | None = None,
    value: str | None = None,
    unit: str | None = None,
    direction: str | None = None,
    rate_hz: float | None = None,
    displacement_value: str | None = None,
    displacement_unit: str | None = None,
    progress: Progress = silent,
) -> Result:
    """Estimate the displacement of a recording (or its path), or of two files: `estimate(ACCEL, FILE2)`.

    calibration: or its file; left out, it is made first (and the camera is tracked once for both). method: a name of
    `midspan methods`, over the recording's own. tracking: what `calibrate_and_track` left, to go on with. given:
    whether the calibration is that of another record; left out: where there is no tracking. video: with an
    accelerometer's file as `recording`, a video or a displacement sensor's table; the second argument is taken for it,
    and a phone's log may hold it.
    value to displacement_unit: with two files, see `Choices` of midspan.settings.two_files. Returns one row
    for each accelerometer sample in the streams' common span. Raises UntrustedError when calibration is refused,
    DataError for unusable streams.
    """
    if video is None and is_sensor_file(recording) and is_second_file(calibration):
        video, calibration = calibration, None
    if calibration is not None and not isinstance(calibration, Calibration):
        calibration = load_calibration(path_of("calibration", calibration))
    choices = Choices(value, unit, direction, rate_hz, displacement_value, displacement_unit)
    if video is not None or is_phone_log(recording):
        accel, second = path_of("recording", recording), None if video is None else path_of("video", video)
        with in_words_of_two_files(accel, second):
            files = Recording(*settings_of(draft(accel, second, choices)))
            return estimate(files, calibration, method=method, progress=progress)
    if choices != Choices():
        raise UsageError(
            f"{', '.join(choices.named)}: go with two files, estimate(ACCEL, FILE2); a recording names them in its "
            "settings."
        )
    recording = opened(recording)
    # The method is checked first: tracking may take long.
    method = option("method", method or recording.settings.fusion.method, METHODS)
    if recording.settings.fusion.literal and not METHODS[method].literal:
        raise UsageError(f"{recording.file}: fusion: {no_literal_form(method)}.")
    given = (calibration is not None and tracking is None) if given is None else given
    if calibration is not None and tracking is None:
        recording = recording.by_pose()
    if calibration is None:
        calibration, tracking = calibrate_and_track(recording.by_pose(), progress)
    recording = recording.without_lines(calibration.lines)
    with naming(recording):
        require_same_sensors(recording, calibration)
        return _estimate(Asked(recording, calibration, method, given), tracking, progress)


@dataclass(frozen=True, slots=True)
class Asked:
    """The recording, its calibration and whether that was given (not estimated on this recording just now), method."""

    recording: Recording
    calibration: Calibration
    method: str
    given: bool

    @property
    def row(self) -> Method:
        """What the method needs."""
        return METHODS[self.method]

    @property
    def on_series(self) -> bool:
        """Whether the method takes one series of displacements."""
        return self.row.takes_series(literal=self.recording.settings.fusion.literal)

    @property
    def by_settings(self) -> MethodSettings:
        """What the recording says of methods."""
        return self.recording.settings.fusion.of_method()

    def point(self, sides: Sequence[Side], tracked_cameras: Sequence[TrackedCamera], **how: Any) -> Point:
        """The point that gives the method's rows; how: further arguments of `measuring_point`."""
        return measuring_point(sides, tracked_cameras, self.row, self.by_settings, given=self.given, **how)

    @property
    def sides(self) -> tuple[Side, ...]:
        """The axes, the main one first."""
        sides = [side_of(self.recording, self.calibration)]
        if self.recording.across is not None and self.calibration.across is not None:
            sides.append(side_of(self.recording.across, self.calibration.across))
        return tuple(sides)


@dataclass(frozen=True, slots=True)
class FirstPass:
    """What the engine gave, record by record: the axes, the cameras, the estimator and what came out of it.

    cameras: the same as plain data; series: what each sensor measured along each axis, by its name; wrong: the values
    of a displacement sensor that the whole record shows to be wrong, by its name.
    """

    sides: tuple[Side, ...]
    tracked_cameras: tuple[TrackedCamera, ...]
    estimator: Estimator | Lag | OnSeries
    sensors: Mapping[str, Sensor]
    outcome: Outcome
    cameras: tuple[CameraResult, ...]
    series: tuple[dict[str, SensorSeries], ...]
    wrong: Mapping[str, WrongValues] = field(default_factory=dict)

    @property
    def delay_s(self) -> float:
        """By how much a row needs what comes later, s."""
        return self.estimator.lag_samples * interval_s(self.sides[0].recording.acceleration.time_ns)

    @property
    def seen(self) -> tuple[tuple[CameraResult, TrackedCamera], ...]:
        """The cameras with their tracking."""
        return tuple(zip(self.cameras, self.tracked_cameras, strict=True))

    @property
    def swayed(self) -> tuple[str, ...]:
        """Cameras whose only target moves by a tilt, which inertial sensors tell, and not by the displacement alone."""
        known = [
            (camera.sensor, camera.calibrations[0].tilt_std_px) for camera in self.cameras if len(camera.targets) < 2
        ]
        return tuple(name for name, tilt_px in known if tilt_px > 0.0)

    def at_instants(self, axis: int) -> dict[str, SensorSeries]:
        """The series along an axis, without what the sensors' exposures take from fast motion, and without values that
        are wrong.
        """
        series = dict(self.series[axis])
        for name, wrong in self.wrong.items() if axis == 0 else ():
            one = series[name]
            series[name] = replace(one, value_m=np.where(np.isin(one.time_ns, wrong.stamps), np.nan, one.value_m))
        return series_at_instants(series, self.estimator.settings.channels, axis, self.sides[axis].acceleration)


@dataclass(frozen=True, slots=True)
class Checked:
    """Whether the calibration fits: warnings, and whether the second axis is left out.

    scale_std: relative standard deviation of each sensor's scale along each axis, with what a given one is off by.
    """

    warnings: tuple[Notice, ...]
    scale_std: tuple[dict[str, float], ...]
    left_out: bool


@dataclass(frozen=True, slots=True)
class Found:
    """Rows, innovations and the zero's variance along each axis, when each sensor was used, events, warnings, delay."""

    rows: tuple[Estimate, ...]
    innovations: tuple[Innovation, ...]
    zero_variance_m2: tuple[float, ...]
    used: dict[str, list[tuple[int, int]]]
    events: tuple[Event, ...]
    warnings: tuple[Notice, ...]


def _estimate(asked: Asked, tracking: CameraTracking | None, progress: Progress) -> Result:
    first = first_pass(asked, tracking, progress)
    progress(0, 1, "fusing")
    looks, ran = asked.row.rows is Pass.SMOOTHED, dict[str, OneClock]()
    wrong = wrong_of(first)
    if looks or asked.given:
        ran = clocks_of(replace(first, wrong=wrong))
        apart = {name for name in wrong if ran_apart(ran[name])}
        if apart:
            # A clock that jumps or drifts explains the values.
            wrong = {name: one for name, one in wrong.items() if name not in apart}
            ran = clocks_of(replace(first, wrong=wrong))
    if looks:
        first = replace(first, wrong=wrong)
    else:
        refuse_followed(first, wrong)
    checked = check(asked, first, ran)
    if looks:
        found = smoothed(first, ran, checked)
    else:
        found = _found(first, first.outcome, tuple(first.outcome.estimate(axis) for axis in range(len(first.sides))))
    progress(1, 1, "fusing")
    return result_of(asked, first, replace(found, warnings=(*checked.warnings, *found.warnings)), checked)


def first_pass(asked: Asked, tracking: CameraTracking | None, progress: Progress) -> FirstPass:
    """All records of the recording through its point."""
    sides = asked.sides
    tracked_cameras = open_tracked_cameras(sides, tracking, progress)
    point = asked.point(sides, tracked_cameras)
    outcome = run(point, sides, tracked_cameras)
    for tracked_camera in tracked_cameras:
        tracked_camera.tracking.close()
    if not any(len(rows.estimates[0].time_ns) for rows in outcome.rows if rows.estimates):
        raise DataError(no_overlap(asked.recording, outcome.measured_ns))
    events, series = outcome.events_of, []
    cameras = tuple(
        camera_result(
            tracked_camera.tracking,
            tracked_camera.sensor,
            tracked_camera.calibrations,
            events.get(tracked_camera.sensor, ()),
        )
        for tracked_camera in tracked_cameras
    )
    for axis in range(len(sides)):
        rows = outcome.estimate(axis)
        series.append({camera.sensor: camera_series(camera, rows, axis) for camera in cameras})
        for view, known in known_sensors(sides[0]) if axis == 0 else ():
            log = (outcome.measured_by(view.sensor), point.estimator.settings.channels, rows)
            series[0][view.sensor] = ROWS[view.kind].series(view, known, log)
    return FirstPass(sides, tracked_cameras, point.estimator, point.sensors, outcome, cameras, tuple(series))


# Of the values that are wrong.
MOST = 0.5


def clocks_of(first: FirstPass) -> dict[str, OneClock]:
    """How the sensors' clocks ran, by the values that are not wrong."""
    main, series = first.sides[0], first.at_instants(0)
    swayed = {name: OneClock(series.pop(name).displacement) for name in first.swayed}
    return swayed | clocks(series, main.acceleration, main.kalman, clocks_shared(main))


def wrong_of(first: FirstPass) -> dict[str, WrongValues]:
    """As of `FirstPass`, where the first pass met values that contradict the acceleration."""
    events = [*first.outcome.fusion_events, *first.outcome.sensor_events]
    if not any(event.kind in CONTRADICTS for event in events):
        return {}
    main, found = first.sides[0], {}
    for view, _ in known_sensors(main):
        if KINDS[view.kind].brings is Readings:
            measured = first.series[0][view.sensor].displacement
            wrong = wrong_values(measured, main.acceleration)
            if len(wrong.stamps):
                found[view.sensor] = wrong
    return with_first_values(first, found, events)


# What the estimator cannot decide among many wrong values: whether a zero or the acceleration is wrong.
UNSETTLED = ("level_shift", "acceleration", "reacquired")
# Where it finds such a cause, or a clock's step, among a sensor's first values, those before were wrong: the zero is
# that of the others.
ANEW = ("clock", *UNSETTLED)
FIRST_VALUES, MAX_FIRST_SHARE = 50, 0.1
# So often at most: what follows the first ones may be wrong in another way.
MAX_BEGUN = 3


def with_first_values(
    first: FirstPass, wrong: Mapping[str, WrongValues], events: Sequence[Event]
) -> dict[str, WrongValues]:
    """The wrong values with the first ones of a displacement sensor that is alone, by a pass' events."""
    (name, series), *others = first.series[0].items()
    time_ns, found = series.time_ns, dict(wrong)
    last = int(min(FIRST_VALUES, MAX_FIRST_SHARE * len(time_ns)))
    anew_ns = [event.time_ns for event in events if event.kind in ANEW and event.time_ns <= time_ns[last]]
    if series.source == Source.DISPLACEMENT and not others and anew_ns:
        known = found.get(name, WrongValues(time_ns[:0], time_ns[:0]))
        found[name] = replace(known, held=np.union1d(known.held, time_ns[time_ns < max(anew_ns)]))
    return found


def refuse_unsettled(first: FirstPass, found: Found) -> None:
    """UntrustedError where values contradict the acceleration for long besides a crowd of outliers."""
    events = [event for event in found.events if event.kind in UNSETTLED]
    for name, wrong in first.wrong.items():
        share = len(wrong.crowd) / max(len(first.series[0][name].time_ns), 1)
        if share and events:
            raise UntrustedError(
                f"{name}: {100 * share:.0f} % of its values contradict the acceleration and its other values; without "
                f"them the sensors still contradict each other at {shown(events[0].time_ns)}. The sensor may measure "
                "something else at times, or its zero may step. Cut the recording to a part in which it follows the "
                "structure."
            )


def refuse_followed(first: FirstPass, wrong: Mapping[str, WrongValues]) -> None:
    """UntrustedError where a causal method has accepted most of very many values that are wrong, by sensor."""
    for name, stamps in ((name, one.stamps) for name, one in wrong.items()):
        measured = first.outcome.measured_by(name)
        share = len(stamps) / max(len(measured.time_ns), 1)
        channels = np.unique(measured.channel)
        accepted = [one.time_ns[one.verdict != REJECTED] for one in map(first.outcome.innovation, channels.tolist())]
        if share > MANY_LEFT_OUT and np.mean(np.isin(stamps, np.concatenate(accepted))) > MOST:
            raise UntrustedError(
                f"{name}: {100 * share:.0f} % of its values contradict the acceleration and its other values, and "
                "this causal method accepted most of them. Use the method smoother, or cut the recording to a part in "
                "which the sensor follows the structure."
            )


def check(asked: Asked, first: FirstPass, ran: Mapping[str, OneClock]) -> Checked:
    """What the whole record says of a given calibration; ran: how the sensors' clocks ran."""
    stated = tuple(stated_scale_std(first, axis) for axis in range(len(first.sides)))
    if not asked.given:
        return Checked((), stated, left_out=False)
    warnings, omitted, found = uncalibrated(asked.recording, asked.calibration), False, list(stated)
    for axis, side in enumerate(first.sides):
        if axis and not side.recording.fused:
            continue
        own = first.at_instants(axis)
        series = {name: on_clock(one, ran[name]) if ran_apart(ran[name]) else one for name, one in own.items()}
        along, reach_s = f" along {side.recording.axis}" if axis else "", asked.recording.max_offset_s
        sensed = [
            Sensed(name, one.source, one.displacement, stated[axis][name])
            for name, one in series.items()
            if name not in first.swayed
        ]
        try:
            fits = fitting(side.acceleration, sensed, along, max_offset_s=reach_s, followed=not asked.on_series)
        except UntrustedError as error:
            if axis == 0:
                raise
            omitted = True
            warnings.append(left_out(side.recording, error))
            continue
        warnings += fits.warnings
        found[axis] = stated[axis] | fits.scale_std
    return Checked(tuple(warnings), tuple(found), omitted)


def stated_scale_std(first: FirstPass, axis: int) -> dict[str, float]:
    """Relative standard deviations of the sensors' scales along an axis as compared with the accelerometer, by name."""
    own = first.sides[axis].calibration.accelerometer_scale_std
    found = {
        tracked_camera.sensor: tracked_camera.calibrations[axis].relative_std
        for tracked_camera in first.tracked_cameras
    }
    found |= {view.sensor: known.relative_std for view, known in known_sensors(first.sides[0])}
    return {name: without_gain(std, own) for name, std in found.items()}


def smoothed(first: FirstPass, ran: Mapping[str, OneClock], checked: Checked) -> Found:
    """The rows smoothed by the whole record, after what it shows of scales and clocks."""
    estimator, outcome = first.estimator, first.outcome
    assert isinstance(estimator, Estimator)
    off = {(name, axis): std for axis, one in enumerate(checked.scale_std) for name, std in one.items()}
    settings = with_scales(estimator.settings, off)
    if any(len(wrong.crowd) for wrong in first.wrong.values()):
        settings = without_steps(settings)
    apart = {name: clock for name, clock in ran.items() if ran_apart(clock)}
    if apart:
        settings = replace(settings, zero_ns=zero_instant(first.sides[0], first.tracked_cameras, first.sensors, ran))
    if apart or first.wrong or settings != estimator.settings:
        for _ in range(MAX_BEGUN):
            estimator, outcome = _passed_again(first, settings, apart)
            wrong = with_first_values(first, first.wrong, outcome.fusion_events)
            if apart or _held(wrong) == _held(first.wrong):
                break
            first = replace(first, wrong=wrong)
        else:
            # What is left out is what the last pass found.
            estimator, outcome = _passed_again(first, settings, apart)
    found = _found(first, outcome, estimator.smoothed(settings))
    refuse_unsettled(first, found)
    # What the displacement may be off by where the motion does not tell which jump a clock made.
    levels, rows = [level for clock in ran.values() for level in clock.levels], []
    for one in found.rows:
        variance = one.variance_m2
        for level in levels:
            variance = variance + np.interp(one.time_ns, level.time_ns, level.std_m) ** 2
        rows.append(replace(one, variance_m2=variance))
    events = [event for clock in ran.values() for event in clock.events]
    events += [left_out_event(name, wrong.held) for name, wrong in first.wrong.items() if len(wrong.held)]
    warnings = tuple(line for clock in ran.values() for line in clock.warnings)
    return replace(found, rows=tuple(rows), events=(*found.events, *events), warnings=warnings)


def _held(wrong: Mapping[str, WrongValues]) -> int:
    return sum(len(one.held) for one in wrong.values())


def _passed_again(
    first: FirstPass, settings: EstimatorSettings, apart: Mapping[str, OneClock]
) -> tuple[Estimator, Outcome]:
    """The estimator run again, without values that are wrong and with clocks that ran apart put right."""
    assert isinstance(first.estimator, Estimator)
    blocks = {name: first.outcome.measured_by(name) for name in first.outcome.measured}
    for name, wrong in first.wrong.items():
        blocks[name] = part(blocks[name], ~np.isin(blocks[name].time_ns, wrong.held))
    blocks |= {name: on_its_clock(blocks[name], settings.channels, clock) for name, clock in apart.items()}
    estimator, again = once_more(settings, first.estimator, tuple(blocks.values()))
    return estimator, Outcome(Blocks(joined_rows, again))


def _found(first: FirstPass, outcome: Outcome, rows: tuple[Estimate, ...]) -> Found:
    """Rows in the streams' common span, with the innovations and events of the run that they rest on."""
    measured_ns = first.outcome.measured_ns
    last_ns = int(measured_ns.max())
    span = inside(rows[0].time_ns, int(measured_ns.min()), last_ns)
    channels = first.estimator.settings.channels
    return Found(
        rows=tuple(part(one, span) for one in rows),
        innovations=tuple(outcome.innovation_along(channels, axis) for axis in range(len(rows))),
        zero_variance_m2=outcome.zero_variance_m2[: len(rows)],
        used={name: used_when(outcome, channels, name) for name in first.series[0]},
        events=tuple(event for event in outcome.fusion_events if event.time_ns <= last_ns),
        warnings=(),
    )


def result_of(asked: Asked, first: FirstPass, found: Found, checked: Checked) -> Result:
    """The result as plain data."""
    recording, main = asked.recording, found.rows[0]
    refuse_rejections(recording, found.innovations[0])
    if not asked.by_settings.literal:
        refuse_untrue(asked, first, found)
    sensors, radars = first.outcome.sensor_events, first.outcome.radars
    info = {view.sensor: view.radar.info for view, _ in known_sensors(first.sides[0]) if view.sensor in radars}
    fused = tuple(event for event in found.events if event.axis == 0)
    two, more = _second_axis(first, found, checked)
    pose, unseen = camera_pose(first.seen, first.sides, Rows(found.rows, found.zero_variance_m2))
    warnings = (
        *recording.channel_warnings,
        *(
            renamed(line, tracked_camera.sensor)
            for tracked_camera in first.tracked_cameras
            for line in tracked_camera.tracking.warnings()
        ),
        *found.warnings,
        *event_warnings(fused),
        *event_warnings(tuple(event for event in sensors if event.kind in ("frozen", "lost", *REPORTED))),
        *(line for view, _ in known_sensors(first.sides[0]) if view.sensor in radars for line in view.radar_notices),
        *(renamed(line, name) for name, log in radars.items() for line in radar_warnings(log, info[name].warnings)),
        *unmeasured_ends(recording.acceleration.time_ns, first.outcome.placed, main),
        *shares(found.innovations[0], main),
        *more,
        *unseen,
    )
    result = Result(
        estimate=main,
        calibration=asked.calibration,
        settings=recording.settings,
        method=asked.method,
        innovation=found.innovations[0],
        events=tuple(sorted((*sensors, *fused), key=lambda event: event.time_ns)),
        warnings=once(warnings, asked.calibration.warnings),
        cameras=first.cameras,
        measured=tuple(first.series[0].values()),
        pose=pose,
        radars={name: log.trace(info[name].limit_speed_m_s) for name, log in radars.items()},
        zero_std_m=float(np.sqrt(found.zero_variance_m2[0])),
        used=found.used,
        delay_s=np.inf if asked.row.rows is Pass.SMOOTHED else first.delay_s,
        file=recording.file,
        name=recording.name,
    )
    if not two:
        return result
    across = replace(
        result,
        estimate=found.rows[1],
        calibration=first.sides[1].calibration,
        innovation=found.innovations[1],
        events=tuple(event for event in found.events if event.axis == 1),
        cameras=(),
        measured=tuple(first.series[1].values()),
        radars={},
        zero_std_m=float(np.sqrt(found.zero_variance_m2[1])),
    )
    return replace(result, across=across)


def refuse_untrue(asked: Asked, first: FirstPass, found: Found) -> None:
    """UntrustedError where the accelerometer contradicts the rows, or a radar has lost its target too often."""
    main, whole, estimator = first.sides[0], found.rows[0], first.estimator
    if asked.row.rows is Pass.CAUSAL and not asked.on_series and isinstance(estimator, Estimator) and found.events:
        # The band of a causal method opens for a jump, that of the whole record does not.
        whole = estimator.smoothed()[0]
    rows = measured_rows(whole, found.innovations[0])
    for name, one in first.at_instants(0).items():
        refuse_forward_step(main.prepared, one.time_ns, one.value_m, name)
        if one.source == Source.DISPLACEMENT and len(first.series[0]) == 1:
            # Alone, its own zero is the rows'.
            refuse_run_away(whole, one)
    refuse_unfelt(main.prepared, rows.time_ns, rows.displacement_m, rows.variance_m2)
    usual = figures(main, main.prepared.rate_hz)
    density = estimator.settings.misfit[0] * (usual.noise_density + usual.motion_noise_s * usual.variance)
    steps_ns = [event.time_ns for event in found.events if event.kind == "clock"]
    for view, known in known_sensors(main):
        if view.sensor in first.outcome.radars:
            # Stamps (k,) of frames in which none of its targets was measured.
            measured = first.outcome.measured_by(view.sensor)
            unseen_ns = np.setdiff1d(measured.time_ns, measured.time_ns[np.isfinite(measured.value)])
            refuse_contradicted(first.outcome.events_of.get(view.sensor, ()), len(known.used), view.sensor)
            refuse_steps_unseen(steps_ns, unseen_ns, view.sensor)
            refuse_lost_cycles(main.prepared, rows, unseen_ns, density, known.relative_std)
            refuse_wide(main.prepared, whole)


def _second_axis(first: FirstPass, found: Found, checked: Checked) -> tuple[bool, list[Notice]]:
    """Whether there is a second image axis that can be trusted, and its warnings."""
    if len(first.sides) < 2 or checked.left_out:
        return False, []
    view = first.sides[1].recording
    try:
        refuse_rejections(view, found.innovations[1])
    except UntrustedError as error:
        return False, [left_out(first.sides[1].recording, error)]
    reported = event_warnings(tuple(event for event in found.events if event.axis == 1))
    reported = [line.worded(f"Along {view.axis}: {line}") for line in reported]
    return True, reported + shares(found.innovations[1], found.rows[1], f" along {view.axis}")
