//! A better template than one frame: two samples a pixel, fitted to frames whose sub-pixel places differ.
//!
//! One frame holds what lies above half a cycle a pixel aliased to lower frequencies; frames at different places alias
//! it differently, so that together they distinguish it. The spline coefficients minimise the squared differences from
//! all frames, each at its place, plus a penalty on the fourth power of the Laplacian that stands for how the spectrum
//! of pictures through a lens falls (after Elad and Feuer, 1997, doi 10.1109/83.650118). Here are the normal equations
//! of that; Python solves them by conjugate gradients.

use super::fine_spline::{Fine, Spreading, Taps, read_into, slopes, spread_into};
use super::grid::{Grid, Part};
use super::matrix::{Matrix, inverse_with_pivots, times};
use super::normal::Normal;
use super::vector::{dot, dot_f64, sum_f64, vectorised};

/// Around the window: what low-pass and spline reach for.
pub const PAD_PX: usize = 8;
/// A smaller gain is none.
const MIN_GAIN: f64 = 0.1;
/// A place moves by no more at once, px.
const MAX_STEP_PX: f64 = 0.1;
/// Whole pixels are known: no place lies farther from them, px.
const MAX_SHIFT_PX: f64 = 0.6;
const SINGULAR: f64 = 1e-13;

/// Frames that lie at one place.
#[derive(Clone)]
pub struct Sample {
    /// Their mean on the template's pixels.
    pub pixels: Grid,
    /// Translation x, y in px less whole pixels.
    pub shift: [f64; 2],
    /// How many frames.
    pub count: f64,
}

/// The frames that a template is fitted to.
pub struct Samples {
    /// Of one size.
    pub items: Vec<Sample>,
}

impl Samples {
    /// What all samples give to coefficients of this shape: the right side of the normal equations.
    pub fn spread(&self, rows: usize, columns: usize) -> Grid {
        let mut out = Fine::zeros(rows, columns);
        spread_all(&self.items, &mut out);
        out.joined()
    }

    /// The normal equations of coefficients of this shape, with the penalty.
    pub fn normal(&self, rows: usize, columns: usize, penalty: f64) -> Normal {
        let taps = |item: &Sample| ([item.shift[1], item.shift[0]].map(|shift| Taps::new(-shift, 0)), item.count);
        Normal::new(rows, columns, self.items.iter().map(taps), penalty)
    }

    /// Mean square of what the fit leaves of one frame; of the first samples only, if this many are `most`.
    pub fn residual_square(&self, grid: &Grid, most: usize) -> Grid<f64> {
        let grid = Fine::of(grid);
        let items = &self.items[..most.min(self.items.len())];
        let size = grid.pixels();
        let mut out = Grid::filled(size.rows(), size.columns(), 0.0f64);
        let mut expected = Grid::filled(size.rows(), size.columns(), 0.0f32);
        for item in items {
            expected_of(item, &grid, &mut expected);
            for (out, (seen, expected)) in out.values.iter_mut().zip(item.pixels.values.iter().zip(&expected.values)) {
                let rest = f64::from(seen - expected);
                *out += item.count * rest * rest;
            }
        }
        let divided = items.len().saturating_sub(1).max(1) as f64;
        out.values.iter_mut().for_each(|out| *out /= divided);
        out
    }

    /// Give each sample the place, level and contrast that the template says: one step of least squares.
    pub fn place(&mut self, grid: &Grid) {
        let grid = Fine::of(grid);
        self.items.iter_mut().for_each(|item| placed(item, &grid));
    }
}

vectorised! {
    fn expected_of(item: &Sample, grid: &Fine, out: &mut Grid) {
        read_into(grid, &Taps::new(-item.shift[1], 0), &Taps::new(-item.shift[0], 0), out);
    }
}

