"""The camera's part of a calibration: every target, along every measured image axis, relative to the accelerometer."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from midspan._core import TEMPLATE_NOISE
from midspan.calibration.agreement import Misfit, misfit
from midspan.calibration.camera.disagreement import SAME_DISTANCE, agreed, certainly_tilts, m_per_px
from midspan.calibration.camera.tilt import tilt_of
from midspan.calibration.camera.view import SeenTarget, View, printed_along, scale_on_any_clock
from midspan.calibration.camera.zoom import without_zoom
from midspan.calibration.common_offset import Fitted, one_offset, pooled_variance, shared_part
from midspan.calibration.fit import MIN_FRAMES, Pair, measured_rows
from midspan.calibration.frequency_response import FrequencyResponse
from midspan.calibration.noise import learn_motion
from midspan.calibration.own_error import OwnError
from midspan.calibration.own_noise import contradiction, strange_noise
from midspan.calibration.scale import PARTS, REFUSED_ABOVE, ScaleCalibration, of_no_camera, start_noise, too_vague
from midspan.calibration.sensors.camera import SLOW_TILT, CameraCalibration, TargetCalibration
from midspan.calibration.sensors.fit import SensorFit, bias_of
from midspan.errors import NoAgreementError, UntrustedError
from midspan.notices import Notice, rounded
from midspan.records import NANOSECONDS, InputNoise, ScaleFactor, TimeOffset
from midspan.signals.stamps import inside
from midspan.vision.lens import ideal_gain
from midspan.vision.picture_report import PictureReport
from midspan.vision.region_choice import USELESS

# What sways more slowly than this, Hz, is a mast, whose slow tilt is the sway itself.
BRACKET_HZ = 1.0
# What a codec leaves out it makes up for in some frames, which looks like an oscillator with a share of the critical
# damping that no mast has. Its size is predicted to about this factor.
CODEC_DAMPING, CODEC_WITHIN = 0.1, 1.5

CameraFit = SensorFit[CameraCalibration, ScaleCalibration]

PRINTED = (
    "calibration.literal: scale factor and clock offset are as printed (band-pass, double integration, "
    "cross-correlation, least squares). Their standard deviations include the difference from the likelihood estimate."
)


def fit_camera(
    views: Sequence[View],
    targets: Sequence[SeenTarget],
    reported: Callable[[], Sequence[str]],
    second: str = "",
    without_tilt: Mapping[str, Fitted] | None = None,
) -> tuple[CameraFit, ...]:
    """Calibrate a camera along its image axes, the main one first.

    views: the axes with an acceleration of their own, one or two; targets: as tracked through the window; reported:
    what of the frames is worth reporting, for a refusal; second: the second axis, fused or only tracked (empty: none);
    without_tilt: by image axes, the targets as a gyroscope has them.
    A second axis that cannot even be tracked is left out, and the main one's warnings tell why. Raises UntrustedError
    where no target can be calibrated along the main axis.
    """
    targets = [without_zoom(views, target) for target in targets]
    main, across, refused = views[0], (*views[1:], None)[0], ""
    turned = without_tilt or {}
    fits = [turned[main.axis] if main.axis in turned else _fitted(main, targets, reported)]
    if across is not None:
        try:
            fits.append(turned[across.axis] if across.axis in turned else _fitted(across, targets, reported))
        except UntrustedError as error:
            refused = f"Along {second} the target is only tracked, without the accelerometer. {error}"
    fits = one_offset(fits)
    if not fits[0].used:
        raise UntrustedError(
            f"The targets along {main.axis} and the other axis contradict each other: {' '.join(fits[0].reasons)} "
            "Check accelerometer.value_x, accelerometer.value_y and that both columns are of the same clock."
        )
    if len(fits) == 2 and not fits[1].used:
        refused = f"Along {second} the target is only tracked: {' '.join(fits[1].reasons)}"
        fits = fits[:1]
    offset = main.offset(fits[0].used[0].search.offset)
    axes = list(zip(views, fits, strict=False))
    judged = [_judged(view, targets, fit, offset) for view, fit in axes]
    cameras = used_along_both([camera for camera, _ in judged])
    if len(cameras) < len(axes):
        refused = f"Along {second} the target is only tracked: no target is usable along both axes."
    parts = [
        _given(view, targets, _fit_of(targets, camera, fit, notices))
        for camera, (view, fit), (_, notices) in zip(cameras, axes, judged, strict=False)
    ]
    if main.scale is None and main.printed is None:
        _refuse_vague(parts[0])
    if second and len(parts) == 1:
        return _with_tracked(main, targets, parts[0], refused)
    return tuple(parts)


def _refuse_vague(fit: CameraFit) -> None:
    total, scale = fit.calibration.relative_std, fit.calibration.scale
    if total <= REFUSED_ABOVE:
        return
    largest = max(fit.parts, key=lambda part: fit.parts[part])
    cause, remedy = PARTS[largest]
    raise UntrustedError(
        f"The scale factor is too uncertain: {too_vague(scale.value_m_per_px, total)}. "
        f"{of_no_camera(scale.value_m_per_px)}The largest part, ± {100 * fit.parts[largest]:.2g} %, "
        f"comes from {cause}. {remedy}"
    )


def _given(view: View, seen: Sequence[SeenTarget], fit: CameraFit) -> CameraFit:
    """The calibration with the scale factor that is known beforehand, or with scale and clock offset as printed."""
    if view.printed is None and view.scale is None:
        return fit
    camera, known, offset = fit.calibration, list(fit.calibration.targets), fit.calibration.offset
    best = next(k for k, target in enumerate(known) if target.region == camera.region)
    for k, target in enumerate(known):
        if not target.used:
            continue
        scale = view.scale
        if view.printed is not None:
            scale, own = printed_along(view, seen[k], target.scale)
            if view.scale is None and target.scale is not None:
                # No fit knows its own error: the distance from the likelihood's is in the variance.
                off = scale.value_m_per_px - target.scale.value_m_per_px
                scale = replace(scale, variance=scale.variance + off**2)
            scale = view.scale or scale
            offset = replace(own, variance=own.variance + (own.value_s - offset.value_s) ** 2) if k == best else offset
        known[k] = replace(target, scale=scale)
    scale = known[best].scale
    assert scale is not None
    share = scale.value_m_per_px / camera.scale.value_m_per_px
    phase = camera.phase_scale_m_per_rad
    camera = replace(
        camera,
        scale=scale,
        offset=offset,
        targets=tuple(known),
        relative_scale_std=None,
        phase_scale_m_per_rad=None if phase is None else share * phase,
        literal=view.printed is not None,
    )
    notices = (Notice("literal", PRINTED),) if view.printed is not None else ()
    parts = dict(fit.parts) if view.printed is None else {**fit.parts, "printed": abs(share - 1.0)}
    return replace(fit, calibration=camera, warnings=(*fit.warnings, *notices), parts=parts)


def used_along_both(cameras: Sequence[CameraCalibration]) -> list[CameraCalibration]:
    """The axes' calibrations with the same targets in use: what either axis leaves out, neither uses.

    Only the first one where no target would be left.
    """
    if len(cameras) < 2:
        return list(cameras)
    main, across = cameras
    pairs = list(zip(main.targets, across.targets, strict=True))
    if not any(one.used and other.used for one, other in pairs):
        return [main]
    return [
        replace(main, targets=tuple(_alongside(one, other, across.direction) for one, other in pairs)),
        replace(across, targets=tuple(_alongside(other, one, main.direction) for one, other in pairs)),
    ]


def _alongside(own: TargetCalibration, other: TargetCalibration, axis: str) -> TargetCalibration:
    """A target along one axis, out of use where it is so along the other, `axis`."""
    if other.used or not own.used:
        return own
    return replace(own, used=False, reason=f"not usable along {axis}: {other.reason}")


def _with_tracked(view: View, targets: Sequence[SeenTarget], main: CameraFit, refused: str) -> tuple[CameraFit, ...]:
    """The main axis and the second one tracked only, which is left out with a warning where that cannot be trusted."""
    reported = (Notice("part-left-out", refused),) if refused else ()
    try:
        only = _tracked_only(view, targets, main.calibration)
    except UntrustedError as error:
        axis = "x" if main.calibration.direction == "y" else "y"
        left_out = Notice("part-left-out", f"The second axis {axis} is left out of the result. {error}")
        return (replace(main, warnings=(*main.warnings, *reported, left_out)),)
    return main, replace(only, warnings=reported)


def fit_box(
    view: View, targets: Sequence[SeenTarget], *, tells: bool
) -> CameraFit | tuple[CameraCalibration, tuple[Notice, ...]]:
    """Calibrate two cameras on one box, the second one's target as seen by the first one (`box.as_seen_by`).

    tells: whether what a tilt moves both by compares for certain. The calibration of both where they show a tilt; else
    what they contradict each other by, and sentences on it. Raises UntrustedError where that is too much, or neither
    can be calibrated.
    """
    fit, _ = _alone(view, targets)
    tilt = tilt_of(view, targets, fit, lambda: _tilts(view, targets, fit)) if tells else None
    if tilt is not None:
        fit = Fitted(tuple(tilt.found for _ in targets), ("",) * len(targets), tilt)
    if not fit.used:
        raise UntrustedError(" ".join(fit.reasons))
    if tilt is None:
        (fit,) = one_offset([fit])
    offset = view.offset(fit.used[0].search.offset)
    camera, notices = _judged(view, targets, fit, offset)
    if tilt is not None:
        return _fit_of(targets, camera, fit, notices)
    for before, after in zip(_each(view, targets, fit, offset).targets, camera.targets, strict=True):
        if before.used and not after.used:
            # Of two nothing but the accelerometer says so, which a slow tilt deceives.
            raise UntrustedError(f"Either {after.name} moves on its own or both tilt: {after.reason}")
    return camera, notices


def _fitted(view: View, targets: Sequence[SeenTarget], reported: Callable[[], Sequence[str]]) -> Fitted:
    fit, refused = _alone(view, targets)
    tilt = tilt_of(view, targets, fit, lambda: _tilts(view, targets, fit)) if len(targets) > 1 else None
    if tilt is not None:
        return Fitted(tuple(tilt.found for _ in targets), tilt.others.reasons, tilt)
    if any(fit.found):
        return fit
    alone = len(targets) == 1
    lines = [why if alone else f"Target {one.name}: {why}" for one, why in zip(targets, fit.reasons, strict=True)]
    more = (error.more for error in refused if error.more)
    text, rest = lines[0], " ".join((*lines[1:], *more, *reported()))
    offsets_s = [one.clock_offset_s for one in refused if isinstance(one, NoAgreementError)]
    apart_s = [one + view.late_ns / NANOSECONDS for one in offsets_s if one is not None]
    raise NoAgreementError(text, float(np.median(apart_s)), rest) if apart_s else UntrustedError(text, rest)


def _alone(view: View, targets: Sequence[SeenTarget]) -> tuple[Fitted, list[UntrustedError]]:
    """Each target on its own, and why some are refused."""
    found: list[ScaleCalibration | None] = []
    reasons: list[str] = []
    refused: list[UntrustedError] = []
    for target in targets:
        try:
            own = scale_on_any_clock(view, target)
            _refuse_pattern(target.tracker.scale_share_std, own.scale)
            _refuse_compression(target.with_picture_error(own.scale, view.axis), own.scale)
            found.append(own)
            reasons.append("")
        except UntrustedError as error:
            found.append(None)
            reasons.append(str(error))
            refused.append(error)
    return Fitted(tuple(found), tuple(reasons)), refused


def _tilts(view: View, targets: Sequence[SeenTarget], fit: Fitted) -> bool:
    """Whether nothing but a tilt explains what the targets differ by."""
    if not fit.used:
        return False
    offset = view.offset(fit.used[0].search.offset)
    return certainly_tilts(view, targets, _each(view, targets, fit, offset), fit)


def _refuse_pattern(share_std: float, estimated: ScaleFactor) -> None:
    """UntrustedError where a thermal camera's fixed pattern may draw the translations to zero by too much."""
    if share_std <= REFUSED_ABOVE:
        return
    raise UntrustedError(
        "The thermal camera's fixed pattern is too strong for this scene to calibrate the scale factor: it may bias "
        f"translations towards zero by {100 * share_std:.2g} % (σ; at most {100 * REFUSED_ABOVE:g} % is accepted). "
        "Choose an infrared.roi with more contrast, or run the shutter correction before recording.",
        more=f"The {1e3 * estimated.value_m_per_px:.4g} mm/px are biased with them. A target that moves by half a "
        "pixel or more from the beginning separates the pattern from the scene.",
    )


