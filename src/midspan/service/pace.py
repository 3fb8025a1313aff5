"""How fast and how late the newest records of a stream come, and how fast its clock drifts. No clock is in here."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from midspan.records import NANOSECONDS

# Rate and delay are those of about the last ten seconds: ten marks, a second apart by the stamps.
MARKS, MARK_NS = 10, NANOSECONDS
# Stamps further apart than those ten seconds are a gap, unless the two before were a third as far apart or further:
# then records come so seldom.
GAP_INTERVALS = 3
# A sensor that brings nothing for so long, and for this many of its usual intervals, is silent; a point without rows.
FRESH_S, FRESH_INTERVALS = 5.0, 3.0
# The usual interval is averaged over about this many arrivals; the first one counts as no more than this, s: it may be
# an outage's.
AVERAGED, MAX_FIRST_S = 8, 60.0


@dataclass(frozen=True, slots=True)
class Mark:
    """After a record: its newest stamp, how many values and records had come by then, and the sum of their delays."""

    newest_ns: int
    values: int
    records: int
    delays_s: float


@dataclass(slots=True)
class Pace:
    """Of the records of a stream, each of one or more values (a frame is one)."""

    _marks: deque[Mark] = field(default_factory=lambda: deque(maxlen=MARKS + 1))
    _newest: Mark | None = None
    # Between the two newest stamps.
    _interval_ns: int = 0

    def came(self, newest_ns: int, values: int, now_ns: int) -> None:
        """A record came; newest_ns: stamp of its newest value."""
        before, delay_s = self._newest or Mark(newest_ns, 0, 0, 0.0), (now_ns - newest_ns) / NANOSECONDS
        interval_ns, gap_ns = newest_ns - before.newest_ns, MARKS * MARK_NS
        is_gap = not -gap_ns <= interval_ns <= max(gap_ns, GAP_INTERVALS * self._interval_ns)
        self._interval_ns = interval_ns
        if is_gap:
            # After a gap, or where a clock was set: what was before tells nothing of now.
            self._marks.clear()
        delays_s = before.delays_s + delay_s
        self._newest = Mark(max(newest_ns, before.newest_ns), before.values + values, before.records + 1, delays_s)
        if not self._marks:
            self._newest = Mark(newest_ns, before.values + values, before.records + 1, delays_s)
            # The first record has come after its own delay alone.
            self._marks.append(Mark(newest_ns, self._newest.values, before.records, before.delays_s))
        elif newest_ns - self._marks[-1].newest_ns >= MARK_NS:
            self._marks.append(self._newest)

    @property
    def rate_hz(self) -> float | None:
        """Values a second, by the stamps; None before there are two records."""
        if self._newest is None or (length_ns := self._newest.newest_ns - self._marks[0].newest_ns) <= 0:
            return None
        return (self._newest.values - self._marks[0].values) * NANOSECONDS / length_ns

    @property
    def delay_s(self) -> float | None:
        """How much later than its newest stamp a record came, in the mean, s; None before the first."""
        if self._newest is None:
            return None
        first = self._marks[0]
        count = self._newest.records - first.records
        return (self._newest.delays_s - first.delays_s) / count if count else None


# A clock's offset is looked at once a minute, and its drift is that over the last hour. The motion tells an offset to
# a millisecond or so: over ten minutes, two millionths.
LOOK_NS, LOOKS, MIN_NS = 60 * NANOSECONDS, 61, 600 * NANOSECONDS


@dataclass(slots=True)
class ClockDrift:
    """How fast a clock's offset changes, by what the engine estimates of it."""

    _looks: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=LOOKS))
    _point: object = None
    _set_ns: int = 0

    def look(self, now_ns: int, offset_s: float | None, point: object = None, set_ns: int = 0) -> None:
        """The offset as estimated now, None where it is not; point: what estimates it; set_ns: by how much the clock
        was found to have been set. Another opening, or a clock that was set since, begins anew: neither is drift.
        """
        if point is not self._point or set_ns != self._set_ns or offset_s is None:
            self._looks.clear()
            self._point, self._set_ns = point, set_ns
        if offset_s is None:
            return
        if not self._looks or not 0 <= now_ns - self._looks[-1][0] < LOOK_NS:
            self._looks.append((now_ns, offset_s))

    @property
    def ppm(self) -> float | None:
        """The slope of a line through the offsets, millionths; None before ten minutes are over."""
        if not self._looks or self._looks[-1][0] - self._looks[0][0] < MIN_NS:
            return None
        time_s = np.array([(at_ns - self._looks[0][0]) / NANOSECONDS for at_ns, _ in self._looks])
        return 1e6 * float(np.polyfit(time_s, [offset_s for _, offset_s in self._looks], 1)[0])
