//! The causes of what a measurement is: how often each is met, how likely it makes an innovation, and what it does to
//! the filter, side by side.
//!
//! The priors are rates: how often each is met in the field. The likelihood of what is measured later, by any channel,
//! decides between them ([`super::hypotheses`]).

use super::acceptance::{ANEW, accept, find_step};
use super::hypothesis::{Burst, Contradiction, Hypothesis, LastShift};
use super::innovation::{Innovation, Scene, Work, look};
use super::matrix::Matrix;
use super::model::Model;
use super::predict::add_noise;
use super::situation::{GATE, OUTLIER_MEMORY, SHORTEST_S, Situation, led_away, log_normal, met_within};
use super::update::scale_state;
use serde::{Deserialize, Serialize};

/// A prediction whose variance is this many times the measurement's own cannot tell an outlier from a measurement
/// inside the gate: later ones decide. At 25 an outlier at the gate moves the state by five times what a sound one
/// leaves.
pub const VAGUE: f64 = 25.0;
/// So often a sensor that is back is noisier than before it was away. A guess, which counts as much as one measurement at
/// three deviations (ln 100).
const P_NOISIER: f64 = 0.01;
/// What goes on as an error of the acceleration is so often one of the bias, which a state led away holds too.
const BIAS_TOO: f64 = 0.05;
/// How fast a shift comes back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Pace {
    /// In the channel's time.
    Slow,
    /// In a fifth of it: a process of one time follows neither one that is three times as fast nor as slow.
    Fast,
}

impl Pace {
    /// How many times as fast as the channel's.
    fn factor(self) -> f64 {
        match self {
            Self::Slow => 1.0,
            Self::Fast => 5.0,
        }
    }
}

/// What is known of a shift's size beforehand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Prior {
    /// Nothing: the innovation tells it.
    AnySize,
    /// Nothing either, and what is left of it comes back in time.
    Reverting(Pace),
    /// Nothing, nor does the innovation tell it, but those after it.
    ReportedLater,
    /// The zero is where it was before its last shift.
    FormerZero,
}

/// What may have happened to a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Cause {
    /// It is good: where it lies far off, one of the few that do so by chance.
    Good,
    /// It is wrong, by any amount; the next ones may be so too, and may keep its value.
    Outlier,
    /// The channel's zero has moved, and stays.
    Shift(Prior),
    /// The prediction is wrong: the acceleration errs by more than its noise, and may go on to do so.
    Wrong,
    /// The motion's state is wrong, its bias too: an earlier measurement led it away.
    Lost,
    /// The channel's noise has risen.
    Noise,
    /// It is good, and by the innovations up to it the sensor's zero has stepped at an earlier one.
    StepBefore,
}

/// What a measurement was taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Decision {
    /// The cause.
    pub cause: Cause,
    /// An error of the acceleration that went on has just ended.
    pub burst_ended: bool,
    /// The prediction was wrong, and the samples' noise holds it since the last good measurement (second pass).
    pub explained: bool,
}

impl Decision {
    /// A good measurement.
    pub const GOOD: Self = Self::of(Cause::Good);
    /// A good measurement that tells an earlier step.
    pub const STEP_BEFORE: Self = Self::of(Cause::StepBefore);

    /// One cause and nothing else.
    pub const fn of(cause: Cause) -> Self {
        Self { cause, burst_ended: false, explained: false }
    }

    /// Whether it is left out.
    pub fn is_outlier(self) -> bool {
        self.cause == Cause::Outlier
    }
}

impl Cause {
    /// What a measurement is asked for, in this order.
    pub const CANDIDATES: [Self; 9] = [
        Self::Good,
        Self::Outlier,
        Self::Shift(Prior::AnySize),
        Self::Shift(Prior::Reverting(Pace::Slow)),
        Self::Shift(Prior::Reverting(Pace::Fast)),
        Self::Shift(Prior::FormerZero),
        Self::Wrong,
        Self::Lost,
        Self::Noise,
    ];

