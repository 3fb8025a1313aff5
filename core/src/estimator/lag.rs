//! The estimator's rows given out a number of samples, or up to a quarter more, later, smoothed by what came until
//! then.
//!
//! The window moves on in hops of a quarter of the lag, counted in samples from the first one, so that any cutting of
//! the input gives the same rows. What the estimator's own filter leaves of a hop is kept where one hypothesis took all
//! its measurements as good; else the filter is run again over it, and only from where something is decided otherwise.
//! Of a hop only the rows that are given out are smoothed, behind them the adjoint is carried from measurement to
//! measurement. Innovations and events are those of the estimator, as they come.

use super::cause::Decision;
use super::clock_bank::Bank;
use super::decided::{Decided, Log};
use super::hypothesis::Hypothesis;
use super::innovation::{Mixed, Mixture, Work};
use super::layout::{MOTION_STATES, motion_of};
use super::model::{Model, instant, since};
use super::rows::{Output, Rows};
use super::run::{Block, Filter, Judge};
use super::samples::{Samples, View};
use super::smoother::{Adjoint, Counted, Counting};
use super::start::Beginning;
use super::stream::{Estimator, Remembered};
use super::waiting::{Timed, count_until};
use super::way_back::WayBack;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Of the lag, the part by which the window moves on at once.
const HOPS: usize = 4;

/// All that a fixed-lag stream remembers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LagMemory {
    estimator: Remembered,
    begin: Option<Beginning>,
    samples: Samples,
    decided: Decided,
    before: Option<Filter>,
    given: usize,
    pushed: u64,
}

/// What a run over a piece of the window left.
#[derive(Clone, Debug)]
struct Piece {
    way: WayBack,
    after: Filter,
    /// Whether all its items are decided.
    settled: bool,
    /// Whether the estimator's own run left it.
    own: bool,
    /// The items that it was run with, as it had them before and after it put those of one instant in order, and what
    /// they were taken for; none where the estimator's own run left it.
    items: Vec<Timed>,
    decisions: Vec<Decision>,
}

/// A fixed-lag stream; the estimator's log is its window: the samples that are not given out yet, and those after which
/// the filter may be run again.
#[derive(Clone, Debug)]
pub struct Lag {
    /// The estimator whose decisions it takes.
    pub estimator: Estimator,
    lag: usize,
    hop: usize,
    /// The filter before the window's first sample.
    before: Option<Filter>,
    /// How many of the window's samples were given out already.
    given: usize,
    pushed: u64,
    pieces: VecDeque<Piece>,
    spare: Vec<Piece>,
    /// What the estimator's own run leaves of a hop, where the last piece ends in its filter.
    own: Option<Piece>,
    adjoint: Adjoint,
    counting: Option<Counting>,
    work: Work,
    time_s: Vec<f64>,
    smoothed: Vec<Mixed>,
}

impl Lag {
    /// Rows come this many samples later; the estimator keeps a log and gives no rows.
    pub fn new(estimator: Estimator, lag: usize) -> Self {
        let (adjoint, work) = (Adjoint::nothing(&estimator.model), Work::new(&estimator.model));
        Self {
            estimator,
            lag,
            hop: (lag / HOPS).max(1),
            before: None,
            given: 0,
            pushed: 0,
            pieces: VecDeque::new(),
            spare: Vec::new(),
            own: None,
            adjoint,
            counting: None,
            work,
            time_s: Vec::new(),
            smoothed: Vec::new(),
        }
    }

    /// All that is remembered.
    pub fn memory(&self) -> LagMemory {
        let log = self.estimator.log.as_ref();
        LagMemory {
            estimator: self.estimator.memory.clone(),
            begin: log.map(|log| log.begin.clone()),
            samples: log.map_or_else(|| Samples::none(self.estimator.model.axes()), |log| log.samples.clone()),
            decided: log.map_or_else(Decided::default, |log| log.decided.clone()),
            before: self.before.clone(),
            given: self.given,
            pushed: self.pushed,
        }
    }

