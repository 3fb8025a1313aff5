//! Numbers of one picture: its detail, the share of its pixels at the ends of the scale, what a codec left of it.
//!
//! Detail is the mean square difference of pixels two apart; a codec's blocks are of [`BLOCK_PX`] counted from the
//! corner of the whole picture, and what it did not send is equal to the picture before bit for bit.

use super::image::{Image, Level, Pixel};
use super::vector::{sums, vectorised};

/// Codecs cut pictures into such blocks, counted from the corner, px.
pub const BLOCK_PX: usize = 8;
/// Ends of a video's range in 8 bits (ITU-R BT.601).
const VIDEO_ENDS: [f64; 2] = [16.0, 235.0];

/// Mean square differences of pixels two apart along x and y, and the variance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Detail {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Variance of the pixels.
    pub variance: f64,
}

vectorised! {
/// Detail of one in `every` bands of a picture; a band is eight rows: whole blocks of rows see a pattern of bricks
/// alike wherever it lies between the pixels. NaN of a picture without an inside.
pub fn detail<T: Pixel>(picture: &Image<'_, T>, every: usize) -> Detail {
    let (rows, columns) = (picture.rows, picture.columns);
    if rows < 3 || columns < 3 {
        return Detail { x: f64::NAN, y: f64::NAN, variance: f64::NAN };
    }
    let level = picture.row(rows / 2)[columns / 2].level();
    let mut total = [0.0; 4];
    let mut count = 0;
    for r in (1..rows - 1).filter(|r| (r / BLOCK_PX) % every == 0) {
        let (above, row, below) = (picture.row(r - 1), picture.row(r), picture.row(r + 1));
        let inside = 1..columns - 1;
        let parts = [&row[..columns - 2], &row[inside.clone()], &row[2..], &above[inside.clone()], &below[inside]];
        let of_row = sums(parts, |[left, here, right, above, below]| {
            let (value, dx, dy) = (here - level, right - left, below - above);
            [value, value * value, dx * dx, dy * dy]
        });
        for (total, more) in total.iter_mut().zip(of_row) {
            *total += more;
        }
        count += columns - 2;
    }
    let [mean, square, x, y] = total.map(|sum| sum / count as f64);
    Detail { x, y, variance: square - mean * mean }
}
}

/// Detail of a picture along x and y over that of another, both without their noise's variance and by their contrast;
/// NaN where that is not known.
pub fn sharpness(now: Detail, other: Detail, noise: f64) -> [f64; 2] {
    let (light, dark) = (without(now.variance, noise), without(other.variance, noise));
    [(now.x, other.x), (now.y, other.y)].map(|(now, other)| {
        let other = without(other, 2.0 * noise) * light;
        if other > 0.0 { without(now, 2.0 * noise) * dark / other } else { f64::NAN }
    })
}

/// A detail less its noise; at most half is taken off: where nearly all is noise, what is left says nothing.
fn without(value: f64, noise: f64) -> f64 {
    (value - noise).max(0.5 * value)
}

/// Share of the pixels that light has driven to the end of the scale, or that have none; the larger of the two.
///
/// Full scale need not be known (10 bits in 16): where light is cut off, many pixels share one value. In 8 bits that is
/// from 235 on or up to 16, the ends of a video's range. Numbers that are not whole have no scale: 0.
pub fn share_at_ends<T: Pixel>(picture: &Image<'_, T>) -> f64 {
    let ends = match T::FULL_SCALE {
        Some(255.0) => VIDEO_ENDS,
        Some(_) => [f64::INFINITY, 0.0],
        None => return 0.0,
    };
    if picture.rows * picture.columns == 0 {
        return 0.0;
    }
    at_ends(picture, ends) as f64 / (picture.rows * picture.columns) as f64
}

vectorised! {
/// How many pixels have the least value, where that is at most `ends[0]`, or the largest from `ends[1]` on; the larger.
fn at_ends<T: Pixel>(picture: &Image<'_, T>, ends: [f64; 2]) -> usize {
    let first = picture.row(0)[0];
    let (mut low, mut high) = (first, first);
    for r in 0..picture.rows {
        for &value in picture.row(r) {
            low = if value < low { value } else { low };
            high = if value > high { value } else { high };
        }
    }
    let count = |end: T| {
        // A byte holds how many of 255 there are.
        let of_part = |part: &[T]| part.iter().map(|&value| u8::from(value == end)).sum::<u8>() as usize;
        let of_row = |r| picture.row(r).chunks(255).map(of_part).sum::<usize>();
        (0..picture.rows).map(of_row).sum::<usize>()
    };
    let lows = if low.level().number() <= ends[0] { count(low) } else { 0 };
    let highs = if high.level().number() >= ends[1] { count(high) } else { 0 };
    lows.max(highs)
}
}

