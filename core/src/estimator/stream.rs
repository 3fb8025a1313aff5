//! The estimator as a stream: any cutting of the input into pushes gives the same rows.
//!
//! Measurements wait for the samples that cover their time. Rows are held back until the first few measurements have
//! come: the first of them is then judged by those after it.

use super::clocks::Clocks;
use super::decided::{Log, Logged, MAX_UNDECIDED, Undecided, channels_exist};
use super::innovation::{Work, predict_value};
use super::model::{Model, instant, since};
use super::motion::GAP_STEPS;
use super::reports::{Report, Reports};
use super::rows::{Output, Rows, zero_variance};
use super::run::Filter;
use super::samples::{Integrated, Samples, View};
use super::settings::Settings;
use super::waiting::{Item, Measurement, Timed};
use super::way_back::WayBack;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// What bounds the memory.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// This many measurements may wait for the samples that cover them; older ones are dropped.
    pub waiting: usize,
    /// Samples that are run at once.
    pub block: usize,
}

/// All that an estimator remembers besides its log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Remembered {
    pub(crate) origin_ns: Option<i64>,
    /// Measurements before the first sample, from which times are counted.
    pub(crate) early: VecDeque<(i64, Measurement)>,
    /// Samples while rows are held back.
    pub(crate) held: Option<Samples>,
    pub(crate) waiting: VecDeque<Timed>,
    /// Until the filter, and all zeros, have begun.
    pub(crate) alone: Option<Integrated>,
    pub(crate) filter: Option<Filter>,
    pub(crate) first_s: f64,
    pub(crate) undecided: Undecided,
    pub(crate) reports: Reports,
    /// Of each channel whether its last measurements came too late.
    pub(crate) late: Vec<bool>,
    pub(crate) overflown: bool,
    /// Events that wait for the next rows.
    pub(crate) pending: Vec<Report>,
    /// What is known of the sensors' clocks.
    pub(crate) clocks: Clocks,
}

/// The estimator of one measuring point.
#[derive(Clone, Debug)]
pub struct Estimator {
    pub(crate) settings: Settings,
    pub(crate) model: Model,
    pub(crate) limits: Limits,
    pub(crate) keep_log: bool,
    pub(crate) give_rows: bool,
    pub(crate) memory: Remembered,
    pub(crate) log: Option<Log>,
    /// Whether what is decided is the past of all hypotheses.
    pub(crate) one_past: bool,
    pub(crate) work: Work,
    pub(crate) time_s: Vec<f64>,
    /// The items of a run.
    pub(crate) items: Vec<Timed>,
}

impl Estimator {
    /// Before anything is pushed; keep_log: keep all that a second pass needs; give_rows: rows are given out.
    pub fn new(settings: Settings, limits: Limits, keep_log: bool, give_rows: bool) -> Self {
        let (channels, model) = (settings.channels.len(), Model::new(&settings, 0));
        let memory = Remembered {
            origin_ns: None,
            early: VecDeque::new(),
            held: None,
            waiting: VecDeque::new(),
            alone: None,
            filter: None,
            first_s: f64::NAN,
            undecided: Undecided::default(),
            reports: Reports::new(channels),
            late: vec![false; channels],
            overflown: false,
            pending: Vec::new(),
            clocks: Clocks::new(channels, settings.axes),
        };
        let work = Work::new(&model);
        Self {
            settings,
            model,
            limits,
            keep_log,
            give_rows,
            memory,
            log: None,
            one_past: true,
            work,
            time_s: Vec::new(),
            items: Vec::new(),
        }
    }

    /// What times in s count from, ns.
    pub fn origin_ns(&self) -> i64 {
        self.memory.origin_ns.unwrap_or(0)
    }

    /// Goes on from what an estimator with the same settings remembered; false: it does not fit.
    pub fn restore(&mut self, memory: Remembered) -> bool {
        if !memory.fits(&self.settings, &self.model) {
            return false;
        }
        self.memory = memory;
        self.model = Model::new(&self.settings, self.origin_ns());
        true
    }

    /// Takes samples, which are later than all before, and adds what is due; back: takes what a pass back needs, while
    /// one hypothesis takes all measurements as good.
    pub fn push(&mut self, samples: View, mut back: Option<&mut WayBack>, outputs: &mut Option<Output>) {
        for first in (0..samples.len()).step_by(self.limits.block) {
            let end = samples.len().min(first + self.limits.block);
            if let Some(rows) = outputs.as_mut().and_then(|one| one.rows.as_mut()).filter(|_| self.give_rows) {
                rows.reserve(samples.len() - first);
            }
            if let Some(log) = self.log.as_mut() {
                log.samples.reserve(samples.len() - first);
            }
            self.push_block(samples.part(first, end), back.as_deref_mut(), outputs);
        }
    }

