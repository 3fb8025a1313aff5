"""`estimate`: the main job, from a recording to displacement at the accelerometer's rate with its error band."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from midspan.checks import option
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.fusion.blocks import REJECTED
from midspan.fusion.methods import LITERAL, METHODS, no_literal_form
from midspan.fusion.runners import MethodSettings
from midspan.fusion.streams import Smoothed
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.camera_result import CameraResult, camera_result, camera_series
from midspan.recording.cameras.tracked import Eye
from midspan.recording.displacement.sensor import displacement_series
from midspan.recording.fusing.fuse import FusionInputs, fuse
from midspan.recording.fusing.scale_check import Fitting, fitting
from midspan.recording.inputs import Gathered, gather
from midspan.recording.radar.literal import require_same_way
from midspan.recording.result import Result
from midspan.recording.second_axis import SecondAxis, second_axis
from midspan.recording.sensor_series import SensorSeries
from midspan.recording.stored.calibration import Calibration
from midspan.recording.stored.calibration_file import load_calibration
from midspan.recording.streams.progress import Progress, silent
from midspan.recording.streams.recording import Recording, naming, open_recording
from midspan.recording.streams.span import inside, shown
from midspan.recording.tracking.tracking import CameraTracking
from midspan.recording.unsupported import unsupported_events
from midspan.records import NANOSECONDS, Estimate, Event, Innovation, Status, part

# Where more than half of the measurements contradict the prediction, the prediction or the calibration is wrong.
MOST_REJECTED = 0.5
# Rejections above this share are worth telling.
NOTABLE_REJECTED = 0.02
# Learnt noise of a method run as printed, over the calibrated one, beyond which it is called a run-away.
RUN_AWAY = 10.0
# Events of one kind that are told in the warnings.
MOST_TOLD = 3


def estimate(
    recording: Recording | str | Path,
    calibration: Calibration | str | Path | None = None,
    *,
    method: str | None = None,
    tracking: CameraTracking | None = None,
    progress: Progress = silent,
) -> Result:
    """Estimate the displacement of a recording, which may be given by its path.

    calibration: or its file; left out, it is made first (and the camera is tracked once for both). method: a name of
    `midspan methods`, over the recording's own. tracking: what `calibrate_and_track` left, to go on with. Returns one
    row for each accelerometer sample in the streams' common span.
    Raises UntrustedError when calibration is refused, DataError for unusable streams.
    """
    if isinstance(recording, str | Path):
        recording = open_recording(recording)
    if isinstance(calibration, str | Path):
        calibration = load_calibration(calibration)
    recording.require_one_of_a_kind()
    # The method is checked first: tracking may take long.
    method = option("method", method or recording.settings.fusion.method, METHODS)
    if recording.settings.fusion.literal and method not in LITERAL:
        raise UsageError(f"{recording.file}: fusion: {no_literal_form(method)}.")
    # What was learnt on this recording a moment ago fits it.
    asked = _Asked(method, given=calibration is not None and tracking is None)
    if calibration is None:
        calibration, tracking = calibrate_and_track(recording, progress)
    with naming(recording):
        return _estimate(recording, calibration, asked, tracking, progress)


@dataclass(frozen=True, slots=True)
class _Asked:
    """The method, and whether the calibration was given, not learnt on this recording just now."""

    method: str
    given: bool


def _estimate(
    recording: Recording, calibration: Calibration, asked: _Asked, tracking: CameraTracking | None, progress: Progress
) -> Result:
    method = asked.method
    _require(recording, calibration)
    gathered = gather(recording, calibration, tracking, progress)
    progress(0, 1, "fusing")
    scaled: list[str] = []
    if asked.given:
        fits = _given(recording, calibration, gathered)
        gathered, scaled = replace(gathered, inputs=replace(gathered.inputs, errors=fits.errors)), fits.warnings
        scaled += _uncalibrated(recording, calibration)
    fused, zero_variance = fuse(gathered.inputs, method, _method_settings(recording))
    _refuse_rejections(recording, fused.innovation)
    result = _cut(recording, gathered.inputs, fused.estimate)
    alone = unsupported_events(result, fused.events)
    across, more = _second(recording, calibration, gathered, (result, method), given=asked.given)
    progress(1, 1, "fusing")
    warnings = (
        *_channel_warnings(recording, calibration),
        *_warnings(gathered, fused, result),
        *scaled,
        *_told(alone),
        *_literal_warnings(recording, gathered, fused),
        *more,
    )
    return result_of(
        recording, calibration, gathered, Fused(method, fused, zero_variance, result, across, alone, warnings)
    )


@dataclass(frozen=True, slots=True)
class Fused:
    """What the fusion left: the method, its output, the rows in the common span, the second axis, events, warnings."""

    method: str
    found: Smoothed
    zero_variance_m2: float
    rows: Estimate
    across: SecondAxis | None
    events: tuple[Event, ...]
    warnings: tuple[str, ...]


def result_of(recording: Recording, calibration: Calibration, gathered: Gathered, fused: Fused) -> Result:
    """The result as plain data, of what the sensors and the fusion left."""
    cameras = tuple(_camera(eye) for eye in gathered.eyes)
    events = (*(event for camera in cameras for event in camera.events), *fused.found.events, *fused.events)
    across = fused.across
    if across is not None:
        along = tuple(camera_series(camera, across.estimate, axis=1) for camera in cameras)
        across = replace(across, measured=along)
    return Result(
        estimate=fused.rows,
        calibration=calibration,
        settings=recording.settings,
        method=fused.method,
        innovation=fused.found.innovation,
        events=_events(recording, gathered, events),
        warnings=fused.warnings,
        cameras=cameras,
        measured=_measured(recording, calibration, gathered, cameras, fused.rows),
        across=across,
        zero_std_m=float(np.sqrt(fused.zero_variance_m2)),
        file=recording.file,
        name=recording.name,
    )


def _camera(eye: Eye) -> CameraResult:
    settings = eye.view.settings.camera
    assert settings is not None
    return camera_result(eye.tracking, eye.sensor, settings, eye.calibrations)


def _measured(
    recording: Recording,
    calibration: Calibration,
    gathered: Gathered,
    cameras: Sequence[CameraResult],
    rows: Estimate,
) -> tuple[SensorSeries, ...]:
    """What each sensor measured along the main axis."""
    found = [camera_series(camera, rows) for camera in cameras]
    if recording.has("displacement") and calibration.displacement is not None:
        found.append(displacement_series("displacement", recording.displacement, calibration.displacement))
    return tuple(found)


def _given(recording: Recording, calibration: Calibration, gathered: Gathered) -> Fitting:
    """How a calibration that was given fits the recording; UntrustedError where it does not."""
    return fitting(gathered.inputs, max_offset_s=recording.max_offset_s)


def _uncalibrated(recording: Recording, calibration: Calibration) -> list[str]:
    """What to tell of a camera that the recording has and the calibration that was given has not."""
    return [
        f"[{view.sensor}] is left out of the result: the calibration that was given has no {view.sensor} part. Run "
        "`midspan calibrate` on a recording with both cameras."
        for view in recording.cameras
        if calibration.camera_of(view.sensor) is None
    ]


def _events(recording: Recording, gathered: Gathered, more: tuple[Event, ...]) -> tuple[Event, ...]:
    """What happened to all sensors, and `more` of the cameras and the fusion, in the order of time."""
    found = (
        *recording.prepared.events,
        *gathered.frozen,
        *gathered.events,
        *more,
    )
    return tuple(sorted(found, key=lambda event: event.time_ns))


def _second(
    recording: Recording, calibration: Calibration, gathered: Gathered, main: tuple[Estimate, str], *, given: bool
) -> tuple[SecondAxis | None, list[str]]:
    """The second image axis and its warnings; left out where it is not to be trusted: the main one stands without.

    given: whether the calibration was not learnt on this recording just now.
    """
    view, scaled = recording.across, []
    try:
        if given and view is not None and gathered.across is not None and _fused_across(calibration):
            fits = fitting(gathered.across, f" along {view.axis}")
            gathered = replace(gathered, across=replace(gathered.across, errors=fits.errors))
            scaled = fits.warnings
        found = _across(recording, calibration, gathered, main)
    except UntrustedError as error:
        return None, [f"The second axis {'' if view is None else view.axis} is left out of the result. {error}"]
    if view is None or found is None:
        return None, []
    sensor = view.prepared.events if found.fused else ()
    events = tuple(sorted((*sensor, *found.events), key=lambda event: event.time_ns))
    return replace(found, events=events), [*scaled, *_second_warnings(found)]


def _fused_across(calibration: Calibration) -> bool:
    """Whether the second axis is fused with an accelerometer of its own."""
    camera = None if calibration.across is None else calibration.across.first_camera
    return camera is not None and camera.fused


def _across(
    recording: Recording, calibration: Calibration, gathered: Gathered, main: tuple[Estimate, str]
) -> SecondAxis | None:
    """The second image axis at the rows of the first; None without one."""
    view, (rows, method) = recording.across, main
    if view is None or gathered.across is None or calibration.across is None:
        return None
    found = second_axis(gathered.across, calibration.across, rows.time_ns, method, _method_settings(recording))
    _refuse_rejections(view, found.innovation)
    missing = view.prepared.time_ns[view.prepared.missing]
    bridged = np.isin(rows.time_ns, missing) & (found.estimate.status == Status.TRACKING)
    status = np.where(bridged, np.uint8(Status.COASTING), found.estimate.status)
    return replace(found, estimate=replace(found.estimate, status=status))


def _second_warnings(across: SecondAxis) -> list[str]:
    """What the gate did along the second axis."""
    along = f" along {across.axis}"
    told = [f"Along {across.axis}: {line}" for line in _told(across.events)]
    return [*told, *_shares(across.innovation, across.estimate, along)]


def _method_settings(recording: Recording) -> MethodSettings:
    """What [fusion] says of single methods."""
    fusion = recording.settings.fusion
    return MethodSettings(lag_s=fusion.lag_s, literal=fusion.literal, forgetting=fusion.forgetting)


def _literal_warnings(recording: Recording, gathered: Gathered, fused: Smoothed) -> list[str]:
    """What to know of the adaptive filter as printed; the FIR methods need no such word."""
    if not recording.settings.fusion.literal or fused.variance_m2 is None or not len(fused.variance_m2):
        return []
    found = [
        "fusion.literal: the filter was run exactly as printed, without bias, gate and limits. Its own covariance does "
        "not hold its error; the band was widened by what the innovations show."
    ]
    known = gathered.inputs.displacement.variance_m2
    declared = float(np.median(known[np.isfinite(known)]))
    grown = float(np.sqrt(np.max(fused.variance_m2) / declared))
    if grown > RUN_AWAY:
        found.append(
            f"fusion.literal: the learnt noise grew to {grown:.3g} times the calibrated one: it runs away, most often "
            "under a bias of the accelerometer. Leave fusion.literal out."
        )
    share = float(np.mean(fused.variance_m2 < 0.0))
    if share > 0.0:
        found.append(f"fusion.literal: equation 20 gave a negative variance in {100 * share:.2g} % of the frames.")
    return found


def _told(events: tuple[Event, ...]) -> list[str]:
    """The texts of the events; of a kind that comes often only how often."""
    found = []
    for kind in dict.fromkeys(event.kind for event in events):
        texts = [event.text for event in events if event.kind == kind]
        rest = [f"{len(texts) - MOST_TOLD} more such stretches stand in the events."] if len(texts) > MOST_TOLD else []
        found += [*texts[:MOST_TOLD], *rest]
    return found


def _require(recording: Recording, calibration: Calibration) -> None:
    if calibration.others:
        names = ", ".join(name for name, _, _ in calibration.sensors)
        raise UsageError(
            f"The calibration must be of one sensor of each kind here; received {names}. Keep those of the recording's "
            "sensors in it, or run `midspan calibrate` on this recording."
        )
    if recording.has("radar") and calibration.radar is not None:
        require_same_way(calibration.radar, recording.settings.fusion.literal)
    views = recording.cameras
    if views and not any(calibration.camera_of(view.sensor) for view in views):
        raise UsageError(
            f"The calibration has no {views[0].sensor} part, but the recording has a camera. Run `midspan calibrate` "
            "on a recording of this camera."
        )
    for view in views:
        camera, known = view.settings.camera, calibration.camera_of(view.sensor)
        if camera is None or known is None:
            continue
        made_for = calibration.direction if len(views) == 1 else known.direction
        if camera.direction != made_for:
            raise UsageError(
                f"{recording.file}: {view.sensor}.direction = {camera.direction!r}: the calibration was made for "
                f"{made_for!r}. Calibrate again."
            )
        if view.axis != known.direction:
            raise UsageError(
                f"{recording.file}: the main axis is {view.axis!r}: the calibration's is {known.direction!r}. "
                "Calibrate again."
            )


def _cut(recording: Recording, inputs: FusionInputs, rows: Estimate) -> Estimate:
    """The rows in the common span; those whose sample had to be bridged are marked coasting."""
    usable = np.flatnonzero(np.isfinite(inputs.displacement.value_m))
    first, last = (int(inputs.displacement.time_ns[i]) for i in (usable[0], usable[-1]))
    # Samples that were put in before the start or into gaps are no rows of the result.
    sampled = recording.prepared.time_ns
    if len(rows.time_ns) > len(sampled):
        place = np.minimum(np.searchsorted(sampled, rows.time_ns), len(sampled) - 1)
        rows = part(rows, sampled[place] == rows.time_ns)
    missing = recording.prepared.missing
    status = np.where(missing & (rows.status == Status.TRACKING), np.uint8(Status.COASTING), rows.status)
    span = inside(rows.time_ns, first, last)
    if span.stop - span.start < 2:
        raise DataError(
            f"The streams do not overlap with the calibrated clock offset: measurements run from {shown(first)} to "
            f"{shown(last)} on the accelerometer's clock, which runs from {shown(int(rows.time_ns[0]))} to "
            f"{shown(int(rows.time_ns[-1]))}. Check the calibration's time_offset_s and the start_s of both."
        )
    return part(replace(rows, status=status), span)


def _late_start(inputs: FusionInputs, rows: Estimate) -> list[str]:
    """A sentence when the first measurement comes long after both streams have begun."""
    begun = max(int(inputs.displacement.time_ns[0]), int(inputs.acceleration.time_ns[0]))
    missed = (int(rows.time_ns[0]) - begun) / NANOSECONDS
    if missed <= max(1.0, inputs.kalman.coasting_s):
        return []
    return [
        f"Nothing was measured from {shown(begun)} to {shown(int(rows.time_ns[0]))}; the result begins there, "
        f"{missed:.1f} s late."
    ]


def _lost_end(inputs: FusionInputs, rows: Estimate) -> list[str]:
    """A sentence when the measurements stop long before both streams do."""
    end = min(int(inputs.displacement.time_ns[-1]), int(inputs.acceleration.time_ns[-1]))
    missed = (end - int(rows.time_ns[-1])) / NANOSECONDS
    if missed <= max(1.0, inputs.kalman.coasting_s):
        return []
    return [
        f"The target was lost from {shown(int(rows.time_ns[-1]))} to the end; the result stops there, "
        f"{missed:.1f} s early."
    ]


def rejected_share(innovation: Innovation) -> float:
    """Share of the measurements that were met and rejected."""
    return float(np.mean(innovation.verdict == REJECTED)) if len(innovation.verdict) else 0.0


def _refuse_rejections(recording: Recording, innovation: Innovation) -> None:
    """UntrustedError when most measurements contradict the prediction."""
    share = rejected_share(innovation)
    if share > MOST_REJECTED:
        raise UntrustedError(
            f"{100 * share:.0f} % of the measurements contradict the acceleration; at most "
            f"{100 * MOST_REJECTED:g} % may. "
            "Scale factor, clock offset or direction belong to another recording, or the sensors do not measure "
            f"the same motion. Calibrate this recording, and look at {_looked_at(recording)}."
        )


def _looked_at(recording: Recording) -> str:
    """What may be wrong of the sensors that there are, as an instruction's last words."""
    found = [f"its {view.sensor}.roi" for view in recording.cameras]
    found += ["what the radar sees (`midspan inspect` lists it)"] if recording.has("radar") else []
    found += ["the unit and sign of its displacement file"] if recording.has("displacement") else []
    return " and ".join(found)


