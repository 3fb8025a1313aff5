//! The estimator's rows given out a number of samples, or up to a quarter more, later, smoothed by what came until then.
//!
//! The window moves on in hops of a quarter of the lag, counted in samples from the first one, so that any cutting of the
//! input gives the same rows. What the filter left of the window is kept, and run again only from where something is decided
//! otherwise: of a hop only the rows that are given out are smoothed, behind them the adjoint is carried from measurement to
//! measurement. Innovations and events are those of the estimator, as they come.

use super::cause::Decision;
use super::counting::Counting;
use super::decided::Decided;
use super::innovation::{Mixed, Work};
use super::log::Log;
use super::model::{Model, instant, since};
use super::output::Output;
use super::rows::Rows;
use super::run::{Block, Filter, Judge};
use super::samples::{Samples, View};
use super::smoother::Adjoint;
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
    window: Option<Window>,
    pushed: u64,
}

/// The samples that are not given out yet, and those after which the filter is run again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Window {
    samples: Samples,
    decided: Decided,
    /// The filter before the first sample.
    before: Filter,
    /// How many of the samples were given out already.
    given: usize,
}

/// What a run over a piece of the window left.
#[derive(Clone, Debug)]
struct Piece {
    way: WayBack,
    after: Filter,
    /// The items that it was run with, as it had them before and after it put those of one instant in order, and what they
    /// were taken for.
    items: Vec<Timed>,
    decisions: Vec<Decision>,
}

/// A fixed-lag stream.
#[derive(Clone, Debug)]
pub struct Lag {
    /// The estimator whose decisions it takes.
    pub estimator: Estimator,
    lag: usize,
    hop: usize,
    window: Option<Window>,
    pushed: u64,
    pieces: VecDeque<Piece>,
    spare: Vec<Piece>,
    adjoint: Adjoint,
    work: Work,
    time_s: Vec<f64>,
    found: Vec<Mixed>,
}

impl Lag {
    /// Rows come so many samples later; the estimator keeps a log and gives no rows.
    pub fn new(estimator: Estimator, lag: usize) -> Self {
        let (adjoint, work) = (Adjoint::nothing(estimator.model()), Work::new(estimator.model()));
        Self {
            estimator,
            lag,
            hop: (lag / HOPS).max(1),
            window: None,
            pushed: 0,
            pieces: VecDeque::new(),
            spare: Vec::new(),
            adjoint,
            work,
            time_s: Vec::new(),
            found: Vec::new(),
        }
    }

    /// How many samples, decided and undecided measurements are held.
    pub fn held(&mut self) -> (usize, usize, usize) {
        self.collect();
        let own = self.window.as_ref().map_or((0, 0), |one| (one.samples.len(), one.decided.len()));
        (own.0, own.1, self.estimator.undecided().len())
    }

    /// All that is remembered.
    pub fn memory(&mut self) -> LagMemory {
        self.collect();
        LagMemory {
            estimator: self.estimator.memory().clone(),
            begin: self.estimator.log().map(|log| log.begin.clone()),
            window: self.window.clone(),
            pushed: self.pushed,
        }
    }

    /// Goes on from what a stream with the same settings remembered; false: it does not fit.
    pub fn restore(&mut self, memory: LagMemory) -> bool {
        let model = self.estimator.model();
        let fits = memory.window.as_ref().is_none_or(|one| one.fits(model))
            && memory.begin.as_ref().is_none_or(|one| one.fits(model.axes()));
        if !fits || !self.estimator.restore(memory.estimator) {
            return false;
        }
        let (first_s, origin_ns) = (self.estimator.first_s(), self.estimator.origin_ns());
        let axes = self.estimator.model().axes();
        self.estimator.set_log(memory.begin.map(|begin| Log::new(begin, first_s, origin_ns, axes)));
        (self.window, self.pushed) = (memory.window, memory.pushed);
        self.pieces.clear();
        true
    }

