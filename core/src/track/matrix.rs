//! Small matrices, and medians.

/// A matrix of N rows and columns.
pub type Matrix<const N: usize> = [[f64; N]; N];

/// The inverse of a symmetric positive matrix, which needs no pivots; not finite where it is singular.
pub fn inverse<const N: usize>(matrix: &Matrix<N>) -> Matrix<N> {
    let mut out = *matrix;
    for k in 0..N {
        let pivot = 1.0 / out[k][k];
        out[k][k] = 1.0;
        out[k].iter_mut().for_each(|value| *value *= pivot);
        let row = out[k];
        for (i, other) in out.iter_mut().enumerate().filter(|(i, _)| *i != k) {
            debug_assert_ne!(i, k);
            let factor = other[k];
            other[k] = 0.0;
            other.iter_mut().zip(row).for_each(|(value, of)| *value -= factor * of);
        }
    }
    out
}

/// The inverse by elimination with pivots on scaled rows; None where a pivot is less than so much of its row.
pub fn inverse_with_pivots<const N: usize>(matrix: &Matrix<N>, least: f64) -> Option<Matrix<N>> {
    let (mut left, mut right) = (*matrix, [[0.0; N]; N]);
    for i in 0..N {
        let largest = left[i].iter().fold(0.0f64, |most, value| most.max(value.abs()));
        if !(largest > 0.0 && largest.is_finite()) {
            return None;
        }
        left[i].iter_mut().for_each(|value| *value /= largest);
        right[i][i] = 1.0 / largest;
    }
    for k in 0..N {
        let best = (k..N).fold(k, |best, i| if left[i][k].abs() > left[best][k].abs() { i } else { best });
        if left[best][k].abs() < least {
            return None;
        }
        left.swap(k, best);
        right.swap(k, best);
        let pivot = 1.0 / left[k][k];
        left[k].iter_mut().chain(right[k].iter_mut()).for_each(|value| *value *= pivot);
        let (row, of_right) = (left[k], right[k]);
        for i in (0..N).filter(|i| *i != k) {
            let factor = left[i][k];
            left[i].iter_mut().zip(row).for_each(|(value, of)| *value -= factor * of);
            right[i].iter_mut().zip(of_right).for_each(|(value, of)| *value -= factor * of);
        }
    }
    Some(right)
}

/// Their product.
pub fn times<const N: usize>(matrix: &Matrix<N>, vector: &[f64; N]) -> [f64; N] {
    matrix.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum())
}

/// The sum of two matrices, the first times a factor.
pub fn scaled_sum<const N: usize>(one: &Matrix<N>, factor: f64, other: &Matrix<N>) -> Matrix<N> {
    std::array::from_fn(|i| std::array::from_fn(|j| factor * one[i][j] + other[i][j]))
}

/// The median, of two middle values their mean; NaN of nothing.
pub fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

/// The median, of two middle values the lower; 0 of nothing.
pub fn lower_median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    values.sort_unstable_by(f64::total_cmp);
    values[(values.len() - 1) / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_inverses_are_that_of_a_positive_matrix() {
        let matrix = [[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];
        let (plain, pivoted) = (inverse(&matrix), inverse_with_pivots(&matrix, 1e-9).unwrap());
        for i in 0..3 {
            for j in 0..3 {
                let product: f64 = (0..3).map(|k| matrix[i][k] * plain[k][j]).sum();
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-14);
                assert!((plain[i][j] - pivoted[i][j]).abs() < 1e-14);
            }
        }
        assert!(inverse_with_pivots(&[[1.0, 2.0], [2.0, 4.0]], 1e-9).is_none());
        assert_eq!((median(&mut [3.0, 1.0, 2.0, 9.0]), lower_median(&mut [3.0, 1.0, 2.0, 9.0])), (2.5, 2.0));
    }
}