def _refuse_compression(scale: ScaleFactor, estimated: ScaleFactor) -> None:
    """UntrustedError where a scale factor with what compression may do to it is too vague to be given out."""
    if (relative := np.sqrt(scale.variance) / abs(scale.value_m_per_px)) <= REFUSED_ABOVE:
        return
    codec = np.sqrt(scale.variance - estimated.variance) / abs(scale.value_m_per_px)
    raise UntrustedError(
        f"Too much compression to calibrate the scale factor: {1e3 * scale.value_m_per_px:.4g} mm/px ± "
        f"{rounded(100 * relative)} %, of which ± {rounded(100 * codec)} % from the video compression; at most ± "
        f"{100 * REFUSED_ABOVE:g} % is accepted. Record with a higher bit rate or without compression, or choose a "
        "camera.roi with more contrast or a calibration.window_s with more image motion."
    )


def _judged(
    view: View, targets: Sequence[SeenTarget], fit: Fitted, offset: TimeOffset
) -> tuple[CameraCalibration, tuple[Notice, ...]]:
    """All targets along one axis as one calibration; those that do not agree with the others are not used."""
    camera = _each(view, targets, fit, offset)
    if fit.tilt is not None:
        held_m = float(np.hypot(fit.tilt.others.held_m, fit.tilt.left_m))
        tilts = {"tilt_std_px": fit.tilt.std_px, "tilt_walk_px2_s": fit.tilt.walk_px2_s}
        camera = replace(camera, **tilts, apart_std_m=held_m)
        return camera, (fit.tilt.text([target.name for target in targets]),)
    return agreed(view, targets, camera, fit)