    /// Logarithm of how often it is met times how likely it makes the innovation; -inf: it is not considered.
    pub fn log_weight(self, at: &Situation) -> f64 {
        let (innovation, rates) = (&at.innovation, &at.scene.model.rates);
        match self {
            Self::Good => (1.0 - at.p_outlier()).ln() + at.normal(),
            Self::Outlier if at.mark.outliers > 0.0 => 0.5f64.ln() + at.wrong_or_kept() + at.p_outlier().ln(),
            Self::Outlier
                if at.runs || at.first || !at.inside || innovation.with_parameters > VAGUE * innovation.noise =>
            {
                at.wrong_or_kept() + at.p_outlier().ln()
            }
            Self::Shift(Prior::FormerZero) if at.mark.shifted && !at.inside => weight_of_return(at),
            Self::Shift(Prior::AnySize) if at.asked() => weight_of_shift(at) + at.share_of_shifts(None).ln(),
            Self::Shift(Prior::Reverting(pace)) if at.asked() => {
                weight_of_shift(at) + at.share_of_shifts(Some(pace)).ln()
            }
            Self::Wrong | Self::Lost if !at.scene.channel.places => f64::NEG_INFINITY,
            Self::Wrong if at.asked() => met_within(rates.wrong, at.lapse).ln() + at.any_size(),
            Self::Lost => weight_of_lost(at),
            Self::Noise if at.asked() => noise_within(at).ln() + at.any_size(),
            _ => f64::NEG_INFINITY,
        }
    }
}

/// A shift is asked for its return outside the gate only.
fn weight_of_return(at: &Situation) -> f64 {
    let (g, (mean, variance, ph)) = (at.scene.channel.row.units_per_m, at.shift);
    // Without the shift's state: its mean comes back to the innovation, its variance goes.
    let rest = at.innovation.with_parameters - 2.0 * g * ph + g * g * variance;
    let returned = log_normal(at.innovation.error + g * mean, rest.max(0.0) + at.innovation.noise);
    let rates = &at.scene.model.rates;
    let lapse = (at.scene.at_s - at.mark.met_s).max(SHORTEST_S);
    met_within(rates.back, lapse).ln() + returned
}

fn weight_of_shift(at: &Situation) -> f64 {
    let (rates, g) = (&at.scene.model.rates, at.scene.channel.row.units_per_m);
    let same_frame = |one: &LastShift| one.at_s == at.scene.at_s && one.sensor == at.scene.channel.sensor;
    match at.memory.shift.filter(same_frame) {
        // The sensor moved: all its targets shift, mostly by the same.
        Some(shift) => {
            let alike = log_normal(at.innovation.error - g * shift.size_m, 2.0 * at.innovation.noise);
            (0.5 * rates.stays).ln() + at.any_size().max(alike)
        }
        None => {
            // A solution that has not converged jumps on its way as often as it comes back.
            let rate = if at.mark.reverting_m2 > 0.0 { rates.back } else { rates.shift };
            let shifted = met_within(rate, at.lapse).ln();
            if at.mark.outliers > 0.0 {
                // It had shifted before the first of them, as a state that is wrong was.
                shifted.min(rates.outlier.ln()) + at.wrong_or_kept()
            } else {
                shifted + at.any_size()
            }
        }
    }
}

fn weight_of_lost(at: &Situation) -> f64 {
    let rates = &at.scene.model.rates;
    let goes_on = if at.memory.burst.is_some() { BIAS_TOO.ln() + at.normal() } else { f64::NEG_INFINITY };
    if !at.asked() {
        return goes_on;
    }
    let led = met_within(rates.lost, at.lapse).ln();
    let anew = if at.mark.outliers > 0.0 {
        // The state was wrong before the first of them, so the others speak against it no more than against the sensor.
        led.min(rates.outlier.ln()) + at.wrong_or_kept()
    } else {
        led + at.any_size()
    };
    goes_on.max(anew)
}

/// How likely a sensor's noise rose within a lapse.
fn noise_within(at: &Situation) -> f64 {
    let rates = &at.scene.model.rates;
    let noisier = met_within(rates.noise, at.lapse);
    let is_back = at.scene.at_s - at.mark.met_s > at.scene.channel.coasting_s;
    let is_sharp = at.innovation.with_parameters <= VAGUE * at.innovation.noise;
    if rates.noise > 0.0 && is_back && is_sharp { noisier.max(P_NOISIER) } else { noisier }
}

/// What became of a measurement, for the way back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taken {
    /// The innovation's variance that it was taken with, infinite where it began a zero; None: not at all.
    pub total: Option<f64>,
    /// Whether the shift is gone.
    pub restored: bool,
}

