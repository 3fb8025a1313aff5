//! Loops over pixels, compiled twice: for any processor, and for one with AVX2 where there is one.
//!
//! Both are the same code. Sums run in [`LANES`] partial sums whatever the processor, and no product is fused with a
//! sum, so that the results are equal bit for bit.

use super::image::{Level, Pixel};
use std::array::from_fn;

/// A function compiled for any processor and for AVX2; which of the two runs is decided when it is called.
///
/// The work is to be done in loops: what an iterator collects may stay a function of its own, compiled for any
/// processor.
macro_rules! vectorised {
    ($(#[$doc:meta])* $vis:vis fn $name:ident $(<$T:ident : $bound:path>)? ($($arg:ident : $ty:ty),* $(,)?)
     $(-> $out:ty)? $body:block) => {
        $(#[$doc])*
        $vis fn $name $(<$T: $bound>)? ($($arg: $ty),*) $(-> $out)? {
            #[inline(always)]
            fn portable $(<$T: $bound>)? ($($arg: $ty),*) $(-> $out)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            unsafe fn wide $(<$T: $bound>)? ($($arg: $ty),*) $(-> $out)? {
                portable($($arg),*)
            }
            #[cfg(target_arch = "x86_64")]
            if $crate::track::vector::is_wide() {
                // SAFETY: the processor has AVX2, as has just been asked; there is no other condition.
                return unsafe { wide($($arg),*) };
            }
            portable($($arg),*)
        }
    };
}
pub(crate) use vectorised;

/// Partial sums that a long sum of numbers that are not whole runs in: column c belongs to lane c mod 4.
pub const LANES: usize = 4;
// 32 bits hold the squares of 8 bits of this number of columns: 32768 · 255² < 2³¹.
const PART: usize = 32768;

/// Sums (N,) over the columns of rows of equal length of what `term` makes of a pixel of each.
///
/// Sums of whole numbers are exact in whatever order they are taken, which leaves it to the compiler.
#[inline(always)]
pub fn sums<T: Pixel, const I: usize, const N: usize>(
    rows: [&[T]; I],
    term: impl Fn([T::Level; I]) -> [T::Level; N],
) -> [f64; N] {
    let count = rows[0].len();
    let rows = rows.map(|row| &row[..count]);
    if T::Level::WHOLE {
        let mut total = [0.0; N];
        for begin in (0..count).step_by(PART) {
            let mut sum = [T::Level::default(); N];
            // Each of the rows has an element `c`.
            #[allow(clippy::needless_range_loop)]
            for c in begin..count.min(begin + PART) {
                let terms = term(from_fn(|i| rows[i][c].level()));
                for n in 0..N {
                    sum[n] = sum[n] + terms[n];
                }
            }
            total = from_fn(|n| total[n] + sum[n].number());
        }
        return total;
    }
    let mut lanes = [[T::Level::default(); N]; LANES];
    for c in 0..count {
        let terms = term(from_fn(|i| rows[i][c].level()));
        let lane = &mut lanes[c % LANES];
        for n in 0..N {
            lane[n] = lane[n] + terms[n];
        }
    }
    from_fn(|n| (lanes[0][n].number() + lanes[1][n].number()) + (lanes[2][n].number() + lanes[3][n].number()))
}

/// Partial sums of `sum_f64` and `dot_f64`.
const DOUBLE_LANES: usize = 8;

vectorised! {
/// The sum of the products of single precision numbers, in double precision.
pub fn dot_f64(one: &[f32], other: &[f32]) -> f64 {
    let mut lanes = [0.0; DOUBLE_LANES];
    let (one_parts, other_parts) = (one.chunks_exact(DOUBLE_LANES), other.chunks_exact(DOUBLE_LANES));
    let rest = one_parts.remainder().iter().zip(other_parts.remainder());
    for (one, other) in one_parts.zip(other_parts) {
        for (lane, (a, b)) in lanes.iter_mut().zip(one.iter().zip(other)) {
            *lane += f64::from(a * b);
        }
    }
    for (lane, (a, b)) in lanes.iter_mut().zip(rest) {
        *lane += f64::from(a * b);
    }
    lane_sum(lanes)
}
}

vectorised! {
/// The sum of single precision numbers, in double precision.
pub fn sum_f64(values: &[f32]) -> f64 {
    let mut lanes = [0.0; DOUBLE_LANES];
    let parts = values.chunks_exact(DOUBLE_LANES);
    let rest = parts.remainder();
    for part in parts {
        for (lane, &value) in lanes.iter_mut().zip(part) {
            *lane += f64::from(value);
        }
    }
    for (lane, &value) in lanes.iter_mut().zip(rest) {
        *lane += f64::from(value);
    }
    lane_sum(lanes)
}
}

#[inline(always)]
fn lane_sum(lanes: [f64; DOUBLE_LANES]) -> f64 {
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + b) + (c + d)) + ((e + f) + (g + h))
}

