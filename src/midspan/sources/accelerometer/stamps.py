"""Time stamps of rows that a logger rounded, or delivered twice: what is no fault of the order is put right.

A batch that was delivered again stands in the file as rows that equal earlier ones, all of them; they are dropped.
Equal stamps of neighbours with other values are one instant rounded to what the logger writes (1 ms, 10 ms, 1 s): they
are put on the even clock that fits all stamps within the rounding, else spread within it.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from midspan.records import Floats, Nanoseconds
from midspan.signals.health import Mask, runs
from midspan.sources.accelerometer.channel import Values

# Rounding to less than this share of the usual step does not make neighbours equal: such a clock is wrong.
MIN_ROUNDING_SHARE = 0.01
# A busy system stamps samples late: this many steps come within one rounded instant; more is a clock that hangs.
MAX_LATE_STEPS = 2.0
# An even clock fits where no stamp is farther from it than the rounding, and by this share for the fit's own error:
# stamps of an even clock are rounded evenly, so that it is a few n-ths of the rounding with n rows. Fewer rows do not
# show what stamps are rounded to.
FIT_SLACK, MIN_EVEN_ROWS = 0.05, 64
# Rows that are fitted at once: the fit errs by less than a hundredth of the rounding, and each try takes 2 ms.
MAX_EVEN_ROWS = 16384
# A step longer than this many usual ones, and the rounding, is a gap.
GAP_STEPS = 1.5
# Equal values by chance: a count that exceeds what is expected by this many standard deviations is none.
CHANCE_SIGMAS = 3.0


def repeated_rows(time_ns: Nanoseconds, columns: Sequence[Values]) -> Mask:
    """Which rows (n,) repeat an earlier one exactly, as a batch that was delivered again or a row written twice.

    columns: the values (n,) of each row. Nothing is repeated where time runs backwards in another way.
    """
    batches = _batches(time_ns, columns)
    kept = np.flatnonzero(~batches)
    same_time = time_ns[kept][1:] == time_ns[kept][:-1]
    if same_time.any():
        same = _same([column[kept][1:] for column in columns], [column[kept][:-1] for column in columns])
        twice = same & same_time
        pairs, chance = int(same_time.sum()), float(same[~same_time].mean()) if (~same_time).any() else 0.0
        by_chance = pairs * chance + CHANCE_SIGMAS * float(np.sqrt(pairs * chance * (1.0 - chance)))
        # Rounded stamps of a coarse sensor: some neighbours hold the same value as they do everywhere else.
        if int(twice.sum()) == pairs or int(twice.sum()) > by_chance:
            batches[kept[1:][twice]] = True
    return batches


def _same(left: Sequence[Values], right: Sequence[Values]) -> Mask:
    """Which rows (n,) of two series are equal in all columns; what is no number equals what is none."""
    equal = np.ones(len(left[0]), dtype=bool)
    for one, other in zip(left, right, strict=True):
        equal &= (one == other) | ((one != one) & (other != other))
    return equal


def _batches(time_ns: Nanoseconds, columns: Sequence[Values]) -> Mask:
    """The rows (n,) of batches that were delivered again."""
    count = len(time_ns)
    nothing = np.zeros(count, dtype=bool)
    back = np.flatnonzero(time_ns[1:] < time_ns[:-1]) + 1
    repeated = nothing.copy()
    kept, kept_ns = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    size = 0
    for begin, end in zip([0, *back], [*back, count], strict=True):
        rows = np.arange(begin, end)
        if size and time_ns[begin] < kept_ns[size - 1]:
            first, last = (int(np.searchsorted(kept_ns[:size], time_ns[begin], side)) for side in ("left", "right"))
            alike = [_alike([time_ns, *columns], rows, kept[k:size]) for k in range(first, last)]
            rows = rows[max(alike, default=0) :]
            if len(rows) == end - begin or (len(rows) and time_ns[rows[0]] < kept_ns[size - 1]):
                return nothing
            repeated[begin : end - len(rows)] = True
        kept[size : size + len(rows)], kept_ns[size : size + len(rows)] = rows, time_ns[rows]
        size += len(rows)
    return repeated


def _alike(columns: Sequence[Values], rows: Nanoseconds, others: Nanoseconds) -> int:
    """How many rows from the first on equal as many others."""
    count = min(len(rows), len(others))
    same = _same([column[rows[:count]] for column in columns], [column[others[:count]] for column in columns])
    return count if same.all() else int(np.argmin(same))


def spread_equal_stamps(time_ns: Nanoseconds) -> tuple[Nanoseconds, str]:
    """Stamps (n,) with equal neighbours spread within the rounding that made them equal, and what was done in words.

    They stay as they are, too, where rounding does not explain them: a clock that hangs or runs backwards.
    """
    steps = np.diff(time_ns)
    equal = steps == 0
    if not equal.any() or len(time_ns) < MIN_EVEN_ROWS or (steps < 0).any() or equal.all():
        return time_ns, ""
    rounding = float(np.gcd.reduce(steps))
    step = float(np.mean(steps))
    step = float(np.mean(steps[steps <= GAP_STEPS * step + rounding]))
    groups = runs(np.concatenate((equal, [False])))
    longest = int((groups[:, 1] - groups[:, 0]).max())
    if rounding < MIN_ROUNDING_SHARE * step or longest * step > rounding + MAX_LATE_STEPS * step:
        return time_ns, ""
    spread = _within_rounding(time_ns, groups, step, rounding)
    even, placed = _on_even_clocks(time_ns, steps, step, rounding)
    found = np.where(placed, even, spread)
    if (np.diff(found) <= 0).any():
        found, placed = spread, np.zeros(len(placed), dtype=bool)
    if (np.diff(found) <= 0).any():
        return time_ns, ""
    share = "all" if placed.all() else f"{100 * placed.mean():.0f} % of"
    how = f"; {share} rows fit evenly spaced times" if placed.any() else ""
    text = (
        f"{int(equal.sum())} of {len(time_ns)} time stamps equal the one before, rounded to {1e-6 * rounding:g} ms; "
        f"they were spread within the rounding{how}"
    )
    return found, text


def _within_rounding(time_ns: Nanoseconds, groups: Nanoseconds, step: float, rounding: float) -> Nanoseconds:
    """Stamps (n,) with the rows of each group (begin, end: the last row) spread evenly about their common instant."""
    # A record begins and ends within a group: what is there of it lies at the usual step next to the others.
    found = time_ns.copy()
    for begin, end in groups:
        count = int(end - begin) + 1
        places = np.asarray(rounding * ((np.arange(count) + 0.5) / count - 0.5))
        cut = 0.5 * max(rounding - count * step, 0.0) * (int(begin == 0) - int(end == len(time_ns) - 1))
        if cut:
            places = np.asarray(step * (np.arange(count) - 0.5 * (count - 1)) + cut)
        found[begin : end + 1] += np.rint(places).astype(np.int64)
    return found


def _on_even_clocks(time_ns: Nanoseconds, steps: Nanoseconds, step: float, rounding: float) -> tuple[Nanoseconds, Mask]:
    """Stamps (n,) of the even clocks that fit within the rounding, one between gaps, and which rows lie on one."""
    found, placed = time_ns.copy(), np.zeros(len(time_ns), dtype=bool)
    edges = [0, *(np.flatnonzero(steps > GAP_STEPS * step + rounding) + 1).tolist(), len(time_ns)]
    parts = [
        (k, min(k + MAX_EVEN_ROWS, end)) for begin, end in pairwise(edges) for k in range(begin, end, MAX_EVEN_ROWS)
    ]
    bound = (1.0 + FIT_SLACK) * rounding
    while parts:
        begin, end = parts.pop()
        if end - begin < MIN_EVEN_ROWS:
            continue
        line, apart = _line(time_ns[begin:end])
        if np.ptp(apart) <= bound:
            centred = line + 0.5 * (apart.min() + apart.max())
            found[begin:end] = time_ns[begin] + np.rint(centred).astype(np.int64)
            placed[begin:end] = True
            continue
        # A sample that is lost shifts all that follow: what the line misses changes its sign there.
        at = begin + 1 + int(np.argmax(np.abs(np.cumsum(apart))[:-1]))
        parts += [(begin, at), (at, end)]
    return found, placed


def _line(time_ns: Nanoseconds) -> tuple[Floats, Floats]:
    """The even clock that fits stamps (n,) best, in ns from the first one, and what they are apart from it."""
    elapsed_ns = (time_ns - time_ns[0]).astype(np.float64)
    index = np.arange(len(elapsed_ns)) - 0.5 * (len(elapsed_ns) - 1)
    slope = float(index @ elapsed_ns) / float(index @ index)
    line = np.asarray(slope * index + float(elapsed_ns.mean()))
    return line, np.asarray(elapsed_ns - line)