    /// Goes on from what a stream with the same settings remembered; false: it does not fit.
    pub fn restore(&mut self, memory: LagMemory) -> bool {
        let model = &self.estimator.model;
        let fits = memory.samples.consistent(model.axes())
            && memory.decided.fits(model.channels.len())
            && memory.before.as_ref().is_none_or(|one| one.fits(model))
            && memory.given <= memory.samples.len()
            && memory.begin.as_ref().is_none_or(|one| one.fits(model.axes()));
        if !fits || !self.estimator.restore(memory.estimator) {
            return false;
        }
        let (first_s, origin_ns) = (self.estimator.memory.first_s, self.estimator.origin_ns());
        let (samples, decided) = (memory.samples, memory.decided);
        let filled = |begin| Log { samples, decided, ..Log::new(begin, first_s, origin_ns, 0) };
        self.estimator.log = memory.begin.map(filled);
        (self.before, self.given, self.pushed) = (memory.before, memory.given, memory.pushed);
        self.pieces.clear();
        (self.own, self.counting) = (None, None);
        true
    }

    /// Takes samples, and adds what is due.
    pub fn push(&mut self, samples: View, whole: &mut Option<Output>) {
        if samples.len() > self.hop {
            whole.get_or_insert_default().rows.get_or_insert_default().reserve(samples.len());
        }
        let mut first = 0;
        while first < samples.len() {
            let done = (self.pushed % self.hop as u64) as usize;
            if done == 0 {
                self.begin_hop();
            }
            let end = samples.len().min(first + self.hop - done);
            let back = self.own.as_mut().map(|piece| &mut piece.way);
            self.estimator.push(samples.part(first, end), back, whole);
            self.pushed += (end - first) as u64;
            first = end;
            if self.pushed % self.hop as u64 == 0 {
                self.move_on(self.lag, whole);
            }
        }
    }

    /// Adds the rows that are held still, and what the estimator says at the end.
    pub fn finish(&mut self, whole: &mut Option<Output>) {
        self.estimator.finish(whole);
        self.move_on(0, whole);
    }

    /// Lets the estimator's own run over the next hop leave what it finds, where the last piece ends in its filter.
    fn begin_hop(&mut self) {
        self.spare.extend(self.own.take());
        let (Some(last), Some(filter)) = (self.pieces.back(), &self.estimator.memory.filter) else { return };
        if last.settled
            && self.estimator.one_past
            && self.estimator.memory.clocks.is_plain()
            && (last.own || last.after.is_at(filter))
        {
            let mut piece = self.spare.pop().unwrap_or_else(|| Piece::new(filter.best_alone()));
            piece.way.restart(&self.estimator.model, filter.clock.time_s);
            self.own = Some(piece);
        }
    }

    /// Gives out the rows that are older than the lag, and drops what is decided and not needed any more.
    fn move_on(&mut self, lag: usize, whole: &mut Option<Output>) {
        let model = &self.estimator.model;
        let Some(log) = &self.estimator.log else { return };
        if self.before.is_none() {
            self.before = Some(Filter::begun(&log.begin, &self.estimator.settings, model));
        }
        let due = log.samples.len().saturating_sub(lag);
        self.take_own();
        if due > self.given {
            let rows = whole.get_or_insert_default().rows.get_or_insert_default();
            self.smoothed(due, rows);
            self.drop_settled(due);
        }
    }

