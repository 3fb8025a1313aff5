"""The displacement that the calibrated targets of a radar show, followed through the record."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from midspan.radar.channels import Phasors
from midspan.radar.departures import departures
from midspan.radar.following import LEAST_EXCURSION_BINS, at_places
from midspan.radar.measurement import TargetFrames, TargetSeries, displacement
from midspan.radar.own_motion import OwnMotions, Shown, own_motions
from midspan.radar.range_profile import coarse_range, half_kernel
from midspan.radar.several import record_combined
from midspan.radar.target import Target
from midspan.recording.radar.clock import RadarClock, Seen, radar_clock
from midspan.recording.radar.frames import (
    TargetPhasors,
    bin_m_of,
    bins_of,
    check_same_radar,
    even_places,
    fetched,
    samples_of,
)
from midspan.recording.radar.gaps import gaps_filled
from midspan.recording.radar.own_motion import comparable, without_acceleration
from midspan.recording.radar.trace import Followed, RadarTrace, SeenFrames, radar_trace
from midspan.recording.stored.radar import RadarCalibration
from midspan.recording.streams.acceleration import PreparedAcceleration
from midspan.recording.streams.progress import Progress
from midspan.records import NANOSECONDS, Displacement, Floats, Nanoseconds, Source, seconds
from midspan.sources.radar.dca1000 import RawCapture
from midspan.sources.radar.radar_source import RadarSource


@dataclass(frozen=True, slots=True)
class RadarTrack:
    """What the targets show, one row a frame.

    measured: displacement on the accelerometer's clock, NaN where no target was seen; targets: the series of each used
    target, on an even grid of frames; places (n,): the rows' frames in it; lost (n,): frames of which nothing arrived;
    datums: rows from which on the displacement counts from a new zero; bent_m (2, n): error for one standard deviation
    of either part, in phase and across, of what else lies in the targets' bins; trace: what the report draws; clock:
    how the radar's ran; own: how the targets move by themselves; courses_m: the error of one standard deviation each
    that they make by it.
    """

    measured: Displacement
    targets: tuple[TargetSeries, ...]
    places: NDArray[np.int64]
    lost: NDArray[np.bool_]
    datums: tuple[int, ...]
    bent_m: Floats
    left_out: NDArray[np.bool_] | None = None
    apart_m: Floats | None = None
    trace: RadarTrace | None = field(default=None, repr=False)
    clock: RadarClock | None = field(default=None, repr=False)
    own: OwnMotions | None = field(default=None, repr=False)
    courses_m: tuple[Floats, ...] = field(default=(), repr=False)


def target_series(
    own: TargetPhasors, target: Target, given: tuple[float, float, Floats], coarse_m: Floats | None = None
) -> TargetSeries:
    """The displacement at one target, on the even grid of `even_places`.

    given: rad per m of range, from bin to bin in m, and `samples_of` with the stamps' own origin; coarse_m (n,): range
    from the beat frequency, where it is known.
    """
    phase_per_m, bin_m, samples = given
    places = even_places(own.time_ns)
    count = int(places[-1]) + 1
    several = len(own.bins) > 1
    phasors = np.full((count, 1, len(own.bins)), np.nan, dtype=np.complex64)
    phasors[places, 0] = own.phasors
    frames = TargetFrames(
        frame_s=np.interp(np.arange(count), places, seconds(own.time_ns, 0)),
        phasors=phasors if several else phasors[..., 0],
        valid=np.asarray(np.isfinite(phasors).all(axis=2)),
        coarse_m=None if coarse_m is None else _spread(coarse_m, places),
        bins=own.bins if several else None,
        bin_m=bin_m,
    )
    # The receivers are together already.
    alone = replace(target, weights=np.ones(1, dtype=np.complex128))
    return displacement(frames, alone, samples=samples, phase_per_m=phase_per_m)


def _spread(values: Floats, places: NDArray[np.int64]) -> Floats:
    out = np.full(int(places[-1]) + 1, np.nan)
    out[places] = values
    return out


def track_targets(
    source: RadarSource,
    calibration: RadarCalibration,
    prepared: PreparedAcceleration,
    used: slice,
    progress: Progress,
) -> RadarTrack:
    """Follow the calibrated targets through the frames `used` of a source; the file is streamed.

    Raises UsageError where the calibration belongs to other settings of the radar.
    """
    check_same_radar(source, calibration)
    targets = tuple(replace(t, time_offset_s=calibration.offset.value_s) for t in calibration.used)
    wanted = [(target, bins_of(target, source.info)) for target in targets]
    own = read_targets(source, wanted, used, progress)
    origin = int(own[0].time_ns[0])
    samples = samples_of(prepared, origin)
    seen = _seen(source, own[0], targets[0], origin)
    samples = gaps_filled(samples, prepared.unmeasured_ns - origin, seen)
    clock = radar_clock(seen, samples)
    clock = replace(clock, time_ns=clock.time_ns + origin)
    own = [replace(one, time_ns=clock.time_ns) for one in own]
    series = [_series(source, one, target, (origin, samples)) for one, target in zip(own, targets, strict=True)]
    wide = [k for k, one in enumerate(series) if _moves_further(one, own[k], source)]
    if wide:
        # Some moved further than in the calibration: once more, with all bins that they went through.
        again = [(targets[k], bins_of(targets[k], source.info, series[k].excursion_m)) for k in wide]
        for k, read in zip(wide, read_targets(source, again, used, progress), strict=True):
            found = replace(read, time_ns=clock.time_ns)
            own[k], series[k] = found, _series(source, found, targets[k], (origin, samples))
    for k, target in enumerate(targets):
        if series[k].restarts and isinstance(source, RawCapture):
            # The range itself may tell the cycle after an outage; it is only computed where there was one.
            coarse = _coarse(source, target, used)
            series[k] = _series(source, own[k], target, (origin, samples), coarse)
    lost = np.asarray(~np.isfinite(own[0].phasors).all(axis=1))
    given = (lost, source.info.axis.phase_per_m(targets[0].range_m), origin, samples)
    track = _together(own[0].time_ns, series, (calibration, prepared), given)
    return replace(track, trace=_trace(source, targets, track, own), clock=clock)


def read_targets(
    source: RadarSource, wanted: list[tuple[Target, Floats]], used: slice, progress: Progress
) -> list[TargetPhasors]:
    """The phasors of several targets, each at its bins, through the frames `used` in one pass."""
    bins = np.concatenate([bins for _, bins in wanted])
    return fetched(source.slow_time(bins, used.start, used.stop), wanted, used.stop - used.start, progress)


def _seen(source: RadarSource, own: TargetPhasors, target: Target, origin: int) -> Seen:
    """The best target as its clock is judged by; its stamps count from the origin, ns."""
    return Seen(
        time_ns=own.time_ns - origin,
        phasors=_at_target(own, target, np.zeros(len(own.time_ns))),
        amplitude=target.amplitude,
        offset_s=target.time_offset_s,
        ratio=1.0 / target.conversion_factor,
        phase_per_m=source.info.axis.phase_per_m(target.range_m),
    )


def _series(
    source: RadarSource,
    own: TargetPhasors,
    target: Target,
    given: tuple[int, Floats],
    coarse_m: Floats | None = None,
) -> TargetSeries:
    """One target's series; given: what its stamps count from (ns), and the samples."""
    origin, samples = given
    moved = replace(own, time_ns=own.time_ns - origin)
    unit = source.info.axis.phase_per_m(target.range_m)
    return target_series(moved, target, (unit, bin_m_of(source.info), samples), coarse_m)


