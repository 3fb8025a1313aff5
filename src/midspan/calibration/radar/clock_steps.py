"""Steps of a radar's clock: it was set, which shows as one interval between stamps that is not like the others.

Frames that are lost make such an interval too, and then the stamps are right. The offset between the wrapped phase and
the acceleration, before and after the interval, tells which; it needs no unwrapping.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from midspan.notices import Notice
from midspan.radar.alignment import Alignment, align
from midspan.records import NANOSECONDS, Floats, Nanoseconds, seconds
from midspan.signals.stamps import shown

# An interval that differs from the usual one by more than this share of it is none of jittering stamps. A file with
# more of them loses frames all the time.
IRREGULAR, MAX_INTERVALS = 0.5, 20
# Frames on either side are compared for this long at least and at most, s.
MIN_SIDE_S, MAX_SIDE_S = 5.0, 30.0
# The clock was set where the offset changes by what the interval says, within this many standard deviations and a
# half of a millisecond, by which frames jitter, and by this many deviations from none at all.
AGREES, CERTAIN, JITTER_S = 4.0, 8.0, 5e-4


@dataclass(frozen=True, slots=True)
class ClockStep:
    """From a frame on late_s is to be added to the stamps."""

    frame: int
    late_s: float


@dataclass(frozen=True, slots=True)
class Phase:
    """Wrapped phase (n,) of the strongest target at stamps (n,) ns of the radar's clock; phase_per_m: rad per m."""

    time_ns: Nanoseconds
    phase_rad: Floats
    phase_per_m: float


def irregular(time_ns: Nanoseconds) -> list[int]:
    """The frames behind an interval that is not like the others; none where these are many."""
    steps = np.diff(time_ns)
    if len(steps) < 2:
        return []
    usual = float(np.median(steps))
    found = np.flatnonzero(np.abs(steps - usual) > IRREGULAR * usual) + 1
    return [int(k) for k in found] if len(found) <= MAX_INTERVALS else []


def clock_steps(phase: Phase, samples: Floats, max_offset_s: float) -> list[ClockStep]:
    """Steps of the clock; samples (m, 2): time (s from the first frame's stamp on) and acceleration (m/s²)."""
    time_s, edges = seconds(phase.time_ns, int(phase.time_ns[0])), irregular(phase.time_ns)
    period_s = float(np.median(np.diff(time_s)))
    parts = [slice(*ends) for ends in zip([0, *edges], [*edges, len(time_s)], strict=True)]
    found = []
    for edge, before, after in zip(edges, parts, parts[1:], strict=False):
        reach = np.searchsorted(time_s, (time_s[edge] - MAX_SIDE_S, time_s[edge] + MAX_SIDE_S))
        sides = slice(max(before.start, int(reach[0])), edge), slice(edge, min(after.stop, int(reach[1])))
        first, second = (_offset(phase, time_s, samples, side, max_offset_s) for side in sides)
        if first is None or second is None:
            continue
        change_s, std_s = second.offset_s - first.offset_s, float(np.hypot(first.offset_std_s, second.offset_std_s))
        # Whole frames may be lost as the clock is set.
        interval_s = float(time_s[edge] - time_s[edge - 1])
        set_by_s = -(interval_s - max(round((interval_s + change_s) / period_s), 1) * period_s)
        if abs(change_s - set_by_s) < AGREES * std_s + JITTER_S and abs(set_by_s) > CERTAIN * std_s:
            found.append(ClockStep(edge, set_by_s))
    return found


def _offset(phase: Phase, time_s: Floats, samples: Floats, side: slice, max_offset_s: float) -> Alignment | None:
    """Clock offset that the frames of one side tell."""
    own = time_s[side]
    if len(own) < 2 or own[-1] - own[0] < MIN_SIDE_S:
        return None
    near = slice(*np.searchsorted(samples[:, 0], (own[0] - 2.0 * max_offset_s, own[-1] + 2.0 * max_offset_s)))
    if near.stop - near.start < 10:
        return None
    return align(
        own,
        phase.phase_rad[side],
        samples=samples[near],
        phase_per_m=phase.phase_per_m,
        max_offset_s=max_offset_s,
    )


def lateness_ns(steps: Sequence[ClockStep], count: int) -> Nanoseconds:
    """What is to be added to each of `count` stamps, ns."""
    late_ns = np.zeros(count, dtype=np.int64)
    for step in steps:
        late_ns[step.frame :] += round(NANOSECONDS * step.late_s)
    return late_ns


def steps_text(steps: Sequence[ClockStep], time_ns: Nanoseconds, sensor: str) -> tuple[Notice, ...]:
    """A sentence for each step that was taken out of the stamps (n,)."""
    return tuple(
        Notice(
            "clock-corrected",
            f"{sensor}: its clock was set at {shown(int(time_ns[step.frame]))}: {1e3 * step.late_s:+.4g} ms were "
            "added to its time stamps from there on.",
        )
        for step in steps
    )
