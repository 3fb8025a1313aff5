"""The second pass over what the estimator decided: `smoother` over a whole log, `lag` over a sliding window.

Both run the filter again with the decisions of the best hypothesis, and then back in time. Memory stays bounded: the
smoother keeps the filter at every block's start only and runs each block once more on its way back (G. J. Bierman,
Fixed interval smoothing with discrete measurements, Int. J. Control 18 (1973) 65-75). As far as nothing was decided
otherwise later, it takes those that the estimator logged: the best hypothesis's past is what it decided.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.backward import pass_back
from midspan.fusion.blocks import estimate_of, given_rows, sample_rows
from midspan.fusion.decisions import NOTHING_DECIDED, ONE_CAUSE_S, Decided
from midspan.fusion.estimator import BLOCK, Estimator, EstimatorState, Log, Rows
from midspan.fusion.filtering import FOUND_VARIANCE, zero_variance
from midspan.fusion.forward import AT, AXIS, CHANNEL, SENSOR, TIME, UNITS_PER_M, ZERO, ZERO_VARIANCE
from midspan.fusion.hypothesis import (
    BEGUN,
    GOOD,
    KINDS,
    LOST,
    OUTLIER,
    SHIFT,
    SINCE_THEN,
    SPREAD,
    STEPPED_BEFORE,
    WRONG,
)
from midspan.fusion.model import Beginning, Block, EstimatorSettings, Filter, Left, options_of, run, tables_of
from midspan.fusion.weighing import SHORTEST_S, led_away
from midspan.records import Estimate, Event, Floats, Measured, Samples, cut, joined, part, seconds

# Of the lag, the part by which the window moves on at once.
HOPS = 4


@dataclass(frozen=True, slots=True)
class Span:
    """Samples with the measurements within them, what they were taken for, and the filter before the first sample."""

    samples: Samples
    block: Block
    before: Filter


class SecondPass:
    """Runs spans forward as decided and back, for one estimator's settings."""

    def __init__(self, settings: EstimatorSettings, origin_ns: int) -> None:
        self.settings, self.tables, self.options = settings, tables_of(settings, origin_ns), options_of(settings)

    def forward(self, span: Span, *, back: bool, nodes: Floats | None = None) -> tuple[Filter, Left]:
        """The filter after a span, and what the run left; nodes: as of `run`."""
        state = span.before.resumed(1)
        return state, run(state, span.block, self.tables, self.options, back=back, nodes=nodes)

    def nothing_later(self) -> Floats:
        """The adjoint (1 + k + 2 n, n) at the end of the record."""
        n = self.settings.size
        return np.zeros((1 + len(self.settings.parameters) + 2 * n, n))

    def counted(self, before: Filter, decided: Decided) -> NDArray[np.int64]:
        """The zero (axes,) that each axis counts from on the way back, or -1: its first channel's, if that is unknown.

        before: the filter at the beginning of what was decided. See `forward.count_from`.
        """
        channels, begun = self.tables[1], before.hyps[2][0, :, BEGUN] > 0.0
        met = decided.rows[(decided.rows[:, CHANNEL] >= 0.0) & (decided.codes % KINDS != OUTLIER), CHANNEL]
        found = np.full(self.settings.axes, -1)
        for a in range(self.settings.axes):
            own = channels[:, AXIS] == a
            known = own & (channels[:, ZERO_VARIANCE] < np.inf)
            first = [*np.flatnonzero(begun & known), *np.flatnonzero(begun & own), *met[own[met.astype(int)]]][:1]
            for c in np.array(first, dtype=int):
                found[a] = -1 if known[c] else int(channels[c, ZERO])
        return found

    def backward(self, span: Span, left: Left, adjoint: Floats, last: Filter, counted: NDArray[np.int64]) -> Floats:
        """What was found (s, axes, 5), smoothed by what came later; the adjoint moves to the span's beginning."""
        parameters = (last.hyps[4][0], last.hyps[5][0])
        start_s = float(span.before.clock[TIME])
        made = (left.nodes, left.record, left.uncertain)
        pass_back(span.block.samples[:, 0].copy(), start_s, self.tables, counted, made, adjoint, parameters, left.found)
        for a in range(self.settings.axes):
            least = zero_variance(last.hyps[1][0], self.tables[1], a, self.tables[3], self.tables[5])
            np.maximum(left.found[:, a, FOUND_VARIANCE], least, out=left.found[:, a, FOUND_VARIANCE])
        return left.found


