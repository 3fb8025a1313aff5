//! Steps of a sensor's zero that no single measurement shows: the ratio of likelihoods over many innovations.
//!
//! A step that began at some instant leaves a signature in all innovations after it, through the filter's own gains.
//! Its size and the ratio of likelihoods follow from sums of signature times innovation, and the estimate with the step
//! from the one without it (A. S. Willsky, H. L. Jones, A generalized likelihood ratio approach to the detection and
//! estimation of jumps in linear systems, IEEE Trans. Automat. Contr. 21 (1976) 108-112, doi
//! 10.1109/TAC.1976.1101146; the exact correction is Friedland's, doi 10.1109/TAC.1969.1099223). Sums are kept for a
//! bounded number of instants. An error of the acceleration that left a wrong velocity is weighed against each step: it
//! asks for no correction, as the filter follows the sensor then.
//!
//! Each quantity holds both causes of all instants side by side, so that the processor takes several at a time; where
//! an instant is not in use all is 0 and stays so.

use super::hypothesis::{Contradiction, Hypothesis};
use super::layout::{MOTION_STATES, motion_of};
use super::matrix::Matrix;
use super::model::{ChannelModel, Model};
use super::row::Row;
use super::settings::Rates;
use super::situation::{LOG_2PI, met_within};
use super::slow::{SlowError, Turn};
use crate::track::vector::vectorised;
use serde::{Deserialize, Serialize};

/// Instants at which a step may have begun, of each sensor along each axis.
pub const INSTANTS: usize = 16;
/// From one of them to the next the updates take over this share of what a measurement is off, all together: a step
/// there looks alike. So the instants reach back over four times the filter's memory at least.
pub const APART_BY: f64 = 0.25;
/// A step is taken out where it is likelier than none (logarithm of the odds), as the likeliest hypothesis is taken.
/// With one an hour, five measurements a second and sizes alike in all decades that is at 5.1 deviations of its size.
pub const SURE: f64 = 0.0;
/// After this share of the gaps a sensor has been moved or set up anew, as its clock may have been.
const P_MOVED: f64 = 0.1;
/// No step and no wrong acceleration is more probable beforehand, and the logarithm of that.
const MAX_PROBABILITY: f64 = 0.5;
const MAX_LOG_PROBABILITY: f64 = -std::f64::consts::LN_2;
/// Both causes of all instants: the zero's step (1 m), then that of the velocity (1 m/s).
const LANES: usize = 2 * INSTANTS;

/// When a step may have begun, and the time since the measurement before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Instant {
    /// When, s.
    pub since_s: f64,
    /// Time in which it may have happened, s.
    pub lapse_s: f64,
}

/// The steps that a group of channels may have made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepTest {
    instants: [Option<Instant>; INSTANTS],
    /// Time up to which all are carried, s.
    carried_s: f64,
    /// Shares taken over since the last instant.
    pub taken_over: f64,
    /// The place of the next instant.
    next: usize,
    /// Of each lane the sum of its information, of signature times innovation (1 + k), and what it has changed of the
    /// states that the filter does not know (n).
    sums: Vec<[f64; LANES]>,
    columns: usize,
    /// Whether any lane has changed a state (n,): the others' rows are 0.
    changed: Vec<bool>,
}

/// The parameters of a hypothesis and what is known of its group, by which steps are weighed.
#[derive(Clone, Copy)]
pub struct Weighed<'a> {
    /// The channel whose measurement tells it.
    pub channel: &'a ChannelModel,
    /// How often each cause is met.
    pub rates: &'a Rates,
    /// The parameters as estimated (k,).
    pub parameters: &'a [f64],
    /// Their covariance (k, k).
    pub spread: &'a Matrix,
    /// Factor on the variance of the states.
    pub misfit: f64,
    /// Logarithm of the density of the size's logarithm.
    pub even: f64,
}

