"""Opening of a camera's tracking: where it sees, the frames used, its targets, and what they are tracked with."""

from dataclasses import astuple, replace

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.calibration.camera.best_range import felt_motion
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.camera import Target
from midspan.engine.tracking import CameraTracking, StoredTracking, TrackingSettings
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.progress import Progress
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import DEFAULT_WINDOW_S, calibration_window, require_overlap, window_ends
from midspan.records import NANOSECONDS, Floats, Nanoseconds, Region
from midspan.settings.camera import CameraSettings, InfraredSettings
from midspan.settings.kinds import CAMERAS
from midspan.signals.health import runs
from midspan.signals.stamps import frames_used, shown
from midspan.sources.camera.lens import load_lens
from midspan.thermal.limits import Limits
from midspan.vision.lens import Lens
from midspan.vision.region_choice import Judge
from midspan.vision.tracker import tracker_settings

# Trackers that were made for pictures of 256 grey levels: their thresholds are in them.
IN_GREY = ("features",)
# This many frames are looked at in the window, and in the whole recording where that is dark.
LOOKED_AT, SEARCHED = 16, 240
MAX_DARK_SHARE = 0.2
# A camera sees well where it is at least so bright compared with its bright frames.
FULL_SHARE = 0.7
# Of fewer of the frames looked at in a row the first ones may be headlights, which make a poor reference.
MIN_LIT = 3
MIN_FRAMES = 2


def levels_of(view: Recording, known: CameraCalibration | None) -> Limits | None:
    """The range that is shown in grey levels; None where trackers see temperatures as they are.

    known: the calibration, whose range is taken where none is given and the tracker needs one. Raises UsageError for a
    range of pictures that hold no temperatures.
    """
    camera = view.settings.camera
    if not isinstance(camera, InfraredSettings):
        return None
    if camera.temperature_range_c is None:
        if known is None or known.temperature_range_c is None or camera.tracker not in IN_GREY:
            return None
        return Limits(*known.temperature_range_c)
    if is_grey(view):
        raise UsageError(
            f"{view.file}: infrared.temperature_range_c: must be left out for {camera.file}, which has 8-bit grey "
            "levels, not temperatures."
        )
    return Limits(*camera.temperature_range_c)


def is_grey(view: Recording) -> bool:
    """Whether a thermal camera's frames are grey levels of 8 bits instead of temperatures."""
    return not view.frames.info.radiometric and not view.frames.tracks


def where_it_sees(recording: Recording) -> tuple[Recording, list[str]]:
    """The view with a window in which its camera sees, and a sentence where that is another than the recording's.

    The window is the longest segment of light; the frames are used from the first one on. Only a camera of light
    together with another camera is looked at. Raises UntrustedError where it is dark all the time.
    """
    alone = not any(sensor.kind in CAMERAS for sensor in recording.companions)
    if recording.kind != "camera" or alone or recording.frames.tracks:
        return recording, []
    times = recording.frames.times_ns()
    first, last = window_ends(recording)
    inside = np.flatnonzero((times + recording.late_ns >= first) & (times + recording.late_ns <= last))
    if not len(inside):
        return recording, []
    _, brightness = _brightness(recording, inside, LOOKED_AT)
    if np.mean(brightness == 0.0) <= MAX_DARK_SHARE:
        return recording, []
    looked, brightness = _brightness(recording, np.arange(len(times)), SEARCHED)
    if not brightness.any():
        raise UntrustedError("All frames are dark.")
    # Dusk and dawn are left out: a reference frame from there would be a poor one.
    lit = runs(brightness > FULL_SHARE * np.percentile(brightness[brightness > 0.0], 90))
    start, end = max(lit, key=lambda run: run[1] - run[0])
    seen_from = next((run[0] for run in lit if run[1] - run[0] >= min(MIN_LIT, end - start)), start)
    begun = int(times[looked[start]]) + recording.late_ns
    last = int(times[looked[min(end, len(looked)) - 1]]) + recording.late_ns
    ended = min(last, begun + round(DEFAULT_WINDOW_S * NANOSECONDS))
    text = (
        f"camera: all frames in calibration.window_s are dark; the bright part from {shown(begun)} to {shown(ended)} "
        "was used."
    )
    return recording.seeing(begun, ended, int(times[looked[seen_from]])), [text]


