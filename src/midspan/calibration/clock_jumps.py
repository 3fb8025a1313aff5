"""Jumps of a displacement sensor's clock: it was set, or a frame was lost or doubled where stamps are counted.

Around a place where the measurements begin to contradict the acceleration all clock offsets are tried, and the course
of offsets with the least contradiction, each change at a price, is found by dynamic programming. What is found is then
refined with the stamps moved from a row on, and must explain the measurements better than a clock that drifts.

One jump leaves one half of a camera's calibration window without any: calibrated there, the rest of it shows the jump.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.agreement import compared_by
from midspan.calibration.clock import CLIPPED, NO_INFORMATION, Compared, calm_variance, knots
from midspan.calibration.fit import MIN_FRAMES, Fit, Pair, best_corner, refine
from midspan.calibration.time_offset import OffsetSearch, search_offset
from midspan.errors import UntrustedError
from midspan.notices import Notice
from midspan.records import Floats
from midspan.signals.medians import SIGMA_OF_MEDIAN

# Jumps up to this many s are looked for, in steps of this many s at first; smaller ones than this are left alone.
LARGEST_S, STEP_S, MIN_S = 1.05, 0.01, 2e-3
# Steps of the offsets, s, by which a jump is refined.
FINER_S = (5e-3, 1.5e-3, 4e-4, 1e-4)
# Around a suspicious place this many s either way are compared, of a slow sensor this many measurements.
REACH_S, REACH_ROWS = 30.0, 40
# A window of this many s, or measurements, whose offset leaves the one before by this many deviations is suspicious; so
# is one whose clipped squared innovations are on average beyond the last value.
WINDOW_S, WINDOW_ROWS, SUSPICIOUS, CONTRADICTING = 8.0, 12, 5.0, 3.0
# Without values for this long, s, and for this many of their intervals, a clock may have been set unseen: whatever the
# windows say, such an outage is suspicious. As of the bank of clocks in `core/src/estimator`.
OUTAGE_S, OUTAGE_ROWS = 1.0, 3
# The offsets of both halves are sought so near that of the whole, s: a larger step shows in its outliers.
HALVES_S = 0.1
# One measurement contradicts by this many squared deviations at most: it may be an outlier.
MAX_SQUARE = 25.0
# Price of a jump; what it must gain over none and over a clock that drifts; what its rival may come near to.
PRICE, MIN_GAIN, MIN_NEXT_TO, RIVAL = 30.0, 30.0, 15.0, 10.0
# Changes within this many s may be one: the filter that all offsets are tried with takes its time after a jump.
SETTLED_S = 3.0
# How well a straight line is tried, and a rival; a rival is so far away, s.
LINE_STEP_S, RIVAL_STEP_S, APART_S = 4e-4, 2e-3, 0.03
# An instant is possible that is worse than the best by no more than this; of a segment this many instants are tried.
UNSURE, INSTANTS = 8.0, 240
# On either side of a jump at least this many measurements must be, and this share of them explained.
MIN_ROWS, EXPLAINED = 10, 0.8
# A jump counts from this many of its standard deviations on; the search ends after this many places without one.
SIGNIFICANT, MAX_TRIED = 6.0, 12
# A clock that is off before the jump by less than this, s, stays as calibrated there.
MIN_BEFORE_S = 5e-4


@dataclass(frozen=True, slots=True)
class ClockJump:
    """From `row` on `late_s` (± `std_s`) is to be added to the stamps; rows `first` to `last` may be on either clock.

    before_s: what is to be added from the jump before on, or from the beginning. rival_s: another jump that fits about
    as well.
    """

    row: int
    late_s: float
    std_s: float
    first: int
    last: int
    before_s: float = 0.0
    rival_s: float | None = None


def clock_jumps(one: Compared) -> list[ClockJump]:
    """The jumps of a sensor's clock, in the order of time; each one's rows count in what was given.

    A sensor that the motion tells nothing of has none.
    """
    found: list[ClockJump] = []
    begin, tried, late_s = 0, 0, np.zeros(len(one.rows))
    while tried < MAX_TRIED and (place := _suspicious(one, late_s, begin)) is not None:
        jump = _jump_near(one, late_s, place, begin)
        if jump is None:
            begin, tried = place + _rows_in(one, WINDOW_S, WINDOW_ROWS), tried + 1
            continue
        found.append(jump)
        late_s = lateness(found, len(one.rows))
        begin = jump.last + 1
    return found


def outages(time_s: Floats) -> NDArray[np.int64]:
    """The first rows after outages of readings at times (m,)."""
    apart = np.diff(time_s)
    least = max(OUTAGE_S, OUTAGE_ROWS * float(np.median(apart))) if len(apart) else 0.0
    return np.flatnonzero(apart > least) + 1


def lateness(jumps: Sequence[ClockJump], count: int) -> Floats:
    """What is to be added to each of `count` stamps, s."""
    late_s, begin = np.zeros(count), 0
    for jump in jumps:
        late_s[begin:] += jump.before_s
        late_s[jump.row :] += jump.late_s
        begin = jump.row
    return late_s


def _rows_in(one: Compared, seconds: float, least: int) -> int:
    return max(least, round(seconds / float(np.median(np.diff(one.rows[:, 0])))))


def _suspicious(one: Compared, late_s: Floats, begin: int) -> int | None:
    """The first row from `begin` on after an outage, or of a window that contradicts the acceleration or the offset."""
    # The filter needs a way to settle.
    start = max(0, begin - _rows_in(one, REACH_S, 0)) if len(one.rows) > 1 else 0
    if len(one.rows) - max(start, begin) < 2 * MIN_ROWS:
        return None
    part = one.since(start)
    windows = knots(part, late_s[start:], np.arange(0, len(part.rows), _rows_in(part, WINDOW_S, WINDOW_ROWS)))
    after = outages(one.rows[:, 0])
    outage = next((int(row) for row in after if row > begin), None)
    reference, known = 0.0, 0.0
    columns = (windows.first, windows.late_s, windows.information, windows.square)
    for first, late, reported, square in zip(*columns, strict=True):
        variance = 1.0 / max(reported, NO_INFORMATION) + (1.0 / known if known else 0.0)
        moved = known > 0.0 and abs(late - reference) > SUSPICIOUS * np.sqrt(variance)
        if outage is not None and start + first >= outage:
            return outage
        if (square > CONTRADICTING or moved) and start + first >= begin:
            return int(start + first)
        # What lies far back says little of a clock that drifts.
        known = 0.5 * known + reported
        reference += (late - reference) * reported / max(known, NO_INFORMATION)
    return outage


@dataclass(frozen=True, slots=True)
class _Guess:
    """A jump at a row of a segment: lateness before it and from it on, s; end: the next one's row, None for none."""

    row: int
    before_s: float
    after_s: float
    end: int | None = None


