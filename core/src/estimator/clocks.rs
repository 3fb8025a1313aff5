//! The estimator with clocks that step: while nothing is suspected it runs as it is; where a clock may have stepped a
//! bank of offsets ([`super::clock_bank`]) runs together with it until one offset is left, which is then the sensor's.
//!
//! A measurement is met at its instant: its stamp and the offset of its sensor's clock. Where stamps are late by some
//! time, the filter, its decisions and its log stay back by that, and rows come from a copy of the filter that is run
//! on to the newest sample. So what is decided holds items at their instants alone, and what runs by that (the second
//! pass, the lag) knows of clocks nothing but that a parameter begins anew.

use super::clock_bank::{Bank, LINEAR_S, MAX_OFFSET_NS, REACH_S, Search, Step};
use super::decided::Undecided;
use super::innovation::Work;
use super::model::{Model, instant, since};
use super::reports::{Report, What};
use super::rows::{Innovations, Output, Rows, mixed};
use super::run::{Block, Filter, Judge};
use super::samples::{Samples, View};
use super::stream::Estimator;
use super::waiting::{Timed, put_in_order};
use super::way_back::WayBack;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The filter is kept at intervals of this, s.
const KEPT_EACH_S: f64 = 0.5;
/// From before this on, s: all offsets of a bank can be met at all measurements at which a step is looked for.
const KEPT_S: f64 = REACH_S + 1e-9 * MAX_OFFSET_NS as f64;

/// What an estimator knows of the sensors' clocks, and keeps to look into them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Clocks {
    /// What is added to each channel's stamps, ns.
    pub offsets_ns: Vec<i64>,
    /// The filter at some instants of the last seconds.
    kept: VecDeque<Filter>,
    /// The samples since the first of these, and what was measured.
    samples: Samples,
    items: Vec<Timed>,
    /// The steps that may have been.
    pub bank: Option<Bank>,
    /// Where the filter stays back, a copy that is at the newest sample.
    pub leader: Option<Filter>,
    /// Until when (s) what was decided still holds, where it has changed.
    #[serde(skip)]
    pub changed_s: Option<f64>,
}

impl Clocks {
    /// No clock has stepped.
    pub fn new(channels: usize, axes: usize) -> Self {
        Self { offsets_ns: vec![0; channels], samples: Samples::none(axes), ..Self::default() }
    }

    /// Whether it is of the model's shape.
    pub fn fits(&self, model: &Model) -> bool {
        self.offsets_ns.len() == model.channels.len()
            && self.samples.consistent(model.axes())
            && self.kept.iter().chain(&self.leader).all(|one| one.fits(model))
            && super::decided::channels_exist(self.items.iter(), model.channels.len())
            && self.bank.as_ref().is_none_or(|one| one.fits(model))
    }

    /// By how much the filter stays back, ns.
    pub fn behind_ns(&self) -> i64 {
        -self.offsets_ns.iter().copied().min().unwrap_or(0).min(0)
    }

    /// Whether the filter is at the newest sample, and nothing is suspected.
    pub fn is_plain(&self) -> bool {
        self.bank.is_none() && self.behind_ns() == 0
    }

    /// What is added to a channel's stamps, s.
    pub fn offset_s(&self, c: usize) -> f64 {
        1e-9 * self.offsets_ns[c] as f64
    }

    /// By how much each channel's stamps are ahead of the instants that its measurements are taken at, s.
    fn ahead_s(&self) -> Vec<f64> {
        self.offsets_ns.iter().map(|&one| -1e-9 * one.min(0) as f64).collect()
    }

    /// From when on (s) what is decided may change.
    pub fn open_from_s(&self) -> Option<f64> {
        self.kept.front().map(|one| one.clock.time_s)
    }

