//! Quintic B-splines with two coefficients a pixel along each axis: pictures finer than the pixels they are read on.
//!
//! Coefficient k of a line lies k/2 px from its first pixel, less a margin of four coefficients before and behind.

use super::grid::{Grid, Part};
use super::spline::{REACH, coefficients, combine, quintic, weights};
use super::vector::{vectorised, weighted};
use std::array::from_fn;

/// Coefficients a pixel.
pub const PER_PX: usize = 2;
/// Coefficients beyond the first and last pixel: the spline's 3, and 1 for a shift of half a pixel.
pub const MARGIN: usize = 4;
/// Coefficients that a point depends on.
pub const FINE_TAPS: usize = 2 * MARGIN + 1;
/// Coefficients of a line beyond two a pixel.
pub const BEYOND: usize = FINE_TAPS - PER_PX;
/// Pixels to either side of one that share a coefficient with it.
const HALF: usize = FINE_TAPS / PER_PX;

/// Weights of the coefficients about a pixel for a point `shift` (-0.5 to 0.5 px) after it, or their first or second
/// derivative by it.
pub fn fine_weights(shift: f64, derivative: usize) -> [f64; FINE_TAPS] {
    let scale = (-(PER_PX as f64)).powi(derivative as i32);
    from_fn(|j| scale * quintic(j as f64 - MARGIN as f64 - PER_PX as f64 * shift, derivative))
}

/// How many of them are not 0.
const SUPPORT: usize = 6;
/// How many of these are of even, and of odd, coefficients.
const EACH: usize = SUPPORT / PER_PX;

/// The weights of [`fine_weights`] that are not 0.
#[derive(Clone, Copy)]
pub struct Taps {
    /// The first of the coefficients about a pixel that they belong to.
    pub first: usize,
    /// Of this and the next ones.
    pub weight: [f32; SUPPORT],
}

impl Taps {
    /// See [`fine_weights`].
    pub fn new(shift: f64, derivative: usize) -> Self {
        let all = fine_weights(shift, derivative);
        let first = ((PER_PX as f64 * shift).floor() + 2.0).clamp(0.0, (FINE_TAPS - SUPPORT) as f64) as usize;
        Self { first, weight: from_fn(|j| all[first + j] as f32) }
    }

    /// Times a factor.
    pub fn times(self, factor: f64) -> Self {
        Self { weight: self.weight.map(|weight| weight * factor as f32), ..self }
    }

    /// Those of even (`part` 0) or odd coefficients, with by how many pixels the first of them lies before.
    #[inline(always)]
    fn each_second(&self, part: usize) -> (usize, [f32; EACH]) {
        let before = (self.first + 1 - part) / PER_PX;
        (before, from_fn(|m| self.weight[PER_PX * (before + m) + part - self.first]))
    }
}

/// How many pixels lie on a number of coefficients.
pub fn pixels(coefficients: usize) -> usize {
    (coefficients.saturating_sub(FINE_TAPS)) / PER_PX + usize::from(coefficients >= FINE_TAPS)
}

/// Coefficients, those of even and those of odd columns apart: reading each second of them is then reading all.
#[derive(Clone, Debug, Default)]
pub struct Fine {
    /// Of columns 0, 2, 4 …
    pub even: Grid,
    /// Of columns 1, 3, 5 …
    pub odd: Grid,
}