def _moves_further(series: TargetSeries, own: TargetPhasors, source: RadarSource) -> bool:
    """Whether a target left the bins that were fetched of it."""
    covered = LEAST_EXCURSION_BINS if len(own.bins) == 1 else 0.5 * (own.bins[-1] - own.bins[0]) - 1.0
    return bool(series.excursion_m > covered * bin_m_of(source.info))


def _coarse(source: RawCapture, target: Target, used: slice) -> Floats:
    """Range in m (n,) from the beat frequency at a target, its receivers together."""
    profile = source.layout.profile
    kernel = half_kernel(target.place_bin, profile)
    weights = np.abs(target.weights) ** 2
    found = []
    for block in source.products(kernel, used.start, used.stop):
        turn = block.phasors[..., 1] * np.conj(block.phasors[..., 0])
        both = np.sum(np.where(block.valid, turn * weights, 0.0), axis=1)
        halves = np.stack((np.ones_like(both), both), axis=-1)
        seen = coarse_range(halves, target.place_bin, profile)
        found.append(np.where(block.valid.any(axis=1), seen, np.nan))
    return np.concatenate(found)


def _together(
    time_ns: Nanoseconds,
    series: list[TargetSeries],
    known: tuple[RadarCalibration, PreparedAcceleration],
    given: tuple[NDArray[np.bool_], float, int, Floats],
) -> RadarTrack:
    """One displacement out of all targets'; time_ns (n,): on the radar's clock; known: calibration, accelerometer.

    given: frames (n,) of which nothing arrived, rad per m of range at the best target, and `samples_of` with what
    their time counts from.
    """
    (lost, phase_per_m, origin, samples), (calibration, prepared) = given, known
    places = even_places(time_ns)
    rate = NANOSECONDS / float(np.median(np.diff(time_ns)))
    frame_s = np.interp(np.arange(int(places[-1]) + 1), places, seconds(time_ns, origin)) + calibration.offset.value_s
    value = np.stack([one.value_m for one in series])
    variance = np.stack([one.variance_m2 for one in series]) * calibration.variance_factor
    guessed = np.stack([one.new_datum for one in series])
    relative = np.array([target.relative_std for target in calibration.used])
    blind = without_acceleration(prepared, origin, frame_s)
    seen = comparable(value, frame_s, blind)
    moved = departures(frame_s, seen, variance, samples=samples, relative_std=relative)
    own = _own(series, (frame_s, value, variance, relative), (guessed, moved, blind), samples)
    kept = ~own.left_out
    targets, (total, spread, begins) = record_combined(
        value[kept], variance[kept], rate, told=(guessed[kept], moved[kept]), relative_std=relative[kept]
    )
    left_out = np.zeros(value.shape, dtype=np.bool_)
    left_out[kept] = targets.left_out
    weighed = np.where(left_out | own.left_out[:, None], np.inf, variance)
    measured = Displacement(
        time_ns=time_ns + round(calibration.offset.value_s * NANOSECONDS),
        value_m=total[places],
        variance_m2=spread[places],
        source=np.full(len(places), Source.RADAR, dtype=np.uint8),
    )
    return RadarTrack(
        measured=measured,
        targets=tuple(series),
        places=places,
        lost=lost,
        datums=tuple(int(k) for k in np.flatnonzero(begins[places])),
        bent_m=_bent(series, weighed, phase_per_m)[:, places],
        left_out=left_out[:, places],
        apart_m=targets.apart_m[places],
        own=own,
        courses_m=own.courses_m(frame_s[places], weighed[:, places]),
    )


