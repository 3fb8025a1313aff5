//! A target's translation from the mean phases of its active pixels along x and y.
//!
//! Z. Ma, J. Choi, P. Liu, H. Sohn, Automation in Construction 140 (2022) 104338, doi 10.1016/j.autcon.2022.104338,
//! equations 4 and 17: translation = ratio · mean phase. Here both axes are solved together by the slopes of the
//! phases; pixels whose phase contradicts the others (something stands before them) do not count in a frame, unless
//! they are the majority.

use super::phase_axis::{AxisModel, Phases, Weights, phases, take_errors};
use super::steerable::Responses;
use super::vector::dot_f64;

const ROUNDS: usize = 3;
const CHECKS: usize = 3;
/// Of the mean phases' slopes, (rad/px)².
const SMALLEST_DETERMINANT: f64 = 1e-3;

/// A translation beyond the region's whole-pixel place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fix {
    /// Along x and y, px.
    pub shift: [f64; 2],
    /// Of the translation along x and y, px².
    pub variance: [f64; 2],
    /// Agreement with the reference, 0 to 1.
    pub coherence: f64,
}

/// Translation from the mean phases of both axes; None where their slopes do not tell x from y, or without pixels.
pub fn measure(axes: [&AxisModel; 2], now: [&Responses; 2]) -> Option<Fix> {
    if axes.iter().any(|axis| axis.is_empty()) {
        return None;
    }
    let phases = [0, 1].map(|k| phases(axes[k], now[k]));
    let every = axes.map(|axis| &axis.weights);
    let mut solution = Solution::of(axes, &phases, every, [0.0; 2])?;
    let mut kept: [Option<Weights>; 2] = [None, None];
    for _ in 0..CHECKS {
        let agreeing = [0, 1].map(|k| axes[k].agreeing(&solution.errors[k], solution.noise[k]));
        if agreeing.iter().chain(&kept).all(Option::is_none) {
            break;
        }
        kept = agreeing;
        let used = [0, 1].map(|k| kept[k].as_ref().unwrap_or(every[k]));
        solution = Solution::of(axes, &phases, used, solution.shift)?;
    }
    let used = [0, 1].map(|k| kept[k].as_ref().unwrap_or(every[k]));
    let of_phase = solution.variances(axes, used);
    let Solution { shift, inverse, .. } = solution;
    let variance = [0, 1].map(|k: usize| {
        let [a, b] = inverse[k];
        a * a * of_phase[0] + b * b * of_phase[1] + (axes[k].gain_error * shift[k]).powi(2)
    });
    Some(Fix { shift, variance, coherence: solution.coherence(axes, &phases) })
}

/// Translation along each axis alone, the ratio times the mean phase of all active pixels: equations 4 and 17.
///
/// The variance is not the paper's: what one frame's noise makes of the mean phase. None without pixels.
pub fn measure_printed(axes: [&AxisModel; 2], ratios: [f64; 2], now: [&Responses; 2]) -> Option<Fix> {
    if axes.iter().any(|axis| axis.is_empty()) {
        return None;
    }
    let phases = [0, 1].map(|k| phases(axes[k], now[k]));
    let every = axes.map(|axis| &axis.weights);
    let shift = [0, 1].map(|k| ratios[k] * dot_f64(&every[k].each, &phases[k].change));
    let solution = Solution::at(axes, &phases, shift, [[0.0; 2]; 2]);
    let of_phase = solution.variances(axes, every);
    let variance = [0, 1].map(|k| ratios[k] * ratios[k] * of_phase[k]);
    Some(Fix { shift, variance, coherence: solution.coherence(axes, &phases) })
}

/// A translation, what it leaves of each pixel's phase, and the noise of one image (variance) that this shows.
struct Solution {
    shift: [f64; 2],
    inverse: [[f64; 2]; 2],
    errors: [Vec<f32>; 2],
    noise: [f64; 2],
}

impl Solution {
    /// From the mean phases, taken about what the last estimate expects, so that single pixels near ±π do not wrap.
    fn of(axes: [&AxisModel; 2], phases: &[Phases; 2], weights: [&Weights; 2], start: [f64; 2]) -> Option<Self> {
        let [[a, b], [c, d]] = weights.map(|weights| weights.slope);
        let determinant = a * d - b * c;
        if determinant.is_nan() || determinant.abs() <= SMALLEST_DETERMINANT {
            return None;
        }
        let inverse = [[d / determinant, -b / determinant], [-c / determinant, a / determinant]];
        let mut shift = start;
        let mut errors = [Vec::new(), Vec::new()];
        for _ in 0..ROUNDS {
            // Where the errors are taken, in their precision, so that no rounding of it is left.
            shift = shift.map(|value| f64::from(value as f32));
            let mean = [0, 1].map(|k: usize| {
                take_errors(axes[k], &phases[k].change, shift, &mut errors[k]);
                dot_f64(&weights[k].each, &errors[k])
            });
            shift = [0, 1].map(|k: usize| shift[k] + inverse[k][0] * mean[0] + inverse[k][1] * mean[1]);
        }
        Some(Self::at(axes, phases, shift, inverse))
    }

