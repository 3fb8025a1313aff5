//! What a run leaves of a block for the pass back: of each sample what the filter found, of each item what it did to it.

use super::hypothesis::Hypothesis;
use super::innovation::Work;
use super::layout::{MOTION_STATES, motion_of};
use super::model::Model;
use super::motion::{AxisMotion, Clock};
use super::predict::{MotionCovariance, MotionMean};
use super::rows::{AxisRows, Status, status_of};
use super::samples::{BRIDGED, View};
use super::waiting::{Item, Timed};

/// What an item did to the filter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Record {
    /// Number of the sample that ends its interval.
    pub(super) sample: usize,
    pub(super) at_s: f64,
    pub(super) what: Recorded,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Recorded {
    Measured {
        channel: usize,
        /// The innovation's variance it was taken with, infinite where it began a zero; None: not at all.
        total: Option<f64>,
        shift_scaled: f64,
        reference_scaled: f64,
    },
    Datum,
    Doubt,
}

/// What a run leaves of a block for the pass back.
#[derive(Clone, Debug, Default)]
pub struct WayBack {
    pub(super) axes: usize,
    pub(super) columns: usize,
    pub(super) size: usize,
    /// The filter's time before the first sample, s.
    pub(super) start_s: f64,
    /// Times of the samples, s.
    pub(super) time_s: Vec<f64>,
    /// Of each sample and axis displacement relative to the datum (1 + k), true velocity (1 + k), and the covariances (n)
    /// of both with all states.
    pub(super) nodes: Vec<f64>,
    /// Source and status of each axis' rows.
    pub(super) statuses: Vec<AxisRows>,
    pub(super) records: Vec<Record>,
    /// Of each record its sensitivities (1 + k) and gain (n).
    pub(super) details: Vec<f64>,
    /// States (n,) that are uncertain in some part of the block.
    pub(super) uncertain: Vec<bool>,
    /// The motion's states and those that are uncertain now.
    live: Vec<usize>,
}

impl WayBack {
    /// Forgets what was left, to be used again from a filter's time on.
    pub fn restart(&mut self, model: &Model, start_s: f64) {
        (self.axes, self.columns, self.size, self.start_s) = (model.axes(), model.columns(), model.size(), start_s);
        self.time_s.clear();
        self.nodes.clear();
        self.statuses.resize_with(self.axes, AxisRows::default);
        for one in &mut self.statuses {
            one.source.clear();
            one.status.clear();
        }
        self.records.clear();
        self.details.clear();
        self.uncertain.clear();
        self.uncertain.resize(self.size, false);
        self.uncertain[..model.layout.moving()].fill(true);
    }

    /// How many samples there are.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Source and status of a sample's row along an axis.
    pub fn status(&self, k: usize, axis: usize) -> (u8, u8) {
        let one = &self.statuses[axis];
        (one.source[k], one.status[k])
    }

    /// Marks states that are uncertain from here on, besides the motion's.
    #[inline]
    pub fn note_uncertain(&mut self, states: &[usize]) {
        self.live.clear();
        self.live.extend((0..MOTION_STATES * self.axes).chain(states.iter().copied()));
        for &j in states {
            self.uncertain[j] = true;
        }
    }

    /// Adds samples at these times (s), whose nodes and statuses are to be put; returns the number of the first.
    pub fn add_samples(&mut self, time_s: &[f64]) -> usize {
        let first = self.time_s.len();
        self.time_s.extend_from_slice(time_s);
        let count = self.time_s.len();
        self.nodes.resize(count * self.axes * 2 * (self.columns + self.size), 0.0);
        for one in &mut self.statuses {
            one.source.resize(count, 0);
            one.status.resize(count, 0);
        }
        first
    }

    /// The node of a sample along an axis: displacement and velocity (1 + k), and the covariances of both (n).
    #[inline(always)]
    fn node(&mut self, k: usize, a: usize) -> [&mut [f64]; 4] {
        let stride = 2 * (self.columns + self.size);
        let first = (k * self.axes + a) * stride;
        let (places, rest) = self.nodes[first..first + stride].split_at_mut(self.columns);
        let (speeds, rest) = rest.split_at_mut(self.columns);
        let (pc, pv) = rest.split_at_mut(self.size);
        [places, speeds, pc, pv]
    }

