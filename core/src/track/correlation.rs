//! Zero-mean normalised cross-correlation (ZNCC) of a template with every window of a patch, and the filters before it.

use super::grid::Grid;
use super::vector::{vectorised, weighted};

/// How many adjacent positions are summed at once.
const ACROSS: usize = 8;
/// Running sums leave rounding of about 1e-16 of the patch's whole energy where a window is constant.
const CONSTANT_SHARE: f64 = 1e-12;

/// A number of single or double precision.
pub trait Real: Copy + Into<f64> {}

impl Real for f32 {}
impl Real for f64 {}

vectorised! {
    /// Add a row, times a sign, to the sums of the values and of their squares in each column.
    fn add_row<T: Real>(row: &[T], sign: f64, sums: [&mut [f64]; 2]) {
        let [value, square] = sums;
        for ((value, square), &pixel) in value.iter_mut().zip(square).zip(row) {
            let pixel: f64 = pixel.into();
            *value += sign * pixel;
            *square += sign * pixel * pixel;
        }
    }
}

/// Sum of squares about the mean of every window of `rows` by `columns` px, from running sums.
pub fn window_energies<T: Real>(patch: &Grid<T>, rows: usize, columns: usize) -> Grid<f64> {
    let mut out = Grid::filled(patch.rows - rows + 1, patch.columns - columns + 1, 0.0);
    // Of each column over the rows of the window.
    let (mut value, mut square) = (vec![0.0f64; patch.columns], vec![0.0f64; patch.columns]);
    let add = |r: usize, sign: f64, value: &mut [f64], square: &mut [f64]| add_row(patch.row(r), sign, [value, square]);
    (0..rows).for_each(|r| add(r, 1.0, &mut value, &mut square));
    for y in 0..out.rows {
        if y > 0 {
            add(y + rows - 1, 1.0, &mut value, &mut square);
            add(y - 1, -1.0, &mut value, &mut square);
        }
        let (mut first, mut second) = (value[..columns].iter().sum::<f64>(), square[..columns].iter().sum::<f64>());
        for x in 0..out.columns {
            if x > 0 {
                first += value[x + columns - 1] - value[x - 1];
                second += square[x + columns - 1] - square[x - 1];
            }
            out.row_mut(y)[x] = (second - first * first / (rows * columns) as f64).max(0.0);
        }
    }
    out
}

/// Sum of products of `template` with every window of `patch`; rows in single precision, their sum in double.
pub fn products(patch: &Grid, template: &Grid) -> Grid<f64> {
    let mut out = Grid::filled(patch.rows - template.rows + 1, patch.columns - template.columns + 1, 0.0f64);
    // Positions beyond the last are summed too and left out.
    let mut wide = Grid::filled(patch.rows, patch.columns + ACROSS, 0.0);
    for r in 0..patch.rows {
        wide.row_mut(r)[..patch.columns].copy_from_slice(patch.row(r));
    }
    let mut y = 0;
    while y < out.rows {
        // As many rows of positions at once as the processor keeps sums of, or few.
        y += if out.rows - y > 4 {
            rows_of_products::<7>(&wide, template, y, &mut out)
        } else {
            rows_of_products::<4>(&wide, template, y, &mut out)
        };
    }
    out
}

/// Fill in the products of N rows of positions from the row `y` on, or as many as there are: how many.
fn rows_of_products<const N: usize>(wide: &Grid, template: &Grid, y: usize, out: &mut Grid<f64>) -> usize {
    let last = (out.rows - 1 - y).min(N - 1);
    for x in (0..out.columns).step_by(ACROSS) {
        for r in 0..template.rows {
            let end = x + template.columns + ACROSS - 1;
            let sums = adjacent::<N>(template.row(r), std::array::from_fn(|k| &wide.row(y + k.min(last) + r)[x..end]));
            for (k, sums) in sums.iter().enumerate().take(last + 1) {
                out.row_mut(y + k)[x..].iter_mut().zip(sums).for_each(|(out, sum)| *out += f64::from(*sum));
            }
        }
    }
    last + 1
}

/// Sums of the products of a `row` with eight windows of each of N lines, which are seven longer.
fn adjacent<const N: usize>(row: &[f32], lines: [&[f32]; N]) -> [[f32; ACROSS]; N] {
    let lines = lines.map(|line| &line[..row.len() + ACROSS - 1]);
    #[cfg(target_arch = "x86_64")]
    if super::vector::is_wide() {
        // SAFETY: the processor has AVX2, and each line holds eight values from each of the row's places on.
        return unsafe { adjacent_wide(row, lines) };
    }
    let mut sums = [[0.0f32; ACROSS]; N];
    for (c, &value) in row.iter().enumerate() {
        for (sums, line) in sums.iter_mut().zip(&lines) {
            sums.iter_mut().zip(&line[c..c + ACROSS]).for_each(|(sum, other)| *sum += value * other);
        }
    }
    sums
}

