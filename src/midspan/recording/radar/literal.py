"""The radar's part of a recording as printed by Ma et al.: target and factor by trial, unwrapping by equations 12–16.

One receiver, the whole bin, the ramp's start frequency as the carrier, nothing taken out and nothing judged. Only the
clocks are brought together as elsewhere: the printed chain has one clock for both sensors.
Ma et al., "Structural displacement estimation using accelerometer and FMCW millimeter wave radar", sections 3.1 and
3.2, doi:10.1016/j.ymssp.2022.109582.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.time_offset import OffsetSearch
from midspan.engine.radar_target import FollowedTarget
from midspan.errors import DataError, UsageError
from midspan.radar.channels import Phasors
from midspan.radar.chirp import SPEED_OF_LIGHT_M_S
from midspan.radar.literal import EDGE_S, GRID, GridFactor, best_on_grid, high_passed
from midspan.radar.measurement import TargetSeries
from midspan.radar.target import Target, ranked
from midspan.radar.unwrap import unwrap_aided
from midspan.recording.radar.calibrate import (
    RadarFit,
    diagnostics_of,
    found_targets,
    nearest_peak,
    one_clock,
    searched,
    searched_bias,
    series_of,
)
from midspan.recording.radar.frames import (
    even_places,
    fetched,
    samples_of,
    without_holes,
)
from midspan.recording.radar.trace import RadarLog
from midspan.recording.radar.window import OpenedWindow, opened_window
from midspan.recording.stored.radar import RadarCalibration, RadarTarget
from midspan.recording.streams.measured import frames_used
from midspan.recording.streams.progress import Progress
from midspan.recording.streams.recording import Recording
from midspan.records import NANOSECONDS, Displacement, Floats, PhaseMeasurement, Source, Status, TimeOffset, seconds
from midspan.sources.radar.radar_source import RadarInfo

# A range that goes on at half a cycle a frame for this long, s, has lost cycles: no structure moves so.
RUN_AWAY_S = 2.0
# The window without its ends must be at least this long, s, and the frames at least this frequent, Hz.
LEAST_INNER_S, LEAST_RATE_HZ = 4.0, 2.0
RAN_AWAY = (
    "radar: the printed unwrapping (fusion.literal) lost cycles and ran away (equations 12 to 15 do not return): the "
    "displacement is wrong from there on. Leave fusion.literal out."
)
ONE_CLOCK = "fusion.literal: no target's phase tells the radar's clock offset; the clocks are taken for one."


def calibrate_radar_literal(recording: Recording, progress: Progress) -> RadarFit:
    """Choose the target of least error E and its conversion factor by trial from 0.5 to 2 in the calibration window.

    Raises DataError where the window is too short for the high-pass of 0.5 Hz or shows no target.
    """
    window, info = opened_window(recording, progress), recording.radar.info
    whole = without_holes(window.frames)
    _check_length(whole.time_ns / NANOSECONDS)
    window = replace(window, frames=whole)
    peaks = found_targets(whole, window.samples, info, window.clock[1])
    section = recording.settings.radar
    if not peaks:
        raise DataError("The radar sees no target: no peak of the range profile stands 10 dB above the noise.")
    if section is not None and section.target_range_m is not None:
        peaks = (nearest_peak(peaks, section.target_range_m),)
    offset, told = _clock(peaks)
    targets, series = _judged(peaks, window, info, offset)
    best = targets[0].target
    unit = printed_phase_per_m(info)
    calibration = RadarCalibration(
        targets=targets,
        offset=offset,
        variance_factor=1.0,
        relative_std=best.conversion_factor_std / best.conversion_factor,
        carrier_hz=info.carrier_hz,
        channels=info.channels,
        literal=True,
        diagnostics=diagnostics_of(info.axis.range_m, info.limit_speed_m_s, whole, (best, series, unit)),
    )
    warnings = (*info.warnings, *window.told, *told, *_warnings(best, series))
    search = _accelerometer_by_clean_target(recording, window, peaks, series)
    return RadarFit(calibration, search.fit.input_density, searched_bias(search), warnings)


@dataclass(frozen=True, slots=True)
class Printed:
    """The displacement as printed, a row a frame on the accelerometer's clock; whether it ran away; the frames' log."""

    measured: Displacement
    ran_away: bool
    log: RadarLog


def printed_displacement(recording: Recording, calibration: RadarCalibration, progress: Progress) -> Printed:
    """Displacement at the chosen target through a recording, by equations 10 and 12 to 16.

    A frame that never arrived takes the predicted phase and is no measurement.
    """
    source, best = recording.radar, calibration.best
    used = frames_used(source.times_ns(), recording.prepared.time_ns, round(recording.max_offset_s * NANOSECONDS))
    bins = np.array([best.place_bin])
    blocks = source.slow_time(bins, used.start, used.stop)
    own = fetched(blocks, [(best, bins)], used.stop - used.start, progress)[0]
    places, origin = even_places(own.time_ns), int(own.time_ns[0])
    z = np.full(int(places[-1]) + 1, np.nan, dtype=np.complex64)
    z[places] = own.phasors[:, 0]
    frame_s = np.interp(np.arange(len(z)), places, seconds(own.time_ns, origin))
    level = _level(samples_of(recording.prepared, origin), frame_s + calibration.offset.value_s)
    unit = printed_phase_per_m(source.info)
    series = _series(z, frame_s, level, (best, unit))
    measured = Displacement(
        time_ns=own.time_ns + round(calibration.offset.value_s * NANOSECONDS),
        value_m=series.value_m[places],
        variance_m2=series.variance_m2[places],
        source=np.full(len(places), Source.RADAR, dtype=np.uint8),
    )
    period_s = 1.0 / source.info.frame_rate_hz
    log = RadarLog([FollowedTarget(best, unit, bins, np.nan, period_s)])
    for k, strength in enumerate(np.abs(np.nan_to_num(own.phasors[:, 0])) / best.amplitude):
        phase = unit * series.range_change_m[places[k]]
        status = Status.TRACKING if np.isfinite(phase) else Status.COASTING
        one = PhaseMeasurement(int(measured.time_ns[k]), float(phase), 0.0, 0.0, status, float(strength))
        log.push([one])
    gone = ran_away(series.range_change_m, period_s=period_s, phase_per_m=unit)
    return Printed(measured, gone, log)


def require_same_way(calibration: RadarCalibration, literal: bool) -> None:
    """UsageError where a calibration as printed would be followed otherwise, or the other way round."""
    if calibration.literal == literal:
        return
    made, asked = (str(value).lower() for value in (calibration.literal, literal))
    raise UsageError(
        f"radar: the calibration was made with fusion.literal = {made}, this estimate has fusion.literal = {asked}; "
        f"both must be the same. Write literal = {asked} under [fusion] of recording.toml and run `midspan calibrate` "
        "again, or leave the calibration out."
    )


def printed_phase_per_m(info: RadarInfo) -> float:
    """Phase in rad that one metre more of range adds, by the ramp's start frequency; the carrier without a ramp."""
    hertz = info.carrier_hz if info.profile is None else info.profile.start_frequency_hz
    return 4.0 * np.pi * hertz / SPEED_OF_LIGHT_M_S