    /// Adds the rows of the window from those given out on up to before sample `due`.
    fn smoothed(&mut self, due: usize, rows: &mut Rows) {
        let open = self.estimator.memory.undecided.all();
        self.note_changed();
        self.run_forward(&open);
        let (Some(log), Some(before)) = (&self.estimator.log, &self.before) else { return };
        let model = &self.estimator.model;
        let parts = [&log.decided, &open];
        let recounted = !self.counting.as_ref().is_some_and(|one| one.holds(model, before.hyps.best(), &parts));
        if recounted {
            self.counting = Some(Counting::new(model, before.hyps.best(), &parts));
        }
        let Some(counting) = &self.counting else { return };
        let last = self.pieces.back().map_or(before, |piece| &piece.after).hyps.best();
        let view = Counted { model, counting, last };
        self.adjoint.restart(recounted);
        let first_ns = instant(log.first_s, log.origin_ns);
        let (samples, mut end) = (log.samples.view(), log.samples.len());
        let count = (self.given..due).filter(|&k| samples.is_row(k, first_ns)).count();
        let mut place = rows.add_zeros(model.axes(), count);
        let alternatives = Alternatives::of(&self.estimator);
        let bank = self.estimator.memory.clocks.bank.as_ref();
        let weights = bank.map(|bank| bank.weights(model));
        for piece in self.pieces.iter().rev() {
            let first = end - piece.way.len();
            let own = first.max(self.given)..end.min(due).max(first);
            let wanted = own.start.min(own.end) - first..own.end - first;
            self.adjoint.pass(&piece.way, &view, wanted.clone(), &mut self.smoothed);
            for (k, one) in wanted.zip(self.smoothed.chunks(samples.axes)).rev() {
                if samples.is_row(first + k, first_ns) {
                    place -= 1;
                    rows.put(place, samples.time_ns[first + k], one, |a| piece.way.status(k, a));
                    if let Some(alternatives) = &alternatives {
                        alternatives.widen(rows, place, since(samples.time_ns[first + k], log.origin_ns));
                    }
                    if let (Some(bank), Some(weights)) = (bank, &weights) {
                        mix(rows, place, bank, weights);
                    }
                }
            }
            if first <= self.given {
                break;
            }
            end = first;
        }
    }

    /// Where what was decided has changed as a clock stepped, the pieces from there on are looked at again.
    fn note_changed(&mut self) {
        let Some(changed_s) = self.estimator.memory.clocks.changed_s.take() else { return };
        for piece in self.pieces.iter_mut().filter(|piece| piece.after.clock.time_s > changed_s) {
            piece.settled = false;
        }
    }

    /// Takes what the estimator's own run left of the last hop as a piece, where it is whole.
    fn take_own(&mut self) {
        let (Some(mut piece), Some(filter), Some(log)) =
            (self.own.take(), &self.estimator.memory.filter, &self.estimator.log)
        else {
            return;
        };
        let before: usize = self.pieces.iter().map(|piece| piece.way.len()).sum();
        if before + piece.way.len() == log.samples.len() {
            piece.after.copy_best(filter);
            (piece.settled, piece.own) = (true, true);
            self.pieces.push_back(piece);
        } else {
            self.spare.push(piece);
        }
    }

    /// Runs the filter over the pieces of the window that are new, or of which something is decided otherwise now.
    ///
    /// Pieces are hops, counted from the first sample that was pushed.
    fn run_forward(&mut self, open: &Decided) {
        let (Some(log), Some(before)) = (&self.estimator.log, &self.before) else { return };
        let (model, samples, count) = (&self.estimator.model, log.samples.view(), log.samples.len());
        // Of later times measurements may come still, where stamps are late.
        let complete_s = self.estimator.memory.filter.as_ref().map_or(f64::INFINITY, |filter| filter.clock.time_s);
        // The window's first sample was, from the beginning of a hop on, the one of this number.
        let ahead = self.hop - (count + self.hop - (self.pushed % self.hop as u64) as usize) % self.hop;
        let (mut first, mut number, mut done) = (0, 0, 0);
        while first < count {
            let end = count.min(first + self.hop - (first + ahead) % self.hop);
            let end_s = since(samples.time_ns[end - 1], log.origin_ns);
            let until = count_until(&log.decided.items, end_s);
            let all_final = until < log.decided.len() || open.is_empty();
            let settled = all_final && end_s <= complete_s;
            let until = if all_final { until } else { until + count_until(&open.items, end_s) };
            let items = (done..until).map(|j| match log.decided.items.get(j) {
                Some(&item) => (item, log.decided.decisions[j]),
                None => (open.items[j - log.decided.len()], open.decisions[j - log.decided.len()]),
            });
            done = until;
            if let Some(piece) = self.pieces.get_mut(number).filter(|piece| piece.holds(end - first, items.clone())) {
                piece.settled = piece.settled || settled;
            } else {
                self.spare.extend(self.pieces.drain(number..));
                let start = number.checked_sub(1).map_or(before, |last| &self.pieces[last].after);
                let mut piece = self.spare.pop().unwrap_or_else(|| Piece::new(start.clone()));
                piece.after.copy_best(start);
                piece.way.restart(model, start.clock.time_s);
                (piece.items, piece.decisions) = items.unzip();
                (piece.settled, piece.own) = (settled, false);
                let samples = samples.part(first, end);
                samples.seconds(log.origin_ns, &mut self.time_s);
                piece.run(model, samples, &self.time_s, &mut self.work);
                self.pieces.push_back(piece);
            }
            (first, number) = (end, number + 1);
        }
    }

