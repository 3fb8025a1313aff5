//! The integral image: sums of all pixels above and left, of which any box's sum is a difference.

use super::image::Image;

/// Sums (rows + 1, columns + 1) of all pixels above and left of a corner.
pub struct Integral {
    /// Of the image.
    pub rows: usize,
    /// Of the image.
    pub columns: usize,
    sums: Vec<f64>,
}

impl Integral {
    /// Of the pixels less a level: what lies outside the image counts as 0.
    pub fn of(image: &Image<'_, f32>, level: f32) -> Self {
        let (rows, columns) = (image.rows, image.columns);
        let mut sums = vec![0.0; (rows + 1) * (columns + 1)];
        for r in 0..rows {
            let (above, below) = sums[r * (columns + 1)..].split_at_mut(columns + 1);
            let mut line = 0.0;
            for ((sum, above), value) in below[1..=columns].iter_mut().zip(&above[1..]).zip(image.row(r)) {
                line += f64::from(value - level);
                *sum = above + line;
            }
        }
        Self { rows, columns, sums }
    }

    /// The sums above a row.
    #[inline(always)]
    pub fn row(&self, row: usize) -> &[f64] {
        &self.sums[row * (self.columns + 1)..][..self.columns + 1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_holds_the_sum_of_all_pixels_above_and_left() {
        let pixels: Vec<f32> = (0..35).map(|k| (k * 13 % 17) as f32).collect();
        let integral = Integral::of(&Image::new(&pixels, 5, 7, 7).unwrap(), 3.0);
        for r in 0..=5 {
            for c in 0..=7 {
                let above = pixels.chunks(7).take(r).flat_map(|row| &row[..c]);
                assert_eq!(integral.row(r)[c], above.map(|&value| f64::from(value) - 3.0).sum::<f64>());
            }
        }
    }
}