@dataclass(frozen=True, slots=True)
class _Segment:
    """A segment around a suspicious place, its noise factor, and the rms velocity in m/s."""

    part: Compared
    noise: float
    velocity: float

    @property
    def count(self) -> int:
        return len(self.part.rows)

    def losses(self, late_s: Floats, step_s: float = 0.0) -> Floats:
        """Contradiction of each measurement (m, c) with stamps so much later; step_s: how well that is known."""
        r = self.part.innovations(late_s, self.velocity * step_s)
        return np.asarray(0.5 * np.minimum(r**2 / self.noise, MAX_SQUARE))

    def loss(self, late_s: Floats, step_s: float = 0.0) -> Floats:
        """Contradiction (c,) with stamps so much later, (m, c)."""
        return np.asarray(self.losses(late_s, step_s).sum(axis=0))

    def stamps(self, guesses: Sequence[_Guess]) -> Floats:
        """Lateness (m, c) with jumps."""
        rows = np.arange(self.count)
        return np.column_stack([np.where(rows < one.row, one.before_s, one.after_s) for one in guesses])

    def best(self, guesses: Sequence[_Guess], step_s: float) -> _Guess:
        """The jump that contradicts least."""
        return guesses[int(np.argmin(self.loss(self.stamps(guesses), step_s)))]