    fn push_block(&mut self, samples: View, back: Option<&mut WayBack>, outputs: &mut Option<Output>) {
        if self.memory.origin_ns.is_none() {
            self.memory.origin_ns = samples.time_ns.first().copied();
            let origin_ns = self.origin_ns();
            let early = std::mem::take(&mut self.memory.early);
            let timed = |(stamp_ns, row)| Timed { at_s: since(stamp_ns, origin_ns), item: Item::Measured(row) };
            self.memory.waiting.extend(early.into_iter().map(timed));
            self.order_waiting();
        }
        if self.memory.filter.is_none() || self.memory.alone.is_some() {
            let (alone, origin_ns) = (self.memory.alone.take(), self.origin_ns());
            self.memory.alone = Integrated::after(alone, samples, origin_ns, &self.settings.bias_m_s2);
        }
        if self.memory.filter.is_some() {
            self.run(samples, back, outputs);
        } else {
            self.hold(samples, outputs);
        }
        let mut channels = 0..self.settings.channels.len();
        if self.memory.alone.is_some() && self.memory.filter.is_some() && channels.all(|c| self.counts(c)) {
            self.memory.alone = None;
        }
    }

    /// Whether the filter's displacement counts from a channel's zero: an unknown zero has been met, or of the known
    /// ones of the axis one.
    fn counts(&self, c: usize) -> bool {
        let Some(filter) = &self.memory.filter else { return false };
        let marks = &filter.hyps.best().marks;
        let is_known = |c: usize| self.model.channels[c].zero_variance.is_some();
        let axis = self.model.channels[c].row.axis;
        if !is_known(c) || !self.model.channels[c].places {
            return marks[c].begun;
        }
        let own = |k: usize| self.model.channels[k].places && self.model.channels[k].row.axis == axis;
        (0..marks.len()).any(|k| is_known(k) && own(k) && marks[k].begun)
    }

    /// Holds samples until rows are given out.
    fn hold(&mut self, samples: View, outputs: &mut Option<Output>) {
        let held = match self.memory.held.take() {
            Some(mut held) => {
                held.extend(samples);
                held
            }
            None => samples.owned(),
        };
        self.begin(held, false, outputs);
    }

    /// The rows of samples; where they are logged, run up to where the log keeps the filter, and then on.
    pub(super) fn run(&mut self, samples: View, mut back: Option<&mut WayBack>, outputs: &mut Option<Output>) {
        let mut first = 0;
        while first < samples.len() {
            let logged = self.log.as_ref().map_or(0, |log| log.samples.len());
            let end = samples.len().min(first + self.limits.block - logged % self.limits.block);
            self.run_clocked(samples.part(first, end), back.as_deref_mut(), outputs);
            first = end;
        }
    }

    /// How many of the waiting items are no later than an instant.
    pub(super) fn count_due(&self, until_s: f64) -> usize {
        self.memory.waiting.iter().take_while(|one| one.at_s <= until_s).count()
    }

    /// Takes the waiting items up to an instant as those of the next run.
    pub(super) fn take_due(&mut self, until_s: f64) {
        let count = self.count_due(until_s);
        self.items.clear();
        self.items.extend(self.memory.waiting.drain(..count));
        self.memory.overflown = self.memory.overflown && self.memory.waiting.len() > self.limits.waiting / 2;
    }

    /// After a run over samples: logs them, and what is decided now.
    pub(super) fn settle(&mut self, samples: View, output: &mut Output) {
        let best = self.memory.filter.as_ref().map(|filter| filter.hyps.best());
        output.zero_variance.clear();
        output.zero_variance.extend(
            (0..self.settings.axes).map(|a| {
                best.map_or(0.0, |hyp| zero_variance(hyp, a, &self.model)) + self.settings.unseen_common_m2[a]
            }),
        );
        let count = self.memory.filter.as_ref().map_or(0, |filter| filter.hyps.count());
        self.memory.undecided.settle(count);
        if self.memory.clocks.bank.is_none() {
            self.report(output);
        }
        let (Some(log), Some(filter)) = (self.log.as_mut(), self.memory.filter.as_ref()) else { return };
        log.samples.extend(samples);
        // What was decided because more would have been undecided need not be the best hypothesis's past.
        self.one_past = self.one_past && self.memory.undecided.len() < MAX_UNDECIDED;
        let logged = log.samples.len();
        if logged % self.limits.block == 0 && self.one_past && self.memory.clocks.is_plain() {
            let open = self.memory.undecided.best().decisions;
            log.filters.insert(logged, Logged { filter: filter.best_alone(), decided: log.decided.len(), open });
        }
    }

