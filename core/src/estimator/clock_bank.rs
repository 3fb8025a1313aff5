//! The bank of offsets that a sensor's clock may have stepped by: one filter for each offset and each measurement at
//! which it may have stepped, weighed by the likelihood of all that is measured since shortly before.
//!
//! The filters are run anew from a state of before the step, so that what was met at wrong instants leaves nothing in
//! them (multiple models: D. Magill, Optimal adaptive estimation of sampled stochastic processes, IEEE Trans. Automat.
//! Contr. 10 (1965) 434-439, doi 10.1109/TAC.1965.1098191). What is off between two offsets of the bank, each filter
//! estimates as its clock's parameter.

use super::decided::Undecided;
use super::hypothesis::Hypothesis;
use super::innovation::{Mixed, Mixture, Work};
use super::layout::MOTION_STATES;
use super::model::{Model, instant, since};
use super::rows::Rows;
use super::run::{Alone, Block, Filter, Judge};
use super::samples::View;
use super::situation::{LOG_2PI, SHORTEST_S, log_normal, met_within};
use super::suspicion::Suspicion;
use super::waiting::{Item, Measurement, Timed, put_each_in_order};
use serde::{Deserialize, Serialize};

/// Clocks are set by this much at most, s: what NTP steps by where it does not slew.
pub const MAX_OFFSET_NS: i64 = 500_000_000;
/// From offset to offset of the bank, ns: half of it is 0.2 rad of the fastest motion of 6 Hz twice, so that an offset
/// between is linear.
const STEP_NS: i64 = 20_000_000;
/// Standard deviation of what a clock is off by from the nearest offset of the bank, s: half a step.
pub const BETWEEN_STD_S: f64 = 0.01;
/// A step is looked for among the measurements of this time before it is suspected, s: where it shows later, the
/// structure did not move.
pub const REACH_S: f64 = 2.0;
/// And at this many of them at most, 83 ms apart: 51 offsets of each bound the work, and what was measured between is
/// an outlier to the nearest.
const MAX_INSTANTS: usize = 24;
/// Of the gaps and steps back in the stamps of a stream this share is one clock's step against the others.
const P_STEPPED: f64 = 0.1;
/// So often a clock is off by some frames, one step of the bank at most, after a gap: one that starts anew is set to that.
/// A guess, which counts as much as one measurement at 2.8 deviations (ln 52).
const P_NEARLY: f64 = 0.3;
/// An offset of a clock is linear up to this, s: to 0.1 mm at 10 m/s². It is found where its standard deviation is below.
pub const LINEAR_S: f64 = 5e-3;
/// All filters are run anew with what has come no more often than this, s: at each measurement of a sensor at 10 Hz, as
/// a step is found after some tenths of a second; a radar measures more often.
const WEIGHED_EACH_S: f64 = 0.09;
/// After this time the likelier of a step and none is taken, s: a period of the slowest motion that bridges have (0.1 Hz),
/// and what bounds the memory.
const MAX_SEARCH_S: f64 = 10.0;

/// A step of a clock that may have been.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// What is added to stamps, ns.
    pub shift_ns: i64,
    /// The first stamp that it is added to, as the clock was before, s.
    pub from_s: f64,
    /// The channel whose sensor's clock it is; None: the accelerometer's has stepped, which is all others' step.
    pub channel: Option<usize>,
    /// Whether samples were missing or went back as well: the motion's state is that of another instant.
    pub moved: bool,
    /// Whether the clock has drifted by this, which its parameter has followed: nothing is unknown of it.
    pub drifted: bool,
}

/// A step with its filter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Member {
    /// The step.
    pub step: Step,
    /// Logarithm of its prior.
    prior: f64,
    /// Logarithm of its prior times the likelihood, counted from the filter before the step.
    weight: f64,
    /// By how much what has come, but is of later than now, may make it likelier at most.
    open: f64,
    /// How many measurements of after the step it has met.
    met: usize,
    /// The number of the filter before it.
    before: usize,
    /// The filter with it.
    pub filter: Filter,
    /// The rows of the filter since before the step, where they are kept.
    pub rows: Rows,
    /// Where it goes on from when it is weighed again; None: from the filter before the step.
    #[serde(skip)]
    settled: Option<Settled>,
}

/// A member's filter at an instant of before which nothing comes any more.
#[derive(Clone, Debug, PartialEq)]
struct Settled {
    filter: Filter,
    /// Logarithm of the likelihood of what it has met.
    log_likelihood: f64,
}

