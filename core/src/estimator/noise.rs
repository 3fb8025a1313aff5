//! The variance of each channel's noise, followed by the variational Bayes filter.
//!
//! S. Särkkä, A. Nummenmaa, Recursive noise adaptive Kalman filtering by variational Bayesian approximations, IEEE Trans.
//! Automat. Contr. 54 (2009) 596-600, doi 10.1109/TAC.2008.2008348: a mean, over the measurements that are remembered, of
//! what is left of each innovation after its update and of what the updated state's variance adds to it.

use super::hypothesis::Mark;

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
