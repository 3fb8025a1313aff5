//! Unwrapping of a radar's phase with the accelerometer's help.
//!
//! Ma et al., "Structural displacement estimation using accelerometer and FMCW millimeter wave radar", equations 12–15:
//! each phase takes the cycle nearest to the one that its two predecessors and the acceleration predict.

use std::f64::consts::TAU;

/// The phase (n,) in rad without wraps; NaN marks a missing frame, which takes the predicted phase.
///
/// `acceleration_step_m` (n,): acceleration in the line of sight times the square of the frame period, m; `rad_per_m`:
/// phase per metre of range. The first two frames must not wrap.
pub fn unwrap_aided(phase_rad: &[f64], acceleration_step_m: &[f64], rad_per_m: f64) -> Vec<f64> {
    let mut unwrapped: Vec<f64> = Vec::with_capacity(phase_rad.len());
    for (k, &phase) in phase_rad.iter().enumerate() {
        let predicted = match k {
            0 => phase,
            1 => unwrapped[0],
            _ => 2.0 * unwrapped[k - 1] - unwrapped[k - 2] + rad_per_m * acceleration_step_m[k - 1],
        };
        unwrapped.push(if k >= 2 && !phase.is_finite() { predicted } else { nearest_cycle(phase, predicted) });
    }
    unwrapped
}

/// The phase plus the whole number of cycles that brings it nearest to the predicted one, rad.
fn nearest_cycle(phase: f64, predicted: f64) -> f64 {
    phase + TAU * ((predicted - phase) / TAU).round_ties_even()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn wrapped(phase: f64) -> f64 {
        (phase + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0
    }

    proptest! {
        /// A range that accelerates evenly is unwrapped at any speed, whatever its phase: the prediction is exact.
        #[test]
        fn a_range_that_accelerates_evenly_is_unwrapped(start in -3.0..3.0f64, speed in -2.0..2.0f64, bend in -0.4..0.4f64) {
            let count = 200;
            let truth: Vec<f64> = (0..count).map(|k| start + speed * k as f64 + 0.5 * bend * (k * k) as f64).collect();
            prop_assume!(wrapped(truth[0]) == truth[0] || (wrapped(truth[0]) - truth[0]).abs() < 1e-9);
            prop_assume!((truth[1] - truth[0]).abs() < TAU / 2.0 - 1e-6);
            let phase: Vec<f64> = truth.iter().map(|&one| wrapped(one)).collect();
            let found = unwrap_aided(&phase, &vec![bend / 50.0; count], 50.0);
            for (one, other) in found.iter().zip(&truth) {
                // The size of the phase is up to 1e4 rad, each wrap rounds it.
                prop_assert!((one - other).abs() < 1e-8, "{one} {other}");
            }
        }
    }

    #[test]
    fn a_missing_frame_takes_the_predicted_phase() {
        let found = unwrap_aided(&[0.0, 0.5, f64::NAN, 1.5], &[0.0; 4], 1.0);
        assert_eq!(found, [0.0, 0.5, 1.0, 1.5]);
    }
}