/// All steps that may have been.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bank {
    /// What was suspected.
    pub suspect: Suspicion,
    /// When, s.
    since_s: f64,
    /// Filters before steps, in time order.
    befores: Vec<Filter>,
    /// What was measured since, in time order.
    pub items: Vec<Timed>,
    /// The steps.
    pub members: Vec<Member>,
    /// Logarithm of the likelihood of no step, counted from the same filter.
    none: f64,
    /// Whether rows are kept.
    keeps_rows: bool,
    /// When all filters were last run anew, s.
    weighed_s: f64,
}

/// What the bank comes to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Search {
    /// It does not know yet.
    Open,
    /// There was none.
    None,
    /// A step, and the standard deviation of its size, s.
    Stepped(Step, f64),
}

impl Step {
    /// Whether it moves a channel's clock.
    pub fn concerns(&self, c: usize, model: &Model) -> bool {
        let one = &model.channels[c];
        one.clock.is_some() && self.channel.is_none_or(|own| model.channels[own].sensor == one.sensor)
    }

    /// Items as the clock was before, as it is after the step, in time order, with the marks of the step; and of each
    /// whether it is one of before the step that comes behind the marks.
    pub fn applied(&self, items: &[Timed], model: &Model, origin_ns: i64) -> (Vec<Timed>, Vec<bool>) {
        let moves = |one: &Timed| one.channel().is_some_and(|c| self.concerns(c, model)) && one.at_s >= self.from_s;
        let shifted = |at_s: f64| since(instant(at_s, origin_ns) + self.shift_ns, origin_ns);
        let mut timed: Vec<(Timed, bool)> = items
            .iter()
            .map(|&one| (if moves(&one) { Timed { at_s: shifted(one.at_s), ..one } } else { one }, moves(&one)))
            .collect();
        let mark_s = timed.iter().filter(|one| one.1).map(|one| one.0.at_s).fold(f64::INFINITY, f64::min);
        let mut own: Vec<usize> = (0..model.channels.len())
            .filter(|&c| self.concerns(c, model))
            .filter_map(|c| model.channels[c].clock)
            .collect();
        own.sort_unstable();
        own.dedup();
        if mark_s < f64::INFINITY {
            let variance = BETWEEN_STD_S * BETWEEN_STD_S;
            // By this much the motion has become another: two Gaussian-correlated instants, as variances.
            let moved_s = if self.moved { 1e-9 * self.shift_ns as f64 } else { 0.0 };
            let mark = |(place, parameter)| {
                // The state moves once, not with each sensor.
                let moved_s = if place == 0 { moved_s } else { 0.0 };
                let item = if self.drifted {
                    Item::Relinearised { parameter, by_s: 1e-9 * self.shift_ns as f64 }
                } else {
                    Item::ClockStep { parameter, variance, moved_s }
                };
                (Timed { at_s: mark_s, item }, true)
            };
            timed.extend(own.into_iter().enumerate().map(mark));
        }
        put_each_in_order(&mut timed, |one| one.0);
        let is_before = |(one, moved): &(Timed, bool)| {
            one.channel().is_some_and(|c| self.concerns(c, model)) && one.at_s >= mark_s && !moved
        };
        let before = timed.iter().map(is_before).collect();
        (timed.into_iter().map(|one| one.0).collect(), before)
    }

    /// Items and which of them are of before the step, without those of a time that the accelerometer's samples leave
    /// out, as its clock went back; and these.
    pub fn without_unseen(&self, items: Vec<Timed>, before: Vec<bool>) -> (Vec<Timed>, Vec<bool>, Vec<Timed>) {
        if !self.moved || self.shift_ns >= 0 {
            return (items, before, Vec::new());
        }
        let is_unseen = |one: &(Timed, bool)| one.1 && one.0.channel().is_some();
        let (unseen, seen): (Vec<_>, Vec<_>) = items.into_iter().zip(before).partition(is_unseen);
        let (items, before) = seen.into_iter().unzip();
        (items, before, unseen.into_iter().map(|one| one.0).collect())
    }
}