def _each(view: View, targets: Sequence[SeenTarget], fit: Fitted, offset: TimeOffset) -> CameraCalibration:
    """All targets along one axis as one calibration, each by its own fit."""
    known = []
    for target, found, why in zip(targets, fit.found, fit.reasons, strict=True):
        if found is None:
            known.append(TargetCalibration(target.region, target.name, None, used=False, reason=why))
            continue
        number = len(known)
        scale = found.scale if fit.tilt is None else fit.tilt.scale(number)
        noise_px = found.noise.std if fit.tilt is None else fit.tilt.noise_px[number]
        scale = target.with_picture_error(scale, view.axis).wider(found.response.relative_std)
        factor = found.variance_factor * (1.0 if fit.tilt is None else _by_own_error(found))
        figures = (scale, noise_px, factor)
        lever_px = target.lever_px(view.axis)
        known.append(TargetCalibration(target.region, target.name, *figures, not why, why, lever_px))
    known = known if fit.tilt is not None else _without_useless(known)
    found = fit.found[_best(known)]
    assert found is not None
    return replace(_camera(targets, view.axis, known, offset), exposure_s=found.response.exposure_s)


def _by_own_error(found: ScaleCalibration) -> float:
    """By how much the slow error of a difference makes frames noisier: the estimator's slow error is the tilt."""
    own = found.own
    return 1.0 if own is None or not own.taken else 1.0 + (own.std / found.noise.std) ** 2


