//! A measurement in one hypothesis before it is decided what it is, and the densities that its causes are weighed by.

use super::cause::Pace;
use super::hypothesis::{Hypothesis, Mark, Memory};
use super::innovation::{Innovation, Scene};

/// Innovations beyond this number of standard deviations are asked what happened: one in 16 000 is by chance.
pub const GATE: f64 = 4.0;
/// A measurement this many times (in variance) as far off as predicted is an outlier until the next one says otherwise:
/// 100 deviations. The least weight of anything else would move the rows by that share of whatever size it has.
pub const WILD: f64 = 1e4;
/// The share of outliers is that of this number of measurements.
pub const OUTLIER_MEMORY: f64 = 20.0;
/// It is never more than this: a sensor that is mostly wrong cannot be distinguished from one that has shifted.
const MAX_OUTLIERS: f64 = 0.3;
/// Errors of unknown size lie within this number of decades above the noise.
pub const DECADES: f64 = 4.0;
/// Shortest time (s) that a rate is taken over.
pub const SHORTEST_S: f64 = 1e-3;
pub(super) const LOG_2PI: f64 = 1.837_877_066_409_345_3;

/// A measurement in one hypothesis, before it is decided what it is.
pub struct Situation<'a> {
    pub(super) scene: &'a Scene<'a>,
    pub(super) mark: &'a Mark,
    pub(super) memory: &'a Memory,
    pub(super) innovation: Innovation,
    /// Mean of the shift's state, its variance, and its entry of P h.
    pub(super) shift: (f64, f64, f64),
    /// Whether it is one of the first and may be an outlier even inside the gate.
    pub(super) first: bool,
    /// Variance of the sharpest prediction that any hypothesis has of it.
    pub(super) sharpest: f64,
    pub(super) inside: bool,
    /// Whether the outliers before it, or of the same frame, make another one likely.
    pub(super) runs: bool,
    /// Time in which it may have happened, s: among outliers any since the last measurement that was none.
    pub(super) lapse: f64,
}

impl<'a> Situation<'a> {
    /// Of a hypothesis that has just looked at the measurement.
    pub fn new(
        hyp: &'a Hypothesis,
        scene: &'a Scene,
        innovation: Innovation,
        ph: &[f64],
        (first, sharpest): (bool, f64),
    ) -> Self {
        let (mark, memory, s) = (&hyp.marks[scene.row.channel], &hyp.memory, scene.channel.shift);
        let same_frame = memory.outlier == Some((scene.at_s, scene.channel.sensor));
        Self {
            scene,
            mark,
            memory,
            shift: (hyp.x[(s, 0)], hyp.p[(s, s)], ph[s]),
            first,
            sharpest,
            inside: innovation.within(GATE),
            runs: mark.outliers > 0.0 || same_frame,
            lapse: (scene.at_s - mark.accepted_s.max(memory.began_s)).max(SHORTEST_S),
            innovation,
        }
    }

    pub(super) fn p_outlier(&self) -> f64 {
        let rates = &self.scene.model.rates;
        if self.runs { rates.stays } else { rates.outlier.max(self.mark.share.min(MAX_OUTLIERS)) }
    }

    /// Whether it is asked what else than an outlier it may be: of the first measurements it is not, as what is met
    /// once an hour is not met just then.
    pub(super) fn asked(&self) -> bool {
        let wild =
            self.mark.outliers == 0.0 && self.innovation.error * self.innovation.error > WILD * self.innovation.total();
        !self.inside && !self.first && !wild
    }

    /// Of shifts the share that reverts, or stays; one that is added to a shift is as that is.
    pub(super) fn share_of_shifts(&self, revert: Option<Pace>) -> f64 {
        let reverts = match self.scene.channel.reverting {
            Some(_) if self.mark.reverting_m2 == 0.0 => self.scene.model.rates.revert,
            _ => 0.0,
        };
        match revert {
            None => 1.0 - reverts,
            // Either pace is as likely.
            Some(Pace::Slow | Pace::Fast) => 0.5 * reverts,
        }
    }

    pub(super) fn normal(&self) -> f64 {
        log_normal(self.innovation.error, self.innovation.total())
    }

    pub(super) fn any_size(&self) -> f64 {
        log_any_size(self.innovation.error, self.innovation.total())
    }

    /// The density of a wrong measurement; a value near the first outlier's says nothing against the sensor where no
    /// hypothesis can tell the motion.
    pub(super) fn wrong_or_kept(&self) -> f64 {
        let wrong = log_wrong(self.innovation.error, self.innovation.total(), self.innovation.noise);
        if self.mark.outliers > 0.0 {
            let again =
                log_normal(self.scene.row.value - self.mark.kept, (2.0 * self.innovation.noise).max(self.sharpest));
            return wrong.max(again);
        }
        wrong
    }
}

/// Logarithm of the normal density of an innovation.
pub fn log_normal(e: f64, total: f64) -> f64 {
    -0.5 * (LOG_2PI + total.ln() + e * e / total)
}

/// Logarithm of the density of an error of unknown size: alike in all decades from the predicted deviation on.
pub fn log_any_size(e: f64, total: f64) -> f64 {
    -(2.0 * DECADES * std::f64::consts::LN_10).ln() - 0.5 * (e * e).max(total).ln()
}

/// Logarithm of the density of a measurement that is wrong: its error is alike in all decades from its own deviation
/// on, and those decades that the prediction cannot tell leave what is predicted.
pub fn log_wrong(e: f64, total: f64, own: f64) -> f64 {
    let hidden = (0.5 * (total / own).log10() / DECADES).min(1.0);
    (hidden * log_normal(e, total).exp() + log_any_size(e, total).exp()).ln()
}

/// Probability that what is met so often a second (Poisson) is met in a lapse, s.
pub fn met_within(rate: f64, lapse: f64) -> f64 {
    -(-rate * lapse).exp_m1()
}

/// Density, (m/s²)²/Hz, of an error of the acceleration that leads a prediction `size` (m) away in `lapse` (s).
pub fn led_away(size: f64, lapse: f64) -> f64 {
    3.0 * size * size / (lapse * lapse * lapse)
}
