"""Two cameras that contradict each other: when, by how much, and which of them the acceleration speaks against."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.fusion.gate import ACCEPTED
from midspan.fusion.zero_course import ZeroCourse
from midspan.recording.cameras.tracked import Seen
from midspan.recording.cameras.wander import wandering_std
from midspan.recording.fusing.fuse import CourseError
from midspan.recording.streams.span import shown
from midspan.records import NANOSECONDS, Displacement, Event, Innovation, Nanoseconds
from midspan.signals.health import Mask

# Differences less than so many seconds apart are one contradiction; innovations so long beside it count.
APART_S, BESIDE_S = 5.0, 1.5
# Innovations are judged by their mean over windows of so many seconds; the worst window counts.
WINDOW_S, LEAST_IN_WINDOW = 2.0, 3
# The acceleration speaks against a camera whose worst window is so bad, and by this factor worse than the other's.
BAD, WORSE = 6.0, 4.0
# What both reference frames may be off by explains a difference of so many standard deviations.
EXPLAINED_STD = 3.0


@dataclass(frozen=True, slots=True)
class Contradiction:
    """From from_ns to to_ns the cameras differ by about apart_m more than their stated uncertainties allow.

    guilty: the camera (0 or 1) that the acceleration speaks against, None where it does not tell. jump_m: by how much
    the difference stayed changed from to_ns on, 0 where it came back.
    """

    from_ns: int
    to_ns: int
    apart_m: float
    guilty: int | None
    jump_m: float = 0.0

    def covers(self, time_ns: Nanoseconds) -> Mask:
        """Which stamps (n,) lie in it, half a second on either side included."""
        reach_ns = NANOSECONDS // 2
        return (time_ns >= self.from_ns - reach_ns) & (time_ns <= self.to_ns + reach_ns)

    def told(self, names: tuple[str, str]) -> Event:
        """The event that tells it; names of both cameras."""
        text = (
            f"From {shown(self.from_ns)} to {shown(self.to_ns)} {names[1]} and {names[0]} differ by "
            f"{1e3 * abs(self.apart_m):.2g} mm more than their stated uncertainties allow; "
        )
        if self.guilty is None:
            text += "the acceleration does not tell which one is wrong: the band holds both."
        else:
            text += f"the acceleration contradicts the {names[self.guilty]}, which was left out there."
        if self.jump_m:
            text += f" The difference stays changed by {1e3 * self.jump_m:+.2g} mm."
        return Event(self.from_ns, "contradiction", text)


def contradictions(
    course: ZeroCourse, seen: tuple[Seen, Seen], innovations: Sequence[Innovation]
) -> tuple[Contradiction, ...]:
    """All stretches in which the differences leave the course.

    innovations: of each camera alone beside the acceleration.
    """
    allowed = EXPLAINED_STD * np.hypot(*(wandering_std(one, course.time_ns) for one in seen))
    jump = course.jump_m
    far = ((course.apart_m != 0.0) & (np.abs(course.apart_m) > allowed)) | (np.abs(jump) > allowed)
    places = np.flatnonzero(far)
    if not len(places):
        return ()
    apart_s = np.diff(course.time_ns[places]) / NANOSECONDS
    # A jump ends its stretch.
    cut = (apart_s > APART_S) | (jump[places[:-1]] != 0.0)
    found = []
    for own in np.split(places, np.flatnonzero(cut) + 1):
        end = int(course.time_ns[own[-1]])
        begin = min(_rejected_from(one, int(course.time_ns[own[0]])) for one in innovations)
        stays = float(jump[own[-1]])
        size = abs(stays) if stays else float(np.max(np.abs(course.apart_m[own])))
        found.append(Contradiction(begin, end, size, _guilty(innovations, begin, end), stays))
    return tuple(found)


def cleared(found: Sequence[Contradiction], number: int, measured: Displacement) -> Displacement:
    """A camera's measurements (0: the first camera) without those that it is guilty of; its own jumps taken out.

    The second camera's jumps are in its zero beside the first.
    """
    value = measured.value_m.copy()
    for one in found:
        if one.guilty == number:
            if number == 0 and one.jump_m:
                value[measured.time_ns > one.to_ns] += one.jump_m
            value[one.covers(measured.time_ns)] = np.nan
    return replace(measured, value_m=value)


def bands(found: Sequence[Contradiction], eyes: tuple[Seen, Seen], time_ns: Nanoseconds) -> tuple[CourseError, ...]:
    """What both cameras' zeros are uncertain by (at stamps, n) where nothing tells which of them is right."""
    sources = (eyes[0].eye.source, eyes[1].eye.source)
    told = []
    for one in found:
        if one.guilty is None:
            inside = one.covers(time_ns)
            if one.jump_m:
                inside |= time_ns >= one.from_ns
            told.append(CourseError(sources, time_ns, np.where(inside, abs(one.apart_m), 0.0)))
    return tuple(told)


def _rejected_from(found: Innovation, begin_ns: int) -> int:
    """Since when a camera has been rejected without a break at an instant; that instant where it has not.

    A camera that the gate rejects is not seen to differ: its displacement is the acceleration's alone.
    """
    near = slice(None, int(np.searchsorted(found.time_ns, begin_ns + round(BESIDE_S * NANOSECONDS), side="right")))
    before = np.flatnonzero(found.verdict[near] != ACCEPTED)
    if not len(before) or found.time_ns[before[-1]] < begin_ns - round(BESIDE_S * NANOSECONDS):
        return begin_ns
    breaks = np.flatnonzero(np.diff(found.time_ns[before]) > BESIDE_S * NANOSECONDS)
    return min(begin_ns, int(found.time_ns[before[breaks[-1] + 1 if len(breaks) else 0]]))


def _guilty(innovations: Sequence[Innovation], begin_ns: int, end_ns: int) -> int | None:
    """The camera whose innovations are bad there, and much worse than the other's."""
    worst = [_worst(one, begin_ns, end_ns) for one in innovations]
    number = int(np.argmax(worst))
    return number if worst[number] > max(BAD, WORSE * worst[1 - number]) else None


def _worst(found: Innovation, begin_ns: int, end_ns: int) -> float:
    """The largest mean over a window of squared innovations in their variances; 0 where there are too few."""
    reach_ns = round(BESIDE_S * NANOSECONDS)
    inside = (found.time_ns >= begin_ns - reach_ns) & (found.time_ns <= end_ns + reach_ns)
    if np.count_nonzero(inside) < LEAST_IN_WINDOW:
        return 0.0
    time_s = (found.time_ns[inside] - begin_ns) / NANOSECONDS
    squared = found.value_m[inside] ** 2 / found.variance_m2[inside]
    ends = np.searchsorted(time_s, time_s + WINDOW_S)
    sums = np.concatenate(([0.0], np.cumsum(squared)))
    count = ends - np.arange(len(time_s))
    means = (sums[ends] - sums[: len(time_s)]) / count
    return float(np.max(means[count >= min(LEAST_IN_WINDOW, int(count.max()))]))