/// Turns a hypothesis into what a measurement makes of it.
pub fn apply(decision: Decision, hyp: &mut Hypothesis, scene: &Scene, work: &mut Work) -> Taken {
    let c = scene.row.channel;
    let lapse = (scene.at_s - hyp.marks[c].met_s).max(SHORTEST_S);
    hyp.memory.decision = decision;
    hyp.memory.age = if decision == Decision::GOOD { hyp.memory.age + 1.0 } else { 0.0 };
    hyp.marks[c].met_s = scene.at_s;
    let mut innovation = look(hyp, scene, work);
    // Whether the samples' noise since then explains it: then it was the prediction that was wrong.
    let explained = decision.explained && innovation.within(GATE);
    let evidence = Contradiction { size: innovation.error, variance: innovation.total(), ago_s: 0.0 };
    match decision.cause {
        Cause::Outlier if !explained => {
            reject(hyp, scene);
            hyp.memory.met = evidence;
            if decision.burst_ended {
                hyp.memory.burst = None;
            }
            return Taken { total: None, restored: false };
        }
        Cause::Good | Cause::Outlier | Cause::StepBefore => {}
        cause => {
            change(cause, hyp, scene, &Change { innovation, lapse, explained }, work);
            innovation = look(hyp, scene, work);
        }
    }
    let total = accept(hyp, scene, &innovation, work);
    hyp.memory.met = evidence;
    if decision.cause == Cause::StepBefore {
        find_step(hyp, scene, f64::NEG_INFINITY);
    } else if decision.burst_ended {
        hyp.memory.burst = None;
    }
    Taken { total: Some(total), restored: decision.cause == Cause::Shift(Prior::FormerZero) }
}

/// Leaves out a measurement as an outlier.
fn reject(hyp: &mut Hypothesis, scene: &Scene) {
    let mark = &mut hyp.marks[scene.row.channel];
    if mark.outliers == 0.0 {
        // From value to value a fast sensor always keeps its own; stuck is one that keeps the first.
        mark.kept = scene.row.value;
    }
    mark.outliers += 1.0;
    mark.share += (1.0 - mark.share) / OUTLIER_MEMORY;
    hyp.memory.outlier = Some((scene.at_s, scene.channel.sensor));
}

/// What a change of the filter starts from.
struct Change {
    innovation: Innovation,
    lapse: f64,
    /// The samples' noise holds the error already.
    explained: bool,
}

/// What a cause changes of the filter before the measurement is accepted.
fn change(cause: Cause, hyp: &mut Hypothesis, scene: &Scene, at: &Change, work: &mut Work) {
    let (channel, c, group) = (scene.channel, scene.row.channel, scene.channel.group);
    let (row, s) = (&channel.row, channel.shift);
    let (error, total, size) = (at.innovation.error, at.innovation.total(), at.innovation.error / row.units_per_m);
    match cause {
        Cause::Good | Cause::Outlier | Cause::StepBefore => {}
        Cause::Shift(Prior::FormerZero) => {
            hyp.tests[group].clear();
            restore_zero(hyp, scene, work);
        }
        Cause::Shift(prior) => {
            hyp.tests[group].clear();
            // Where only later measurements tell the size, nothing is known of it here: the prior takes a fiftieth of
            // its deviation.
            let unknown = if prior == Prior::ReportedLater { VAGUE * total } else { error * error };
            let unknown_m2 = unknown / (row.units_per_m * row.units_per_m);
            hyp.p[(s, s)] += unknown_m2;
            let mark = &mut hyp.marks[c];
            mark.shifted = true;
            if mark.reverting_m2 > 0.0 {
                grow_reverting(hyp, scene, unknown_m2);
            } else if let Prior::Reverting(pace) = prior {
                mark.reverting_pace = pace.factor();
                grow_reverting(hyp, scene, unknown_m2);
            }
            hyp.memory.shift = Some(LastShift { at_s: scene.at_s, sensor: channel.sensor, size_m: size });
        }
        Cause::Wrong => {
            let density = led_away(size, at.lapse);
            hyp.memory.burst = Some(Burst { density, axis: row.axis });
            if !at.explained {
                add_noise(&mut hyp.p, row.axis, at.lapse, density);
            }
        }
        Cause::Lost => {
            let mark = &hyp.marks[c];
            let lapse = (scene.at_s - mark.accepted_s.max(hyp.memory.began_s)).max(SHORTEST_S);
            let size = size.abs().max(total.sqrt() / row.units_per_m.abs());
            inflate_motion(&mut hyp.p, row.motion(), (size, lapse), at.explained);
            hyp.memory.burst = None;
        }
        Cause::Noise => {
            let mark = &mut hyp.marks[c];
            mark.recent = 1.0;
            mark.factor *= error * error / total;
            mark.rests_on = mark.rests_on.min(ANEW);
        }
    }
}

/// Lets a channel's zero be where it was before its shift; as well as one measurement tells, where that
/// comes later than returns do on the mean: what does not go back soon has moved for good, and a second shift has
/// nearly undone the first.
fn restore_zero(hyp: &mut Hypothesis, scene: &Scene, work: &mut Work) {
    let (channel, c) = (scene.channel, scene.row.channel);
    scale_state(&mut hyp.x, &mut hyp.p, channel.shift, 0.0);
    let reverted = stop_reverting(hyp, scene);
    let innovation = look(hyp, scene, work);
    let recent = hyp
        .memory
        .shift
        .is_some_and(|one| one.sensor == channel.sensor && (scene.at_s - one.at_s) * scene.model.rates.back <= 1.0);
    if !recent && !reverted {
        let g = channel.row.units_per_m;
        hyp.p[(channel.shift, channel.shift)] += innovation.total() / (g * g);
    }
    hyp.marks[c].shifted = false;
}

