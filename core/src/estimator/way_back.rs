//! What a run leaves of a block for the pass back: of each sample what the filter found, of each item what it did to it.

use super::hypothesis::Hypothesis;
use super::innovation::Work;
use super::layout::{MOTION_STATES, motion_of};
use super::model::Model;
use super::motion::{AxisMotion, Clock};
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

    /// Marks states that are uncertain.
    #[inline]
    pub fn note_uncertain(&mut self, states: &[usize]) {
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

    /// Puts what the filter found of a sample along an axis; datum: the state that its rows count from.
    #[inline]
    pub fn put_node(&mut self, k: usize, a: usize, hyp: &Hypothesis, axis: &AxisMotion, datum: Option<usize>) {
        let (i, columns, n) = (motion_of(a), self.columns, self.size);
        let stride = 2 * (columns + n);
        let first = (k * self.axes + a) * stride;
        let (x, p) = (&hyp.x, &hyp.p);
        let (places, rest) = self.nodes[first..first + stride].split_at_mut(columns);
        let (speeds, rest) = rest.split_at_mut(columns);
        let (pc, pv) = rest.split_at_mut(n);
        places.copy_from_slice(x.row(i));
        speeds.copy_from_slice(x.row(i + 1));
        speeds[0] -= axis.ahead();
        pc.copy_from_slice(p.row(i));
        pv.copy_from_slice(p.row(i + 1));
        if let Some(d) = datum {
            subtract(places, x.row(d));
            // The motion's rows hold its covariances with the datum; the datum's may be behind.
            for j in 0..n {
                pc[j] -= if j / MOTION_STATES == a { p[(j, d)] } else { p[(d, j)] };
            }
        }
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
            self.put_node(k, a, hyp, axis, model.datum.as_ref().map(|datum| datum[a]));
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

fn subtract(from: &mut [f64], other: &[f64]) {
    for (own, &one) in from.iter_mut().zip(other) {
        *own -= one;
    }
}
