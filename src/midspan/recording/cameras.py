"""The part of a calibration that rests on the pictures of one camera, where it sees."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from midspan.calibration.camera.best_range import FRAMES, best_range
from midspan.calibration.camera.calibrate import CameraFit, fit_camera
from midspan.calibration.camera.geometry import FOCAL_STD
from midspan.calibration.camera.gyroscope import GyroscopeFit, StillError, fit_gyroscope
from midspan.calibration.camera.tilt import apart
from midspan.calibration.camera.view import SeenTarget, View, judged_by
from midspan.calibration.lines import LinesFound, Shown, unconfirmed_lines
from midspan.calibration.sensors.auxiliary import turns_image
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.target_opening import ThermalTarget
from midspan.engine.tracking import COMPRESSED, CameraTracking
from midspan.errors import NoAgreementError, UntrustedError
from midspan.notices import Notice
from midspan.progress import Progress
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import calibration_window, window_ends
from midspan.recording.tracking.opening import IN_GREY, is_grey, open_tracking, where_it_sees
from midspan.recording.tracking.posed import PosedTracking, posed
from midspan.records import ScaleFactor, Source, TimeSeries, seconds
from midspan.settings.camera import InfraredSettings
from midspan.settings.messages import in_words_of, renamed
from midspan.signals.lines import Line
from midspan.sources.accelerometer.phone import holds_phone_log
from midspan.sources.accelerometer.units import si_factor
from midspan.sources.thermal.temperatures import AGC_NOTE
from midspan.thermal.temperature_range import DIVISIONS
from midspan.vision.region_choice import Judge

# Of a camera that may nod as the structure vibrates.
SLOW_ANGLE = (
    "[inclinometer] takes off the slow tilt alone. A camera that nods with the structure needs [gyroscope], or a "
    "second target at another distance."
)


@dataclass(frozen=True, slots=True)
class SeenBy:
    """What one camera gave: what was estimated along its axes, its tracking as far as it had to go, and warnings."""

    parts: tuple[CameraFit, ...]
    tracking: CameraTracking
    warnings: tuple[Notice, ...]


def calibrated_camera(recording: Recording, progress: Progress) -> SeenBy:
    """What one camera gave; once more where its clock is found farther off than was searched and nothing forbids it."""
    try:
        return _calibrated_near(recording, progress)
    except NoAgreementError as error:
        if error.clock_offset_s is None or not recording.clocks_open:
            raise
        offset_s = error.clock_offset_s
    text = (
        f"{recording.sensor}: its clock offset is {offset_s:+.3g} s by the motion; offsets beyond "
        f"±{recording.max_offset_s:g} s were searched because calibration.max_offset_s is not set."
    )
    found = _calibrated_near(recording.later(offset_s), progress)
    return replace(found, warnings=(Notice("clock-corrected", text), *found.warnings))


def _calibrated_near(recording: Recording, progress: Progress) -> SeenBy:
    with in_words_of(recording.sensor):
        view, tracking, moved = tracking_by_acceleration(recording, progress)
        if view.posed:
            tracking = posed(view.settings.first_camera, tracking, view.accelerometer.camera_offset_m)
        if isinstance(tracking, PosedTracking):
            tracking, parts = _by_poses(view, tracking)
        else:
            parts = calibrate_camera(view, tracking)
        if wants_range(view):
            tracking, parts = _in_best_range(view, tracking, parts, progress)
        if tracking.learns_by_acceleration:
            tracking, parts = _taught(view, tracking, parts, progress)
        parts = tuple(named(view, tracking, part) for part in parts)
    reported = [Notice("window-moved", line) for line in moved]
    if isinstance(view.own.settings, InfraredSettings) and is_grey(view):
        reported.append(Notice("thermal", f"infrared: {AGC_NOTE}."))
    else:
        # Of these the scale factor suffers.
        reported += [line for line in tracking.warnings() if line.code in (COMPRESSED, "frozen")]
    reported += [line for part in parts for line in part.warnings]
    return SeenBy(parts, tracking, tuple(renamed(line, view.sensor) for line in reported))


def tracking_by_acceleration(recording: Recording, progress: Progress) -> tuple[Recording, CameraTracking, list[str]]:
    """A camera's view, its tracking, in which the accelerometer chose the targets that are not given, and notes."""
    view, moved = where_it_sees(recording)
    return view, open_tracking(view, None, progress, judge=judge_of(view)), moved