/// Lets the shift that has just begun, or has grown by this variance (m²), revert from here on.
fn grow_reverting(hyp: &mut Hypothesis, scene: &Scene, size_m2: f64) {
    let Some(velocity) = scene.channel.reverting.and_then(|one| one.velocity) else { return };
    let mark = &mut hyp.marks[scene.row.channel];
    (mark.reverting_s, mark.reverting_m2) = (scene.at_s, mark.reverting_m2 + size_m2);
    hyp.p[(velocity, velocity)] += size_m2;
}

/// The shift is gone; returns whether it reverted.
fn stop_reverting(hyp: &mut Hypothesis, scene: &Scene) -> bool {
    let mark = &mut hyp.marks[scene.row.channel];
    let reverted = std::mem::take(&mut mark.reverting_m2) > 0.0;
    mark.reverting_pace = 1.0;
    if let Some(velocity) = scene.channel.reverting.and_then(|one| one.velocity) {
        scale_state(&mut hyp.x, &mut hyp.p, velocity, 0.0);
    }
    reverted
}

/// Lets an axis' motion from state `i` on be off by a size (m) that it was led away in a time (s).
///
/// explained: displacement and velocity have their noise already.
fn inflate_motion(p: &mut Matrix, i: usize, (size, lapse): (f64, f64), explained: bool) {
    let bias = size / (lapse * lapse);
    p[(i + 2, i + 2)] += bias * bias;
    if !explained {
        p[(i, i)] += size * size;
        p[(i + 1, i + 1)] += (size / lapse) * (size / lapse);
    }
}

/// Logarithm of the share of what goes on that ends just now, over that of what stays.
pub fn log_ends(model: &Model) -> f64 {
    (1.0 - model.rates.stays).ln() - model.rates.stays.ln()
}

#[cfg(test)]
mod tests {
    use super::super::innovation::look;
    use super::super::motion::AxisMotion;
    use super::super::situation::log_any_size;
    use super::super::tests::{beginning, channel, rates, settings};
    use super::super::waiting::Measurement;
    use super::*;

    /// From a frame to a month.
    const LAPSES_S: [f64; 5] = [0.04, 10.0, 3600.0, 86400.0, 2.6e6];

    #[test]
    fn no_prior_is_more_than_certain() {
        let mut set = settings(vec![channel()], rates());
        set.motion = vec![(2e-3, 10.0)];
        let (model, motion) = (Model::new(&set, 0), [AxisMotion::default()]);
        for (lapse, shifted) in LAPSES_S.into_iter().flat_map(|lapse| [(lapse, false), (lapse, true)]) {
            let mut hyp = Hypothesis::begun(&beginning(1e-4, 1e-3), &set, &model);
            let mark = &mut hyp.marks[0];
            (mark.accepted_s, mark.met_s, mark.shifted, mark.begun) = (0.0, 0.0, shifted, true);
            // 10 mm off, of a prediction that is good to 0.1 mm.
            let row = Measurement { channel: 0, value: 1e-2, variance: 1e-8, reference: 0.0 };
            let (channel, mut work) = (&model.channels[0], Work::new(&model));
            let scene = Scene {
                model: &model,
                row: &row,
                channel,
                at_s: lapse,
                motion: &motion,
                acceleration: 0.0,
                density: 0.0,
            };
            let innovation = look(&hyp, &scene, &mut work);
            let at = Situation::new(&hyp, &scene, innovation, &work.gain, (false, 2e-8));
            let any_size = log_any_size(innovation.error, innovation.total());
            for cause in [Cause::Shift(Prior::AnySize), Cause::Wrong, Cause::Noise, Cause::Lost] {
                let prior = (cause.log_weight(&at) - any_size).exp();
                // Once an hour, as a Poisson process; noise is so after a gap at least.
                let least = if cause == Cause::Noise && lapse > channel.coasting_s { P_NOISIER } else { 0.0 };
                let expected = (1.0 - (-lapse / 3600.0).exp()).max(least);
                assert!((prior / expected - 1.0).abs() < 1e-9, "{cause:?} {lapse}");
            }
            if shifted {
                // Nothing is known of a shift's size here: without it the innovation is the same.
                let returned = Cause::Shift(Prior::FormerZero).log_weight(&at);
                assert!((returned - log_normal(innovation.error, innovation.total())).exp() <= 1.0 + 1e-12);
            }
        }
    }
}
