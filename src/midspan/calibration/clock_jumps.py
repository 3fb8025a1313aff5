"""Jumps of a displacement sensor's clock: it was set, or a frame was lost or doubled where stamps are counted.

Around a place where the measurements begin to contradict the acceleration all clock offsets are tried, and the course
of offsets with the least contradiction, each change at a price, is found by dynamic programming. What is found is then
refined with the stamps moved from a row on, and must explain the measurements better than a clock that runs apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.whitening import whiten
from midspan.records import Floats

# Jumps up to this many s are looked for, in steps of so many s at first; smaller ones than this are left alone.
LARGEST_S, STEP_S, LEAST_S = 1.05, 0.01, 2e-3
# Around a suspicious place so many s either way are compared, of a slow sensor so many measurements.
REACH_S, REACH_ROWS = 30.0, 40
# A window of so many s, or measurements, whose offset leaves the one before by so many deviations is suspicious; so is
# one whose squared innovations, none above the second value, are on average beyond the third.
WINDOW_S, WINDOW_ROWS, SUSPICIOUS, MOST_SQUARE, CONTRADICTING = 8.0, 12, 5.0, 9.0, 3.0
# One measurement tells so many squared deviations at most: it may be an outlier.
CLIPPED = 25.0
# Price of a jump; what it must gain beside none and beside a clock that runs apart; what its rival may come near to.
PRICE, LEAST_GAIN, LEAST_BESIDE, RIVAL = 30.0, 30.0, 15.0, 10.0
# Changes within so many s may be one.
SETTLED_S = 3.0
# How well a straight line is tried, s.
LINE_STEP_S = 4e-4
# A rival is so many s away.
APART_S = 0.03
# An instant is possible that is worse than the best by no more than this.
UNSURE = 8.0
# On either side of a jump at least so many measurements must be, and this share of them explained.
LEAST_ROWS, EXPLAINED = 10, 0.8
# A jump counts from so many of its standard deviations on; the search ends after so many places without one.
SIGNIFICANT, MOST_TRIED = 6.0, 12
# A clock that is off before the jump by less than this, s, stays as calibrated there.
LEAST_BEFORE_S = 5e-4
MEDIAN_OF_SQUARE = 0.4549


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


@dataclass(frozen=True, slots=True)
class Beside:
    """A sensor's rows (m, 3) of time (s), displacement (m), variance (m²; infinite: not used), beside samples (n, 3) of
    time, acceleration (m/s²) and its noise density ((m/s²)²/Hz).
    """

    samples: Floats
    rows: Floats

    def contradiction(self, wider_m: float = 0.0) -> Floats:
        """Innovations (m,) in standard deviations, NaN where there is none; wider_m: added to each one's noise."""
        used = np.isfinite(self.rows[:, 2])
        found = np.full(len(self.rows), np.nan)
        if np.count_nonzero(used) < LEAST_ROWS:
            return found
        variance = self.rows[:, 2] + wider_m**2
        unit, density = float(np.median(variance[used])), float(np.median(self.samples[:, 2]))
        rows = np.column_stack((self.rows[:, 0], self.rows[:, 1], variance / unit))
        samples = self.samples / np.array([1.0, 1.0, density])
        w = whiten(samples, rows, density / unit)
        found[w.index] = (w.translation - w.response) / np.sqrt(w.variance * unit)
        return found

    def late(self, late_s: Floats | float) -> "Beside":
        """The same with the stamps moved, (m,) or all alike."""
        rows = self.rows.copy()
        rows[:, 0] += late_s
        # What then comes before its predecessor is a doubled frame.
        latest = np.maximum.accumulate(rows[:, 0])
        doubled = np.concatenate(([False], rows[1:, 0] <= latest[:-1]))
        rows[doubled, 2] = np.inf
        rows[:, 0] = latest
        return replace(self, rows=rows)

    def near(self, begin: int, end: int) -> "Beside":
        """The rows of a stretch, with the samples around them."""
        rows = self.rows[begin:end]
        margin = LARGEST_S + 1.0
        edges = np.searchsorted(self.samples[:, 0], (rows[0, 0] - margin, rows[-1, 0] + margin))
        return Beside(self.samples[slice(*edges)], rows)


def clock_jumps(beside: Beside) -> list[ClockJump]:
    """The jumps of a sensor's clock, in the order of time; each one's rows count in what was given.

    A sensor that the motion tells nothing of has none.
    """
    found: list[ClockJump] = []
    # Stamps that go back on their own are nobody's.
    beside = given = beside.late(0.0)
    begin, tried = 0, 0
    while tried < MOST_TRIED and (place := _suspicious(beside, begin)) is not None:
        jump = _jump_near(beside, place, begin)
        if jump is None:
            begin, tried = _next_window(beside, place), tried + 1
            continue
        found.append(jump)
        beside = given.late(lateness(found, len(given.rows)))
        begin = max(jump.last, jump.row) + 1
    return found


