//! Pictures of one target under several lights: where a mix of them holds, and how they lie to each other.
//!
//! A picture that lies wrong adds dimensions to what the pictures span. The places are those at which log det of the
//! pictures' products is least (rank instead of log det: Y. Peng and others, "RASL", 2012, doi 10.1109/TPAMI.2011.282).

use super::grid::Grid;

/// Of the mean contrast: what a block without texture may differ by.
const FLAT: f64 = 0.1;
/// A picture is moved by no more at once, px.
const MAX_MOVE_PX: f64 = 0.3;
const SETTLED_PX: f64 = 1e-4;

/// Sums over the pixels of a cell.
#[derive(Clone, Copy, Default)]
struct Sums {
    count: f64,
    seen: [f64; 2],
    expected: [f64; 2],
    left: [f64; 2],
}

/// How well what is expected is `seen` (`left`: the difference) in each of this many cells: 1 alike, 0 unrelated or one
/// of them without contrast, which is what a thing in front leaves; the level is free. None where a pixel's cell is
/// none.
///
/// For cells of equal contrast this is their correlation. Cells without texture agree while nothing is seen in them.
pub fn agreement(seen: &[f32], left: &[f32], cell: &[i64], cells: usize) -> Option<Vec<f64>> {
    let mut sums = vec![Sums::default(); cells];
    for ((&seen, &left), &cell) in seen.iter().zip(left).zip(cell) {
        let sums = sums.get_mut(usize::try_from(cell).ok()?)?;
        let (seen, left) = (f64::from(seen), f64::from(left));
        let expected = seen - left;
        sums.count += 1.0;
        for (sum, value) in [(&mut sums.seen, seen), (&mut sums.expected, expected), (&mut sums.left, left)] {
            sum[0] += value;
            sum[1] += value * value;
        }
    }
    let energy = |sum: [f64; 2], count: f64| (sum[1] - sum[0] * sum[0] / count) / count;
    let energies: Vec<[f64; 3]> =
        sums.iter().map(|one| [one.seen, one.expected, one.left].map(|sum| energy(sum, one.count.max(1.0)))).collect();
    let mut rest: Vec<f64> = energies.iter().map(|energy| energy[2]).collect();
    rest.sort_unstable_by(f64::total_cmp);
    // What even the better cells are off by is noise.
    let contrast = energies.iter().map(|energy| energy[1]).sum::<f64>() / cells as f64;
    let floor = 2.0 * (FLAT * contrast + 2.0 * rest.get(cells / 8)?) + 1e-12;
    Some(energies.iter().map(|[seen, expected, left]| 1.0 - left / (seen + expected + floor)).collect())
}

/// Moves of least log det from `products` (3 n, 3 n) of n pictures and their slopes along x and y, from `moves` on.
///
/// Log det is concave: a weighted sum of squares with the inverse as weights lies above it and touches it, and each
/// round goes to that sum's least. `trust`: standard deviation of a mix that pictures leave open, as a share of their
/// contrast. None where the pictures do not determine their places, or the shapes differ.
pub fn least(products: &Grid<f64>, moves: &[[f64; 2]], rounds: usize, trust: f64) -> Option<Vec<[f64; 2]>> {
    let (n, mut moves) = (moves.len(), moves.to_vec());
    if n < 2 || products.rows != 3 * n || products.columns != 3 * n {
        return (n < 2).then_some(moves);
    }
    for _ in 0..rounds {
        // Products of all with the moved pictures, and of these with each other.
        let mut moved = Grid::filled(3 * n, n, 0.0);
        for r in 0..3 * n {
            let row = products.row(r);
            for (i, [x, y]) in moves.iter().enumerate() {
                moved.row_mut(r)[i] = row[i] + x * row[n + i] + y * row[2 * n + i];
            }
        }
        let mut shared = Grid::filled(n, n, 0.0);
        let mut weight = Grid::filled(n, n, 0.0);
        for (i, [x, y]) in moves.iter().enumerate() {
            for j in 0..n {
                let row = moved.row(i)[j] + x * moved.row(n + i)[j] + y * moved.row(2 * n + i)[j];
                shared.row_mut(i)[j] = row + if i == j { trust * trust } else { 0.0 };
            }
            weight.row_mut(i)[i] = 1.0;
        }
        solve(&mut shared, &mut weight)?;
        // Unknowns: along x, then along y, of all pictures but the first.
        let place = |a: usize| (a % (n - 1) + 1, n * (1 + a / (n - 1)));
        let unknown = 2 * (n - 1);
        let (mut curve, mut pull) = (Grid::filled(unknown, unknown, 0.0), Grid::filled(unknown, 1, 0.0));
        for a in 0..unknown {
            let (i, row) = place(a);
            for b in 0..unknown {
                let (j, column) = place(b);
                curve.row_mut(a)[b] = weight.row(i)[j] * products.row(row + i)[column + j];
            }
            pull.values[a] = (0..n).map(|j| weight.row(i)[j] * moved.row(row + i)[j]).sum();
        }
        solve(&mut curve, &mut pull)?;
        for (a, step) in pull.values.iter().enumerate() {
            let (i, axis) = (a % (n - 1) + 1, a / (n - 1));
            moves[i][axis] = (moves[i][axis] - step).clamp(-MAX_MOVE_PX, MAX_MOVE_PX);
        }
        if pull.values.iter().all(|step| step.abs() < SETTLED_PX) {
            break;
        }
    }
    Some(moves)
}