/// As [`adjacent`], by name: the compiler does not keep the lines apart, which makes it three times as slow.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn adjacent_wide<const N: usize>(row: &[f32], lines: [&[f32]; N]) -> [[f32; ACROSS]; N] {
    use std::arch::x86_64::{
        _mm256_add_ps, _mm256_loadu_ps, _mm256_mul_ps, _mm256_set1_ps, _mm256_setzero_ps, _mm256_storeu_ps,
    };

    let mut out = [[0.0f32; ACROSS]; N];
    // SAFETY: the caller's: AVX2, and `c + ACROSS` is at most each line's length; `out` holds eight values each.
    unsafe {
        let mut sums = [_mm256_setzero_ps(); N];
        for (c, &value) in row.iter().enumerate() {
            let value = _mm256_set1_ps(value);
            for (sum, line) in sums.iter_mut().zip(&lines) {
                *sum = _mm256_add_ps(*sum, _mm256_mul_ps(value, _mm256_loadu_ps(line.as_ptr().add(c))));
            }
        }
        out.iter_mut().zip(sums).for_each(|(out, sum)| _mm256_storeu_ps(out.as_mut_ptr(), sum));
    }
    out
}

/// ZNCC (-1 to 1) of `template` at every whole-pixel position in `patch`: (rows - h + 1, columns - w + 1); 0 where a
/// window is constant.
///
/// `patch` is roughly free of its mean (single precision loses the difference otherwise); `template` (h, w) has zero
/// mean.
pub fn zncc_map(patch: &Grid, template: &Grid) -> Grid<f64> {
    let norm: f64 = template.values.iter().map(|&value| f64::from(value) * f64::from(value)).sum();
    let energy = window_energies(patch, template.rows, template.columns);
    let mut out = products(patch, template);
    let constant = CONSTANT_SHARE * (energy.values.iter().copied().fold(0.0, f64::max) + 1e-30);
    for (out, &energy) in out.values.iter_mut().zip(&energy.values) {
        *out = if energy > constant && energy * norm > 0.0 { *out / (energy * norm).sqrt() } else { 0.0 };
    }
    out
}

vectorised! {
    /// Filter `patch` along both axes with the symmetric `taps` (2 m + 1,); the result loses m px on every side.
    pub fn smooth(patch: &Grid, taps: &[f32]) -> Grid {
        let lost = taps.len() - 1;
        let (rows, columns) = (patch.rows.saturating_sub(lost), patch.columns.saturating_sub(lost));
        let (mut out, mut line) = (Grid::filled(rows, columns, 0.0), vec![0.0f32; patch.columns]);
        if out.values.is_empty() {
            return out;
        }
        if let Ok(taps) = <[f32; 5]>::try_from(taps) {
            for r in 0..rows {
                weighted::<5, false>(std::array::from_fn(|j| patch.row(r + j)), taps, &mut line);
                weighted::<5, false>(std::array::from_fn(|i| &line[i..]), taps, out.row_mut(r));
            }
            return out;
        }
        for r in 0..rows {
            line.fill(0.0);
            for (j, &tap) in taps.iter().enumerate() {
                for (sum, value) in line.iter_mut().zip(patch.row(r + j)) {
                    *sum += tap * value;
                }
            }
            for (i, &tap) in taps.iter().enumerate() {
                for (sum, value) in out.row_mut(r).iter_mut().zip(&line[i..]) {
                    *sum += tap * value;
                }
            }
        }
        out
    }
}

/// Means of the blocks of `factor` by `factor` px; what does not fill a block is left out.
pub fn shrink(patch: &Grid, factor: usize) -> Grid {
    let mut out = Grid::filled(patch.rows / factor, patch.columns / factor, 0.0f32);
    let share = (1.0 / (factor * factor) as f64) as f32;
    for r in 0..out.rows * factor {
        let blocks = patch.row(r).chunks_exact(factor);
        for (out, block) in out.row_mut(r / factor).iter_mut().zip(blocks) {
            block.iter().for_each(|value| *out += share * value);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;

    fn texture(rows: usize, columns: usize) -> Grid {
        let values = (0..rows * columns).map(|k| (1.7 * k as f32).sin() + (0.01 * (k * k) as f32).cos()).collect();
        Grid { values, rows, columns }
    }

    fn centred(grid: &Grid) -> Grid {
        let mean = grid.values.iter().sum::<f32>() / grid.values.len() as f32;
        grid.map(|value| value - mean)
    }

    #[test]
    fn the_map_is_one_where_the_template_was_cut_and_zero_where_nothing_varies() {
        let mut patch = texture(41, 38);
        (0..41).for_each(|r| patch.row_mut(r)[30..].fill(0.5));
        let part = super::super::grid::Part { top: 13, bottom: 27, left: 5, right: 12 };
        let template = centred(&patch.part(part));
        let map = on_both(|| zncc_map(&patch, &template));
        assert_eq!((map.rows, map.columns), (28, 32));
        assert!((map.row(13)[5] - 1.0).abs() < 1e-6);
        assert!(map.values.iter().all(|value| value.abs() < 1.0 + 1e-6));
        assert!((0..28).all(|r| map.row(r)[30..].iter().all(|&value| value == 0.0)));
    }

    #[test]
    fn products_are_those_of_each_window() {
        let (patch, template) = (texture(14, 23), texture(5, 6));
        let found = products(&patch, &template);
        for y in 0..found.rows {
            for x in 0..found.columns {
                let expected: f64 = (0..5)
                    .flat_map(|r| (0..6).map(move |c| (r, c)))
                    .map(|(r, c)| f64::from(patch.row(y + r)[x + c]) * f64::from(template.row(r)[c]))
                    .sum();
                assert!((found.row(y)[x] - expected).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn smoothing_and_shrinking_keep_a_constant() {
        let flat = Grid::filled(13, 11, 2.0f32);
        assert_eq!(smooth(&flat, &[0.25, 0.5, 0.25]), Grid::filled(11, 9, 2.0));
        assert_eq!(shrink(&flat, 2), Grid::filled(6, 5, 2.0));
    }
}
