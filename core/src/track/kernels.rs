//! Kernels that turn pixels into translations: one product a pixel for x, for y and for the gain.
//!
//! In each block of the window the frame is a T - a d·∇T + level + ramps, with the template T at a known phase, a small
//! remaining shift d and a gain a. The kernels are the rows of (Zᵀ W A)⁻¹ Zᵀ W that belong to a d and a: A holds the
//! gradients, the template, 1, two ramps and the template times each ramp (light that falls off across the block), W
//! one over each pixel's noise variance, and Z the same columns as A of the low-passed template. Whatever is in A and
//! not wanted drops out exactly; the low-pass in Z alone keeps the template's noise and aliasing, which the gradient
//! amplifies, out of the result (an instrument in the sense of regression). What they give for the second order of a
//! shift is known and taken off, so that kernels for every eighth of a pixel are enough.

use super::fine_spline::{Curvatures, Fine, Slopes, bends, slopes};
use super::grid::{Grid, Part};
use super::matrix::{Matrix, inverse_with_pivots};
use super::vector::vectorised;

/// A pixel, along each axis: the third order over 1/16 px leaves an error of the order of 4e-5 px.
pub const PHASES: i64 = 8;
/// Of both axes.
pub const ALL_PHASES: usize = (PHASES * PHASES) as usize;
/// What a block's pixels are linear in.
const UNKNOWNS: usize = 8;
/// Turned, enlarged, dx²/2, dx dy, dy²/2.
const WARPS: usize = 5;
/// Below this share of its row a pivot says that the block holds no texture.
const SINGULAR: f64 = 1e-9;
/// No translation is longer, px.
pub const MAX_PX: f64 = 1e9;
const LARGEST_HALF: f32 = 32767.0;

/// The nearest eighth of a pixel to a translation, as whole pixels and a phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantised {
    /// Whole pixels x, y.
    pub whole: [i64; 2],
    /// Number of the phase, that of x first.
    pub phase: usize,
    /// What both make together, px.
    pub near: [f64; 2],
}

impl Quantised {
    /// Next to a translation x, y in px.
    pub fn new(place: [f64; 2]) -> Self {
        let steps = place.map(|at| (at.clamp(-MAX_PX, MAX_PX) * PHASES as f64 + 0.5).floor());
        let whole = steps.map(|steps| (steps as i64 + PHASES / 2).div_euclid(PHASES));
        let part = [0, 1].map(|k| steps[k] as i64 - whole[k] * PHASES + PHASES / 2);
        Self { whole, phase: (part[0] * PHASES + part[1]) as usize, near: steps.map(|steps| steps / PHASES as f64) }
    }
}

/// The shift x, y in px, -0.5 to below 0.5, of the phase of that number.
pub fn phase_shift(phase: usize) -> [f64; 2] {
    let phase = phase as i64;
    [phase / PHASES, phase % PHASES].map(|part| (part - PHASES / 2) as f64 / PHASES as f64)
}

/// The slot of a phase among `count` slots; phases share slots where there are fewer of these.
///
/// Neighbouring phases, and those along either axis, have slots of their own where there are 8 of them.
pub fn phase_slot(phase: usize, count: usize) -> usize {
    let (x, y) = (phase / PHASES as usize, phase % PHASES as usize);
    (PHASES as usize * x + (3 * x + y) % PHASES as usize) % count
}

/// Of how many phases kernels are kept, `bytes` of them a window with three of 16 bits a pixel.
pub fn held_phases(bytes: usize, pixels: usize) -> usize {
    (bytes / (6 * pixels).max(1)).clamp(4, ALL_PHASES)
}

/// The edges of the blocks along an axis of `size` px: at most `most`, of at least `least` px.
pub fn edges(size: usize, most: usize, least: usize) -> Vec<usize> {
    let count = most.min((size / least).max(2));
    (0..=count).map(|k| k * size / count).collect()
}

/// A block's kernels for a d along x and y and for a, pixel after pixel, and what they give for x and y (rows) of a
/// block turned by 1 rad or enlarged by 1 about its middle, and of the second order of a shift.
#[derive(Clone, Debug)]
pub struct Exact {
    /// Of the pixels.
    pub kernels: [Vec<f64>; 3],
    /// By roll, zoom, dx²/2, dx dy and dy²/2 (columns).
    pub warp: [[f64; WARPS]; 2],
}

