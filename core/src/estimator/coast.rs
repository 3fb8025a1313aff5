//! The samples between two measurements, while there is one hypothesis: most of a record.
//!
//! It does what [`super::run`] does of a sample without a measurement, by the same sums in the same order, so that the
//! bits of the filter are the same; quantity by quantity, each in a loop of its own over the samples of a segment, with
//! what stays as it is between measurements looked up once.

use super::hypothesis::Hypothesis;
use super::innovation::{Mixed, Mixture, Work};
use super::layout::{MOTION_STATES, motion_of};
use super::matrix::Matrix;
use super::model::Model;
use super::motion::{AxisMotion, Response, lead_of};
use super::predict::{MotionCovariance, MotionMean, mirror_others, predict_across, predict_walks};
use super::rows::{Rows, Standing, zero_variance};
use super::run::{Block, Filter};
use super::samples::View;
use super::settings::MAX_AXES;
use super::way_back::WayBack;
use crate::track::vector::vectorised;

/// This many samples at once stay in the nearest memory.
const MAX_SEGMENT: usize = 128;

/// Where rows and nodes go.
pub struct Leave<'a> {
    /// Rows.
    pub rows: Option<&'a mut Rows>,
    /// What the way back needs.
    pub back: Option<&'a mut WayBack>,
    /// See [`Standing::at`].
    pub ahead_s: &'a [f64],
}

/// A quantity along one axis at each sample of a segment, of the displacement and of the velocity.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    pub(super) x: Vec<f64>,
    pub(super) v: Vec<f64>,
}

impl Pair {
    fn new() -> Self {
        Self { x: vec![0.0; MAX_SEGMENT], v: vec![0.0; MAX_SEGMENT] }
    }
}

/// What the samples of a segment leave along one axis.
#[derive(Clone, Debug)]
pub struct Course {
    /// How many samples there are.
    pub(super) count: usize,
    /// Lengths of the intervals, s.
    dt: Vec<f64>,
    /// What the velocity state is moved by at the start of each, m/s, and what its input adds.
    led: Vec<f64>,
    moved: Vec<Response>,
    /// Displacement and true velocity.
    pub(super) mean: Pair,
    /// Of the motion.
    pub(super) covariance: Vec<MotionCovariance>,
    /// Of the displacement, and then of the row, m².
    variance: Vec<f64>,
    /// Of each parameter.
    pub(super) sensitivities: Vec<Pair>,
    /// Covariances with each of the other states that are uncertain.
    pub(super) others: Vec<Pair>,
}

impl Course {
    /// For a model.
    pub fn new(model: &Model) -> Self {
        Self {
            count: 0,
            dt: vec![0.0; MAX_SEGMENT],
            led: vec![0.0; MAX_SEGMENT],
            moved: vec![Response::default(); MAX_SEGMENT],
            mean: Pair::new(),
            covariance: vec![MotionCovariance::default(); MAX_SEGMENT],
            variance: vec![0.0; MAX_SEGMENT],
            sensitivities: vec![Pair::new(); model.columns() - 1],
            others: vec![Pair::new(); model.size()],
        }
    }

    /// What one sample leaves: what a hypothesis is now; ahead: what its velocity state is ahead of the true velocity,
    /// m/s.
    fn set(&mut self, hyp: &Hypothesis, a: usize, ahead: f64, others: &[usize]) {
        let (i, x, p) = (motion_of(a), &hyp.x, &hyp.p);
        self.count = 1;
        (self.mean.x[0], self.mean.v[0]) = (x[(i, 0)], x[(i + 1, 0)] - ahead);
        self.covariance[0] = MotionCovariance::of(p, i);
        for (q, pair) in self.sensitivities.iter_mut().enumerate() {
            (pair.x[0], pair.v[0]) = (x[(i, 1 + q)], x[(i + 1, 1 + q)]);
        }
        for (pair, &j) in self.others.iter_mut().zip(others) {
            (pair.x[0], pair.v[0]) = (p[(i, j)], p[(i + 1, j)]);
        }
    }