def _channel_warnings(recording: Recording, calibration: Calibration) -> tuple[str, ...]:
    """What the calibration says, and what is wrong with this recording's channels where it is another's."""
    own = recording.channel_warnings
    return (*calibration.warnings, *(line for line in own if line not in calibration.warnings))


def _warnings(gathered: Gathered, fused: Smoothed, rows: Estimate) -> tuple[str, ...]:
    found = [*gathered.warnings]
    for eye in gathered.eyes:
        found += eye.tracking.warnings()
    found += _told(fused.events)
    found += _late_start(gathered.inputs, rows)
    found += _lost_end(gathered.inputs, rows)
    return (*found, *_shares(fused.innovation, rows))


def _shares(innovation: Innovation, rows: Estimate, along: str = "") -> list[str]:
    """A sentence for many rejected measurements, and for rows that none supports; along: a second axis in words."""
    found = []
    rejected = rejected_share(innovation)
    if rejected > NOTABLE_REJECTED:
        found.append(f"{100 * rejected:.1f} % of the measurements{along} were rejected as outliers.")
    for status in (Status.COASTING, Status.LOST):
        share = float(np.mean(rows.status == status))
        if share > 0.0:
            found.append(f"{100 * share:.2g} % of the rows{along} are {status.word}: no measurement supports them.")
    return found