    /// Takes samples; returns what is due.
    pub fn push(&mut self, samples: View) -> Option<Output> {
        let (mut whole, mut first) = (None, 0);
        while first < samples.len() {
            let hop = self.hop - (self.pushed % self.hop as u64) as usize;
            let end = samples.len().min(first + hop);
            if let Some(output) = self.estimator.push(samples.part(first, end)) {
                Output::add(&mut whole, output);
            }
            self.pushed += (end - first) as u64;
            first = end;
            if self.pushed % self.hop as u64 == 0 {
                self.move_on(self.lag, &mut whole);
            }
        }
        whole
    }

    /// The rows that are held still, and what the estimator says at the end.
    pub fn finish(&mut self) -> Option<Output> {
        let mut whole = self.estimator.finish();
        self.move_on(0, &mut whole);
        whole
    }

    /// Takes over what the estimator has logged.
    fn collect(&mut self) {
        if self.window.is_none() {
            let (Some(log), model) = (self.estimator.log(), self.estimator.model()) else { return };
            self.window = Some(Window {
                samples: Samples::none(model.axes()),
                decided: Decided::default(),
                before: Filter::begun(&log.begin, self.estimator.settings(), model),
                given: 0,
            });
        }
        let (Some(log), Some(window)) = (self.estimator.log_mut(), &mut self.window) else { return };
        window.samples.extend(log.samples.view());
        window.decided.extend(&log.decided);
        log.samples.drop_first(log.samples.len());
        log.decided.drop_first(log.decided.len());
        log.filters.clear();
    }

    /// Gives out the rows that are older than the lag, and drops what is decided and not needed any more.
    fn move_on(&mut self, lag: usize, whole: &mut Option<Output>) {
        self.collect();
        let Some(mut window) = self.window.take() else { return };
        let due = window.samples.len().saturating_sub(lag);
        if due > window.given {
            let rows = whole.get_or_insert_default().rows.get_or_insert_default();
            self.smoothed(&window, due, rows);
            self.drop_settled(&mut window, due);
        }
        self.window = Some(window);
    }

    /// Adds the rows of the window from those given out on up to before sample `due`.
    fn smoothed(&mut self, window: &Window, due: usize, rows: &mut Rows) {
        let open = self.estimator.undecided().best();
        self.run_forward(window, &open);
        let (model, origin_ns) = (self.estimator.model(), self.estimator.origin_ns());
        let last = self.pieces.back().map_or(&window.before, |piece| &piece.after).hyps.best();
        let counting = Counting::new(model, window.before.hyps.best(), &[&window.decided, &open], last);
        self.adjoint.restart();
        let first_ns = instant(self.estimator.first_s(), origin_ns);
        let (view, mut end) = (window.samples.view(), window.samples.len());
        let mut place = rows.add_zeros(model.axes(), (window.given..due).filter(|&k| view.is_row(k, first_ns)).count());
        let mut found = std::mem::take(&mut self.found);
        for piece in self.pieces.iter().rev() {
            let first = end - piece.way.len();
            let own = first.max(window.given)..end.min(due).max(first);
            let wanted = own.start.min(own.end) - first..own.end - first;
            self.adjoint.pass(&piece.way, &counting, wanted.clone(), &mut found);
            for (k, one) in wanted.zip(found.chunks(view.axes)).rev() {
                if view.is_row(first + k, first_ns) {
                    place -= 1;
                    rows.put(place, view.time_ns[first + k], one, |a| piece.way.status(k, a));
                }
            }
            if first <= window.given {
                break;
            }
            end = first;
        }
        self.found = found;
    }

