"""What is kept of a radar's whole record for the report: thinned arrays of bounded size, however long it is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.radar.channels import Phasors, combined
from midspan.radar.measurement import TargetSeries
from midspan.radar.target import Target
from midspan.records import NANOSECONDS, Floats, Nanoseconds
from midspan.signals.thinning import starts

# Stretches that a record is thinned to.
MOST_STRETCHES = 2000
# Length of the stretch of phase that is kept whole, s, and the time over which its speed is taken, s.
EXCERPT_S, SPEED_S = 2.5, 0.03


@dataclass(frozen=True, slots=True)
class TargetTrace:
    """One target over the record, in stretches (k,) from time_ns on the accelerometer's clock.

    low, high: amplitude as a share of the calibrated one, NaN where no frame was received; used: share of the frames
    that told the displacement; restarts_ns: frames from which on the cycle had to be found anew.
    """

    range_m: float
    time_ns: Nanoseconds
    low: Floats
    high: Floats
    used: Floats
    restarts_ns: Nanoseconds


@dataclass(frozen=True, slots=True)
class PhaseExcerpt:
    """The fastest seconds of the best target's phase, rad, arrays (n,) at time_ns on the accelerometer's clock.

    wrapped: as measured, −π … π; plain: unwrapped by the nearest cycle from frame to frame; unwrapped: as it was used,
    NaN where it was not.
    """

    time_ns: Nanoseconds
    wrapped: Floats
    plain: Floats
    unwrapped: Floats


@dataclass(frozen=True, slots=True)
class RadarTrace:
    """The radar over the whole record.

    targets: best first; low, high (k,): unwrapped phase of the best one, rad, in the stretches of its trace;
    speed_m_s: largest in the line of sight; limit_speed_m_s: where plain unwrapping fails; excerpt: None where
    nothing was seen.
    """

    targets: tuple[TargetTrace, ...]
    low: Floats
    high: Floats
    speed_m_s: float
    limit_speed_m_s: float
    excerpt: PhaseExcerpt | None


@dataclass(frozen=True, slots=True)
class SeenFrames:
    """The frames of a record that were received, whole or in part.

    time_ns (n,): on the accelerometer's clock; places (n,): on an even grid from 0 on; phasors (n, channels, targets)
    and valid (n, channels).
    """

    time_ns: Nanoseconds
    places: NDArray[np.int64]
    phasors: Phasors
    valid: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Followed:
    """A calibrated target as it was followed: its series on an even grid of frames, and rad per m of its range."""

    target: Target
    series: TargetSeries
    phase_per_m: float


def radar_trace(frames: SeenFrames, followed: tuple[Followed, ...], *, limit_speed_m_s: float) -> RadarTrace:
    """Thin what the targets showed; followed: in the order of the phasors, best first.

    limit_speed_m_s: line-of-sight speed from which plain unwrapping fails.
    """
    time_ns, places = frames.time_ns, frames.places
    seen = [
        combined(frames.phasors[..., k], one.target.weights, frames.valid) - one.target.leak
        for k, one in enumerate(followed)
    ]
    best = followed[0]
    phase_rad = best.phase_per_m * best.series.range_change_m[places]
    at = starts(len(time_ns), MOST_STRETCHES)
    step_s = float(np.median(np.diff(time_ns))) / NANOSECONDS
    lag = max(1, round(SPEED_S / step_s))
    speed = np.abs(phase_rad[lag:] - phase_rad[:-lag]) / (best.phase_per_m * lag * step_s)
    # Across a pause, or where the cycle was found anew, the difference is no speed.
    speed[(places[lag:] - places[:-lag] > lag) | _restarted(best.series, places, lag)] = np.nan
    fastest = int(np.nanargmax(speed)) if np.isfinite(speed).any() else -1
    return RadarTrace(
        targets=tuple(_target(frames, np.abs(z), one) for z, one in zip(seen, followed, strict=True)),
        low=np.fmin.reduceat(phase_rad, at),
        high=np.fmax.reduceat(phase_rad, at),
        speed_m_s=float(speed[fastest]) if fastest >= 0 else np.nan,
        limit_speed_m_s=limit_speed_m_s,
        excerpt=_excerpt(fastest, time_ns, phase_rad, np.angle(seen[0])) if fastest >= 0 else None,
    )


def _restarted(series: TargetSeries, places: NDArray[np.int64], lag: int) -> NDArray[np.bool_]:
    """Whether the cycle was found anew within the `lag` frames after each frame (n − lag,)."""
    count = np.zeros(int(places[-1]) + 2, dtype=np.int64)
    count[np.array(series.restarts, dtype=np.int64)] = 1
    before = np.cumsum(count)
    return np.asarray(before[places[lag:]] > before[places[:-lag]])


def _target(frames: SeenFrames, amplitude: Floats, followed: Followed) -> TargetTrace:
    time_ns, places = frames.time_ns, frames.places
    at = starts(len(time_ns), MOST_STRETCHES)
    share = np.asarray(amplitude, dtype=np.float64) / followed.target.amplitude
    used = np.isfinite(followed.series.range_change_m[places]).astype(np.float64)
    again = np.searchsorted(places, np.array(followed.series.restarts, dtype=np.int64))
    return TargetTrace(
        range_m=followed.target.range_m,
        time_ns=time_ns[at],
        low=np.fmin.reduceat(share, at),
        high=np.fmax.reduceat(share, at),
        used=np.add.reduceat(used, at) / np.diff(np.append(at, len(time_ns))),
        restarts_ns=time_ns[np.minimum(again, len(time_ns) - 1)],
    )


def _excerpt(fastest: int, time_ns: Nanoseconds, phase_rad: Floats, wrapped_rad: Floats) -> PhaseExcerpt:
    """The stretch about the fastest frame."""
    half = round(0.5 * EXCERPT_S * NANOSECONDS)
    middle = int(time_ns[fastest])
    first, last = (int(k) for k in np.searchsorted(time_ns, (middle - half, middle + half)))
    cut = slice(first, last)
    known = np.isfinite(wrapped_rad[cut])
    plain = np.full(last - first, np.nan)
    plain[known] = np.unwrap(wrapped_rad[cut][known])
    # Both ways of unwrapping begin at the same place.
    both = np.flatnonzero(known & np.isfinite(phase_rad[cut]))
    shift = phase_rad[cut][both[0]] - plain[both[0]] if len(both) else 0.0
    return PhaseExcerpt(time_ns[cut].copy(), wrapped_rad[cut].copy(), plain + shift, phase_rad[cut].copy())