impl Member {
    /// Runs its filter over samples and items up to the last sample, and keeps what it is at `settles_s`; returns the
    /// logarithm of the likelihood since the filter before the step. untaken: see [`Alone`].
    fn run(
        &mut self,
        (before, settles_s): (&Filter, f64),
        model: &Model,
        (samples, time_s): (View, &[f64]),
        (items, untaken): (&mut [Timed], &[bool]),
        (keeps_rows, work): (bool, &mut Work),
    ) -> f64 {
        let (mut filter, log_likelihood) = match self.settled.take() {
            Some(one) => (one.filter, one.log_likelihood),
            None => (before.best_alone(), 0.0),
        };
        let from_s = filter.clock.time_s;
        let mut alone = Alone { log_likelihood, ..Alone::default() };
        let first = time_s.partition_point(|&one| one <= from_s);
        let settled = time_s.partition_point(|&one| one <= settles_s).max(first);
        let mut done = items.partition_point(|one| one.at_s <= from_s);
        if keeps_rows {
            self.rows.drop_from(samples.time_ns.get(first).copied().unwrap_or(i64::MAX));
        }
        for (first, end) in [(first, settled), (settled, samples.len())] {
            let end_s = if end > first { time_s[end - 1] } else { filter.clock.time_s };
            let met = done + items[done..].partition_point(|one| one.at_s <= end_s);
            alone.untaken.clear();
            alone.untaken.extend_from_slice(untaken.get(done..met).unwrap_or(&[]));
            let samples = samples.part(first, end);
            let block =
                &mut Block { samples, time_s: &time_s[first..end], items: &mut items[done..met], first_ns: i64::MIN };
            let rows = keeps_rows.then_some(&mut self.rows);
            filter.run(model, block, &mut Judge::Alone(&mut alone), rows, work);
            done = met;
            if self.settled.is_none() {
                self.settled = Some(Settled { filter: filter.clone(), log_likelihood: alone.log_likelihood });
            }
        }
        self.filter = filter;
        alone.log_likelihood
    }
}

impl Bank {
    /// All steps that a suspicion may mean; befores: filters of earlier, one at least; items: what was measured since
    /// the first of them.
    pub fn new(suspect: Suspicion, now_s: f64, befores: Vec<Filter>, items: Vec<Timed>, model: &Model) -> Self {
        let mut bank = Self {
            suspect,
            since_s: now_s,
            befores,
            items,
            members: Vec::new(),
            none: 0.0,
            keeps_rows: false,
            weighed_s: f64::NEG_INFINITY,
        };
        bank.instants(model).into_iter().for_each(|(from_s, probability)| bank.add(from_s, probability, model));
        bank
    }

    /// Keeps the rows of all members.
    pub fn keeping_rows(self, keeps_rows: bool) -> Self {
        Self { keeps_rows, ..self }
    }

    /// Adds the steps from a stamp (s) on, with their probability together.
    fn add(&mut self, from_s: f64, probability: f64, model: &Model) {
        let own = self.suspect.channel;
        let several = model.channels.iter().any(|one| one.clock.is_some() && one.sensor != model.channels[own].sensor);
        let clocks: &[Option<usize>] = if several { &[Some(own), None] } else { &[Some(own)] };
        let states: &[bool] = if self.suspect.back { &[false, true] } else { &[false] };
        let offsets = (-MAX_OFFSET_NS..=MAX_OFFSET_NS).step_by(usize::try_from(STEP_NS).unwrap_or(1));
        let alike = (clocks.len() * states.len()) as f64;
        let (count, near) =
            (offsets.clone().count() as f64, offsets.clone().filter(|one| one.abs() <= STEP_NS).count() as f64);
        let nearly = if self.suspect.back { probability * P_NEARLY / P_STEPPED / near } else { 0.0 };
        for shift_ns in offsets {
            let more = if shift_ns.abs() <= STEP_NS { nearly } else { 0.0 };
            let prior = ((probability / count + more) / alike).ln();
            // What would be before all filters cannot be met.
            let begins_s = from_s.min(from_s + 1e-9 * shift_ns as f64);
            let Some(before) = self.befores.iter().rposition(|one| one.clock.time_s < begins_s) else { continue };
            for (&channel, &moved) in clocks.iter().flat_map(|one| states.iter().map(move |other| (one, other))) {
                let step = Step { shift_ns, from_s, channel, moved, drifted: false };
                let filter = self.befores[before].best_alone();
                self.members.push(Member {
                    step,
                    prior,
                    weight: prior,
                    open: 0.0,
                    met: 0,
                    before,
                    filter,
                    rows: Rows::default(),
                    settled: None,
                });
            }
        }
    }

    /// Adds the steps from a measurement on that has just come, where the sensor's last ones may be of before it.
    fn add_newest(&mut self, model: &Model) {
        let sensor = model.channels[self.suspect.channel].sensor;
        let own = |one: &&Timed| one.channel().is_some_and(|c| model.channels[c].sensor == sensor);
        let Some(last_s) = self.items.iter().rfind(own).map(|one| one.at_s) else { return };
        let is_new = self.members.iter().all(|one| one.step.from_s < last_s);
        if self.suspect.back && is_new && last_s <= self.since_s + 1e-9 * MAX_OFFSET_NS as f64 {
            self.add(last_s, P_STEPPED / MAX_INSTANTS as f64, model);
        }
    }

