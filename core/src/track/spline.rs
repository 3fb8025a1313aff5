//! Quintic B-splines on the pixel grid: weights, coefficients, interpolation (Unser, 1999, doi 10.1109/79.799930).

use super::grid::Grid;
use super::vector::{vectorised, weighted};

/// The quintic B-spline reaches 3 px to either side; a shift of up to 1 px needs the coefficients at -3 … 3.
pub const REACH: usize = 3;
/// How many coefficients that are.
pub const TAPS: usize = 2 * REACH + 1;
/// Poles of the filter from values to coefficients.
const POLES: [f64; 2] = [-0.430_575_347_099_973_8, -0.043_096_288_203_264_65];

/// Quintic B-spline at `x` (px from its centre), or its first or second derivative, from truncated powers.
pub fn quintic(x: f64, derivative: usize) -> f64 {
    let (mut total, mut binomial) = (0.0, 1.0);
    for k in 0..7 {
        let base = x + 3.0 - f64::from(k);
        if base > 0.0 {
            total += binomial * base.powi(5 - derivative as i32);
        }
        binomial *= -(6.0 - f64::from(k)) / f64::from(k + 1);
    }
    total / [120.0, 24.0, 6.0][derivative]
}

/// Weights of the coefficients at -3 … 3 px for a point at `shift` (-1 to 1 px), or their derivative by it.
pub fn weights(shift: f64, derivative: usize) -> [f64; TAPS] {
    let sign = if derivative == 1 { -1.0 } else { 1.0 };
    std::array::from_fn(|j| sign * quintic(j as f64 - REACH as f64 - shift, derivative))
}

/// Coefficients of the quintic spline through `image`, mirrored at its edges.
pub fn coefficients(image: &Grid<f64>) -> Grid<f64> {
    let mut across = image.transposed();
    filtered_down(&mut across);
    let mut out = across.transposed();
    filtered_down(&mut out);
    out
}

/// Turn each column from values into coefficients: the inverse of sampling, one recursion down and one up for each
/// pole.
fn filtered_down(grid: &mut Grid<f64>) {
    let (n, columns) = (grid.rows, grid.columns);
    if n < 2 {
        return;
    }
    let gain: f64 = POLES.iter().map(|z| (1.0 - z) * (1.0 - 1.0 / z)).product();
    grid.values.iter_mut().for_each(|value| *value *= gain);
    for z in POLES {
        // The first value sums the mirrored signal, which has the period 2 n - 2.
        let last = z.powi(n as i32 - 1);
        let mut first: Vec<f64> = (0..columns).map(|c| grid.row(0)[c] + last * grid.row(n - 1)[c]).collect();
        let mut power = z;
        for i in 1..n - 1 {
            let (near, far) = (grid.row(i), grid.row(n - 1 - i));
            for c in 0..columns {
                first[c] += power * (near[c] + last * far[c]);
            }
            power *= z;
        }
        for (value, first) in grid.row_mut(0).iter_mut().zip(&first) {
            *value = first / (1.0 - last * last);
        }
        for i in 1..n {
            let (before, here) = grid.values[(i - 1) * columns..].split_at_mut(columns);
            here[..columns].iter_mut().zip(before.iter()).for_each(|(here, before)| *here += z * *before);
        }
        let (before, end) = grid.values[(n - 2) * columns..].split_at_mut(columns);
        end.iter_mut().zip(before.iter()).for_each(|(end, before)| *end = (z * *before + *end) * z / (z * z - 1.0));
        for i in (0..n - 1).rev() {
            let (here, after) = grid.values[i * columns..].split_at_mut(columns);
            here.iter_mut().zip(after.iter()).for_each(|(here, after)| *here = z * (*after - *here));
        }
    }
}

vectorised! {
    /// Filter `grid` (rows + 6, columns + 6) with weights `down` and `across`: (rows, columns).
    pub fn combine(grid: &Grid, down: &[f64; TAPS], across: &[f64; TAPS]) -> Grid {
        let (rows, columns) = (grid.rows.saturating_sub(2 * REACH), grid.columns.saturating_sub(2 * REACH));
        let (down, across) = (down.map(|w| w as f32), across.map(|w| w as f32));
        let (mut out, mut line) = (Grid::filled(rows, columns, 0.0), vec![0.0; grid.columns]);
        for r in 0..rows {
            weighted::<TAPS, false>(std::array::from_fn(|j| grid.row(r + j)), down, &mut line);
            weighted::<TAPS, false>(std::array::from_fn(|i| &line[i..]), across, out.row_mut(r));
        }
        out
    }
}

/// The spline image moved by x to the right and y down (-1 to 1 px): value at k is the spline at k - (x, y).
///
/// `grid` holds the coefficients with 3 px more on every side than the result.
pub fn translated(grid: &Grid, x: f64, y: f64) -> Grid {
    combine(grid, &weights(-y, 0), &weights(-x, 0))
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;
    use proptest::prelude::*;

    fn image(rows: usize, columns: usize) -> Grid<f64> {
        let values =
            (0..rows * columns).map(|k| 40.0 * (0.37 * k as f64).sin() + 20.0 * (1.3 * k as f64).cos()).collect();
        Grid { values, rows, columns }
    }

    proptest! {
        #[test]
        fn weights_sum_to_one_and_their_derivatives_to_nothing(shift in -1.0..1.0f64) {
            // Truncated powers cancel terms of up to 65.
            prop_assert!((weights(shift, 0).iter().sum::<f64>() - 1.0).abs() < 1e-12);
            prop_assert!(weights(shift, 1).iter().sum::<f64>().abs() < 1e-12);
            prop_assert!(weights(shift, 2).iter().sum::<f64>().abs() < 1e-12);
        }
    }

    #[test]
    fn the_spline_goes_through_the_values_it_is_made_from() {
        let image = image(31, 40);
        let grid = coefficients(&image).map(|&c| c as f32);
        let usual = on_both(|| translated(&grid, 0.0, 0.0));
        for r in 0..usual.rows {
            for c in 0..usual.columns {
                // Coefficients of up to some 300 in single precision carry 2e-5 each.
                let (got, expected) = (f64::from(usual.row(r)[c]), image.row(r + REACH)[c + REACH]);
                assert!((got - expected).abs() < 1e-3, "{got} {expected}");
            }
        }
    }
}