    /// Puts the mean that the filter found of a sample along an axis, and what the velocity state is ahead; datum: the state
    /// that its rows count from.
    #[inline(always)]
    pub fn put_mean(
        &mut self,
        k: usize,
        a: usize,
        (mean, ahead): (&MotionMean, f64),
        hyp: &Hypothesis,
        datum: Option<usize>,
    ) {
        let (i, x, [places, speeds, ..]) = (motion_of(a), &hyp.x, self.node(k, a));
        (places[0], speeds[0]) = (mean.x, mean.v - ahead);
        for q in 1..places.len() {
            (places[q], speeds[q]) = (x[(i, q)], x[(i + 1, q)]);
        }
        if let Some(d) = datum {
            for (q, place) in places.iter_mut().enumerate() {
                *place -= x[(d, q)];
            }
        }
    }

    /// Puts its covariances; those with states that are certain are 0, as which they were added.
    #[inline(always)]
    pub fn put_covariance(
        &mut self,
        k: usize,
        a: usize,
        own: &MotionCovariance,
        hyp: &Hypothesis,
        datum: Option<usize>,
    ) {
        let (i, p, live) = (motion_of(a), &hyp.p, std::mem::take(&mut self.live));
        let [_, _, pc, pv] = self.node(k, a);
        for &j in &live {
            (pc[j], pv[j]) = (p[(i, j)], p[(i + 1, j)]);
        }
        pc[i..i + MOTION_STATES].copy_from_slice(&[own.xx, own.xv, own.xb]);
        pv[i..i + MOTION_STATES].copy_from_slice(&[own.xv, own.vv, own.vb]);
        if let Some(d) = datum {
            // The motion's rows hold its covariances with the datum; the datum's may be behind.
            for &j in &live {
                pc[j] -= if j / MOTION_STATES == a { p[(j, d)] } else { p[(d, j)] };
            }
        }
        self.live = live;
    }

    /// Puts source and status of a sample's row along an axis.
    #[inline]
    pub fn put_status(&mut self, k: usize, a: usize, source: u8, status: u8) {
        let one = &mut self.statuses[a];
        (one.source[k], one.status[k]) = (source, status);
    }

    /// Adds a sample with all its nodes.
    pub fn leave_node(
        &mut self,
        hyp: &Hypothesis,
        motion: &[AxisMotion],
        clock: &Clock,
        model: &Model,
        at: (View, usize),
    ) {
        let k = self.add_samples(&[clock.time_s]);
        for (a, axis) in motion.iter().enumerate() {
            let (mean, own) = (MotionMean::of(&hyp.x, motion_of(a)), MotionCovariance::of(&hyp.p, motion_of(a)));
            let datum = model.datum.as_ref().map(|datum| datum[a]);
            self.put_mean(k, a, (&mean, axis.ahead()), hyp, datum);
            self.put_covariance(k, a, &own, hyp, datum);
            let (source, status) = status_of(hyp, a, model, clock.time_s);
            let bridged = at.0.kind[at.1] == BRIDGED;
            self.put_status(k, a, source, if bridged { status.max(Status::Coasting) } else { status } as u8);
        }
    }

    /// Adds a measurement; scaled: factors on the states of its shift and its reference.
    #[inline]
    pub fn leave_record(&mut self, at_s: f64, channel: usize, total: Option<f64>, scaled: (f64, f64), work: &Work) {
        let what = Recorded::Measured { channel, total, shift_scaled: scaled.0, reference_scaled: scaled.1 };
        self.records.push(Record { sample: self.time_s.len(), at_s, what });
        self.details.extend_from_slice(&work.e);
        self.details.extend_from_slice(&work.gain);
    }

    /// Adds a mark.
    pub fn pass_mark(&mut self, mark: Timed) {
        let what = if mark.item == Item::Datum { Recorded::Datum } else { Recorded::Doubt };
        self.records.push(Record { sample: self.time_s.len(), at_s: mark.at_s, what });
        self.details.resize(self.details.len() + self.columns + self.size, 0.0);
    }
}