impl Weighed<'_> {
    /// Chi-square that odds of `least` need at least, of a cause with the logarithm of this probability.
    fn needed(&self, prior: f64, least: f64) -> f64 {
        ((2.0 * (least - prior - self.even) - LOG_2PI) * self.misfit).max(1.0)
    }
}

impl StepTest {
    /// None yet, of n states with this many columns.
    pub fn new(n: usize, columns: usize) -> Self {
        Self {
            instants: [None; INSTANTS],
            carried_s: 0.0,
            taken_over: 0.0,
            next: 0,
            sums: vec![[0.0; LANES]; 1 + columns + n],
            columns,
            changed: vec![false; n],
        }
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        if self.any() {
            self.sums.fill([0.0; LANES]);
            self.changed.fill(false);
        }
        self.instants = [None; INSTANTS];
        (self.carried_s, self.taken_over, self.next) = (0.0, 0.0, 0);
    }

    /// Becomes a copy.
    pub fn copy_from(&mut self, other: &Self) {
        if self.any() || other.any() {
            self.sums.clone_from(&other.sums);
            self.changed.clone_from(&other.changed);
        }
        self.instants = other.instants;
        (self.carried_s, self.taken_over, self.next) = (other.carried_s, other.taken_over, other.next);
    }

    /// Whether it is of this many states and columns.
    pub fn fits(&self, n: usize, columns: usize) -> bool {
        self.columns == columns && self.next < INSTANTS && self.changed.len() == n && self.sums.len() == 1 + columns + n
    }

    fn any(&self) -> bool {
        self.instants.iter().any(Option::is_some)
    }

    /// When the newest instant was, s.
    pub fn newest_s(&self) -> Option<f64> {
        self.instants[(self.next + INSTANTS - 1) % INSTANTS].map(|one| one.since_s)
    }

    /// The instant at a place.
    pub fn instant(&self, place: usize) -> Option<Instant> {
        self.instants.get(place).copied().flatten()
    }

    fn state(&self, j: usize) -> usize {
        1 + self.columns + j
    }

    /// Moves what all causes have changed of an axis' motion to an instant.
    fn carry(&mut self, at_s: f64, axis: usize) {
        let dt = at_s - self.carried_s;
        self.carried_s = at_s;
        let first = self.state(motion_of(axis));
        if dt != 0.0 && self.any() {
            carry_lanes(&mut self.sums[first..first + MOTION_STATES], dt);
        }
    }

    /// Begins a candidate in the place of the oldest.
    fn begin(&mut self, instant: Instant, zeros: impl Iterator<Item = usize>, axis: usize) {
        let place = self.next;
        self.next = (place + 1) % INSTANTS;
        self.taken_over = 0.0;
        self.instants[place] = Some(instant);
        for quantity in &mut self.sums {
            quantity[place] = 0.0;
            quantity[INSTANTS + place] = 0.0;
        }
        for shift in zeros {
            self.changed[shift] = true;
            let row = self.state(shift);
            self.sums[row][place] = 1.0;
        }
        // It happened some time since the measurement before.
        self.changed[motion_of(axis)..motion_of(axis) + 2].fill(true);
        let i = self.state(motion_of(axis));
        self.sums[i][INSTANTS + place] = 0.5 * instant.lapse_s;
        self.sums[i + 1][INSTANTS + place] = 1.0;
    }

    /// The information of a lane, and signature times innovation with the parameters.
    fn matched(&self, lane: usize, parameters: &[f64]) -> (f64, f64) {
        let mut matched = self.sums[1][lane];
        for (q, &value) in parameters.iter().enumerate() {
            matched += self.sums[2 + q][lane] * value;
        }
        (self.sums[0][lane], matched)
    }

