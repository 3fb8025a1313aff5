"""The radar's measurements for the fusion, with what is uncertain of their level and what happened on the way."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError, UsageError
from midspan.fusion.path import at
from midspan.fusion.streams import KalmanSettings, smooth
from midspan.radar.target import Target
from midspan.recording.fusing.fuse import CourseError, LevelError, SensorError
from midspan.recording.fusing.one_clock import one_clock
from midspan.recording.radar.literal import literal_track
from midspan.recording.radar.own_motion import told
from midspan.recording.radar.trace import RadarTrace
from midspan.recording.radar.track import RadarTrack, track_targets
from midspan.recording.stored.calibration import Calibration
from midspan.recording.streams.measured import frames_used
from midspan.recording.streams.progress import Progress
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.span import inside, require_overlap, shown
from midspan.records import NANOSECONDS, Acceleration, Displacement, Event, Nanoseconds, Source, Status, part
from midspan.signals.health import runs

# Each side of an outage is smoothed over so much, s, to tell what the structure did meanwhile.
BRIDGED_S = 30.0
# Shorter outages than this, s, are no events: the filter rides through them.
LEAST_OUTAGE_S = 0.1
# A target whose phase the accelerometer does not explain, or that is seen less than this, is worth telling.
LEAST_SEEN = 0.9
CONTRADICTION = "radar: the targets contradict each other; the error band was widened by their distance"
LEFT_OUT = "moved by itself or lost its cycle (it contradicts the accelerometer or the other targets): left out"


@dataclass(frozen=True, slots=True)
class RadarInputs:
    """Measurements on the accelerometer's clock, from the first frame that was used on, and what is to be told.

    levels: instants from which on the zero is known to a standard deviation only, and what else in the targets' bins
    does to the displacement; trace: for the report.
    """

    measured: Displacement
    error: SensorError
    levels: tuple[LevelError | CourseError, ...]
    events: tuple[Event, ...]
    warnings: tuple[str, ...]
    trace: RadarTrace | None


def radar_inputs(
    recording: Recording,
    calibration: Calibration,
    acceleration: Acceleration,
    kalman: KalmanSettings,
    progress: Progress,
) -> RadarInputs:
    """Follow the calibrated targets through the recording.

    Raises UsageError where the calibration has no radar part or belongs to another one, DataError where no frame shows
    a target.
    """
    source, known = recording.radar, calibration.radar
    if known is None:
        raise UsageError("The calibration has no radar part, but the recording has [radar]. Calibrate again.")
    times, accelerations = source.times_ns(), recording.prepared.time_ns
    require_overlap(accelerations, times, "radar")
    margin = round(recording.max_offset_s * NANOSECONDS)
    follow = literal_track if known.literal else track_targets
    track = follow(source, known, recording.prepared, frames_used(times, accelerations, margin), progress)
    seen = np.flatnonzero(np.isfinite(track.measured.value_m))
    if not len(seen):
        raise DataError(
            "radar: none of the calibrated targets is seen in any frame. Calibrate again, or check radar.file and that "
            "nothing stands in front of the radar."
        )
    measured, levels = _levelled(track, acceleration, kalman)
    clock = track.clock
    # Its drift was found in the phase; a jump shows best in the displacement.
    jumped = one_clock(measured, acceleration, kalman, "radar", drifts=False)
    measured = jumped.measured
    std_s = float(np.sqrt(known.offset.variance)) if clock is None or clock.std_s is None else clock.std_s
    std_s = float(np.hypot(std_s, jumped.std_s or 0.0))
    events = (*_events(track, known.used, levels), *jumped.events)
    warned = [
        *(() if clock is None else clock.warnings),
        *jumped.warnings,
        *_warnings(track, source.info.warnings, calibration),
    ]
    stamps = measured.time_ns
    lasting = (*track.bent_m, *track.courses_m, *(() if track.apart_m is None else (track.apart_m,)))
    bends = tuple(CourseError(Source.RADAR, stamps, error_m) for error_m in lasting if error_m.any())
    return RadarInputs(
        measured=part(measured, slice(int(seen[0]), None)),
        error=SensorError(Source.RADAR, known.relative_std, std_s),
        levels=(*levels, *bends, *jumped.levels),
        events=events,
        warnings=tuple(warned),
        trace=track.trace,
    )


def _levelled(
    track: RadarTrack, acceleration: Acceleration, kalman: KalmanSettings
) -> tuple[Displacement, tuple[LevelError, ...]]:
    """The measurements with each new datum brought to the level before the outage by the acceleration, and how well.

    Both sides are smoothed on their own and compared in the middle of the outage, where either has the shortest way.
    """
    measured, levels = track.measured, []
    edges = [0, *track.datums, len(measured.time_ns)]
    value = measured.value_m.copy()
    for begin, row, end in zip(edges[:-2], edges[1:-1], edges[2:], strict=True):
        before = np.flatnonzero(np.isfinite(value[begin:row])) + begin
        if not len(before):
            continue
        now = replace(measured, value_m=value)
        apart_m, std_m = _apart(now, (int(before[-1]), row), (begin, end), acceleration, kalman)
        value[row:] -= apart_m
        levels.append(LevelError(Source.RADAR, int(measured.time_ns[row]), std_m))
    return replace(measured, value_m=value), tuple(levels)


def _apart(
    measured: Displacement,
    outage: tuple[int, int],
    segment: tuple[int, int],
    acceleration: Acceleration,
    kalman: KalmanSettings,
) -> tuple[float, float]:
    """How much higher the rows after an outage (last row before, first after) lie, in m, and its standard deviation."""
    last, first = (int(measured.time_ns[k]) for k in outage)
    reach, middle = round(BRIDGED_S * NANOSECONDS), np.array([(last + first) // 2])
    found = []
    for rows, span in (
        (slice(segment[0], outage[0] + 1), (last - reach, first)),
        (slice(outage[1], segment[1]), (last, first + reach)),
    ):
        block = part(measured, rows)
        near = part(block, inside(block.time_ns, *span))
        # The samples around the outage as well: its middle may lie between two of them.
        moved = part(acceleration, inside(acceleration.time_ns, span[0] - NANOSECONDS, span[1] + NANOSECONDS))
        found.append(at(smooth(moved, near, kalman).estimate, middle))
    (before, variance_before), (after, variance_after) = found
    return float(after[0] - before[0]), float(np.sqrt(variance_before[0] + variance_after[0]))


def _events(track: RadarTrack, targets: tuple[Target, ...], levels: tuple[LevelError, ...]) -> tuple[Event, ...]:
    """Outages, cycles that were checked or lost, and new zeros, in the order of time."""
    time_ns, places = track.measured.time_ns, track.places
    found = [
        Event(
            level.from_ns,
            "new datum",
            f"radar: the cycle was lost in the outage before {shown(level.from_ns)}; from there on the level is known "
            f"to ± {1e3 * level.std_m:.3g} mm (one standard deviation).",
        )
        for level in levels
    ]
    found += _outages(time_ns, track.lost, "lost frames", "radar: no whole frame arrived")
    if track.apart_m is not None:
        found += _outages(time_ns, track.apart_m > 0.0, "contradiction", CONTRADICTION)
    left_out = np.zeros((len(targets), len(time_ns)), dtype=np.bool_) if track.left_out is None else track.left_out
    for target, series, left in zip(targets, track.targets, left_out, strict=True):
        hidden = (series.status[places] != Status.TRACKING) & ~track.lost
        name = "radar: the target" if len(targets) == 1 else f"radar: the target at {target.range_m:.2f} m"
        found += _outages(time_ns, hidden, "blocked", f"{name} was not seen")
        found += _outages(time_ns, left, "left out", f"{name} {LEFT_OUT}")
        for verdict in series.verdicts:
            at = int(time_ns[min(int(np.searchsorted(places, verdict.frame)), len(time_ns) - 1)])
            if verdict.verdict != "new datum":
                told = "was right" if verdict.cycles == 0 else f"was corrected by {verdict.cycles:+d}"
                text = f"{name}: by its range the cycle after the outage before {shown(at)} {told}."
                found.append(Event(at, "cycle", text))
    return tuple(sorted(found, key=lambda event: event.time_ns))


def _outages(time_ns: Nanoseconds, mask: NDArray[np.bool_], kind: str, text: str) -> list[Event]:
    """An event for each longer run of the mask (n,)."""
    found = []
    for start, end in runs(mask):
        begin = int(time_ns[start])
        length_s = (int(time_ns[min(end, len(time_ns) - 1)]) - begin) / NANOSECONDS
        if length_s >= LEAST_OUTAGE_S:
            found.append(Event(begin, kind, f"{text} for {length_s:.2f} s from {shown(begin)} on."))
    return found


def _warnings(track: RadarTrack, of_source: tuple[str, ...], calibration: Calibration) -> list[str]:
    """What the source noticed, frames that never arrived, and targets that were seldom seen."""
    found = [line for line in of_source if line not in calibration.warnings]
    if track.lost.any():
        found.append(f"radar: {np.count_nonzero(track.lost)} frames ({100 * np.mean(track.lost):.2g} %) never arrived.")
    assert calibration.radar is not None
    if track.own is not None:
        found += told(track.own, calibration.radar.used)
    for target, series in zip(calibration.radar.used, track.targets, strict=True):
        found += [] if series.explained else [f"radar: {line}" for line in series.warnings[:1]]
        seen = float(np.mean(series.status[track.places] == Status.TRACKING))
        if seen < LEAST_SEEN:
            found.append(
                f"radar: the target at {target.range_m:.2f} m was seen in {100 * seen:.3g} % of the frames only."
            )
    return found
