"""The kinds of sensors that are no cameras, one row each: how they are calibrated, checked, staged and drawn.

Each works on the view of one sensor of the recording. Cameras have targets, tracked ahead of the engine, and rooms of
their own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.calibration.displacement.learn import Given
from midspan.calibration.displacement.sensor import DisplacementFit, fit_displacement, read_with
from midspan.calibration.lines import Shown, require_no_lines
from midspan.calibration.noise import USUAL_GAIN_STD
from midspan.calibration.radar.calibrate import RadarFit, fit_radar
from midspan.calibration.radar.window import MIN_FRAMES, OpenedWindow, opened, shown_by_strongest
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.calibration.sensors.fit import SensorFit
from midspan.calibration.sensors.radar import RadarCalibration
from midspan.engine.channels import Table, interval_s, plain_channel, radar_channels, require_same_radar
from midspan.engine.sensor_series import SensorSeries, channel_series
from midspan.engine.sensors import PlainSensor, RadarSensor
from midspan.errors import DataError, UsageError
from midspan.fusion.methods import named
from midspan.notices import Notice
from midspan.progress import Progress
from midspan.radar.frames import collected
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import require_overlap, window_ends, within_window
from midspan.records import NANOSECONDS, Channel, Estimate, Measured, Source, seconds
from midspan.settings.messages import in_words_of
from midspan.settings.stored.calibration import Calibration
from midspan.signals.stamps import inside
from midspan.signals.stuck import at_limits
from midspan.sources.accelerometer.units import si_factor

# Complex values of range profiles that are kept of the window at most: 128 MB.
MAX_VALUES = 1 << 24
# A larger share of frames with holes is reported.
WARNED_LOST = 0.02
# What stands in `papers`, above this room.
PRINTED_FIT = "midspan.papers.printed.radar_calibration:fit_radar_literal"
PRINTED_RADAR = "midspan.papers.printed.radar:radar_channels"

Log = tuple[Measured, Sequence[Channel], Estimate]
"""All that a sensor measured, the estimator's channels, the rows along the main axis."""


def opened_window(recording: Recording, progress: Progress) -> OpenedWindow:
    """The range profiles of a radar's calibration window, no more of them than memory allows, and the acceleration with
    a margin for the clock offset.
    """
    source, prepared = recording.radar, recording.prepared
    times, reported = source.times_ns(), list[Notice]()
    if not len(times):
        raise DataError(f"radar.file = {recording.own.settings.file!r}: holds no frames.")
    require_overlap(prepared.time_ns, times, "radar")
    ends = window_ends(recording)
    # At the largest clock offset the frames must still lie inside the accelerometer's samples.
    margin = round(recording.max_offset_s * NANOSECONDS)
    first = max(ends[0], int(prepared.time_ns[0]) + margin)
    used = inside(times, first, min(ends[1], int(prepared.time_ns[-1]) - margin))
    if used.stop - used.start < MIN_FRAMES:
        raise DataError(
            f"radar: {max(used.stop - used.start, 0)} frames lie in the calibration window (those within "
            f"calibration.max_offset_s of the accelerometer's ends are left out); at least {MIN_FRAMES} are needed. "
            "Widen calibration.window_s or correct the clock offset with radar.start_s."
        )
    most = MAX_VALUES // max(source.info.channels * source.info.bins, 1)
    if used.stop - used.start > most:
        used = slice(used.start, used.start + max(most, MIN_FRAMES))
        length_s = (int(times[used.stop - 1]) - int(times[used.start])) / NANOSECONDS
        text = f"radar: only the first {length_s:.3g} s of the calibration window are used, to save memory."
        reported.append(Notice("window-moved", text))
    blocks = source.profiles(used.start, used.stop)
    frames = collected(blocks, used.stop - used.start, progress, "reading the radar's calibration window")
    holes = float(np.mean(~frames.valid.all(axis=1)))
    if holes > WARNED_LOST:
        text = f"radar: {100 * holes:.2g} % of the frames in the calibration window have lost packets."
        reported.append(Notice("radar-data", text))
    return opened(frames, prepared, ends, recording.max_offset_s, reported)


def calibrate_radar(view: Recording, progress: Progress) -> RadarFit:
    """Fixed targets, their conversion factors and the clock offset in the calibration window, as printed where asked.

    Raises UntrustedError, with the reason, where no target follows the accelerometer well enough, DataError where the
    window holds too few frames.
    """
    window = opened_window(view, progress)
    section, info = view.settings.radar, view.radar.info
    assert section is not None
    wanted_m = section.target_range_m
    if view.settings.fusion.literal:
        printed: RadarFit = named(PRINTED_FIT)(window, view.prepared, info, target_range_m=wanted_m)
        return printed
    if not view.lines:
        require_no_lines(window.samples, shown_by_strongest(window, info, wanted_m), view.sensor)
    fit = fit_radar(window, view.prepared, info, most_targets=section.targets, target_range_m=wanted_m)
    return replace(fit, warnings=(*view.radar_notices, *fit.warnings))