def lateness(jumps: Sequence[ClockJump], count: int) -> Floats:
    """What is to be added to each of `count` stamps, s."""
    late_s, begin = np.zeros(count), 0
    for jump in jumps:
        late_s[begin:] += jump.before_s
        late_s[jump.row :] += jump.late_s
        begin = jump.row
    return late_s


def _interval(rows: Floats) -> float:
    return float(np.median(np.diff(rows[:, 0])))


def _next_window(beside: Beside, place: int) -> int:
    return place + max(WINDOW_ROWS, round(WINDOW_S / _interval(beside.rows)))


def _suspicious(beside: Beside, begin: int) -> int | None:
    """First row of the first window from `begin` on that contradicts the acceleration or the offset before."""
    if len(beside.rows) - begin < 2 * LEAST_ROWS:
        return None
    # The filter needs a way to settle.
    start = max(0, begin - round(REACH_S / _interval(beside.rows)))
    part = beside.near(start, len(beside.rows))
    step = 2e-4
    middle, ahead, behind = (part.late(late).contradiction() for late in (0.0, step, -step))
    slope = (ahead - behind) / (2.0 * step)
    used = np.flatnonzero(np.isfinite(middle) & np.isfinite(slope))
    if len(used) < 2 * LEAST_ROWS:
        return None
    r, g = middle[used], slope[used]
    noise = max(float(np.median(r**2)) / MEDIAN_OF_SQUARE, 1.0)
    clipped = np.clip(r, -3.0 * np.sqrt(noise), 3.0 * np.sqrt(noise))
    length = max(WINDOW_ROWS, round(WINDOW_S / _interval(part.rows[used])))
    edges = np.arange(0, len(used), length)
    information = np.add.reduceat(g * g, edges) / noise
    late = -np.add.reduceat(g * clipped, edges) / noise / np.maximum(information, 1e-30)
    square = np.add.reduceat(np.minimum(r**2 / max(_quiet(r), 1.0), MOST_SQUARE), edges) / np.diff([*edges, len(used)])
    reference, known = 0.0, 0.0
    for k, edge in enumerate(edges):
        told = 1.0 / max(information[k], 1e-30) + (1.0 / known if known else 0.0)
        strange = square[k] > CONTRADICTING or (known > 0.0 and abs(late[k] - reference) > SUSPICIOUS * np.sqrt(told))
        if strange and start + used[edge] >= begin:
            return int(start + used[edge])
        # What lies far back says little of a clock that runs apart.
        known = 0.5 * known + information[k]
        reference += (late[k] - reference) * information[k] / max(known, 1e-30)
    return None


def _quiet(r: Floats) -> float:
    """Variance of the calmer half of innovations (n,) in time: after a jump all are large."""
    halves = [float(np.median(half**2)) for half in np.array_split(r, 4) if len(half)]
    return min(halves) / MEDIAN_OF_SQUARE


@dataclass(frozen=True, slots=True)
class _Stretch:
    """A stretch around a suspicious place: its noise factor, and the rms velocity in m/s."""

    beside: Beside
    noise: float
    velocity: float

    def loss(self, late_s: Floats | float, step_s: float = 0.0) -> float:
        """Contradiction of stamps so much later; step_s: how well the lateness is known."""
        moved = self.beside.late(late_s)
        doubled = np.count_nonzero(np.isfinite(self.beside.rows[:, 2]) & ~np.isfinite(moved.rows[:, 2]))
        return float(np.sum(_losses(moved.contradiction(self.velocity * step_s), self.noise))) + 2.0 * doubled

    def stamps(self, jump: "_Guess") -> Floats:
        """Lateness (m,) with a jump."""
        return np.where(np.arange(len(self.beside.rows)) < jump.row, jump.before_s, jump.after_s)

    def with_jump(self, jump: "_Guess", step_s: float = 0.0) -> float:
        """Contradiction of stamps with a jump."""
        return self.loss(self.stamps(jump), step_s)


@dataclass(frozen=True, slots=True)
class _Guess:
    """A jump at a row of a stretch: lateness before it and from it on, s."""

    row: int
    before_s: float
    after_s: float


def _losses(r: Floats, noise: float) -> Floats:
    return np.where(np.isfinite(r), 0.5 * np.minimum(np.nan_to_num(r) ** 2 / noise, CLIPPED), 0.5)


