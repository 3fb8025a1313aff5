//! What a second pass knows better than the filter did: what led predictions away, and where steps of zeros were.

use super::cause::{Cause, Decision, Prior};
use super::decided::Decided;
use super::model::Model;
use super::reports::ONE_CAUSE_S;
use super::situation::{SHORTEST_S, led_away};

/// An error of the acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Error {
    /// From when, s.
    pub from_s: f64,
    /// Until when, s.
    pub until_s: f64,
    /// Its axis.
    pub axis: usize,
    /// Its density, (m/s²)²/Hz.
    pub density: f64,
}

/// Adds errors to the noise densities (s · axes) of samples at these times (s,).
pub fn add_errors(errors: &[Error], time_s: &[f64], axes: usize, density: &mut [f64]) {
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
/// The filter learns of it by the measurement that it contradicts; but it happened since the last good one before, of the
/// same channel. Measurements between are asked again, and those that were taken for outliers before, as far as they belong
/// to the same cause: they contradicted a state that was wrong. Without a good one before nothing is changed.
pub fn unforeseen(decided: &Decided, model: &Model) -> (Vec<Error>, Vec<Decision>) {
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
                let density = led_away(decided.told[j].size / channel.row.units_per_m, lapse);
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

/// Puts the steps that later measurements told where they were, as shifts of all targets of a sensor.
pub fn put_steps_in_place(decided: &mut Decided, model: &Model) {
    let steps: Vec<usize> = (0..decided.len()).filter(|&j| decided.decisions[j].cause == Cause::StepBefore).collect();
    for &j in &steps {
        decided.decisions[j] = Decision::GOOD;
    }
    for j in steps {
        let Some(of) = decided.items[j].channel() else { continue };
        let since_s = decided.items[j].at_s - decided.told[j].ago_s - SHORTEST_S;
        let first = decided.items.partition_point(|one| one.at_s < since_s);
        for (c, channel) in model.channels.iter().enumerate() {
            if channel.group != model.channels[of].group {
                continue;
            }
            let met = |&k: &usize| decided.items[k].channel() == Some(c) && !decided.decisions[k].is_outlier();
            let place = (first..=j).find(met);
            if let Some(k) = place {
                decided.decisions[k] = Decision::of(Cause::Shift(Prior::ToldLater));
            }
        }
    }
}

/// From when on (s) decisions are other than the first, or the noise; infinite where they never are.
pub fn first_change(before: &Decided, decisions: &[Decision], errors: &[Error]) -> f64 {
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
        // Every third of a second; one outlier long before, then a state that is led away and contradicts sound measurements
        // on both sides of one that it took.
        let outliers = [1, 11, 13, 14, 16];
        let cause = |j: usize| match j {
            17 => Cause::Lost,
            j if outliers.contains(&j) => Cause::Outlier,
            _ => Cause::Good,
        };
        let decided = Decided {
            items: (0..19).map(|j| measured(f64::from(j) / 3.0, 0, 0.0, 1.0)).collect(),
            decisions: (0..19).map(|j| Decision::of(cause(j))).collect(),
            told: vec![Contradiction { size: 1.0, variance: 1.0, ago_s: 0.0 }; 19],
        };
        let model = Model::new(&settings(vec![channel()], rates()), 0);
        let (errors, decisions) = unforeseen(&decided, &model);
        let again: Vec<usize> = (0..19).filter(|&j| decisions[j].explained).collect();
        assert_eq!(again, [11, 13, 14, 16, 17]);
        assert!(decisions.iter().zip(&decided.decisions).all(|(one, other)| one.cause == other.cause));
        assert_eq!(errors.len(), 1);
    }
}
