//! The update of one hypothesis by a measurement that it accepts: states, noise, parameters, and steps of the zero.

use super::cause::Decision;
use super::hypothesis::{Hypothesis, LastShift};
use super::innovation::{Innovation, Scene, Work};
use super::noise::adapt;
use super::parameters::{Told, learn, move_to_updated};
use super::situation::{DECADES, OUTLIER_MEMORY, SHORTEST_S};
use super::steps::{APART_BY, Instant, Weighed, begin_instant, carry_all, meet_innovation};
use super::update::{begin_zero, update};

/// Updates one hypothesis with a measurement; seen: of `look`, with P h and sensitivities in `work`.
///
/// Returns the innovation's variance that it was taken with, infinite where it began the channel's zero.
#[inline]
pub fn accept(hyp: &mut Hypothesis, scene: &Scene, seen: &Innovation, work: &mut Work) -> f64 {
    let (model, row, c) = (scene.model, &scene.channel.row, scene.row.channel);
    if model.looks_for_steps() {
        ask_for_step(hyp, scene, seen.known / (seen.known + seen.own));
    }
    hyp.memory.met.size = seen.error;
    hyp.memory.met.variance = seen.total();
    let (gain, e) = (&mut work.gain, &mut work.e);
    let (mut total, mut own) = (f64::INFINITY, seen.own);
    if hyp.marks[c].begun {
        adapt(&mut hyp.marks[c], seen.error, seen.wider, seen.own, model.noise_memory);
        own = scene.row.variance * hyp.marks[c].factor;
        total = seen.known + own;
        if !hyp.parameters.is_empty() {
            let told = Told {
                e,
                error: seen.error,
                predicted: seen.known,
                total: seen.wider + own,
                at_s: scene.at_s,
                last_s: hyp.memory.last_s,
            };
            learn(&mut hyp.parameters, &mut hyp.spread, &model.parameters, &told, &mut work.parameters);
            hyp.memory.last_s = scene.at_s;
            move_to_updated(e, row, &model.parameters, scene.at_s, seen.error * seen.known / total);
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
    if mark.stepped || !mark.begun {
        // What it measures is of another instant, or begins its zero.
        test.clear();
        return;
    }
    test.taken_over += share;
    if test.taken_over >= APART_BY && test.newest_s() != Some(scene.at_s) {
        let lapse_s = (scene.at_s - mark.accepted_s.max(hyp.memory.began_s)).max(SHORTEST_S);
        begin_instant(hyp, channel, model, Instant { since_s: scene.at_s, lapse_s });
    }
}

/// Whether innovations tell by odds (logarithm) of `least` that the sensor's zero has stepped; then it is taken out of the
/// states, what it may be off by included, and the hypothesis remembers it.
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