def printed_change(z: Phasors, acceleration_m_s2: Floats, *, period_s: float, phase_per_m: float) -> Floats:
    """Range change (n,) in m since the first two frames on end that were received, NaN before; equations 12 to 16.

    z (n,): phasors of one receiver at one bin, NaN where missing; acceleration_m_s2 (n,): in the line of sight at the
    frames' instants, without its mean; period_s: from frame to frame; phase_per_m: rad per m of range.
    """
    out = np.full(len(z), np.nan)
    known = np.isfinite(z)
    both = np.flatnonzero(known[:-1] & known[1:])
    if not len(both):
        return out
    since = slice(int(both[0]), None)
    phase = np.where(known, np.angle(np.where(known, z, 1.0)), np.nan).astype(np.float64)[since]
    unwrapped = unwrap_aided(phase, acceleration_m_s2[since], period_s=period_s, phase_per_m=phase_per_m)
    out[since] = (unwrapped - unwrapped[0]) / phase_per_m
    return out


def ran_away(change_m: Floats, *, period_s: float, phase_per_m: float) -> bool:
    """Whether a range change (n,) in m went on for seconds as fast as only whole lost cycles a frame can."""
    lag = max(round(RUN_AWAY_S / period_s), 1)
    gone = np.abs(change_m[lag:] - change_m[:-lag])
    return bool(np.nanmax(gone, initial=0.0) > np.pi * lag / phase_per_m)


def _at_the_end(factor: float) -> bool:
    margin = 1.5 * GRID[2]
    return not GRID[0] + margin < factor < GRID[1] - margin


def _check_length(frame_s: Floats) -> None:
    """DataError where the high-pass of 0.5 Hz has too little to settle in."""
    length_s, rate = float(frame_s[-1] - frame_s[0]), 1.0 / float(np.median(np.diff(frame_s)))
    least_s = 2.0 * EDGE_S + LEAST_INNER_S
    if length_s < least_s:
        raise DataError(
            f"fusion.literal: the radar's calibration window must be at least {least_s:g} s long, of which the printed "
            f"high-pass leaves {EDGE_S:g} s out at either end; it is {length_s:.3g} s. Widen calibration.window_s."
        )
    if rate < LEAST_RATE_HZ:
        raise DataError(
            f"fusion.literal: the printed high-pass of 0.5 Hz needs at least {LEAST_RATE_HZ:g} frames a second; the "
            f"radar has {rate:.3g}. Leave fusion.literal out."
        )


def _clock(peaks: Sequence[Target]) -> tuple[TimeOffset, list[str]]:
    """The radar's clock offset by the targets that follow the accelerometer."""
    telling = [peak for peak in peaks if not peak.objection]
    telling = telling or [peak for peak in peaks if np.isfinite(peak.time_offset_std_s)]
    return (one_clock(telling)[1], []) if telling else (TimeOffset(0.0, 0.0), [ONE_CLOCK])


