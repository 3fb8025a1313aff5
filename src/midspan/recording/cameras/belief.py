"""Two cameras as one displacement: the second on the zero of the first, and which of them is believed when."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.engine.sun import sun_elevation_deg
from midspan.engine.switching import PUBLISHED, Look, Switch, SwitchSettings
from midspan.fusion.path import at
from midspan.fusion.smoother import smooth
from midspan.fusion.zero_course import ZeroCourse, zero_course
from midspan.recording.cameras.contradiction import (
    bands,
    cleared,
    contradictions,
    course_without,
)
from midspan.recording.cameras.tracked import Seen, Side
from midspan.recording.cameras.wander import wander_event, wandering_std, without_wandering, zero_errors
from midspan.recording.fusing.fuse import CourseError
from midspan.recording.streams.span import EPOCH_FROM_NS
from midspan.records import (
    NANOSECONDS,
    Displacement,
    Estimate,
    Event,
    Floats,
    Nanoseconds,
    Source,
    joined,
    part,
)
from midspan.signals.health import Mask

# Both cameras see at the same time where their frames are no further apart than so many usual intervals.
TOGETHER_INTERVALS, LEAST_TOGETHER_S = 2.0, 0.5
# Only their rows are marked by what was believed; radar and displacement sensors count beside either.
CAMERAS = (Source.CAMERA, Source.INFRARED)


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Two cameras as one block of measurements, and who was believed.

    switched_ns, believed (k,): from each instant on this source, the first from the beginning on. course: the second
    camera's zero beside the first's, None where both never saw together. levels: what is uncertain of both zeros.
    """

    measured: Displacement
    switched_ns: Nanoseconds
    believed: NDArray[np.uint8]
    course: ZeroCourse | None
    levels: tuple[CourseError, ...] = ()
    events: tuple[Event, ...] = ()
    warnings: tuple[str, ...] = ()

    def at(self, time_ns: Nanoseconds) -> NDArray[np.uint8]:
        """The source believed at stamps (n,)."""
        place = np.searchsorted(self.switched_ns, time_ns, side="right") - 1
        return self.believed[np.maximum(place, 0)]

    def marked(self, time_ns: Nanoseconds, source: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The sources (n,) of rows, those of the cameras as believed."""
        ours = np.isin(source, [int(camera) for camera in CAMERAS])
        return np.where(ours, self.at(time_ns), source)


@dataclass(frozen=True, slots=True, eq=False)
class _Zeroed:
    """Both cameras' measurements on one zero, and what was met on the way."""

    measured: tuple[Displacement, Displacement]
    course: ZeroCourse | None
    levels: tuple[CourseError, ...]
    events: tuple[Event, ...]
    warnings: tuple[str, ...]


def believed(side: Side, seen: tuple[Seen, Seen]) -> Belief:
    """Bring the second camera to the zero of the first, and tell which one is believed when.

    By variances both count, each with its own; by matches only the one that is believed, as published. Where they
    contradict each other, the one that the acceleration speaks against is left out.
    """
    zeroed = _zeroed(side, seen)
    both = joined(list(zeroed.measured))
    order = np.argsort(both.time_ns, kind="stable")
    both = part(both, order)
    strength = np.concatenate([one.eye.strength for one in seen])[order]
    switched_ns, sources, events = _switches(side, both, strength, (seen[0].eye.source, seen[1].eye.source))
    events = (*zeroed.events, *events)
    found = Belief(both, switched_ns, sources, zeroed.course, zeroed.levels, events, zeroed.warnings)
    if side.recording.settings.fusion.switching == "matches":
        left_out = found.at(both.time_ns) != both.source
        found = replace(found, measured=replace(both, value_m=np.where(left_out, np.nan, both.value_m)))
    return found


def _zeroed(side: Side, seen: tuple[Seen, Seen]) -> _Zeroed:
    """Both cameras on the zero of the first; the second left out where both never see together."""
    first, second = (one.measured for one in seen)
    names = (seen[0].eye.sensor, seen[1].eye.sensor)
    quiet = tuple(without_wandering(one) for one in seen)
    course, innovations = None, []
    if all(np.isfinite(one.value_m).any() for one in quiet):
        alone = smooth(side.acceleration, quiet[0], side.kalman)
        said = np.hypot(*(wandering_std(one, second.time_ns) for one in seen)) ** 2
        course = zero_course(*_apart(alone.estimate, *quiet), said)
        # A day has millions of rows: the first camera's are let go before the second's come.
        innovations = [alone.innovation]
        del alone
        innovations.append(smooth(side.acceleration, quiet[1], side.kalman).innovation)
    if course is None:
        text = f"{names[1]}: never sees its target while the {names[0]} does, so its zero is unknown; it was left out."
        levels = tuple(one.wandering for one in seen[:1] if one.wandering is not None)
        blind = replace(second, value_m=np.full_like(second.value_m, np.nan))
        return _Zeroed((first, blind), None, levels, (), (text,))
    found = contradictions(course, seen, innovations)
    events = tuple(one.told(names) for one in found if not one.explained)
    wandered = wander_event(course, quiet, names)
    events = events if wandered is None else (*events, wandered)
    course = course_without(course, found)
    levels = (
        *zero_errors(seen, course, ~_near(first, second.time_ns)),
        *bands(found, seen, second.time_ns),
    )
    second = replace(second, value_m=second.value_m - course.at(second.time_ns)[0])
    both = (cleared(found, 0, first), cleared(found, 1, second))
    return _Zeroed(both, course, levels, events, tuple(event.text for event in events))


def _apart(path: Estimate, first: Displacement, second: Displacement) -> tuple[Nanoseconds, Floats, Floats]:
    """Time, second less first displacement (m) and its variance (m²) at the second's frames; NaN where one is blind.

    path: the first one's displacement, smoothed.
    """
    there, spread = at(path, second.time_ns)
    apart = np.where(_near(first, second.time_ns), second.value_m - there, np.nan)
    return second.time_ns, apart, second.variance_m2 + spread


def _near(first: Displacement, time_ns: Nanoseconds) -> Mask:
    """Which stamps (n,) lie near a frame that the first camera saw its target in."""
    seen = first.time_ns[np.isfinite(first.value_m)]
    usual_s = float(np.median(np.diff(first.time_ns))) / NANOSECONDS if len(first.time_ns) > 1 else LEAST_TOGETHER_S
    reach_ns = round(max(TOGETHER_INTERVALS * usual_s, LEAST_TOGETHER_S) * NANOSECONDS)
    place = np.searchsorted(seen, time_ns)
    before = time_ns - seen[np.maximum(place - 1, 0)]
    after = seen[np.minimum(place, len(seen) - 1)] - time_ns
    near: Mask = np.minimum(np.abs(before), np.abs(after)) <= reach_ns
    return near


def _looks(both: Displacement, strength: Floats) -> Iterator[Look]:
    """What each frame of both cameras says, one after another."""
    variance = np.where(np.isfinite(both.value_m), both.variance_m2, np.inf)
    for source, time_ns, spread, matches in zip(both.source, both.time_ns, variance, strength, strict=True):
        yield Look(Source(int(source)), int(time_ns), float(spread), float(matches))


def _switches(
    side: Side, both: Displacement, strength: Floats, sources: tuple[Source, Source]
) -> tuple[Nanoseconds, NDArray[np.uint8], tuple[Event, ...]]:
    """From which instant on which source is believed, and the events that tell it."""
    fusion = side.recording.settings.fusion
    switch = Switch(sources, PUBLISHED if fusion.switching == "matches" else SwitchSettings())
    sun = _sun(side, both.time_ns)
    stamps, codes, events = [int(both.time_ns[0])], [int(sources[0])], []
    for k, look in enumerate(_looks(both, strength)):
        events += switch.push(look, None if sun is None else float(sun[k]))
        if int(switch.believed) != codes[-1]:
            stamps.append(look.time_ns)
            codes.append(int(switch.believed))
    return np.array(stamps, dtype=np.int64), np.array(codes, dtype=np.uint8), tuple(events)


def _sun(side: Side, time_ns: Nanoseconds) -> Floats | None:
    """The sun's elevation (n,) in degrees; None where place or date is not known."""
    site = side.recording.settings.site
    if site is None or time_ns[0] < EPOCH_FROM_NS:
        return None
    return sun_elevation_deg(time_ns, site.latitude_deg, site.longitude_deg)
