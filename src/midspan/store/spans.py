"""When a stream's rows were made with which calibration, by the index of its blocks and the heads of few of them."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

from midspan.store.chunk import BODY, HEAD, MAGIC
from midspan.store.days import DAY_NS, REACH_NS, Day
from midspan.store.group_rows import MAGIC as GROUP_MAGIC
from midspan.store.pieces import Piece

# The layout of rows takes some 300 bytes before the head of the body.
HEAD_BYTES = 4096


@dataclass(frozen=True, slots=True)
class CalibratedSpan:
    """Rows from first_ns to last_ns that were made with a calibration. Gaps that are shorter than what a block may
    last (11 min) are not seen.
    """

    calibration: int
    first_ns: int
    last_ns: int


def spans_of(days: Iterable[Day], pieces: Sequence[Piece], point: str, stream: str) -> list[CalibratedSpan]:
    """The spans of a stream of a point, in the order of time; pieces: its rows that are no blocks yet. Blocks that are
    removed meanwhile, as they are too old, have none.
    """
    place = (point, stream)
    blocks = sorted(((t0_ns, day) for day in days for t0_ns in day.begins(*place)), key=lambda one: one[0])
    begin_ns = np.array([t0_ns for t0_ns, _ in blocks], dtype=np.int64)
    found = [
        CalibratedSpan(number, int(begin_ns[first]), last_ns)
        for first, last, number in _runs(begin_ns, lambda k: _calibration(blocks[k][1], place, int(begin_ns[k])))
        if number is not None and (last_ns := blocks[last][1].end_ns(*place, int(begin_ns[last]))) is not None
    ]
    late = [CalibratedSpan(_calibration_in(one.body, one), one.t0_ns, one.t1_ns) for one in pieces]
    return _merged([*found, *late])


def _runs(begin_ns: np.ndarray, calibration: Callable[[int], int | None]) -> list[tuple[int, int, int | None]]:
    """First and last block (their numbers) and calibration of each run without a gap.

    calibration: of a block. Only the first of each day and those at gaps are looked at, and between two with different
    ones as many as it takes to find where it changed.
    """
    count, known = len(begin_ns), cache(calibration)
    if not count:
        return []
    gaps = 1 + np.flatnonzero(np.diff(begin_ns) > REACH_NS)
    new_days = 1 + np.flatnonzero(np.diff(begin_ns // DAY_NS))
    looked = sorted({0, count - 1, *gaps.tolist(), *(gaps - 1).tolist(), *new_days.tolist()})
    starts = {0, *gaps.tolist()}
    for low, high in pairwise(looked):
        if known(low) != known(high):
            starts.add(_change(known, low, high))
    firsts = sorted(starts)
    return [(first, end - 1, known(first)) for first, end in zip(firsts, [*firsts[1:], count], strict=True)]


def _change(calibration: Callable[[int], int | None], low: int, high: int) -> int:
    """The first block after `low` that has another calibration, where that of `high` is another one."""
    before = calibration(low)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if calibration(middle) == before else (low, middle)
    return high


def _merged(spans: Sequence[CalibratedSpan]) -> list[CalibratedSpan]:
    found: list[CalibratedSpan] = []
    for one in spans:
        last = found[-1] if found else None
        if last is not None and last.calibration == one.calibration and one.first_ns - last.last_ns <= REACH_NS:
            found[-1] = replace(last, last_ns=max(last.last_ns, one.last_ns))
        else:
            found.append(one)
    return found


def _calibration(day: Day, place: tuple[str, str], t0_ns: int) -> int | None:
    if (kept := day.head(*place, t0_ns, HEAD_BYTES)) is None:
        return None
    number, head = kept
    # Rows of a point of a group, and those of schema 1, do not say it.
    return number if not head.startswith(MAGIC) else _in_body(head)


def _calibration_in(body: bytes, piece: Piece) -> int:
    if body.startswith(GROUP_MAGIC):
        return 0
    return _in_body(body) if piece.layout is None else int(BODY.unpack_from(body)[3])


def _in_body(data: bytes) -> int:
    """The calibration of a chunk as `encode` writes it, by its beginning."""
    _, length = HEAD.unpack_from(data, len(MAGIC))
    return int(BODY.unpack_from(data, len(MAGIC) + HEAD.size + length)[3])
