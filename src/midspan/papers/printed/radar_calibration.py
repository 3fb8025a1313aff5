"""The radar's part of a calibration as printed by Ma et al.: target and factor by trial.

One receiver, the whole bin, the ramp's start frequency as the carrier, nothing taken out and nothing judged. Only the
clocks are brought together as elsewhere: the printed chain has one clock for both sensors.
Ma et al., "Structural displacement estimation using accelerometer and FMCW millimeter wave radar", sections 3.1 and
3.2, doi:10.1016/j.ymssp.2022.109582.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from midspan.calibration.radar.calibrate import (
    RadarFit,
    diagnostics_of,
    nearest_peak,
    one_clock,
    radar_pair,
)
from midspan.calibration.radar.window import OpenedWindow, found_targets
from midspan.calibration.sensors.fit import bias_of
from midspan.calibration.sensors.radar import RadarCalibration, RadarTarget
from midspan.calibration.time_offset import search_offset
from midspan.errors import DataError
from midspan.notices import Notice
from midspan.papers.printed.radar_phase import (
    EDGE_S,
    GRID,
    GridFactor,
    acceleration_at,
    best_on_grid,
    high_passed,
    printed_change,
    printed_phase_per_m,
    printed_series,
)
from midspan.radar.chirp import RadarInfo
from midspan.radar.frames import series_of, without_holes
from midspan.radar.measurement import TargetSeries
from midspan.radar.target import Target, ranked
from midspan.records import NANOSECONDS, Floats, TimeOffset
from midspan.signals.acceleration import PreparedAcceleration

# The window without its ends must be at least this long, s, and the frames at least this frequent, Hz.
MIN_INNER_S, MIN_RATE_HZ = 4.0, 2.0
ONE_CLOCK = Notice(
    "clock-uncertain", "fusion.literal: no target's phase tells the radar's clock offset; the clocks are taken for one."
)


def fit_radar_literal(
    window: OpenedWindow, prepared: PreparedAcceleration, info: RadarInfo, *, target_range_m: float | None = None
) -> RadarFit:
    """Choose the target of least error E and its conversion factor by trial from 0.5 to 2 in the calibration window.

    target_range_m: where the only target is wanted. Raises DataError where the window is too short for the high-pass of
    0.5 Hz or shows no target.
    """
    whole = without_holes(window.frames)
    _check_length(whole.time_ns / NANOSECONDS)
    window = replace(window, frames=whole)
    peaks = found_targets(whole, window.samples, info, window.clock[1])
    if not peaks:
        raise DataError("The radar sees no target: no peak of the range profile stands 10 dB above the noise.")
    if target_range_m is not None:
        peaks = (nearest_peak(peaks, target_range_m),)
    telling = [peak for peak in peaks if not peak.objection]
    telling = telling or [peak for peak in peaks if np.isfinite(peak.time_offset_std_s)]
    offset, reported = (one_clock(telling)[1], []) if telling else (TimeOffset(0.0, 0.0), [ONE_CLOCK])
    targets, series = _judged(peaks, window, info, offset)
    best = targets[0].target
    calibration = RadarCalibration(
        targets=targets,
        offset=offset,
        variance_factor=1.0,
        relative_std=best.conversion_factor_std / best.conversion_factor,
        carrier_hz=info.carrier_hz,
        channels=info.channels,
        literal=True,
        diagnostics=diagnostics_of(info.axis.range_m, whole, best),
    )
    warnings = (*info.warnings, *window.reported, *reported, *_warnings(best, series))
    # Noise and bias of the accelerometer, which the printed chain does not give, as elsewhere: with the cleanest target
    # where there is a usable one. What bends the printed phase would be taken for noise.
    usable = tuple(peak for peak in peaks if not peak.objection)
    if usable:
        series = series_of(window.frames, ranked(usable)[0], info, window.samples)
    search = search_offset(radar_pair(prepared, window.frames, series, window.clock), window.clock[1])
    bias = bias_of(search.pair, search.fit, float(np.sqrt(search.offset.variance)))
    return RadarFit(calibration, search.pair.input_noise(search.fit.input_density), bias, warnings)


def _at_the_end(factor: float) -> bool:
    margin = 1.5 * GRID[2]
    return not GRID[0] + margin < factor < GRID[1] - margin


def _check_length(frame_s: Floats) -> None:
    length_s, rate = float(frame_s[-1] - frame_s[0]), 1.0 / float(np.median(np.diff(frame_s)))
    least_s = 2.0 * EDGE_S + MIN_INNER_S
    if length_s < least_s:
        raise DataError(
            f"fusion.literal: the radar's calibration window must be at least {least_s:g} s long, of which the printed "
            f"high-pass leaves {EDGE_S:g} s out at either end; it is {length_s:.3g} s. Widen calibration.window_s."
        )
    if rate < MIN_RATE_HZ:
        raise DataError(
            f"fusion.literal: the printed high-pass of 0.5 Hz needs at least {MIN_RATE_HZ:g} frames a second; the "
            f"radar has {rate:.3g}. Leave fusion.literal out."
        )


def _judged(
    peaks: Sequence[Target], window: OpenedWindow, info: RadarInfo, offset: TimeOffset
) -> tuple[tuple[RadarTarget, ...], TargetSeries]:
    """All peaks with their least error E, the one of least E first and in use; and that one's series."""
    frame_s, rows = window.frames.time_ns / NANOSECONDS, window.frames.phasors[:, 0]
    level = acceleration_at(window.samples, frame_s + offset.value_s)
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
    series = printed_series(rows[:, places[k]], frame_s, level, (best, unit))
    return (met[k], *(item for item in met if not item.used)), series


def _factor_std(change_m: Floats, grid: GridFactor, period_s: float) -> float:
    """What E leaves open of the factor, its values taken for independent once a second; not printed."""
    if _at_the_end(grid.conversion_factor):
        return grid.conversion_factor  # it lies beyond, nobody knows how far
    edge = round(EDGE_S / period_s)
    seen = high_passed(change_m, 1.0 / period_s)[edge : len(change_m) - edge]
    moved = float(np.sqrt(np.mean(seen**2) * max(len(seen) * period_s, 1.0)))
    return float(np.hypot(grid.error_m / max(moved, 1e-9), GRID[2] / np.sqrt(12.0)))


def _warnings(best: Target, series: TargetSeries) -> Iterator[Notice]:
    yield Notice(
        "literal",
        "fusion.literal: target, conversion factor and unwrapping of the radar are as printed: one receiver, start "
        f"frequency, factors from {GRID[0]:g} to {GRID[1]:g}. What blocks the target or shares its bin goes "
        "unnoticed, a lost cycle is not found again, and the band rests on the least error E alone.",
    )
    if _at_the_end(best.conversion_factor):
        yield Notice(
            "literal",
            "fusion.literal: the radar's least error E lies at the end of the grid, factor "
            f"{best.conversion_factor:g}: a factor beyond {GRID[0]:g} to {GRID[1]:g} or a negative one cannot be "
            "found that way, and the displacement is wrong. Leave fusion.literal out, or aim at another target.",
        )
    if best.noise_m > best.conversion_factor * float(np.nanstd(series.range_change_m)):
        yield Notice(
            "literal",
            f"fusion.literal: the radar's least error E, {1e3 * best.noise_m:.3g} mm, is larger than the motion "
            f"that it sees of the target at {best.range_m:.2f} m: that target does not follow the accelerometer, and "
            "the displacement is wrong. Leave fusion.literal out, or name another one with radar.target_range_m.",
        )