    /// Keeps a filter where it is time to, and drops what is too old; returns whether it is kept.
    fn keep(&mut self, filter: &Filter, origin_ns: i64) -> bool {
        let now_s = filter.clock.time_s;
        if self.bank.is_some() || self.kept.back().is_some_and(|one| now_s < one.clock.time_s + KEPT_EACH_S) {
            return false;
        }
        self.kept.push_back(filter.clone());
        while self.kept.get(1).is_some_and(|one| one.clock.time_s <= now_s - KEPT_S) {
            self.kept.pop_front();
        }
        let first_s = self.open_from_s().unwrap_or(now_s);
        self.items.retain(|one| one.at_s > first_s);
        let first_ns = instant(first_s, origin_ns);
        self.samples.drop_first(self.samples.time_ns.partition_point(|&one| one <= first_ns));
        true
    }
}

impl Estimator {
    /// The rows of samples; back: takes what a pass back needs, while the filter is at the newest sample.
    pub(super) fn run_clocked(&mut self, samples: View, mut back: Option<&mut WayBack>, outputs: &mut Option<Output>) {
        let mut first = 0;
        while first < samples.len() {
            let output = outputs.get_or_insert_default();
            output.innovations.resize_with(self.settings.channels.len(), Innovations::default);
            if self.keep_filter() {
                // What was left for a pass back is of before.
                back = None;
            }
            first += if self.memory.clocks.is_plain() {
                self.run_plain(samples.part(first, samples.len()), back.as_deref_mut(), output)
            } else {
                self.run_one(samples.part(first, first + 1), output);
                1
            };
        }
    }

    /// Runs up to where the filter is kept, or a clock is suspected to have stepped; returns over how many samples.
    fn run_plain(&mut self, samples: View, back: Option<&mut WayBack>, output: &mut Output) -> usize {
        let origin_ns = self.origin_ns();
        let Some(mut filter) = self.memory.filter.take() else { return samples.len() };
        let steps = self.model.channels.iter().any(|one| one.clock.is_some());
        samples.seconds(origin_ns, &mut self.time_s);
        if steps {
            let kept_s = self.memory.clocks.kept.back().map_or(0.0, |one| one.clock.time_s);
            let count = self.time_s.partition_point(|&one| one < kept_s + KEPT_EACH_S) + 1;
            self.time_s.truncate(count);
        }
        let samples = samples.part(0, self.time_s.len());
        self.take_due(self.time_s.last().copied().unwrap_or(f64::NEG_INFINITY));
        let rows = self.give_rows.then(|| output.rows.get_or_insert_default());
        let first_ns = instant(self.memory.first_s, origin_ns);
        let mut block = Block { samples, time_s: &self.time_s, items: &mut self.items, first_ns };
        let (undecided, innovations) = (&mut self.memory.undecided, &mut output.innovations);
        let mut open = Judge::Open { undecided, innovations, origin_ns, back, stops: steps };
        let count = filter.run(&self.model, &mut block, &mut open, rows, &mut self.work);
        let samples = samples.part(0, count);
        let met = self.items.partition_point(|one| one.at_s <= filter.clock.time_s);
        for one in self.items.drain(met..).rev() {
            self.memory.waiting.push_front(one);
        }
        if steps {
            self.memory.clocks.samples.extend(samples);
            self.memory.clocks.items.extend_from_slice(&self.items);
        }
        let suspected = steps && filter.watch.suspect.is_some();
        self.memory.filter = Some(filter);
        if suspected {
            let last = samples.part(count - 1, count);
            self.settle(samples.part(0, count - 1), output);
            if let Some(rows) = output.rows.as_mut().filter(|_| self.give_rows) {
                rows.drop_last(last.time_ns[0]);
            }
            self.look_into(last, output);
        } else {
            self.settle(samples, output);
        }
        count
    }