    /// Drops the pieces before what is given out and decided.
    fn drop_settled(&mut self, due: usize) {
        let memory = &self.estimator.memory;
        // What a bank of clocks decides anew begins with a filter that is kept.
        let first_s = [memory.undecided.first_s(), memory.clocks.open_from_s()].into_iter().flatten().reduce(f64::min);
        let (Some(log), Some(before)) = (&mut self.estimator.log, &mut self.before) else { return };
        let settled = match first_s {
            Some(first_s) => log.samples.time_ns.partition_point(|&one| since(one, log.origin_ns) < first_s),
            None => due,
        };
        let mut dropped = 0;
        let is_old = |piece: &&Piece, dropped: usize| dropped + piece.way.len() <= due.min(settled);
        while self.pieces.front().filter(|piece| is_old(piece, dropped)).is_some() {
            let Some(mut piece) = self.pieces.pop_front() else { break };
            dropped += piece.way.len();
            std::mem::swap(before, &mut piece.after);
            self.spare.push(piece);
        }
        if dropped > 0 {
            let end_s = since(log.samples.time_ns[dropped - 1], log.origin_ns);
            log.decided.drop_first(count_until(&log.decided.items, end_s));
            log.samples.drop_first(dropped);
        }
        log.filters.clear();
        self.given = due - dropped;
    }
}

/// What else the motion may have been where hypotheses are not decided yet: by how much each differs from the best.
struct Alternatives {
    /// Since when they have not one past, s.
    since_s: f64,
    now_s: f64,
    /// Its probability, and along each axis the differences of displacement, velocity and bias now.
    others: Vec<(f64, Vec<[f64; MOTION_STATES]>)>,
}

impl Alternatives {
    fn of(estimator: &Estimator) -> Option<Self> {
        let (memory, model) = (&estimator.memory, &estimator.model);
        let (since_s, filter) = (memory.undecided.first_s()?, memory.filter.as_ref()?);
        let now = memory.clocks.leader.as_ref().unwrap_or(filter);
        let hyps = now.hyps.all();
        let weight = |hyp: &Hypothesis| hyp.memory.weight.exp();
        let total: f64 = hyps.iter().map(weight).sum();
        let motion = |hyp: &Hypothesis, axis: usize| {
            let state = |j: usize| {
                let sensitivities = &hyp.x.row(j)[1..];
                hyp.x[(j, 0)] + sensitivities.iter().zip(&hyp.parameters).map(|(one, value)| one * value).sum::<f64>()
            };
            let datum = model.datum.as_ref().map_or(0.0, |datum| state(datum[axis]));
            let i = motion_of(axis);
            [state(i) - datum, state(i + 1), state(i + 2)]
        };
        let best: Vec<_> = (0..model.axes()).map(|a| motion(&hyps[0], a)).collect();
        let off = |hyp: &Hypothesis| {
            let apart = |a: usize| std::array::from_fn(|j| motion(hyp, a)[j] - best[a][j]);
            (weight(hyp) / total, (0..model.axes()).map(apart).collect())
        };
        Some(Self { since_s, now_s: now.clock.time_s, others: hyps[1..].iter().map(off).collect() })
    }