impl Exact {
    /// Noise covariance of what the kernels give for pixels of this weight: one over each one's variance.
    pub fn covariance(&self, weight: &Grid, part: Part) -> Matrix<3> {
        let weight = weight.part(part);
        [0, 1, 2].map(|i| {
            [0, 1, 2].map(|j| {
                let products = self.kernels[i].iter().zip(&self.kernels[j]).zip(&weight.values);
                // As they are used: in single precision.
                products.map(|((a, b), w)| f64::from(*a as f32) / f64::from(*w) * f64::from(*b as f32)).sum()
            })
        })
    }
}

/// The kernels of the block `part` for the template moved by `shift` (x, y px); None where it holds no texture.
///
/// `grids`: fine spline coefficients (2 h + 7, 2 w + 7) of the template and of the low-passed one; `weight` (h, w): one
/// over the noise variance.
pub fn build(grids: &[Fine; 2], weight: &Grid, part: Part, shift: [f64; 2]) -> Option<Exact> {
    let (moved, curved) = bends(&grids[0], part, shift[0], shift[1]);
    let smooth = slopes(&grids[1], part, shift[0], shift[1]);
    let model = columns(&moved);
    let mut weighted = columns(&smooth);
    let weight = weight.part(part);
    for column in &mut weighted {
        column.iter_mut().zip(&weight.values).for_each(|(value, weight)| *value *= f64::from(*weight));
    }
    let normal = weighted.each_ref().map(|one| model.each_ref().map(|other| product(one, other)));
    let inverse = inverse_with_pivots::<UNKNOWNS>(&normal, SINGULAR)?;
    let kernels = [0, 1, 2].map(|k| mixed(&weighted, &inverse[k]));
    let changes = warps(&moved, &curved);
    let warp = [0, 1].map(|k| changes.each_ref().map(|change| product(&kernels[k], change)));
    Some(Exact { kernels, warp })
}

vectorised! {
    /// Sum of products.
    fn product(one: &[f64], other: &[f64]) -> f64 {
        let mut lanes = [0.0f64; 8];
        let (blocks, others) = (one.chunks_exact(8), other.chunks_exact(8));
        let (rest, rest_of_other) = (blocks.remainder(), others.remainder());
        for (a, b) in blocks.zip(others) {
            for k in 0..8 {
                lanes[k] += a[k] * b[k];
            }
        }
        for (lane, (a, b)) in lanes.iter_mut().zip(rest.iter().zip(rest_of_other)) {
            *lane += a * b;
        }
        ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]))
    }
}

vectorised! {
    /// The columns, each times its share.
    fn mixed(columns: &[Vec<f64>; UNKNOWNS], share: &[f64; UNKNOWNS]) -> Vec<f64> {
        let mut out = vec![0.0; columns[0].len()];
        for (column, share) in columns.iter().zip(share) {
            for (out, value) in out.iter_mut().zip(column) {
                *out += share * value;
            }
        }
        out
    }
}

/// The regressors of a block's pixels: -∂x, -∂y, template, 1, ramps across and down, the template times each.
fn columns(planes: &Slopes) -> [Vec<f64>; UNKNOWNS] {
    let (rows, columns) = (planes.value.rows, planes.value.columns);
    let mut out: [Vec<f64>; UNKNOWNS] = std::array::from_fn(|_| Vec::with_capacity(rows * columns));
    for r in 0..rows {
        let down = (2.0 * r as f64 - rows as f64 + 1.0) / rows as f64;
        for c in 0..columns {
            let across = (2.0 * c as f64 - columns as f64 + 1.0) / columns as f64;
            let [value, x, y] = [&planes.value, &planes.x, &planes.y].map(|plane| f64::from(plane.row(r)[c]));
            let row = [-x, -y, value, 1.0, across, down, across * value, down * value];
            out.iter_mut().zip(row).for_each(|(out, value)| out.push(value));
        }
    }
    out
}

/// How a block's pixels change when it is turned by 1 rad, when it is enlarged by 1, and to the second order of a
/// shift.
fn warps(planes: &Slopes, curvatures: &Curvatures) -> [Vec<f64>; WARPS] {
    let (rows, columns) = (planes.value.rows, planes.value.columns);
    let mut out: [Vec<f64>; WARPS] = std::array::from_fn(|_| Vec::with_capacity(rows * columns));
    for r in 0..rows {
        let y = r as f64 - 0.5 * (rows as f64 - 1.0);
        for c in 0..columns {
            let x = c as f64 - 0.5 * (columns as f64 - 1.0);
            let [along, down] = [&planes.x, &planes.y].map(|plane| f64::from(plane.row(r)[c]));
            let [xx, xy, yy] = [&curvatures.xx, &curvatures.xy, &curvatures.yy].map(|plane| f64::from(plane.row(r)[c]));
            let row = [y * along - x * down, -x * along - y * down, xx, xy, yy];
            out.iter_mut().zip(row).for_each(|(out, value)| out.push(value));
        }
    }
    out
}

