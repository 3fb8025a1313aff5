"""Two cameras that contradict each other: when, by how much, and which of them the acceleration speaks against."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.gate import ACCEPTED, REACQUIRED
from midspan.fusion.zero_course import ZeroCourse
from midspan.recording.cameras.tracked import Seen
from midspan.recording.cameras.wander import wandering_std
from midspan.recording.fusing.fuse import CourseError
from midspan.recording.streams.span import shown
from midspan.records import NANOSECONDS, Displacement, Event, Innovation, Nanoseconds
from midspan.signals.health import Mask

# Differences less than so many seconds apart are one contradiction; innovations so long beside it count.
APART_S, BESIDE_S = 5.0, 1.5
# Innovations are judged by their mean over windows of so many seconds; the worst window counts. A small jump is seen
# in the first few only: then the filter has followed it, or expects as much.
WINDOW_S, LEAST_IN_WINDOW = 0.6, 3
# The acceleration speaks against a camera whose worst window is so bad, and by this factor worse than the other's.
BAD, WORSE = 6.0, 4.0
# What both reference frames may be off by explains a difference of so many standard deviations.
EXPLAINED_STD = 3.0
# A camera without a measurement for so many seconds was blind: its zero may have changed unseen.
BLIND_S = 2.5


@dataclass(frozen=True, slots=True)
class Contradiction:
    """From from_ns to to_ns the cameras differ by about apart_m more than their stated uncertainties allow.

    guilty: the camera (0 or 1) that the acceleration speaks against, None where it does not tell. jump_m: by how much
    the difference stayed changed, 0 where it came back. yields: the camera whose zero then follows the other's where
    the acceleration does not tell; changed_ns: between which instants it jumped. explained: what both reference frames
    may be off by explains it, so that it is not told.
    """

    from_ns: int
    to_ns: int
    apart_m: float
    guilty: int | None
    jump_m: float = 0.0
    yields: int = 1
    changed_ns: tuple[int, int] = (0, 0)
    explained: bool = False

    @property
    def follower(self) -> int:
        """The camera whose zero follows the other's from the jump on."""
        return self.yields if self.guilty is None else self.guilty

    def covers(self, time_ns: Nanoseconds) -> Mask:
        """Which stamps (n,) lie in it, half a second on either side included."""
        reach_ns = NANOSECONDS // 2
        return (time_ns >= self.from_ns - reach_ns) & (time_ns <= self.to_ns + reach_ns)

    def told(self, names: tuple[str, str]) -> Event:
        """The event that tells it; names of both cameras."""
        # A jump may be told by a single frame.
        when = f"From {shown(self.from_ns)} to {shown(self.to_ns)}"
        if shown(self.from_ns) == shown(self.to_ns):
            when = f"At {shown(self.from_ns)}"
        text = (
            f"{when} {names[1]} and {names[0]} differ by "
            f"{1e3 * abs(self.apart_m):.2g} mm more than their stated uncertainties allow; "
        )
        if self.guilty is None:
            text += "the acceleration does not tell which one is wrong: the band holds both."
        else:
            text += f"the acceleration contradicts the {names[self.guilty]}, which was left out there."
        if self.jump_m:
            text += f" The difference stays changed by {1e3 * self.jump_m:+.2g} mm"
            text += "." if self.guilty is not None else f": the {names[self.follower]} was brought to the other's zero."
        return Event(self.from_ns, "contradiction", text)


def contradictions(
    course: ZeroCourse, seen: tuple[Seen, Seen], innovations: Sequence[Innovation]
) -> tuple[Contradiction, ...]:
    """All stretches in which the differences leave the course.

    innovations: of each camera alone beside the acceleration.
    """
    allowed = EXPLAINED_STD * np.hypot(*(wandering_std(one, course.time_ns) for one in seen))
    far = np.maximum(np.abs(course.apart_m), np.abs(course.jump_m))
    places = np.flatnonzero(far > 0.0)
    if not len(places):
        return ()
    apart_s = np.diff(course.time_ns[places]) / NANOSECONDS
    # A jump ends its stretch.
    cut = (apart_s > APART_S) | (course.jump_m[places[:-1]] != 0.0)
    found = []
    for own in np.split(places, np.flatnonzero(cut) + 1):
        told = own[far[own] > allowed[own]]
        stays = _stays(course, own)
        if not len(told) and not stays:
            continue
        size = abs(stays) if stays else float(np.max(far[told]))
        if not len(told):
            from_ns, to_ns = int(course.time_ns[own[0]]), int(course.time_ns[own[-1]])
            guilty = None
        else:
            first_ns, to_ns = int(course.time_ns[told[0]]), int(course.time_ns[told[-1]])
            from_ns = min(_rejected_from(one, first_ns) for one in innovations)
            guilty = _guilty(innovations, from_ns, to_ns)
        yields, changed_ns = _yielding(course, own[0], seen, innovations)
        found.append(Contradiction(from_ns, to_ns, size, guilty, stays, yields, changed_ns, not len(told)))
    return tuple(found)


def _stays(course: ZeroCourse, own: NDArray[np.int64]) -> float:
    """By how much (m) the difference stays changed after the pieces `own`; 0 where it comes back."""
    if course.jump_m[own[-1]]:
        return float(course.jump_m[own[-1]])
    # What has not come back by the end is as one that stays.
    unsettled = own[-1] == len(course.time_ns) - 1 and len(own) >= LEAST_IN_WINDOW
    return float(np.median(course.apart_m[own])) if unsettled else 0.0