def _known(view: Recording, calibration: Calibration) -> Any:
    """The part of a calibration for a view's sensor; UsageError where it has none."""
    if (found := calibration.of_sensor(view.own, view.companions)) is None:
        raise UsageError(
            f"The calibration has no {view.sensor} part, but the recording has [{view.sensor}]. Calibrate again."
        )
    return found


def radar_part(view: Recording, calibration: Calibration) -> RadarCalibration:
    """The radar's part of a calibration; UsageError where it has none or belongs to other settings of the radar."""
    known: RadarCalibration = _known(view, calibration)
    with in_words_of(view.sensor):
        require_overlap(view.prepared.time_ns, view.radar.times_ns(), "radar")
        require_same_radar(view.radar.info, known)
    return known


def calibrate_displacement(view: Recording, progress: Progress) -> DisplacementFit:
    """Noise, clock offset and scale of the sensor, estimated relative to the accelerometer, or a refusal."""
    section, series, own = view.settings.displacement, view.displacement, view.accelerometer
    assert section is not None
    require_overlap(view.prepared.time_ns, series.time_ns, "displacement")
    series = within_window(view, series)
    if not view.lines and not view.settings.fusion.literal:
        origin_ns = int(view.prepared.time_ns[0])
        shown = Shown(seconds(series.time_ns, origin_ns), series.value)
        require_no_lines(view.prepared.rows(origin_ns, slice(None)), shown, view.sensor)
    given = section.noise_std
    return fit_displacement(
        Given(
            view.prepared,
            series,
            wanted_s=view.settings.calibration.max_offset_s,
            learns_offset=section.estimate_offset,
            learns_scale=section.estimate_scale,
            noise_std_m=None if given is None else given * si_factor(section.unit or series.unit, "displacement", None),
            gives_zero=view.gives_zero,
            gain_std=(own.scale_std or USUAL_GAIN_STD) if own.estimate_scale else 0.0,
            noise_time_s=section.noise_time_s,
            gnss=section.receiver == "gnss",
            exposure_s=section.exposure_s,
        )
    )


def displacement_part(view: Recording, calibration: Calibration) -> DisplacementCalibration:
    """The sensor's part of a calibration; UsageError where it has none, or none of the scale that is wanted."""
    known: DisplacementCalibration = _known(view, calibration)
    section = view.settings.displacement
    if section is not None and section.estimate_scale and known.scale == 1.0:
        raise UsageError(
            "displacement.estimate_scale = true: the calibration was made without it and has no displacement.scale. "
            "Calibrate again."
        )
    require_overlap(view.prepared.time_ns, view.displacement.time_ns, view.sensor)
    return known


def displacement_series(view: Recording, known: DisplacementCalibration, log: Log) -> SensorSeries:
    """The whole channel as it was read, in metres on the accelerometer's clock."""
    found = read_with(view.displacement, known)
    value = np.where(at_limits(found.value, known.low_m, known.high_m), np.nan, found.value)
    std = np.where(np.isfinite(value), known.noise_std_m, np.nan)
    return SensorSeries(view.sensor, Source.DISPLACEMENT, found.time_ns, value, std)


def radar_stage(table: Table, view: Recording, known: RadarCalibration, **more: Any) -> RadarSensor:
    """The radar's part of the engine; with fusion.literal as printed."""
    made = named(PRINTED_RADAR) if view.settings.fusion.literal else radar_channels
    step_s = interval_s(view.radar.times_ns())
    sensor: RadarSensor = made(table, known, view.radar.info, sensor=view.sensor, step_s=step_s, **more)
    return sensor


@dataclass(frozen=True, slots=True)
class Kind:
    """calibrate: what is estimated of the sensor; known: its part of a calibration, or a refusal; stage: its part of
    the engine, and its channels in the table; series: what it measured over the record; printed: with fusion.literal
    calibration and stage are others.
    """

    calibrate: Callable[[Recording, Progress], SensorFit[Any, Any]]
    known: Callable[[Recording, Calibration], Any]
    stage: Callable[..., PlainSensor | RadarSensor]
    series: Callable[..., SensorSeries]
    printed: bool = False


ROWS = {
    "radar": Kind(
        calibrate_radar,
        radar_part,
        radar_stage,
        # What its targets measured together.
        lambda view, known, log: channel_series(log[0], log[1], view.sensor, log[2]),
        printed=True,
    ),
    "displacement": Kind(
        calibrate_displacement,
        displacement_part,
        lambda table, view, known, *, first, **_: plain_channel(
            table, known, view.displacement, view.sensor, first=first
        ),
        displacement_series,
    ),
}


def has_printed(recording: Recording) -> bool:
    """Whether a recording has a sensor whose calibration and stage are others with fusion.literal."""
    return any(row.printed and recording.has(kind) for kind, row in ROWS.items())