def _fit_of(seen: Sequence[SeenTarget], camera: CameraCalibration, fit: Fitted, notices: Sequence[Notice]) -> CameraFit:
    """One axis whose targets have been judged: the values of the best one, and what is worth reporting."""
    found = fit.found[_best(camera.targets)]
    assert found is not None
    used = [(f, t) for f, t in zip(fit.found, camera.targets, strict=True) if f is not None and t.used]
    several = len(camera.targets) > 1 and fit.tilt is None
    warnings = [*notices, *_left_out(camera)]
    for one, target in used[: 1 if fit.tilt is not None else None]:
        warnings += [line.worded(f"Target {target.name}: {line}") if several else line for line in one.warnings]
    search, tilt_m, best = found.search, camera.apart_std_m, seen[_best(camera.targets)]
    own = found.own
    codec_own = own is not None and of_codec(own, best.picture)
    taken = own if own is not None and own.taken and fit.tilt is None else None
    apart_m, slow_m = _contradicted_m(found, tilt_seen=fit.tilt is not None)
    if codec_own:
        # What compression makes of a translation is noise of the rows, and no vibration.
        apart_m = 0.0
    lever = best.levers.get(camera.direction)
    if lever is not None:
        apart_m = float(np.hypot(apart_m, lever.left_px * abs(found.scale.value_m_per_px)))
        warnings.append(lever.text(found.scale.value_m_per_px))
    # The noise of the reference frame is in all rows alike.
    start = start_noise(search.pair, search.fit)
    start_m = TEMPLATE_NOISE * start.std * abs(found.scale.value_m_per_px)
    camera = replace(
        _camera(seen, camera.direction, camera.targets, camera.offset),
        relative_scale_std=relative_scale_std(*zip(*used, strict=True)) if len(used) > 1 and fit.tilt is None else None,
        tilt_std_px=camera.tilt_std_px,
        tilt_walk_px2_s=camera.tilt_walk_px2_s,
        exposure_s=found.response.exposure_s,
        apart_std_m=float(np.sqrt(apart_m**2 + tilt_m**2 + start_m**2 + found.response.other_m**2)),
        slow_std_m=0.0 if taken is None else slow_m,
        slow_time_s=np.inf if taken is None else taken.time_s,
        slow_hz=0.0 if taken is None else taken.hertz,
    )
    bias = bias_of(search.pair, search.fit, float(np.sqrt(search.offset.variance)))
    # The integrated acceleration that the pair keeps besides its fields is no part of the result.
    plain = replace(found, search=search.on_clock(camera.offset.value_s - search.offset.value_s))
    coloured = misfit(search.pair, search.fit)
    warnings += _zero_warnings(start_m, drifts=start.drifts)
    if not codec_own:
        warnings += _apart_warnings(found, coloured, (slow_m, apart_m), camera.targets, tilt_seen=fit.tilt is not None)
    parts = {
        "motion": float(np.sqrt(found.scale.variance)) / abs(found.scale.value_m_per_px),
        "compression": best.codec_std(camera.direction),
        "pattern": best.tracker.scale_share_std,
        "response": found.response.relative_std,
        "misfit": float(np.sqrt(coloured.factor - 1.0)) * camera.relative_std,
    }
    return CameraFit(
        camera.without_gain(1.0, parts["misfit"]),
        found.input_noise,
        bias,
        tuple(doubt_exposures(warnings, parts["compression"])),
        plain,
        misfit=coloured,
        slope=found.response.slope,
        direction=found.direction,
        parts=parts,
    )