impl Fine {
    /// No coefficients but 0.
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { even: Grid::filled(rows, columns.div_ceil(2), 0.0), odd: Grid::filled(rows, columns / 2, 0.0) }
    }

    /// Those of a grid of all.
    pub fn of(grid: &Grid) -> Self {
        let mut out = Self::zeros(grid.rows, grid.columns);
        for r in 0..grid.rows {
            let (even, odd, pairs) = (out.even.row_mut(r), out.odd.row_mut(r), grid.row(r).chunks_exact(2));
            if let ([last], Some(even)) = (pairs.remainder(), even.last_mut()) {
                *even = *last;
            }
            for ((pair, even), odd) in pairs.zip(even).zip(odd) {
                (*even, *odd) = (pair[0], pair[1]);
            }
        }
        out
    }

    /// All of them in one grid.
    pub fn joined(&self) -> Grid {
        let mut out = Grid::filled(self.even.rows, self.columns(), 0.0);
        for r in 0..out.rows {
            let row = out.row_mut(r);
            row.iter_mut().step_by(2).zip(self.even.row(r)).for_each(|(out, value)| *out = *value);
            row[1..].iter_mut().step_by(2).zip(self.odd.row(r)).for_each(|(out, value)| *out = *value);
        }
        out
    }

    /// Columns of all.
    pub fn columns(&self) -> usize {
        self.even.columns + self.odd.columns
    }

    /// The whole of the pixels that lie on the coefficients.
    pub fn pixels(&self) -> Part {
        Part { top: 0, bottom: pixels(self.even.rows), left: 0, right: pixels(self.columns()) }
    }

    /// The coefficients of the pixels from `origin` (row, column) on, `size` (rows, columns) of them.
    pub fn cropped(&self, origin: (usize, usize), size: (usize, usize)) -> Self {
        let part = |half: usize| Part {
            top: PER_PX * origin.0,
            bottom: PER_PX * (origin.0 + size.0) + BEYOND,
            left: origin.1,
            right: origin.1 + size.1 + half,
        };
        Self { even: self.even.part(part(HALF)), odd: self.odd.part(part(HALF - 1)) }
    }
}

/// Lines of coefficients about a row of pixels.
struct Line {
    even: Vec<f32>,
    odd: Vec<f32>,
}

impl Line {
    #[inline(always)]
    fn new(columns: usize) -> Self {
        Self { even: vec![0.0; columns + HALF], odd: vec![0.0; columns + HALF - 1] }
    }

    /// Fill with the sums of nine rows of coefficients from `row` on, about pixels from `left` on, each times its
    /// weight.
    #[inline(always)]
    fn down(&mut self, grid: &Fine, row: usize, left: usize, taps: &Taps) {
        let row = row + taps.first;
        weighted::<SUPPORT, false>(from_fn(|j| &grid.even.row(row + j)[left..]), taps.weight, &mut self.even);
        weighted::<SUPPORT, false>(from_fn(|j| &grid.odd.row(row + j)[left..]), taps.weight, &mut self.odd);
    }

    /// Fill `out` with the weighted sums of nine coefficients about each pixel.
    #[inline(always)]
    fn across(&self, taps: &Taps, out: &mut [f32]) {
        let line = |i: usize| if i % 2 == 0 { &self.even[i / 2..] } else { &self.odd[i / 2..] };
        weighted::<SUPPORT, false>(from_fn(|j| line(taps.first + j)), taps.weight, out);
    }
}

vectorised! {
    /// Values (rows, columns) on the pixels of the coefficients; weights down and across.
    pub fn read(grid: &Fine, down: &Taps, across: &Taps) -> Grid {
        let size = grid.pixels();
        let mut out = Grid::filled(size.rows(), size.columns(), 0.0);
        read_into(grid, down, across, &mut out);
        out
    }
}

/// Fill `out` with what [`read`] gives.
#[inline(always)]
pub fn read_into(grid: &Fine, down: &Taps, across: &Taps, out: &mut Grid) {
    let mut line = Line::new(out.columns);
    for r in 0..out.rows {
        line.down(grid, PER_PX * r, 0, down);
        line.across(across, out.row_mut(r));
    }
}

/// What [`spread_into`] needs besides: lines of what each row of pixels gives.
pub struct Spreading {
    /// With lines of 0 around those of the pixels.
    lines: Fine,
    line: Vec<f32>,
}

impl Spreading {
    /// For images of that number of pixels.
    pub fn new(rows: usize, columns: usize) -> Self {
        Self { lines: Fine::zeros(rows + 2 * HALF, PER_PX * columns + BEYOND), line: vec![0.0; columns + 2 * HALF] }
    }
}

/// Add to the coefficients `out` what [`read`] would take from each to `pixels`: its transpose.
#[inline(always)]
pub fn spread_into(pixels: &Grid, down: &Taps, across: &Taps, spreading: &mut Spreading, out: &mut Fine) {
    let Spreading { lines, line } = spreading;
    for r in 0..pixels.rows {
        line[HALF..HALF + pixels.columns].copy_from_slice(pixels.row(r));
        for (part, lines) in [&mut lines.even, &mut lines.odd].into_iter().enumerate() {
            let (before, weight) = across.each_second(part);
            weighted::<EACH, false>(from_fn(|m| &line[HALF - before - m..]), weight, lines.row_mut(r + HALF));
        }
    }
    for r in 0..out.even.rows {
        let (before, weight) = down.each_second(r % PER_PX);
        let row = r / PER_PX + HALF - before;
        for (lines, out) in [(&lines.even, &mut out.even), (&lines.odd, &mut out.odd)] {
            weighted::<EACH, true>(from_fn(|m| lines.row(row - m)), weight, out.row_mut(r));
        }
    }
}

