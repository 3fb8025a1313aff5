//! Zero-mean normalised cross-correlation (ZNCC) of a template with every window of a patch, and the filters before it.

use super::grid::Grid;
use super::vectors::vectorised;

/// How many positions beside each other, and one below the other, are summed at once.
const ACROSS: usize = 8;
const DOWN: usize = 4;
/// Integral images leave rounding of about 1e-16 of the patch's whole energy where a window is constant.
const CONSTANT_SHARE: f64 = 1e-12;

/// Sum of squares about the mean of every window of `rows` by `columns` px, from integral images.
pub fn window_energies<T: Copy + Into<f64>>(patch: &Grid<T>, rows: usize, columns: usize) -> Grid<f64> {
    let (height, width) = (patch.rows, patch.columns);
    let mut total = Grid::filled(height + 1, width + 1, [0.0f64; 2]);
    for r in 0..height {
        let (mut line, mut square) = (0.0, 0.0);
        for c in 0..width {
            let value: f64 = patch.row(r)[c].into();
            line += value;
            square += value * value;
            let above = total.row(r)[c + 1];
            total.row_mut(r + 1)[c + 1] = [above[0] + line, above[1] + square];
        }
    }
    let mut out = Grid::filled(height - rows + 1, width - columns + 1, 0.0);
    for r in 0..out.rows {
        let (top, bottom) = (total.row(r), total.row(r + rows));
        for (c, out) in out.row_mut(r).iter_mut().enumerate() {
            let [first, second] =
                [0, 1].map(|k| bottom[c + columns][k] - top[c + columns][k] - bottom[c][k] + top[c][k]);
            *out = (second - first * first / (rows * columns) as f64).max(0.0);
        }
    }
    out
}

vectorised! {
    /// Sum of products of `template` with every window of `patch`; rows in single precision, their sum in double.
    pub fn products(patch: &Grid, template: &Grid) -> Grid<f64> {
        let (rows, columns) = (template.rows, template.columns);
        let mut out = Grid::filled(patch.rows - rows + 1, patch.columns - columns + 1, 0.0f64);
        // Positions beyond the last are summed too and left out.
        let mut wide = Grid::filled(patch.rows, patch.columns + ACROSS, 0.0);
        for r in 0..patch.rows {
            wide.row_mut(r)[..patch.columns].copy_from_slice(patch.row(r));
        }
        for y in (0..out.rows).step_by(DOWN) {
            let last = out.rows - 1 - y;
            for x in (0..out.columns).step_by(ACROSS) {
                for r in 0..rows {
                    let lines: [&[f32]; DOWN] =
                        std::array::from_fn(|k| &wide.row(y + k.min(last) + r)[x..x + columns + ACROSS - 1]);
                    let sums = beside(template.row(r), lines);
                    for (k, sums) in sums.iter().enumerate().take(last + 1) {
                        for (out, sum) in out.row_mut(y + k)[x..].iter_mut().zip(sums) {
                            *out += f64::from(*sum);
                        }
                    }
                }
            }
        }
        out
    }
}

/// Sums of the products of a `row` with so many windows of each of some lines.
#[inline(always)]
fn beside(row: &[f32], lines: [&[f32]; DOWN]) -> [[f32; ACROSS]; DOWN] {
    let mut sums = [[0.0f32; ACROSS]; DOWN];
    let lines = lines.map(|line| &line[..row.len() + ACROSS - 1]);
    for (c, &value) in row.iter().enumerate() {
        for k in 0..DOWN {
            let window = &lines[k][c..c + ACROSS];
            for i in 0..ACROSS {
                sums[k][i] += value * window[i];
            }
        }
    }
    sums
}

/// ZNCC (-1 to 1) of `template` at every whole-pixel position in `patch`: (rows - h + 1, columns - w + 1); 0 where a window
/// is constant.
///
/// `patch` is roughly free of its mean (single precision loses the difference otherwise); `template` (h, w) has zero mean.
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
        for r in 0..rows {
            line.fill(0.0);
            for (j, &tap) in taps.iter().enumerate() {
                line.iter_mut().zip(patch.row(r + j)).for_each(|(sum, value)| *sum += tap * value);
            }
            for (i, &tap) in taps.iter().enumerate() {
                out.row_mut(r).iter_mut().zip(&line[i..]).for_each(|(sum, value)| *sum += tap * value);
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
    use super::super::vectors::both_ways;
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
        let [map, portable] = both_ways(|| zncc_map(&patch, &template));
        assert_eq!(map, portable);
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