def _own(
    series: list[TargetSeries],
    shown: tuple[Floats, Floats, Floats, Floats],
    flaws: tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]],
    samples: Floats,
) -> OwnMotions:
    """How the targets move by themselves, besides setting out.

    shown: instants (n,), values and variances (targets, n), the factors' relative deviations (targets,); flaws: where a
    cycle was lost and where a target set out (targets, n), and where no acceleration was measured (n,).
    """
    (frame_s, value, variance, relative), (guessed, moved, blind) = shown, flaws
    out = moved | ~np.isfinite(variance)
    steps = guessed | (moved & ~np.roll(moved, 1, axis=1)) | (~moved & np.roll(moved, 1, axis=1))
    lasting = np.array([one.clutter_m for one in series])
    return own_motions(Shown(frame_s, np.where(out, np.nan, value), variance, steps, blind, relative, lasting), samples)


def _bent(series: list[TargetSeries], variance: Floats, phase_per_m: float) -> Floats:
    """Error (2, frames) of one standard deviation of either part of what else lies in the bins, all targets together.

    Something weaker beside a target bends its phase by a sine of the phase itself, of a size that is known and a place
    that is not; the errors of several targets add up as squares. phase_per_m: of the best target.
    """
    weight = np.where(np.isfinite(variance), 1.0 / variance, 0.0)
    weight /= np.maximum(weight.sum(axis=0), 1e-300)
    size = np.sqrt(np.sum((weight * np.array([[one.clutter_m] for one in series])) ** 2, axis=0))
    turn = phase_per_m * np.nan_to_num(series[0].range_change_m)
    return np.stack((size * np.cos(turn), size * np.sin(turn)))


def _trace(source: RadarSource, targets: tuple[Target, ...], track: RadarTrack, own: list[TargetPhasors]) -> RadarTrace:
    """What the report draws of the record."""
    followed, seen = [], []
    for target, series, one in zip(targets, track.targets, own, strict=True):
        plain = replace(target, weights=np.ones(1, dtype=np.complex128), leak=0j)
        followed.append(Followed(plain, series, source.info.axis.phase_per_m(target.range_m)))
        seen.append(_at_target(one, target, series.range_change_m[track.places] / bin_m_of(source.info)))
    phasors = np.stack(seen, axis=1)[:, None, :]
    frames = SeenFrames(track.measured.time_ns, track.places, phasors, ~track.lost[:, None])
    return radar_trace(frames, tuple(followed), limit_speed_m_s=source.info.limit_speed_m_s)


def _at_target(own: TargetPhasors, target: Target, moved_bins: Floats) -> Phasors:
    """Phasors (n,) of a target alone, where it is at the time."""
    if len(own.bins) == 1:
        return own.phasors[:, 0] - np.complex64(target.leak)
    known = np.isfinite(moved_bins)
    n = np.arange(len(moved_bins))
    moved = np.interp(n, n[known], moved_bins[known]) if known.any() else np.zeros(len(n))
    still = target.background.at(own.bins) if target.background is not None else np.full(len(own.bins), target.leak)
    return at_places(own.phasors - still, own.bins, target.place_bin + moved - np.median(moved))