    /// Keeps the filter where it is time to; then, where a clock has drifted farther than its parameter is linear, its
    /// stamps take what that has come to. Returns whether they did: the filter was run anew.
    fn keep_filter(&mut self) -> bool {
        let origin_ns = self.origin_ns();
        let Some(filter) =
            self.memory.filter.as_ref().filter(|_| self.model.channels.iter().any(|one| one.clock.is_some()))
        else {
            return false;
        };
        let newest_ns = self.memory.clocks.samples.time_ns.last().copied();
        let alone = filter.hyps.count() == 1 && filter.watch.suspect.is_none();
        let best = filter.hyps.best();
        let drifts = self.model.channels.iter().map(|one| one.clock.map_or(0.0, |q| best.parameters[q]));
        let drifted = drifts.enumerate().find(|one| alone && one.1.abs() > LINEAR_S);
        if !self.memory.clocks.keep(filter, origin_ns) {
            return false;
        }
        let (Some((c, offset_s)), Some(before), Some(now_ns)) =
            (drifted, self.memory.clocks.kept.front().cloned(), newest_ns)
        else {
            return false;
        };
        let shift_ns = (1e9 * offset_s).round() as i64;
        // Nothing comes before the filter.
        let from_s = before.clock.time_s + offset_s.abs();
        let step = Step { shift_ns, from_s, channel: Some(c), moved: false, drifted: true };
        let items = self.items_since(&before, now_ns);
        let is_moved = |one: &Timed| one.at_s >= from_s && one.channel().is_some_and(|c| step.concerns(c, &self.model));
        if !items.iter().any(is_moved) {
            return false;
        }
        self.adopt(&before, &items, step, now_ns);
        true
    }

    /// A sensor that is lost is not waited for: its stamps count as they come, and when it is back its clock is looked
    /// into anyway.
    fn release_lost(&mut self, now_ns: i64) {
        let (origin_ns, channels) = (self.origin_ns(), &self.model.channels);
        let now_s = since(now_ns, origin_ns);
        let Some(filter) = self.memory.filter.as_ref().filter(|_| self.memory.clocks.bank.is_none()) else { return };
        let ahead_s = self.memory.clocks.ahead_s();
        let is_lost = |&c: &usize| {
            let own = |k: &usize| channels[*k].sensor == channels[c].sensor;
            let stamped_s = |k: usize| filter.hyps.best().marks[k].met_s + ahead_s[k];
            let last_s = (0..channels.len()).filter(own).map(stamped_s).fold(f64::NEG_INFINITY, f64::max);
            let is_back = |one: &Timed| one.channel().is_some_and(|k| own(&k)) && self.stamp_ns(one) <= now_ns;
            ahead_s[c] > 0.0 && now_s - last_s > channels[c].lost_s && !self.memory.waiting.iter().any(is_back)
        };
        let lost: Vec<usize> = (0..channels.len()).filter(is_lost).collect();
        for c in lost {
            let offset_ns = std::mem::take(&mut self.memory.clocks.offsets_ns[c]);
            for one in self.memory.waiting.iter_mut().filter(|one| one.channel() == Some(c)) {
                one.at_s = since(instant(one.at_s, origin_ns) - offset_ns, origin_ns);
            }
            put_in_order(self.memory.waiting.make_contiguous());
        }
    }

    /// Runs over one sample, while a step is looked into or the filter stays back.
    fn run_one(&mut self, sample: View, output: &mut Output) {
        let now_ns = sample.time_ns[0];
        let before_ns = self.memory.clocks.samples.time_ns.last().copied().unwrap_or(i64::MIN);
        self.memory.clocks.samples.extend(sample);
        self.release_lost(now_ns);
        let Some(mut filter) = self.memory.filter.take() else { return };
        self.run_behind(&mut filter, now_ns - self.memory.clocks.behind_ns(), output);
        let arrived = self.arrived(before_ns, now_ns);
        self.lead(&filter, arrived, now_ns);
        self.memory.filter = Some(filter);
        self.look(arrived, sample, output);
    }