@dataclass(frozen=True, slots=True)
class Unforeseen:
    """Errors of the acceleration (k,): from when to when (s), along which axis, of which density ((m/s²)²/Hz)."""

    from_s: Floats
    until_s: Floats
    axis: NDArray[np.int64]
    density: Floats

    def added_to(self, rows: Floats) -> Floats:
        """Rows (s, 1 + 2 axes) of samples with this in their noise."""
        axes, times = (rows.shape[1] - 1) // 2, rows[:, 0]
        for begin, end, axis, density in zip(self.from_s, self.until_s, self.axis, self.density, strict=True):
            within = slice(np.searchsorted(times, begin, side="right"), np.searchsorted(times, end) + 1)
            rows[within, 1 + axes + axis] += density
        return rows


def unforeseen(decided: Decided, channels: Floats) -> tuple[Unforeseen, NDArray[np.int64]]:
    """What led predictions away that were found wrong, and the codes (m,) by which measurements then are taken.

    The filter learns of it by the measurement that it contradicts; but it happened since the last good one before, of
    the same channel. Measurements between are asked again, and those that were taken for outliers before, as far as
    they belong to the same cause: they contradicted a state that was wrong. Without a good one before nothing is
    changed.
    """
    codes, time_s, channel_of, found = decided.codes.copy(), decided.rows[:, AT], decided.rows[:, CHANNEL], []
    again = np.zeros(len(codes), dtype=np.bool_)
    led = np.isin(decided.codes % KINDS, (WRONG, LOST)) & (channel_of >= 0.0)
    for c in np.unique(channel_of[led]).astype(np.int64):
        own = np.flatnonzero(channel_of == c)
        good = np.flatnonzero(decided.codes[own] % KINDS != OUTLIER)
        for place in np.flatnonzero(led[own]):
            last = int(np.searchsorted(good, place)) - 1
            if last < 0:
                continue
            j, first = own[place], int(good[last])
            lapse = max(time_s[j] - time_s[own[first]], SHORTEST_S)
            density = led_away(decided.errors[j, 0] / channels[c, UNITS_PER_M], lapse)
            found.append((time_s[j] - lapse, time_s[j], channels[c, AXIS], density))
            again[own[first + 1 : place + 1]] = True
            again[outliers_of_one_cause(own[: place + 1], time_s, codes)] = True
    codes[again] += SPREAD
    table = np.array(found).reshape(-1, 4)
    return Unforeseen(table[:, 0], table[:, 1], table[:, 2].astype(np.int64), table[:, 3]), codes