    /// Stamps of the measurements from which on the clock may have stepped, with their probabilities.
    fn instants(&self, model: &Model) -> Vec<(f64, f64)> {
        let sensor = model.channels[self.suspect.channel].sensor;
        let own = |one: &&Timed| one.channel().is_some_and(|c| model.channels[c].sensor == sensor);
        let mut stamps: Vec<f64> = self.items.iter().filter(own).map(|one| one.at_s).collect();
        stamps.dedup();
        let Some(&last_s) = stamps.last() else { return Vec::new() };
        let first = stamps.partition_point(|&at_s| at_s < last_s - REACH_S);
        let every = (stamps.len() - first).div_ceil(MAX_INSTANTS).max(1);
        let mut before_s = if first > 0 { stamps[first - 1] } else { self.before().clock.time_s };
        let mut instants = Vec::new();
        for &at_s in stamps[first..].iter().rev().step_by(every).collect::<Vec<_>>().into_iter().rev() {
            instants.push((at_s, met_within(model.rates.clock, (at_s - before_s).max(SHORTEST_S))));
            before_s = at_s;
        }
        if self.suspect.back {
            let probability = P_STEPPED / instants.len() as f64;
            instants.iter_mut().for_each(|one| one.1 = probability);
        }
        instants
    }

    /// Runs all filters over the samples up to now, with what was measured until then, from where nothing that comes can
    /// change them any more; now: the filter without a step; behind_s: by how much stamps may be ahead of their instants.
    pub fn weigh(
        &mut self,
        (now, behind_s): (&Filter, f64),
        model: &Model,
        (samples, time_s): (View, &[f64]),
        origin_ns: i64,
        work: &mut Work,
    ) {
        self.add_newest(model);
        self.none = now.hyps.evidence() - self.before().hyps.evidence();
        let starts: Vec<f64> = self.befores.iter().map(|one| self.log_likelihood_before(one)).collect();
        let now_s = time_s.last().copied().unwrap_or(self.before().clock.time_s);
        self.weighed_s = now_s;
        for member in &mut self.members {
            let before = &self.befores[member.before];
            let since: Vec<Timed> = self.items.iter().filter(|one| one.at_s > before.clock.time_s).copied().collect();
            // What one measurement came to without a step, on the mean.
            let places = |one: &&Timed| one.channel().is_some_and(|c| model.channels[c].places);
            let usual = (self.none - starts[member.before]) / since.iter().filter(places).count().max(1) as f64;
            let (items, untaken) = member.step.applied(&since, model, origin_ns);
            let (mut items, untaken, unseen) = member.step.without_unseen(items, untaken);
            let due = items.partition_point(|one| one.at_s <= now_s);
            let concerned = |one: &&Timed| one.channel().is_some_and(|c| member.step.concerns(c, model));
            let stepped_s = items.iter().find(|one| matches!(one.item, Item::ClockStep { .. })).map(|one| one.at_s);
            let after = items[..due].iter().filter(|one| stepped_s.is_some_and(|at_s| one.at_s >= at_s));
            member.met = after.filter(concerned).count();
            // What comes later is stamped later than now, and met by the step earlier at most.
            let settles_s = now_s - behind_s - (-1e-9 * member.step.shift_ns as f64).max(0.0);
            let log_likelihood = member.run(
                (before, settles_s),
                model,
                (samples, time_s),
                (&mut items[..due], &untaken),
                (self.keeps_rows, work),
            );
            let pending = unseen.iter().chain(&items[due..]).filter(places).filter_map(|one| one.item.measured());
            let (pending, most) = log_later(pending, member.filter.hyps.best(), usual, model);
            (member.weight, member.open) =
                (member.prior + starts[member.before] + log_likelihood + pending, most - pending);
        }
    }

    /// Whether it has been looked for long enough.
    pub fn is_over(&self, now_s: f64) -> bool {
        now_s - self.since_s > MAX_SEARCH_S
    }

    /// Whether it is time to run all filters anew with what has come.
    pub fn is_due(&self, now_s: f64) -> bool {
        now_s >= self.weighed_s + WEIGHED_EACH_S
    }

    /// Whether it is of the model's shape.
    pub fn fits(&self, model: &Model) -> bool {
        let count = model.channels.len();
        self.suspect.channel < count
            && !self.befores.is_empty()
            && self.befores.iter().all(|one| one.fits(model))
            && super::decided::channels_exist(self.items.iter(), count)
            && self.members.iter().all(|one| {
                one.filter.fits(model) && one.before < self.befores.len() && one.step.channel.is_none_or(|c| c < count)
            })
    }