def _jump_near(beside: Beside, place: int, begin: int) -> ClockJump | None:
    interval = _interval(beside.rows)
    reach = max(REACH_ROWS, round(REACH_S / interval))
    start, end = max(begin, place - reach), min(len(beside.rows), place + reach)
    if end - start < 2 * LEAST_ROWS:
        return None
    stretch = _stretch(beside.near(start, end), place - start)
    if stretch is None:
        return None
    for guess in _coarse(stretch, place - start):
        jump = _refined(stretch, guess)
        if jump is not None:
            return replace(jump, row=jump.row + start, first=jump.first + start, last=jump.last + start)
    return None


def _stretch(beside: Beside, place: int) -> _Stretch | None:
    rows = beside.rows[np.isfinite(beside.rows[:, 2])]
    if len(rows) < 2 * LEAST_ROWS:
        return None
    inner = beside.samples[(beside.samples[:, 0] >= rows[0, 0]) & (beside.samples[:, 0] <= rows[-1, 0])]
    if len(inner) < 2 * LEAST_ROWS:
        return None
    # The faster of what either shows: a slow sensor misses fast motion, slow motion hides in the acceleration's bias.
    steps = np.diff(rows[:, 1]) / np.maximum(np.diff(rows[:, 0]), 1e-4)
    velocity = np.cumsum((inner[1:, 1] - inner[:, 1].mean()) * np.diff(inner[:, 0]))
    time_s = inner[1:, 0] - inner[:, 0].mean()
    velocity = velocity - np.polynomial.Polynomial.fit(time_s, velocity, 3)(time_s)
    spread = max(1.4826 * float(np.median(np.abs(steps))), float(np.std(velocity)))
    r = beside.contradiction()
    r = r[np.isfinite(r)]
    return _Stretch(beside, max(_quiet(r), 1.0), spread) if len(r) else None


def _coarse(stretch: _Stretch, place: int) -> list[_Guess]:
    """Candidates: where the cheapest course of offsets changes, and the suspicious place itself."""
    beside = stretch.beside
    coarse = beside
    count = round(LARGEST_S / STEP_S)
    grid = STEP_S * np.arange(-count, count + 1)
    wider = stretch.velocity * STEP_S
    losses = np.array([_losses(coarse.late(float(late)).contradiction(wider), stretch.noise) for late in grid])
    course = grid[_cheapest(losses)]
    changes = np.flatnonzero(np.abs(np.diff(course)) > 1.5 * STEP_S) + 1
    found = [_Guess(int(k), float(course[k - 1]), float(course[k])) for k in changes]
    if len(changes) > 1:
        # The filter that all offsets were tried with takes its time after a jump.
        close = changes[beside.rows[changes, 0] <= beside.rows[changes[0], 0] + SETTLED_S]
        found.insert(0, _Guess(int(close[0]), float(course[close[0] - 1]), float(course[close[-1]])))
    return [*found[:3], _Guess(place, float(course[0]), float(course[0]))]