    /// Turns what the samples left into displacement relative to the datum, its variance, and the velocity, with the
    /// parameters' part.
    fn relate(&mut self, hyp: &Hypothesis, model: &Model, a: usize, others: &[usize]) {
        let Self { count, mean, covariance, variance, sensitivities, .. } = self;
        let (count, misfit, datum) = (*count, model.misfit[a], model.datum.as_ref().map(|datum| datum[a]));
        let (value, velocity, variance) = (&mut mean.x[..count], &mut mean.v[..count], &mut variance[..count]);
        for (variance, covariance) in variance.iter_mut().zip(covariance.iter()) {
            *variance = covariance.xx;
        }
        if let Some(d) = datum {
            let common = others.iter().position(|&j| j == d).map(|place| &self.others[place].x);
            for (k, (value, variance)) in value.iter_mut().zip(variance.iter_mut()).enumerate() {
                *value -= hyp.x[(d, 0)];
                *variance += hyp.p[(d, d)] - 2.0 * common.map_or(0.0, |common| common[k]);
            }
        }
        variance.iter_mut().for_each(|variance| *variance = misfit * variance.max(0.0));
        for (q, &parameter) in hyp.parameters.iter().enumerate() {
            let at_datum = datum.map_or(0.0, |d| hyp.x[(d, 1 + q)]);
            let Pair { x, v } = &mut sensitivities[q];
            for (((value, velocity), x), v) in value.iter_mut().zip(velocity.iter_mut()).zip(x).zip(v.iter()) {
                *x -= at_datum;
                *value += *x * parameter;
                *velocity += v * parameter;
            }
        }
        for (q, one) in sensitivities.iter().enumerate() {
            for (r, other) in sensitivities.iter().enumerate() {
                let spread = hyp.spread[(q, r)];
                for ((variance, x), y) in variance.iter_mut().zip(&one.x).zip(&other.x) {
                    *variance += x * spread * y;
                }
            }
        }
    }

    /// Displacement relative to the datum, its variance and the velocity of one sample; after [`Self::relate`].
    fn row(&self) -> Mixed {
        Mixed { value: self.mean.x[0], variance: self.variance[0], velocity: self.mean.v[0] }
    }

    /// Puts the row of one sample.
    fn set_row(&mut self, row: Mixed) {
        (self.mean.x[0], self.variance[0], self.mean.v[0]) = (row.value, row.variance, row.velocity);
    }

    /// Adds the rows along an axis, of this variance (m²) at least and with what nothing tells; after [`Self::relate`].
    fn add_rows(&mut self, least: f64, unseen: f64, a: usize, standing: &Standing, rows: &mut Rows) {
        let (out, count) = (&mut rows.axes[a], self.count);
        out.displacement.extend_from_slice(&self.mean.x[..count]);
        out.velocity.extend_from_slice(&self.mean.v[..count]);
        out.variance.extend(self.variance[..count].iter().map(|variance| variance.max(least) + unseen));
        out.source.extend(std::iter::repeat_n(standing.source, count));
        out.status.extend(std::iter::repeat_n(standing.status as u8, count));
    }
}

impl Filter {
    /// Goes on from sample `first` over the next ones of the same kind, to before the first one from `before_s` on, or
    /// behind a gap, or whose row stands otherwise; returns that one's number.
    pub fn coast(
        &mut self,
        model: &Model,
        block: &Block,
        (first, before_s): (usize, f64),
        leave: &mut Leave,
        work: &mut Work,
    ) -> usize {
        let (axes, samples) = (model.axes(), block.samples);
        // Nodes of several axes need the covariances between them sample by sample.
        if axes > 1 && leave.back.is_some() {
            return first;
        }
        let (is_row, kind, mut until_s) = (samples.is_row(first, block.first_ns), samples.kind[first], before_s);
        let mut standing = [Standing::default(); MAX_AXES];
        if leave.back.is_some() || (leave.rows.is_some() && is_row) {
            for (a, standing) in standing.iter_mut().enumerate().take(axes) {
                *standing = Standing::at(self.hyps.best(), model, a, (block.time_s[first], kind), leave.ahead_s);
                until_s = until_s.min(standing.until_s);
            }
        }
        let (mut clock, mut end, last) = (self.clock, first, block.time_s.len().min(first + MAX_SEGMENT));
        while end < last && !clock.is_gap(block.time_s[end]) {
            let end_s = block.time_s[end];
            let stays = samples.kind[end] == kind && samples.is_row(end, block.first_ns) == is_row;
            if end_s >= before_s || (end > first && (end_s >= until_s || !stays)) {
                break;
            }
            clock.advance(end_s);
            end += 1;
        }
        if end == first {
            return first;
        }
        let (segment, time_s) = (samples.part(first, end), &block.time_s[first..end]);
        let Work { course, uncertain, .. } = work;
        if let Some(rows) = leave.rows.as_deref_mut().filter(|_| is_row) {
            rows.add_stamps(axes, segment.time_ns);
        }
        if let Some(back) = leave.back.as_deref_mut() {
            back.add_samples(time_s);
        }
        let hyp = self.hyps.best_mut();
        for (a, standing) in standing.iter().enumerate().take(axes) {
            coast_along(hyp, model, (a, &mut self.motion[a], self.clock.time_s), (segment, time_s), uncertain, course);
            let doubt_m2 = self.watch.variance_m2(&model.usual[a]);
            if let Some(back) = leave.back.as_deref_mut() {
                back.add_nodes(hyp, model, a, course);
                back.add_statuses(time_s.len(), standing, doubt_m2);
            }
            if let Some(rows) = leave.rows.as_deref_mut().filter(|_| is_row) {
                course.relate(hyp, model, a, uncertain);
                let unseen = model.unseen_m2[a] + doubt_m2;
                course.add_rows(zero_variance(hyp, a, model), unseen, a, standing, rows);
            }
        }
        if axes > 1 || !uncertain.is_empty() {
            for &dt in &course.dt[..course.count] {
                predict_walks(&mut hyp.p, model.layout.walks(), dt, uncertain);
                for (a, b) in (0..axes).flat_map(|a| (a + 1..axes).map(move |b| (a, b))) {
                    predict_across(&mut hyp.p, motion_of(a), motion_of(b), dt);
                }
            }
        }
        self.clock = clock;
        end
    }
}