    /// Logs what is final, and gives its events after those that waited.
    pub(super) fn report(&mut self, output: &mut Output) {
        let origin_ns = self.origin_ns();
        let Remembered { undecided, reports, pending, .. } = &mut self.memory;
        if let Some(log) = self.log.as_mut() {
            log.decided.extend(&undecided.settled);
        }
        output.reports.append(pending);
        output.reports.extend(reports.after(&undecided.settled, &self.model, origin_ns));
        undecided.settled.clear();
    }

    /// Adds the rows that are held back still, and events that the record's end completes.
    pub fn finish(&mut self, outputs: &mut Option<Output>) {
        if self.memory.filter.is_none() {
            if let Some(held) = self.memory.held.take() {
                self.begin(held, true, outputs);
            }
        }
        let mut output = Output::default();
        if self.memory.filter.is_none() {
            output.reports.clone_from(&self.memory.pending);
        } else {
            self.finish_clocks(&mut output);
            let decided = std::mem::take(&mut self.memory.undecided).all();
            self.memory.undecided.settled = decided;
            self.report(&mut output);
            output.reports.extend(self.memory.reports.ended(self.origin_ns()));
        }
        if !output.reports.is_empty() {
            outputs.get_or_insert_default().reports.append(&mut output.reports);
        }
    }

    /// The row at the newest sample as the filter has it, before what comes later smooths it; None where there is none,
    /// or a clock may have stepped. Needs the log.
    pub fn head(&self) -> Option<Rows> {
        let filter = self.memory.filter.as_ref().filter(|_| self.memory.clocks.is_plain())?;
        let samples = self.log.as_ref()?.samples.view();
        let newest = samples.part(samples.len().checked_sub(1)?, samples.len());
        let is_there = since(newest.time_ns[0], self.origin_ns()) == filter.clock.time_s;
        let first_ns = instant(self.memory.first_s, self.origin_ns());
        let mut work = Work::new(&self.model);
        let rows = filter.row_now(&self.model, (newest, first_ns), &[], &mut work);
        (is_there && !rows.is_empty()).then_some(rows)
    }

    /// Expected measurement of a channel at a time after the last sample, in its unit, and the variance of that.
    ///
    /// The last acceleration is held over a step or two; None where no samples come. Until the filter and the channel's
    /// zero have begun only the acceleration tells: the variance is infinite before the filter begins and NaN
    /// afterwards, when measurements from before come too late.
    pub fn predict(&self, c: usize, time_ns: i64) -> Option<(f64, f64)> {
        let time_s = since(time_ns, self.origin_ns());
        let Some(filter) = self.memory.filter.as_ref().filter(|_| self.counts(c)) else {
            let row = &self.model.channels[c].row;
            let variance = if self.memory.filter.is_some() { f64::NAN } else { f64::INFINITY };
            return Some((row.units_per_m * self.memory.alone.as_ref()?.at(time_s, row.axis)?, variance));
        };
        let (filter, shift_s) = (self.memory.clocks.leader.as_ref().unwrap_or(filter), self.memory.clocks.offset_s(c));
        let ahead_s = GAP_STEPS * filter.clock.step_s;
        if time_s - filter.clock.time_s > ahead_s {
            return None;
        }
        let at_s = (time_s + shift_s).clamp(filter.clock.time_s - ahead_s, filter.clock.time_s + ahead_s);
        let (value, variance) = predict_value(at_s, c, &filter.motion, &filter.clock, &filter.hyps, &self.model);
        let (g, channel) = (self.model.channels[c].row.units_per_m, &self.model.channels[c]);
        // What it measures of a time farther away is anywhere in the motion.
        let is_near = at_s == time_s + shift_s;
        Some((value, if is_near { variance } else { variance + g * g * channel.apart_m2 }))
    }
}

impl Remembered {
    /// Whether it is of an estimator with these settings.
    fn fits(&self, settings: &Settings, model: &Model) -> bool {
        let (channels, axes) = (settings.channels.len(), settings.axes);
        let count = self.filter.as_ref().map_or(0, |filter| filter.hyps.count());
        self.filter.as_ref().is_none_or(|one| one.fits(model))
            && self.held.as_ref().is_none_or(|one| one.consistent(axes))
            && self.alone.as_ref().is_none_or(|one| one.fits(axes))
            && self.early.iter().all(|one| one.1.channel < channels)
            && channels_exist(self.waiting.iter(), channels)
            && self.undecided.fits(count, channels)
            && self.reports.fits(channels)
            && self.late.len() == channels
            && self.clocks.fits(model)
            && self.pending.iter().all(|one| one.channel < channels.max(1))
    }
}