def outliers_of_one_cause(own: NDArray[np.int64], time_s: Floats, codes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Which of a channel's measurements `own` are the outliers that led to what the last of them was taken for."""
    odd = own[codes[own] % KINDS != GOOD]
    apart = np.flatnonzero(np.diff(time_s[odd]) >= ONE_CAUSE_S)
    same: NDArray[np.int64] = odd[apart[-1] + 1 :] if len(apart) else odd
    return np.extract(codes[same] % KINDS == OUTLIER, same)


def steps_in_place(decided: Decided, channels: Floats) -> Decided:
    """Decisions with the steps that later measurements told as shifts where they were: of all targets of a sensor."""
    codes, rows = decided.codes.copy(), decided.rows
    codes[codes == STEPPED_BEFORE] = GOOD
    for j in np.flatnonzero(decided.codes == STEPPED_BEFORE):
        since_s, own = rows[j, AT] - decided.errors[j, 2] - SHORTEST_S, channels[int(rows[j, CHANNEL])]
        first = int(np.searchsorted(rows[:, AT], since_s))
        for c in np.flatnonzero((channels[:, SENSOR] == own[SENSOR]) & (channels[:, AXIS] == own[AXIS])):
            met = (rows[first : j + 1, CHANNEL] == c) & (codes[first : j + 1] % KINDS != OUTLIER)
            codes[first + np.flatnonzero(met)[:1]] = SHIFT + SINCE_THEN
    return replace(decided, codes=codes)


def joined_decisions(parts: list[Decided]) -> Decided:
    """Decisions in their order as one."""
    return Decided(
        np.concatenate([one.rows for one in parts]),
        np.concatenate([one.codes for one in parts]),
        np.concatenate([one.errors for one in parts]),
    )


def smooth(log: Log, settings: EstimatorSettings) -> tuple[Estimate, ...]:
    """The rows of each axis, smoothed by the whole record; log: of an estimator that has finished."""
    # Steps of zeros are put in place before, and none is asked for.
    work = SecondPass(replace(settings, rates=replace(settings.rates, shift=0.0)), log.origin_ns)
    met = joined_decisions(log.decided)
    errors, codes = unforeseen(steps_in_place(met, work.tables[1]), work.tables[1])
    decided = replace(met, codes=codes)
    known = logged_filters(log, met, first_change(met, decided, errors)) if settings == log.settings else {}
    spans = spans_of(work, log, decided, errors, known)
    given = [given_rows(block, log.first_s, log.origin_ns) for block, _, _ in spans]
    edges = np.cumsum([0, *map(np.count_nonzero, given)])
    estimates = tuple(_empty(int(edges[-1])) for _ in range(settings.axes))
    adjoint, counted, last, nodes = work.nothing_later(), work.counted(spans[0][2], decided), None, None
    for i in range(len(spans) - 1, -1, -1):
        span = _span(spans[i], decided, errors, log)
        after, left = work.forward(span, back=True, nodes=nodes)
        last, nodes = last or after, left.nodes if nodes is None or len(nodes) < len(left.nodes) else nodes
        found = work.backward(span, left, adjoint, last, counted)
        for a, whole in enumerate(estimates):
            unseen_m2 = settings.unseen_variance_m2(a)
            _fill(whole, int(edges[i]), estimate_of(span.samples, found[:, a], given[i], unseen_m2))
    return estimates


# Samples, the measurements within them, and the filter before the first sample.
Part = tuple[Samples, slice, Filter]


def logged_filters(log: Log, met: Decided, other_s: float) -> dict[int, Filter]:
    """The logged filters, by samples before, that are as a run by what was decided would find them: before anything is
    other in the second pass, and of the hypothesis that was right.
    """
    return {
        count: one.filter
        for count, one in log.filters.items()
        if one.filter.clock[TIME] < other_s
        and np.array_equal(one.codes, met.codes[one.decided : one.decided + len(one.codes)])
    }


def spans_of(
    work: SecondPass, log: Log, decided: Decided, errors: Unforeseen, known: Mapping[int, Filter]
) -> list[Part]:
    """A log in parts of BLOCK samples, each with the filter before it, known or by running over the part before."""
    parts, due, done = list[Part](), 0, 0
    for block in in_blocks(log.samples):
        before = known.get(done)
        if before is None and parts:
            before = work.forward(_span(parts[-1], decided, errors, log), back=False)[0].saved()
        first, done = due, done + len(block.time_ns)
        end_s = float(seconds(block.time_ns[-1:], log.origin_ns)[0])
        due = int(np.searchsorted(decided.rows[:, AT], end_s, side="right"))
        parts.append((block, slice(first, due), before or Filter.begun(log.begin, work.settings, 1)))
    return parts


def in_blocks(pieces: Iterable[Samples]) -> Iterator[Samples]:
    """Samples in pieces of BLOCK; the last one may be shorter."""
    held, count = list[Samples](), 0
    for piece in pieces:
        for one in (part(piece, slice(BLOCK - count)), *cut(part(piece, slice(BLOCK - count, None)), BLOCK)):
            held.append(one)
            count += len(one.time_ns)
            if count == BLOCK:
                yield joined(held)
                held, count = [], 0
    if count:
        yield joined(held)


def first_change(met: Decided, decided: Decided, errors: Unforeseen) -> float:
    """From when on (s) the second pass is other than the first: another code or noise; infinite where it never is."""
    other = met.rows[met.codes != decided.codes, AT]
    return float(min([*other[:1], *errors.from_s], default=np.inf))


def _span(one: Part, decided: Decided, errors: Unforeseen, log: Log) -> Span:
    samples, own, before = one
    rows, codes = decided.rows[own].copy(), decided.codes[own]
    return Span(samples, Block(errors.added_to(sample_rows(samples, log.origin_ns)), rows, codes), before)


def _empty(n: int) -> Estimate:
    """Rows to be filled: a day of them must not exist twice."""
    codes = np.empty(n, dtype=np.uint8), np.empty(n, dtype=np.uint8)
    return Estimate(np.empty(n, dtype=np.int64), np.empty(n), np.empty(n), np.empty(n), *codes)


def _fill(whole: Estimate, place: int, rows: Estimate) -> None:
    own = slice(place, place + len(rows.time_ns))
    for name in Estimate.__slots__:
        getattr(whole, name)[own] = getattr(rows, name)


@dataclass(frozen=True, slots=True)
class LagState:
    """All that a fixed-lag stream remembers: the estimator's state, and its window with the filter before it."""

    estimator: EstimatorState
    begin: Beginning | None
    samples: Samples | None
    decided: Decided
    before: Filter | None
    pushed: int
    held: int


class Lag:
    """The estimator's rows given out `lag_samples` or up to a quarter more later, smoothed by what came until then.

    The window moves on in hops of a quarter of the lag, counted in samples from the first one, so that any cutting of
    the input gives the same rows. Innovations and events are those of the estimator, as they come.
    """

    def __init__(self, settings: EstimatorSettings, lag_samples: int) -> None:
        self.settings = settings
        self.estimator = Estimator(settings, log=True, rows=False)
        self.lag_samples, self._hop = lag_samples, max(1, lag_samples // HOPS)
        self._samples: Samples | None = None
        self._decided = NOTHING_DECIDED
        self._before: Filter | None = None
        # Samples pushed, and those of the window that were given out already.
        self._pushed = self._given = 0

    def push(self, record: Samples | Measured | Event) -> list[Rows]:
        """Take one block, as `Estimator.push`."""
        if not isinstance(record, Samples):
            return self.estimator.push(record)
        found, first = [], 0
        while first < len(record.time_ns):
            last = min(len(record.time_ns), first + self._hop - self._pushed % self._hop)
            found += self.estimator.push(part(record, slice(first, last)))
            self._pushed += last - first
            first = last
            if self._pushed % self._hop == 0:
                found += self._move_on(self.lag_samples)
        return found

    def finish(self) -> list[Rows]:
        """The rows that are held still, and what the estimator says at the end."""
        return [*self.estimator.finish(), *self._move_on(0)]

    def predict(self, channel: int, time_ns: int) -> tuple[float, float]:
        """As `Estimator.predict`."""
        return self.estimator.predict(channel, time_ns)

    @property
    def parameters(self) -> tuple[Floats, Floats]:
        """As `Estimator.parameters`."""
        return self.estimator.parameters

    @property
    def state(self) -> LagState:
        """All that the stream remembers."""
        self._collect()
        log = self.estimator.log
        begin = None if log is None else log.begin
        own = (self._samples, self._decided, self._before, self._pushed, self._given)
        return LagState(self.estimator.state, begin, *own)

    def restore(self, state: LagState) -> None:
        """Go on from a state of a stream with the same settings."""
        self.estimator.restore(state.estimator)
        known = state.estimator
        begin, origin_ns = state.begin, known.origin_ns or 0
        self.estimator.log = None if begin is None else Log(self.settings, begin, known.first_s, origin_ns)
        self._samples, self._decided, self._before = state.samples, state.decided, state.before
        self._pushed, self._given = state.pushed, state.held

    def _collect(self) -> bool:
        """Take over what the estimator has logged; whether there is anything."""
        log = self.estimator.log
        if log is None:
            return False
        if self._before is None:
            self._before = Filter.begun(log.begin, self.estimator.settings, 1)
        if log.samples:
            own = [] if self._samples is None else [self._samples]
            self._samples = joined([*own, *log.samples])
            self._decided = joined_decisions([self._decided, *log.decided])
        log.samples.clear()
        log.decided.clear()
        log.filters.clear()
        return self._samples is not None

    def _move_on(self, lag: int) -> list[Rows]:
        """Give out the rows that are older than the lag, and let go of what is decided and not needed any more."""
        if not self._collect() or self._samples is None or self._before is None:
            return []
        samples, log = self._samples, self.estimator.log
        due = len(samples.time_ns) - lag
        if log is None or due <= self._given:
            return []
        work = SecondPass(self.estimator.settings, log.origin_ns)
        decided, open_ones = self._decided, self.estimator.undecided
        best, _ = open_ones.decided(self.estimator.count, all_of_them=True)
        both = joined_decisions([decided, best])
        rows = sample_rows(samples, log.origin_ns)
        settled = int(np.searchsorted(rows[:, 0], open_ones.rows[0, AT])) if len(open_ones.rows) else due
        anchor = min(due, settled)
        parts = [self._span(both, rows, slice(anchor), self._before)] if anchor else []
        middle, left = work.forward(parts[0], back=True) if parts else (self._before, None)
        lefts = [left] if left is not None else []
        last = middle
        if anchor < len(rows):
            parts.append(self._span(both, rows, slice(anchor, None), middle.saved()))
            last, late = work.forward(parts[-1], back=True)
            lefts.append(late)
        adjoint, counted = work.nothing_later(), work.counted(self._before, both)
        found = [
            work.backward(span, one, adjoint, last, counted)
            for span, one in zip(reversed(parts), reversed(lefts), strict=True)
        ]
        own = part(samples, slice(self._given, due))
        smoothed = np.concatenate(found[::-1])[self._given : due]
        self._let_go(anchor, rows, middle.saved())
        self._given = due - anchor
        shown = given_rows(own, log.first_s, log.origin_ns)
        unseen = [self.settings.unseen_variance_m2(a) for a in range(self.settings.axes)]
        return [Rows(tuple(estimate_of(own, smoothed[:, a], shown, m2) for a, m2 in enumerate(unseen)), (), ())]

    def _span(self, decided: Decided, rows: Floats, which: slice, before: Filter) -> Span:
        assert self._samples is not None
        block = rows[which]
        within = (decided.rows[:, AT] <= block[-1, 0]) & (decided.rows[:, AT] > before.clock[TIME])
        own = Block(block, decided.rows[within], decided.codes[within])
        return Span(part(self._samples, which), own, before)

    def _let_go(self, anchor: int, rows: Floats, before: Filter) -> None:
        assert self._samples is not None
        if not anchor:
            return
        self._before, self._samples = before, part(self._samples, slice(anchor, None))
        kept = self._decided.rows[:, AT] > rows[anchor - 1, 0]
        own = self._decided
        self._decided = Decided(own.rows[kept], own.codes[kept], own.errors[kept])
