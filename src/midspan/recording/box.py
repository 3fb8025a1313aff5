"""The cameras of a recording together: each is calibrated alone, and two on one box by the tilt that both show."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import hypot, inf
from typing import Any

import numpy as np

from midspan.calibration.camera.box import Together, as_seen_by
from midspan.calibration.camera.box import together as compared
from midspan.calibration.camera.calibrate import CameraFit, fit_box
from midspan.calibration.camera.view import SeenTarget, View, filter_settings, target_block
from midspan.calibration.camera.with_radar import with_tilt
from midspan.calibration.scale import UNEXPLAINED_SHARE
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.fit import SensorFit
from midspan.engine.tracking import CameraTracking
from midspan.errors import MidspanError, UntrustedError
from midspan.fusion.path import at
from midspan.fusion.streams import smooth
from midspan.notices import Notice, rounded
from midspan.progress import Progress
from midspan.recording.cameras import SeenBy, calibrated_camera, named, seen_targets, view_of
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import window_ends
from midspan.recording.tracking.opening import open_tracking, where_it_sees
from midspan.recording.tracking.posed import PosedTracking
from midspan.records import NANOSECONDS, Floats, ScaleFactor, TimeOffset, part
from midspan.settings.messages import renamed
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.signals.medians import SIGMA_OF_MEDIAN
from midspan.signals.stamps import inside

REMEDY = (
    "Cameras on one box share its tilt: let one camera see targets at both distances, add a [gyroscope], or give each "
    "camera its lens and its target's distance_m."
)


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A camera in the calibration window: its view, tracking and only target, and what it tells alone."""

    recording: Recording
    tracking: CameraTracking
    view: View
    target: SeenTarget
    alone: SeenBy | None

    @property
    def offset_s(self) -> float | None:
        """The clock offset besides the view's, as calibrated."""
        if self.alone is None:
            return None
        return self.alone.parts[0].calibration.offset.value_s - self.view.late_ns / NANOSECONDS

    @property
    def step_ns(self) -> int:
        """Mean time between frames."""
        time_ns = self.target.rows.time_ns
        return int(time_ns[-1] - time_ns[0]) // max(len(time_ns) - 1, 1)


def calibrate_cameras(recording: Recording, progress: Progress) -> tuple[SeenBy, ...]:
    """Calibrate every camera of a recording, the one whose zero counts first.

    One of several that cannot be trusted is left out, and the first one's warnings tell why; UntrustedError where none
    is left.
    """
    found: dict[str, SeenBy] = {}
    refused: dict[str, UntrustedError] = {}
    for view in recording.cameras:
        try:
            found[view.sensor] = calibrated_camera(view, progress)
        except UntrustedError as error:
            refused[view.sensor] = error
    for pair in combinations(recording.cameras, 2):
        if any(view.sensor in found and found[view.sensor].parts[0].calibration.tilt_of for view in pair):
            # Its tilt is shared with another one already.
            continue
        both = _by_tilt(pair, found, progress)
        found |= both
        refused = {name: error for name, error in refused.items() if name not in both}
    if not found:
        if len(refused) == 1:
            raise next(iter(refused.values()))
        why, *rest = (f"{name}: {error}" for name, error in refused.items())
        rest += [error.more for error in refused.values() if error.more]
        raise UntrustedError(why, " ".join(rest))
    reported = tuple(
        Notice("part-left-out", f"[{name}] is left out of the result. {error}") for name, error in refused.items()
    )
    first, *others = (found[view.sensor] for view in recording.cameras if view.sensor in found)
    return (replace(first, warnings=(*reported, *first.warnings)), *others)


def together(seen: tuple[SeenBy, ...]) -> CameraTracking | None:
    """The tracking of the first camera, with those of the others with it; None without a camera."""
    if not seen:
        return None
    first, *others = (one.tracking for one in seen)
    first.companions = tuple(others)
    return first


