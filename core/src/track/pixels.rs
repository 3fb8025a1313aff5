//! What a frame's pixels are: whole numbers of 8 or 16 bits or floating-point numbers, read where they lie.

use super::grid::{Grid, Part};
use super::vectors::vectorised;

/// Share of pixels without a value that may be filled from their neighbours.
const BAD_SHARE: f64 = 0.02;

/// A kind of pixel.
pub trait Pixel: Copy + Send + Sync {
    /// Whether each has a value.
    const WHOLE: bool;

    /// The pixel less a level. Floating-point pixels lose the level in full precision: single precision alone would lose a
    /// small contrast on a large level.
    fn less(self, level: f64) -> f32;

    /// Whether it has a value.
    fn finite(self) -> bool;
}

macro_rules! whole_pixel {
    ($kind:ty) => {
        impl Pixel for $kind {
            const WHOLE: bool = true;

            #[inline(always)]
            fn less(self, level: f64) -> f32 {
                f32::from(self) - level as f32
            }

            #[inline(always)]
            fn finite(self) -> bool {
                true
            }
        }
    };
}

whole_pixel!(u8);
whole_pixel!(u16);

macro_rules! floating_pixel {
    ($kind:ty) => {
        impl Pixel for $kind {
            const WHOLE: bool = false;

            #[inline(always)]
            fn less(self, level: f64) -> f32 {
                (f64::from(self) - level) as f32
            }

            #[inline(always)]
            fn finite(self) -> bool {
                self.is_finite()
            }
        }
    };
}

floating_pixel!(f32);
floating_pixel!(f64);

vectorised! {
    /// Fill `out` with a line's pixels less a level.
    pub fn less_level<T: Pixel>(line: &[T], level: f64, out: &mut [f32]) {
        for (out, pixel) in out.iter_mut().zip(line) {
            *out = pixel.less(level);
        }
    }
}

/// A frame, or a part of one, in the memory of another: rows lie `stride` pixels apart.
#[derive(Clone, Copy)]
pub struct Pixels<'a, T> {
    values: &'a [T],
    stride: usize,
    /// How many rows.
    pub rows: usize,
    /// How many columns.
    pub columns: usize,
}

impl<'a, T: Pixel> Pixels<'a, T> {
    /// Rows of `columns` pixels that lie `stride` pixels apart in `values`; None where these do not hold them.
    pub fn new(values: &'a [T], rows: usize, columns: usize, stride: usize) -> Option<Self> {
        let enough = rows == 0 || (columns <= stride && values.len() >= (rows - 1) * stride + columns);
        enough.then_some(Self { values, stride, rows, columns })
    }

    /// Columns from `left` to before `right` of a row.
    #[inline(always)]
    pub fn line(&self, row: usize, left: usize, right: usize) -> &'a [T] {
        debug_assert!(right <= self.columns);
        &self.values[row * self.stride + left..row * self.stride + right]
    }

    /// All of it.
    pub fn whole(&self) -> Part {
        Part { top: 0, bottom: self.rows, left: 0, right: self.columns }
    }

    /// Whether all pixels of a part have a value.
    pub fn all_finite(&self, part: Part) -> bool {
        T::WHOLE
            || (part.top..part.bottom).all(|r| {
                // Without a question at each pixel the processor takes several at once.
                self.line(r, part.left, part.right).iter().fold(true, |all, pixel| all & pixel.finite())
            })
    }

    /// The pixels of a part less a level; None where more than 2 % of them are not numbers.
    pub fn values(&self, part: Part, level: f64) -> Option<Grid> {
        let mut out = Grid::filled(part.rows(), part.columns(), 0.0);
        for r in 0..out.rows {
            less_level(self.line(part.top + r, part.left, part.right), level, out.row_mut(r));
        }
        if T::WHOLE {
            return Some(out);
        }
        let bad = out.values.iter().filter(|value| !value.is_finite()).count();
        if bad == 0 {
            return Some(out);
        }
        (bad as f64 <= BAD_SHARE * out.values.len() as f64).then(|| filled(&out))
    }
}

impl<'a> Pixels<'a, f32> {
    /// All of a grid.
    pub fn of(grid: &'a Grid) -> Self {
        Self { values: &grid.values, stride: grid.columns, rows: grid.rows, columns: grid.columns }
    }
}

/// Bad pixels replaced by the mean of their good neighbours, ring by ring.
fn filled(image: &Grid) -> Grid {
    let mut value = image.map(|&v| if v.is_finite() { f64::from(v) } else { 0.0 });
    let mut known = image.map(|v| v.is_finite());
    let mut bad: Vec<usize> = (0..image.values.len()).filter(|&k| !known.values[k]).collect();
    while !bad.is_empty() {
        let means: Vec<Option<f64>> = bad.iter().map(|&k| neighbours(&value, &known, k)).collect();
        if means.iter().all(Option::is_none) {
            break;
        }
        for (&k, mean) in bad.iter().zip(&means) {
            if let Some(mean) = mean {
                (value.values[k], known.values[k]) = (*mean, true);
            }
        }
        bad.retain(|&k| !known.values[k]);
    }
    value.map(|&v| v as f32)
}

/// Mean of the known ones among the nine pixels about one; None where there is none.
fn neighbours(value: &Grid<f64>, known: &Grid<bool>, k: usize) -> Option<f64> {
    let (r, c) = (k / value.columns, k % value.columns);
    let (mut total, mut count) = (0.0, 0.0);
    for y in r.saturating_sub(1)..(r + 2).min(value.rows) {
        for x in c.saturating_sub(1)..(c + 2).min(value.columns) {
            if known.row(y)[x] {
                total += value.row(y)[x];
                count += 1.0;
            }
        }
    }
    (count > 0.0).then(|| total / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_read_where_it_lies_and_holes_are_filled() {
        let values: Vec<f64> = (0..120).map(f64::from).collect();
        // Every second row of 12 columns, of which 10 are seen.
        let image = Pixels::new(&values, 5, 10, 24).unwrap();
        let part = Part { top: 1, bottom: 3, left: 2, right: 4 };
        assert_eq!(image.values(part, 20.0).unwrap().values, [6.0, 7.0, 30.0, 31.0]);
        assert!(Pixels::new(&values, 5, 25, 24).is_none() && Pixels::new(&values, 6, 10, 24).is_none());
        let mut holes = Grid::filled(10, 10, 3.0f32);
        holes.values[55] = f32::NAN;
        let (whole, seen) = (Part { top: 0, bottom: 10, left: 0, right: 10 }, Pixels::of(&holes));
        assert!(!seen.all_finite(whole) && seen.all_finite(Part { top: 0, bottom: 5, left: 0, right: 10 }));
        assert_eq!(seen.values(whole, 1.0).unwrap(), Grid::filled(10, 10, 2.0));
        holes.values[..3].fill(f32::NAN);
        assert!(Pixels::of(&holes).values(whole, 1.0).is_none());
    }
}