def _yielding(
    course: ZeroCourse, place: int, seen: tuple[Seen, Seen], innovations: Sequence[Innovation]
) -> tuple[int, tuple[int, int]]:
    """The camera (0 or 1) whose zero follows the other's after a jump up to the piece at `place`, and between which
    instants (ns) it jumped.

    The first one's zero counts, but for one that it comes back with after it was blind, beside one that was not and
    whose own level the acceleration bore out all the while.
    """
    end = int(course.time_ns[place])
    begin = int(course.time_ns[max(place - 1, 0)])
    gaps = [_longest_gap(one.measured, begin, end) for one in seen]
    lengths_s = [(to - since) / NANOSECONDS for since, to in gaps]
    if lengths_s[0] > BLIND_S > lengths_s[1]:
        taken_over = _taken_over(innovations[1], gaps[0])
        return (0, gaps[0]) if taken_over is None else (1, taken_over)
    return 1, gaps[1] if lengths_s[1] > BLIND_S else (begin, end)


def _taken_over(found: Innovation, gap_ns: tuple[int, int]) -> tuple[int, int] | None:
    """Between which instants (ns) in a gap another level of a camera was first met; None where it kept its own."""
    inside = np.flatnonzero((found.time_ns > gap_ns[0]) & (found.time_ns < gap_ns[1]))
    places = inside[found.verdict[inside] == REACQUIRED]
    if not len(places):
        return None
    before = np.flatnonzero(found.verdict[: places[0]] == ACCEPTED)
    last = int(before[-1]) if len(before) else 0
    return int(found.time_ns[last]), int(found.time_ns[last + 1])


def _longest_gap(measured: Displacement, begin_ns: int, end_ns: int) -> tuple[int, int]:
    """First and last instant (ns) of the longest stretch from one to another without a measurement."""
    inside = np.isfinite(measured.value_m) & (measured.time_ns > begin_ns) & (measured.time_ns < end_ns)
    stamps = np.concatenate(([begin_ns], measured.time_ns[inside], [end_ns]))
    longest = int(np.argmax(np.diff(stamps)))
    return int(stamps[longest]), int(stamps[longest + 1])


def course_without(course: ZeroCourse, found: Sequence[Contradiction]) -> ZeroCourse:
    """The second's zero beside the first without what the first one's jumps changed, each jump of its own where it
    began: a difference that stays has stayed from its beginning on.
    """
    level, jump = course.level_m.copy(), course.jump_m.copy()
    steps: list[Contradiction] = []
    for one in found:
        if not one.jump_m or one.guilty == 1:
            continue
        begin, end = np.searchsorted(course.time_ns, one.changed_ns)
        if one.follower == 1 and begin == end:
            steps.append(one)  # between two pieces: from one to the other the level would go as a drift does
        here = (course.time_ns == one.to_ns) & (course.jump_m != 0.0)
        if here.any():
            level[course.time_ns >= one.to_ns] -= one.jump_m
        jump[here] = 0.0
        if one.follower == 1:
            after = course.time_ns >= one.changed_ns[1]
            level[after] += one.jump_m
            jump[np.argmax(after)] = one.jump_m
    made = replace(course, level_m=level, jump_m=jump)
    for one in steps:
        made = _stepped(made, one)
    return made


def _stepped(course: ZeroCourse, one: Contradiction) -> ZeroCourse:
    """The course with a jump where it was, between two pieces that lie far apart."""
    place = int(np.searchsorted(course.time_ns, one.changed_ns[0]))
    if not 0 < place < len(course.time_ns):
        return course
    levels = (course.level_m[place] - one.jump_m, course.level_m[place])
    jump = course.jump_m.copy()
    jump[place] = 0.0
    return replace(
        course,
        time_ns=np.insert(course.time_ns, [place, place], one.changed_ns),
        level_m=np.insert(course.level_m, [place, place], levels),
        variance_m2=np.insert(course.variance_m2, [place, place], course.variance_m2[place]),
        apart_m=np.insert(course.apart_m, [place, place], 0.0),
        jump_m=np.insert(jump, [place, place], (0.0, one.jump_m)),
    )


def cleared(found: Sequence[Contradiction], number: int, measured: Displacement) -> Displacement:
    """A camera's measurements (0: the first camera) without those that it is guilty of; its own jumps taken out.

    The second camera's jumps are in its zero beside the first.
    """
    value = measured.value_m.copy()
    for one in found:
        if one.jump_m and number == 0 and one.follower == 0:
            value[measured.time_ns > (one.to_ns if one.guilty == 0 else sum(one.changed_ns) // 2)] += one.jump_m
        if one.guilty == number:
            value[one.covers(measured.time_ns)] = np.nan
        elif one.jump_m and one.guilty is None and number == 1 == one.follower:
            # Between both levels its zero is not known.
            since, to = one.changed_ns
            value[(measured.time_ns > since) & (measured.time_ns < to)] = np.nan
    return replace(measured, value_m=value)


def bands(found: Sequence[Contradiction], eyes: tuple[Seen, Seen], time_ns: Nanoseconds) -> tuple[CourseError, ...]:
    """What both cameras' zeros are uncertain by (at stamps, n) where nothing tells which of them is right."""
    sources = (eyes[0].eye.source, eyes[1].eye.source)
    told = []
    for one in found:
        if one.guilty is None and not one.explained:
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
