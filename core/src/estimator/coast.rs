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

/// The samples of a stretch without measurements: a range of a block's.
#[derive(Clone, Copy)]
struct Stretch<'a> {
    samples: &'a View<'a>,
    time_s: &'a [f64],
    first: usize,
    end: usize,
    /// The stamp of the first row, ns.
    first_ns: i64,
    all_rows: bool,
}

impl Stretch<'_> {
    #[inline(always)]
    fn is_row(&self, k: usize) -> bool {
        self.all_rows || self.samples.is_row(k, self.first_ns)
    }

    /// Adds what is made of each sample that is a row; returns how many there are.
    fn extend<T: Copy, U>(&self, to: &mut Vec<U>, of: &[T], make: impl Fn(T) -> U) -> usize {
        let before = to.len();
        if self.all_rows {
            to.extend(of[self.first..self.end].iter().map(|&one| make(one)));
        } else {
            to.extend((self.first..self.end).filter(|&k| self.is_row(k)).map(|k| make(of[k])));
        }
        to.len() - before
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
        // Nodes of several axes need the covariances between them sample by sample; and a stretch leaves rows or nodes.
        if end == first || (leave.back.is_some() && (axes > 1 || leave.rows.is_some())) {
            return first;
        }
        let (samples, time_s, first_ns) = (&block.samples, block.time_s, block.first_ns);
        let stretch = Stretch { samples, time_s, first, end, first_ns, all_rows: leave.all_rows };
        let hyp = self.hyps.best_mut();
        if let Some(rows) = leave.rows.as_deref_mut() {
            stretch.extend(&mut rows.time_ns, samples.time_ns, |time_ns| time_ns);
        }
        let place = leave.back.as_deref_mut().map(|back| back.add_samples(&time_s[first..end]));
        for a in 0..axes {
            let out = leave.rows.as_deref_mut().and_then(|rows| rows.axes.get_mut(a));
            let back = leave.back.as_deref_mut().zip(place);
            let (motion, begun_s) = (self.motion[a], self.clock.time_s);
            let mut along = Along { a, hyp, motion, begun_s, model, uncertain };
            along.run(&stretch, out, back);
            self.motion[a] = along.motion;
        }
        if axes > 1 || !uncertain.is_empty() {
            let mut begun_s = self.clock.time_s;
            for &end_s in &time_s[first..end] {
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

/// The input with what leaning takes added. It is a call of its own because without leaning the input must not wait for the
/// state: the processor then prepares samples ahead.
#[inline(never)]
fn leaned(value: f64, lean: f64, mean: &MotionMean, dt: f64) -> f64 {
    value + lean * (mean.x + dt * mean.v)
}

/// One axis of the hypothesis.
struct Along<'a> {
    a: usize,
    hyp: &'a mut Hypothesis,
    motion: AxisMotion,
    /// Time of the last sample, s.
    begun_s: f64,
    model: &'a Model,
    uncertain: &'a [usize],
}

impl Along<'_> {
    /// Runs over a stretch: covariance and mean one after the other, so that the processor's registers hold each.
    #[inline(always)]
    fn run(&mut self, stretch: &Stretch, mut out: Option<&mut AxisRows>, mut back: Option<(&mut WayBack, usize)>) {
        let (known, mut part) = (Known::of(self.hyp, self.model, self.a), *stretch);
        if out.is_none() && back.is_none() {
            self.follow_covariance(stretch, |_, _, _| {});
            self.follow_mean(stretch, |_, _, _, _| {});
            part.first = part.end;
        }
        while part.first < stretch.end {
            let standing = Standing::at(self.hyp, self.model, self.a, stretch.time_s[part.first]);
            let rest = &stretch.time_s[part.first + 1..stretch.end];
            part.end = part.first + 1 + rest.iter().take_while(|&&end_s| end_s <= standing.until_s).count();
            if let Some(out) = out.as_deref_mut() {
                self.leave_rows(&part, &known, &standing, out);
            }
            if let Some((back, place)) = back.as_mut() {
                self.leave_nodes(&part, &known, &standing, (back, *place + part.first - stretch.first));
            }
            part.first = part.end;
        }
        mirror_others(&mut self.hyp.p, motion_of(self.a), self.uncertain);
    }

    /// Carries the covariance from sample to sample, and leaves each as it is reached.
    #[inline(always)]
    fn follow_covariance(&mut self, part: &Stretch, mut leave: impl FnMut(usize, &MotionCovariance, &Hypothesis)) {
        let (i, axes) = (motion_of(self.a), self.model.axes());
        let walk = self.model.layout.walks()[i + 2];
        let burst = self.hyp.memory.burst.map_or(0.0, |burst| if burst.axis == self.a { burst.density } else { 0.0 });
        let densities = part.samples.density[part.first * axes + self.a..].iter().step_by(axes);
        let (mut covariance, mut begun_s) = (MotionCovariance::of(&self.hyp.p, i), self.begun_s);
        for (k, (&end_s, &density)) in part.time_s[part.first..part.end].iter().zip(densities).enumerate() {
            let dt = end_s - begun_s;
            begun_s = end_s;
            covariance = covariance.moved(dt, walk).with_noise(dt, density);
            if burst != 0.0 {
                covariance = covariance.with_noise(dt, burst);
            }
            if !self.uncertain.is_empty() {
                predict_others(&mut self.hyp.p, i, dt, self.uncertain);
            }
            leave(k, &covariance, self.hyp);
        }
        covariance.put(&mut self.hyp.p, i);
    }

    /// Carries the mean from sample to sample, and leaves each as it is reached, with what the velocity state is ahead.
    #[inline(always)]
    fn follow_mean(&mut self, part: &Stretch, mut leave: impl FnMut(usize, &MotionMean, f64, &Hypothesis)) {
        let (model, a, axes) = (self.model, self.a, self.model.axes());
        let (i, lean) = (motion_of(a), model.lean[a]);
        let accelerations = part.samples.value[part.first * axes + a..].iter().step_by(axes);
        let (mut mean, mut motion, mut begun_s) = (MotionMean::of(&self.hyp.x, i), self.motion, self.begun_s);
        for (k, (&end_s, &value)) in part.time_s[part.first..part.end].iter().zip(accelerations).enumerate() {
            let dt = end_s - begun_s;
            begun_s = end_s;
            let now = if lean == 0.0 { value } else { leaned(value, lean, &mean, dt) };
            let led = motion.begin(now, dt, lead_of(dt));
            let moved = motion.response(dt);
            mean.v += led;
            mean = mean.moved(dt, moved);
            if !model.gain_of.is_empty() {
                shift_sensitivities(&mut self.hyp.x, a, led, &model.gain_of);
                predict_sensitivities(&mut self.hyp.x, a, dt, moved, &model.gain_of);
            }
            motion.input = now;
            leave(k, &mean, motion.ahead(), self.hyp);
        }
        (self.motion, self.begun_s) = (motion, begun_s);
        mean.put(&mut self.hyp.x, i);
    }

    /// Goes on over samples of one standing, and adds their rows.
    #[inline(always)]
    fn leave_rows(&mut self, part: &Stretch, known: &Known, standing: &Standing, out: &mut AxisRows) {
        let (first, a, before) = (part.first, self.a, out.status.len());
        let given = part.extend(&mut out.status, part.samples.kind, |kind| standing.status_of(kind));
        out.source.resize(before + given, standing.source);
        out.add_zeros(given);
        let mut variances = out.variance[before..].iter_mut();
        self.follow_covariance(part, |k, covariance, hyp| {
            if !part.is_row(first + k) {
                return;
            }
            if let Some(variance) = variances.next() {
                *variance = known.variance(hyp, a, covariance);
            }
        });
        let rows = out.displacement[before..].iter_mut().zip(&mut out.variance[before..]);
        let mut rows = rows.zip(&mut out.velocity[before..]);
        self.follow_mean(part, |k, mean, ahead, hyp| {
            if !part.is_row(first + k) {
                return;
            }
            if let Some(((place, variance), velocity)) = rows.next() {
                (*place, *variance, *velocity) = known.row(hyp, a, (mean, ahead), *variance, standing.clock_variance);
            }
        });
    }

    /// Goes on over samples of one standing, and puts their nodes from a number on.
    #[inline(always)]
    fn leave_nodes(
        &mut self,
        part: &Stretch,
        known: &Known,
        standing: &Standing,
        (back, place): (&mut WayBack, usize),
    ) {
        let a = self.a;
        self.follow_covariance(part, |k, own, hyp| back.put_covariance(place + k, a, own, hyp, known.datum));
        self.follow_mean(part, |k, mean, ahead, hyp| back.put_mean(place + k, a, (mean, ahead), hyp, known.datum));
        for (k, &kind) in part.samples.kind[part.first..part.end].iter().enumerate() {
            back.put_status(place + k, a, standing.source, standing.status_of(kind));
        }
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

    /// Variance of a sample's row, of the states alone.
    #[inline(always)]
    fn variance(&self, hyp: &Hypothesis, a: usize, covariance: &MotionCovariance) -> f64 {
        let own = match self.datum {
            Some(d) => covariance.xx + (self.datum_variance - 2.0 * hyp.p[(motion_of(a), d)]),
            None => covariance.xx,
        };
        self.misfit * own.max(0.0)
    }

    /// Displacement of a sample's row, its variance and the velocity; variance: of the states alone.
    #[inline(always)]
    fn row(
        &self,
        hyp: &Hypothesis,
        a: usize,
        (mean, ahead): (&MotionMean, f64),
        mut variance: f64,
        clock_variance: f64,
    ) -> (f64, f64, f64) {
        let (mut value, mut velocity) = (mean.x, mean.v);
        if let Some(d) = self.datum {
            value -= hyp.x[(d, 0)];
        }
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

    /// The code of a row's status by the kind of its sample; bridged ones are coasting at best.
    #[inline(always)]
    fn status_of(&self, kind: u8) -> u8 {
        if kind == BRIDGED { self.status.max(Status::Coasting) as u8 } else { self.status as u8 }
    }
}
