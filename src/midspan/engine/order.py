"""Which stamps of a stream follow each other: increasing, and possible at all."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from midspan.checks import TIME_S
from midspan.records import NANOSECONDS, Nanoseconds

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


def order(time_ns: Nanoseconds, newest_ns: int | None, bound_ns: int = LAST_NS) -> tuple[Codes, Nanoseconds]:
    """What is wrong with each stamp (n,), and the newest good one before it (n,).

    newest_ns: the newest good stamp before the block; None: there is none. Stamps above `bound_ns` are AHEAD.
    """
    codes = np.zeros(len(time_ns), dtype=np.uint8)
    before = FIRST_NS - 1 if newest_ns is None else newest_ns
    if (
        len(time_ns)
        and before < time_ns[0]
        and time_ns[-1] <= min(bound_ns, LAST_NS)
        and (time_ns[1:] > time_ns[:-1]).all()
    ):
        return codes, np.concatenate(([before], time_ns[:-1]))
    codes[time_ns > bound_ns] = AHEAD
    codes[(time_ns < FIRST_NS) | (time_ns > LAST_NS)] = IMPOSSIBLE
    reached = np.where(codes == GOOD, time_ns, before)
    newest = np.maximum.accumulate(np.concatenate(([before], reached)))[:-1]
    codes[(codes == GOOD) & (time_ns < newest)] = BACKWARDS
    codes[(codes == GOOD) & (time_ns == newest)] = DOUBLED
    return codes, newest


def order_of(time_ns: int, newest_ns: int | None, bound_ns: int = LAST_NS) -> int:
    """The same for a single stamp: what is wrong with it."""
    if not FIRST_NS <= time_ns <= LAST_NS:
        return IMPOSSIBLE
    if time_ns > bound_ns:
        return AHEAD
    if newest_ns is None or time_ns > newest_ns:
        return GOOD
    return DOUBLED if time_ns == newest_ns else BACKWARDS


def spans(codes: Codes) -> Iterator[tuple[int, int, int]]:
    """Start, end (exclusive) and code of each run of equal codes (n,)."""
    if not len(codes):
        return
    if not codes.any():
        yield 0, len(codes), GOOD
        return
    edges = [0, *(np.flatnonzero(np.diff(codes)) + 1), len(codes)]
    for start, end in pairwise(edges):
        yield int(start), int(end), int(codes[start])


def is_new(code: int, fault: int) -> bool:
    """Whether a stamp's `code` is a fault other than that of the stamp before it (`fault`).

    Of a clock that ran back, the stamp that reaches the newest one again is no fault of its own.
    """
    return code not in (GOOD, fault) and (fault, code) != (BACKWARDS, DOUBLED)


def words(code: int, time_ns: int, newest_ns: int) -> str:
    """What is wrong with the stamp of a record after the newest good one, for a message."""
    if code == DOUBLED:
        return "a stamp came twice; the second record is left out."
    if code == IMPOSSIBLE:
        return f"a stamp of {time_ns} ns is no time; the record is left out."
    back_s = (newest_ns - time_ns) / NANOSECONDS
    until = "until it is newer than all before or shows that the clock was set"
    return f"time runs backwards by {back_s:.3g} s; each record is left out {until}."
