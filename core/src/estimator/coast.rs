//! The samples between two measurements, while there is one hypothesis: most of a record.
//!
//! It does what [`super::run`] does of a sample without a measurement, in the same order of sums, so that the bits are the
//! same; what stays as it is between measurements is looked up once.

use super::layout::{MOTION_STATES, motion_of};
use super::model::Model;
use super::predict::{MotionCovariance, mirror_others, predict_across, predict_axis_mean, predict_others, predict_walks};
use super::rows::{Rows, Status, status_of, zero_variance};
use super::run::{Block, Filter};
use super::samples::BRIDGED;
use super::settings::MAX_AXES;
use super::smoother::WayBack;

/// What is known of an axis' rows until the next measurement.
#[derive(Clone, Copy)]
struct Known {
    covariance: MotionCovariance,
    /// Variance that no row is more certain than, and that is added to each.
    least: f64,
    unseen: f64,
    misfit: f64,
    /// Source and status up to a time, s.
    source: u8,
    status: Status,
    until_s: f64,
}

/// Where rows and nodes go.
pub struct Leave<'a> {
    /// Rows.
    pub rows: Option<&'a mut Rows>,
    /// What the way back needs.
    pub back: Option<&'a mut WayBack>,
}

impl Filter {
    /// Goes on from sample `first` to before the first one after `before_s`, or behind a gap; returns that one's number.
    pub fn coast(&mut self, model: &Model, block: &Block, first: usize, before_s: f64, uncertain: &[usize], leave: &mut Leave) -> usize {
        let axes = model.axes();
        let mut known = [self.known(model, 0); MAX_AXES];
        for (a, one) in known.iter_mut().enumerate().take(axes).skip(1) {
            *one = self.known(model, a);
        }
        let mut k = first;
        while let Some(&end_s) = block.time_s.get(k).filter(|&&end_s| end_s < before_s && !self.clock.is_gap(end_s)) {
            self.coast_over(model, block, (k, end_s), uncertain, &mut known);
            if let Some(rows) = leave.rows.as_deref_mut().filter(|_| block.samples.is_row(k, block.first_ns)) {
                self.coast_row(model, block, k, &mut known, rows);
            }
            if let Some(back) = leave.back.as_deref_mut() {
                for (a, one) in known.iter().enumerate().take(axes) {
                    let p = &mut self.hyps.best_mut().p;
                    one.covariance.put(p, motion_of(a));
                    mirror_others(p, motion_of(a), uncertain);
                }
                back.leave_node(self.hyps.best(), &self.motion, &self.clock, model, (block.samples, k));
            }
            k += 1;
        }
        let p = &mut self.hyps.best_mut().p;
        for (a, one) in known.iter().enumerate().take(axes) {
            one.covariance.put(p, motion_of(a));
            mirror_others(p, motion_of(a), uncertain);
        }
        k
    }

    fn known(&self, model: &Model, a: usize) -> Known {
        let best = self.hyps.best();
        Known {
            covariance: MotionCovariance::of(&best.p, motion_of(a)),
            least: zero_variance(best, a, model),
            unseen: model.unseen_m2[a],
            misfit: model.misfit[a],
            source: 0,
            status: Status::Lost,
            until_s: f64::NEG_INFINITY,
        }
    }

    /// Moves over the interval that ends at a sample.
    #[inline(always)]
    fn coast_over(&mut self, model: &Model, block: &Block, (k, end_s): (usize, f64), uncertain: &[usize], known: &mut [Known; MAX_AXES]) {
        let (axes, dt, lead) = (model.axes(), end_s - self.clock.time_s, self.clock.lead(end_s));
        let walks = model.layout.walks();
        let hyp = self.hyps.best_mut();
        for (a, axis) in self.motion.iter_mut().enumerate() {
            let i = motion_of(a);
            let now = block.samples.value[k * axes + a] + model.lean[a] * (hyp.x[(i, 0)] + dt * hyp.x[(i + 1, 0)]);
            axis.begin(now, dt, lead, &mut hyp.x, a, &model.gain_of);
            let moved = axis.response(dt);
            predict_axis_mean(&mut hyp.x, a, dt, moved, &model.gain_of);
            let mut covariance = known[a].covariance.moved(dt, walks[i + 2]).with_noise(dt, block.samples.density[k * axes + a]);
            if let Some(burst) = hyp.memory.burst.filter(|burst| burst.axis == a) {
                covariance = covariance.with_noise(dt, burst.density);
            }
            known[a].covariance = covariance;
            predict_others(&mut hyp.p, i, dt, uncertain);
            axis.input = now;
        }
        if axes > 1 {
            for i in (0..axes * MOTION_STATES).step_by(MOTION_STATES) {
                for other in (i + MOTION_STATES..axes * MOTION_STATES).step_by(MOTION_STATES) {
                    predict_across(&mut hyp.p, i, other, dt);
                }
            }
        }
        predict_walks(&mut hyp.p, walks, dt, uncertain);
        self.clock.advance(end_s);
    }

    /// Adds the rows of all axes.
    #[inline(always)]
    fn coast_row(&self, model: &Model, block: &Block, k: usize, known: &mut [Known; MAX_AXES], rows: &mut Rows) {
        let (hyp, time_s) = (self.hyps.best(), self.clock.time_s);
        rows.time_ns.push(block.samples.time_ns[k]);
        let bridged = block.samples.kind[k] == BRIDGED;
        for (a, out) in rows.axes.iter_mut().enumerate() {
            let own = &mut known[a];
            if time_s > own.until_s {
                (own.source, own.status) = status_of(hyp, a, model, time_s);
                own.until_s = same_status_until(hyp.marks.iter().zip(&model.channels).filter(|one| one.1.row.axis == a).flat_map(
                    |(mark, channel)| [mark.accepted_s + channel.coasting_s, mark.accepted_s + channel.lost_s],
                ), time_s);
            }
            let i = motion_of(a);
            let (mut value, mut variance, mut velocity) = (hyp.x[(i, 0)], own.covariance.xx, hyp.x[(i + 1, 0)]);
            let datum = model.datum.as_ref().map(|datum| datum[a]);
            if let Some(d) = datum {
                value -= hyp.x[(d, 0)];
                variance += hyp.p[(d, d)] - 2.0 * hyp.p[(i, d)];
            }
            variance = own.misfit * variance.max(0.0);
            if !hyp.parameters.is_empty() {
                hyp.add_parameters(a, datum, (&mut value, &mut variance, &mut velocity));
            }
            out.displacement.push(value);
            out.variance.push(variance.max(own.least) + own.unseen);
            out.velocity.push(velocity - self.motion[a].ahead());
            out.source.push(own.source);
            out.status.push(if bridged { own.status.max(Status::Coasting) } else { own.status } as u8);
        }
    }
}

/// Until when a status surely stays: shortly before the first of some limits that is not past.
fn same_status_until(limits: impl Iterator<Item = f64>, time_s: f64) -> f64 {
    // Ages are differences that are rounded: near a limit each row is looked at.
    const NEAR_S: f64 = 1e-6;
    limits.filter(|&limit| limit + NEAR_S >= time_s).map(|limit| limit - NEAR_S).fold(f64::INFINITY, f64::min)
}