def _jump_near(one: Compared, late_s: Floats, place: int, begin: int) -> ClockJump | None:
    reach = _rows_in(one, REACH_S, REACH_ROWS)
    start, end = max(begin, place - reach), min(len(one.rows), place + reach)
    if end - start < 2 * MIN_ROWS:
        return None
    rows = one.rows[start:end]
    # Offsets are sought beyond the lateness before the segment, which the jumps before it have made.
    base = float(late_s[start])
    covered = (one.samples[:, 0] >= rows[0, 0] + base) & (one.samples[:, 0] <= rows[-1, 0] + base)
    if np.count_nonzero(covered) < 2 * MIN_ROWS:
        # The acceleration has a gap here, or its own clock ran away.
        return None
    later = Compared(one.samples, rows + np.array([base, 0.0, 0.0]))
    segment = _segment(later.near(0, len(rows), LARGEST_S + 1.0))
    for guess in _coarse(segment, place - start):
        # What comes after the next jump says nothing of this one.
        own = segment if guess.end is None else _segment(later.near(0, guess.end, LARGEST_S + 1.0))
        jump = _refined(own, guess)
        if jump is not None:
            return replace(jump, row=jump.row + start, first=jump.first + start, last=jump.last + start)
    return None


def _segment(part: Compared) -> _Segment:
    rows = part.rows
    inner = part.samples[(part.samples[:, 0] >= rows[0, 0]) & (part.samples[:, 0] <= rows[-1, 0])]
    # The faster of what either shows: a slow sensor misses fast motion, slow motion hides in the acceleration's bias.
    steps = np.diff(rows[:, 1]) / np.maximum(np.diff(rows[:, 0]), 1e-4)
    time_s = inner[:, 0] - inner[:, 0].mean()
    velocity = part.response.velocity(inner[:, 0])
    velocity = velocity - np.polynomial.Polynomial.fit(time_s, velocity, 3)(time_s)
    spread = max(SIGMA_OF_MEDIAN * float(np.median(np.abs(steps))), float(np.std(velocity)))
    r = part.innovations(np.zeros((len(rows), 1)))[:, 0]
    return _Segment(part, max(calm_variance(r), 1.0), spread)


def _coarse(segment: _Segment, place: int) -> list[_Guess]:
    count = round(LARGEST_S / STEP_S)
    grid = STEP_S * np.arange(-count, count + 1)
    course = grid[_cheapest(segment.losses(np.tile(grid, (segment.count, 1)), STEP_S))]
    changes = np.flatnonzero(np.abs(np.diff(course)) > 1.5 * STEP_S) + 1
    found = [_Guess(int(k), float(course[k - 1]), float(course[k])) for k in changes]
    if len(changes) > 1:
        time_s = segment.part.rows[:, 0]
        close = changes[time_s[changes] <= time_s[changes[0]] + SETTLED_S]
        guess = _Guess(int(close[0]), float(course[close[0] - 1]), float(course[close[-1]]))
        after = changes[len(close) :]
        others = [replace(guess, end=int(after[0]))] if len(after) else []
        found = [guess, *others, *found]
    return [*found[:4], _Guess(place, float(course[0]), float(course[0]))]


def _cheapest(losses: Floats) -> NDArray[np.int64]:
    """The number of the offset at each row (m,) with the least sum of losses (m, offsets), each change at a price."""
    m, offsets = losses.shape
    best, back = losses[0].copy(), np.tile(np.arange(offsets), (m, 1))
    for j in range(1, m):
        least = int(np.argmin(best))
        back[j, best > best[least] + PRICE] = least
        best = np.minimum(best, best[least] + PRICE) + losses[j]
    path = np.empty(m, dtype=np.int64)
    path[-1] = int(np.argmin(best))
    for j in range(m - 1, 0, -1):
        path[j - 1] = back[j, path[j]]
    return path