    /// Logarithm of the odds of a cause of any size, each decade of which is as likely; None where they are below
    /// `least` or the size is below its deviation.
    fn odds(&self, lane: usize, prior: f64, weighed: &Weighed, least: f64) -> Option<f64> {
        let (known, matched) = self.matched(lane, weighed.parameters);
        // Most are refused here, without a division.
        if known <= 0.0 || matched * matched <= known * weighed.needed(prior, least) {
            return None;
        }
        let most = |chi: f64| prior + weighed.even + 0.5 * (chi / weighed.misfit + LOG_2PI);
        let mut chi = matched * matched / known;
        if !weighed.parameters.is_empty() {
            // The innovations have the parameters' errors in common: they are no step.
            let mut shared = 0.0;
            for q in 0..weighed.parameters.len() {
                for r in 0..weighed.parameters.len() {
                    shared += self.sums[2 + q][lane] * weighed.spread[(q, r)] * self.sums[2 + r][lane];
                }
            }
            chi = matched * matched / (known + shared);
        }
        // The variance over the square of the size is 1 / chi.
        (chi > 1.0 && most(chi) > least).then(|| most(chi) - 0.5 * chi.ln())
    }

    /// Of each lane whether its sums tell so much that its cause may be likely.
    fn may_tell(&self, weighed: &Weighed, least: f64) -> [bool; LANES] {
        let (mut matched, mut may) = (self.sums[1], [false; LANES]);
        for (q, &value) in weighed.parameters.iter().enumerate() {
            add_times(&mut matched, &self.sums[2 + q], value);
        }
        let needed = weighed.needed(MAX_LOG_PROBABILITY, least);
        for ((may, one), known) in may.iter_mut().zip(&matched).zip(&self.sums[0]) {
            *may = one * one > known * needed;
        }
        may
    }

    /// The place of the likeliest instant of a step; None where the odds (logarithm) of each, against no step or
    /// against a wrong acceleration, whichever is likelier, are below `least`.
    pub fn likeliest(&self, weighed: &Weighed, least: f64) -> Option<usize> {
        let (Weighed { channel, rates, .. }, may) = (weighed, self.may_tell(weighed, least));
        let mut best: Option<(usize, f64)> = None;
        for (place, (instant, _)) in self.instants.iter().zip(&may).enumerate().filter(|(_, (_, may))| **may) {
            let Some(instant) = instant else { continue };
            let prior = moved_probability(instant.lapse_s, channel, rates.shift).ln();
            if let Some(odds) = self.odds(place, prior, weighed, least) {
                if best.is_none_or(|(_, before)| odds > before) {
                    best = Some((place, odds));
                }
            }
        }
        let (place, odds) = best?;
        let other = self.instants.iter().enumerate().filter_map(|(place, instant)| {
            let prior = met_within(rates.wrong, instant.as_ref()?.lapse_s).min(MAX_PROBABILITY).ln();
            self.odds(INSTANTS + place, prior, weighed, f64::NEG_INFINITY)
        });
        (odds - other.fold(0.0, f64::max) >= least).then_some(place)
    }

    /// Corrects states and covariance by the step at a place; returns its size (m) and the variance of that (m²).
    pub fn take(&self, place: usize, x: &mut Matrix, p: &mut Matrix, parameters: &[f64]) -> Contradiction {
        let (known, matched) = self.matched(place, parameters);
        let variance = 1.0 / known;
        for i in 0..p.width() {
            let changed = self.sums[self.state(i)][place];
            if changed == 0.0 {
                continue;
            }
            for (q, value) in x.row_mut(i).iter_mut().enumerate() {
                *value += changed * self.sums[1 + q][place] * variance;
            }
            for j in 0..p.width() {
                p[(i, j)] += changed * self.sums[self.state(j)][place] * variance;
            }
        }
        Contradiction { size: matched / known, variance, ago_s: 0.0 }
    }
}

vectorised! {
    /// Moves what all causes have changed of a motion by `dt` seconds.
    fn carry_lanes(motion: &mut [[f64; LANES]], dt: f64) {
        let [places, speeds, biases] = motion else { return };
        let half = 0.5 * dt * dt;
        for ((place, speed), &bias) in places.iter_mut().zip(speeds).zip(biases.iter()) {
            *place += dt * *speed - half * bias;
            *speed -= dt * bias;
        }
    }
}