/// A picture with its slopes, and with what they change by.
#[derive(Clone, Debug, Default)]
pub struct Slopes {
    /// Values.
    pub value: Grid,
    /// Derivative along x.
    pub x: Grid,
    /// Derivative along y.
    pub y: Grid,
}

/// Second derivatives of a picture.
#[derive(Clone, Debug, Default)]
pub struct Curvatures {
    /// Along x.
    pub xx: Grid,
    /// Along x and y.
    pub xy: Grid,
    /// Along y.
    pub yy: Grid,
}

vectorised! {
    /// Values and slopes of the spline image moved by (x, y) px, each -0.5 to 0.5, in a `part` of its pixels.
    pub fn slopes(grid: &Fine, part: Part, x: f64, y: f64) -> Slopes {
        let [down, steep] = [0, 1].map(|d| Taps::new(-y, d));
        let [across, along] = [0, 1].map(|d| Taps::new(-x, d));
        let mut line = Line::new(part.columns());
        let [mut value, mut slope_x, mut slope_y] = from_fn(|_| Grid::filled(part.rows(), part.columns(), 0.0));
        for r in 0..part.rows() {
            let (row, left) = (PER_PX * (part.top + r), part.left);
            line.down(grid, row, left, &down);
            line.across(&across, value.row_mut(r));
            line.across(&along, slope_x.row_mut(r));
            line.down(grid, row, left, &steep);
            line.across(&across, slope_y.row_mut(r));
        }
        Slopes { value, x: slope_x, y: slope_y }
    }
}

vectorised! {
    /// What [`slopes`] gives, and second derivatives of the same image.
    pub fn bends(grid: &Fine, part: Part, x: f64, y: f64) -> (Slopes, Curvatures) {
        let [down, across] = [y, x].map(|shift| [0, 1, 2].map(|d| Taps::new(-shift, d)));
        let mut line = Line::new(part.columns());
        // By the order of the derivative down, and that across.
        let [mut flat, mut steep, mut bent]: [[Grid; 3]; 3] =
            from_fn(|d| {
                from_fn(|k| if d + k < 3 { Grid::filled(part.rows(), part.columns(), 0.0) } else { Grid::default() })
            });
        for r in 0..part.rows() {
            for (d, out) in [&mut flat[..], &mut steep[..2], &mut bent[..1]].into_iter().enumerate() {
                line.down(grid, PER_PX * (part.top + r), part.left, &down[d]);
                for (out, across) in out.iter_mut().zip(&across) {
                    line.across(across, out.row_mut(r));
                }
            }
        }
        let ([value, along, xx], [steep, xy, _], [yy, ..]) = (flat, steep, bent);
        (Slopes { value, x: along, y: steep }, Curvatures { xx, xy, yy })
    }
}