def _accelerometer_by_clean_target(
    recording: Recording, window: OpenedWindow, peaks: Sequence[Target], series: TargetSeries
) -> OffsetSearch:
    """The search that gives noise and bias of the accelerometer: the printed chain does not.

    They are estimated as elsewhere, with the cleanest target where there is a usable one; what bends the printed
    phase would be taken for noise.
    """
    usable = tuple(peak for peak in peaks if not peak.objection)
    if usable:
        series = series_of(window.frames, ranked(usable)[0], recording.radar.info, window.samples)
    return searched(recording, window.frames, series, window.clock)


def _level(samples: Floats, time_s: Floats) -> Floats:
    """Acceleration (n,) at times (n,), without its mean."""
    value = np.interp(time_s, samples[:, 0], samples[:, 1])
    return np.asarray(value - np.mean(value))


def _judged(
    peaks: Sequence[Target], window: OpenedWindow, info: RadarInfo, offset: TimeOffset
) -> tuple[tuple[RadarTarget, ...], TargetSeries]:
    """All peaks with their least error E, the one of least E first and in use; and that one's series."""
    frame_s, rows = window.frames.time_ns / NANOSECONDS, window.frames.phasors[:, 0]
    level = _level(window.samples, frame_s + offset.value_s)
    places = [min(max(round(peak.place_bin), 0), info.bins - 1) for peak in peaks]
    period_s, unit = float(np.median(np.diff(frame_s))), printed_phase_per_m(info)
    # The factor is not known yet: the prediction takes it for 1.
    changes = [printed_change(rows[:, place], level, period_s=period_s, phase_per_m=unit) for place in places]
    k, grids = best_on_grid(np.stack(changes), level, 1.0 / period_s)
    met = []
    for peak, place, change, grid in zip(peaks, places, changes, grids, strict=True):
        amplitude = float(np.median(np.abs(rows[:, place]))) / np.sqrt(info.channels)
        printed = replace(
            peak,
            place_bin=float(place),
            range_m=info.axis.range_at(place),
            amplitude=amplitude,
            weights=np.eye(1, info.channels, dtype=np.complex128)[0],
            conversion_factor=grid.conversion_factor,
            conversion_factor_std=_factor_std(change, grid, period_s),
            noise_m=grid.error_m,
            leak=0j,
            background=None,
            reach_bins=0.0,
        )
        reason = f"its least error E is {1e3 * grid.error_m:.3g} mm, the best one's {1e3 * grids[k].error_m:.3g} mm"
        met.append(RadarTarget(printed, peak is peaks[k], "" if peak is peaks[k] else reason))
    best = met[k].target
    series = _series(rows[:, places[k]], frame_s, level, (best, unit))
    return (met[k], *(item for item in met if not item.used)), series


def _factor_std(change_m: Floats, grid: GridFactor, period_s: float) -> float:
    """What E leaves open of the factor, its values taken for independent once a second; not printed."""
    if _at_the_end(grid.conversion_factor):
        return grid.conversion_factor  # it lies beyond, nobody knows how far
    edge = round(EDGE_S / period_s)
    seen = high_passed(change_m, 1.0 / period_s)[edge : len(change_m) - edge]
    moved = float(np.sqrt(np.mean(seen**2) * max(len(seen) * period_s, 1.0)))
    return float(np.hypot(grid.error_m / max(moved, 1e-9), GRID[2] / np.sqrt(12.0)))


def _series(z: Phasors, frame_s: Floats, level: Floats, given: tuple[Target, float]) -> TargetSeries:
    """The target's displacement at phasors (n,) of an even grid; given: target, rad per m of range.

    Its variance is E², the only error that the chain knows.
    """
    target, unit = given
    period_s = float(np.median(np.diff(frame_s)))
    factor = target.conversion_factor
    change = printed_change(z, level / factor, period_s=period_s, phase_per_m=unit)
    seen = np.isfinite(z) & np.isfinite(change)
    change = np.where(seen, change, np.nan)
    return TargetSeries(factor * change, np.where(seen, target.noise_m**2, np.inf), change)


def _warnings(best: Target, series: TargetSeries) -> list[str]:
    found = [
        "fusion.literal: target, conversion factor and unwrapping of the radar are as printed: one receiver, start "
        f"frequency, factors from {GRID[0]:g} to {GRID[1]:g}. What blocks the target or shares its bin goes unnoticed, "
        "a lost cycle is not found again, and the band rests on the least error E alone."
    ]
    if _at_the_end(best.conversion_factor):
        found.append(
            "fusion.literal: the radar's least error E lies at the end of the grid, factor "
            f"{best.conversion_factor:g}: a factor beyond {GRID[0]:g} to {GRID[1]:g} or a negative one cannot be found "
            "that way, and the displacement is wrong. Leave fusion.literal out, or aim at another target."
        )
    if best.noise_m > best.conversion_factor * float(np.nanstd(series.range_change_m)):
        found.append(
            f"fusion.literal: the radar's least error E, {1e3 * best.noise_m:.3g} mm, is larger than the motion that "
            f"it sees of the target at {best.range_m:.2f} m: that target does not follow the accelerometer, and the "
            "displacement is wrong. Leave fusion.literal out, or name another one with radar.target_range_m."
        )
    return found
