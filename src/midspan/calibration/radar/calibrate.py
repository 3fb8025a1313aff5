"""The radar's part of a calibration: fixed targets, their conversion factors, one clock offset."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.agreement import misfit
from midspan.calibration.common_offset import MIN_OFFSET_S, OFFSET_STD, weighted_median
from midspan.calibration.direction import Direction, turned
from midspan.calibration.fit import Fit, Pair, best_corner, measured_rows
from midspan.calibration.frequency_shapes import Kind, kinds_of
from midspan.calibration.own_error import averaged, find_own_error
from midspan.calibration.own_noise import SLOW_HZ, narrow_motion
from midspan.calibration.radar.clock import Seen, clock_skew
from midspan.calibration.radar.jitter import JITTER, frames_jitter
from midspan.calibration.radar.own_motion import judged
from midspan.calibration.radar.window import OpenedWindow, clearly_seen, found_targets, refuse_farther
from midspan.calibration.scale import WARNED_ABOVE, is_ambiguous, with_frequency
from midspan.calibration.sensors.fit import SensorFit, bias_of
from midspan.calibration.sensors.radar import RadarCalibration, RadarDiagnostics, RadarTarget
from midspan.calibration.time_offset import OffsetSearch, search_offset
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.notices import Notice
from midspan.radar.channels import noise_variance
from midspan.radar.chirp import RadarInfo
from midspan.radar.following import at_place
from midspan.radar.frames import (
    RadarFrames,
    samples_of,
    series_of,
    together,
    without_holes,
)
from midspan.radar.measurement import TargetSeries
from midspan.radar.target import MAX_CLUTTER, MAX_RELATIVE_STD, Target, ranked
from midspan.records import NANOSECONDS, Displacement, Floats, Source, TimeOffset
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.stamps import inside

# Rows that the likelihood is evaluated on at most; a faster radar is thinned.
MAX_ROWS = 8000
# The two ways to the factor, closed form and likelihood, may differ by this many standard deviations before that is put
# into the stated one.
AGREED_STD = 3.0
# A clock offset known worse than this (s) brings a warning.
WARNED_OFFSET_S = 2e-3
# A factor below 1 by more than this share, and by this many standard deviations, is that of no fixed target.
MIN_SHORT, SHORT_STD = 0.02, 5.0
# A target farther than this from the range that was asked for is another one, m.
MAX_M = 0.5


# Errors of a target that are slower than half of this rate, Hz, are compared with the accelerometer.
OWN_RATE_HZ = 10.0

RadarFit = SensorFit[RadarCalibration, None]
# Points of the window that are kept for the report.
KEPT = 2000


def fit_radar(
    window: OpenedWindow,
    prepared: PreparedAcceleration,
    info: RadarInfo,
    *,
    most_targets: int,
    target_range_m: float | None = None,
) -> RadarFit:
    """Choose fixed targets and learn their conversion factors and the clock offset in the calibration window.

    most_targets: this many are used at most; target_range_m: where the only one is wanted. Where the accelerometer's
    other axes were recorded, the acceleration is that along the direction which the clearest target shows. Raises
    UntrustedError, with the reason, where no target follows the accelerometer well enough.
    """
    own = _along_axis(window, prepared, info)
    prepared, samples, frames, (origin, max_offset) = own.prepared, own.samples, window.frames, window.clock
    found, frames, hidden = clearly_seen(frames, samples, info, (max_offset, most_targets))
    if all(target.objection for target in found):
        refuse_farther(frames, prepared, info, (origin, max_offset))
    found, frames = _at_one_pace(found, frames, samples, (info, max_offset))
    whole = without_holes(frames)
    targets, offset = _chosen(found, most_targets, target_range_m)
    seen = [series_of(frames, item.target, info, samples) for item in targets if item.used]
    targets, moving = judged(targets, seen, whole.time_ns / NANOSECONDS + offset.value_s, samples, prepared.lines)
    best = _best(targets)
    moved = series = series_of(frames, best, info, samples)
    # A second way to clock offset, factor and noise levels of the best target.
    search = search_offset(radar_pair(prepared, whole, series, (origin, max_offset)), max_offset)
    _refuse_ambiguity(search, max_offset)
    # The clock offset is the targets' own.
    kinds = [kind for kind in kinds_of(search.pair, exposure_declared=True) if kind is not Kind.LAG]
    search, response = with_frequency(search, search.pair, max_offset, kinds)
    if response.known:
        targets = _without_gain(targets, best.conversion_factor * search.fit.ratio)
        best = _best(targets)
        moved = series_of(frames, best, info, samples)
    targets, contradicted = _contradicted(targets, search, moving, _stated(series))
    calibration = RadarCalibration(
        targets=targets,
        offset=TimeOffset(offset.value_s, offset.variance + own.offset_variance),
        variance_factor=_variance_factor(search, best, series),
        relative_std=_relative_std([item.target for item in targets if item.used]),
        carrier_hz=info.carrier_hz,
        channels=info.channels,
        diagnostics=diagnostics_of(info.axis.range_m, whole, best),
    )
    coloured = misfit(search.pair, search.fit)
    reported = (*info.warnings, *window.reported, *hidden, *contradicted, *response.texts(search.fit.motion_hz))
    more = (np.sqrt(coloured.factor - 1.0) * calibration.relative_std, response.relative_std, own.relative_std)
    return RadarFit(
        calibration.without_gain(1.0, float(np.linalg.norm(more))),
        search.pair.input_noise(search.fit.input_density),
        bias_of(search.pair, search.fit, float(np.sqrt(search.offset.variance))),
        (*reported, *_warnings(calibration), *coloured.text("radar")),
        misfit=coloured,
        slope=response.slope,
        direction=own.direction,
        moved=_moved(whole, moved, origin, offset),
    )


def _best(targets: Sequence[RadarTarget]) -> Target:
    return next(item.target for item in targets if item.used)


def _without_gain(targets: Sequence[RadarTarget], gain: float) -> tuple[RadarTarget, ...]:
    """The targets with other factors: the acceleration alone, that gave them, is off by as much in all."""
    return tuple(replace(item, target=item.target.without_gain(gain, 0.0)) for item in targets)


def _moved(whole: RadarFrames, series: TargetSeries, origin_ns: int, offset: TimeOffset) -> Displacement:
    """The displacement that a target tells, on the accelerometer's clock."""
    late_ns = origin_ns + round(NANOSECONDS * offset.value_s)
    source = np.full(len(series.value_m), Source.RADAR, dtype=np.uint8)
    return Displacement(whole.time_ns + late_ns, series.value_m, series.variance_m2, source)


