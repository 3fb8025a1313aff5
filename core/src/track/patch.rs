//! A patch of an image as numbers: its pixels less an offset, those without a value bridged by their neighbours.

use super::grid::Grid;
use super::image::{Image, Pixel};
use super::vector::vectorised;

/// Share of pixels without a value that may be filled from their neighbours.
const BAD_SHARE: f64 = 0.02;

/// The pixels less an offset, row by row; None where more than 2 % of them are not numbers.
///
/// The offset goes first, in full precision: 32 bits alone would lose a small contrast on a large level.
pub fn values<T: Pixel>(image: &Image<'_, T>, offset: f64) -> Option<Grid> {
    let mut grid = Grid { values: shifted(image, offset), rows: image.rows, columns: image.columns };
    if T::FULL_SCALE.is_none() {
        let bad = grid.values.iter().filter(|value| !value.is_finite()).count();
        if bad as f64 > BAD_SHARE * grid.values.len() as f64 {
            return None;
        }
        if bad > 0 {
            fill(&mut grid.values, image.columns);
        }
    }
    Some(grid)
}

vectorised! {
fn shifted<T: Pixel>(image: &Image<'_, T>, offset: f64) -> Vec<f32> {
    let mut values = vec![0f32; image.rows * image.columns];
    for (r, row) in values.chunks_exact_mut(image.columns.max(1)).enumerate() {
        less_offset(image.row(r), offset, row);
    }
    values
}
}

/// Fill `out` with pixels less an offset.
#[inline(always)]
pub fn less_offset<T: Pixel>(pixels: &[T], offset: f64, out: &mut [f32]) {
    for (out, pixel) in out.iter_mut().zip(pixels) {
        *out = pixel.less(offset);
    }
}

/// Replaces what is not finite by the mean of its neighbours that are, ring by ring.
fn fill(values: &mut [f32], columns: usize) {
    let rows = values.len() / columns;
    let mut filled: Vec<Option<f64>> = values.iter().map(|&v| v.is_finite().then_some(f64::from(v))).collect();
    while filled.contains(&None) {
        let ring: Vec<(usize, f64)> = (0..filled.len())
            .filter(|&k| filled[k].is_none())
            .filter_map(|k| {
                let (r, c) = (k / columns, k % columns);
                let (mut total, mut count) = (0.0, 0.0);
                for row in r.saturating_sub(1)..(r + 2).min(rows) {
                    for value in filled[row * columns..][c.saturating_sub(1)..(c + 2).min(columns)].iter().flatten() {
                        total += value;
                        count += 1.0;
                    }
                }
                (count > 0.0).then(|| (k, total / count))
            })
            .collect();
        if ring.is_empty() {
            return;
        }
        for (k, value) in ring {
            filled[k] = Some(value);
        }
    }
    for (value, filled) in values.iter_mut().zip(filled) {
        *value = filled.map_or(*value, |filled| filled as f32);
    }
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;

    #[test]
    fn a_hole_is_filled_from_its_rim_and_a_large_one_is_refused() {
        let mut pixels: Vec<f64> = (0..400).map(|k| 1e6 + f64::from(k % 20)).collect();
        for k in [105, 106, 107, 125, 126, 127, 145] {
            pixels[k] = f64::NAN;
        }
        let image = Image::new(&pixels, 20, 20, 20).unwrap();
        let found = on_both(|| values(&image, 1e6)).unwrap().values;
        assert_eq!(found[..20], (0..20).map(|k| k as f32).collect::<Vec<_>>());
        // Of the five known neighbours of the corner three lie in column 4 and one each in columns 5 and 6.
        assert_eq!(found[105], (3.0 * 4.0 + 5.0 + 6.0) / 5.0);
        assert!(found.iter().all(|value| value.is_finite()));
        pixels[..20].fill(f64::INFINITY);
        assert_eq!(values(&Image::new(&pixels, 20, 20, 20).unwrap(), 0.0), None);
    }
}
