"""Which of two cameras is believed: the one that knows more, or the one with more matches, without going to and fro.

J. Choi, Z. Ma, K. Kim, H. Sohn, "Continuous Structural Displacement Monitoring Using Accelerometer, Vision, and
Infrared (IR) Cameras", Sensors 23 (2023) 5241, doi 10.3390/s23115241, section 2.2.2: the camera with the larger mean
number of matches is used. Numbers of matches of two cameras cannot be compared (their pictures, scale factors and noise
differ); variances in m² can.
"""

import math
from collections import deque
from dataclasses import dataclass, field

from midspan.checks import option, positive, refuse
from midspan.records import NANOSECONDS, Event, Source

RULES = ("variance", "matches")
# Above this elevation of the sun a camera of light sees as well as it ever does, below the other it is night.
DAY_DEG, NIGHT_DEG = 0.0, -6.0


@dataclass(frozen=True, slots=True)
class SwitchSettings:
    """When another camera is believed.

    rule: "variance" compares what both know in the last `average_s` seconds, in 1/m²; "matches" the mean numbers of
    matches, as published. factor: so many times the other one's must be larger, 1 or more; more switches later.
    hold_s: for so long, in which both see. silent_s: a camera that has shown nothing for so long is lost.
    """

    rule: str = "variance"
    average_s: float = 5.0
    factor: float = 2.0
    hold_s: float = 2.0
    silent_s: float = 2.0

    def __post_init__(self) -> None:
        option("rule", self.rule, RULES)
        if not 1.0 <= self.factor < math.inf:
            raise refuse("factor", "1 or more", self.factor)
        if not 0.0 <= self.hold_s < math.inf:
            raise refuse("hold_s", "0 s or more", self.hold_s)
        positive("average_s", self.average_s, "s")
        positive("silent_s", self.silent_s, "s")


PUBLISHED = SwitchSettings(rule="matches", average_s=2.0, factor=1.0, hold_s=0.0)


@dataclass(frozen=True, slots=True)
class Look:
    """What one camera says of a frame: its source, the variance (m²) of its displacement, infinite or NaN where the
    target is lost, and its matches (of trackers without matches the quality in percent).
    """

    source: Source
    time_ns: int
    variance_m2: float
    strength: float = 0.0

    @property
    def seen(self) -> bool:
        """Whether the frame shows the target."""
        return math.isfinite(self.variance_m2) and self.variance_m2 > 0.0


@dataclass(slots=True)
class _Known:
    """The last looks of one camera: times (ns) with 1/m² and matches."""

    rows: deque[tuple[int, float, float]] = field(default_factory=deque)
    seen_ns: int | None = None


class Switch:
    """Takes looks of two cameras in the order of their times and tells which one is believed."""

    def __init__(self, sources: tuple[Source, Source], settings: SwitchSettings | None = None) -> None:
        """`sources`: the first one is believed to begin with."""
        self.settings = settings or SwitchSettings()
        self._known = {source: _Known() for source in sources}
        self.believed = sources[0]
        self._better_ns: int | None = None
        self._first_ns: int | None = None
        self._begun = False

    def push(self, look: Look, sun_deg: float | None = None) -> list[Event]:
        """Take a look; a switch is told as an event. sun_deg: the sun's elevation, which decides between equals."""
        known = self._known[look.source]
        self._first_ns = look.time_ns if self._first_ns is None else self._first_ns
        known.rows.append(
            (look.time_ns, 1.0 / look.variance_m2 if look.seen else 0.0, look.strength if look.seen else 0)
        )
        if look.seen:
            known.seen_ns = look.time_ns
        for each in self._known.values():
            while each.rows and each.rows[0][0] < look.time_ns - self.settings.average_s * NANOSECONDS:
                each.rows.popleft()
        return self._judged(look.time_ns, sun_deg)

    def score(self, source: Source) -> float:
        """What a camera is judged by: 1/m² in a second of the last frames, or the mean number of matches."""
        rows = self._known[source].rows
        if self.settings.rule == "variance":
            return sum(row[1] for row in rows) / self.settings.average_s
        return sum(row[2] for row in rows) / max(len(rows), 1)

    def _judged(self, now_ns: int, sun_deg: float | None) -> list[Event]:
        """Switch where the other one has been better for long enough, or this one is lost and the other is not."""
        settings, other = self.settings, self._other
        own, theirs = self.score(self.believed), self.score(other)
        if self._silent(self.believed, now_ns) and not self._silent(other, now_ns):
            return self._switched(now_ns, "the first that sees" if not self._begun else "it no longer sees the target")
        self._begun = self._begun or own > 0.0
        # What it knew seconds ago still counts in its mean, but it has gone blind since.
        if self._silent(other, now_ns) or not (theirs > 0.0 and theirs > self._threshold(sun_deg) * own):
            self._better_ns = None
            return []
        self._better_ns = now_ns if self._better_ns is None else self._better_ns
        if now_ns - self._better_ns < settings.hold_s * NANOSECONDS:
            return []
        if settings.rule == "matches":
            return self._switched(now_ns, f"{theirs:.3g} matches beside {own:.3g}")
        return self._switched(now_ns, f"{_std_mm(theirs):.2g} mm in a second beside {_std_mm(own):.2g} mm")

    @property
    def _other(self) -> Source:
        return next(source for source in self._known if source is not self.believed)

    def _threshold(self, sun_deg: float | None) -> float:
        """So many times better the other one must be; less where the sun speaks for it."""
        factor = self.settings.factor
        if sun_deg is None or NIGHT_DEG <= sun_deg <= DAY_DEG:
            return factor
        fitting = Source.CAMERA if sun_deg > DAY_DEG else Source.INFRARED
        return 1.0 / factor if fitting is self._other else factor

    def _silent(self, source: Source, now_ns: int) -> bool:
        since_ns = self._known[source].seen_ns
        since_ns = self._first_ns if since_ns is None else since_ns
        return since_ns is not None and now_ns - since_ns > self.settings.silent_s * NANOSECONDS

    def _switched(self, now_ns: int, why: str) -> list[Event]:
        before, self.believed, self._better_ns = self.believed, self._other, None
        told = self._begun
        self._begun = True
        return [Event(now_ns, "switch", f"{before.word} → {self.believed.word}: {why}")] if told else []


def _std_mm(information: float) -> float:
    """Standard deviation in mm that a second of frames gives."""
    return 1e3 / math.sqrt(information) if information > 0.0 else math.inf