    fn at(axes: [&AxisModel; 2], phases: &[Phases; 2], shift: [f64; 2], inverse: [[f64; 2]; 2]) -> Self {
        let errors = [0, 1].map(|k: usize| {
            let mut errors = Vec::new();
            take_errors(axes[k], &phases[k].change, shift, &mut errors);
            errors
        });
        let noise = [0, 1].map(|k: usize| axes[k].noise(&errors[k]));
        Self { shift, inverse, errors, noise }
    }

    /// Of the mean phases, rad².
    fn variances(&self, axes: [&AxisModel; 2], weights: [&Weights; 2]) -> [f64; 2] {
        [0, 1].map(|k| axes[k].variance(weights[k], &self.errors[k], self.noise[k]))
    }

    /// The smaller of both axes' coherences.
    fn coherence(&self, axes: [&AxisModel; 2], phases: &[Phases; 2]) -> f64 {
        let [x, y] = [0, 1].map(|k| axes[k].coherence(&phases[k], &self.errors[k]));
        x.min(y)
    }
}

#[cfg(test)]
mod tests {
    use super::super::phase_axis::ActivePixel;
    use super::super::vector::on_both;
    use super::*;
    use proptest::prelude::*;

    /// Pixels of a plane wave along each axis, and the responses after a translation; one in eleven may be off by
    /// `off`.
    fn waves(shift: [f64; 2], off: f32) -> ([AxisModel; 2], [Responses; 2]) {
        let both = [0usize, 1].map(|axis| {
            let mut now = Responses::default();
            let pixels = (0..160)
                .map(|k| {
                    let mut slope = [0.1, -0.07];
                    slope[axis] = -1.2 - 0.002 * f64::from(k);
                    let curve = [0.03, -0.02, 0.01];
                    let [x, y] = shift;
                    let bend = curve[0] * 0.5 * x * x + curve[1] * 0.5 * y * y + curve[2] * x * y;
                    let phase = 2.9 + 0.1 * f64::from(k);
                    let change = slope[0] * x + slope[1] * y + bend + if k % 11 == 3 { f64::from(off) } else { 0.0 };
                    now.even.push((20.0 * (phase + change).cos()) as f32);
                    now.odd.push((20.0 * (phase + change).sin()) as f32);
                    ActivePixel {
                        index: k as usize,
                        reference: [(20.0 * phase.cos()) as f32, (20.0 * phase.sin()) as f32],
                        weight: 1.0 / 160.0,
                        slope,
                        curve,
                        unit: 0.01,
                        block: (k * 5 % 16) as usize,
                    }
                })
                .collect();
            (AxisModel::new(pixels, 1e-4, 0.0), now)
        });
        let [(x, of_x), (y, of_y)] = both;
        ([x, y], [of_x, of_y])
    }

    proptest! {
        #[test]
        fn a_translation_is_found_again(x in -0.9..0.9f64, y in -0.9..0.9f64) {
            let (axes, now) = waves([x, y], 0.0);
            let found = on_both(|| measure([&axes[0], &axes[1]], [&now[0], &now[1]])).unwrap();
            // Each round leaves the share of the curvature in the slope, 0.03 · 0.9 / 1.2; three leave 1e-5.
            prop_assert!((found.shift[0] - x).abs() < 2e-5 && (found.shift[1] - y).abs() < 2e-5, "{:?}", found);
            prop_assert!((found.coherence - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn pixels_that_contradict_the_others_do_not_count() {
        let (axes, now) = waves([0.3, -0.2], 1.5);
        let found = on_both(|| measure([&axes[0], &axes[1]], [&now[0], &now[1]])).unwrap();
        assert!((found.shift[0] - 0.3).abs() < 1e-5 && (found.shift[1] + 0.2).abs() < 1e-5, "{found:?}");
        let printed = measure_printed([&axes[0], &axes[1]], [-0.7; 2], [&now[0], &now[1]]).unwrap();
        let change = |k: usize| axes[k].changes(&now[k]).map(|(_, change)| f64::from(change)).sum::<f64>() / 160.0;
        assert!((printed.shift[0] + 0.7 * change(0)).abs() < 1e-7);
        assert!(printed.coherence < 0.95);
    }

    #[test]
    fn pixels_without_a_response_draw_to_no_place() {
        let (axes, mut now) = waves([0.45, -0.4], 0.0);
        for of in &mut now {
            of.even[20..36].fill(0.0);
            of.odd[20..36].fill(0.0);
        }
        let found = on_both(|| measure([&axes[0], &axes[1]], [&now[0], &now[1]])).unwrap();
        assert!((found.shift[0] - 0.45).abs() < 1e-4 && (found.shift[1] + 0.4).abs() < 1e-4, "{found:?}");
    }

    #[test]
    fn two_axes_of_one_slope_tell_nothing() {
        let (axes, now) = waves([0.1, 0.0], 0.0);
        assert_eq!(measure([&axes[0], &axes[0]], [&now[0], &now[0]]), None);
    }
}