@dataclass(frozen=True, slots=True)
class _Along:
    """The acceleration along the axis, its `samples_of`, and what the direction leaves open (relative; s²)."""

    prepared: PreparedAcceleration
    samples: Floats
    direction: Direction | None = None
    relative_std: float = 0.0
    offset_variance: float = 0.0


def _along_axis(window: OpenedWindow, prepared: PreparedAcceleration, info: RadarInfo) -> _Along:
    (origin, max_offset), samples = window.clock, window.samples
    if prepared.cross_m_s2 is None:
        return _Along(prepared, samples)
    found = found_targets(window.frames, samples, info, max_offset)
    best = min(found, key=lambda one: (bool(one.objection), one.noise_m))
    series = series_of(window.frames, best, info, samples)
    axis = turned(radar_pair(prepared, without_holes(window.frames), series, window.clock), max_offset)
    assert axis.direction is not None
    prepared = prepared.along(axis.direction.components)
    first_ns, last_ns = (origin + int(np.rint(NANOSECONDS * time_s)) for time_s in samples[[0, -1], 0])
    samples = samples_of(prepared, origin, (first_ns, last_ns))
    return _Along(prepared, samples, axis.direction, axis.relative_std, axis.offset_variance)


def _at_one_pace(
    found: tuple[Target, ...], frames: RadarFrames, samples: Floats, given: tuple[RadarInfo, float]
) -> tuple[tuple[Target, ...], RadarFrames]:
    """The targets and frames with the radar's stamps at the accelerometer's pace, about the middle of the window."""
    usable = [target for target in found if not target.objection]
    if not usable:
        return found, frames
    best = min(usable, key=lambda target: target.noise_m)
    z = together(at_place(frames.phasors, best.place_bin)[..., None], best, frames.valid)[:, 0] - best.leak
    unit = given[0].axis.phase_per_m(best.range_m)
    reported = best.amplitude, best.noise_variance, best.time_offset_s
    seen = Seen(frames.time_ns, z, *reported, 1.0 / best.conversion_factor, unit)
    skew = clock_skew(seen, samples)
    if skew == 0.0:
        return found, frames
    middle = 0.5 * float(frames.time_ns[0] + frames.time_ns[-1])
    late_ns = np.rint(skew * (frames.time_ns - middle)).astype(np.int64)
    frames = replace(frames, time_ns=frames.time_ns + late_ns)
    return found_targets(frames, samples, given[0], given[1]), frames