def _contradicted_m(found: ScaleCalibration, *, tilt_seen: bool) -> tuple[float, float]:
    """Rms (m) of what camera and accelerometer contradict each other by, of unknown cause, and of a slow error."""
    own, scale = found.own, abs(found.scale.value_m_per_px)
    if own is None:
        # What the accelerometer errs by is its noise.
        return (0.0 if found.felt_alone else contradiction(found.search.pair, found.search.fit)) * scale, 0.0
    slow_m = own.std * scale
    # Nothing tells whose error it is.
    unknown_m = 0.0 if own.alone and own.taken and not tilt_seen else slow_m
    tilt_m = SLOW_TILT * slow_m if _tilts_unseen(found, tilt_seen=tilt_seen) else 0.0
    return float(np.hypot(unknown_m, tilt_m)), slow_m


def of_codec(own: OwnError, picture: PictureReport | None) -> bool:
    """Whether an error of the image is what compression makes of it: of its size, without a resonance."""
    if picture is None or not own.sways:
        return False
    damped = own.hertz * own.time_s < 1.0 / (2.0 * np.pi * CODEC_DAMPING)
    return damped and own.std <= CODEC_WITHIN * picture.compression.std_px


def _tilts_unseen(found: ScaleCalibration, *, tilt_seen: bool) -> bool:
    """Whether the camera sways on its bracket, and its slow tilt is not seen."""
    own = found.own
    return own is not None and own.sways and own.hertz > BRACKET_HZ and not tilt_seen


