//! The noise of one picture as the difference of two registered ones shows it.
//!
//! The other picture is moved to the same place by its quintic spline and brought to the same contrast. The spread of
//! the difference comes from its median, that of its second difference in x and y from the finest detail alone.

use super::image::Image;
use super::interpolate::{CARDINAL_TAPS, REACH_PX, cardinal_taps};
use super::vector::{sums, vectorised};

/// Of the second difference along both axes: the sum of its weights' squares.
const MASK_SQUARE: f64 = 36.0;
/// The median distance from 0 of a normal variable of standard deviation 1.
const MEDIAN_DEVIATION: f64 = 0.6745;

/// A square of a picture about the target, and where the target lies in it beyond whole pixels: x, y of -0.5 to 0.5 px.
#[derive(Clone, Copy)]
pub struct Square<'a> {
    /// Pixels (n, n).
    pub pixels: Image<'a, f32>,
    /// Along x and y, px.
    pub shift: [f64; 2],
}

/// Noise in grey levels; without a codec the two are the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// In the finest detail, where cameras have most of their noise and codecs leave least of it.
    pub fine: f64,
    /// Over all detail.
    pub broad: f64,
}

/// The noise of `now` against `then`; None where their sizes differ or are no larger than what the spline reaches over.
pub fn noise(now: &Square<'_>, then: &Square<'_>) -> Option<Noise> {
    let side = now.pixels.rows;
    if side < 2 * REACH_PX + 4 || [now.pixels.columns, then.pixels.rows, then.pixels.columns] != [side; 3] {
        return None;
    }
    let [across, down] = [0, 1].map(|axis| cardinal_taps(then.shift[axis] - now.shift[axis]));
    let single = |taps: [f64; CARDINAL_TAPS]| taps.map(|tap| tap as f32);
    let difference = difference(&now.pixels, &then.pixels, &single(across), &single(down));
    // White noise of variance 1 in both pictures, as it comes out of the difference and of the mask on it.
    let square = |taps: &[f64]| taps.iter().map(|tap| tap * tap).sum::<f64>();
    let moved = square(&across) * square(&down);
    let masked = square(&second_difference(&across)) * square(&second_difference(&down));
    let mut every_second: Vec<f32> =
        difference.broad.chunks(side - 2 * REACH_PX).step_by(2).flatten().copied().collect();
    let mut fine = difference.fine;
    Some(Noise {
        fine: spread(&mut fine) / (MASK_SQUARE + masked).sqrt(),
        broad: spread(&mut every_second) / (1.0 + moved).sqrt(),
    })
}

/// Taps after the mask 1, -2, 1.
fn second_difference(taps: &[f64]) -> Vec<f64> {
    let at = |k: usize, back: usize| k.checked_sub(back).and_then(|k| taps.get(k)).copied().unwrap_or(0.0);
    (0..taps.len() + 2).map(|k| at(k, 0) - 2.0 * at(k, 1) + at(k, 2)).collect()
}

/// Standard deviation of a normal variable whose median distance from 0 is that of the values.
fn spread(values: &mut [f32]) -> f64 {
    values.iter_mut().for_each(|value| *value = value.abs());
    median(values) / MEDIAN_DEVIATION
}

/// The middle of values, or the mean of the middle two; changes their order. NaN of none.
pub fn median(values: &mut [f32]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return f64::NAN;
    }
    let even = values.len() % 2 == 0;
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, f32::total_cmp);
    if !even {
        return f64::from(upper);
    }
    let lower = below.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    0.5 * (f64::from(lower) + f64::from(upper))
}

/// Mean and variance of a picture.
#[inline(always)]
fn moments(picture: &Image<'_, f32>) -> [f64; 2] {
    let count = (picture.rows * picture.columns) as f64;
    let level = f64::from(picture.row(0)[0]);
    let mut total = [0.0; 2];
    for r in 0..picture.rows {
        let [sum, square] = sums([picture.row(r)], |[value]| [value - level, (value - level) * (value - level)]);
        total = [total[0] + sum, total[1] + square];
    }
    let mean = total[0] / count;
    [level + mean, total[1] / count - mean * mean]
}