def _by_poses(view: Recording, tracking: PosedTracking) -> tuple[CameraTracking, tuple[CameraFit, ...]]:
    """Tracking and calibration by the poses; by the targets where the accelerometer does not agree with these."""
    try:
        parts = calibrate_camera(view, tracking)
    except UntrustedError:
        return tracking.inner, calibrate_camera(view, tracking.inner)
    if not all(tracking.agrees(part.calibration) for part in parts if part.calibration.fused):
        return tracking.inner, calibrate_camera(view, tracking.inner)
    return tracking, tuple(_with_shape(part, tracking) for part in parts)


def _with_shape(part: CameraFit, tracking: PosedTracking) -> CameraFit:
    """What errors of the distances make of the displacement, in its band."""
    known = part.calibration
    apart_m = float(np.hypot(known.apart_std_m, tracking.shape_std_m(known.direction)))
    return replace(part, calibration=replace(known, apart_std_m=apart_m))


def _in_best_range(
    view: Recording, tracking: CameraTracking, parts: tuple[CameraFit, ...], progress: Progress
) -> tuple[CameraTracking, tuple[CameraFit, ...]]:
    """Tracking and calibration anew in the best temperature range; as they were, with a warning, where nothing decides
    on one.
    """
    camera, first = view.settings.camera, tracking.settings.first
    divisions = camera.range_divisions if isinstance(camera, InfraredSettings) else DIVISIONS
    last = int(np.searchsorted(view.frames.times_ns() + view.late_ns, window_ends(view)[1], side="right"))
    try:
        frames = list(islice(view.frames.frames(first, min(last, first + FRAMES)), FRAMES))
        seen = seen_targets(view, tracking)
        surface = best_range(frames, view_of(view), seen, parts[0], divisions)
    except UntrustedError as error:
        reported = (
            f"infrared: no temperature range was found for the tracker {tracking.settings.tracker!r}, which needs "
            f"grey levels; it uses °C directly and may lose the target. {error} Or set infrared.temperature_range_c."
        )
        return tracking, (replace(parts[0], warnings=(*parts[0].warnings, Notice("thermal", reported))), *parts[1:])
    tracking.close()
    again = open_tracking(view, None, progress, again=(tuple(tracking.chosen), surface.best))
    again.range_surface = surface
    parts = calibrate_camera(view, again)
    again.choice = tracking.choice
    return again, parts


def _taught(
    view: Recording, tracking: CameraTracking, parts: tuple[CameraFit, ...], progress: Progress
) -> tuple[CameraTracking, tuple[CameraFit, ...]]:
    """Tracking and noise anew with trackers that have estimated from the accelerometer, by the first calibration.

    Scale factor and clock offset stay: what was estimated rests on them, and is estimated again wherever they are
    given.
    """
    tracking.close()
    again = open_tracking(view, parts[0].calibration, progress)
    again.choice, fits = tracking.choice, []
    for first, own in zip(parts, calibrate_camera(view, again), strict=False):
        then, now = first.calibration, own.calibration
        scales = {target.region: target.scale for target in then.targets}
        targets = tuple(replace(target, scale=scales.get(target.region, target.scale)) for target in now.targets)
        beta = now.phase_scale_m_per_rad
        ratio = then.scale.value_m_per_px / now.scale.value_m_per_px
        phase_scale = None if beta is None else beta * ratio
        known = replace(now, scale=then.scale, offset=then.offset, targets=targets, phase_scale_m_per_rad=phase_scale)
        fits.append(replace(own, calibration=known))
    return again, tuple(fits)


def view_of(recording: Recording) -> View:
    """What the axis of a recording is calibrated on."""
    wanted, camera = recording.settings.calibration, recording.settings.first_camera
    return View(
        recording.axis,
        recording.prepared,
        calibration_window(recording),
        recording.max_offset_s,
        wanted.band_hz,
        recording.exposure_s,
        None if camera is None else camera.known_scale,
        wanted.printed(camera),
        recording.late_ns,
        recording.clocks_open,
    )


def chosen_text(tracking: CameraTracking) -> list[str]:
    """A sentence on the regions that were chosen; none where they were given."""
    if tracking.choice is None:
        return []
    regions = " and ".join(str([r.x, r.y, r.width, r.height]) for r in tracking.choice.regions)
    return [
        f"camera.roi was left out, and {regions} (x, y, width, height in px) chosen; `midspan inspect` with --picture "
        "FILE.png draws it. Where it does not show what is measured, give camera.roi."
    ]


def judge_of(view: Recording) -> Judge:
    """What decides between places in a camera's picture: its accelerometer."""
    return lambda track, beyond: judged_by(view_of(view), track, beyond=beyond)


