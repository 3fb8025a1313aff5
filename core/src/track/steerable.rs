//! Local phase: the responses of steerable quadrature filters along x or y (Freeman and Adelson, 1991, tables III and
//! V, doi 10.1109/34.93808).
//!
//! The filters are separable: nine taps along the axis, even (second derivative of a Gaussian) or odd (its Hilbert
//! transform), and the Gaussian across it. Even taps are symmetric and odd ones antisymmetric, so that neighbours at
//! equal distances are added or subtracted first.

use super::image::Image;
use super::vector::vectorised;

/// Taps of a filter.
pub const TAPS: usize = 9;
/// Taps on either side of the middle one.
pub const MARGIN_PX: usize = TAPS / 2;

/// The filters' taps from the middle one on.
#[derive(Clone, Copy, Debug)]
pub struct Taps {
    /// Of the even filter.
    pub even: [f32; MARGIN_PX + 1],
    /// Of the odd filter, whose middle tap is 0.
    pub odd: [f32; MARGIN_PX + 1],
    /// Of the Gaussian across both.
    pub across: [f32; MARGIN_PX + 1],
}

/// The axis of an image that a filter lies along.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Axis {
    /// To the right.
    X,
    /// Down.
    Y,
}

/// Both responses of a patch, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Responses {
    /// Of the even filter.
    pub even: Vec<f32>,
    /// Of the odd filter.
    pub odd: Vec<f32>,
}

vectorised! {
/// The responses of a patch with `MARGIN_PX` more than they have on every side; none of a patch that is smaller.
pub fn responses(patch: &Image<'_, f32>, axis: Axis, taps: &Taps) -> Responses {
    let (Some(rows), Some(columns)) =
        (patch.rows.checked_sub(2 * MARGIN_PX), patch.columns.checked_sub(2 * MARGIN_PX))
    else {
        return Responses::default();
    };
    let mut found = Responses { even: vec![0.0; rows * columns], odd: vec![0.0; rows * columns] };
    let (mut line, mut other) = (vec![0.0; patch.columns], vec![0.0; patch.columns]);
    for (r, (even, odd)) in
        found.even.chunks_exact_mut(columns.max(1)).zip(found.odd.chunks_exact_mut(columns.max(1))).enumerate()
    {
        match axis {
            Axis::X => {
                down(patch, r, &taps.across, 1.0, &mut line);
                along(&line, &taps.even, even);
                along_odd(&line, &taps.odd, odd);
            }
            Axis::Y => {
                down(patch, r, &taps.even, 1.0, &mut line);
                down(patch, r, &taps.odd, -1.0, &mut other);
                along(&line, &taps.across, even);
                along(&other, &taps.across, odd);
            }
        }
    }
    found
}
}

/// Columns of nine rows from `row` on, filtered; `sign` is 1 of symmetric taps and -1 of antisymmetric ones.
#[inline(always)]
fn down(patch: &Image<'_, f32>, row: usize, taps: &[f32; MARGIN_PX + 1], sign: f32, line: &mut [f32]) {
    for (sum, value) in line.iter_mut().zip(patch.row(row + MARGIN_PX)) {
        *sum = taps[0] * value;
    }
    for (k, tap) in taps.iter().enumerate().skip(1) {
        let (above, below) = (patch.row(row + MARGIN_PX - k), patch.row(row + MARGIN_PX + k));
        for ((sum, above), below) in line.iter_mut().zip(above).zip(below) {
            *sum += tap * (below + sign * above);
        }
    }
}

/// A line filtered with symmetric taps.
#[inline(always)]
fn along(line: &[f32], taps: &[f32; MARGIN_PX + 1], out: &mut [f32]) {
    for (out, near) in out.iter_mut().zip(line.windows(TAPS)) {
        let pair = |k: usize| taps[k] * (near[MARGIN_PX + k] + near[MARGIN_PX - k]);
        *out = (taps[0] * near[MARGIN_PX] + pair(1)) + (pair(2) + (pair(3) + pair(4)));
    }
}

/// A line filtered with antisymmetric taps.
#[inline(always)]
fn along_odd(line: &[f32], taps: &[f32; MARGIN_PX + 1], out: &mut [f32]) {
    for (out, near) in out.iter_mut().zip(line.windows(TAPS)) {
        let pair = |k: usize| taps[k] * (near[MARGIN_PX + k] - near[MARGIN_PX - k]);
        *out = pair(1) + (pair(2) + (pair(3) + pair(4)));
    }
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;

    #[test]
    fn responses_are_plain_correlations_with_the_filters() {
        let taps = Taps {
            even: [0.9, 0.1, -0.4, -0.2, -0.01],
            odd: [0.0, -0.75, -0.1, 0.3, 0.05],
            across: [1.0, 0.6, 0.2, 0.02, 0.001],
        };
        let pixels: Vec<f32> = (0..20 * 31).map(|k| ((k * 37 % 101) as f32 - 50.0) * 0.5).collect();
        let patch = Image::new(&pixels, 20, 31, 31).unwrap();
        let at = |half: &[f32; 5], k: i32, sign: f32| if k < 0 { sign * half[-k as usize] } else { half[k as usize] };
        for axis in [Axis::X, Axis::Y] {
            let found = on_both(|| responses(&patch, axis, &taps));
            for r in 0..12usize {
                for c in 0..23usize {
                    let (mut even, mut odd) = (0f64, 0f64);
                    for i in -4i32..=4 {
                        for j in -4i32..=4 {
                            let pixel = pixels[(r as i32 + 4 + i) as usize * 31 + (c as i32 + 4 + j) as usize];
                            let (along, across) = if axis == Axis::X { (j, i) } else { (i, j) };
                            let weight = f64::from(at(&taps.across, across, 1.0) * pixel);
                            even += weight * f64::from(at(&taps.even, along, 1.0));
                            odd += weight * f64::from(at(&taps.odd, along, -1.0));
                        }
                    }
                    // Single precision of sums up to some 100.
                    assert!((f64::from(found.even[r * 23 + c]) - even).abs() < 2e-4);
                    assert!((f64::from(found.odd[r * 23 + c]) - odd).abs() < 2e-4);
                }
            }
        }
        assert_eq!(responses(&Image::new(&pixels, 7, 31, 31).unwrap(), Axis::X, &taps), Responses::default());
    }
}