def _refined(segment: _Segment, guess: _Guess) -> ClockJump | None:
    """A candidate at its best instant and size; None where it does not explain what it must."""
    for step in FINER_S:
        guess = _nearer(segment, guess, step)
    if min(guess.row, segment.count - guess.row) < MIN_ROWS:
        return None
    # Deviations of the lateness before and after, s, from the slopes of the innovations.
    sides = segment.stamps([replace(guess, before_s=1.0, after_s=0.0), replace(guess, before_s=0.0, after_s=1.0)])
    slopes = segment.part.slopes(segment.stamps([guess]), sides)
    information = np.maximum(np.sum(slopes**2, axis=0) / segment.noise, NO_INFORMATION)
    before_std, after_std = (float(one**-0.5) for one in information)
    if abs(guess.before_s) < max(SIGNIFICANT * before_std, MIN_BEFORE_S):
        # As calibrated: the jump is what the stamps after it say.
        guess, before_std = replace(guess, before_s=0.0), 0.0
    late_s, std_s = guess.after_s - guess.before_s, float(np.hypot(before_std, after_std))
    if not abs(late_s) > max(SIGNIFICANT * std_s, MIN_S):
        return None
    # Both sides of the jump must agree with the acceleration then.
    good = segment.part.innovations(segment.stamps([guess]))[:, 0] ** 2 < CLIPPED**2 * segment.noise
    if not min(np.mean(good[: guess.row]), np.mean(good[guess.row :])) >= EXPLAINED:
        return None
    none = [replace(guess, after_s=guess.before_s), replace(guess, before_s=guess.after_s), guess]
    *others, stepped = segment.loss(segment.stamps(none))
    if min(others) - stepped < MIN_GAIN:
        return None
    first, last = _possible(segment, guess)
    # Where a clock may have been set in an outage it was; a drift is then no simpler, and must only be less likely.
    inside = [int(row) for row in outages(segment.part.rows[:, 0]) if first <= row <= last]
    least = 0.0 if inside else MIN_NEXT_TO
    if _drifting(segment, guess) - segment.loss(segment.stamps([guess]), LINE_STEP_S)[0] < least:
        return None
    if inside:
        first = last = inside[0]
        guess = replace(guess, row=first)
    return ClockJump(guess.row, late_s, std_s, first, last, guess.before_s, _rival(segment, guess))