/// Kernels as whole numbers of 16 bits with a step each.
///
/// Half the memory is half the time, as kernels come from outside the processor's caches. Their rounding makes less
/// than a thousandth of the noise of a frame.
#[derive(Clone, Debug)]
pub struct Halves {
    /// Pixel after pixel, of a d along x and y and of a.
    pub values: [Vec<i16>; 3],
    /// Of each kernel.
    pub steps: [f32; 3],
    /// See [`Exact`].
    pub warp: [[f64; WARPS]; 2],
}

impl Halves {
    /// The exact ones rounded; zeros where there are none.
    pub fn new(exact: Option<&Exact>, size: usize) -> Self {
        let Some(exact) = exact else {
            return Self { values: std::array::from_fn(|_| vec![0; size]), steps: [1.0; 3], warp: [[0.0; WARPS]; 2] };
        };
        let single = exact.kernels.each_ref().map(|kernel| kernel.iter().map(|&v| v as f32).collect::<Vec<f32>>());
        let steps = single.each_ref().map(|kernel| {
            let largest = kernel.iter().fold(0.0f32, |most, value| most.max(value.abs()));
            if largest > 0.0 { largest / LARGEST_HALF } else { 1.0 }
        });
        let values = std::array::from_fn(|k| {
            single[k].iter().map(|value| (value / steps[k]).round_ties_even() as i16).collect()
        });
        Self { values, steps, warp: exact.warp }
    }

    /// Products of the kernels with the pixels of their block.
    #[inline(always)]
    pub fn products(&self, pixels: &[f32]) -> [f64; 3] {
        [0, 1, 2].map(|k| f64::from(self.steps[k]) * f64::from(halves_product(&self.values[k], pixels)))
    }
}

vectorised! {
    /// Sum of products.
    fn halves_product(kernel: &[i16], pixels: &[f32]) -> f32 {
        super::vector::dot(kernel, pixels)
    }
}

#[cfg(test)]
mod tests {
    use super::super::fine_spline::refined;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn whole_pixels_and_phase_make_the_nearest_eighth(x in -40.0..40.0f64, y in -40.0..40.0f64) {
            let found = Quantised::new([x, y]);
            let shift = phase_shift(found.phase);
            for (k, at) in [x, y].into_iter().enumerate() {
                prop_assert!((found.near[k] - at).abs() <= 0.0625);
                prop_assert!((found.whole[k] as f64 + shift[k] - found.near[k]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn kernels_give_a_small_shift_and_the_gain_whatever_level_and_ramp_are() {
        let wave = |x: f64, y: f64| 30.0 * (0.5 * x + 0.2 * y).sin() + 20.0 * (0.45 * y - 0.3 * x).cos();
        let image = |dx: f64, dy: f64| {
            let values = (0..40 * 40).map(|k| wave((k % 40) as f64 - dx, (k / 40) as f64 - dy)).collect();
            Grid { values, rows: 40, columns: 40 }
        };
        let grid = Fine::of(&refined(&image(0.0, 0.0)));
        let part = Part { top: 8, bottom: 30, left: 9, right: 33 };
        let made = build(&[grid.clone(), grid], &Grid::filled(40, 40, 1.0), part, [0.25, -0.125]).unwrap();
        let kernels = Halves::new(Some(&made), part.size());
        let seen = image(0.255, -0.119).part(part);
        let pixels: Vec<f32> =
            seen.values.iter().enumerate().map(|(k, v)| (1.2 * v + 7.0 + 0.1 * (k % 24) as f64) as f32).collect();
        let [x, y, gain] = kernels.products(&pixels);
        // The second order of 0.008 px and kernels of 16 bits.
        assert!((x / gain - 0.005).abs() < 1e-4 && (y / gain - 0.006).abs() < 1e-4 && (gain - 1.2).abs() < 1e-3);
    }

    #[test]
    fn a_block_without_texture_has_no_kernels_and_slots_are_shared_fairly() {
        let flat = Fine::of(&Grid::filled(47, 47, 3.0));
        let part = Part { top: 0, bottom: 20, left: 0, right: 20 };
        assert!(build(&[flat.clone(), flat], &Grid::filled(20, 20, 1.0), part, [0.0; 2]).is_none());
        for y in 0..8 {
            let mut along: Vec<usize> = (0..8).map(|x| phase_slot(8 * x + y, 8)).collect();
            along.sort_unstable();
            assert_eq!(along, [0, 1, 2, 3, 4, 5, 6, 7]);
        }
    }
}