impl Filter {
    /// The row at the sample that it is at, where that is one; ahead_s: see [`Standing::at`].
    pub fn row_now(&self, model: &Model, (sample, first_ns): (View, i64), ahead_s: &[f64], work: &mut Work) -> Rows {
        let mut rows = Rows::default();
        let block = Block { samples: sample, time_s: &[], items: &mut [], first_ns };
        self.leave_sample(model, (&block, 0), &mut Leave { rows: Some(&mut rows), back: None, ahead_s }, work);
        rows
    }

    /// Leaves rows and nodes of a sample that the filter has just stepped to.
    pub(super) fn leave_sample(&self, model: &Model, (block, k): (&Block, usize), leave: &mut Leave, work: &mut Work) {
        let (samples, best, moving) = (block.samples, self.hyps.best(), model.layout.moving());
        let Work { course, uncertain, others, .. } = work;
        if let Some(rows) = leave.rows.as_deref_mut().filter(|_| samples.is_row(k, block.first_ns)) {
            rows.add_stamps(model.axes(), &samples.time_ns[k..=k]);
            for (a, axis) in self.motion.iter().enumerate() {
                let datum = model.datum.as_ref().map_or(&[][..], |datum| &datum[a..=a]);
                let mut mixture = Mixture::default();
                for hyp in self.hyps.all() {
                    course.set(hyp, a, axis.ahead(), datum);
                    course.relate(hyp, model, a, datum);
                    mixture.add(hyp.memory.weight.exp(), course.row());
                }
                if self.hyps.count() > 1 {
                    course.set_row(mixture.mixed());
                }
                let standing = Standing::at(best, model, a, (self.clock.time_s, samples.kind[k]), leave.ahead_s);
                let unseen = model.unseen_m2[a] + self.watch.variance_m2(&model.usual[a]);
                course.add_rows(zero_variance(best, a, model), unseen, a, &standing, rows);
            }
        }
        let Some(back) = leave.back.as_deref_mut() else { return };
        back.add_samples(&[self.clock.time_s]);
        for (a, axis) in self.motion.iter().enumerate() {
            let own = motion_of(a)..motion_of(a) + MOTION_STATES;
            others.clear();
            others.extend((0..moving).filter(|i| !own.contains(i)).chain(uncertain.iter().copied()));
            course.set(best, a, axis.ahead(), others);
            back.add_nodes(best, model, a, course);
            let standing = Standing::at(best, model, a, (self.clock.time_s, samples.kind[k]), leave.ahead_s);
            back.add_statuses(1, &standing, self.watch.variance_m2(&model.usual[a]));
        }
    }
}

