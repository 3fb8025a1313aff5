//! The samples between two measurements, while there is one hypothesis: most of a record.
//!
//! It does what [`super::run`] does of a sample without a measurement, by the same sums in the same order, so that the bits
//! are the same; axis by axis, with the motion's state at hand, and what stays as it is between measurements looked up once.

use super::hypothesis::Hypothesis;
use super::layout::{MOTION_STATES, motion_of};
use super::model::Model;
use super::motion::{AxisMotion, lead_of, shift_sensitivities};
use super::predict::{
    MotionCovariance, MotionMean, mirror_others, predict_across, predict_others, predict_sensitivities, predict_walks,
};
use super::rows::{AxisRows, Rows, Status, clock_variance, status_of, zero_variance};
use super::run::{Block, Filter};
use super::samples::{BRIDGED, View};
use super::way_back::WayBack;

/// Where rows and nodes go.
pub struct Leave<'a> {
    /// Rows.
    pub rows: Option<&'a mut Rows>,
    /// What the way back needs.
    pub back: Option<&'a mut WayBack>,
    /// Whether all samples of the block are rows.
    pub all_rows: bool,
}

/// The samples of a segment without measurements.
#[derive(Clone, Copy)]
struct Segment<'a> {
    samples: View<'a>,
    time_s: &'a [f64],
    /// The stamp of the first row, ns.
    first_ns: i64,
}

impl Filter {
    /// Goes on from sample `first` to before the first one from `before_s` on, or behind a gap; returns that one's number.
    pub fn coast(
        &mut self,
        model: &Model,
        block: &Block,
        first: usize,
        before_s: f64,
        uncertain: &[usize],
        leave: &mut Leave,
    ) -> usize {
        let (axes, mut clock, mut end) = (model.axes(), self.clock, first);
        while let Some(&end_s) = block.time_s.get(end).filter(|&&end_s| end_s < before_s && !clock.is_gap(end_s)) {
            clock.advance(end_s);
            end += 1;
        }
        // Nodes of several axes need the covariances between them sample by sample.
        if end == first || (axes > 1 && leave.back.is_some()) {
            return first;
        }
        let samples = block.samples.part(first, end);
        let segment = Segment { samples, time_s: &block.time_s[first..end], first_ns: block.first_ns };
        let hyp = self.hyps.best_mut();
        if let Some(rows) = leave.rows.as_deref_mut() {
            if leave.all_rows {
                rows.time_ns.extend_from_slice(samples.time_ns);
            } else {
                let given = (0..samples.len()).filter(|&k| samples.is_row(k, block.first_ns));
                rows.time_ns.extend(given.map(|k| samples.time_ns[k]));
            }
        }
        let place = leave.back.as_deref_mut().map(|back| back.add_samples(segment.time_s));
        for a in 0..axes {
            let out = leave.rows.as_deref_mut().and_then(|rows| rows.axes.get_mut(a));
            let back = leave.back.as_deref_mut().zip(place);
            let (motion, begun_s) = (self.motion[a], self.clock.time_s);
            let mean = MotionMean::of(&hyp.x, motion_of(a));
            let mut along = Along { a, hyp, mean, motion, begun_s, model, uncertain };
            along.run(&segment, out, back);
            self.motion[a] = along.motion;
        }
        if axes > 1 || !uncertain.is_empty() {
            let mut begun_s = self.clock.time_s;
            for &end_s in segment.time_s {
                predict_walks(&mut hyp.p, model.layout.walks(), end_s - begun_s, uncertain);
                predict_between(hyp, axes, end_s - begun_s);
                begun_s = end_s;
            }
        }
        self.clock = clock;
        end
    }
}

/// The covariances between the motions of all axes.
fn predict_between(hyp: &mut Hypothesis, axes: usize, dt: f64) {
    for i in (0..axes * MOTION_STATES).step_by(MOTION_STATES) {
        for other in (i + MOTION_STATES..axes * MOTION_STATES).step_by(MOTION_STATES) {
            predict_across(&mut hyp.p, i, other, dt);
        }
    }
}

/// One axis of the hypothesis.
struct Along<'a> {
    a: usize,
    hyp: &'a mut Hypothesis,
    mean: MotionMean,
    motion: AxisMotion,
    /// Time of the last sample, s.
    begun_s: f64,
    model: &'a Model,
    uncertain: &'a [usize],
}

