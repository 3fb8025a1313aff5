"""The estimator of one measuring point: samples and measurements in, displacement with its band out, one row a sample.

The filter holds all that is uncertain as states and parameters (see `forward`) and decides by hypotheses what went
wrong (see `hypotheses`). Rows are held back until the first few measurements have come: the first of them is then
judged by those after it.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.blocks import (
    beginning,
    estimate_of,
    given_rows,
    in_order,
    innovations_of,
    measured_rows,
    newest,
    sample_rows,
    with_start,
)
from midspan.fusion.decisions import ALL_DECIDED, MAX_UNDECIDED, Decided, Telling, Undecided, events_of, runs_left
from midspan.fusion.filtering import (
    FOUND_VARIANCE,
    FOUND_VELOCITY,
    FOUND_X,
    MET_CODE,
    MET_ERROR,
    MET_TOTAL,
    zero_variance,
)
from midspan.fusion.forward import (
    AT,
    AXIS,
    CHANNEL,
    MEASUREMENT_COLUMNS,
    SET_DATUM,
    STEP,
    TIME,
    UNITS_PER_M,
    WENT_BACK,
    ZERO_VARIANCE,
)
from midspan.fusion.hypothesis import BEGUN, WEIGHT
from midspan.fusion.innovation import predict_value
from midspan.fusion.model import Beginning, Block, EstimatorSettings, Filter, Left, options_of, run, tables_of
from midspan.fusion.state_space import GAP_STEPS
from midspan.fusion.unmeasured import Integrated, integrated
from midspan.records import (
    NANOSECONDS,
    Estimate,
    Event,
    Floats,
    Innovation,
    Measured,
    Samples,
    cut,
    joined,
    part,
    seconds,
)

# So many measurements, one of them of the sensor whose zero counts, or so long (s) after the first one, are waited for
# before rows are given out.
FIRST_MEASUREMENTS, FIRST_S = 8, 2.0
# A zero longer before the first measurement than this (s) is not followed from there: the rows count from the latter.
MAX_BEFORE_S = 10.0
# A first measurement before the first sample counts when it is no more than this (s) before it.
BEFORE_SAMPLES_S = 2.0
# So many measurements may wait for the samples that cover them; older ones are dropped.
MAX_WAITING = 65536
# Samples that are run at once: bounds the memory.
BLOCK = 8192


@dataclass(frozen=True, slots=True)
class Rows:
    """What a push gave: rows of each axis, innovations of each channel as the best hypothesis saw them, events.

    zero_variance_m2 (axes,): variance of the datum at the last row, the part that all rows have in common.
    """

    estimates: tuple[Estimate, ...]
    innovations: tuple[Innovation, ...]
    events: tuple[Event, ...]
    zero_variance_m2: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class EstimatorState:
    """All that an estimator remembers.

    filter: None while rows are held back; integrated: until then, and until all zeros have begun; overflown:
    measurements were dropped.
    """

    origin_ns: int | None
    early: tuple[Measured, ...]
    held: Samples | None
    waiting: Floats
    integrated: Integrated | None
    filter: Filter | None
    first_s: float
    undecided: Undecided
    told: Telling
    late: tuple[int, ...]
    overflown: bool
    events: tuple[Event, ...]


@dataclass(frozen=True, slots=True)
class Logged:
    """The filter with its best hypothesis alone, after so many decided measurements, and what that took those (m,) for
    that were not decided yet.
    """

    filter: Filter
    decided: int
    codes: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Log:
    """Samples, measurements and final decisions as they were met, from the filter's beginning on.

    first_s: time of the first measurement, from which on rows are given; origin_ns: what times in s count from.
    filters: the filter of `settings` after so many samples, multiples of BLOCK.
    """

    settings: EstimatorSettings
    begin: Beginning
    first_s: float
    origin_ns: int
    samples: list[Samples] = field(default_factory=list)
    decided: list[Decided] = field(default_factory=list)
    filters: dict[int, Logged] = field(default_factory=dict)


class Estimator:
    """The estimator as a stream: any cutting of the input into pushes gives the same rows.

    Measurements wait for the samples that cover their time. log: keep all that a second pass needs. rows: whether rows
    are given out, which only a second pass does not need.
    """

    def __init__(self, settings: EstimatorSettings, *, log: bool = False, rows: bool = True) -> None:
        self.settings = settings
        self.log: Log | None = None
        self.tables, self.options = tables_of(settings), options_of(settings)
        # Samples and decisions logged, and whether what is decided is the past of all hypotheses.
        self._keep, self._logged, self._decided, self._one_past = log, 0, 0, True
        self._given = rows
        self._origin_ns: int | None = None
        self._held: Samples | None = None
        self._waiting = np.empty((0, MEASUREMENT_COLUMNS))
        self._early: list[Measured] = []
        self._integrated: Integrated | None = None
        self._filter: Filter | None = None
        self._first_s = np.nan
        self._undecided = ALL_DECIDED
        self._told = Telling.nothing(settings.channels)
        self._late: set[int] = set()
        self._overflown = False
        self._events: list[Event] = []

    def push(self, record: Samples | Measured | Event) -> list[Rows]:
        """Take one block; returns for samples the rows that are due, if any.

        Times increase from block to block of samples. A measurement that is not later than the last sample is left out,
        with an event. An event stands for stamps that went back: from then on clocks may have stepped.
        """
        if isinstance(record, Event):
            self._doubt((record.time_ns - self._origin) / NANOSECONDS)
            return []
        if isinstance(record, Measured):
            self._wait(record)
            return []
        found = []
        for block in cut(record, BLOCK):
            found.extend(self._push(block))
        return found

    def finish(self) -> list[Rows]:
        """The rows that are held back still, and events that the record's end completes."""
        rows = [] if self._filter is not None or self._held is None else self._begin(self._held, ended=True)
        if self._filter is None:
            return [*rows, Rows((), (), tuple(self._events))] if self._events else rows
        decided, self._undecided = self._undecided.decided(self._filter.count, all_of_them=True)
        events = [*self._settle(decided), *runs_left(self._told, self.settings.channels, self._origin)]
        return [*rows, Rows((), (), tuple(events))] if events else rows

    def predict(self, channel: int, time_ns: int) -> tuple[float, float]:
        """Expected measurement of a channel at a time after the last sample, in its unit, and the variance of that.

        The last acceleration is held over a step or two; NaN where no samples come. Until the filter and the channel's
        zero have begun only the acceleration tells, see `Integrated`: the variance is infinite before the filter begins
        and NaN afterwards, when measurements from before come too late.
        """
        time_s, state, alone = (time_ns - self._origin) / NANOSECONDS, self._filter, self._integrated
        if state is None or not self._counting[channel]:
            if alone is None or not time_s - alone.time_s <= GAP_STEPS * alone.step_s:
                return np.nan, np.inf
            known = self.settings.channels[channel]
            return known.units_per_m * alone.at(time_s, known.axis), np.inf if state is None else np.nan
        if time_s - state.clock[TIME] > GAP_STEPS * state.clock[STEP]:
            return np.nan, np.inf
        value, variance = predict_value(time_s, channel, state.motion, state.clock, state.hyps, self.tables)
        return float(value), float(variance)

    @property
    def state(self) -> EstimatorState:
        """All that the estimator remembers besides its log."""
        return EstimatorState(
            self._origin_ns,
            tuple(self._early),
            self._held,
            self._waiting.copy(),
            self._integrated,
            None if self._filter is None else self._filter.saved(),
            self._first_s,
            self._undecided,
            self._told,
            tuple(sorted(self._late)),
            self._overflown,
            tuple(self._events),
        )

    def restore(self, state: EstimatorState) -> None:
        """Go on from a state of an estimator with the same settings."""
        self._origin_ns, self._early = state.origin_ns, list(state.early)
        self._held, self._waiting = state.held, state.waiting.copy()
        self._integrated = state.integrated
        self._filter = None if state.filter is None else state.filter.resumed()
        self._first_s, self._undecided, self._told = state.first_s, state.undecided, state.told
        self._late, self._overflown, self._events = set(state.late), state.overflown, list(state.events)
        self.tables = tables_of(self.settings, self._origin)

    @property
    def undecided(self) -> Undecided:
        """The measurements of which the hypotheses do not say the same yet."""
        return self._undecided

    @property
    def count(self) -> int:
        """How many hypotheses there are."""
        return 0 if self._filter is None else self._filter.count

    @property
    def parameters(self) -> tuple[Floats, Floats]:
        """The parameters as estimated (k,) and their variances (k,)."""
        if self._filter is None:
            return np.zeros(len(self.settings.parameters)), np.array([p.std**2 for p in self.settings.parameters])
        return self._filter.hyps[4][0].copy(), np.diag(self._filter.hyps[5][0]).copy()

    @property
    def _origin(self) -> int:
        return self._origin_ns or 0

    @property
    def _counting(self) -> NDArray[np.bool_]:
        """For which channels (c,) the filter's displacement counts from their zero: an unknown zero has been met, or of
        the known ones of the axis one.
        """
        known, axis = self.tables[1][:, ZERO_VARIANCE] < np.inf, self.tables[1][:, AXIS]
        met = np.zeros(len(known), dtype=np.bool_) if self._filter is None else self._filter.hyps[2][0, :, BEGUN] > 0.0
        return np.where(known, np.isin(axis, axis[known & met]), met)

    def _wait(self, record: Measured) -> None:
        if self._origin_ns is None:
            # Times are counted from the first sample, which is still to come.
            self._early.append(record)
            if len(self._early) > MAX_WAITING:
                self._overflow(int(self._early.pop(0).time_ns[0]))
            return
        rows = measured_rows(record, self.tables[1][:, UNITS_PER_M], self._origin)
        done = -np.inf if self._filter is None else self._filter.clock[TIME]
        late = rows[:, AT] <= done
        if late.any() or self._late:
            for c in np.unique(rows[late, CHANNEL]).astype(int).tolist():
                if c not in self._late:
                    first = self._origin + round(float(rows[late & (rows[:, CHANNEL] == c)][0, AT]) * NANOSECONDS)
                    name = self.settings.channels[c].sensor
                    self._events.append(Event(first, "late", f"Measurements of {name} came too late and are left out."))
            self._late |= set(rows[late, CHANNEL].astype(int).tolist())
            self._late -= set(rows[~late, CHANNEL].astype(int).tolist())
            rows = rows[~late]
        waiting = in_order(np.concatenate((self._waiting, rows)))
        self._waiting = newest(waiting, MAX_WAITING)
        if len(self._waiting) < len(waiting):
            self._overflow(self._origin + round(float(waiting[0, AT]) * NANOSECONDS))

    def _overflow(self, time_ns: int) -> None:
        """Tell that measurements from an instant on are dropped: once, until half of what may wait is gone."""
        if not self._overflown:
            text = f"More than {MAX_WAITING} measurements wait for samples of acceleration; the oldest are left out."
            self._events.append(Event(time_ns, "overflow", text))
        self._overflown = True

    def _doubt(self, time_s: float) -> None:
        """Let the clocks be in doubt from an instant on; before the filter has begun it knows of none."""
        if self._filter is not None:
            mark = np.array([[max(time_s, self._filter.clock[TIME]), WENT_BACK, 0.0, 0.0, 0.0]])
            self._waiting = in_order(np.concatenate((self._waiting, mark)))

    def _push(self, samples: Samples) -> list[Rows]:
        if self._origin_ns is None:
            self._origin_ns = int(samples.time_ns[0])
            early, self._early = self._early, []
            for measured in early:
                self._wait(measured)
        if self._filter is None or self._integrated is not None:
            bias_m_s2 = np.array(self.settings.bias_m_s2[: self.settings.axes])
            self._integrated = integrated(self._integrated, sample_rows(samples, self._origin), bias_m_s2)
        if self._filter is not None:
            rows = self._run(self._filter, samples)
        else:
            rows = self._begin(samples if self._held is None else joined([self._held, samples]))
        if self._filter is not None and self._counting.all():
            self._integrated = None
        return rows

    def _begin(self, held: Samples, *, ended: bool = False) -> list[Rows]:
        """Start once enough measurements are there; until then hold the samples from before the first one on."""
        time_s = seconds(held.time_ns, self._origin)
        self._waiting = self._waiting[self._waiting[:, AT] >= time_s[0] - BEFORE_SAMPLES_S]
        rows = self._waiting[self._waiting[:, AT] <= time_s[-1]]
        first_s = float(rows[0, AT]) if len(rows) else float(time_s[-1])
        start_s = self._start_s(first_s, float(time_s[0]))
        held = part(held, slice(max(int(np.searchsorted(time_s, start_s, side="right")) - 1, 0), None))
        if not len(rows):
            self._held = held
            return []
        time_s = seconds(held.time_ns, self._origin)
        is_enough = len(rows) >= FIRST_MEASUREMENTS and self._tells_zero(rows, first_s)
        enough = rows[FIRST_MEASUREMENTS - 1, AT] if is_enough else np.inf
        # What the acceleration was before its first sample, the samples of some time tell.
        until_s = min(enough, first_s + FIRST_S) if first_s >= time_s[0] else time_s[0] + FIRST_S
        last = int(np.searchsorted(time_s, until_s))
        if last >= len(time_s):
            if not ended:
                self._held = held
                return []
            last = len(time_s) - 1
        self._held = None
        rest = part(held, slice(last + 1, None))
        begun = self._start(with_start(part(held, slice(last + 1)), start_s, self._origin), first_s)
        return [begun, *(self._run(self._filter, rest) if self._filter and len(rest.time_ns) else [])]

    def _start_s(self, first_s: float, sampled_s: float) -> float:
        """When the filter starts, s: at the first measurement, or at the zero where that lies shortly before it, but
        not before the first sample: without acceleration the zero would be uncertain by decimetres.
        """
        if self.settings.zero_ns is None:
            return first_s
        zero_s = (self.settings.zero_ns - self._origin) / NANOSECONDS
        return max(zero_s, min(sampled_s, first_s)) if first_s - MAX_BEFORE_S <= zero_s < first_s else first_s

    def _tells_zero(self, rows: Floats, first_s: float) -> bool:
        """Whether one of the first measurements (m, 5) counts from the zero, or those that do are not waited for."""
        if self.settings.zero_ns is None or self.settings.zero_ns > self._origin + (first_s + FIRST_S) * NANOSECONDS:
            return True
        counting = [channel.zero_std_m < np.inf for channel in self.settings.channels]
        return bool(np.any(np.array(counting)[rows[:, CHANNEL].astype(np.int64)]))

    def _start(self, samples: Samples, first_s: float) -> Rows:
        """Judge the first measurements, and take the rows from a second run with what was decided."""
        block = sample_rows(samples, self._origin)
        rows = self._due(block[-1, 0])
        begin = beginning(block, rows, self.settings)
        if self.settings.zero_ns is not None:
            zero_s = max((self.settings.zero_ns - self._origin) / NANOSECONDS, block[0, 0])
            datum = np.array([[zero_s, SET_DATUM, 0.0, 0.0, 0.0]])
            rows = np.concatenate((rows, datum)) if zero_s <= block[-1, 0] else rows
            self._waiting = in_order(np.concatenate((self._waiting, datum))) if zero_s > block[-1, 0] else self._waiting
            rows = in_order(rows)
        self._first_s = first_s
        self.tables = tables_of(self.settings, self._origin)
        self._filter = Filter.begun(begin, self.settings)
        self.log, self._logged = Log(self.settings, begin, first_s, self._origin) if self._keep else None, 0
        open_block = Block.open(block, rows)
        left = run(self._filter, open_block, self.tables, self.options)
        met = Undecided(rows, left.survivors, left.errors)
        best, _ = met.decided(self._filter.count, all_of_them=True)
        begun = Filter.begun(begin, self.settings, 1)
        again = [
            run(begun.saved(), open_block.taken_as(codes), self.tables, self.options)
            for codes in met.paths(self._filter.count)
        ]
        weights = np.exp(self._filter.hyps[3][: self._filter.count, WEIGHT])
        judged = replace(again[0], found=mixed(np.array([one.found for one in again]), weights / np.sum(weights)))
        judged.met[:, MET_ERROR], judged.met[:, MET_TOTAL] = best.errors[:, :2].T
        judged.met[:, MET_CODE] = best.codes
        return self._rows(samples, rows, left, judged)

    def _run(self, state: Filter, samples: Samples) -> list[Rows]:
        """The rows of samples; where they are logged, run up to where the log keeps the filter, and then on."""
        left = BLOCK - self._logged % BLOCK
        if self.log is None or left >= len(samples.time_ns):
            return [self._run_on(state, samples)]
        return [self._run_on(state, part(samples, slice(left))), *self._run(state, part(samples, slice(left, None)))]

    def _run_on(self, state: Filter, samples: Samples) -> Rows:
        block = sample_rows(samples, self._origin)
        rows = self._due(block[-1, 0])
        left = run(state, Block.open(block, rows), self.tables, self.options)
        return self._rows(samples, rows, left, left)

    def _due(self, until_s: float) -> Floats:
        """Waiting measurements up to an instant, which no longer wait."""
        due = int(np.searchsorted(self._waiting[:, AT], until_s, side="right"))
        rows, self._waiting = self._waiting[:due].copy(), self._waiting[due:]
        self._overflown = self._overflown and len(self._waiting) > MAX_WAITING // 2
        return rows

    def _rows(self, samples: Samples, rows: Floats, left: Left, shown: Left) -> Rows:
        """The outputs of a run; left: what the hypotheses left; shown: where rows and innovations are taken from."""
        assert self._filter is not None
        self._undecided = self._undecided.after(rows, left.survivors, left.errors)
        decided, self._undecided = self._undecided.decided(self._filter.count)
        events = self._settle(decided)
        if self.log is not None:
            self._keep_log(self.log, samples, self._filter)
        settings, estimates = self.settings, tuple[Estimate, ...]()
        if self._given:
            given = given_rows(samples, self._first_s, self._origin)
            estimates = tuple(
                estimate_of(samples, shown.found[:, a], given, settings.unseen_variance_m2(a))
                for a in range(settings.axes)
            )
        innovations = innovations_of(rows, shown.met, self.settings.channels, self._origin)
        p, channels, datum = self._filter.hyps[1][0], self.tables[1], self.tables[3]
        zero = tuple(
            zero_variance(p, channels, a, datum, self.tables[5]) + settings.unseen_common_m2(a)
            for a in range(settings.axes)
        )
        return Rows(estimates, innovations, tuple(events), zero)

    def _keep_log(self, log: Log, samples: Samples, state: Filter) -> None:
        log.samples.append(samples)
        self._logged += len(samples.time_ns)
        # What was decided because more would have been undecided need not be the best hypothesis's past.
        self._one_past = self._one_past and len(self._undecided.rows) < MAX_UNDECIDED
        if self._logged % BLOCK == 0 and self._one_past:
            best, _ = self._undecided.decided(state.count, all_of_them=True)
            log.filters[self._logged] = Logged(state.resumed(1), self._decided, best.codes)

    def _settle(self, decided: Decided) -> list[Event]:
        """Log what is final, and return its events with those that waited."""
        if self.log is not None:
            self.log.decided.append(decided)
            self._decided += len(decided.codes)
        self._told, events = events_of(self._told, decided, self.settings.channels, self._origin)
        waited, self._events = self._events, []
        return [*waited, *events]


def mixed(found: Floats, weights: Floats) -> Floats:
    """What several hypotheses (b,) found (b, s, axes, 5) as one: means and variances by their weights (b,)."""
    one: Floats = found[0].copy()
    one[:, :, FOUND_X] = np.tensordot(weights, found[..., FOUND_X], 1)
    one[:, :, FOUND_VELOCITY] = np.tensordot(weights, found[..., FOUND_VELOCITY], 1)
    off = found[..., FOUND_X] - one[:, :, FOUND_X]
    one[:, :, FOUND_VARIANCE] = np.tensordot(weights, found[..., FOUND_VARIANCE] + off**2, 1)
    return one