/// Whether two pictures are equal to the last bit; the first row that differs ends it.
pub fn same<T: Pixel>(one: &Image<'_, T>, other: &Image<'_, T>) -> bool {
    (one.rows, one.columns) == (other.rows, other.columns) && (0..one.rows).all(|r| one.row(r) == other.row(r))
}

/// First rows and columns of the codec's blocks that lie wholly in a picture whose first pixel is at `left`, `top` of
/// the whole one, with `more` pixels after them.
fn corners<T: Pixel>(picture: &Image<'_, T>, left: usize, top: usize, more: usize) -> impl Iterator<Item = [usize; 2]> {
    let starts = |from: usize, length: usize| {
        let first = from.wrapping_neg() % BLOCK_PX;
        (first..(length + 1).saturating_sub(BLOCK_PX + more)).step_by(BLOCK_PX)
    };
    let columns = starts(left, picture.columns);
    starts(top, picture.rows).flat_map(move |r| columns.clone().map(move |c| [r, c]))
}

fn block_row<'a, T: Pixel>(picture: &Image<'a, T>, row: usize, column: usize) -> &'a [T; BLOCK_PX] {
    picture.row(row)[column..].first_chunk().unwrap()
}

/// Share of the codec's blocks that are one flat tone with a step to the next one: what is left of a weak texture.
pub fn stair_share<T: Pixel>(picture: &Image<'_, T>, left: usize, top: usize) -> f64 {
    let (mut blocks, mut stairs) = (0, 0);
    for [r, c] in corners(picture, left, top, 1) {
        blocks += 1;
        let tone = picture.row(r)[c];
        let flat = (r..r + BLOCK_PX).all(|row| block_row(picture, row, c).iter().all(|&value| value == tone));
        if flat && (picture.row(r + BLOCK_PX)[c] != tone || picture.row(r)[c + BLOCK_PX] != tone) {
            stairs += 1;
        }
    }
    f64::from(stairs) / f64::from(blocks.max(1))
}

vectorised! {
/// Steps across the edges of a codec's blocks over those across their middles, less 1; about 0 without such blocks.
pub fn blockiness<T: Pixel>(picture: &Image<'_, T>, left: usize, top: usize) -> f64 {
    let (mut edge, mut middle) = (1e-9, 1e-9);
    let columns = picture.columns.saturating_sub(1);
    // The first column, and row, before an edge and before a middle.
    let before = |from: usize, place: usize| (place + BLOCK_PX - 1).wrapping_sub(from % BLOCK_PX) % BLOCK_PX;
    for r in 0..picture.rows.saturating_sub(1) {
        let row = picture.row(r);
        let across = |first: usize| -> f64 {
            let places = (first..columns).step_by(BLOCK_PX);
            places.map(|c| (row[c + 1].level() - row[c].level()).magnitude().number()).sum()
        };
        edge += across(before(left, 0));
        middle += across(before(left, BLOCK_PX / 2));
        let down = (top + r + 1) % BLOCK_PX;
        if down == 0 || down == BLOCK_PX / 2 {
            let rows = [&row[..columns], &picture.row(r + 1)[..columns]];
            let [steps] = sums(rows, |[here, below]| [(below - here).magnitude()]);
            *(if down == 0 { &mut edge } else { &mut middle }) += steps;
        }
    }
    edge / middle - 1.0
}
}

/// Square sums of the differences of neighbours: in blocks that are bit for bit those before, and in all.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Texture {
    /// In the blocks that was static.
    pub frozen: f64,
    /// In all; 0 where none was static.
    pub whole: f64,
}

/// The texture of the codec's blocks that was static between two pictures of one size from one place.
pub fn frozen_texture<T: Pixel>(now: &Image<'_, T>, before: &Image<'_, T>, left: usize, top: usize) -> Texture {
    if (now.rows, now.columns) != (before.rows, before.columns) {
        return Texture::default();
    }
    let stood = stood(now, before, left, top);
    if !stood.contains(&true) {
        return Texture::default();
    }
    texture(now, left, top, &stood)
}

