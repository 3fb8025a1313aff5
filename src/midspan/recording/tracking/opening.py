"""Opening of a camera's tracking: the frames used, its targets, and what they are tracked with."""

from dataclasses import replace

import numpy as np

from midspan.calibration.camera.best_range import felt_motion
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.camera_target import Target
from midspan.engine.stored_tracking import StoredTracking
from midspan.engine.tracking import CameraTracking, Felt, TrackingSettings
from midspan.errors import DataError, UsageError
from midspan.progress import Progress
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import calibration_window, require_overlap, window_ends
from midspan.recording.tracking.temperatures import levels_of
from midspan.records import NANOSECONDS, Nanoseconds, Region
from midspan.settings.camera import CameraSettings, InfraredSettings
from midspan.signals.stamps import frames_used, shown
from midspan.sources.camera.lens import load_lens
from midspan.thermal.limits import Limits
from midspan.vision.lens import Lens
from midspan.vision.region_choice import Judge
from midspan.vision.tracker import tracker_settings

MIN_FRAMES = 2


def open_tracking(
    view: Recording,
    known: CameraCalibration | None,
    progress: Progress,
    *,
    again: tuple[tuple[Target, ...], Limits] | None = None,
    judge: Judge | None = None,
) -> CameraTracking:
    """The tracking of the camera of `view` from the first frame used; with a calibration its targets are taken over.

    again: the targets and the temperature range of what was tracked before in another range. judge: what decides
    between places by more than the picture where no target is given; left out, the picture alone decides. Raises
    UsageError for a target that the calibration does not know.
    """
    camera = view.settings.camera
    if camera is None:
        raise DataError(f"{view.file}: has no [camera] section.")
    times = view.frames.times_ns()
    if not len(times):
        raise DataError(f"{camera.file}: holds no frames.")
    used = _frames_used(view, times)
    if view.sees_from_ns is not None:
        used = slice(max(used.start, int(np.searchsorted(times, view.sees_from_ns))), used.stop)
    settings = replace(
        settings_of(view, camera),
        targets=calibrated_targets(given_targets(camera), known) if again is None else again[0],
        first=used.start,
        last=used.stop,
        trial_from_ns=window_ends(view)[0] - view.late_ns,
        levels=levels_of(view, known) if again is None else again[1],
    )
    if known is not None:
        check_same_lens(settings.lens, known.lens)
    if view.frames.tracks:
        return StoredTracking(view.frames, settings, progress)
    return CameraTracking(view.frames, settings, progress, judge, None if known is None else _felt(view, known))


def _felt(view: Recording, known: CameraCalibration) -> Felt:
    """The translation that the accelerometer shows, by a calibration of the camera."""
    prepared, window, band_hz = view.prepared, calibration_window(view), view.settings.calibration.band_hz
    return lambda stamps: felt_motion(prepared, window, known, stamps, band_hz)


def settings_of(view: Recording, camera: CameraSettings) -> TrackingSettings:
    """What the section of a camera says of its tracking."""
    return TrackingSettings(
        tracker=camera.tracker,
        direction=view.axis,
        targets=given_targets(camera),
        automatic_targets=camera.automatic_targets,
        readout_s=camera.readout_s,
        tracker_settings=tracker_settings(camera.tracker, **camera.tracker_settings),
        lens=lens_of(view),
        reference=camera.reference_rule,
        reference_settings=camera.reference_settings,
        thermal=isinstance(camera, InfraredSettings),
        sensor=view.sensor,
    )


def _frames_used(view: Recording, times: Nanoseconds) -> slice:
    """The frames used of those with these stamps (n,); DataError where they hardly overlap with the acceleration."""
    acceleration_ns, times = view.prepared.time_ns, times + view.late_ns
    try:
        require_overlap(acceleration_ns, times, view.sensor)
    except DataError as error:
        # Stamps that could not be used are the likely reason.
        raise DataError(" ".join((str(error), *(f"{line}." for line in view.frames.info.damage)))) from None
    used = frames_used(times, acceleration_ns, round(view.max_offset_s * NANOSECONDS))
    if used.stop - used.start < MIN_FRAMES:
        usual_s = float(np.median(np.diff(times))) / NANOSECONDS
        raise DataError(
            f"{view.sensor}: only {used.stop - used.start} of its {len(times)} frames lie within the acceleration, "
            f"from {shown(int(acceleration_ns[0]))} to {shown(int(acceleration_ns[-1]))}; the frames run from "
            f"{shown(int(times[0]))} to {shown(int(times[-1]))}, {usual_s:.4g} s apart. Check that their times are "
            f"in s, and {view.sensor}.rate_hz and {view.sensor}.start_s."
        )
    return used


def given_targets(camera: CameraSettings) -> tuple[Target, ...]:
    """The targets that a recording names; none where they are to be chosen."""
    if camera.roi is not None:
        return (Target(Region(*camera.roi)),)
    return tuple(Target(Region(*t.roi), name) for t, name in zip(camera.target, camera.target_names, strict=True))


def calibrated_targets(given: tuple[Target, ...], known: CameraCalibration | None) -> tuple[Target, ...]:
    """The targets to track beside a calibration: its own in use, or those of them that the recording names."""
    if known is None:
        return given
    if not given:
        return tuple(Target(target.region, target.name) for target in known.used)
    if len(given) == 1 and len(known.targets) <= 1:
        # One target's scale factor is taken for the same target that moved a little in the picture.
        return given
    regions = {target.region: target for target in known.targets}
    missing = [target.name for target in given if target.region not in regions]
    if missing or len(given) < len(known.used):
        raise UsageError(
            f"camera.target: the calibration was made for {len(known.targets)} targets, and not for the same: "
            f"{'not ' + ', '.join(missing) if missing else 'some are missing in the recording'}. Calibrate again."
        )
    return tuple(Target(target.region, target.name) for target in known.used)


def lens_of(recording: Recording) -> Lens | None:
    """The lens that [camera.lens] of a recording names, None where it names none."""
    settings = recording.settings.camera.lens if recording.settings.camera else None
    if settings is None:
        return None
    if settings.file is not None:
        return load_lens(recording.path(settings.file, "camera.lens.file"))
    return settings.lens()


def check_same_lens(lens: Lens | None, calibrated: Lens | None) -> None:
    """UsageError unless a recording's lens is that of its calibration, whose scale factor holds for no other."""
    now, then = (None if found is None else replace(found, covered_px=None) for found in (lens, calibrated))
    if now != then:
        words = "has none" if then is None else "was made with one" if now is None else "was made with another one"
        raise UsageError(
            f"camera.lens: must be that of the calibration, which {words}. A scale factor holds for one lens model "
            "only. Calibrate again, or correct [camera.lens]."
        )
