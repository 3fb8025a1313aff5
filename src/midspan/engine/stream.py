"""One stream of a `Merge`: its memory, what is wrong with its stamps, and how a clock that was set for good shows."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from midspan.checks import TIME_S
from midspan.records import NANOSECONDS, ClockOffset, Nanoseconds

# What is wrong with a stamp.
GOOD, DOUBLED, BACKWARDS, IMPOSSIBLE, AHEAD, LATE = range(6)
# The word of the event for each.
KINDS = ("", "doubled", "backwards", "stamp", "ahead", "late")
# Events after which the stamps of a stream may be those of another clock.
CLOCK_SET = "clock"
STEPS = (KINDS[BACKWARDS], CLOCK_SET)
# Stamps that far from the clock's zero are no times: the difference of two of them would not fit into 64 bits.
FIRST_NS, LAST_NS = (round(end * NANOSECONDS) for end in (TIME_S.low, TIME_S.high))
Codes = NDArray[np.uint8]
# Stamps that go on elsewhere for so long (s) are those of a clock that was set; until then they are left out. Packets
# that overtake each other are below a second apart.
SETTLED_S = 2.0
# And they go on as fast as ticks do, to this factor: what was held up on its way and is sent once more comes at once.
SAME_RATE = 2
# This many readings say what the interval between two of them is.
MIN_READINGS = 3


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """Readings in a row with the same fault whose stamps increase among themselves.

    code: their fault; first_ns, last_ns: stamps on the common clock; count; since_ns: the tick at the first one.
    """

    code: int
    first_ns: int
    last_ns: int
    count: int
    since_ns: int

    def is_settled(self, now_ns: int) -> bool:
        """Whether they are those of a clock that was set."""
        lasts_ns, ticked_ns = self.last_ns - self.first_ns, now_ns - self.since_ns
        alike = ticked_ns <= SAME_RATE * lasts_ns and lasts_ns <= SAME_RATE * ticked_ns
        return alike and ticked_ns >= SETTLED_S * NANOSECONDS and self.count >= MIN_READINGS

    def step_ns(self, newest_ns: int, released_ns: int) -> int:
        """What is added from here on, so that the first reading follows the newest good one at the usual interval.

        After a pause, in which the others went on, they follow what was given out.
        """
        lasts_ns = self.last_ns - self.first_ns
        expected_ns = newest_ns + lasts_ns // (self.count - 1) + lasts_ns
        return max(expected_ns, released_ns + 1) - self.last_ns


def gone_on(known: Elsewhere | None, code: int, time_ns: Sequence[int], now_ns: int) -> tuple[Elsewhere | None, int]:
    """After further stamps with a fault, and how many of them it took until they were settled, or all."""
    for number, stamp in enumerate(time_ns):
        if known is None or code != known.code or stamp <= known.last_ns:
            known = Elsewhere(code, stamp, stamp, 1, now_ns)
            continue
        known = replace(known, last_ns=stamp, count=known.count + 1)
        if known.is_settled(now_ns):
            return known, number + 1
    return known, len(time_ns)


@dataclass(slots=True)
class StreamMemory:
    """What is known of a stream; a state holds a copy.

    newest_ns, late_ns: its newest stamp, and the newest one that came too late, on the common clock; heard_ns: the tick
    at its newest good record; pause_ns: for how long nobody listened since then; offsets: still to come, in the order
    of their stamps; out: silent for too long; fault: code of what is wrong with its newest record; elsewhere: its
    newest records, where their stamps go on elsewhere; used, late, disordered, lost: counts.
    """

    name: str
    newest_ns: int | None = None
    heard_ns: int | None = None
    pause_ns: int = 0
    sequence: int | None = None
    offset_ns: int = 0
    offsets: tuple[ClockOffset, ...] = ()
    out: bool = False
    fault: int = GOOD
    elsewhere: Elsewhere | None = None
    late_ns: int | None = None
    used: int = 0
    late: int = 0
    disordered: int = 0
    lost: int = 0


def take_offset(own_ns: Sequence[int] | Nanoseconds, stream: StreamMemory) -> int:
    """Let the offset hold that belongs to the first of the stamps (n,) on a stream's own clock; returns for how many of
    them it holds. An offset holds from its stamp on, and for good.
    """
    while stream.offsets and stream.offsets[0].from_ns <= own_ns[0] <= LAST_NS:
        stream.offset_ns, stream.offsets = stream.offsets[0].offset_ns, stream.offsets[1:]
    if not stream.offsets:
        return len(own_ns)
    later = np.asarray(own_ns)
    begins = np.flatnonzero((later >= stream.offsets[0].from_ns) & (later <= LAST_NS))
    return int(begins[0]) if len(begins) else len(own_ns)


def order(time_ns: Nanoseconds, newest_ns: int | None, bound_ns: int = LAST_NS) -> tuple[Codes, Nanoseconds]:
    """What is wrong with each stamp (n,), and the newest good one before it (n,).

    newest_ns: the newest good stamp before the block; None: there is none. Stamps above `bound_ns` are AHEAD.
    """
    codes = np.zeros(len(time_ns), dtype=np.uint8)
    before = FIRST_NS - 1 if newest_ns is None else newest_ns
    codes[time_ns > bound_ns] = AHEAD
    codes[(time_ns < FIRST_NS) | (time_ns > LAST_NS)] = IMPOSSIBLE
    reached = np.where(codes == GOOD, time_ns, before)
    newest = np.maximum.accumulate(np.concatenate(([before], reached)))[:-1]
    codes[(codes == GOOD) & (time_ns < newest)] = BACKWARDS
    codes[(codes == GOOD) & (time_ns == newest)] = DOUBLED
    return codes, newest


def spans(codes: Codes) -> Iterator[tuple[int, int, int]]:
    """Start, end (exclusive) and code of each run of equal codes (n,)."""
    for start, end in pairwise([0, *(np.flatnonzero(np.diff(codes)) + 1), len(codes)]):
        yield int(start), int(end), int(codes[start])
