//! The update of one hypothesis by a measurement that it accepts: states, noise, parameters, and steps of the zero.
//!
//! The variance of each channel's noise is followed by the variational Bayes filter (S. Särkkä, A. Nummenmaa, Recursive
//! noise adaptive Kalman filtering by variational Bayesian approximations, IEEE Trans. Automat. Contr. 54 (2009)
//! 596-600, doi 10.1109/TAC.2008.2008348): a mean, over the measurements that are remembered, of what is left of each
//! innovation after its update and of what the updated state's variance adds to it. The parameters are constants that
//! are carried as sensitivities; some of them are estimated.

use super::cause::Decision;
use super::hypothesis::{Hypothesis, LastShift, Mark};
use super::innovation::{Innovation, Scene, Work};
use super::matrix::Matrix;
use super::model::ParameterModel;
use super::row::{Effect, Row};
use super::situation::{DECADES, OUTLIER_MEMORY, SHORTEST_S};
use super::steps::{APART_BY, Instant, Weighed, begin_instant, carry_all, meet_innovation};
use super::update::{begin_zero, update};

/// Updates one hypothesis with a measurement; innovation: of `look`, with P h and sensitivities in `work`.
///
/// Returns the innovation's variance that it was taken with, infinite where it began the channel's zero.
#[inline]
pub fn accept(hyp: &mut Hypothesis, scene: &Scene, innovation: &Innovation, work: &mut Work) -> f64 {
    let (model, row, c) = (scene.model, &scene.channel.row, scene.row.channel);
    if model.looks_for_steps() && scene.channel.places {
        ask_for_step(hyp, scene, innovation.predicted / (innovation.predicted + innovation.noise));
    }
    hyp.memory.met.size = innovation.error;
    hyp.memory.met.variance = innovation.total();
    let (gain, e) = (&mut work.gain, &mut work.e);
    let (mut total, mut own) = (f64::INFINITY, innovation.noise);
    if hyp.marks[c].begun {
        adapt(&mut hyp.marks[c], innovation.error, innovation.with_parameters, innovation.noise, model.noise_memory);
        own = scene.row.variance * hyp.marks[c].factor;
        total = innovation.predicted + own;
        if !hyp.parameters.is_empty() {
            let observed = Observed {
                e,
                error: innovation.error,
                predicted: innovation.predicted,
                total: innovation.with_parameters + own,
                at_s: scene.at_s,
                last_s: hyp.memory.last_s,
            };
            learn(&mut hyp.parameters, &mut hyp.spread, &model.parameters, &observed, &mut work.parameters);
            hyp.memory.last_s = scene.at_s;
            move_to_updated(e, row, &model.parameters, scene.at_s, innovation.error * innovation.predicted / total);
        }
        update(&mut hyp.x, &mut hyp.p, gain, e, total);
    } else {
        hyp.marks[c].begun = true;
        begin_zero(&mut hyp.x, &mut hyp.p, row, scene.channel.zero, gain, (e, own));
    }
    if model.looks_for_steps() {
        meet_innovation(&mut hyp.tests, row, model.axes(), gain, e, total);
    }
    let mark = &mut hyp.marks[c];
    mark.outliers = 0.0;
    mark.share -= mark.share / OUTLIER_MEMORY;
    mark.accepted_s = scene.at_s;
    mark.accepted_variance = own / (row.units_per_m * row.units_per_m) + mark.reference;
    total
}

/// Lets a step of the sensor's zero be asked for from this measurement on, where the last such instant is far enough
/// away; share: what the update takes over of the innovation.
#[inline]
fn ask_for_step(hyp: &mut Hypothesis, scene: &Scene, share: f64) {
    let (model, channel) = (scene.model, scene.channel);
    carry_all(&mut hyp.tests, scene.at_s, model.axes());
    let mark = &hyp.marks[scene.row.channel];
    let test = &mut hyp.tests[channel.group];
    if !mark.begun {
        test.clear();
        return;
    }
    test.taken_over += share;
    if test.taken_over >= APART_BY && test.newest_s() != Some(scene.at_s) {
        let lapse_s = (scene.at_s - mark.accepted_s.max(hyp.memory.began_s)).max(SHORTEST_S);
        begin_instant(hyp, channel, model, Instant { since_s: scene.at_s, lapse_s });
    }
}

/// Whether innovations tell by odds (logarithm) of `least` that the sensor's zero has stepped; then it is taken out of
/// the states, what it may be off by included, and the hypothesis remembers it.
#[inline]
pub fn find_step(hyp: &mut Hypothesis, scene: &Scene, least: f64) -> bool {
    let (model, channel) = (scene.model, scene.channel);
    let weighed = Weighed {
        channel,
        rates: &model.rates,
        parameters: &hyp.parameters,
        spread: &hyp.spread,
        misfit: model.misfit[channel.row.axis],
        // The size's logarithm is alike in all decades.
        even: -(2.0 * DECADES * std::f64::consts::LN_10).ln(),
    };
    let Some(place) = hyp.tests[channel.group].likeliest(&weighed, least) else { return false };
    take_found_step(hyp, scene, place);
    true
}