def seen_targets(view: Recording, tracking: CameraTracking) -> list[SeenTarget]:
    """The targets as they were tracked so far, with their declared distances."""
    camera = view.settings.first_camera
    known = {} if camera is None else dict(zip(camera.target_names, camera.target, strict=True))
    seen = [tracking.seen(target, view.exposure_s) for target in tracking.targets]
    return [
        replace(one, inverse_distance=known[one.name].inverse_distance) if one.name in known else one for one in seen
    ]


def calibrate_camera(recording: Recording, tracking: CameraTracking) -> tuple[CameraFit, ...]:
    """Calibrate the camera along its image axes, the main one first; targets of no use are tracked no further.

    Raises UntrustedError where no target can be calibrated along the main axis.
    """
    tracking.until(window_ends(recording)[1] - recording.late_ns)
    across, seen = recording.across, seen_targets(recording, tracking)
    views = [view_of(one) for one in (recording, across) if one is not None and one.fused]
    second = "" if across is None else across.axis
    reported = lambda: [*chosen_text(tracking), *tracking.warnings()]  # noqa: E731
    turns = _gyroscope_of(recording) is not None
    # The difference of targets at different distances is sharper than any gyroscope.
    parts = _by_distances(lambda: fit_camera(views, seen, reported, second)) if turns and len(seen) > 1 else ()
    found, said = _gyroscope_fit(recording, views[0], seen, parts) if turns else (None, ())
    if found is None and not recording.lines and not _is_printed(recording):
        _require_no_lines(recording, seen)
    without_tilt = {} if found is None else {views[0].axis: found.fitted}
    try:
        parts = parts or fit_camera(views, seen, reported, second, without_tilt)
    except UntrustedError as error:
        # What a gyroscope would have taken off may be the reason.
        slow = () if recording.root.settings.inclinometer is None or turns else (SLOW_ANGLE,)
        error.more = " ".join((error.more, *said, *slow)).strip()
        raise
    _refuse_mirrored(recording, parts[0].calibration)
    main = parts[0] if found is None else _with_tilt(parts[0], found)
    parts = (replace(main, warnings=(*said, *main.warnings)), *parts[1:])
    tracking.leave_out([k for k, target in enumerate(parts[0].calibration.targets) if not target.used])
    return parts


def _gyroscope_of(recording: Recording) -> TimeSeries | None:
    """The readings of the gyroscope on this view's camera, which is the first one, as they move the image."""
    series = recording.auxiliary.get("gyroscope")
    if series is None or recording.root.cameras[0].sensor != recording.sensor:
        return None
    return replace(series, value=turns_image(recording.axis) * series.value)


def _is_printed(recording: Recording) -> bool:
    """Whether scale and clock offset are calibrated as printed."""
    return recording.settings.calibration.printed(recording.settings.first_camera) is not None


def _by_distances(fitted: Callable[[], tuple[CameraFit, ...]]) -> tuple[CameraFit, ...]:
    """The calibration without a gyroscope where the targets' distances tell the tilt; nothing where they do not."""
    try:
        parts = fitted()
    except UntrustedError:
        return ()
    return parts if parts[0].calibration.tilt_std_px > 0.0 else ()


def _gyroscope_fit(
    recording: Recording, view: View, seen: Sequence[SeenTarget], parts: Sequence[CameraFit]
) -> tuple[GyroscopeFit | None, tuple[Notice, ...]]:
    """What is found of the gyroscope, and notices; parts: calibrated by targets at different distances."""
    series, section = _gyroscope_of(recording), recording.root.settings.gyroscope
    assert series is not None
    assert section is not None
    factor = si_factor(section.unit or series.unit, "rotation rate", None)
    density = None if section.noise_density is None else factor * section.noise_density
    bias_std = None if section.bias_std is None else factor * section.bias_std
    lens = seen[0].lens
    focal_px = None if lens is None else lens.focal_px(view.axis)
    known = None if focal_px is None else (focal_px, FOCAL_STD * focal_px)
    try:
        found = fit_gyroscope(view, seen, series, parts, noise_density=density, bias_std=bias_std, focal_px=known)
    except UntrustedError as error:
        # Where neither it nor distances show a tilt, nothing is missing.
        code = "tilt" if isinstance(error, StillError) and not parts else "part-left-out"
        return None, (Notice(code, f"[gyroscope] is left out of the result. {error}"),)
    # Of the tilt the targets' own notice says the size.
    return found, tuple(line for line in found.notices if line.code != "tilt" or not parts)


