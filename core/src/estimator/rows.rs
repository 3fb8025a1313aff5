//! What is given out of each sample and axis, and of each measurement.

use super::cause::{Cause, Decision};
use super::hypothesis::{Contradiction, Hypothesis, Mark};
use super::innovation::{Mixed, Mixture};
use super::layout::motion_of;
use super::model::{ChannelModel, Model};
use super::motion::{AxisMotion, Clock};
use super::reports::Report;
use super::samples::{BRIDGED, View};

/// What a row rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Status {
    /// A measurement that is not too old.
    Tracking,
    /// The acceleration alone.
    Coasting,
    /// The acceleration alone, for longer.
    Lost,
}

/// Rows of one axis.
#[derive(Clone, Debug, Default, PartialEq)]
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
#[derive(Clone, Debug, Default, PartialEq)]
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

    /// Makes room from a place on for some rows to be filled; for so many at once that they stay in the nearest memory.
    #[inline]
    pub fn make_room(&mut self, axes: usize, place: usize, count: usize) {
        const MANY: usize = 256;
        if place + count > self.len() || self.axes.len() < axes {
            let taken = self.time_ns.capacity().saturating_sub(place);
            self.resize(axes, place + count.max(MANY.min(taken)));
        }
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

    /// Keeps the first ones.
    pub fn truncate(&mut self, count: usize) {
        self.resize(self.axes.len(), count);
    }

    /// Adds rows to be filled, as a day of them must not exist twice; returns how many there are then.
    pub fn add_zeros(&mut self, axes: usize, more: usize) -> usize {
        let count = self.len() + more;
        self.resize(axes, count);
        count
    }

    fn resize(&mut self, axes: usize, count: usize) {
        self.time_ns.resize(count, 0);
        self.axes.resize_with(axes, AxisRows::default);
        for one in &mut self.axes {
            for values in [&mut one.displacement, &mut one.variance, &mut one.velocity] {
                values.resize(count, 0.0);
            }
            one.source.resize(count, 0);
            one.status.resize(count, 0);
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
pub enum Verdict {
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
    pub verdict: Vec<i8>,
}

impl Innovations {
    /// Adds what a measurement at an instant was taken for, and what that told.
    #[inline]
    pub fn push(&mut self, time_ns: i64, units_per_m: f64, told: &Contradiction, decision: Decision) {
        self.time_ns.push(time_ns);
        self.value.push(told.size / units_per_m);
        self.variance.push(told.variance / (units_per_m * units_per_m));
        self.verdict.push(match decision.cause {
            Cause::Outlier => Verdict::Rejected,
            Cause::Lost => Verdict::Reacquired,
            Cause::Good | Cause::Shift(_) | Cause::Wrong | Cause::Noise | Cause::Clock | Cause::StepBefore => {
                Verdict::Accepted
            }
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

/// Source and status of an axis's row: of the channels that are not too old, the most informative one.
#[inline]
pub fn status_of(hyp: &Hypothesis, axis: usize, model: &Model, time_s: f64) -> (u8, Status) {
    let (mut source, mut status, mut best) = (0, Status::Lost, f64::INFINITY);
    for (mark, channel) in hyp.marks.iter().zip(&model.channels) {
        if channel.row.axis != axis {
            continue;
        }
        let age = time_s - mark.accepted_s;
        if age <= channel.coasting_s {
            status = Status::Tracking;
            if mark.accepted_variance < best {
                (best, source) = (mark.accepted_variance, channel.source);
            }
        } else if age <= channel.lost_s {
            status = status.min(Status::Coasting);
        }
    }
    (source, status)
}

/// Variance (m²) that all rows of an axis have in common: of the datum as the first channel's values count it.
#[inline]
pub fn zero_variance(hyp: &Hypothesis, axis: usize, model: &Model) -> f64 {
    let (p, misfit) = (&hyp.p, model.misfit[axis]);
    let zero = model.channels.iter().find(|one| one.row.axis == axis).map(|one| one.zero);
    match (model.datum.as_ref().map(|datum| datum[axis]), zero) {
        (None, None) => 0.0,
        (None, Some(z)) => misfit * p[(z, z)],
        (Some(d), None) => misfit * p[(d, d)],
        (Some(d), Some(_)) if p[(d, d)] <= 0.0 => 0.0,
        (Some(d), Some(z)) => misfit * (p[(d, d)] + 2.0 * p[(d, z)] + p[(z, z)]).max(0.0),
    }
}

/// Standard deviation (s) of the clock of a sensor that is just back: one that starts anew is set to within some frames. What
/// is farther off is a clock that has stepped.
const BACK_STD_S: f64 = 0.02;

/// Variance (s²) of the clock that an axis' row rests on, where all sensors that measure it are just back.
#[inline]
pub fn clock_variance(hyp: &Hypothesis, axis: usize, model: &Model, time_s: f64) -> f64 {
    let mut measuring = hyp
        .marks
        .iter()
        .zip(&model.channels)
        .filter(|(mark, channel)| channel.row.axis == axis && time_s - mark.accepted_s <= channel.coasting_s);
    let in_doubt = |(mark, channel): (&Mark, &ChannelModel)| mark.doubt.lasts() && channel.apart.variance_m2 != 0.0;
    let Some(first) = measuring.next() else { return 0.0 };
    if in_doubt(first) && measuring.all(in_doubt) { BACK_STD_S * BACK_STD_S } else { 0.0 }
}

/// Displacement of an axis relative to its datum, its variance, and the velocity state, in one hypothesis.
#[inline]
pub fn row_of(hyp: &Hypothesis, axis: usize, model: &Model) -> Mixed {
    let (i, x, p) = (motion_of(axis), &hyp.x, &hyp.p);
    let (mut value, mut variance, mut velocity) = (x[(i, 0)], p[(i, i)], x[(i + 1, 0)]);
    let datum = model.datum.as_ref().map(|datum| datum[axis]);
    if let Some(d) = datum {
        value -= x[(d, 0)];
        variance += p[(d, d)] - 2.0 * p[(i, d)];
    }
    variance = model.misfit[axis] * variance.max(0.0);
    if !hyp.parameters.is_empty() {
        hyp.add_parameters(axis, datum, (&mut value, &mut variance, &mut velocity));
    }
    Mixed { value, variance, velocity }
}

/// Fills the row at a place with that of a sample, where the clock is.
#[inline]
pub fn leave_row(
    hyps: &[Hypothesis],
    motion: &[AxisMotion],
    clock: &Clock,
    model: &Model,
    at: (View, usize),
    (rows, place): (&mut Rows, usize),
) {
    let best = &hyps[0];
    rows.time_ns[place] = at.0.time_ns[at.1];
    for (a, out) in rows.axes.iter_mut().enumerate() {
        let mut row = row_of(best, a, model);
        if hyps.len() > 1 {
            let mut mixture = Mixture::default();
            for hyp in hyps {
                let one = row_of(hyp, a, model);
                mixture.add(hyp.memory.weight.exp(), one.value, one.variance, one.velocity);
            }
            row = mixture.mixed();
        }
        let velocity = row.velocity - motion[a].ahead();
        let variance = row.variance + clock_variance(best, a, model, clock.time_s) * velocity * velocity;
        out.displacement[place] = row.value;
        out.variance[place] = variance.max(zero_variance(best, a, model)) + model.unseen_m2[a];
        out.velocity[place] = velocity;
        (out.source[place], out.status[place]) = status_at(best, a, clock, model, at);
    }
}

/// Codes of source and status of an axis' row; bridged samples are coasting at best.
#[inline]
pub fn status_at(hyp: &Hypothesis, a: usize, clock: &Clock, model: &Model, at: (View, usize)) -> (u8, u8) {
    let (source, status) = status_of(hyp, a, model, clock.time_s);
    let bridged = at.0.kind[at.1] == BRIDGED;
    (source, if bridged { status.max(Status::Coasting) } else { status } as u8)
}

/// What several hypotheses found as one: means and variances by their weights.
pub fn mixed(found: &[Rows], weights: &[f64]) -> Rows {
    let Some(first) = found.first() else { return Rows::default() };
    let (mut whole, total) = (first.clone(), weights.iter().sum::<f64>());
    for (a, out) in whole.axes.iter_mut().enumerate() {
        for k in 0..out.displacement.len() {
            let mean = |of: fn(&AxisRows) -> &Vec<f64>| -> f64 {
                found.iter().zip(weights).map(|(one, weight)| weight / total * of(&one.axes[a])[k]).sum()
            };
            let value = mean(|one| &one.displacement);
            let spread = found.iter().zip(weights).map(|(one, weight)| {
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

impl Hypothesis {
    /// Adds the parameters' part to a row of an axis.
    pub fn add_parameters(
        &self,
        axis: usize,
        datum: Option<usize>,
        (value, variance, velocity): (&mut f64, &mut f64, &mut f64),
    ) {
        let (i, x) = (motion_of(axis), &self.x);
        let relative = |q: usize| x[(i, 1 + q)] - datum.map_or(0.0, |d| x[(d, 1 + q)]);
        for (q, &parameter) in self.parameters.iter().enumerate() {
            let own = relative(q);
            *value += own * parameter;
            *velocity += x[(i + 1, 1 + q)] * parameter;
            for r in 0..self.parameters.len() {
                *variance += own * self.spread[(q, r)] * relative(r);
            }
        }
    }
}