    /// Runs the filter up to an instant.
    fn run_behind(&mut self, filter: &mut Filter, until_ns: i64, output: &mut Output) {
        let origin_ns = self.origin_ns();
        let (done_ns, first_ns) = (instant(filter.clock.time_s, origin_ns), instant(self.memory.first_s, origin_ns));
        let stamps = &self.memory.clocks.samples.time_ns;
        let done = stamps.partition_point(|&one| one <= done_ns);
        let end = stamps.partition_point(|&one| one <= until_ns);
        self.items.clear();
        if end <= done {
            return;
        }
        self.take_due(since(self.memory.clocks.samples.time_ns[end - 1], origin_ns));
        let samples = self.memory.clocks.samples.view().part(done, end);
        samples.seconds(origin_ns, &mut self.time_s);
        let mut block = Block { samples, time_s: &self.time_s, items: &mut self.items, first_ns };
        let (undecided, innovations) = (&mut self.memory.undecided, &mut output.innovations);
        let mut open = Judge::Open { undecided, innovations, origin_ns, back: None, stops: false };
        filter.run(&self.model, &mut block, &mut open, None, &mut self.work);
        self.memory.clocks.items.extend_from_slice(&self.items);
    }

    /// The stamp of an item as its sensor gave it, ns.
    fn stamp_ns(&self, one: &Timed) -> i64 {
        instant(one.at_s, self.origin_ns()) - one.channel().map_or(0, |c| self.memory.clocks.offsets_ns[c])
    }

    /// Whether anything was stamped in a time, ns.
    fn arrived(&self, after_ns: i64, until_ns: i64) -> bool {
        let within = |one: &Timed| {
            let stamp_ns = self.stamp_ns(one);
            stamp_ns > after_ns && stamp_ns <= until_ns
        };
        self.memory.waiting.iter().any(within) || self.items.iter().any(within)
    }

    /// Of what waits that which has come by an instant, ns, and is of before it.
    fn waiting_until(&self, now_ns: i64) -> Vec<Timed> {
        let now_s = since(now_ns, self.origin_ns());
        let has_come = |one: &&Timed| one.at_s <= now_s && self.stamp_ns(one) <= now_ns;
        self.memory.waiting.iter().filter(has_come).copied().collect()
    }

    /// Brings the copy of the filter that is ahead of it to the newest sample.
    fn lead(&mut self, filter: &Filter, arrived: bool, now_ns: i64) {
        if self.memory.clocks.behind_ns() == 0 {
            self.memory.clocks.leader = None;
            return;
        }
        let origin_ns = self.origin_ns();
        let anew = arrived || self.memory.clocks.leader.is_none();
        let mut items = if anew { self.waiting_until(now_ns) } else { Vec::new() };
        let mut leader = match self.memory.clocks.leader.take() {
            Some(leader) if !anew => leader,
            _ => filter.clone(),
        };
        let samples = self.memory.clocks.samples.view();
        let done_ns = instant(leader.clock.time_s, origin_ns);
        let samples = samples.part(samples.time_ns.partition_point(|&one| one <= done_ns), samples.len());
        samples.seconds(origin_ns, &mut self.time_s);
        let block = &mut Block { samples, time_s: &self.time_s, items: &mut items, first_ns: i64::MAX };
        run_open(&mut leader, &self.model, block, (&mut Undecided::default(), origin_ns), &mut self.work);
        self.memory.clocks.leader = Some(leader);
    }

    /// Looks into clocks at the newest sample: begins, weighs and ends the bank, and gives the row.
    fn look(&mut self, arrived: bool, sample: View, output: &mut Output) {
        let suspect = self.memory.filter.as_ref().and_then(|one| one.watch.suspect);
        let now_s = since(sample.time_ns[0], self.origin_ns());
        // A sensor that dies must not keep the search open.
        let is_due = |bank: &Bank| bank.is_over(now_s) || arrived && bank.is_due(now_s);
        let due = self.memory.clocks.bank.as_ref().map(is_due);
        match (due, suspect) {
            (Some(true), _) => self.weigh(sample.time_ns[0], output),
            (Some(false), _) => {
                self.time_s.clear();
                self.time_s.push(now_s);
                if let Some(bank) = self.memory.clocks.bank.as_mut() {
                    bank.advance(&self.model, sample, &self.time_s, &mut self.work);
                }
            }
            (None, Some(_)) => return self.look_into(sample, output),
            (None, None) => {}
        }
        self.leave_row(sample, output);
    }