/// How many single precision numbers a sum takes at once.
pub const WIDE_LANES: usize = 16;

/// The lanes' sum, in pairs.
#[inline(always)]
pub fn gathered<const N: usize>(mut lanes: [f32; N]) -> f32 {
    let mut half = N / 2;
    while half > 0 {
        for k in 0..half {
            lanes[k] += lanes[k + half];
        }
        half /= 2;
    }
    lanes[0]
}

/// Sum of the products of two equally long slices.
#[inline(always)]
pub fn dot<T: Copy>(one: &[T], other: &[f32]) -> f32
where
    f32: From<T>,
{
    let mut lanes = [0.0f32; WIDE_LANES];
    let (blocks, others) = (one.chunks_exact(WIDE_LANES), other.chunks_exact(WIDE_LANES));
    let (rest, rest_of_other) = (blocks.remainder(), others.remainder());
    for (a, b) in blocks.zip(others) {
        for k in 0..WIDE_LANES {
            lanes[k] += f32::from(a[k]) * b[k];
        }
    }
    for (lane, (a, b)) in lanes.iter_mut().zip(rest.iter().zip(rest_of_other)) {
        *lane += f32::from(*a) * b;
    }
    gathered(lanes)
}

/// The sum of a slice.
#[inline(always)]
pub fn sum(values: &[f32]) -> f32 {
    let mut lanes = [0.0f32; WIDE_LANES];
    let blocks = values.chunks_exact(WIDE_LANES);
    let rest = blocks.remainder();
    for a in blocks {
        for k in 0..WIDE_LANES {
            lanes[k] += a[k];
        }
    }
    for (lane, a) in lanes.iter_mut().zip(rest) {
        *lane += a;
    }
    gathered(lanes)
}

/// Fill `out` with the sums of N lines, each times its weight, or with ADD add them; each line is at least as long as
/// `out`.
#[inline(always)]
pub fn weighted<const N: usize, const ADD: bool>(lines: [&[f32]; N], weight: [f32; N], out: &mut [f32]) {
    let lines = lines.map(|line| &line[..out.len()]);
    for c in 0..out.len() {
        let mut total = weight[0] * lines[0][c];
        for j in 1..N {
            total += weight[j] * lines[j][c];
        }
        out[c] = if ADD { out[c] + total } else { total };
    }
}

/// Whether the loops for AVX2 are used.
pub fn is_wide() -> bool {
    #[cfg(test)]
    if PORTABLE.get() {
        return false;
    }
    #[cfg(target_arch = "x86_64")]
    return is_x86_feature_detected!("avx2");
    #[cfg(not(target_arch = "x86_64"))]
    return false;
}

#[cfg(test)]
thread_local! {
    static PORTABLE: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// What some work gives with and without AVX2, after asserting that the two are the same.
#[cfg(test)]
pub fn on_both<R: PartialEq + std::fmt::Debug>(work: impl Fn() -> R) -> R {
    PORTABLE.set(true);
    let portable = work();
    PORTABLE.set(false);
    assert_eq!(portable, work());
    portable
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sums_are_those_of_the_columns_one_by_one(row in prop::collection::vec(0u8..255, 1..100)) {
            let [total, square] = sums([&row[..]], |[v]| [v, v * v]);
            prop_assert_eq!(total, row.iter().map(|&v| f64::from(v)).sum::<f64>());
            prop_assert_eq!(square, row.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>());
        }
    }

    #[test]
    fn wide_rows_do_not_overflow_their_lanes() {
        let row = vec![255u8; 300_001];
        assert_eq!(sums([&row[..]], |[v]| [v * v]), [300_001.0 * 255.0 * 255.0]);
    }

    vectorised! {
        fn product(one: &[f32], other: &[f32]) -> f32 {
            dot(one, other)
        }
    }

    #[test]
    fn sums_are_the_same_bits_on_every_processor_and_right() {
        let one: Vec<f32> = (0..77).map(|k| (k as f32).sin()).collect();
        let other: Vec<f32> = (0..77).map(|k| (0.3 * k as f32).cos()).collect();
        let usual = on_both(|| product(&one, &other).to_bits());
        let exact: f64 = one.iter().zip(&other).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum();
        assert!((f64::from(f32::from_bits(usual)) - exact).abs() < 1e-5);
        assert!((sum(&one) - one.iter().sum::<f32>()).abs() < 1e-5);
    }
}
