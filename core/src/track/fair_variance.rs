//! A fair variance for frames that match the reference without noise.
//!
//! The reference frame, and any frame equal to it, matches itself perfectly and would seem to be known exactly; but its
//! noise is that of the template, and the zero of the displacement is no better known than that. A template's noise
//! also enters through the edge of its window, which moves over the frame: measured 1.2 to 1.4 times a frame's own.

use super::running_median::RunningMedian;
use serde::{Deserialize, Serialize};

/// Frames that the usual variance is a median of.
pub const USUAL_FRAMES: usize = 64;
/// A variance below this share of the usual one is the mark of a frame that matches itself, not of a quiet one.
const SUSPICIOUS_SHARE: f64 = 0.25;
/// Noise of the template over the noise of a frame, as standard deviations.
pub const TEMPLATE_NOISE: f64 = 1.15;

/// The last variances along x and y, px².
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct FairVariance([RunningMedian<USUAL_FRAMES>; 2]);

impl FairVariance {
    /// The variances along x and y of a frame, in which the target was seen, made fair.
    pub fn push(&mut self, variance: [f64; 2]) -> [f64; 2] {
        if !(variance[0] + variance[1]).is_finite() {
            return variance;
        }
        std::array::from_fn(|k| {
            self.0[k].push(variance[k]);
            let usual = self.0[k].value();
            if variance[k] < SUSPICIOUS_SHARE * usual { TEMPLATE_NOISE * TEMPLATE_NOISE * usual } else { variance[k] }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_without_noise_gets_the_usual_variance_and_a_lost_one_none() {
        let mut fair = FairVariance::default();
        for _ in 0..10 {
            assert_eq!(fair.push([4e-6, 9e-6]), [4e-6, 9e-6]);
        }
        assert_eq!(fair.push([1e-9, 3e-6]), [TEMPLATE_NOISE * TEMPLATE_NOISE * 4e-6, 3e-6]);
        assert!(fair.push([f64::NAN, 1.0])[0].is_nan());
    }
}