    /// Begins a bank of what is suspected at the newest sample, and gives the row.
    fn look_into(&mut self, sample: View, output: &mut Output) {
        let now_ns = sample.time_ns[0];
        let now_s = since(now_ns, self.origin_ns());
        let suspect = self.memory.filter.as_ref().and_then(|one| one.watch.suspect);
        let befores: Vec<Filter> = self.memory.clocks.kept.iter().cloned().collect();
        if let (Some(suspect), Some(before)) = (suspect, befores.first()) {
            let items = self.items_since(before, now_ns);
            self.memory.clocks.bank =
                Some(Bank::new(suspect, now_s, befores, items, &self.model).keeping_rows(!self.give_rows));
            self.weigh(now_ns, output);
        }
        self.leave_row(sample, output);
    }

    /// What was measured since a filter that was kept.
    fn items_since(&self, before: &Filter, now_ns: i64) -> Vec<Timed> {
        let mut items = self.memory.clocks.items.clone();
        items.retain(|one| one.at_s > before.clock.time_s);
        items.extend(self.waiting_until(now_ns));
        put_in_order(&mut items);
        items
    }

    /// Weighs the bank by all that has come, and ends it where it knows.
    fn weigh(&mut self, now_ns: i64, output: &mut Output) {
        let origin_ns = self.origin_ns();
        let Some(mut bank) = self.memory.clocks.bank.take() else { return };
        bank.items = self.items_since(bank.before(), now_ns);
        let samples = self.memory.clocks.samples.view();
        samples.seconds(origin_ns, &mut self.time_s);
        let Some(now) = self.memory.clocks.leader.as_ref().or(self.memory.filter.as_ref()) else { return };
        let behind_s = 1e-9 * self.memory.clocks.behind_ns() as f64;
        bank.weigh((now, behind_s), &self.model, (samples, &self.time_s), origin_ns, &mut self.work);
        match bank.compare(now, &self.model) {
            Search::Open => self.memory.clocks.bank = Some(bank),
            Search::None => self.calm(output),
            Search::Stepped(step, std_s) => {
                let offset_ns = step.channel.map_or(0, |c| self.memory.clocks.offsets_ns[c]);
                let channel = step.channel.unwrap_or(bank.suspect.channel);
                let (size_mm, std_mm) = (1e-6 * step.shift_ns as f64, 1e3 * std_s);
                let time_ns = instant(step.from_s, origin_ns) - offset_ns;
                self.memory.pending.push(Report { time_ns, channel, what: What::Clock, size_mm, std_mm });
                self.adopt(bank.before(), &bank.items, step, now_ns);
            }
        }
    }

    /// Nothing is suspected any more.
    fn calm(&mut self, output: &mut Output) {
        self.memory.clocks.bank = None;
        if let Some(filter) = self.memory.filter.as_mut() {
            filter.watch.calm();
        }
        self.report(output);
    }

