//! The active pixels of the filter along one axis: their phases in a frame, and what a translation leaves of these.
//!
//! The noise of one image comes from the median of the phases' squares; what contradicts it stands before the target.

use super::angles::{angle, cosine};
use super::picture_noise::median;
use super::steerable::Responses;
use super::vector::{dot_f64, sum_f64, vectorised};
use std::f32::consts::{FRAC_PI_2, PI};

/// The residual is watched in 4 by 4 blocks.
pub const BLOCKS: usize = 16;
const MAX_SIGMA: f64 = 4.0;
const MAX_BEND_RAD: f64 = 0.3;
const MIN_AGREEING: f64 = 0.4;
const NEARLY_ALL: f64 = 0.99;
/// A response of less than this share of the reference's power is none: rounding leaves 1e-12.
const SILENT: f32 = 1e-6;
/// Of the square of a normal variable of variance 1.
const MEDIAN_OF_SQUARE: f64 = 0.4549;
/// Blocks that the scatter of the mean is estimated from.
const MIN_BLOCKS: usize = 4;
/// The blocks' variance counts where it exceeds the pixels' by this factor.
const MUCH_LARGER: f64 = 3.0;

/// An active pixel of the filter along one axis.
#[derive(Clone, Copy, Debug)]
pub struct ActivePixel {
    /// Its place in the flattened region.
    pub index: usize,
    /// The reference's even and odd response.
    pub reference: [f32; 2],
    /// In the mean; the sum is 1.
    pub weight: f64,
    /// Phase by translation along x and y, rad/px.
    pub slope: [f64; 2],
    /// Phase by half the squares of x and y and by their product, rad/px².
    pub curve: [f64; 3],
    /// Variance of the phase for image noise of variance 1.
    pub unit: f64,
    /// The part of the region, below `BLOCKS`.
    pub block: usize,
}

/// The active pixels of the filter along one axis, block by block; a column for each of their numbers.
pub struct AxisModel {
    index: Vec<u32>,
    even: Vec<f32>,
    odd: Vec<f32>,
    /// Of all of them.
    pub weights: Weights,
    slope: [Vec<f32>; 2],
    curve: [Vec<f32>; 3],
    unit: Vec<f32>,
    /// Where each block begins, and the last one ends.
    edges: [usize; BLOCKS + 1],
    reference_power: f64,
    /// Standard deviation of the gain over the gain.
    pub gain_error: f64,
}

/// How much each pixel counts in the mean phase.
#[derive(Clone)]
pub struct Weights {
    /// In the pixels' order.
    pub each: Vec<f32>,
    of_blocks: [f64; BLOCKS],
    /// Mean phase by translation along x and y, rad/px.
    pub slope: [f64; 2],
    /// Variance of the mean phase for image noise of variance 1, with the noise's correlation between pixels.
    sensitivity: f64,
}

/// Phases of a frame's active pixels and the power of its responses there.
pub struct Phases {
    /// Less the reference's, rad.
    pub change: Vec<f32>,
    power: Vec<f32>,
}

impl AxisModel {
    /// `sensitivity`, `gain_error`: as in [`Weights`], and standard deviation of the gain over the gain.
    pub fn new(mut pixels: Vec<ActivePixel>, sensitivity: f64, gain_error: f64) -> Self {
        pixels.sort_by_key(|pixel| pixel.block);
        let single =
            |of: &dyn Fn(&ActivePixel) -> f64| pixels.iter().map(|pixel| of(pixel) as f32).collect::<Vec<f32>>();
        let edges = std::array::from_fn(|block| pixels.partition_point(|pixel| pixel.block < block));
        let mut model = Self {
            index: pixels.iter().map(|pixel| pixel.index as u32).collect(),
            even: pixels.iter().map(|pixel| pixel.reference[0]).collect(),
            odd: pixels.iter().map(|pixel| pixel.reference[1]).collect(),
            weights: Weights { each: Vec::new(), of_blocks: [0.0; BLOCKS], slope: [0.0; 2], sensitivity },
            slope: [single(&|pixel| pixel.slope[0]), single(&|pixel| pixel.slope[1])],
            curve: [0, 1, 2].map(|k| single(&|pixel| pixel.curve[k])),
            unit: single(&|pixel| pixel.unit),
            edges,
            reference_power: pixels
                .iter()
                .map(|p| p.reference.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>())
                .sum(),
            gain_error,
        };
        model.weights = model.weighted(single(&|pixel| pixel.weight), sensitivity);
        model
    }