vectorised! {
    /// Runs along one axis over a segment, from a time (s) on.
    fn coast_along(
        hyp: &mut Hypothesis,
        model: &Model,
        along: (usize, &mut AxisMotion, f64),
        segment: (View, &[f64]),
        uncertain: &[usize],
        course: &mut Course,
    ) {
        let ((a, motion, begun_s), (samples, time_s)) = (along, segment);
        let (i, axes, count) = (motion_of(a), model.axes(), time_s.len());
        let (accelerations, densities) = (&samples.value[a..], &samples.density[a..]);
        course.count = count;
        let mut mean = MotionMean::of(&hyp.x, i);
        let input = (accelerations, axes, model.lean[a]);
        if input.2 == 0.0 {
            move_mean::<false>(&mut mean, motion, (begun_s, time_s), input, course);
        } else {
            move_mean::<true>(&mut mean, motion, (begun_s, time_s), input, course);
        }
        mean.put(&mut hyp.x, i);
        let burst = hyp.memory.burst.filter(|burst| burst.axis == a).map_or(0.0, |burst| burst.density);
        let mut covariance = MotionCovariance::of(&hyp.p, i);
        let walk = model.layout.walks()[i + 2];
        let Course { dt, led, moved, sensitivities, others, .. } = course;
        let (dt, led, moved) = (&dt[..count], &led[..count], &moved[..count]);
        let steps = dt.iter().zip(densities.iter().step_by(axes)).zip(&mut course.covariance);
        for ((&dt, &density), out) in steps {
            covariance = covariance.moved(dt, walk).with_noise(dt, density);
            if burst != 0.0 {
                covariance = covariance.with_noise(dt, burst);
            }
            *out = covariance;
        }
        covariance.put(&mut hyp.p, i);
        for (q, (pair, &of)) in sensitivities.iter_mut().zip(&model.gain_of).enumerate() {
            let input = (of == Some(a)).then_some((led, moved));
            move_pair(&mut hyp.x, (i, 1 + q), dt, input, pair);
        }
        for (pair, &j) in others.iter_mut().zip(uncertain) {
            move_pair(&mut hyp.p, (i, j), dt, None, pair);
        }
        mirror_others(&mut hyp.p, i, uncertain);
    }
}

/// The motion's estimate at each sample; lean: see [`Model::lean`]. Without it (a loop of its own) the input does not
/// wait for the state.
#[inline(always)]
fn move_mean<const LEANS: bool>(
    mean: &mut MotionMean,
    motion: &mut AxisMotion,
    (mut begun_s, time_s): (f64, &[f64]),
    (accelerations, stride, lean): (&[f64], usize, f64),
    course: &mut Course,
) {
    let (mut state, mut axis) = (*mean, *motion);
    let out = course.dt.iter_mut().zip(&mut course.led).zip(&mut course.moved);
    let out = out.zip(course.mean.x.iter_mut().zip(&mut course.mean.v));
    let samples = time_s.iter().zip(accelerations.iter().step_by(stride));
    for ((&end_s, &value), (((out_dt, out_led), out_moved), (x, v))) in samples.zip(out) {
        let dt = end_s - begun_s;
        begun_s = end_s;
        let now = if LEANS { value + lean * (state.x + dt * state.v) } else { value };
        let led = axis.begin(now, dt, lead_of(dt));
        let moved = axis.response(dt);
        state.v += led;
        state = state.moved(dt, moved);
        axis.input = now;
        (*out_dt, *out_led, *out_moved) = (dt, led, moved);
        (*x, *v) = (state.x, state.v - axis.ahead());
    }
    (*mean, *motion) = (state, axis);
}

/// A sensitivity of the motion from state `i` on, or its covariance with another state, at each sample: in column `j`
/// of a matrix. input: what the velocity state is moved by, and what the input adds, both with the opposite sign.
#[inline(always)]
fn move_pair(
    matrix: &mut Matrix,
    (i, j): (usize, usize),
    dt: &[f64],
    input: Option<(&[f64], &[Response])>,
    out: &mut Pair,
) {
    let (mut x, mut v, b) = (matrix[(i, j)], matrix[(i + 1, j)], matrix[(i + 2, j)]);
    for (k, (&dt, (out_x, out_v))) in dt.iter().zip(out.x.iter_mut().zip(&mut out.v)).enumerate() {
        if let Some((led, _)) = input {
            v -= led[k];
        }
        x += dt * v - 0.5 * dt * dt * b;
        v -= dt * b;
        if let Some((_, moved)) = input {
            x -= moved[k].x;
            v -= moved[k].v;
        }
        (*out_x, *out_v) = (x, v);
    }
    (matrix[(i, j)], matrix[(i + 1, j)]) = (x, v);
}