def _brightness(recording: Recording, indices: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], Floats]:
    """Up to `count` of the frames, evenly, and the mean brightness of each; 0 where it is black or cannot be read."""
    chosen = indices[np.unique(np.linspace(0, len(indices) - 1, count).astype(int))]
    found = np.zeros(len(chosen))
    for k, index in enumerate(chosen.tolist()):
        frame = next(iter(recording.frames.frames(index, index + 1)), None)
        if frame is not None and not _core.is_dark(np.asarray(frame.pixels), 1):
            found[k] = float(np.mean(np.asarray(frame.pixels, dtype=np.float64)))
    return chosen, found


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
    if known is None:
        return CameraTracking(view.frames, settings, progress, judge)
    # The translation that the accelerometer shows, by a calibration of the camera.
    prepared, window, band_hz = view.prepared, calibration_window(view), view.settings.calibration.band_hz
    felt = lambda stamps: felt_motion(prepared, window, known, stamps, band_hz)  # noqa: E731
    return CameraTracking(view.frames, settings, progress, judge, felt)


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
            f"{view.sensor}: only {used.stop - used.start} of its {len(times)} frames overlap the acceleration "
            f"({shown(int(acceleration_ns[0]))} to {shown(int(acceleration_ns[-1]))}); the frames run from "
            f"{shown(int(times[0]))} to {shown(int(times[-1]))}, {usual_s:.4g} s apart. Check that their times are in "
            f"s, and {view.sensor}.rate_hz and {view.sensor}.start_s."
        )
    return used


def given_targets(camera: CameraSettings) -> tuple[Target, ...]:
    """The targets that a recording names; none where they are to be chosen."""
    if camera.roi is not None:
        return (Target(Region(*camera.roi)),)
    return tuple(Target(Region(*t.roi), name) for t, name in zip(camera.target, camera.target_names, strict=True))


def require_inside(camera: CameraSettings, size_px: tuple[int, int], where: str) -> None:
    """Raises UsageError for a region that reaches beyond the camera's picture (width, height)."""
    for number, target in enumerate(given_targets(camera), 1):
        if not target.region.inside(*size_px):
            key, numbers = f"target[{number}].roi" if camera.roi is None else "roi", astuple(target.region)
            text = f"must lie inside the image ({size_px[0]} x {size_px[1]} px); received {list(numbers)}."
            raise UsageError(
                f"{where}.{key}: {text} Correct the region; if the image size changed, check the camera first."
            )


def calibrated_targets(given: tuple[Target, ...], known: CameraCalibration | None) -> tuple[Target, ...]:
    """The targets to track with a calibration: its own in use, or those of them that the recording names."""
    if known is None:
        return given
    if not given:
        return tuple(Target(target.region, target.name) for target in known.used)
    if len(given) == 1 and len(known.targets) <= 1:
        # One target's scale factor is taken for the same target that moved a little in the picture.
        return given
    regions = {target.region for target in known.targets}
    missing = [target.name for target in given if target.region not in regions]
    if missing or len(given) < len(known.used):
        raise UsageError(
            f"camera.target: the targets must be the {len(known.targets)} of the calibration: "
            f"{'not ' + ', '.join(missing) if missing else 'some are missing in the recording'}. Calibrate again."
        )
    return tuple(Target(target.region, target.name) for target in known.used)


def lens_of(recording: Recording) -> Lens | None:
    """The lens that [camera.lens] of a recording names, None where it names none."""
    settings = recording.settings.camera.lens if recording.settings.camera else None
    if settings is None or settings.file is None:
        return None if settings is None else settings.lens()
    return load_lens(recording.path(settings.file, "camera.lens.file"))


def check_same_lens(lens: Lens | None, calibrated: Lens | None) -> None:
    """UsageError unless a recording's lens is that of its calibration, whose scale factor holds for no other."""
    now, then = (None if found is None else replace(found, covered_px=None) for found in (lens, calibrated))
    if now != then:
        words = "has none" if then is None else "was made with one" if now is None else "was made with another one"
        raise UsageError(
            f"camera.lens: must be that of the calibration, which {words}. A scale factor is valid for one lens model "
            "only. Calibrate again, or correct [camera.lens]."
        )