/// Takes a step that began at an instant out of a hypothesis, which remembers it.
fn take_found_step(hyp: &mut Hypothesis, scene: &Scene, place: usize) {
    let test = &hyp.tests[scene.channel.group];
    let since_s = test.instant(place).map_or(scene.at_s, |one| one.since_s);
    let mut step = test.take(place, &mut hyp.x, &mut hyp.p, &hyp.parameters);
    step.ago_s = scene.at_s - since_s;
    hyp.memory.step = step;
    hyp.memory.decision = Decision::STEP_BEFORE;
    hyp.memory.shift = Some(LastShift { at_s: since_s, sensor: scene.channel.sensor, size_m: step.size });
    for (mark, one) in hyp.marks.iter_mut().zip(&scene.model.channels) {
        mark.shifted = mark.shifted || one.group == scene.channel.group;
    }
    // The states have changed: all other sums were of those before.
    hyp.clear_tests();
}

/// What the noise's factor rests on after a sudden rise or fall, in measurements.
pub const ANEW: f64 = 12.0;
/// The noise has fallen where over [`ANEW`] measurements the mean square of the innovations is less than this share of
/// their variance: by chance once in 100 000 measurements.
const FALLEN: f64 = 0.25;
/// Iterations of the variance's fixed point: the third changes it by less than a thousandth.
const ITERATIONS: usize = 3;

/// Follows the noise after an accepted innovation, whose variance is `predicted` + `own`; memory: in measurements.
#[inline]
pub fn adapt(mark: &mut Mark, error: f64, predicted: f64, own: f64, memory: f64) {
    // Noise that is taken as declared does not fall.
    if mark.recent < FALLEN && memory < f64::INFINITY {
        mark.rests_on = mark.rests_on.min(ANEW);
    }
    let rests = mark.rests_on.min(memory - 1.0);
    // In units of the measurement's own variance.
    let (predicted_share, square, inverse) = (predicted / own, error * error / own, 1.0 / (rests + 1.0));
    let mut ratio = 1.0;
    for _ in 0..ITERATIONS {
        let share = ratio / (predicted_share + ratio);
        let remaining = share * (square * share + predicted_share);
        ratio = (rests + remaining) * inverse;
    }
    mark.factor *= ratio;
    mark.rests_on = rests + 1.0;
    if predicted < own {
        // Else the innovation tells more of the prediction than of the noise.
        mark.recent += (error * error / (predicted + own) - mark.recent) / ANEW;
    }
}

/// Takes the innovation `e` (1 + k) at the parameters as estimated (k,): a scale error times displacement is no sum.
///
/// moved (1 + k): the displacement's row of the states. The term left out at 0 is (scale error)² of the displacement,
/// 0.4 % of it where the scale is 6 % off.
#[inline]
pub fn linearise(moved: &[f64], parameters: &[f64], row: &Row, e: &mut [f64]) {
    for (q, effect) in row.effects.iter().enumerate() {
        let (Some(sign), true) = (effect.sign(), parameters[q] != 0.0) else { continue };
        let (mut more, g) = (0.0, sign * row.units_per_m);
        for (r, &value) in parameters.iter().enumerate() {
            more += value * moved[1 + r];
            e[1 + r] += g * parameters[q] * moved[1 + r];
        }
        e[1 + q] += g * more;
        e[0] -= g * parameters[q] * more;
    }
}

/// Takes the sensitivities `e` (1 + k) to a gain and to estimated scale errors at the displacement after the update.
///
/// moved: by which the update moves the expected measurement. While place and velocity at the start are not known that
/// is most of the motion: the sensitivity at the prediction would leave the scale error's share of it in the state.
#[inline]
pub fn move_to_updated(e: &mut [f64], row: &Row, parameters: &[ParameterModel], at_s: f64, moved: f64) {
    for (q, (effect, parameter)) in row.effects.iter().zip(parameters).enumerate() {
        match effect {
            Effect::Gain => e[1 + q] -= moved,
            Effect::Scale if at_s >= parameter.from_s => e[1 + q] += moved,
            Effect::Scale | Effect::Clock | Effect::Nothing => {}
        }
    }
}

/// An innovation by which parameters are estimated.
pub struct Observed<'a> {
    /// Its sensitivities, after itself (1 + k).
    pub e: &'a [f64],
    /// Itself with the parameters as estimated.
    pub error: f64,
    /// Variance of the prediction without the parameters.
    pub predicted: f64,
    /// Variance of the innovation with all that is uncertain.
    pub total: f64,
    /// When, s.
    pub at_s: f64,
    /// When the parameters were met last, s.
    pub last_s: f64,
}

/// Estimates those parameters that are to be from an innovation, and lets them walk since the last one.
///
/// The gain of those that are not estimated is 0, and the covariance stays that of the errors (S. F. Schmidt's consider
/// parameters). scratch (2 k): to work with.
pub fn learn(
    values: &mut [f64],
    spread: &mut Matrix,
    table: &[ParameterModel],
    observed: &Observed,
    scratch: &mut Vec<f64>,
) {
    let k = values.len();
    scratch.clear();
    scratch.resize(2 * k, 0.0);
    let (gain, mu) = scratch.split_at_mut(k);
    for (q, parameter) in table.iter().enumerate() {
        spread[(q, q)] += parameter.walk * (observed.at_s - observed.last_s).max(0.0);
        let sensitivity = observed.e[1 + q];
        mu[q] = spread.row(q).iter().zip(&observed.e[1..]).map(|(a, b)| a * b).sum();
        if observed.at_s >= parameter.from_s && sensitivity * sensitivity >= parameter.clear * observed.predicted {
            gain[q] = mu[q] / observed.total;
        }
    }
    for q in 0..k {
        values[q] -= gain[q] * observed.error;
        for r in 0..k {
            spread[(q, r)] += gain[q] * gain[r] * observed.total - gain[q] * mu[r] - mu[q] * gain[r];
        }
    }
}