/// Coefficients (2 rows + 7, 2 columns + 7) that continue the one-per-pixel spline of `image` (rows, columns).
pub fn refined(image: &Grid<f64>) -> Grid {
    let around = REACH + MARGIN / PER_PX + 2;
    // Mirrored as the spline itself is, so that the samples beyond the edge are the spline's own.
    let grid = coefficients(&image.mirrored(around)).map(|&c| c as f32);
    let (rows, columns) = (grid.rows - 2 * REACH, grid.columns - 2 * REACH);
    let mut samples = Grid::filled(PER_PX * rows, PER_PX * columns, 0.0f64);
    for j in 0..PER_PX {
        for i in 0..PER_PX {
            let [down, across] = [j, i].map(|k| weights(k as f64 / PER_PX as f64, 0));
            let read = combine(&grid, &down, &across);
            for r in 0..rows {
                let into = samples.row_mut(PER_PX * r + j)[i..].iter_mut().step_by(PER_PX);
                into.zip(read.row(r)).for_each(|(into, &value)| *into = f64::from(value));
            }
        }
    }
    let first = PER_PX * (around - REACH) - MARGIN;
    coefficients(&samples)
        .part(Part {
            top: first,
            bottom: first + PER_PX * image.rows + BEYOND,
            left: first,
            right: first + PER_PX * image.columns + BEYOND,
        })
        .map(|&c| c as f32)
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;

    vectorised! {
        fn spread(pixels: &Grid, down: &Taps, across: &Taps, out: &mut Fine) {
            spread_into(pixels, down, across, &mut Spreading::new(pixels.rows, pixels.columns), out);
        }
    }

    fn noise(rows: usize, columns: usize, seed: u32) -> Grid {
        let mut state = seed;
        let values = (0..rows * columns)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / 8_388_608.0 - 1.0
            })
            .collect();
        Grid { values, rows, columns }
    }

    fn product(one: &Grid, other: &Grid) -> f64 {
        one.values.iter().zip(&other.values).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
    }

    #[test]
    fn spreading_is_the_transpose_of_reading() {
        for (rows, columns, y, x) in [(9, 12, 0.2, -0.4), (16, 31, -0.6, 0.6), (12, 12, 0.0, 0.5), (12, 12, -0.5, -0.1)]
        {
            let (picture, grid) = (noise(rows, columns, 3), noise(2 * rows + BEYOND, 2 * columns + BEYOND, 5));
            let (down, across) = (Taps::new(y, 0), Taps::new(x, 1));
            let out = on_both(|| {
                let mut out = Fine::zeros(grid.rows, grid.columns);
                spread(&picture, &down, &across, &mut out);
                out.joined()
            });
            assert_eq!(Fine::of(&grid).joined(), grid);
            // ⟨A g, p⟩ = ⟨g, Aᵀ p⟩, in single precision.
            let (one, other) = (product(&out, &grid), product(&picture, &read(&Fine::of(&grid), &down, &across)));
            assert!((one - other).abs() < 1e-5 * product(&picture, &picture), "{one} {other}");
        }
    }

    #[test]
    fn the_weights_left_out_are_none() {
        for k in -24..=24 {
            for derivative in 0..3 {
                let shift = f64::from(k) / 40.0;
                let (all, taps) = (fine_weights(shift, derivative), Taps::new(shift, derivative));
                let kept: f64 = all[taps.first..taps.first + SUPPORT].iter().map(|weight| weight.abs()).sum();
                // Truncated powers leave rounding where the spline has ended.
                assert!((all.iter().map(|weight| weight.abs()).sum::<f64>() - kept).abs() < 1e-11);
            }
        }
    }

    #[test]
    fn a_wave_and_its_derivatives_are_read_between_the_pixels() {
        let (kx, ky) = (0.31, 0.23);
        let wave = |x: f64, y: f64| (kx * x + ky * y).sin();
        let mut image = Grid::filled(50, 60, 0.0);
        for r in 0..50 {
            for c in 0..60 {
                image.row_mut(r)[c] = wave(c as f64, r as f64);
            }
        }
        let (grid, x, y) = (refined(&image), 0.31, -0.42);
        assert_eq!((grid.rows, grid.columns), (2 * 50 + BEYOND, 2 * 60 + BEYOND));
        let part = Part { top: 16, bottom: 34, left: 17, right: 43 };
        let (seen, bent) = bends(&Fine::of(&grid), part, x, y);
        assert_eq!(seen.y, slopes(&Fine::of(&grid), part, x, y).y);
        for r in 0..part.rows() {
            for c in 0..part.columns() {
                let (at, up) = ((c + part.left) as f64 - x, (r + part.top) as f64 - y);
                let cosine = (kx * at + ky * up).cos();
                let expected =
                    [wave(at, up), kx * cosine, ky * cosine, -kx * kx * wave(at, up), -ky * ky * wave(at, up)];
                let got = [&seen.value, &seen.x, &seen.y, &bent.xx, &bent.yy].map(|grid| f64::from(grid.row(r)[c]));
                for (got, expected) in got.iter().zip(expected) {
                    // The spline of fifth order through samples 20 to a wave, and single precision.
                    assert!((got - expected).abs() < 3e-5, "{got} {expected}");
                }
            }
        }
    }
}