impl Along<'_> {
    /// Runs over a segment.
    #[inline(always)]
    fn run(&mut self, segment: &Segment, mut out: Option<&mut AxisRows>, mut back: Option<(&mut WayBack, usize)>) {
        let (model, a, axes) = (self.model, self.a, self.model.axes());
        let (i, lean, walk) = (motion_of(a), model.lean[a], model.layout.walks()[motion_of(a) + 2]);
        let burst = self.hyp.memory.burst.filter(|burst| burst.axis == a).map(|burst| burst.density);
        let mut covariance = MotionCovariance::of(&self.hyp.p, i);
        let known = Known::of(self.hyp, model, a);
        let mut standing =
            Standing { source: 0, status: Status::Lost, clock_variance: 0.0, until_s: f64::NEG_INFINITY };
        let accelerations = segment.samples.value.iter().skip(a).step_by(axes);
        let densities = segment.samples.density.iter().skip(a).step_by(axes);
        for (k, ((&end_s, &value), &density)) in segment.time_s.iter().zip(accelerations).zip(densities).enumerate() {
            let dt = end_s - self.begun_s;
            self.begun_s = end_s;
            let now = value + lean * (self.mean.x + dt * self.mean.v);
            let led = self.motion.begin(now, dt, lead_of(dt));
            let moved = self.motion.response(dt);
            self.mean.v += led;
            self.mean = self.mean.moved(dt, moved);
            if !model.gain_of.is_empty() {
                shift_sensitivities(&mut self.hyp.x, a, led, &model.gain_of);
                predict_sensitivities(&mut self.hyp.x, a, dt, moved, &model.gain_of);
            }
            covariance = covariance.moved(dt, walk).with_noise(dt, density);
            if let Some(density) = burst {
                covariance = covariance.with_noise(dt, density);
            }
            if !self.uncertain.is_empty() {
                predict_others(&mut self.hyp.p, i, dt, self.uncertain);
            }
            self.motion.input = now;
            if out.is_none() && back.is_none() {
                continue;
            }
            if end_s > standing.until_s {
                standing = Standing::at(self.hyp, model, a, end_s);
            }
            let status = if segment.samples.kind[k] == BRIDGED {
                standing.status.max(Status::Coasting)
            } else {
                standing.status
            };
            if let Some(out) = out.as_deref_mut().filter(|_| segment.samples.is_row(k, segment.first_ns)) {
                self.leave_row(&known, &covariance, standing.clock_variance, out);
                out.source.push(standing.source);
                out.status.push(status as u8);
            }
            if let Some((back, first)) = back.as_mut() {
                back.put_mean(*first + k, a, (&self.mean, self.motion.ahead()), self.hyp, known.datum);
                back.put_covariance(*first + k, a, &covariance, self.hyp, known.datum);
                back.put_status(*first + k, a, standing.source, status as u8);
            }
        }
        covariance.put(&mut self.hyp.p, i);
        self.mean.put(&mut self.hyp.x, i);
        mirror_others(&mut self.hyp.p, i, self.uncertain);
    }

    /// Adds a row.
    #[inline(always)]
    fn leave_row(&self, known: &Known, covariance: &MotionCovariance, clock_variance: f64, out: &mut AxisRows) {
        let (i, hyp) = (motion_of(self.a), &*self.hyp);
        let (mut value, mut variance, mut velocity) = (self.mean.x, covariance.xx, self.mean.v);
        if let Some(d) = known.datum {
            value -= hyp.x[(d, 0)];
            variance += known.datum_variance - 2.0 * hyp.p[(i, d)];
        }
        variance = known.misfit * variance.max(0.0);
        if !hyp.parameters.is_empty() {
            hyp.add_parameters(self.a, known.datum, (&mut value, &mut variance, &mut velocity));
        }
        velocity -= self.motion.ahead();
        variance += clock_variance * velocity * velocity;
        out.displacement.push(value);
        out.variance.push(variance.max(known.least) + known.unseen);
        out.velocity.push(velocity);
    }
}

/// What is known of an axis' rows until the next measurement.
#[derive(Clone, Copy)]
struct Known {
    datum: Option<usize>,
    datum_variance: f64,
    /// Variance that no row is more certain than.
    least: f64,
    /// Variance that is added to each.
    unseen: f64,
    misfit: f64,
}

impl Known {
    fn of(hyp: &Hypothesis, model: &Model, a: usize) -> Self {
        let datum = model.datum.as_ref().map(|datum| datum[a]);
        Self {
            datum,
            datum_variance: datum.map_or(0.0, |d| hyp.p[(d, d)]),
            least: zero_variance(hyp, a, model),
            unseen: model.unseen_m2[a],
            misfit: model.misfit[a],
        }
    }
}

/// What rows rest on up to a time, s.
#[derive(Clone, Copy)]
struct Standing {
    source: u8,
    status: Status,
    /// Of the clock, s².
    clock_variance: f64,
    until_s: f64,
}

impl Standing {
    /// At a time; it stays until shortly before the first limit of an age that is not past.
    fn at(hyp: &Hypothesis, model: &Model, a: usize, time_s: f64) -> Self {
        // Ages are differences that are rounded: near a limit each row is looked at.
        const NEAR_S: f64 = 1e-6;
        let (source, status) = status_of(hyp, a, model, time_s);
        let mut until_s = f64::INFINITY;
        for (mark, channel) in hyp.marks.iter().zip(&model.channels).filter(|one| one.1.row.axis == a) {
            for limit in [mark.accepted_s + channel.coasting_s, mark.accepted_s + channel.lost_s] {
                if limit + NEAR_S >= time_s {
                    until_s = until_s.min(limit - NEAR_S);
                }
            }
        }
        Self { source, status, clock_variance: clock_variance(hyp, a, model, time_s), until_s }
    }
}
