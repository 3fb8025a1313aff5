//! The second pass over what the estimator decided in a whole record: forward with the decisions of the best
//! hypothesis, then back in time.
//!
//! Memory stays bounded: the filter is kept at every block's start only, and each block is run once more on its way
//! back (G. J. Bierman, Fixed interval smoothing with discrete measurements, Int. J. Control 18 (1973) 65-75). As far
//! as nothing was decided otherwise later, the filters that the estimator logged are taken: the best hypothesis's past
//! is what it decided. It knows better than the filter did what led predictions away, and where steps of zeros were.

use super::cause::{Cause, Decision, Prior};
use super::decided::{Decided, Log, Logged};
use super::innovation::Work;
use super::model::{Model, instant};
use super::reports::ONE_CAUSE_S;
use super::rows::Rows;
use super::run::{Block, Filter, Judge};
use super::settings::Settings;
use super::situation::{SHORTEST_S, led_away};
use super::smoother::{Adjoint, Counted, Counting};
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

/// The rows of all axes, smoothed by the whole record; log: of an estimator that has finished; logged: whether its
/// filters are used, which belong to its own settings; block: samples of a part.
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

    /// The logged filter after this many samples where it is as a run by what was decided would find it: before
    /// anything is other in the second pass, and of the hypothesis that was right.
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
        let (mut way, mut smoothed) = (WayBack::default(), Vec::new());
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
            adjoint.pass(&way, &counted, 0..part.samples.len(), &mut smoothed);
            end -= given[i];
            let own = part.samples.clone().enumerate().filter(|(_, k)| view.is_row(*k, self.first_ns));
            for (place, (k, sample)) in own.enumerate() {
                let one = &smoothed[k * view.axes..(k + 1) * view.axes];
                rows.put(end + place, view.time_ns[sample], one, |a| way.status(k, a));
            }
        }
        rows
    }
}

/// An error of the acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Error {
    /// From when, s.
    from_s: f64,
    /// Until when, s.
    until_s: f64,
    /// Its axis.
    axis: usize,
    /// Its density, (m/s²)²/Hz.
    density: f64,
}

/// Adds errors to the noise densities (s · axes) of samples at these times (s,).
fn add_errors(errors: &[Error], time_s: &[f64], axes: usize, density: &mut [f64]) {
    for error in errors {
        let first = time_s.partition_point(|&one| one <= error.from_s);
        let end = (time_s.partition_point(|&one| one < error.until_s) + 1).min(time_s.len());
        for k in first..end.max(first) {
            density[k * axes + error.axis] += error.density;
        }
    }
}

/// What led predictions away that were found wrong, and the decisions by which measurements then are taken.
///
/// The filter learns of it by the measurement that it contradicts; but it happened since the last good one before, of
/// the same channel. Measurements between are asked again, and those that were taken for outliers before, as far as
/// they belong to the same cause: they contradicted a state that was wrong. Without a good one before nothing is
/// changed.
fn unforeseen(decided: &Decided, model: &Model) -> (Vec<Error>, Vec<Decision>) {
    let mut decisions = decided.decisions.clone();
    let (mut errors, mut again) = (Vec::new(), vec![false; decisions.len()]);
    for (c, channel) in model.channels.iter().enumerate() {
        let own: Vec<usize> = (0..decided.len()).filter(|&j| decided.items[j].channel() == Some(c)).collect();
        let mut last_good: Option<usize> = None;
        for (place, &j) in own.iter().enumerate() {
            let decision = decided.decisions[j];
            if let (Cause::Wrong | Cause::Lost, Some(first)) = (decision.cause, last_good) {
                let at_s = decided.items[j].at_s;
                let lapse = (at_s - decided.items[own[first]].at_s).max(SHORTEST_S);
                let density = led_away(decided.evidence[j].size / channel.row.units_per_m, lapse);
                errors.push(Error { from_s: at_s - lapse, until_s: at_s, axis: channel.row.axis, density });
                for &between in &own[first + 1..=place] {
                    again[between] = true;
                }
                for outlier in outliers_of_one_cause(&own[..=place], decided) {
                    again[outlier] = true;
                }
            }
            if !decision.is_outlier() {
                last_good = Some(place);
            }
        }
    }
    for (decision, again) in decisions.iter_mut().zip(again) {
        decision.explained = again;
    }
    (errors, decisions)
}