def _refuse_mirrored(recording: Recording, camera: CameraCalibration) -> None:
    """UntrustedError where the image moves with an axis of the camera's own box, not against it."""
    scale, settings = camera.scale.value_m_per_px, recording.root.settings
    in_box = settings.gyroscope is not None or settings.inclinometer is not None
    if not in_box or scale < 0.0 or recording.axis not in recording.accelerometer.named_axes:
        return
    # Of a phone's log value_y may point up where value_z points against the view: to gravity both are the same.
    if holds_phone_log(recording.path(recording.accelerometer.file, "accelerometer.file").parent):
        return
    axis, way = recording.axis, {"x": "right", "y": "down"}[recording.axis]
    raise UntrustedError(
        f"accelerometer.value_{axis}: its sign is wrong ({1e3 * scale:.4g} mm/px). It is along the image's {axis} axis "
        f"({way} +) and reads specific force, +1 g along an axis that points up; in one box with the camera the image "
        f'moves against it. Change the sign: value_{axis} = "-NAME".'
    )


def _with_tilt(part: CameraFit, found: GyroscopeFit) -> CameraFit:
    """The calibration with the tilt's size.

    Of targets at different distances the differences are sharp, and a gyroscope tells what is added to all of them.
    """
    if part.calibration.tilt_std_px > 0.0:
        return replace(part, calibration=_regauged(part.calibration, found), gyroscope=found)
    tilt_px = float(np.hypot(found.tilt_std_px, found.slow_tilt_px))
    return replace(part, calibration=replace(part.calibration, tilt_std_px=tilt_px), gyroscope=found)


def _regauged(camera: CameraCalibration, found: GyroscopeFit) -> CameraCalibration:
    """The scale factors with what goes with the displacement of a tilt in the tilt, where the gyroscope has it."""
    pairs = zip(camera.targets, found.scales, strict=True)
    known = [(own.scale, other) for own, other in pairs if own.scale is not None and other is not None]
    moved = [1.0 / other.value_m_per_px - 1.0 / own.value_m_per_px for own, other in known]
    weight = [other.value_m_per_px**4 / other.variance for _, other in known]
    added = float(np.average(moved, weights=weight))

    def new(scale: ScaleFactor) -> ScaleFactor:
        value = 1.0 / (1.0 / scale.value_m_per_px + added)
        return ScaleFactor(value, scale.variance * (value / scale.value_m_per_px) ** 2)

    targets = tuple(one if one.scale is None else replace(one, scale=new(one.scale)) for one in camera.targets)
    return replace(camera, scale=new(camera.scale), targets=targets)


def _require_no_lines(recording: Recording, seen: Sequence[SeenTarget]) -> None:
    """LinesFound where neither a target nor the difference of two shows what the acceleration holds.

    A camera that tilts with its structure may show none of a mode in one target.
    """
    origin_ns, tracks = int(recording.prepared.time_ns[0]), [seen[0].rows]
    if len(seen) > 1:
        tracks.append(apart(seen[0].rows, seen[-1].rows))
    samples, found = recording.prepared.rows(origin_ns, slice(None)), list[tuple[Line, ...]]()
    for track in tracks:
        shown = Shown(seconds(track.time_ns + recording.late_ns, origin_ns), track.along(recording.axis)[0])
        found.append(unconfirmed_lines(samples, shown))
        if not found[-1]:
            return
    raise LinesFound(found[0], recording.sensor)


def wants_range(view: Recording) -> bool:
    """Whether a range has to be found: a tracker made for grey levels, temperatures, and none given."""
    camera = view.settings.camera
    return (
        isinstance(camera, InfraredSettings)
        and camera.temperature_range_c is None
        and camera.tracker in IN_GREY
        and not is_grey(view)
    )


def named(view: Recording, tracking: CameraTracking, part: CameraFit) -> CameraFit:
    """What was estimated along one axis, with the camera's name, the temperatures seen, and what the values rest on."""
    regions = [target.region for target in tracking.targets]
    place = regions.index(part.calibration.region) if part.calibration.region in regions else 0
    # Temperatures (°C) that the tracker sees; None where it gets pictures.
    tracker = tracking.targets[place].tracker
    seen = (tracker.limits.low_c, tracker.limits.high_c) if isinstance(tracker, ThermalTarget) else None
    own = replace(
        part.calibration,
        source=Source[view.kind.upper()],
        name=view.own.settings.name,
        temperature_range_c=seen,
        diagnostics=part.diagnostics,
    )
    return replace(part, calibration=own)