/// Turns `right` (n, m) into the solution of `matrix` (n, n) by elimination with pivots; None where that is singular.
fn solve(matrix: &mut Grid<f64>, right: &mut Grid<f64>) -> Option<()> {
    let n = matrix.rows;
    for k in 0..n {
        let largest = |best: usize, i: usize| if matrix.row(i)[k].abs() > matrix.row(best)[k].abs() { i } else { best };
        let best = (k + 1..n).fold(k, largest);
        let pivot = matrix.row(best)[k];
        if !(pivot.abs() > 0.0 && pivot.is_finite()) {
            return None;
        }
        for grid in [&mut *matrix, &mut *right] {
            for c in 0..grid.columns {
                grid.values.swap(k * grid.columns + c, best * grid.columns + c);
            }
        }
        for i in (0..n).filter(|i| *i != k) {
            let factor = matrix.row(i)[k] / pivot;
            for grid in [&mut *matrix, &mut *right] {
                for c in 0..grid.columns {
                    let of = grid.row(k)[c];
                    grid.row_mut(i)[c] -= factor * of;
                }
            }
        }
    }
    for k in 0..n {
        let pivot = matrix.row(k)[k];
        right.row_mut(k).iter_mut().for_each(|value| *value /= pivot);
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_agree_where_what_is_expected_is_seen() {
        let expected: Vec<f32> = (0..900).map(|k| 10.0 * (1.7 * k as f32).sin()).collect();
        let cell: Vec<i64> = (0..900).map(|k| k / 100).collect();
        let mut seen = expected.clone();
        seen[300..400].fill(7.0);
        seen[500..600].iter_mut().for_each(|value| *value += 50.0);
        let left: Vec<f32> = seen.iter().zip(&expected).map(|(a, b)| a - b).collect();
        let agreed = agreement(&seen, &left, &cell, 9).unwrap();
        // A fifth of the contrast is forgiven: of a flat cell 1 - 1 / 1.2 is left; the level is free.
        assert!((agreed[3] - (1.0 - 1.0 / 1.2)).abs() < 0.02 && agreed[5] > 0.999 && agreed[0] > 0.999);
        assert!(agreement(&seen, &left, &cell, 8).is_none());
    }

    #[test]
    fn elimination_solves_with_pivots() {
        let mut matrix = Grid { values: vec![0.0, 2.0, 1.0, 3.0, 1.0, 0.0, 1.0, 1.0, 1.0], rows: 3, columns: 3 };
        // Times (1, 2, 3).
        let mut right = Grid { values: vec![7.0, 5.0, 6.0], rows: 3, columns: 1 };
        solve(&mut matrix, &mut right).unwrap();
        for (got, expected) in right.values.iter().zip([1.0, 2.0, 3.0]) {
            assert!((got - expected).abs() < 1e-12);
        }
        assert!(solve(&mut Grid::filled(2, 2, 1.0), &mut Grid::filled(2, 1, 1.0)).is_none());
    }

    #[test]
    fn a_picture_that_was_moved_is_put_back() {
        let picture = |shift: f64, k: usize| {
            let x = 0.05 * k as f64;
            [(x - shift).sin() + (2.3 * x).cos(), -(x - shift).cos() + 2.3 * (2.3 * x).sin()]
        };
        // Two pictures of one dimension: of the second, moved, value and slope along x; along y another texture.
        let columns: Vec<[f64; 6]> = (0..2000)
            .map(|k| {
                let ([a, slope_a], y) = (picture(0.0, k), (0.31 * k as f64).sin());
                [a, a + 0.1 * slope_a, slope_a, slope_a, y, y]
            })
            .collect();
        let product = |i: usize, j: usize| columns.iter().map(|row| row[i] * row[j]).sum::<f64>() / 2000.0;
        let values = (0..36).map(|k| product(k / 6, k % 6)).collect();
        let found = least(&Grid { values, rows: 6, columns: 6 }, &[[0.0; 2]; 2], 40, 0.05).unwrap();
        assert!((found[1][0] + 0.1).abs() < 1e-3 && found[1][1].abs() < 1e-3, "{found:?}");
    }
}