def _left_out(camera: CameraCalibration) -> list[Notice]:
    text = f"Target {{0}} is left out along {camera.direction}: {{1}}"
    return [Notice("part-left-out", text.format(one.name, one.reason)) for one in camera.targets if not one.used]


def doubt_exposures(notices: Sequence[Notice], compression_std: float) -> list[Notice]:
    """Notices of an exposure with the other cause of what they rest on; compression_std: what the compression of the
    film may do to the scale factor, relative, 0 without it.
    """
    other = "Video compression also attenuates fast, small motion; the true exposure may be far shorter."
    doubtful = [one.code == "exposure" and compression_std > 0.0 for one in notices]
    return [one.worded(f"{one} {other}") if doubt else one for one, doubt in zip(notices, doubtful, strict=True)]


def _apart_warnings(
    found: ScaleCalibration,
    coloured: Misfit,
    sizes_m: tuple[float, float],
    targets: Sequence[TargetCalibration],
    *,
    tilt_seen: bool,
) -> list[Notice]:
    """What camera and accelerometer differ by besides noise, in a sentence; sizes_m: of a slow error, and of what is of
    unknown cause; tilt_seen: whether the targets show it.
    """
    slow_m, apart_m = sizes_m
    if found.own is not None:
        second = "A second target or a gyroscope on the camera would show it." if len(targets) == 1 else ""
        text = found.own.text("camera", slow_m, second)
        if tilt_seen:
            text = (
                f"camera: its targets move against each other by {rounded(1e3 * slow_m)} mm rms, which neither a tilt "
                "nor the accelerometer explains: a roll, hot air, or one moves on its own. It is in the error band."
            )
        if _tilts_unseen(found, tilt_seen=tilt_seen):
            text += (
                f" It may tilt slowly as well: the error band includes {rounded(1e3 * SLOW_TILT * slow_m)} mm for that."
            )
            if not _differ_in_distance(targets):
                text += " A target at another distance would show the tilt."
        return [Notice("motion-not-shared", text)]
    if apart_m > 0.0:
        return [Notice("motion-not-shared", _contradiction_text(apart_m, found.response))]
    causes = "a vibrating mast or bracket, autofocus, hot air, or a rotating target"
    search = found.search
    return coloured.text("camera") or strange_noise(search.pair, search.fit, "camera", causes)


def _differ_in_distance(targets: Sequence[TargetCalibration]) -> bool:
    """Whether scale factors are those of targets at several distances."""
    scales = [m_per_px(target) for target in targets if target.scale is not None]
    return min(scales) < (1.0 - SAME_DISTANCE) * max(scales)


def _zero_warnings(start_m: float, *, drifts: bool) -> list[Notice]:
    zero = f"the zero is known only to {rounded(1e3 * start_m)} mm"
    text = f"camera: the first frames are far noisier than the others; {zero}, and an apparent shift among them "
    text += "may be noise."
    if drifts:
        text = "accelerometer: its gain or bias differs at the start, as during warm-up; "
        text += f"{zero}. Let it warm up before recording."
    return [Notice("zero-uncertain", text)] if start_m > 0.0 else []


def _contradiction_text(apart_m: float, response: FrequencyResponse) -> str:
    differs = f"differ by {1e3 * apart_m:.2g} mm rms, far more than their noise; the error band includes it. "
    if response.accelerometer_errs:
        # With what was found taken out they do not contradict each other.
        return (
            f"camera: it and the accelerometer {differs}The cause is the estimated low-pass or resonance of the "
            "accelerometer."
        )
    return (
        f"camera: the image shows motion that the accelerometer does not, or the reverse: they {differs}Likely "
        "causes: vibration of the camera or its bracket (above the Nyquist frequency it is aliased to slow motion), "
        "cross motion on an inclined axis, a soft mounting. Stiffen both mountings, check the axis, raise the frame "
        "rate."
    )


def noise_m(target: TargetCalibration) -> float:
    """Noise of one frame's displacement, m; infinite for a target that is not used."""
    return m_per_px(target) * target.noise_std_px if target.used and target.scale is not None else np.inf