def _chosen(found: tuple[Target, ...], most: int, range_m: float | None) -> tuple[tuple[RadarTarget, ...], TimeOffset]:
    best_first = list(ranked(found))
    if range_m is not None:
        best_first = [nearest_peak(found, range_m)]
        if best_first[0].objection:
            raise UntrustedError(
                f"radar.target_range_m = {range_m:g}: the nearest target, at {best_first[0].range_m:.2f} m, cannot be "
                f"used: {best_first[0].objection}. Give another range (`midspan inspect` lists the peaks) or remove "
                "the key."
            )
    agreed, offset = one_clock(best_first)
    used = [target for target, reason in zip(best_first, agreed, strict=True) if not reason][:most]
    rest = [target for target in found if not any(target is one for one in used)]
    reasons = dict(zip(map(id, best_first), agreed, strict=True))
    return (
        *(RadarTarget(target) for target in used),
        *(RadarTarget(t, False, t.objection or reasons.get(id(t)) or "better ones are used") for t in rest),
    ), offset


def nearest_peak(found: tuple[Target, ...], range_m: float) -> Target:
    """The target nearest to a wanted range, usable or not."""
    known = [target for target in found if np.isfinite(target.range_m)]
    if not known:
        raise DataError("radar.target_range_m: this file does not state the ranges of its bins. Remove the key.")
    target = min(known, key=lambda one: abs(one.range_m - range_m))
    if abs(target.range_m - range_m) > MAX_M:
        raise UsageError(
            f"radar.target_range_m = {range_m:g}: must be within {MAX_M:g} m of a target; the nearest is at "
            f"{target.range_m:.2f} m. `midspan inspect` lists the peaks."
        )
    return target


def one_clock(targets: Sequence[Target]) -> tuple[list[str], TimeOffset]:
    """Why a target contradicts the others' clock offset (empty: it does not), and the offset of those that agree."""
    offset = np.array([target.time_offset_s for target in targets])
    std = np.array([target.time_offset_std_s for target in targets])
    weight = 1.0 / np.maximum(std, 1e-6) ** 2
    middle = weighted_median(offset, weight)
    reasons = [
        f"its clock offset would be {1e3 * o:+.1f} ms, that of the others is {1e3 * middle:+.1f} ms"
        if abs(o - middle) > max(OFFSET_STD * s, MIN_OFFSET_S)
        else ""
        for o, s in zip(offset, std, strict=True)
    ]
    kept = np.array([not reason for reason in reasons])
    mean = float(np.average(offset[kept], weights=weight[kept]))
    # The accelerometer's noise moves all targets alike, so that more of them are no more certain than the best.
    scatter = float(np.sqrt(np.average((offset[kept] - mean) ** 2, weights=weight[kept])))
    return reasons, TimeOffset(mean, max(float(std[kept].min()), scatter) ** 2)


