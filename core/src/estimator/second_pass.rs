//! The second pass over what the estimator decided in a whole record: forward with the decisions of the best hypothesis,
//! then back in time.
//!
//! Memory stays bounded: the filter is kept at every block's start only, and each block is run once more on its way back
//! (G. J. Bierman, Fixed interval smoothing with discrete measurements, Int. J. Control 18 (1973) 65-75). As far as nothing
//! was decided otherwise later, the filters that the estimator logged are taken: the best hypothesis's past is what it
//! decided.

use super::cause::Decision;
use super::decided::{Decided, Log, Logged};
use super::innovation::Work;
use super::model::{Model, instant};
use super::rows::Rows;
use super::run::{Block, Filter, Judge};
use super::settings::Settings;
use super::smoother::{Adjoint, Counted, Counting};
use super::unforeseen::{Error, add_errors, first_change, put_steps_in_place, unforeseen};
use super::waiting::count_until;
use super::way_back::WayBack;
use std::ops::Range;

/// A part of the log with the filter before its first sample.
struct Part {
    samples: Range<usize>,
    items: Range<usize>,
    before: Filter,
}

/// A second pass at work.
struct SecondPass<'a> {
    model: Model,
    log: &'a Log,
    decided: Decided,
    errors: Vec<Error>,
    first_ns: i64,
    work: Work,
    time_s: Vec<f64>,
    density: Vec<f64>,
}

/// The rows of all axes, smoothed by the whole record; log: of an estimator that has finished; logged: whether its filters
/// are used, which belong to its own settings; block: samples of a part.
pub fn smooth(log: &Log, settings: &Settings, logged: bool, block: usize) -> Rows {
    let mut settings = settings.clone();
    // Steps of zeros are put in place before, and none is asked for.
    settings.rates.shift = 0.0;
    let model = Model::new(&settings, log.origin_ns);
    let mut decided = log.decided.clone();
    put_steps_in_place(&mut decided, &model);
    let (errors, decisions) = unforeseen(&decided, &model);
    decided.decisions = decisions;
    let other_s = if logged { first_change(&log.decided, &decided.decisions, &errors) } else { f64::NEG_INFINITY };
    let first_ns = instant(log.first_s, log.origin_ns);
    let work = Work::new(&model);
    let mut pass = SecondPass { model, log, decided, errors, first_ns, work, time_s: Vec::new(), density: Vec::new() };
    let begun = Filter::begun(&log.begin, &settings, &pass.model);
    let mut parts = pass.parts(begun, other_s, block);
    pass.back(&mut parts)
}

impl SecondPass<'_> {
    /// The log in parts, each with the filter before it, known or by running over the part before.
    fn parts(&mut self, begun: Filter, other_s: f64, block: usize) -> Vec<Part> {
        let (count, mut parts, mut due) = (self.log.samples.len(), Vec::<Part>::new(), 0);
        for first in (0..count).step_by(block) {
            let samples = first..count.min(first + block);
            let before = match (parts.last(), self.known(first, other_s)) {
                (None, _) => begun.clone(),
                (Some(_), Some(logged)) => logged.filter.clone(),
                (Some(part), None) => {
                    let (samples, items) = (part.samples.clone(), part.items.clone());
                    let mut filter = part.before.clone();
                    self.forward(&mut filter, samples, items, None);
                    filter
                }
            };
            let end_s = super::model::since(self.log.samples.time_ns[samples.end - 1], self.log.origin_ns);
            let items = due..count_until(&self.decided.items, end_s);
            due = items.end;
            parts.push(Part { samples, items, before });
        }
        parts
    }

    /// The logged filter after so many samples where it is as a run by what was decided would find it: before anything is
    /// other in the second pass, and of the hypothesis that was right.
    fn known(&self, samples: usize, other_s: f64) -> Option<&Logged> {
        let one = self.log.filters.get(&samples)?;
        let then = self.log.decided.decisions.get(one.decided..one.decided + one.open.len())?;
        (one.filter.clock.time_s < other_s && then == one.open).then_some(one)
    }

    /// Runs a filter over a part.
    fn forward(&mut self, filter: &mut Filter, samples: Range<usize>, items: Range<usize>, back: Option<&mut WayBack>) {
        let mut view = self.log.samples.view().part(samples.start, samples.end);
        view.seconds(self.log.origin_ns, &mut self.time_s);
        self.density.clear();
        self.density.extend_from_slice(view.density);
        add_errors(&self.errors, &self.time_s, self.model.axes(), &mut self.density);
        view.density = &self.density;
        let decisions: &[Decision] = &self.decided.decisions[items.clone()];
        let own = &mut self.decided.items[items];
        let mut block = Block { samples: view, time_s: &self.time_s, items: own, first_ns: self.first_ns };
        filter.run(&self.model, &mut block, &mut Judge::Decided { decisions, back }, None, &mut self.work);
    }

    /// Runs all parts forward once more and back, from the last one on.
    fn back(&mut self, parts: &mut [Part]) -> Rows {
        let view = self.log.samples.view();
        let given: Vec<usize> =
            parts.iter().map(|one| one.samples.clone().filter(|&k| view.is_row(k, self.first_ns)).count()).collect();
        let mut end: usize = given.iter().sum();
        let mut rows = Rows::default();
        rows.add_zeros(self.model.axes(), end);
        let Some((first, last)) = parts.first().zip(parts.last()) else { return rows };
        let (before, mut after) = (first.before.hyps.best().clone(), last.before.clone());
        let (samples, items) = (last.samples.clone(), last.items.clone());
        let (mut way, mut found) = (WayBack::default(), Vec::new());
        way.restart(&self.model, after.clock.time_s);
        self.forward(&mut after, samples, items, Some(&mut way));
        let model = self.model.clone();
        let counting = Counting::new(&model, &before, &[&self.decided]);
        let counted = Counted { model: &model, counting: &counting, last: after.hyps.best() };
        let mut adjoint = Adjoint::nothing(&model);
        for (i, part) in parts.iter_mut().enumerate().rev() {
            if part.samples.end < view.len() {
                way.restart(&model, part.before.clock.time_s);
                self.forward(&mut part.before, part.samples.clone(), part.items.clone(), Some(&mut way));
            }
            adjoint.pass(&way, &counted, 0..part.samples.len(), &mut found);
            end -= given[i];
            let own = part.samples.clone().enumerate().filter(|(_, k)| view.is_row(*k, self.first_ns));
            for (place, (k, sample)) in own.enumerate() {
                let one = &found[k * view.axes..(k + 1) * view.axes];
                rows.put(end + place, view.time_ns[sample], one, |a| way.status(k, a));
            }
        }
        rows
    }
}