    /// How many active pixels there are.
    pub fn len(&self) -> usize {
        self.index.len()
    }

    /// Whether there is no active pixel.
    pub fn is_empty(&self) -> bool {
        self.index.is_empty()
    }

    /// Places in the flattened region with the phases there, of a frame's responses.
    pub fn changes(&self, now: &Responses) -> impl Iterator<Item = (usize, f32)> {
        let phases = phases(self, now);
        self.index.iter().map(|&index| index as usize).zip(phases.change)
    }

    fn weighted(&self, each: Vec<f32>, sensitivity: f64) -> Weights {
        let of_blocks = std::array::from_fn(|block| sum_f64(&each[self.edges[block]..self.edges[block + 1]]));
        let slope = [0, 1].map(|axis: usize| dot_f64(&each, &self.slope[axis]));
        Weights { each, of_blocks, slope, sensitivity }
    }

    /// The median of the squares of the errors by their units, as a variance: the noise of one image.
    pub fn noise(&self, error: &[f32]) -> f64 {
        median(&mut squares_by_unit(error, &self.unit)) / MEDIAN_OF_SQUARE
    }

    /// The weights without the pixels whose phase is off by more than noise and the linear gain explain; None where
    /// next to none are, or where most of the weight would go.
    pub fn agreeing(&self, error: &[f32], noise: f64) -> Option<Weights> {
        let mut each = agreeing(&self.weights.each, error, &self.unit, (MAX_SIGMA * MAX_SIGMA * noise) as f32);
        let share = sum_f64(&each);
        (MIN_AGREEING..NEARLY_ALL).contains(&share).then(|| {
            each.iter_mut().for_each(|weight| *weight = (f64::from(*weight) / share) as f32);
            self.weighted(each, self.weights.sensitivity / share)
        })
    }

    /// Variance (rad²) of the mean phase: from the pixels' scatter, or from the blocks' where that is much larger.
    ///
    /// The scatter is a median: the phase of few pixels is far from linear in the translation, which is no noise.
    pub fn variance(&self, weights: &Weights, error: &[f32], noise: f64) -> f64 {
        let white = noise * weights.sensitivity;
        let parts: Vec<[f64; 2]> = (0..BLOCKS)
            .filter(|&block| weights.of_blocks[block] > 0.0)
            .map(|block| {
                let part = self.edges[block]..self.edges[block + 1];
                [dot_f64(&weights.each[part.clone()], &error[part]), weights.of_blocks[block]]
            })
            .collect();
        if parts.len() < MIN_BLOCKS {
            return white;
        }
        // Leaving one block out changes the weighted mean by this much.
        let total: f64 = parts.iter().map(|part| part[0]).sum();
        let without: Vec<f64> = parts.iter().map(|[sum, share]| (total - sum) / (1.0 - share).max(1e-9)).collect();
        let count = without.len() as f64;
        let mean = without.iter().sum::<f64>() / count;
        let blocks = (count - 1.0) / count * without.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        if blocks > MUCH_LARGER * white { blocks } else { white }
    }

    /// Correlation of the responses once the translation is taken out: 1 for a perfect match.
    pub fn coherence(&self, phases: &Phases, error: &[f32]) -> f64 {
        let both = correlations(&phases.power, &self.even, &self.odd, error);
        both / (sum_f64(&phases.power) * self.reference_power).max(1e-300).sqrt()
    }
}

