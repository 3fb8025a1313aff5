//! Images as they lie in memory: rows of pixels at any distance from each other, and parts of them without a copy.

use super::grid::{Grid, Part};
use super::products::Factor;
use std::ops::{Add, Mul, Sub};

/// What a processor fetches at once, and what of a file Linux maps where a pixel of it is looked at.
const LINE_BYTES: usize = 64;
const MAPPED_BYTES: usize = 65536;

/// A number that pixels are computed with.
pub trait Level: Copy + Default + PartialOrd + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// Whether it is a whole number.
    const WHOLE: bool;
    /// As a 64 bit floating point number.
    fn number(self) -> f64;
    /// Without its sign.
    fn magnitude(self) -> Self;
}

macro_rules! level {
    ($($kind:ty, $whole:expr;)*) => {
        $(impl Level for $kind {
            const WHOLE: bool = $whole;
            #[inline(always)]
            fn number(self) -> f64 {
                self as f64
            }
            #[inline(always)]
            fn magnitude(self) -> Self {
                self.abs()
            }
        })*
    };
}
level! {
    i32, true;
    i64, true;
    f64, false;
}

/// A kind of pixel; `Level` holds the squares of its differences.
pub trait Pixel: Copy + PartialEq + PartialOrd + Send + Sync {
    /// What it is computed with.
    type Level: Level;
    /// Full scale where it is a whole number: cameras put 10 or 12 bits into 16, so that of these it is a guess.
    const FULL_SCALE: Option<f64>;
    /// As what it is computed with.
    fn level(self) -> Self::Level;
    /// Less an offset, in the precision that it has: a small contrast on a large level must not be lost.
    fn less(self, offset: f64) -> f32;
    /// Whether it has a value.
    fn is_finite(self) -> bool;
    /// What it is multiplied with kernels as.
    type Factor: Factor;
    /// Less an offset; a byte less the nearest whole one.
    fn factor(self, offset: f64) -> Self::Factor;
}

macro_rules! pixel {
    ($($kind:ty, $level:ty, $scale:expr, |$value:ident, $offset:ident| $less:expr, $factor:ty, $of:expr, $finite:expr;)*) => {
        $(impl Pixel for $kind {
            type Level = $level;
            const FULL_SCALE: Option<f64> = $scale;
            #[inline(always)]
            fn level(self) -> $level {
                self as $level
            }
            #[inline(always)]
            fn less(self, $offset: f64) -> f32 {
                let $value = self;
                $less
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                $finite(&self)
            }
            type Factor = $factor;
            #[inline(always)]
            fn factor(self, offset: f64) -> $factor {
                $of(self, offset)
            }
        })*
    };
}
pixel! {
    u8, i32, Some(255.0), |value, offset| f32::from(value) - offset as f32, i16,
        |byte: u8, offset: f64| i16::from(byte) - offset.round() as i16, |_| true;
    u16, i64, Some(1023.0), |value, offset| f32::from(value) - offset as f32, f32, Self::less, |_| true;
    i16, i64, Some(1023.0), |value, offset| f32::from(value) - offset as f32, f32, Self::less, |_| true;
    i32, f64, Some(1023.0), |value, offset| (f64::from(value) - offset) as f32, f32, Self::less, |_| true;
    i64, f64, Some(1023.0), |value, offset| (value as f64 - offset) as f32, f32, Self::less, |_| true;
    f32, f64, None, |value, offset| (f64::from(value) - offset) as f32, f32, Self::less, |value: &f32| value.is_finite();
    f64, f64, None, |value, offset| (value - offset) as f32, f32, Self::less, |value: &f64| value.is_finite();
}

/// A place in an image, or a part of one: first column and row, and how many of each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// First column.
    pub x: i64,
    /// First row.
    pub y: i64,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Region {
    /// Moved by whole pixels, with a margin on every side.
    pub fn moved(self, x: i64, y: i64, margin: usize) -> Self {
        let more = margin as i64;
        let (width, height) = (self.width + 2 * margin, self.height + 2 * margin);
        Self {
            x: self.x.saturating_add(x).saturating_sub(more),
            y: self.y.saturating_add(y).saturating_sub(more),
            width,
            height,
        }
    }

    /// Moved by a translation, rounded to whole pixels, and then the least to lie inside an image of this size, cut to
    /// that where it is larger (equation 28 of doi 10.1111/mice.12767).
    pub fn followed(self, place: [f64; 2], rows: usize, columns: usize) -> Self {
        let along = |first: i64, moved: f64, size: usize, pixels: usize| {
            let size = size.min(pixels);
            let last = (pixels - size) as i64;
            (first.saturating_add(moved.round_ties_even() as i64).clamp(0, last), size)
        };
        let (x, width) = along(self.x, place[0], self.width, columns);
        let (y, height) = along(self.y, place[1], self.height, rows);
        Self { x, y, width, height }
    }
}

/// An image, or a part of one.
#[derive(Clone, Copy)]
pub struct Image<'a, T> {
    pixels: &'a [T],
    /// How many rows.
    pub rows: usize,
    /// How many columns.
    pub columns: usize,
    stride: usize,
}