def _nearer(segment: _Segment, guess: _Guess, step: float) -> _Guess:
    guess = segment.best([replace(guess, before_s=guess.before_s + k * step) for k in range(-4, 5)], step)
    guess = segment.best([replace(guess, after_s=guess.after_s + k * step) for k in range(-4, 5)], step)
    stride = max(1, segment.count // 40)
    while guess.after_s != guess.before_s:
        rows = np.unique(np.clip(guess.row + stride * np.arange(-6, 7), 1, segment.count - 1))
        guess = segment.best([replace(guess, row=int(k)) for k in rows], step)
        if stride == 1:
            break
        stride = max(1, stride // 4)
    return guess


def _drifting(segment: _Segment, guess: _Guess) -> float:
    time_s, late_s = segment.part.rows[:, 0], guess.after_s - guess.before_s
    share = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    # A straight line compared with a step: up to three times as steep as the step's height over the segment.
    shift, slope = (side.ravel() for side in np.meshgrid(np.linspace(-1.5, 0.5, 11), np.linspace(0.5, 3.0, 11)))
    return float(segment.loss(guess.before_s + late_s * (shift + share[:, None] * slope), LINE_STEP_S).min())


def _possible(segment: _Segment, guess: _Guess) -> tuple[int, int]:
    stride = -(-segment.count // INSTANTS)
    rows = np.arange(1 + (guess.row - 1) % stride, segment.count, stride)
    losses = segment.loss(segment.stamps([replace(guess, row=int(k)) for k in rows]))
    place = int(np.searchsorted(rows, guess.row))
    bad = np.flatnonzero(losses > losses[place] + UNSURE)
    before, after = bad[bad < place], bad[bad > place]
    first = int(rows[before[-1]]) + 1 if len(before) else 1
    return first, int(rows[after[0]]) - 1 if len(after) else segment.count - 1


def _rival(segment: _Segment, guess: _Guess) -> float | None:
    """Another jump that explains about as much: near a single tone several do."""

    def losses(after_s: Floats, step_s: float) -> Floats:
        return segment.loss(segment.stamps([replace(guess, after_s=float(late)) for late in after_s]), step_s)

    wide = 4.0 * RIVAL_STEP_S
    others = guess.before_s + np.arange(-LARGEST_S, LARGEST_S, wide)
    others = others[np.abs(others - guess.after_s) > APART_S]
    highest = others[np.argsort(losses(others, wide))[:3]]
    near = (highest[:, None] + RIVAL_STEP_S * np.arange(-4, 5)).ravel()
    found = losses(near, RIVAL_STEP_S)
    best = int(np.argmin(found))
    alike = found[best] < losses(np.array([guess.after_s]), RIVAL_STEP_S)[0] + RIVAL
    return float(near[best]) - guess.before_s if alike else None


def lead_of_halves(pair: Pair, fit: Fit) -> float:
    """By how much (logarithm) both halves of a pair are likelier, each by its own fit near that of the whole.

    A clock that steps anywhere leaves one half without a step (G. C. Chow, Econometrica 28, 1960, 591,
    doi 10.2307/1910133); 0 where a half has too few rows.
    """
    halves = [pair.changed(rows=rows) for rows in np.array_split(pair.rows, 2)]
    if min(np.count_nonzero(np.isfinite(half.rows[:, 2])) for half in halves) < MIN_FRAMES:
        return 0.0
    fits = [refine(half, best_corner(half, fit.offset_s, fit.corner), HALVES_S) for half in halves]
    return sum(one.likelihood for one in fits) - fit.likelihood


def without_jumps(
    pair: Pair, max_offset_s: float, refuse: Callable[[OffsetSearch], None]
) -> tuple[Pair, list[ClockJump]]:
    """The pair with its stamps on one clock, and the jumps that were taken out; none where nothing shows any.

    refuse: raises UntrustedError where a search is not to be trusted.
    """
    found = []
    for rows in np.array_split(pair.rows, 2):
        if np.count_nonzero(np.isfinite(rows[:, 2])) >= MIN_FRAMES:
            search = search_offset(pair.changed(rows=rows), max_offset_s)
            with suppress(UntrustedError):
                refuse(search)
                found.append(search)
    if not found:
        return pair, []
    search = max(found, key=lambda one: one.fit.gain)
    rows = pair.rows[pair.used(search.fit.offset_s)]
    jumps = clock_jumps(compared_by(pair, search.fit, rows))
    return pair.changed(rows=_moved(rows, jumps)) if jumps else pair, jumps


def _moved(rows: Floats, jumps: list[ClockJump]) -> Floats:
    """Rows (m, 3) on one clock, without those that may be on either side of a jump, or not after those before."""
    rows, kept, late_s = rows.copy(), np.ones(len(rows), dtype=bool), lateness(jumps, len(rows))
    rows[:, 0] += late_s - late_s[0]
    for jump in jumps:
        kept[jump.first : jump.last] = False
    kept[1:] &= rows[1:, 0] > np.maximum.accumulate(rows[:, 0])[:-1]
    return rows[kept]


def jumps_text(jumps: Sequence[ClockJump]) -> tuple[Notice, ...]:
    """A sentence for each jump that was taken out."""
    return tuple(
        Notice(
            "clock-corrected",
            f"The frames' clock jumps in the calibration window: the calibration adds {1e3 * jump.late_s:+.3g} ms to "
            f"the time stamps from frame {jump.row} of the window on. Frames were lost or the clock was set: give "
            "each frame a time stamp, or choose a calibration.window_s without the jump.",
        )
        for jump in jumps
    )
