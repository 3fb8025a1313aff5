//! What a run leaves of a block for the pass back: of each sample what the filter found, of each item what it did to
//! it.

use super::coast::Course;
use super::hypothesis::Hypothesis;
use super::innovation::Work;
use super::layout::{MOTION_STATES, motion_of};
use super::model::Model;
use super::rows::Standing;
use super::slow::Turn;
use super::waiting::{Item, Timed};

/// What an item did to the filter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Record {
    /// Number of the sample that ends its interval.
    pub(super) sample: usize,
    pub(super) at_s: f64,
    pub(super) what: Recorded,
}

/// What was made of a channel's states before its measurement.
#[derive(Clone, Copy, Debug)]
pub struct Scaled {
    /// Of the shift, where it reverts or is gone.
    pub shift: Turn,
    /// On the reference.
    pub reference: f64,
    /// Of the slow error.
    pub slow: Turn,
}

impl Scaled {
    /// Nothing changes.
    pub const NONE: Self = Self { shift: Turn::NONE, reference: 1.0, slow: Turn::NONE };
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Recorded {
    Measured {
        channel: usize,
        /// The innovation's variance it was taken with, infinite where it began a zero; None: not at all.
        total: Option<f64>,
        scaled: Scaled,
    },
    Datum,
    Doubt,
    /// A clock has stepped: the parameter, and what it was estimated to be before.
    ClockStep {
        parameter: usize,
        value: f64,
    },
    /// A parameter counts from another value: by how much it is less than before.
    Relinearised {
        parameter: usize,
        by: f64,
    },
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
    /// Of each sample and axis displacement relative to the datum (1 + k), true velocity (1 + k), and the covariances
    /// of both with the live states: those of the motion and those that are uncertain then.
    nodes: Vec<f64>,
    spans: Vec<Span>,
    live: Vec<usize>,
    /// Source and status of each sample (n · axes).
    statuses: Vec<(u8, u8)>,
    /// Variance (n · axes) of where the structure is, as the accelerometer's clock may have stepped, m².
    doubts_m2: Vec<f64>,
    pub(super) records: Vec<Record>,
    /// Of each record its sensitivities (1 + k) and gain (n).
    pub(super) details: Vec<f64>,
    /// States (n,) that are uncertain in some part of the block.
    pub(super) uncertain: Vec<bool>,
}

/// The node of a sample along an axis: displacement and velocity (1 + k), and the covariances of both with the live
/// states.
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
        self.doubts_m2.clear();
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

    /// Adds samples at these times (s), whose nodes and statuses are to follow.
    pub fn add_samples(&mut self, time_s: &[f64]) {
        self.time_s.extend_from_slice(time_s);
    }

    /// Variance (m²) of a sample's row along an axis, as the accelerometer's clock may have stepped since a measurement.
    pub fn doubt_m2(&self, k: usize, axis: usize) -> f64 {
        self.doubts_m2[k * self.axes + axis]
    }

    /// Adds what this many samples' rows along the next axis rest on, and the doubt about the accelerometer's clock.
    pub fn add_statuses(&mut self, count: usize, standing: &Standing, doubt_m2: f64) {
        self.statuses.extend(std::iter::repeat_n((standing.source, standing.status as u8), count));
        self.doubts_m2.extend(std::iter::repeat_n(doubt_m2, count));
    }

    /// Adds the nodes of the next samples along the next axis, of what the filter left; its other states are the live
    /// ones but the axis' motion.
    pub(super) fn add_nodes(&mut self, hyp: &Hypothesis, model: &Model, a: usize, course: &Course) {
        let (i, x, p, columns) = (motion_of(a), &hyp.x, &hyp.p, self.columns);
        let live = &self.live[self.spans.last().map_or(0, |span| span.live)..];
        let datum = model.datum.as_ref().map(|datum| datum[a]);
        let other = |place: usize| if place < i { place } else { place - MOTION_STATES };
        let stride = 2 * (columns + live.len());
        let first = self.nodes.len();
        self.nodes.resize(first + course.count * stride, 0.0);
        for (k, node) in self.nodes[first..].chunks_exact_mut(stride).enumerate() {
            let (places, rest) = node.split_at_mut(columns);
            let (speeds, rest) = rest.split_at_mut(columns);
            let (pc, pv) = rest.split_at_mut(live.len());
            (places[0], speeds[0]) = (course.mean.x[k], course.mean.v[k]);
            for (q, pair) in course.sensitivities.iter().enumerate() {
                (places[1 + q], speeds[1 + q]) = (pair.x[k], pair.v[k]);
            }
            for place in (0..i).chain(i + MOTION_STATES..live.len()) {
                (pc[place], pv[place]) = (course.others[other(place)].x[k], course.others[other(place)].v[k]);
            }
            let own = &course.covariance[k];
            pc[i..i + MOTION_STATES].copy_from_slice(&[own.xx, own.xv, own.xb]);
            pv[i..i + MOTION_STATES].copy_from_slice(&[own.xv, own.vv, own.vb]);
            let Some(d) = datum else { continue };
            for (q, place) in places.iter_mut().enumerate() {
                *place -= x[(d, q)];
            }
            let Some(common) = live.iter().position(|&j| j == d) else { continue };
            for (c, &j) in pc.iter_mut().zip(live) {
                *c -= p[(d, j)];
            }
            // The covariances of the motion with the datum are those of the sample.
            let common = &course.others[other(common)];
            pc[i..i + MOTION_STATES].copy_from_slice(&[
                own.xx - common.x[k],
                own.xv - common.v[k],
                own.xb - p[(i + 2, d)],
            ]);
        }
    }

    /// Adds a measurement.
    #[inline]
    pub fn leave_record(&mut self, at_s: f64, channel: usize, total: Option<f64>, scaled: Scaled, work: &Work) {
        let what = Recorded::Measured { channel, total, scaled };
        self.records.push(Record { sample: self.time_s.len(), at_s, what });
        self.details.extend_from_slice(&work.e);
        self.details.extend_from_slice(&work.gain);
    }

    /// Adds a mark; parameters (k,): before it.
    pub fn pass_mark(&mut self, mark: Timed, parameters: &[f64]) {
        let what = match mark.item {
            Item::Datum => Recorded::Datum,
            Item::ClockStep { parameter, .. } => Recorded::ClockStep { parameter, value: parameters[parameter] },
            Item::Relinearised { parameter, by_s } => Recorded::Relinearised { parameter, by: by_s },
            Item::WentBack | Item::Measured(_) => Recorded::Doubt,
        };
        self.records.push(Record { sample: self.time_s.len(), at_s: mark.at_s, what });
        self.details.resize(self.details.len() + self.columns + self.size, 0.0);
    }
}
