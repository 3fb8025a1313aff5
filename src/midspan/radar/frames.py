"""The frames of a recording's radar as they are read: on an even grid, receivers combined, holes known."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.progress import Progress
from midspan.radar.channels import MIN_BINS, Phasors, combined_bins
from midspan.radar.chirp import RadarInfo
from midspan.radar.following import MIN_EXCURSION_BINS, at_place, bins_within
from midspan.radar.measurement import TargetFrames, TargetSeries, displacement
from midspan.radar.target import Target
from midspan.records import NANOSECONDS, Floats, Nanoseconds, RangeFrames, seconds
from midspan.signals.acceleration import PreparedAcceleration

# The frames of a recording in memory, stamped on the radar's clock.
RadarFrames = RangeFrames


def collected(blocks: Iterable[RangeFrames], total: int, progress: Progress, what: str) -> RadarFrames:
    """All blocks of a source as one; total: frames that are expected, for the progress."""
    times, phasors, valid, done = [], [], [], 0
    for block in blocks:
        times.append(block.time_ns)
        phasors.append(block.phasors)
        valid.append(block.valid)
        done += len(block.time_ns)
        progress(done, total, what)
    progress(1, 1, what)
    return RadarFrames(np.concatenate(times), np.concatenate(phasors), np.concatenate(valid))


def even_places(time_ns: Nanoseconds) -> NDArray[np.int64]:
    """Places (n,) of stamps (n,) on an even grid, from 0 on: frames that are absent leave theirs empty.

    Raises DataError for times of which the frames fill next to nothing, which are wrong rather than gaps.
    """
    steps = np.diff(time_ns).astype(np.float64)
    if not len(steps):
        return np.zeros(len(time_ns), dtype=np.int64)
    usual = np.median(steps)
    wanted = float(np.sum(np.maximum(np.rint(steps / usual), 1.0)))
    # The frames fill one in a hundred places or more; a short record has 100 000 at most.
    if wanted > 100 * len(time_ns) + 100_000:
        raise DataError(
            f"radar: the usual interval of the {len(time_ns)} frames checked is {usual / NANOSECONDS:.3g} s, but they "
            f"span {np.sum(steps) / NANOSECONDS:.3g} s. Check the times in radar.file, or give radar.rate_hz."
        )
    whole = np.maximum(np.rint(steps / usual), 1.0).astype(np.int64)
    return np.concatenate((np.zeros(1, dtype=np.int64), np.cumsum(whole)))


def samples_of(prepared: PreparedAcceleration, origin_ns: int, span_ns: tuple[int, int] | None = None) -> Floats:
    """Rows (m, 2) of time in s after `origin_ns` and acceleration in m/s², of a span of stamps or all."""
    block = prepared.with_noise(1.0)
    first, last = span_ns or (int(block.time_ns[0]), int(block.time_ns[-1]))
    own = slice(*np.searchsorted(block.time_ns, (first, last + 1)))
    return np.column_stack((seconds(block.time_ns[own], origin_ns), block.value_m_s2[own]))


def bin_m_of(info: RadarInfo) -> float:
    """From bin to bin, m; NaN where there is no chirp or single targets are stored: nothing can be followed there."""
    if info.profile is None or info.bins < MIN_BINS:
        return float("nan")
    return float(np.median(np.diff(info.range_m)))


def series_of(frames: RadarFrames, target: Target, info: RadarInfo, samples: Floats) -> TargetSeries:
    """The displacement at one target on the even grid of `even_places`; samples: of `samples_of`, counted as stamps.

    It is followed through the bins in which the calibration saw it move; met in its place if it moves by little.
    """
    bin_m = bin_m_of(info)
    if bin_m > 0 and target.reach_bins > MIN_EXCURSION_BINS:
        bins = bins_within(target.place_bin, target.reach_bins, info.bins)
        some = frames.phasors[..., bins.astype(np.int64)]
    else:
        bins, some = np.array([target.place_bin]), at_place(frames.phasors, target.place_bin)[..., None]
    places = even_places(frames.time_ns)
    count = int(places[-1]) + 1
    several = len(bins) > 1
    phasors = np.full((count, 1, len(bins)), np.nan, dtype=np.complex64)
    phasors[places, 0] = together(some, target, frames.valid)
    even = TargetFrames(
        frame_s=np.interp(np.arange(count), places, seconds(frames.time_ns, 0)),
        phasors=phasors if several else phasors[..., 0],
        valid=np.asarray(np.isfinite(phasors).all(axis=2)),
        bins=bins if several else None,
        bin_m=bin_m,
    )
    # The receivers are together already.
    alone = replace(target, weights=np.ones(1, dtype=np.complex128))
    return displacement(even, alone, samples=samples, phase_per_m=info.axis.phase_per_m(target.range_m))


def together(phasors: Phasors, target: Target, valid: NDArray[np.bool_]) -> NDArray[np.complex64]:
    """Phasors (n, k) of phasors (n, channels, k), receivers combined as the target was calibrated."""
    return combined_bins(phasors, target.weights, valid).astype(np.complex64)


def without_holes(frames: RadarFrames) -> RadarFrames:
    """The frames on an even grid with every hole filled: by the channel before, turned as the other channels turned.

    A window's profiles must be whole and even to be searched for peaks; what is filled in is no measurement and stays
    marked in `valid` as not received.
    """
    places = even_places(frames.time_ns)
    if frames.valid.all() and places[-1] + 1 == len(places):
        return frames
    count = int(places[-1]) + 1
    time_ns = np.rint(np.interp(np.arange(count), places, frames.time_ns.astype(np.float64))).astype(np.int64)
    z = np.zeros((count, *frames.phasors.shape[1:]), dtype=np.complex64)
    valid = np.zeros((count, frames.phasors.shape[1]), dtype=np.bool_)
    z[places], valid[places] = np.where(frames.valid[..., None], frames.phasors, 0.0), frames.valid
    first = int(np.argmax(valid.all(axis=1)))
    for k in np.flatnonzero(~valid.all(axis=1)):
        good, before = valid[k], z[k - 1 if k > first else first]
        turn = np.sum(z[k, good] * np.conj(before[good]), axis=0) if good.any() else np.ones(z.shape[2])
        size = np.abs(turn)
        some = size > np.finfo(np.float32).tiny
        z[k, ~good] = before[~good] * (np.where(some, turn, 1.0) / np.where(some, size, 1.0))
    return RadarFrames(time_ns, z, valid)