struct Difference {
    /// (m, m), m the side less what the spline reaches over.
    broad: Vec<f32>,
    /// Its second difference in x and y (m - 2, m - 2).
    fine: Vec<f32>,
}

vectorised! {
fn difference(
    now: &Image<'_, f32>,
    then: &Image<'_, f32>,
    across: &[f32; CARDINAL_TAPS],
    down: &[f32; CARDINAL_TAPS],
) -> Difference {
    let side = now.rows;
    let inner = side - 2 * REACH_PX;
    let ([level_now, variance_now], [level_then, variance_then]) = (moments(now), moments(then));
    let gain = ((variance_now + 1e-12) / (variance_then + 1e-12)).sqrt() as f32;
    let (level_now, level_then) = (level_now as f32, level_then as f32);
    let mut broad = Vec::with_capacity(inner * inner);
    let mut line = vec![0f32; side];
    for r in 0..inner {
        line.fill(0.0);
        for (j, tap) in down.iter().enumerate() {
            let weight = gain * tap;
            for (sum, value) in line.iter_mut().zip(then.row(r + j)) {
                *sum += weight * (value - level_then);
            }
        }
        let start = broad.len();
        broad.extend(now.row(r + REACH_PX)[REACH_PX..][..inner].iter().map(|value| value - level_now));
        for (j, weight) in across.iter().enumerate() {
            for (sum, value) in broad[start..].iter_mut().zip(&line[j..]) {
                *sum -= weight * value;
            }
        }
    }
    let mut fine = Vec::with_capacity((inner - 2) * (inner - 2));
    for rows in broad.windows(2 * inner + inner).step_by(inner) {
        let (upper, rest) = rows.split_at(inner);
        let (middle, lower) = rest.split_at(inner);
        let bend = |c: usize| (upper[c] - 2.0 * middle[c]) + lower[c];
        fine.extend((0..inner - 2).map(|c| (bend(c) - 2.0 * bend(c + 1)) + bend(c + 2)));
    }
    Difference { broad, fine }
}
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;

    #[test]
    fn two_noisy_pictures_of_a_wave_that_moved_tell_their_noise() {
        let mut seed = 1u64;
        let mut uniform = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64 / f64::from(1 << 24)
        };
        let mut picture = |x: f64, y: f64| -> Vec<f32> {
            let at = |k: usize, shift: f64| 0.6 * (k as f64 - shift);
            (0..84 * 84)
                .map(|k| {
                    let normal: f64 = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
                    (100.0 + 30.0 * at(k % 84, x).sin() * at(k / 84, y).cos() + 2.0 * normal) as f32
                })
                .collect()
        };
        let shifts = [[0.0, 0.0], [0.4, -0.3]];
        let pixels = shifts.map(|[x, y]| picture(x, y));
        let square = |k: usize| Square { pixels: Image::new(&pixels[k], 84, 84, 84).unwrap(), shift: shifts[k] };
        let found = on_both(|| noise(&square(0), &square(1))).unwrap();
        // A median of 4000 values is known to 2 %.
        assert!((found.fine / 2.0 - 1.0).abs() < 0.06 && (found.broad / 2.0 - 1.0).abs() < 0.06, "{found:?}");
        let small = Square { pixels: Image::new(&pixels[0], 20, 20, 84).unwrap(), shift: [0.0; 2] };
        assert_eq!(noise(&small, &small), None);
    }

    #[test]
    fn the_median_of_an_even_count_is_the_mean_of_the_middle_two() {
        assert_eq!(median(&mut [4.0, 1.0, 3.0]), 3.0);
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), 2.5);
        assert!(median(&mut []).is_nan());
    }
}