def radar_pair(
    prepared: PreparedAcceleration, whole: RadarFrames, series: TargetSeries, given: tuple[int, float]
) -> Pair:
    """The range to a target, and the acceleration; given: stamp of the first frame (ns), largest clock offset (s)."""
    origin, max_offset = given
    span = int(whole.time_ns[0]) + origin, int(whole.time_ns[-1]) + origin
    margin = round((max_offset + 1.0) * NANOSECONDS)
    window = inside(prepared.time_ns, span[0] - margin, span[1] + margin)
    samples = prepared.rows(origin, window)
    variance = np.where(np.isfinite(series.value_m), series.variance_m2, np.inf)
    typical = float(np.median(variance[np.isfinite(variance)]))
    thin = slice(None, None, max(1, -(-len(whole.time_ns) // MAX_ROWS)))
    rows = measured_rows(whole.time_ns[thin], series.range_change_m[thin], variance[thin] / typical, 0)
    return Pair(
        samples,
        rows,
        level_m_s2=prepared.level(window),
        cross=prepared.cross_rows(window),
        lines=prepared.lines,
    )


def _refuse_ambiguity(search: OffsetSearch, max_offset_s: float) -> None:
    other, fit = search.runner_up, search.fit
    if other is None or not is_ambiguous(search):
        return
    raise UntrustedError(
        f"The radar's clock offset is ambiguous: {fit.offset_s:+.4f} s (conversion factor {1 / fit.ratio:.4g}) and "
        f"{other.offset_s:+.4f} s ({1 / other.ratio:.4g}) fit almost equally well within ±{max_offset_s:g} s, as with "
        "nearly a single tone. Set a smaller calibration.max_offset_s that excludes one of them, or calibrate on a "
        "time with changing motion."
    )


def _relative_std(used: Sequence[Target]) -> float:
    """Of the displacement of all targets together; the accelerometer's noise is common to their factors."""
    weights = [1.0 / target.noise_m**2 for target in used]
    return float(np.average([target.relative_std for target in used], weights=weights))


def _variance_factor(search: OffsetSearch, best: Target, series: TargetSeries) -> float:
    """Estimated variance over the stated one, of a frame's displacement; what is stated is never lowered."""
    if best.own_m > best.noise_m:
        return 1.0
    return max(1.0, best.conversion_factor**2 * search.fit.noise / _stated(series))


def _stated(series: TargetSeries) -> float:
    return float(np.median(series.variance_m2[np.isfinite(series.variance_m2)]))


def _contradicted(
    targets: tuple[RadarTarget, ...], search: OffsetSearch, moving: list[Notice], stated: float
) -> tuple[tuple[RadarTarget, ...], list[Notice]]:
    """The targets with what the accelerometer contradicts in their deviations, and sentences on it.

    moving: sentences on targets that move on their own; several are compared with each other, at the same instants;
    stated: variance of a frame's displacement (m²).
    """
    if sum(item.used for item in targets) == 1 and frames_jitter(search.pair, search.fit):
        moving = [JITTER]
    targets, of_factor = _widened(targets, search)
    _refuse_short(targets)
    targets, of_motion = _with_slow_motion(targets, search, stated)
    return targets, [*moving, *of_factor, *of_motion]


def _widened(targets: tuple[RadarTarget, ...], search: OffsetSearch) -> tuple[tuple[RadarTarget, ...], list[Notice]]:
    best, fit = targets[0].target, search.fit
    apart = abs(1.0 / (fit.ratio * best.conversion_factor) - 1.0)
    expected = float(np.hypot(best.relative_std, np.sqrt(fit.ratio_variance) / abs(fit.ratio)))
    if apart <= AGREED_STD * expected:
        return targets, []
    text = (
        f"radar: the conversion factor of the target {best.place} is {best.conversion_factor:.5g} by its "
        f"acceleration and {1 / fit.ratio:.5g} by likelihood; the difference was added to its uncertainty."
    )
    if np.hypot(best.relative_std, apart) > MAX_RELATIVE_STD:
        raise UntrustedError(
            f"radar: the conversion factor of the target {best.place} is {best.conversion_factor:.4g} by "
            f"its acceleration and {1 / fit.ratio:.4g} by likelihood: {100 * apart:.2g} % apart, at most "
            f"{100 * MAX_RELATIVE_STD:g} % are allowed. Something else moves in its bin, or it moves on its own. "
            "Choose another with radar.target_range_m, or calibrate (calibration.window_s) on a time without it."
        )
    wider = list(targets)
    for k, target in enumerate(item.target for item in targets):
        if targets[k].used:
            std = float(np.hypot(target.conversion_factor_std, apart * abs(target.conversion_factor)))
            wider[k] = replace(targets[k], target=replace(target, conversion_factor_std=std))
    return tuple(wider), [Notice("scale-uncertain", text)]


def _with_slow_motion(
    targets: tuple[RadarTarget, ...], search: OffsetSearch, stated: float
) -> tuple[tuple[RadarTarget, ...], list[Notice]]:
    """The only target in use with what it moves by slowly that the accelerometer does not feel, and a sentence."""
    used = [item for item in targets if item.used]
    if len(used) != 1:
        return targets, []
    target, own_hz = used[0].target, SLOW_HZ
    pair, fit = _sparse(search)
    own, felt_alone = find_own_error(pair, fit, stated / target.conversion_factor**2)
    own_m = 0.0 if felt_alone else narrow_motion(search.pair, search.fit) * abs(target.conversion_factor)
    if own is not None:
        own_m, own_hz = own.std * abs(target.conversion_factor), own.hertz or 0.5 / (np.pi * own.time_s)
    if not own_m > max(target.noise_m, target.own_m):
        return targets, []
    text = (
        f"radar: its target shows {1e3 * own_m:.2g} mm rms that the accelerometer does not: hot air, or motion of the "
        "target, the radar's mount or the accelerometer alone. The error band includes it. A second target would show "
        "which."
    )
    moving = replace(used[0], target=replace(target, own_m=own_m, own_hz=own_hz))
    return tuple(moving if item is used[0] else item for item in targets), [Notice("motion-not-shared", text)]


def _sparse(search: OffsetSearch) -> tuple[Pair, Fit]:
    """The pair with as many frames as its slow errors need, and its fit."""
    pair = averaged(search.pair, max(int(search.pair.rate_hz / OWN_RATE_HZ), 1))
    return pair, best_corner(pair, search.fit.offset_s)


def _warnings(calibration: RadarCalibration) -> Iterator[Notice]:
    if calibration.relative_std > WARNED_ABOVE:
        yield Notice(
            "scale-uncertain",
            f"radar: the conversion factor is uncertain by ± {100 * calibration.relative_std:.1f} % (one standard "
            "deviation). Use a calibration window with more motion.",
        )
    std = float(np.sqrt(calibration.offset.variance))
    if std > WARNED_OFFSET_S:
        text = f"radar: the clock offset is uncertain by ± {1e3 * std:.1f} ms (one standard deviation)."
        yield Notice("clock-uncertain", text)
    best = calibration.best
    if best.clutter > MAX_CLUTTER and not best.leak:
        yield Notice(
            "radar-target",
            f"radar: another reflector with {100 * best.clutter:.0f} % of its amplitude shares the bin of the target "
            f"{best.place} and distorts its phase. Aim at an isolated target.",
        )


def _refuse_short(targets: Sequence[RadarTarget]) -> None:
    worst = min((item.target for item in targets if item.used), key=lambda target: abs(target.conversion_factor))
    if abs(worst.conversion_factor) >= 1.0 - max(MIN_SHORT, SHORT_STD * worst.relative_std):
        return
    raise UntrustedError(
        f"radar: the conversion factor of the target {worst.place} must be 1 or more for a fixed target; received "
        f"{worst.conversion_factor:.4g}. All displacements would be wrong by this factor. Check accelerometer.unit (1 "
        "g is 9.81 m/s²) and the accelerometer's sensitivity, carrier and slope in radar.config, and that the path is "
        "not reflected twice."
    )


def diagnostics_of(range_m: Floats, whole: RadarFrames, target: Target) -> RadarDiagnostics:
    """What the report draws of the range profile and of the best target."""
    power = np.zeros(whole.phasors.shape[2])
    for part in np.array_split(np.arange(len(whole.phasors)), max(1, len(whole.phasors) // 256)):
        power += np.sum(np.abs(whole.phasors[part]) ** 2, axis=(0, 1))
    noise = noise_variance(whole.phasors)
    mean = power / (len(whole.phasors) * whole.phasors.shape[1])
    thin = slice(None, None, max(1, len(whole.time_ns) // KEPT))
    z = at_place(whole.phasors[thin], target.place_bin) @ target.weights.conj() / np.sqrt(len(target.weights))
    return RadarDiagnostics(
        range_m=range_m,
        power_db=10.0 * np.log10(np.maximum(mean / max(noise, 1e-300), 1e-6)),
        phasors=np.asarray(z, dtype=np.complex128),
        leak=target.leak,
    )