/// Which of the codec's blocks are equal to the last bit in two pictures of one size.
fn stood<T: Pixel>(now: &Image<'_, T>, before: &Image<'_, T>, left: usize, top: usize) -> Vec<bool> {
    let still = |[r, c]: [usize; 2]| (r..r + BLOCK_PX).all(|row| block_row(now, row, c) == block_row(before, row, c));
    corners(now, left, top, 0).map(still).collect()
}

/// Whether any of them may be, as their first rows say: hardly any is equal.
fn any_stood<T: Pixel>(now: &Image<'_, T>, before: &Image<'_, T>, left: usize, top: usize) -> bool {
    let [first_row, first_column] = [top, left].map(|from| from.wrapping_neg() % BLOCK_PX);
    (first_row..(now.rows + 1).saturating_sub(BLOCK_PX)).step_by(BLOCK_PX).any(|r| {
        let [one, other] = [now, before].map(|picture| picture.row(r).get(first_column..).unwrap_or_default());
        one.chunks_exact(BLOCK_PX).zip(other.chunks_exact(BLOCK_PX)).fold(false, |any, (one, other)| {
            any | one.iter().zip(other).fold(true, |all, (one, other)| all & (one == other))
        })
    })
}

/// Share of equal pixels up to which a block of 64 of them is equal by chance once in a million.
const MAX_EQUAL: f64 = 0.8;

/// What of a picture is bit for bit that of another one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PartStill {
    /// The share of its texture, 0 to 1.
    pub share: f64,
    /// Whether pixels of the rest are equal so seldom that no whole block is so by chance.
    pub rest_differs: bool,
}

/// How much of the codec's blocks is still between two pictures of one size from one place, and what the rest does.
pub fn part_still<T: Pixel>(now: &Image<'_, T>, before: &Image<'_, T>, left: usize, top: usize) -> PartStill {
    if (now.rows, now.columns) != (before.rows, before.columns) || !any_stood(now, before, left, top) {
        return PartStill::default();
    }
    let stood = stood(now, before, left, top);
    let pairs = (0..now.rows).flat_map(|r| now.row(r).iter().zip(before.row(r)));
    let equal = pairs.filter(|(one, other)| one == other).count();
    let still = BLOCK_PX * BLOCK_PX * stood.iter().filter(|&&one| one).count();
    let rest = (now.rows * now.columns).saturating_sub(still).max(1);
    let found = texture(now, left, top, &stood);
    let share = if found.whole > 0.0 { found.frozen / found.whole } else { 0.0 };
    PartStill { share, rest_differs: ((equal - still) as f64) < MAX_EQUAL * rest as f64 }
}

vectorised! {
fn texture<T: Pixel>(picture: &Image<'_, T>, left: usize, top: usize, stood: &[bool]) -> Texture {
    let mut found = Texture::default();
    for ([r, c], &stood) in corners(picture, left, top, 0).zip(stood) {
        let of_block = block_texture(picture, r, c);
        found.whole += of_block;
        found.frozen += if stood { of_block } else { 0.0 };
    }
    if found.frozen > 0.0 { found } else { Texture::default() }
}
}

#[inline(always)]
fn block_texture<T: Pixel>(picture: &Image<'_, T>, row: usize, column: usize) -> f64 {
    let mut lanes = [T::Level::default(); BLOCK_PX - 1];
    let mut here = block_row(picture, row, column).map(Pixel::level);
    for r in row + 1..row + BLOCK_PX {
        let below = block_row(picture, r, column).map(Pixel::level);
        for l in 0..BLOCK_PX - 1 {
            let (dx, dy) = (here[l + 1] - here[l], below[l] - here[l]);
            lanes[l] = lanes[l] + (dx * dx + dy * dy);
        }
        here = below;
    }
    lanes.iter().map(|lane| lane.number()).sum()
}

