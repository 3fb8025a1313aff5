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
use crate::track::vector::vectorised;

/// Where rows and nodes go.
pub struct Leave<'a> {
    /// Rows.
    pub rows: Option<&'a mut Rows>,
    /// The place of the next row.
    pub place: &'a mut usize,
    /// Whether all samples of the block are rows.
    pub all_rows: bool,
    /// What the way back needs.
    pub back: Option<&'a mut WayBack>,
}

/// The samples of a segment without measurements.
#[derive(Clone, Copy)]
struct Segment<'a> {
    samples: View<'a>,
    time_s: &'a [f64],
    /// The stamp of the first row, ns; None: all are rows.
    first_ns: Option<i64>,
}

impl Segment<'_> {
    #[inline(always)]
    fn is_row(&self, k: usize) -> bool {
        self.first_ns.is_none_or(|first_ns| self.samples.is_row(k, first_ns))
    }
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
        let segment = Segment {
            samples,
            time_s: &block.time_s[first..end],
            first_ns: (!leave.all_rows).then_some(block.first_ns),
        };
        let hyp = self.hyps.best_mut();
        let begin = *leave.place;
        if let Some(rows) = leave.rows.as_deref_mut() {
            rows.make_room(axes, begin, samples.len());
            for k in (0..samples.len()).filter(|&k| segment.is_row(k)) {
                rows.time_ns[*leave.place] = samples.time_ns[k];
                *leave.place += 1;
            }
        }
        let number = leave.back.as_deref_mut().map(|back| back.add_samples(segment.time_s));
        for a in 0..axes {
            let out = leave.rows.as_deref_mut().map(|rows| OutRows::of(&mut rows.axes[a], begin));
            let back = leave.back.as_deref_mut().zip(number);
            coast_along(hyp, model, (a, &mut self.motion[a], self.clock.time_s), &segment, uncertain, (out, back));
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

/// Rows of an axis from a place on.
struct OutRows<'a> {
    displacement: &'a mut [f64],
    variance: &'a mut [f64],
    velocity: &'a mut [f64],
    source: &'a mut [u8],
    status: &'a mut [u8],
    place: usize,
}

impl<'a> OutRows<'a> {
    fn of(rows: &'a mut AxisRows, begin: usize) -> Self {
        Self {
            displacement: &mut rows.displacement[begin..],
            variance: &mut rows.variance[begin..],
            velocity: &mut rows.velocity[begin..],
            source: &mut rows.source[begin..],
            status: &mut rows.status[begin..],
            place: 0,
        }
    }

    #[inline(always)]
    fn put(&mut self, (value, variance, velocity): (f64, f64, f64), (source, status): (u8, u8)) {
        let place = self.place;
        (self.displacement[place], self.variance[place], self.velocity[place]) = (value, variance, velocity);
        (self.source[place], self.status[place]) = (source, status);
        self.place += 1;
    }
}

vectorised! {
    /// Runs along one axis over a segment, from a time (s) on.
    fn coast_along(
        hyp: &mut Hypothesis,
        model: &Model,
        along: (usize, &mut AxisMotion, f64),
        segment: &Segment,
        uncertain: &[usize],
        leave: (Option<OutRows>, Option<(&mut WayBack, usize)>),
    ) {
        let ((a, axis, mut begun_s), (mut out, mut back)) = (along, leave);
        let (axes, i, lean, walk) = (model.axes(), motion_of(a), model.lean[a], model.layout.walks()[motion_of(a) + 2]);
        let burst = hyp.memory.burst.filter(|burst| burst.axis == a).map(|burst| burst.density);
        let (mut motion, mut mean, mut covariance) = (*axis, MotionMean::of(&hyp.x, i), MotionCovariance::of(&hyp.p, i));
        let known = Known::of(hyp, model, a);
        let mut standing = Standing { source: 0, status: Status::Lost, clock_variance: 0.0, until_s: f64::NEG_INFINITY };
        let accelerations = segment.samples.value.iter().skip(a).step_by(axes);
        let densities = segment.samples.density.iter().skip(a).step_by(axes);
        for (k, ((&end_s, &value), &density)) in segment.time_s.iter().zip(accelerations).zip(densities).enumerate() {
            let dt = end_s - begun_s;
            begun_s = end_s;
            // Without lean the input does not wait for the state.
            let now = if lean == 0.0 { value } else { value + lean * (mean.x + dt * mean.v) };
            let led = motion.begin(now, dt, lead_of(dt));
            let moved = motion.response(dt);
            mean.v += led;
            mean = mean.moved(dt, moved);
            if !model.gain_of.is_empty() {
                shift_sensitivities(&mut hyp.x, a, led, &model.gain_of);
                predict_sensitivities(&mut hyp.x, a, dt, moved, &model.gain_of);
            }
            covariance = covariance.moved(dt, walk).with_noise(dt, density);
            if let Some(density) = burst {
                covariance = covariance.with_noise(dt, density);
            }
            if !uncertain.is_empty() {
                predict_others(&mut hyp.p, i, dt, uncertain);
            }
            motion.input = now;
            if out.is_none() && back.is_none() {
                continue;
            }
            if end_s > standing.until_s {
                standing = Standing::at(hyp, model, a, end_s);
            }
            let bridged = segment.samples.kind[k] == BRIDGED;
            let status = if bridged { standing.status.max(Status::Coasting) } else { standing.status };
            let codes = (standing.source, status as u8);
            if let Some(out) = out.as_mut().filter(|_| segment.is_row(k)) {
                out.put(known.row(hyp, a, (&mean, &covariance, motion.ahead()), standing.clock_variance), codes);
            }
            if let Some((back, first)) = back.as_mut() {
                back.add_node(a, (&mean, &covariance, motion.ahead()), hyp, known.datum);
                back.put_status(*first + k, a, codes);
            }
        }
        covariance.put(&mut hyp.p, i);
        mean.put(&mut hyp.x, i);
        mirror_others(&mut hyp.p, i, uncertain);
        *axis = motion;
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

    /// Displacement, variance and velocity of a row.
    #[inline(always)]
    fn row(
        &self,
        hyp: &Hypothesis,
        a: usize,
        (mean, covariance, ahead): (&MotionMean, &MotionCovariance, f64),
        clock_variance: f64,
    ) -> (f64, f64, f64) {
        let (mut value, mut variance, mut velocity) = (mean.x, covariance.xx, mean.v);
        if let Some(d) = self.datum {
            value -= hyp.x[(d, 0)];
            variance += self.datum_variance - 2.0 * hyp.p[(motion_of(a), d)];
        }
        variance = self.misfit * variance.max(0.0);
        if !hyp.parameters.is_empty() {
            hyp.add_parameters(a, self.datum, (&mut value, &mut variance, &mut velocity));
        }
        velocity -= ahead;
        variance += clock_variance * velocity * velocity;
        (value, variance.max(self.least) + self.unseen, velocity)
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