def _by_tilt(pair: Sequence[Recording], alone: Mapping[str, SeenBy], progress: Progress) -> dict[str, SeenBy]:
    """Two cameras by the tilt that they share, or with what they contradict each other by; nothing where they are as
    they are alone.
    """
    if any(not _is_plain(one) for one in pair):
        return {}
    both = [_seen(one, alone.get(one.sensor), progress) for one in pair]
    seen = [one for one in both if one is not None]
    if len(seen) < 2:
        return {}
    # Between frames of the faster one less happens.
    base, other = sorted(seen, key=lambda one: -one.step_ns)
    moves = _moves(base, other)
    found = compared(base.view, base.target, other.view, other.target, (base.offset_s, other.offset_s), moves)
    if found is None:
        return {}
    if not found.tells:
        if base.offset_s is None or other.offset_s is None:
            return {}
        # Whatever the ratio is, both are compared as displacements.
        found = replace(found, ratio=1.0, std=inf, late_s=other.offset_s - base.offset_s)
    moved = as_seen_by(base.target, base.view, other.target, other.view, found, moves)
    if moved is None:
        return {}
    try:
        fit = fit_box(base.view, [base.target, moved], tells=found.tells)
    except UntrustedError as error:
        if any(one.alone is None for one in seen):
            return {}
        apart_m, motion_m = _differ_m(base, other, moved)
        if found.tells or apart_m > UNEXPLAINED_SHARE * motion_m:
            raise UntrustedError(f"{error} {REMEDY}") from None
        text = f"the cameras differ by {rounded(1e3 * apart_m)} mm rms; the error band includes it."
        return _apart(seen, apart_m, (Notice("motion-not-shared", f"camera: {text}"),))
    if not isinstance(fit, tuple):
        return _joined(seen[0], base, other, fit, found)
    camera, notices = fit
    if not notices or any(one.alone is None for one in seen):
        return {}
    return _apart(seen, camera.apart_std_m, notices)


def _differ_m(base: _Seen, other: _Seen, moved: SeenTarget) -> tuple[float, float]:
    """What two cameras differ by as displacements, m, whatever stood before one of them for a while, and the motion's
    rms; moved: the second one's target at the first one's frames, in its own pixels.
    """
    shown = []
    for one, target in ((base, base.target), (other, moved)):
        assert one.alone is not None
        value = target.rows.along(base.view.axis)[0]
        shown.append(one.alone.parts[0].calibration.scale.value_m_per_px * value)
    both = np.isfinite(shown[0]) & np.isfinite(shown[1])
    apart = shown[0][both] - shown[1][both]
    return float(SIGMA_OF_MEDIAN * np.median(np.abs(apart - np.median(apart)))), float(np.std(shown[0][both]))


def _moves(base: _Seen, other: _Seen) -> Callable[[Floats], Floats]:
    """What the displacement that the first camera and the accelerometer tell makes of the second one's image, px; none
    where one of them is not calibrated alone.
    """
    if base.alone is None or other.alone is None:
        return np.zeros_like
    fit, own = base.alone.parts[0], other.alone.parts[0].calibration
    view, noise = base.view, fit.input_noise
    acceleration = view.prepared.with_noise(noise.density, noise.motion_s)
    block = target_block(base.target, fit.calibration.mappings()[0], fit.calibration.exposure_s, acceleration)
    first, last = int(block.time_ns[0]) - NANOSECONDS, int(block.time_ns[-1]) + NANOSECONDS
    near = part(acceleration, inside(acceleration.time_ns, first, last))
    path = smooth(near, block, filter_settings(view.prepared, noise.density, lean=GRAVITY_M_S2 * fit.slope)).estimate
    apart_ns = view.window_ns[0] - other.view.late_ns + round(NANOSECONDS * own.offset.value_s)

    def moved_px(time_s: Floats) -> Floats:
        time_ns = apart_ns + np.rint(NANOSECONDS * time_s).astype(np.int64)
        return np.asarray(at(path, time_ns)[0] / own.scale.value_m_per_px)

    return moved_px


def _is_plain(recording: Recording) -> bool:
    """Whether a camera's only axis is calibrated by likelihood, and no sensor measures its tilt."""
    view, turns = view_of(recording), any(kind != "velocity" for kind in recording.root.auxiliary)
    known = view.scale is not None or view.printed is not None
    return recording.across is None and not known and not turns and not recording.posed


def _seen(recording: Recording, alone: SeenBy | None, progress: Progress) -> _Seen | None:
    """A camera with one target in the calibration window; None where it has several, or nothing is to be seen."""
    try:
        if alone is not None:
            recording = recording.later(alone.parts[0].calibration.offset.value_s)
        view, _ = where_it_sees(recording)
        tracking = open_tracking(view, None, progress) if alone is None else alone.tracking
        if isinstance(tracking, PosedTracking) or len(tracking.targets) != 1:
            return None
        tracking.until(window_ends(view)[1] - view.late_ns)
        (target,) = seen_targets(view, tracking)
    except MidspanError:
        return None
    return _Seen(view, tracking, view_of(view), replace(target, name=view.sensor), alone)