vectorised! {
/// Phases of a frame's responses.
///
/// The angle of the complex product lies in -π … π on its own; a difference of two angles would not. Where there is
/// next to no response (an even surface stands before the target) there is no phase: a quarter of a turn, one way and
/// the other, agrees with no translation and draws to none, where 0 would draw to the place that the region was moved
/// to.
pub fn phases(axis: &AxisModel, now: &Responses) -> Phases {
    let count = axis.index.len();
    let (mut even, mut odd) = (vec![0f32; count], vec![0f32; count]);
    for ((a, b), &index) in even.iter_mut().zip(&mut odd).zip(&axis.index) {
        (*a, *b) = (now.even[index as usize], now.odd[index as usize]);
    }
    let (mut change, mut power) = (vec![0f32; count], vec![0f32; count]);
    for ((((change, &a), &b), &c), &d) in change.iter_mut().zip(&even).zip(&odd).zip(&axis.even).zip(&axis.odd) {
        *change = angle(b * c - a * d, a * c + b * d);
    }
    for ((power, &a), &b) in power.iter_mut().zip(&even).zip(&odd) {
        *power = a * a + b * b;
    }
    for (k, change) in change.iter_mut().enumerate() {
        let least = SILENT * (axis.even[k] * axis.even[k] + axis.odd[k] * axis.odd[k]);
        let quarter = if k % 2 == 0 { FRAC_PI_2 } else { -FRAC_PI_2 };
        *change = if power[k] < least { quarter } else { *change };
    }
    Phases { change, power }
}
}

vectorised! {
/// Phases less what a translation explains, wrapped into -π … π.
pub fn take_errors(axis: &AxisModel, change: &[f32], shift: [f64; 2], errors: &mut Vec<f32>) {
    let [x, y] = shift.map(|value| value as f32);
    let [of_xx, of_yy, of_xy] = [0.5 * x * x, 0.5 * y * y, x * y];
    let count = change.len();
    let [slope_x, slope_y] = [&axis.slope[0][..count], &axis.slope[1][..count]];
    let [curve_xx, curve_yy, curve_xy] = [0, 1, 2].map(|k| &axis.curve[k][..count]);
    errors.resize(count, 0.0);
    for (k, out) in errors[..count].iter_mut().enumerate() {
        let bend = curve_xx[k] * of_xx + curve_yy[k] * of_yy + curve_xy[k] * of_xy;
        let error = change[k] - (slope_x[k] * x + slope_y[k] * y + bend);
        let turn = if error > PI { 2.0 * PI } else { 0.0 } - if error < -PI { 2.0 * PI } else { 0.0 };
        *out = error - turn;
    }
}
}

vectorised! {
fn squares_by_unit(error: &[f32], unit: &[f32]) -> Vec<f32> {
    let mut squares = vec![0f32; error.len()];
    for ((square, error), unit) in squares.iter_mut().zip(error).zip(unit) {
        *square = error * error / unit;
    }
    squares
}
}

vectorised! {
/// The weights of the pixels whose error is within a limit times their unit, else 0.
fn agreeing(weights: &[f32], error: &[f32], unit: &[f32], limit: f32) -> Vec<f32> {
    let bend = (MAX_BEND_RAD * MAX_BEND_RAD) as f32;
    let mut kept = vec![0f32; weights.len()];
    for (((kept, &weight), &error), &unit) in kept.iter_mut().zip(weights).zip(error).zip(unit) {
        *kept = if error * error <= limit * unit + bend { weight } else { 0.0 };
    }
    kept
}
}

vectorised! {
/// Sum of the products of both amplitudes with the cosine of the error.
fn correlations(power: &[f32], even: &[f32], odd: &[f32], error: &[f32]) -> f64 {
    let mut each = vec![0f32; power.len()];
    for ((((each, a), even), odd), &e) in each.iter_mut().zip(power).zip(even).zip(odd).zip(error) {
        *each = (a * (even * even + odd * odd)).sqrt() * cosine(e);
    }
    sum_f64(&each)
}
}
