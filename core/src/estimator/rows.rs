//! What is given out of each sample and axis, and of each measurement.

use super::cause::{Cause, Decision};
use super::hypothesis::{Contradiction, Hypothesis};
use super::innovation::Mixed;
use super::layout::motion_of;
use super::matrix::Matrix;
use super::model::{ChannelModel, Model};
use super::reports::Report;
use super::samples::BRIDGED;
use crate::Status;
use serde::{Deserialize, Serialize};

/// Rows of one axis.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AxisRows {
    /// Displacement relative to the datum, m.
    pub displacement: Vec<f64>,
    /// Its variance, m².
    pub variance: Vec<f64>,
    /// True velocity, m/s.
    pub velocity: Vec<f64>,
    /// Code of the kind of sensor that fixes it, 0 for the acceleration alone.
    pub source: Vec<u8>,
    /// Code of its status.
    pub status: Vec<u8>,
}

/// Rows of all axes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Rows {
    /// Stamps, ns.
    pub time_ns: Vec<i64>,
    /// The rows of each axis.
    pub axes: Vec<AxisRows>,
}

impl Rows {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.time_ns.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.time_ns.is_empty()
    }

    /// Adds stamps, of rows that are to follow along each axis.
    pub fn add_stamps(&mut self, axes: usize, time_ns: &[i64]) {
        self.time_ns.extend_from_slice(time_ns);
        self.axes.resize_with(axes, AxisRows::default);
    }

    /// Takes memory for more.
    pub fn reserve(&mut self, more: usize) {
        self.time_ns.reserve(more);
        for one in &mut self.axes {
            for values in [&mut one.displacement, &mut one.variance, &mut one.velocity] {
                values.reserve(more);
            }
            one.source.reserve(more);
            one.status.reserve(more);
        }
    }

    /// Adds rows to be filled, as a day of them must not exist twice; returns how many there are then.
    pub fn add_zeros(&mut self, axes: usize, more: usize) -> usize {
        let count = self.len() + more;
        self.time_ns.resize(count, 0);
        self.axes.resize_with(axes, AxisRows::default);
        for one in &mut self.axes {
            for values in [&mut one.displacement, &mut one.variance, &mut one.velocity] {
                values.resize(count, 0.0);
            }
            one.source.resize(count, 0);
            one.status.resize(count, 0);
        }
        count
    }

    /// The estimate of an axis at a stamp; None: there is none.
    pub fn at(&self, time_ns: i64, axis: usize) -> Option<Mixed> {
        let (k, one) = (self.time_ns.binary_search(&time_ns).ok()?, &self.axes[axis]);
        Some(Mixed { value: one.displacement[k], variance: one.variance[k], velocity: one.velocity[k] })
    }

    /// Adds the rows of others behind.
    pub fn extend(&mut self, other: &Self) {
        self.add_stamps(other.axes.len(), &other.time_ns);
        for (out, one) in self.axes.iter_mut().zip(&other.axes) {
            out.displacement.extend_from_slice(&one.displacement);
            out.variance.extend_from_slice(&one.variance);
            out.velocity.extend_from_slice(&one.velocity);
            out.source.extend_from_slice(&one.source);
            out.status.extend_from_slice(&one.status);
        }
    }

    /// Drops the rows from a stamp on.
    pub fn drop_from(&mut self, time_ns: i64) {
        let count = self.time_ns.partition_point(|&one| one < time_ns);
        self.time_ns.truncate(count);
        for one in &mut self.axes {
            for values in [&mut one.displacement, &mut one.variance, &mut one.velocity] {
                values.truncate(count);
            }
            one.source.truncate(count);
            one.status.truncate(count);
        }
    }

    /// Drops the last row where it is of this stamp.
    pub fn drop_last(&mut self, time_ns: i64) {
        if self.time_ns.last() != Some(&time_ns) {
            return;
        }
        self.time_ns.pop();
        for one in &mut self.axes {
            for values in [&mut one.displacement, &mut one.variance, &mut one.velocity] {
                values.pop();
            }
            one.source.pop();
            one.status.pop();
        }
    }

    /// Fills the row at a place with the estimate (axes,) of a sample, and source and status of each axis.
    #[inline]
    pub fn put(&mut self, place: usize, time_ns: i64, estimate: &[Mixed], status: impl Fn(usize) -> (u8, u8)) {
        self.time_ns[place] = time_ns;
        for (a, (out, one)) in self.axes.iter_mut().zip(estimate).enumerate() {
            out.displacement[place] = one.value;
            out.variance[place] = one.variance;
            out.velocity[place] = one.velocity;
            (out.source[place], out.status[place]) = status(a);
        }
    }
}