def _cheapest(losses: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """The number of the offset at each row (m,) with the least sum of losses (offsets, m), each change at a price."""
    offsets, m = losses.shape
    best, back = losses[:, 0].copy(), np.tile(np.arange(offsets), (m, 1))
    for j in range(1, m):
        least = int(np.argmin(best))
        changed = best > best[least] + PRICE
        back[j, changed] = least
        best = np.minimum(best, best[least] + PRICE) + losses[:, j]
    path = np.empty(m, dtype=np.int64)
    path[-1] = int(np.argmin(best))
    for j in range(m - 1, 0, -1):
        path[j - 1] = back[j, path[j]]
    return path


def _refined(stretch: _Stretch, guess: _Guess) -> ClockJump | None:
    """A candidate at its best instant and size; None where it does not explain what it must."""
    m = len(stretch.beside.rows)
    for step in (5e-3, 1.5e-3, 4e-4, 1e-4):
        guess = _nearer(stretch, guess, step)
    if min(guess.row, m - guess.row) < LEAST_ROWS:
        return None
    before_std, after_std = _stds(stretch, guess)
    if abs(guess.before_s) < max(SIGNIFICANT * before_std, LEAST_BEFORE_S):
        # As calibrated: the jump is what the stamps after it say.
        guess, before_std = replace(guess, before_s=0.0), 0.0
    late_s, std_s = guess.after_s - guess.before_s, float(np.hypot(before_std, after_std))
    if not abs(late_s) > max(SIGNIFICANT * std_s, LEAST_S) or not _explains(stretch, guess):
        return None
    least = stretch.with_jump(guess)
    if min(stretch.loss(guess.before_s), stretch.loss(guess.after_s)) - least < LEAST_GAIN:
        return None
    if _running_apart(stretch, guess) - stretch.with_jump(guess, LINE_STEP_S) < LEAST_BESIDE:
        return None
    first, last = _possible(stretch, guess)
    rival_s = _rival(stretch, guess)
    return ClockJump(
        guess.row, late_s, std_s, first, last, guess.before_s, None if rival_s is None else rival_s - guess.before_s
    )


def _nearer(stretch: _Stretch, guess: _Guess, step: float) -> _Guess:
    """Each of its values at its best within some steps (s)."""
    tried = [replace(guess, before_s=guess.before_s + k * step) for k in range(-4, 5)]
    guess = min(tried, key=lambda one: stretch.with_jump(one, step))
    tried = [replace(guess, after_s=guess.after_s + k * step) for k in range(-4, 5)]
    guess = min(tried, key=lambda one: stretch.with_jump(one, step))
    m = len(stretch.beside.rows)
    stride = max(1, m // 40)
    while guess.after_s != guess.before_s:
        rows = np.unique(np.clip(guess.row + stride * np.arange(-6, 7), 1, m - 1))
        guess = min((replace(guess, row=int(k)) for k in rows), key=lambda one: stretch.with_jump(one, step))
        if stride == 1:
            break
        stride = max(1, stride // 4)
    return guess


def _stds(stretch: _Stretch, guess: _Guess) -> tuple[float, float]:
    """Standard deviations of the lateness before and after, s, from the slopes of the innovations."""
    step, found = 1e-4, []
    # Doubled frames are left out first, so that all have the same rows.
    moved = stretch.beside.late(stretch.stamps(guess))
    for more in (replace(guess, before_s=step, after_s=0.0), replace(guess, before_s=0.0, after_s=step)):
        late = stretch.stamps(more)
        slope = (moved.late(late).contradiction() - moved.late(-late).contradiction()) / (2.0 * step)
        information = float(np.sum(slope[np.isfinite(slope)] ** 2)) / stretch.noise
        found.append(float(1.0 / np.sqrt(max(information, 1e-30))))
    return found[0], found[1]


def _running_apart(stretch: _Stretch, guess: _Guess) -> float:
    """The contradiction of a clock that runs apart evenly."""
    rows = stretch.beside.rows
    t = (rows[:, 0] - rows[0, 0]) / (rows[-1, 0] - rows[0, 0])
    late_s = guess.after_s - guess.before_s
    # A straight line beside a step: up to three times as steep as the step's height over the stretch.
    tried = [
        stretch.loss(guess.before_s + late_s * (shift + slope * t), LINE_STEP_S)
        for slope in np.linspace(0.5, 3.0, 11)
        for shift in np.linspace(-1.5, 0.5, 11)
    ]
    return min(tried)


def _explains(stretch: _Stretch, guess: _Guess) -> bool:
    """Whether both sides of the jump agree with the acceleration then."""
    r = stretch.beside.late(stretch.stamps(guess)).contradiction()
    for side in (r[: guess.row], r[guess.row :]):
        known = side[np.isfinite(side)]
        if len(known) < LEAST_ROWS // 2 or np.mean(known**2 < MOST_SQUARE * stretch.noise) < EXPLAINED:
            return False
    return True


def _possible(stretch: _Stretch, guess: _Guess) -> tuple[int, int]:
    """The first and last row at which the jump can have been."""
    least, m = stretch.with_jump(guess), len(stretch.beside.rows)
    ends = []
    for way, end in ((-1, 1), (1, m - 1)):
        k, stride = guess.row, 1
        while k != end:
            ahead = int(np.clip(k + way * stride, 1, m - 1))
            if stretch.with_jump(replace(guess, row=ahead)) <= least + UNSURE:
                k, stride = ahead, stride * 2
            elif stride == 1:
                break
            else:
                stride //= 2
        ends.append(k)
    return ends[0], ends[1]


def _rival(stretch: _Stretch, guess: _Guess) -> float | None:
    """Another lateness after the jump that explains about as much: near a single tone several do."""
    step = 2e-3
    others = guess.before_s + 4.0 * step * np.arange(-LARGEST_S / step // 4, LARGEST_S / step // 4 + 1)
    others = others[np.abs(others - guess.after_s) > APART_S]
    wide = np.array([stretch.with_jump(replace(guess, after_s=float(late)), 4.0 * step) for late in others])
    near = [float(others[k]) + step * i for k in np.argsort(wide)[:3] for i in range(-4, 5)]
    losses = [stretch.with_jump(replace(guess, after_s=late), step) for late in near]
    best = int(np.argmin(losses))
    return near[best] if losses[best] < stretch.with_jump(guess, step) + RIVAL else None