impl<'a, T: Copy> Image<'a, T> {
    /// Rows of `columns` pixels whose first ones lie `stride` pixels apart; None where `pixels` do not hold them.
    pub fn new(pixels: &'a [T], rows: usize, columns: usize, stride: usize) -> Option<Self> {
        let needed = rows.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(columns))?;
        (needed <= pixels.len() && columns <= stride.max(columns)).then_some(Self { pixels, rows, columns, stride })
    }

    /// A row's pixels.
    #[inline(always)]
    pub fn row(&self, row: usize) -> &'a [T] {
        assert!(row < self.rows);
        &self.pixels[row * self.stride..][..self.columns]
    }

    /// Columns from `left` to before `right` of a row.
    #[inline(always)]
    pub fn line(&self, row: usize, left: usize, right: usize) -> &'a [T] {
        &self.row(row)[left..right]
    }

    /// A part, which is inside; or empty at an edge.
    pub fn part(&self, part: Part) -> Self {
        let pixels = self.pixels.get(part.top * self.stride + part.left..).unwrap_or_default();
        Self { pixels, rows: part.rows(), columns: part.columns(), stride: self.stride }
    }

    /// The part of the image in a region; None where that is not wholly inside.
    pub fn cut(&self, region: Region) -> Option<Self> {
        let (x, y) = (usize::try_from(region.x).ok()?, usize::try_from(region.y).ok()?);
        let (right, bottom) = (x.checked_add(region.width)?, y.checked_add(region.height)?);
        if right > self.columns || bottom > self.rows || region.width == 0 || region.height == 0 {
            return None;
        }
        let pixels = &self.pixels[y * self.stride + x..];
        Some(Self { pixels, rows: region.height, columns: region.width, stride: self.stride })
    }

    /// Ask for the pixels of a region, as far as it is inside, some time before they are needed.
    ///
    /// A frame of a file comes from far away, row by row, too seldom in sequence for the processor to foresee it.
    pub fn ask_for(&self, region: Region) {
        let along = |first: i64, length: usize, size: usize| {
            [first, first.saturating_add(length as i64)].map(|end| end.clamp(0, size as i64) as usize)
        };
        let [left, right] = along(region.x, region.width, self.columns);
        let [top, bottom] = along(region.y, region.height, self.rows);
        let mut mapped = 0;
        for row in (top..bottom).map(|r| self.line(r, left, right)) {
            for pixels in row.chunks((LINE_BYTES / size_of::<T>()).max(1)) {
                let place = pixels.as_ptr();
                // What is not mapped yet is not fetched: a part of the file is, once it is looked at.
                if place as usize / MAPPED_BYTES != mapped {
                    mapped = place as usize / MAPPED_BYTES;
                    std::hint::black_box(pixels[0]);
                }
                #[cfg(target_arch = "x86_64")]
                // SAFETY: a prefetch reads nothing, and every x86-64 processor has it.
                unsafe {
                    use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
                    _mm_prefetch::<_MM_HINT_T1>(place.cast());
                }
            }
        }
    }

    /// One in `step` rows.
    pub fn thinned(&self, step: usize) -> Self {
        Self { rows: self.rows.div_ceil(step), stride: self.stride * step, ..*self }
    }
}

impl<T: Pixel> Image<'_, T> {
    /// Whether all pixels have a value.
    pub fn all_finite(&self) -> bool {
        // Without a question at each pixel the processor takes several at once.
        let row_is = |r: usize| self.row(r).iter().fold(true, |all, pixel| all & pixel.is_finite());
        T::FULL_SCALE.is_some() || (0..self.rows).all(row_is)
    }
}

impl<'a> From<&'a Grid> for Image<'a, f32> {
    fn from(grid: &'a Grid) -> Self {
        Self { pixels: &grid.values, rows: grid.rows, columns: grid.columns, stride: grid.columns }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_region_follows_its_target_to_the_edge() {
        let region = Region { x: 5, y: 2, width: 3, height: 4 };
        assert_eq!(region.followed([-2.4, 1.6], 20, 30), Region { x: 3, y: 4, ..region });
        assert_eq!(region.followed([1e300, -9.0], 20, 30), Region { x: 27, y: 0, ..region });
        assert_eq!(region.followed([0.0, 0.0], 3, 2), Region { x: 0, y: 0, width: 2, height: 3 });
    }

    #[test]
    fn a_part_is_the_pixels_of_its_rows_and_columns_and_one_that_leaves_the_image_is_none() {
        let pixels: Vec<u8> = (0..60).collect();
        let image = Image::new(&pixels, 6, 8, 10).unwrap();
        let part = image.cut(Region { x: 5, y: 2, width: 3, height: 4 }).unwrap();
        assert_eq!(part.row(0), [25, 26, 27]);
        assert_eq!(part.thinned(2).row(1), [45, 46, 47]);
        assert_eq!((part.thinned(3).rows, part.thinned(9).rows), (2, 1));
        for (x, y, width, height) in [(6, 2, 3, 4), (5, 3, 3, 4), (-1, 0, 3, 3), (0, 0, 0, 3)] {
            assert!(image.cut(Region { x, y, width, height }).is_none());
        }
        assert!(Image::new(&pixels, 7, 8, 10).is_none());
    }
}