    /// The filter before all steps.
    pub fn before(&self) -> &Filter {
        &self.befores[0]
    }

    /// Logarithm of the likelihood of the best hypothesis of a filter, counted from the first one.
    fn log_likelihood_before(&self, before: &Filter) -> f64 {
        let total = before.hyps.all().iter().map(|hyp| hyp.memory.weight.exp()).sum::<f64>().ln();
        before.hyps.best().memory.weight - total + before.hyps.evidence() - self.before().hyps.evidence()
    }

    /// Compares all steps with none, whose filter is now; drops what falls behind.
    pub fn compare(&mut self, now: &Filter, model: &Model) -> Search {
        let channel = &model.channels[self.suspect.channel];
        // What makes innovations larger than their variance makes them less likely at all instants.
        let (odds, misfit) = (model.rates.odds, model.misfit[channel.row.axis].max(1.0));
        let top = self.members.iter().map(|one| one.weight).fold(self.none, f64::max);
        // None is dropped for its prior, nor for what is not known yet.
        self.members.retain(|one| one.weight - one.prior + one.open > top - odds * misfit);
        let best = self.members.iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
        let (Some(best), Some(q)) = (best, channel.clock) else { return Search::None };
        let (step, met) = (best.step, best.met);
        let mut offsets = Mixture::default();
        for one in &self.members {
            let hyp = one.filter.hyps.best();
            let value = 1e-9 * one.step.shift_ns as f64 + hyp.parameters[q];
            let mixed = Mixed { value, variance: hyp.spread[(q, q)], velocity: 0.0 };
            offsets.add(((one.weight - top) / misfit).exp(), mixed);
        }
        let (none, offset) = (self.none < top - odds * misfit, offsets.mixed());
        let std_s = offset.variance.max(0.0).sqrt();
        let is_over = self.is_over(now.clock.time_s);
        let is_likely = if is_over { self.none < top } else { none };
        // One that has met no more than a motion has states agrees with anything.
        if is_likely && met > MOTION_STATES && std_s < LINEAR_S {
            let shift_ns = (1e9 * offset.value).round() as i64;
            return Search::Stepped(Step { shift_ns, ..step }, std_s);
        }
        if is_over {
            return Search::None;
        }
        Search::Open
    }

    /// Moves all filters over one sample in which nothing was measured.
    pub fn advance(&mut self, model: &Model, sample: View, time_s: &[f64], work: &mut Work) {
        for member in &mut self.members {
            let mut block = Block { samples: sample, time_s, items: &mut [], first_ns: i64::MIN };
            let mut alone = Alone { undecided: Undecided::default(), ..Alone::default() };
            let rows = self.keeps_rows.then_some(&mut member.rows);
            member.filter.run(model, &mut block, &mut Judge::Alone(&mut alone), rows, work);
        }
    }

    /// The weights of no step and of all members.
    pub fn weights(&self, model: &Model) -> Vec<f64> {
        let misfit = model.misfit[model.channels[self.suspect.channel].row.axis].max(1.0);
        let top = self.members.iter().map(|one| one.weight).fold(self.none, f64::max);
        let all = std::iter::once(self.none).chain(self.members.iter().map(|one| one.weight));
        all.map(|one| ((one - top) / misfit).exp()).collect()
    }

    /// The rows of all members at the sample that they are at.
    pub fn rows(&self, model: &Model, sample: View, first_ns: i64, work: &mut Work) -> Vec<Rows> {
        self.members.iter().map(|one| one.filter.row_now(model, (sample, first_ns), &[], work)).collect()
    }
}

/// Logarithm of the likelihood of measurements of later than now, and the most that it may come to: it is only known
/// where the structure is now and how far it moves. After as many as a motion has states the others follow from these
/// as well as from a prediction, whose variance is the measurement's own at least, and as they did without a step
/// (usual).
fn log_later<'a>(
    rows: impl Iterator<Item = &'a Measurement>,
    now: &Hypothesis,
    usual: f64,
    model: &Model,
) -> (f64, f64) {
    let (mut likely, mut most) = (0.0, 0.0);
    for (place, row) in rows.enumerate() {
        let channel = &model.channels[row.channel];
        let (g, i) = (channel.row.units_per_m, channel.row.motion());
        let own = row.variance * now.marks[row.channel].factor;
        let unknown = if place < MOTION_STATES { (channel.apart_m2 + now.p[(i, i)]) * g * g } else { own };
        likely += (-0.5 * (LOG_2PI + 1.0 + (unknown + own).ln())).min(usual);
        most += log_normal(0.0, own);
    }
    (likely, most)
}
