//! What a run leaves of a block for the pass back: of each sample what the filter found, of each item what it did to it.

use super::hypothesis::Hypothesis;
use super::innovation::Work;
use super::layout::{MOTION_STATES, motion_of};
use super::model::Model;
use super::motion::{AxisMotion, Clock};
use super::predict::{MotionCovariance, MotionMean};
use super::rows::status_at;
use super::samples::View;
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

/// Samples of which the same states are uncertain.
#[derive(Clone, Copy, Debug)]
struct Span {
    /// Number of the first one.
    sample: usize,
    /// Where its node begins.
    node: usize,
    /// Where its states begin in `live`.
    live: usize,
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
    /// Of each sample and axis displacement relative to the datum (1 + k), true velocity (1 + k), and the covariances of
    /// both with the live states: those of the motion and those that are uncertain then.
    nodes: Vec<f64>,
    spans: Vec<Span>,
    live: Vec<usize>,
    /// Source and status of each sample (n · axes).
    statuses: Vec<(u8, u8)>,
    pub(super) records: Vec<Record>,
    /// Of each record its sensitivities (1 + k) and gain (n).
    pub(super) details: Vec<f64>,
    /// States (n,) that are uncertain in some part of the block.
    pub(super) uncertain: Vec<bool>,
}

/// The node of a sample along an axis: displacement and velocity (1 + k), and the covariances of both with the live states.
pub(super) struct Node<'a> {
    pub(super) places: &'a [f64],
    pub(super) speeds: &'a [f64],
    pub(super) live: &'a [usize],
    pub(super) pc: &'a [f64],
    pub(super) pv: &'a [f64],
}

impl WayBack {
    /// Forgets what was left, to be used again from a filter's time on.
    pub fn restart(&mut self, model: &Model, start_s: f64) {
        (self.axes, self.columns, self.size, self.start_s) = (model.axes(), model.columns(), model.size(), start_s);
        self.time_s.clear();
        self.nodes.clear();
        self.spans.clear();
        self.live.clear();
        self.statuses.clear();
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
        self.statuses[k * self.axes + axis]
    }

    /// Marks states that are uncertain from here on, besides the motion's.
    #[inline]
    pub fn note_uncertain(&mut self, states: &[usize]) {
        let moving = MOTION_STATES * self.axes;
        let span = Span { sample: self.len(), node: self.nodes.len(), live: self.live.len() };
        if let Some(last) = self.spans.last().copied() {
            if self.live[last.live + moving..] == *states {
                return;
            }
            if last.sample == span.sample {
                self.spans.pop();
                self.live.truncate(last.live);
            }
        }
        self.spans.push(Span { live: self.live.len(), ..span });
        self.live.extend((0..moving).chain(states.iter().copied()));
        for &j in states {
            self.uncertain[j] = true;
        }
    }

    /// The number of the span that a sample belongs to; near: of one that is not earlier.
    #[inline]
    pub(super) fn span_of(&self, k: usize, near: usize) -> usize {
        let mut place = near.min(self.spans.len() - 1);
        while self.spans[place].sample > k {
            place -= 1;
        }
        place
    }

    /// The node of a sample of a span along an axis.
    #[inline]
    pub(super) fn node(&self, span: usize, k: usize, a: usize) -> Node<'_> {
        let end = self.spans.get(span + 1).map_or(self.live.len(), |next| next.live);
        let span = &self.spans[span];
        let live = &self.live[span.live..end];
        let stride = 2 * (self.columns + live.len());
        let first = span.node + ((k - span.sample) * self.axes + a) * stride;
        let (places, rest) = self.nodes[first..first + stride].split_at(self.columns);
        let (speeds, rest) = rest.split_at(self.columns);
        let (pc, pv) = rest.split_at(live.len());
        Node { places, speeds, live, pc, pv }
    }

    /// Adds samples at these times (s), whose nodes and statuses are to be put; returns the number of the first.
    pub fn add_samples(&mut self, time_s: &[f64]) -> usize {
        let first = self.time_s.len();
        self.time_s.extend_from_slice(time_s);
        self.statuses.resize(self.time_s.len() * self.axes, (0, 0));
        first
    }

    /// Adds the node of the next sample along the next axis, of what the filter found: the motion's mean and covariance, and
    /// what the velocity state is ahead; datum: the state that its rows count from.
    #[inline(always)]
    pub fn add_node(
        &mut self,
        a: usize,
        (mean, own, ahead): (&MotionMean, &MotionCovariance, f64),
        hyp: &Hypothesis,
        datum: Option<usize>,
    ) {
        let (i, x, p, columns) = (motion_of(a), &hyp.x, &hyp.p, self.columns);
        let live = &self.live[self.spans.last().map_or(0, |span| span.live)..];
        let first = self.nodes.len();
        self.nodes.resize(first + 2 * (columns + live.len()), 0.0);
        let (places, rest) = self.nodes[first..].split_at_mut(columns);
        let (speeds, rest) = rest.split_at_mut(columns);
        let (pc, pv) = rest.split_at_mut(live.len());
        (places[0], speeds[0]) = (mean.x, mean.v - ahead);
        for q in 1..columns {
            (places[q], speeds[q]) = (x[(i, q)], x[(i + 1, q)]);
        }
        if live.len() > MOTION_STATES {
            for ((c, v), &j) in pc.iter_mut().zip(pv.iter_mut()).zip(live) {
                (*c, *v) = (p[(i, j)], p[(i + 1, j)]);
            }
        }
        pc[i..i + MOTION_STATES].copy_from_slice(&[own.xx, own.xv, own.xb]);
        pv[i..i + MOTION_STATES].copy_from_slice(&[own.xv, own.vv, own.vb]);
        if let Some(d) = datum {
            for (q, place) in places.iter_mut().enumerate() {
                *place -= x[(d, q)];
            }
            // The motion's rows hold its covariances with the datum; the datum's may be behind.
            for (c, &j) in pc.iter_mut().zip(live) {
                *c -= if j / MOTION_STATES == a { p[(j, d)] } else { p[(d, j)] };
            }
        }
    }

    /// Puts source and status of a sample's row along an axis.
    #[inline]
    pub fn put_status(&mut self, k: usize, a: usize, status: (u8, u8)) {
        self.statuses[k * self.axes + a] = status;
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
            self.add_node(a, (&mean, &own, axis.ahead()), hyp, datum);
            self.put_status(k, a, status_at(hyp, a, clock, model, at));
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
