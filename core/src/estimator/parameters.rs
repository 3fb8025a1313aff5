//! The parameters: constants that are carried as sensitivities, and those of them that are estimated.

use super::matrix::Matrix;
use super::model::ParameterModel;
use super::row::{Effect, Row};

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
/// moved: by which the update moves the expected measurement. While place and velocity at the start are not known that is
/// most of the motion: the sensitivity at the prediction would leave the scale error's share of it in the state.
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
pub struct Told<'a> {
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
pub fn learn(values: &mut [f64], spread: &mut Matrix, table: &[ParameterModel], told: &Told, scratch: &mut Vec<f64>) {
    let k = values.len();
    scratch.clear();
    scratch.resize(2 * k, 0.0);
    let (gain, mu) = scratch.split_at_mut(k);
    for (q, parameter) in table.iter().enumerate() {
        spread[(q, q)] += parameter.walk * (told.at_s - told.last_s).max(0.0);
        let sensitivity = told.e[1 + q];
        mu[q] = spread.row(q).iter().zip(&told.e[1..]).map(|(a, b)| a * b).sum();
        if told.at_s >= parameter.from_s && sensitivity * sensitivity >= parameter.clear * told.predicted {
            gain[q] = mu[q] / told.total;
        }
    }
    for q in 0..k {
        values[q] -= gain[q] * told.error;
        for r in 0..k {
            spread[(q, r)] += gain[q] * gain[r] * told.total - gain[q] * mu[r] - mu[q] * gain[r];
        }
    }
}
