"""How far the zeros of two cameras wander: what their trackers say of it, and what their difference shows."""

from dataclasses import replace

import numpy as np

from midspan.fusion.zero_course import ZeroCourse
from midspan.recording.cameras.tracked import Seen
from midspan.recording.fusing.fuse import CourseError
from midspan.recording.streams.span import shown
from midspan.records import NANOSECONDS, Displacement, Event, Floats, Nanoseconds
from midspan.signals.health import Mask

# The noise of single frames is at least this share of a variance that holds what the reference frames are off by too.
LEAST_NOISE = 0.01
# A zero that goes further than so many standard deviations of a frame is told.
NOTABLE_STD = 10.0


def wandering_std(seen: Seen, time_ns: Nanoseconds) -> Floats:
    """What a camera's reference frames may be off by (n,), m, at stamps (n,)."""
    if seen.wandering is None:
        return np.zeros(len(time_ns))
    return np.interp(time_ns, seen.wandering.time_ns, seen.wandering.std_m)


def without_wandering(seen: Seen) -> Displacement:
    """A camera's measurements with the noise of single frames alone."""
    measured = seen.measured
    noise = measured.variance_m2 - wandering_std(seen, measured.time_ns) ** 2
    return replace(measured, variance_m2=np.maximum(noise, LEAST_NOISE * measured.variance_m2))


def wander_event(course: ZeroCourse, quiet: tuple[Displacement, ...], names: tuple[str, str]) -> Event | None:
    """An event from where on the zeros go far from each other; quiet: both cameras with the noise of single frames."""
    noise = max(float(np.sqrt(np.nanmedian(one.variance_m2[np.isfinite(one.value_m)]))) for one in quiet)
    wandered = np.where(course.apart_m == 0.0, gone_m(course), 0.0)
    far = np.flatnonzero(wandered > NOTABLE_STD * noise)
    if not len(far):
        return None
    worst = int(np.argmax(wandered))
    since, until = (int(course.time_ns[place]) for place in far[[0, -1]])
    text = (
        f"From {shown(since)} to {shown(until)} the zeros of {names[1]} and {names[0]} wander beside each other by "
        f"{1e3 * course.wander_m:.2g} mm (root mean square), most at {shown(int(course.time_ns[worst]))}, by "
        f"{1e3 * wandered[worst]:.2g} mm; nothing tells which one's it is: the band holds it. Look at both targets."
    )
    return Event(since, "contradiction", text)


def gone_m(course: ZeroCourse) -> Floats:
    """How far (n,) m the second's zero beside the first is from where it began; jumps do not count."""
    gone: Floats = np.abs(course.level_m - np.cumsum(course.jump_m) - course.level_m[0])
    return gone


def zero_errors(seen: tuple[Seen, Seen], course: ZeroCourse, alone: Mask) -> tuple[CourseError, ...]:
    """What is uncertain of both zeros. alone (n,): which of the second's frames the first one does not see beside.

    Nothing tells whose zero it is that wanders, so half of the variance is taken for the first one's and the result's.
    """
    (first, second), time_ns = seen, seen[1].measured.time_ns
    since_s = np.abs(time_ns - course.time_ns[0]) / NANOSECONDS
    wander = np.minimum(np.sqrt(course.growth_m2_s * since_s), course.wander_m)
    # Where the difference has gone further than it does on the whole it may be all the first one's.
    wander = np.maximum(wander, np.interp(time_ns, course.time_ns, gone_m(course))) / np.sqrt(2.0)
    found = [
        CourseError((first.eye.source, second.eye.source), time_ns, wander),
        CourseError(second.eye.source, time_ns, np.sqrt(course.at(time_ns)[1])),
    ]
    if first.wandering is not None:
        found.append(first.wandering)
    if second.wandering is not None:
        # Where both see, the second's zero is measured.
        said = wandering_std(second, time_ns)
        found.append(CourseError(second.eye.source, time_ns, np.where(alone, said, 0.0)))
    return tuple(found)