    /// Takes a step as found: all since the filter before it is decided anew, with what was measured since at its
    /// instants.
    fn adopt(&mut self, before: &Filter, measured: &[Timed], step: Step, now_ns: i64) {
        let (origin_ns, before_s) = (self.origin_ns(), before.clock.time_s);
        let (items, untaken) = step.applied(measured, &self.model, origin_ns);
        let (mut items, _, _) = step.without_unseen(items, untaken);
        let mut waiting: Vec<Timed> = self.memory.waiting.drain(..).collect();
        waiting.retain(|one| !measured.contains(one));
        for one in &mut waiting {
            if one.channel().is_some_and(|c| step.concerns(c, &self.model)) {
                one.at_s = since(instant(one.at_s, origin_ns) + step.shift_ns, origin_ns);
            }
        }
        for c in (0..self.model.channels.len()).filter(|&c| step.concerns(c, &self.model)) {
            self.memory.clocks.offsets_ns[c] += step.shift_ns;
        }
        let until_ns = now_ns - self.memory.clocks.behind_ns();
        let samples = self.memory.clocks.samples.view();
        let samples = samples.part(0, samples.time_ns.partition_point(|&one| one <= until_ns));
        samples.seconds(origin_ns, &mut self.time_s);
        let met = items.partition_point(|one| self.time_s.last().is_some_and(|&end_s| one.at_s <= end_s));
        waiting.extend(items.drain(met..));
        put_in_order(&mut waiting);
        let (mut filter, mut undecided) = (before.best_alone(), Undecided::default());
        let block = &mut Block { samples, time_s: &self.time_s, items: &mut items, first_ns: i64::MIN };
        run_open(&mut filter, &self.model, block, (&mut undecided, origin_ns), &mut self.work);
        filter.watch.calm();
        self.memory.waiting.extend(waiting);
        self.decide_anew(before_s, undecided);
        let clocks = &mut self.memory.clocks;
        (clocks.bank, clocks.leader, clocks.changed_s) = (None, None, Some(before_s));
        clocks.kept.clear();
        clocks.items.clear();
        clocks.keep(&filter, origin_ns);
        self.lead(&filter, true, now_ns);
        self.memory.filter = Some(filter);
    }

    /// Forgets what was decided after an instant (s), in favour of what another run made of it.
    fn decide_anew(&mut self, after_s: f64, again: Undecided) {
        let mut decided = std::mem::replace(&mut self.memory.undecided, again).all();
        decided.drop_after(after_s);
        decided.extend(&self.memory.undecided.settled);
        self.memory.undecided.settled = decided;
        if let Some(log) = self.log.as_mut() {
            log.decided.drop_after(after_s);
            log.filters.retain(|_, one| one.filter.clock.time_s <= after_s);
        }
    }

    /// Logs the newest sample and gives its row: of all that may be, by their weights.
    fn leave_row(&mut self, sample: View, output: &mut Output) {
        self.settle(sample, output);
        if !self.give_rows {
            return;
        }
        let first_ns = instant(self.memory.first_s, self.origin_ns());
        let clocks = &self.memory.clocks;
        let Some(now) = clocks.leader.as_ref().or(self.memory.filter.as_ref()) else { return };
        let own = now.row_now(&self.model, (sample, first_ns), &clocks.ahead_s(), &mut self.work);
        let row = match &clocks.bank {
            Some(bank) if !own.is_empty() => {
                let mut rows: Vec<Rows> = vec![own];
                rows.extend(bank.rows(&self.model, sample, first_ns, &mut self.work));
                mixed(&rows, &bank.weights(&self.model))
            }
            _ => own,
        };
        output.rows.get_or_insert_default().extend(&row);
    }

    /// At the record's end: what is looked into still is decided by what is likelier, and a filter that stays back runs
    /// to the last sample.
    pub(super) fn finish_clocks(&mut self, output: &mut Output) {
        let Some(&now_ns) = self.memory.clocks.samples.time_ns.last() else { return };
        self.memory.clocks.bank = None;
        output.innovations.resize_with(self.settings.channels.len(), Innovations::default);
        if let Some(mut filter) = self.memory.filter.take() {
            if self.memory.clocks.behind_ns() > 0 {
                self.run_behind(&mut filter, now_ns, output);
            }
            self.memory.filter = Some(filter);
        }
        output.innovations.clear();
    }
}

/// Runs a filter over a block whose innovations are not given out; settled: takes what each item was taken for.
fn run_open(
    filter: &mut Filter,
    model: &Model,
    block: &mut Block,
    (undecided, origin_ns): (&mut Undecided, i64),
    work: &mut Work,
) {
    let innovations = &mut vec![Innovations::default(); model.channels.len()];
    let mut open = Judge::Open { undecided, innovations, origin_ns, back: None, stops: false };
    filter.run(model, block, &mut open, None, work);
}