vectorised! {
    fn spread_all(items: &[Sample], out: &mut Fine) {
        let size = out.pixels();
        let mut spreading = Spreading::new(size.rows(), size.columns());
        for item in items {
            let [across, down] = item.shift.map(|shift| Taps::new(-shift, 0));
            spread_into(&item.pixels, &down.times(item.count), &across, &mut spreading, out);
        }
    }
}

/// Pixels at the level and with the contrast of others.
pub fn alike(pixels: &Grid, like: &Grid) -> Grid {
    let level = |grid: &Grid| (sum_f64(&grid.values) / grid.values.len() as f64) as f32;
    let [own, others] = [pixels, like].map(|grid| {
        let level = level(grid);
        grid.map(|value| value - level)
    });
    let [square, wanted] = [&own, &others].map(|grid| dot_f64(&grid.values, &grid.values));
    let gain = (wanted / square.max(1e-60)).sqrt() as f32;
    let level = level(like);
    own.map(|value| gain * value + level)
}

/// See [`Samples::place`].
fn placed(item: &mut Sample, grid: &Fine) {
    let size = grid.pixels();
    let part = Part { top: PAD_PX, bottom: size.bottom - PAD_PX, left: PAD_PX, right: size.right - PAD_PX };
    let moved = slopes(grid, part, item.shift[0], item.shift[1]);
    let ones = vec![1.0f32; part.columns()];
    let (mut matrix, mut right) = (Matrix::<4>::default(), [0.0; 4]);
    for r in 0..part.rows() {
        let seen = &item.pixels.row(part.top + r)[part.left..part.right];
        // Products that are sums along one line lose nothing in single precision.
        let lines = [moved.x.row(r), moved.y.row(r), moved.value.row(r), &ones];
        for i in 0..4 {
            right[i] += f64::from(line_product(lines[i], seen));
            for j in 0..=i {
                matrix[i][j] += f64::from(line_product(lines[i], lines[j]));
            }
        }
    }
    // The picture moves with the shift, and its values against the slopes.
    let sign = |k: usize| if k < 2 { -1.0 } else { 1.0 };
    let whole = |i: usize, j: usize| sign(i) * sign(j) * matrix[i.max(j)][i.min(j)];
    let matrix = std::array::from_fn(|i| std::array::from_fn(|j| whole(i, j)));
    let Some(inverse) = inverse_with_pivots::<4>(&matrix, SINGULAR) else { return };
    let found = times(&inverse, &std::array::from_fn(|i| sign(i) * right[i]));
    let gain = if found[2] > MIN_GAIN { found[2] } else { 1.0 };
    item.pixels.values.iter_mut().for_each(|value| *value = (*value - found[3] as f32) / gain as f32);
    for (shift, step) in item.shift.iter_mut().zip(found) {
        *shift = (*shift + (step / gain).clamp(-MAX_STEP_PX, MAX_STEP_PX)).clamp(-MAX_SHIFT_PX, MAX_SHIFT_PX);
    }
}

vectorised! {
    fn line_product(one: &[f32], other: &[f32]) -> f32 {
        dot(one, other)
    }
}

vectorised! {
    /// Fill `out` with the sum of the four neighbours less four times the value; beyond the edge the value itself.
    fn laplacian(grid: &Grid<f64>, out: &mut Grid<f64>) {
        let last = grid.columns - 1;
        for r in 0..grid.rows {
            let (own, up, down) = (grid.row(r), grid.row(r.saturating_sub(1)), grid.row((r + 1).min(grid.rows - 1)));
            let into = out.row_mut(r);
            // The two edges apart: the rest then runs without a question, several values at once.
            for c in [0, last] {
                into[c] = up[c] + down[c] + own[c.saturating_sub(1)] + own[(c + 1).min(last)] - 4.0 * own[c];
            }
            let neighbours = up[1..].iter().zip(&down[1..]).zip(own).zip(&own[2..]).zip(&own[1..]);
            for (out, ((((up, down), before), after), own)) in into[1..].iter_mut().zip(neighbours) {
                *out = up + down + before + after - 4.0 * own;
            }
        }
    }
}