/// Which of a channel's measurements are the outliers that led to what the last of them was taken for.
fn outliers_of_one_cause(own: &[usize], decided: &Decided) -> Vec<usize> {
    let odd: Vec<usize> = own
        .iter()
        .copied()
        .filter(|&j| !matches!(decided.decisions[j].cause, Cause::Good | Cause::StepBefore))
        .collect();
    let time_s = |j: usize| decided.items[j].at_s;
    let apart = odd.windows(2).rposition(|two| time_s(two[1]) - time_s(two[0]) >= ONE_CAUSE_S);
    let same = &odd[apart.map_or(0, |place| place + 1)..];
    same.iter().copied().filter(|&j| decided.decisions[j].is_outlier()).collect()
}

/// Puts the steps that later measurements showed where they were, as shifts of all targets of a sensor.
fn put_steps_in_place(decided: &mut Decided, model: &Model) {
    let steps: Vec<usize> = (0..decided.len()).filter(|&j| decided.decisions[j].cause == Cause::StepBefore).collect();
    for &j in &steps {
        decided.decisions[j] = Decision::GOOD;
    }
    for j in steps {
        let Some(of) = decided.items[j].channel() else { continue };
        let since_s = decided.items[j].at_s - decided.evidence[j].ago_s - SHORTEST_S;
        let first = decided.items.partition_point(|one| one.at_s < since_s);
        for (c, channel) in model.channels.iter().enumerate() {
            if channel.group != model.channels[of].group {
                continue;
            }
            let met = |&k: &usize| decided.items[k].channel() == Some(c) && !decided.decisions[k].is_outlier();
            let place = (first..=j).find(met);
            if let Some(k) = place {
                decided.decisions[k] = Decision::of(Cause::Shift(Prior::ReportedLater));
            }
        }
    }
}

/// From when on (s) decisions are other than the first, or the noise; infinite where they never are.
fn first_change(before: &Decided, decisions: &[Decision], errors: &[Error]) -> f64 {
    let other = before.decisions.iter().zip(decisions).position(|(one, other)| one != other);
    let first_s = other.map_or(f64::INFINITY, |j| before.items[j].at_s);
    errors.iter().map(|one| one.from_s).fold(first_s, f64::min)
}

#[cfg(test)]
mod tests {
    use super::super::hypothesis::Contradiction;
    use super::super::tests::{channel, measured, rates, settings};
    use super::*;

    #[test]
    fn outliers_of_the_cause_that_a_wrong_state_explains_are_asked_again() {
        // Every third of a second; one outlier long before, then a state that is led away and contradicts sound
        // measurements on both sides of one that it took.
        let outliers = [1, 11, 13, 14, 16];
        let cause = |j: usize| match j {
            17 => Cause::Lost,
            j if outliers.contains(&j) => Cause::Outlier,
            _ => Cause::Good,
        };
        let decided = Decided {
            items: (0..19).map(|j| measured(f64::from(j) / 3.0, 0, 0.0, 1.0)).collect(),
            decisions: (0..19).map(|j| Decision::of(cause(j))).collect(),
            evidence: vec![Contradiction { size: 1.0, variance: 1.0, ago_s: 0.0 }; 19],
        };
        let model = Model::new(&settings(vec![channel()], rates()), 0);
        let (errors, decisions) = unforeseen(&decided, &model);
        let again: Vec<usize> = (0..19).filter(|&j| decisions[j].explained).collect();
        assert_eq!(again, [11, 13, 14, 16, 17]);
        assert!(decisions.iter().zip(&decided.decisions).all(|(one, other)| one.cause == other.cause));
        assert_eq!(errors.len(), 1);
    }
}