    /// Runs the filter over the pieces of the window that are new, or of which something is decided otherwise now.
    ///
    /// Pieces are hops, counted back from the window's end.
    fn run_forward(&mut self, window: &Window, open: &Decided) {
        let model = self.estimator.model();
        let origin_ns = self.estimator.origin_ns();
        let (view, count) = (window.samples.view(), window.samples.len());
        let hop = self.hop;
        let (mut first, mut number, mut done) = (0, 0, 0);
        let total = window.decided.len() + open.len();
        while first < count {
            let end = count.min(first + hop - (first + hop - count % hop) % hop);
            let end_s = since(view.time_ns[end - 1], origin_ns);
            let until = count_until(&window.decided.items, end_s);
            let until = if until == window.decided.len() { until + count_until(&open.items, end_s) } else { until };
            let range = done..until.min(total);
            done = range.end;
            if !self.pieces.get(number).is_some_and(|piece| piece.holds(end - first, window, open, range.clone())) {
                self.spare.extend(self.pieces.drain(number..));
                let before = match number {
                    0 => &window.before,
                    _ => &self.pieces[number - 1].after,
                };
                let mut piece = self.spare.pop().unwrap_or_else(|| Piece::new(before.clone()));
                piece.start(before, window, open, range, model);
                let samples = view.part(first, end);
                samples.seconds(origin_ns, &mut self.time_s);
                piece.run(model, samples, &self.time_s, &mut self.work);
                self.pieces.push_back(piece);
            }
            (first, number) = (end, number + 1);
        }
    }

    /// Drops the pieces before what is given out and decided.
    fn drop_settled(&mut self, window: &mut Window, due: usize) {
        let origin_ns = self.estimator.origin_ns();
        let settled = match self.estimator.undecided().first_s() {
            Some(first_s) => window.samples.time_ns.partition_point(|&one| since(one, origin_ns) < first_s),
            None => due,
        };
        let mut dropped = 0;
        while let Some(piece) = self.pieces.front() {
            if dropped + piece.way.len() > due.min(settled) {
                break;
            }
            dropped += piece.way.len();
            if let Some(mut piece) = self.pieces.pop_front() {
                std::mem::swap(&mut window.before, &mut piece.after);
                self.spare.push(piece);
            }
        }
        if dropped > 0 {
            let end_s = since(window.samples.time_ns[dropped - 1], origin_ns);
            let old = count_until(&window.decided.items, end_s);
            window.decided.drop_first(old);
            window.samples.drop_first(dropped);
        }
        window.given = due - dropped;
    }
}

impl Window {
    fn fits(&self, model: &Model) -> bool {
        self.samples.consistent(model.axes())
            && self.decided.fits(model.channels.len())
            && self.before.fits(model)
            && self.given <= self.samples.len()
    }

    /// Item `j` of the decided ones and the open ones after them.
    fn item(&self, open: &Decided, j: usize) -> (Timed, Decision) {
        match self.decided.items.get(j) {
            Some(&item) => (item, self.decided.decisions[j]),
            None => {
                let place = j - self.decided.len();
                (open.items[place], open.decisions[place])
            }
        }
    }
}

impl Piece {
    fn new(after: Filter) -> Self {
        Self { way: WayBack::default(), after, items: Vec::new(), decisions: Vec::new() }
    }

    /// Whether it was run over so many samples with these items as they are decided now.
    fn holds(&self, samples: usize, window: &Window, open: &Decided, range: std::ops::Range<usize>) -> bool {
        self.way.len() == samples
            && self.items.len() == range.len()
            && range.zip(self.items.iter().zip(&self.decisions)).all(|(j, (item, decision))| {
                let now = window.item(open, j);
                now.0 == *item && now.1 == *decision
            })
    }

    /// Takes the items and the filter before its first sample.
    fn start(
        &mut self,
        before: &Filter,
        window: &Window,
        open: &Decided,
        range: std::ops::Range<usize>,
        model: &Model,
    ) {
        self.after.copy_best(before);
        self.way.restart(model, before.clock.time_s);
        self.items.clear();
        self.decisions.clear();
        for j in range {
            let (item, decision) = window.item(open, j);
            self.items.push(item);
            self.decisions.push(decision);
        }
    }

    fn run(&mut self, model: &Model, samples: View, time_s: &[f64], work: &mut Work) {
        let Self { way, after, items, decisions } = self;
        let mut block = Block { samples, time_s, items, first_ns: 0 };
        after.run(model, &mut block, &mut Judge::Decided { decisions, back: Some(way) }, None, work);
    }
}