/// The Laplacian applied an even number of `times`.
fn powered(grid: &Grid, times: usize) -> Grid<f64> {
    let mut out = grid.map(|&value| f64::from(value));
    let mut other = out.clone();
    for _ in 0..times / 2 {
        laplacian(&out, &mut other);
        laplacian(&other, &mut out);
    }
    out
}

/// Mean square of the Laplacian's Laplacian, without what lies near the edges.
pub fn roughness(grid: &Grid) -> f64 {
    let bent = powered(grid, 2);
    let edge = PAD_PX;
    if bent.rows.min(bent.columns) <= 2 * edge {
        return 0.0;
    }
    let inner = Part { top: edge, bottom: bent.rows - edge, left: edge, right: bent.columns - edge };
    bent.part(inner).values.iter().map(|value| value * value).sum::<f64>() / inner.size() as f64
}

#[cfg(test)]
mod tests {
    use super::super::fine_spline::refined;
    use super::super::vector::on_both;
    use super::*;

    fn wave(x: f64, y: f64) -> f64 {
        30.0 * (0.5 * x + 0.3 * y).sin() + 20.0 * (0.4 * y - 0.6 * x).cos()
    }

    fn seen(size: usize, shift: [f64; 2]) -> Grid<f64> {
        let at = |k: usize| wave((k % size) as f64 - shift[0], (k / size) as f64 - shift[1]);
        Grid { values: (0..size * size).map(at).collect(), rows: size, columns: size }
    }

    #[test]
    fn a_sample_finds_its_place_level_and_contrast() {
        let grid = refined(&seen(40, [0.0; 2]));
        let pixels = seen(40, [0.23, -0.12]).map(|value| (1.3 * value + 5.0) as f32);
        let mut samples = Samples { items: vec![Sample { pixels, shift: [0.2, -0.1], count: 1.0 }] };
        samples.place(&grid);
        samples.place(&grid);
        let item = &samples.items[0];
        assert!((item.shift[0] - 0.23).abs() < 1e-4 && (item.shift[1] + 0.12).abs() < 1e-4, "{:?}", item.shift);
        // What is left is the spline's error at the edges.
        assert!(samples.residual_square(&grid, 9).row(20)[20] < 1e-4);
    }

    #[test]
    fn pixels_are_made_alike_in_level_and_contrast_alone() {
        let picture = seen(24, [0.0; 2]).map(|&value| value as f32);
        let found = alike(&picture.map(|value| 0.7 * value + 30.0), &picture);
        assert!(found.values.iter().zip(&picture.values).all(|(found, value)| (found - value).abs() < 1e-3));
    }

    #[test]
    fn the_normal_equations_read_each_sample_and_spread_it_again_and_bend_the_rest() {
        let shape = 2 * 24 + 7;
        let values = (0..shape * shape).map(|k| ((3.0 * k as f64).sin() * 10.0) as f32).collect();
        let grid = Grid { values, rows: shape, columns: shape };
        let item = |shift: [f64; 2]| {
            let mut item = Sample { pixels: Grid::filled(24, 24, 0.0), shift, count: 2.0 };
            let mut pixels = item.pixels.clone();
            expected_of(&item, &Fine::of(&grid), &mut pixels);
            item.pixels = pixels;
            item
        };
        let samples = Samples { items: vec![item([0.1, 0.4]), item([-0.3, 0.0]), item([-0.58, 0.6])] };
        let (found, bent) = (on_both(|| samples.normal(shape, shape, 0.01).times(&grid).unwrap()), powered(&grid, 4));
        for ((found, spread), bent) in found.values.iter().zip(samples.spread(shape, shape).values).zip(bent.values) {
            // Sums of a hundred products of up to 700 in single precision.
            assert!((f64::from(found - spread) - 0.01 * bent).abs() < 1e-3, "{found} {spread} {bent}");
        }
        assert!(samples.normal(shape, shape, 0.01).times(&Grid::filled(9, 9, 0.0)).is_none());
    }
}