vectorised! {
    /// Adds an innovation `e` (1 + k) and its variance to the sums; gain (n,): K of its update.
    fn meet_lanes(test: &mut StepTest, row: &Row, gain: &[f64], e: &[f64], total: f64) {
        let mut signature = [0.0; LANES];
        for entry in &row.entries {
            if test.changed[entry.state] {
                add_times(&mut signature, &test.sums[1 + test.columns + entry.state], entry.factor);
            }
        }
        let (inverse, mut share) = (1.0 / total, [0.0; LANES]);
        add_times(&mut share, &signature, inverse);
        let (information, sums) = test.sums.split_at_mut(1);
        for ((sum, one), other) in information[0].iter_mut().zip(&signature).zip(&share) {
            *sum += one * other;
        }
        for (sum, &error) in sums.iter_mut().zip(e) {
            add_times(sum, &share, error);
        }
        for ((sum, &own), changed) in sums[test.columns..].iter_mut().zip(gain).zip(&mut test.changed) {
            if own != 0.0 {
                *changed = true;
                add_times(sum, &signature, -own);
            }
        }
    }
}

/// Adds a row times a factor.
#[inline(always)]
fn add_times(to: &mut [f64; LANES], row: &[f64; LANES], factor: f64) {
    for (sum, one) in to.iter_mut().zip(row) {
        *sum += one * factor;
    }
}

/// Moves what all causes have changed to an instant.
pub fn carry_all(tests: &mut [StepTest], at_s: f64, axes: usize) {
    for (g, test) in tests.iter_mut().enumerate() {
        test.carry(at_s, g % axes);
    }
}

/// A state has been scaled by a factor.
pub fn scale_changed(tests: &mut [StepTest], j: usize, factor: f64) {
    if factor == 1.0 {
        return;
    }
    for test in tests {
        let state = test.state(j);
        for changed in &mut test.sums[state] {
            *changed *= factor;
        }
    }
}

/// The states of a slow error have been turned.
pub fn turn_changed(tests: &mut [StepTest], slow: &SlowError, turn: Turn) {
    let Some(velocity) = slow.velocity else { return scale_changed(tests, slow.place, turn.left()) };
    for test in tests {
        let (i, q) = (slow.place, velocity);
        let either = test.changed[i] || test.changed[q];
        (test.changed[i], test.changed[q]) = (either, either);
        let (i, q) = (test.state(i), test.state(q));
        for lane in 0..LANES {
            (test.sums[i][lane], test.sums[q][lane]) = turn.of(test.sums[i][lane], test.sums[q][lane]);
        }
    }
}

/// Begins a candidate of a channel's group at a measurement.
pub fn begin_instant(hyp: &mut Hypothesis, channel: &ChannelModel, model: &Model, instant: Instant) {
    let group = channel.group;
    let zeros = model.channels.iter().filter(|one| one.group == group).map(|one| one.shift);
    hyp.tests[group].begin(instant, zeros, channel.row.axis);
}

/// Adds an innovation to the sums of all groups along its axis.
pub fn meet_innovation(tests: &mut [StepTest], row: &Row, axes: usize, gain: &[f64], e: &[f64], total: f64) {
    for test in tests.iter_mut().skip(row.axis).step_by(axes) {
        if test.any() {
            meet_lanes(test, row, gain, e, total);
        }
    }
}

/// Probability that a sensor's zero has shifted since its last measurement, `lapse` (s) ago; rate: a second.
fn moved_probability(lapse: f64, channel: &ChannelModel, rate: f64) -> f64 {
    let met = met_within(rate, lapse).min(MAX_PROBABILITY);
    if lapse > channel.coasting_s { met.max(P_MOVED) } else { met }
}