vectorised! {
/// Whether whole numbers, none below 0, add up to a total, of one in `step` columns; rows after that are not looked at.
/// The middle row is the first: what is watched lies there, so that its pixels are at hand.
pub fn adds_up<T: Pixel>(picture: &Image<'_, T>, step: usize, total: f64) -> bool {
    let mut sum = 0.0;
    (0..picture.rows).any(|r| {
        let row = picture.row((r + picture.rows / 2) % picture.rows);
        sum += if step == 1 {
            sums([row], |[value]| [value])[0]
        } else {
            row.iter().step_by(step).fold(T::Level::default(), |sum, value| sum + value.level()).number()
        };
        sum >= total
    })
}
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;
    use proptest::prelude::*;

    const ROWS: usize = 37;
    const COLUMNS: usize = 45;

    fn pictures() -> impl Strategy<Value = Vec<u16>> {
        prop::collection::vec(0u16..1024, ROWS * COLUMNS)
    }

    fn plain(picture: &[u16]) -> impl Fn(usize, usize) -> f64 + '_ {
        |r, c| f64::from(picture[r * COLUMNS + c])
    }

    proptest! {
        #[test]
        fn detail_is_that_of_the_pixels_one_by_one(pixels in pictures()) {
            let image = Image::new(&pixels, ROWS, COLUMNS, COLUMNS).unwrap();
            let found = on_both(|| detail(&image, 2));
            let (at, mut values, mut x, mut y) = (plain(&pixels), Vec::new(), 0.0, 0.0);
            for r in (1..ROWS - 1).filter(|r| r / 8 % 2 == 0) {
                for c in 1..COLUMNS - 1 {
                    values.push(at(r, c));
                    x += (at(r, c + 1) - at(r, c - 1)).powi(2);
                    y += (at(r + 1, c) - at(r - 1, c)).powi(2);
                }
            }
            let count = values.len() as f64;
            let mean = values.iter().sum::<f64>() / count;
            let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
            // Differences of whole numbers are exact; the variance is a difference of squares of 1e6.
            prop_assert!((found.x, found.y) == (x / count, y / count));
            prop_assert!((found.variance - variance).abs() < 1e-8 * variance);
        }

        #[test]
        fn blockiness_is_that_of_the_steps_one_by_one(pixels in pictures(), left in 0usize..9, top in 0usize..9) {
            let image = Image::new(&pixels, ROWS, COLUMNS, COLUMNS).unwrap();
            let (at, mut edge, mut middle) = (plain(&pixels), 1e-9, 1e-9);
            for r in 0..ROWS - 1 {
                for c in 0..COLUMNS - 1 {
                    for (place, step) in [(left + c + 1, at(r, c + 1)), (top + r + 1, at(r + 1, c))] {
                        match place % 8 {
                            0 => edge += (step - at(r, c)).abs(),
                            4 => middle += (step - at(r, c)).abs(),
                            _ => {}
                        }
                    }
                }
            }
            let found = on_both(|| blockiness(&image, left, top));
            prop_assert!((found - (edge / middle - 1.0)).abs() < 1e-12 * edge / middle);
        }
    }

    #[test]
    fn blocks_that_stood_still_count_by_their_texture_and_flat_ones_for_nothing() {
        let now: Vec<u8> = (0..32 * 32).map(|k| (k * 7 % 251) as u8).collect();
        let mut before = now.clone();
        for row in before.chunks_mut(32) {
            row[16..].iter_mut().for_each(|value| *value ^= 1);
        }
        let [one, other] = [&now, &before].map(|pixels| Image::new(pixels, 32, 32, 32).unwrap());
        let found = on_both(|| frozen_texture(&one, &other, 0, 0));
        let half = Image::new(&now, 32, 16, 32).unwrap();
        assert_eq!(found.frozen, frozen_texture(&half, &half, 0, 0).whole);
        assert!(found.whole > 1.5 * found.frozen);
        let flat = [9u8; 32 * 32];
        let flat = Image::new(&flat, 32, 32, 32).unwrap();
        assert_eq!(frozen_texture(&flat, &flat, 3, 5), Texture::default());
        assert!(same(&one, &one) && !same(&one, &other) && !same(&one, &half));
    }

    #[test]
    fn pictures_smaller_than_a_block_tell_nothing_and_do_no_harm() {
        let pixels = [5u8; 4];
        for (rows, columns) in [(0, 0), (1, 1), (2, 2), (0, 2), (2, 0)] {
            let image = Image::new(&pixels, rows, columns, columns).unwrap();
            assert!(detail(&image, 1).x.is_nan());
            assert_eq!((stair_share(&image, 0, 0), blockiness(&image, 0, 0)), (0.0, 0.0));
            assert_eq!(frozen_texture(&image, &image, 0, 0), Texture::default());
            assert_eq!(share_at_ends(&image), if rows * columns > 0 { 1.0 } else { 0.0 });
        }
    }
}