    /// Adds to the variances of a row at a time (s) what the alternatives are apart there: all of them follow the same
    /// acceleration.
    fn widen(&self, rows: &mut Rows, place: usize, at_s: f64) {
        if at_s < self.since_s {
            return;
        }
        let ago_s = self.now_s - at_s;
        for (weight, apart) in &self.others {
            for (out, [moved, speed, bias]) in rows.axes.iter_mut().zip(apart) {
                let off = moved - speed * ago_s - 0.5 * bias * ago_s * ago_s;
                out.variance[place] += weight * off * off;
            }
        }
    }
}

/// Makes a row that of no step of a clock and of all that may have been, by their weights: the others' as they were
/// found up to the row's time.
fn mix(rows: &mut Rows, place: usize, bank: &Bank, weights: &[f64]) {
    let time_ns = rows.time_ns[place];
    for (a, out) in rows.axes.iter_mut().enumerate() {
        let mut mixture = Mixture::default();
        let (value, variance, velocity) = (out.displacement[place], out.variance[place], out.velocity[place]);
        mixture.add(weights[0], Mixed { value, variance, velocity });
        let members = bank.members.iter().map(|one| one.rows.at(time_ns, a));
        for (&weight, row) in weights[1..].iter().zip(members) {
            mixture.add(weight, row.unwrap_or(Mixed { value, variance, velocity }));
        }
        let mixed = mixture.mixed();
        (out.displacement[place], out.variance[place], out.velocity[place]) =
            (mixed.value, mixed.variance, mixed.velocity);
    }
}

impl Piece {
    fn new(after: Filter) -> Self {
        Self { way: WayBack::default(), after, settled: false, own: false, items: Vec::new(), decisions: Vec::new() }
    }

    /// Whether it was run over this many samples with these items as they are decided now.
    fn holds(&self, samples: usize, mut items: impl Iterator<Item = (Timed, Decision)>) -> bool {
        let run_with = || self.items.iter().copied().zip(self.decisions.iter().copied());
        let mut is_same = || run_with().all(|one| items.next() == Some(one)) && items.next().is_none();
        self.way.len() == samples && (self.settled || is_same())
    }

    fn run(&mut self, model: &Model, samples: View, time_s: &[f64], work: &mut Work) {
        let Self { way, after, items, decisions, .. } = self;
        let mut block = Block { samples, time_s, items, first_ns: 0 };
        after.run(model, &mut block, &mut Judge::Decided { decisions, back: Some(way) }, None, work);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_alternatives_are_apart_follows_their_motion_back() {
        // x(t) = 3 + 2 t - 0.4 t² / 2 from t = 1 s on, and nothing apart before it.
        let apart = |t: f64| 3.0 + 2.0 * t - 0.2 * t * t;
        let now_s = 2.5;
        let others = vec![(0.25, vec![[apart(now_s), 2.0 - 0.4 * now_s, 0.4]])];
        let alternatives = Alternatives { since_s: 1.0, now_s, others };
        let mut rows = Rows::default();
        rows.add_zeros(1, 3);
        for (place, at_s) in [0.9, 1.0, 2.0].into_iter().enumerate() {
            alternatives.widen(&mut rows, place, at_s);
        }
        assert_eq!(rows.axes[0].variance[0], 0.0);
        for (place, at_s) in [(1, 1.0), (2, 2.0)] {
            let expected = 0.25 * apart(at_s) * apart(at_s);
            assert!((rows.axes[0].variance[place] - expected).abs() < 1e-9 * expected);
        }
    }
}