def _best(targets: Sequence[TargetCalibration]) -> int:
    return min(range(len(targets)), key=lambda k: noise_m(targets[k]))


def _without_useless(targets: list[TargetCalibration]) -> list[TargetCalibration]:
    best = min(noise_m(target) for target in targets)
    for k, target in enumerate(targets):
        noise = noise_m(target)
        if target.used and not noise <= USELESS * best:
            reason = (
                f"it differs from the acceleration by {1e3 * noise:.2g} mm per frame, {noise / best:.0f} times as "
                "much as the best target: it moves on its own or is too noisy."
            )
            targets[k] = replace(target, used=False, reason=reason)
    return targets


def _camera(
    seen: Sequence[SeenTarget], direction: str, targets: Sequence[TargetCalibration], offset: TimeOffset
) -> CameraCalibration:
    place = _best(targets)
    best = targets[place]
    assert best.scale is not None
    own = seen[place]
    gain, lens = own.tracker.phase_gain_px_per_rad, own.lens
    gains = None if gain is None else ideal_gain(gain, own.tracker.region, lens)
    return CameraCalibration(
        scale=best.scale,
        offset=offset,
        region=best.region,
        direction=direction,
        tracker=own.tracker_name,
        noise_std_px=best.noise_std_px,
        variance_factor=best.variance_factor,
        phase_scale_m_per_rad=None if gains is None else best.scale.value_m_per_px * gains["xy".index(direction)],
        targets=tuple(targets),
        lens=lens,
    )


def relative_scale_std(scales: Sequence[ScaleCalibration], targets: Sequence[TargetCalibration]) -> float:
    """Relative standard deviation of the scale factor of all targets' mean.

    scales: as estimated; targets: the same with what compression may do to them, which is one error of the whole video
    and does not average out.
    """
    relative = np.array([s.scale.variance / s.scale.value_m_per_px**2 for s in scales])
    with_codec = [t.scale.variance / t.scale.value_m_per_px**2 for t in targets if t.scale is not None]
    weight = np.array([1.0 / (s.scale.value_m_per_px * s.noise.std) ** 2 for s in scales])
    weight /= weight.sum()
    shared = float(np.mean([shared_part(s) for s in scales]))
    codec = pooled_variance(weight, np.maximum(np.array(with_codec) - relative, 0.0), 1.0)
    return float(np.sqrt(pooled_variance(weight, relative, shared) + codec))


def _tracked_only(view: View, seen: Sequence[SeenTarget], main: CameraCalibration) -> CameraFit:
    """The axis without an accelerometer, in square pixels; positive where the structure moves right or down."""
    axis = "x" if main.direction == "y" else "y"
    targets, densities = [], []
    tracked_of = [one for one, known in zip(seen, main.targets, strict=True) if known.used]
    for target, tracked in zip(main.used, tracked_of, strict=True):
        track = tracked.rows
        assert target.scale is not None
        value = -abs(target.scale.value_m_per_px)
        first, last = view.window_ns
        translation, variance = track.along(axis)
        time_ns = track.time_ns + view.late_ns
        window = inside(time_ns, first, last)
        rows = measured_rows(time_ns[window], value * translation[window], value**2 * variance[window], first)
        usable = np.count_nonzero(np.isfinite(rows[:, 2]))
        if usable < MIN_FRAMES:
            raise UntrustedError(
                f"{usable} usable frames lie in the calibration window along {axis}; at least {MIN_FRAMES} are needed."
            )
        still = view.prepared.rows(first, view.window) * np.array([1.0, 0.0, 1.0])
        # The tracker is as far from its own variance as along the other axis.
        rows[:, 2] *= target.variance_factor
        usual = float(np.sqrt(target.variance_factor * np.nanmedian(variance[window])))
        scale = ScaleFactor(value, target.scale.variance)
        targets.append(TargetCalibration(tracked.region, tracked.name, scale, usual, target.variance_factor))
        densities.append(learn_motion(Pair(still, rows, 1.0)))
    camera = replace(
        _camera(tracked_of, axis, targets, main.offset), fused=False, relative_scale_std=main.relative_scale_std
    )
    return CameraFit(camera, InputNoise(densities[_best(targets)]))