/// What became of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acceptance {
    /// It was accepted.
    Accepted,
    /// It was left out as an outlier.
    Rejected,
    /// The motion was started anew from it.
    Reacquired,
}

/// Innovations of one channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Innovations {
    /// Stamps, ns.
    pub time_ns: Vec<i64>,
    /// Measured minus predicted displacement, m.
    pub value: Vec<f64>,
    /// Its predicted variance, m².
    pub variance: Vec<f64>,
    /// Codes of what became of it.
    pub acceptance: Vec<i8>,
}

impl Innovations {
    /// Adds what a measurement at an instant was taken for, and the evidence for it.
    #[inline]
    pub fn push(&mut self, time_ns: i64, units_per_m: f64, evidence: &Contradiction, decision: Decision) {
        self.time_ns.push(time_ns);
        self.value.push(evidence.size / units_per_m);
        self.variance.push(evidence.variance / (units_per_m * units_per_m));
        self.acceptance.push(match decision.cause {
            Cause::Outlier => Acceptance::Rejected,
            Cause::Lost => Acceptance::Reacquired,
            Cause::Good | Cause::Shift(_) | Cause::Wrong | Cause::Noise | Cause::StepBefore => Acceptance::Accepted,
        } as i8);
    }
}

/// What pushes gave.
#[derive(Clone, Debug, Default)]
pub struct Output {
    /// Rows of all axes, where they are given out.
    pub rows: Option<Rows>,
    /// Innovations of each channel as the best hypothesis saw them; none at the end.
    pub innovations: Vec<Innovations>,
    /// Events.
    pub reports: Vec<Report>,
    /// Variance (axes,) of the datum at the last row, the part that all rows have in common, m².
    pub zero_variance: Vec<f64>,
}

/// What an axis' rows rest on, up to a time.
#[derive(Clone, Copy, Debug, Default)]
pub struct Standing {
    /// Code of the most informative of the channels that are not too old.
    pub source: u8,
    /// By the youngest channel; bridged samples are coasting at best.
    pub status: Status,
    /// Shortly before the first limit of an age that is not past, s.
    pub until_s: f64,
}

impl Standing {
    /// At a time, of a sample of this kind; ahead_s: by how much the stamps of each channel are ahead of the instants
    /// that its measurements are taken at, as the age of a row counts from stamps; empty: of none.
    #[inline]
    pub fn at(hyp: &Hypothesis, model: &Model, axis: usize, (time_s, kind): (f64, u8), ahead_s: &[f64]) -> Self {
        // Ages are differences that are rounded: near a limit each row is looked at.
        const NEAR_S: f64 = 1e-6;
        let mut standing = Self { until_s: f64::INFINITY, ..Self::default() };
        let mut best = f64::INFINITY;
        let marks = hyp.marks.iter().zip(&model.channels).enumerate();
        for (c, (mark, channel)) in marks.filter(|(_, one)| one.1.places && one.1.row.axis == axis) {
            let accepted_s = mark.accepted_s + ahead_s.get(c).unwrap_or(&0.0);
            let age = time_s - accepted_s;
            if age <= channel.coasting_s {
                standing.status = Status::Tracking;
                if mark.accepted_variance < best {
                    (best, standing.source) = (mark.accepted_variance, channel.source);
                }
            } else if age <= channel.lost_s {
                standing.status = standing.status.min(Status::Coasting);
            }
            for limit in [accepted_s + channel.coasting_s, accepted_s + channel.lost_s] {
                if limit + NEAR_S >= time_s {
                    standing.until_s = standing.until_s.min(limit - NEAR_S);
                }
            }
        }
        if kind == BRIDGED {
            standing.status = standing.status.max(Status::Coasting);
        }
        standing
    }
}