def _apart(seen: Sequence[_Seen], apart_m: float, notices: Sequence[Notice]) -> dict[str, SeenBy]:
    """Both cameras with what they contradict each other by (rms, m) in the band, and sentences on it."""
    found = {}
    text = tuple(line.worded(f"{line} {REMEDY}") for line in notices)
    for number, one in enumerate(seen):
        assert one.alone is not None
        known = one.alone.parts[0].calibration
        wider = replace(one.alone.parts[0], calibration=replace(known, apart_std_m=max(known.apart_std_m, apart_m)))
        warnings = (*one.alone.warnings, *(() if number else text))
        found[one.recording.sensor] = replace(one.alone, parts=(wider,), warnings=warnings)
    return found


def _joined(lead: _Seen, base: _Seen, other: _Seen, fit: CameraFit, found: Together) -> dict[str, SeenBy]:
    """Both cameras by the difference that is free of their tilt, which is counted in pixels of the one that leads."""
    whole = fit.calibration
    assert fit.diagnostics is not None
    # By the ratio's error some of the tilt is left.
    left_m = found.std / abs(found.ratio) * whole.tilt_std_px * abs(fit.diagnostics.scale.value_m_per_px)
    whole = replace(whole, apart_std_m=hypot(whole.apart_std_m, left_m), tilt_of=lead.recording.sensor)
    late_s = whole.offset.value_s + found.late_s + (other.view.late_ns - base.view.late_ns) / NANOSECONDS
    offset = TimeOffset(late_s, whole.offset.variance + found.late_std_s**2)
    per_base, per_other = (1.0, 1.0 / found.ratio) if lead is base else (found.ratio, 1.0)
    known = (
        (base, replace(_part(whole, 0, 1.0), tilt_ratio=per_base)),
        (other, replace(_part(whole, 1, found.ratio), tilt_ratio=per_other, offset=offset)),
    )
    both = {}
    for one, own in known:
        named_fit = named(one.recording, one.tracking, replace(fit, calibration=own))
        notices = tuple(renamed(line, base.recording.sensor) for line in fit.warnings) if one is lead else ()
        both[one.recording.sensor] = SeenBy((named_fit,), one.tracking, notices)
    return both


def _part(whole: CameraCalibration, number: int, ratio: float) -> CameraCalibration:
    """One camera's part of the calibration of both; ratio: pixels of these that one of its own is."""
    target = whole.targets[number]
    assert target.scale is not None
    scale = ScaleFactor(target.scale.value_m_per_px * ratio, target.scale.variance * ratio**2)
    target = replace(target, name="1", scale=scale, noise_std_px=target.noise_std_px / abs(ratio))
    return replace(
        whole,
        scale=scale,
        region=target.region,
        noise_std_px=target.noise_std_px,
        variance_factor=target.variance_factor,
        targets=(target,),
        tilt_std_px=whole.tilt_std_px / abs(ratio),
        tilt_walk_px2_s=whole.tilt_walk_px2_s / ratio**2,
    )


def with_radar(
    recording: Recording, seen: tuple[SeenBy, ...], fits: Sequence[SensorFit[Any, Any]]
) -> tuple[SeenBy, ...]:
    """The cameras of one target with the tilt that the first radar does not show; fits: of the other sensors."""
    radar = next((fit for fit in fits if fit.moved is not None), None)
    views = {view.sensor: view for view in recording.cameras}
    return (
        seen if radar is None else tuple(_with_radar(views[one.tracking.settings.sensor], one, radar) for one in seen)
    )


def _with_radar(recording: Recording, one: SeenBy, radar: SensorFit[Any, Any]) -> SeenBy:
    camera = one.parts[0].calibration
    if camera.tilt_std_px > 0.0 or not camera.fused or len(camera.targets) != 1 or len(one.tracking.targets) != 1:
        return one
    (target,) = seen_targets(recording, one.tracking)
    fit, notice = with_tilt(view_of(recording), target, one.parts[0], radar)
    if notice is None:
        return one
    # What is said of a sway is said of the tilt now.
    kept = [line for line in one.warnings if camera.slow_std_m == 0.0 or line.code != "motion-not-shared"]
    return replace(one, parts=(fit, *one.parts[1:]), warnings=(*kept, renamed(notice, recording.sensor)))
