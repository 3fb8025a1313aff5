"""What is kept of a radar's frames while a record runs: thinned arrays of bounded size, however long it is."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from midspan.engine.radar_target import FollowedTarget
from midspan.records import NANOSECONDS, Floats, Nanoseconds, PhaseMeasurement, Status

# A record is thinned to this many segments, or half as many.
MAX_SEGMENTS = 2000
# Length of the part of the phase that is kept whole, s, and the time over which its speed is taken, s.
EXCERPT_S, SPEED_S = 2.5, 0.03
# Events after which the phase goes on from another place.
STEPS = ("new datum", "cycle")


@dataclass(frozen=True, slots=True)
class TargetTrace:
    """One target over the record, in segments (k,) from time_ns on the accelerometer's clock.

    low, high: amplitude as a share of the calibrated one, NaN where no frame was received; used: share of the frames
    that gave a phase; restarts_ns: frames from which on the zero of the phase is a new one.
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

    wrapped: −π … π, counted from the first used frame; plain: unwrapped by the nearest cycle from frame to frame;
    unwrapped: as it was used, NaN where it was not.
    """

    time_ns: Nanoseconds
    wrapped: Floats
    plain: Floats
    unwrapped: Floats


@dataclass(frozen=True, slots=True)
class RadarTrace:
    """The radar over the whole record.

    targets: best first; low, high (k,): unwrapped phase of the best one, rad, in the segments of its trace;
    speed_m_s: largest in the line of sight; limit_speed_m_s: where plain unwrapping fails; excerpt: None where
    nothing was seen.
    """

    targets: tuple[TargetTrace, ...]
    low: Floats
    high: Floats
    speed_m_s: float
    limit_speed_m_s: float
    excerpt: PhaseExcerpt | None


@dataclass(slots=True)
class _Segments:
    """One target's segments, each of this many frames (`length`) but the last: a list of numbers for each.

    rows: first stamp (ns), lowest and highest strength, lowest and highest phase (rad), used frames, frames.
    """

    rows: list[list[float]] = field(default_factory=list)
    length: int = 1

    def push(self, one: PhaseMeasurement) -> None:
        """Take the next frame."""
        strength = one.strength if one.strength > 0.0 else np.nan
        used = float(one.status == Status.TRACKING)
        row = [one.time_ns, strength, strength, one.phase_rad, one.phase_rad, used, 1.0]
        if self.rows and self.rows[-1][6] < self.length:
            self.rows[-1] = _joined(self.rows[-1], row)
            return
        if len(self.rows) == MAX_SEGMENTS:
            self.rows = [_joined(*self.rows[k : k + 2]) for k in range(0, MAX_SEGMENTS, 2)]
            self.length *= 2
        self.rows.append(row)

    def columns(self) -> list[Floats]:
        """The seven columns (k,) of all segments; the stamps lose their last digits."""
        return list(np.array(self.rows, dtype=np.float64).reshape(-1, 7).T)


def _joined(a: list[float], b: list[float]) -> list[float]:
    """Two segments that follow each other as one; NaN is left out of the extremes."""
    lows = [b[k] if a[k] != a[k] or b[k] < a[k] else a[k] for k in (1, 3)]
    highs = [b[k] if a[k] != a[k] or b[k] > a[k] else a[k] for k in (2, 4)]
    return [a[0], lows[0], highs[0], lows[1], highs[1], a[5] + b[5], a[6] + b[6]]


class _Fastest:
    """The fastest part of a phase: of the last frames the place that moved by the most in SPEED_S, and about it."""

    def __init__(self, period_s: float) -> None:
        self._lag = max(1, round(SPEED_S / period_s))
        self._lag_ns = (self._lag + 0.5) * period_s * NANOSECONDS
        self._half_ns = round(0.5 * EXCERPT_S * NANOSECONDS)
        self._near: deque[tuple[int, float]] = deque()
        self._since: deque[tuple[int, float]] = deque(maxlen=self._lag + 1)
        self._at_ns: int | None = None
        self.rate_rad_s = np.nan
        self._kept: list[tuple[int, float]] = []

    def push(self, one: PhaseMeasurement) -> None:
        """Take the next frame."""
        if any(event.kind in STEPS for event in one.events):
            self._since.clear()
        frame = (one.time_ns, one.phase_rad)
        self._near.append(frame)
        self._since.append(frame)
        while self._near[0][0] < one.time_ns - 2 * self._half_ns:
            self._near.popleft()
        first = self._since[0]
        passed_ns = one.time_ns - first[0]
        if len(self._since) > self._lag and passed_ns < self._lag_ns:
            rate = abs(one.phase_rad - first[1]) * NANOSECONDS / passed_ns
            if rate > self.rate_rad_s or (np.isnan(self.rate_rad_s) and np.isfinite(rate)):
                self.rate_rad_s, self._at_ns = rate, one.time_ns
        if self._at_ns is not None and one.time_ns >= self._at_ns + self._half_ns:
            self._kept, self._at_ns = list(self._near), None

    def excerpt(self) -> PhaseExcerpt | None:
        """The seconds about the fastest frame."""
        frames = self._kept if self._at_ns is None else list(self._near)
        if not frames:
            return None
        time_ns = np.array([time for time, _ in frames], dtype=np.int64)
        unwrapped = np.array([phase for _, phase in frames])
        wrapped = np.angle(np.exp(1j * unwrapped))
        known = np.isfinite(wrapped)
        plain = np.full(len(wrapped), np.nan)
        plain[known] = np.unwrap(wrapped[known])
        # Both ways of unwrapping begin at the same place.
        first = int(np.argmax(known))
        return PhaseExcerpt(time_ns, wrapped, plain + (unwrapped[first] - plain[first]), unwrapped)


class RadarLog:
    """Takes what a radar's stage found in each frame; targets: in its order, best first."""

    def __init__(self, targets: Sequence[FollowedTarget]) -> None:
        self.targets = tuple(targets)
        self.frames = 0
        self.lost = 0
        self.used = [0] * len(self.targets)
        self._segments = [_Segments() for _ in self.targets]
        self._restarts: list[list[int]] = [[] for _ in self.targets]
        self._fastest = _Fastest(self.targets[0].period_s)

    def push(self, found: Sequence[PhaseMeasurement]) -> None:
        """Take the measurements of one frame, one a target."""
        self.frames += 1
        self.lost += all(one.strength == 0.0 for one in found)
        for k, one in enumerate(found):
            self.used[k] += one.status == Status.TRACKING
            self._segments[k].push(one)
            self._restarts[k] += [event.time_ns for event in one.events if event.kind == "new datum"]
        self._fastest.push(found[0])

    @property
    def restarts_ns(self) -> Nanoseconds:
        """Instants (k,) from which on the zero of any target is a new one."""
        return np.array(sorted({stamp for own in self._restarts for stamp in own}), dtype=np.int64)

    def trace(self, limit_speed_m_s: float) -> RadarTrace:
        """What a report draws; limit_speed_m_s: line-of-sight speed from which plain unwrapping fails."""
        _, _, _, low, high, _, _ = self._segments[0].columns()
        return RadarTrace(
            targets=tuple(self._target(k) for k in range(len(self.targets))),
            low=low,
            high=high,
            speed_m_s=self._fastest.rate_rad_s / self.targets[0].phase_per_m,
            limit_speed_m_s=limit_speed_m_s,
            excerpt=self._fastest.excerpt(),
        )

    def _target(self, number: int) -> TargetTrace:
        segments, range_m = self._segments[number], self.targets[number].target.range_m
        stamps = np.array([row[0] for row in segments.rows], dtype=np.int64)
        _, low, high, _, _, used, frames = segments.columns()
        restarts = np.array(self._restarts[number], dtype=np.int64)
        return TargetTrace(range_m, stamps, low, high, used / frames, restarts)