/// Variance (m²) that all rows of an axis have in common: of the datum as the first channel's sensor counts it.
#[inline]
pub fn zero_variance(hyp: &Hypothesis, axis: usize, model: &Model) -> f64 {
    let (p, misfit) = (&hyp.p, model.misfit[axis]);
    let mut own = model.channels.iter().filter(|one| one.places && one.row.axis == axis);
    let Some(first) = own.next() else {
        return model.datum.as_ref().map_or(0.0, |datum| misfit * p[(datum[axis], datum[axis])]);
    };
    let Some(datum) = model.datum.as_ref() else { return misfit * p[(first.zero, first.zero)] };
    let d = datum[axis];
    if p[(d, d)] <= 0.0 {
        return 0.0;
    }
    // Of a first sensor that tilts the others tell how far all is from its zero.
    let with_first = |one: &&ChannelModel| one.sensor == first.sensor || first.slow.is_some();
    let others: Vec<usize> = own.filter(with_first).map(|one| one.zero).collect();
    // A tilt takes up what a zero would move the displacement by.
    if first.slow.is_none() && others.iter().all(|&z| p[(z, z)] == 0.0) {
        let z = first.zero;
        return misfit * (p[(d, d)] + 2.0 * p[(d, z)] + p[(z, z)]).max(0.0);
    }
    misfit * without_zeros(p, d, motion_of(axis), (first.zero, &others))
}

/// Variance of the datum `d` without what the zeros of a sensor's channels move it and the displacement `x` by alike.
fn without_zeros(p: &Matrix, d: usize, x: usize, (first, others): (usize, &[usize])) -> f64 {
    let zeros: Vec<usize> = std::iter::once(first).chain(others.iter().copied()).filter(|&z| p[(z, z)] > 0.0).collect();
    let n = zeros.len();
    // The displacement's regression on the zeros, by elimination.
    let mut system = Matrix::zeros(n, n + 1);
    for (i, &z) in zeros.iter().enumerate() {
        for (j, &other) in zeros.iter().enumerate() {
            system[(i, j)] = p[(z, other)];
        }
        system[(i, n)] = p[(z, x)];
    }
    let mut share = vec![0.0; n];
    for i in 0..n {
        for k in i + 1..n {
            let factor = system[(k, i)] / system[(i, i)];
            for j in i..=n {
                let moved = factor * system[(i, j)];
                system[(k, j)] -= moved;
            }
        }
    }
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| system[(i, j)] * share[j]).sum();
        // A zero that the others tell has no share of its own.
        share[i] = if system[(i, i)] > 1e-9 * p[(zeros[i], zeros[i])] {
            (system[(i, n)] - known) / system[(i, i)]
        } else {
            0.0
        };
    }
    let mut variance = p[(d, d)];
    for (i, &z) in zeros.iter().enumerate() {
        variance -= 2.0 * share[i] * p[(d, z)];
        for (j, &other) in zeros.iter().enumerate() {
            variance += share[i] * share[j] * p[(z, other)];
        }
    }
    variance.max(0.0)
}

/// What several hypotheses found as one: means and variances by their weights.
pub fn mixed(runs: &[Rows], weights: &[f64]) -> Rows {
    let Some(first) = runs.first() else { return Rows::default() };
    let (mut whole, total) = (first.clone(), weights.iter().sum::<f64>());
    for (a, out) in whole.axes.iter_mut().enumerate() {
        for k in 0..out.displacement.len() {
            let mean = |of: fn(&AxisRows) -> &Vec<f64>| -> f64 {
                runs.iter().zip(weights).map(|(one, weight)| weight / total * of(&one.axes[a])[k]).sum()
            };
            let value = mean(|one| &one.displacement);
            let spread = runs.iter().zip(weights).map(|(one, weight)| {
                let off = one.axes[a].displacement[k] - value;
                weight / total * (one.axes[a].variance[k] + off * off)
            });
            out.variance[k] = spread.sum();
            out.velocity[k] = mean(|one| &one.velocity);
            out.displacement[k] = value;
        }
    }
    whole
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of x = 2 z₁ − z₂ + own and datum = x at another instant, with the same zeros, the own parts alone are left.
    #[test]
    fn what_zeros_move_all_rows_by_is_no_part_of_the_datum() {
        let (first, second, own, earlier) = (0.3, 0.7, 0.05, 0.02);
        let mut p = Matrix::zeros(4, 4);
        // Displacement, datum, both zeros.
        let shared = 4.0 * first + second;
        p[(0, 0)] = shared + own;
        p[(1, 1)] = shared + earlier;
        p.set_both(0, 1, shared);
        for d in 0..2 {
            p.set_both(d, 2, 2.0 * first);
            p.set_both(d, 3, -second);
        }
        p[(2, 2)] = first;
        p[(3, 3)] = second;
        assert!((without_zeros(&p, 1, 0, (2, &[3])) - earlier).abs() < 1e-12);
    }
}
