//! What light takes of a picture: the share of the contrast, squared, that is no longer the reference's.
//!
//! Under light from another side a picture is a · reference + b · something else. Both pictures are means of 3 by 3
//! pixels, the present one interpolated linearly where the target lies, and are compared in blocks: 1 - correlation²
//! of each, of which the middle one counts, weighted by the blocks' contrast in the reference.

use super::image::{Image, Level, Pixel, Region};
use super::picture::adds_up;
use super::vector::{sums, vectorised};

/// Means of squares of this side (px) are compared.
const THINNED: usize = 3;
/// Blocks a side: what hides less than half of them is no light. A block has this many means a side at least.
const BLOCKS: usize = 4;
const MIN_BLOCK: usize = 5;
/// Pixels near the top of 8 bits are cut off: more light changes them without any shading.
const CLIPPED: f64 = 250.0;
/// A frame whose mean is above black by less than this share of full scale is dark; black is 0, or in video of limited
/// range 16 of 255 (ITU-R BT.601): then its darkest pixels are near that.
const DARK_SHARE: f64 = 0.02;
const VIDEO_BLACK: f64 = 16.0 / 255.0;
const NEAR_BLACK: f64 = 0.75;
/// One in this many rows and columns tells a frame's darkest and brightest pixels, and these shares of them which.
const DARK_STEP: usize = 4;
const DARKEST: f64 = 0.01;
const BRIGHTEST: f64 = 0.99;

/// A picture of means (rows, columns), row by row.
#[derive(Clone, Debug, PartialEq)]
struct Means {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

/// The reference that a target's pictures are compared with.
pub struct Reference {
    region: Region,
    /// Values from this one on are cut off and left out.
    full: f64,
    means: Option<Means>,
}

impl Reference {
    /// `region` of an image.
    pub fn new<T: Pixel>(image: &Image<'_, T>, region: Region) -> Self {
        let full = if T::FULL_SCALE == Some(255.0) { CLIPPED } else { f64::INFINITY };
        Self { region, full, means: means_at(image, region, [0.0; 2]) }
    }

    /// Share (0 to 1) of the target's picture that is not the reference's, where it lies `shift` (x, y) px from its
    /// region; None where either leaves the image.
    pub fn unlike<T: Pixel>(&self, image: &Image<'_, T>, shift: [f64; 2]) -> Option<f64> {
        let reference = self.means.as_ref()?;
        Some(unlike(reference, &means_at(image, self.region, shift)?, self.full))
    }
}

/// Means of squares of pixels of a region that is moved; None where it leaves the image.
fn means_at<T: Pixel>(image: &Image<'_, T>, region: Region, shift: [f64; 2]) -> Option<Means> {
    let whole = shift.map(f64::floor);
    let size = [region.width, region.height].map(|side| side / THINNED * THINNED);
    if size[0] == 0 || size[1] == 0 || !whole.iter().all(|step| step.abs() < 1e9) {
        return None;
    }
    let place = Region {
        x: region.x + whole[0] as i64,
        y: region.y + whole[1] as i64,
        width: size[0] + 1,
        height: size[1] + 1,
    };
    Some(means(&image.cut(place)?, shift[0] - whole[0], shift[1] - whole[1]))
}

vectorised! {
/// Means of 3 by 3 pixels of a picture moved by parts of a pixel (0 to 1), linearly interpolated.
///
/// Of four neighbours the middle two count whole and the outer ones by the parts, along both axes.
fn means<T: Pixel>(cut: &Image<'_, T>, across: f64, down: f64) -> Means {
    let (rows, columns) = ((cut.rows - 1) / THINNED, (cut.columns - 1) / THINNED);
    let mut values = Vec::with_capacity(rows * columns);
    let mut line = vec![0.0; cut.columns];
    for r in 0..rows {
        let [first, second, third, last] = [0, 1, 2, 3].map(|k| &cut.row(THINNED * r + k)[..line.len()]);
        for (c, sum) in line.iter_mut().enumerate() {
            let inner = (second[c].level() + third[c].level()).number();
            *sum = (1.0 - down) * first[c].level().number() + inner + down * last[c].level().number();
        }
        let ends = line[THINNED..].iter().step_by(THINNED);
        let scale = 1.0 / (THINNED * THINNED) as f64;
        values.extend(line.chunks_exact(THINNED).zip(ends).map(|(three, end)| {
            scale * ((1.0 - across) * three[0] + (three[1] + three[2]) + across * end)
        }));
    }
    Means { rows, columns, values }
}
}

/// Sums over the pixels of a block of two pictures, each less its middle level, that are not cut off.
#[derive(Clone, Copy, Default)]
struct Block {
    count: f64,
    own: f64,
    its: f64,
    own_square: f64,
    product: f64,
    its_square: f64,
}

/// The share of a picture that is not the reference's, of two of one size.
fn unlike(reference: &Means, now: &Means, full: f64) -> f64 {
    let side = (reference.rows.min(reference.columns) / MIN_BLOCK).clamp(1, BLOCKS);
    let mut shares: Vec<[f64; 2]> = block_sums(reference, now, full, side)
        .into_iter()
        .filter(|block| block.count > 0.0)
        .map(|block| {
            let contrast = block.own_square - block.own * block.own / block.count;
            let its = block.its_square - block.its * block.its / block.count;
            let both = (block.product - block.own * block.its / block.count).max(0.0);
            [1.0 - (both * both / (contrast * its).max(1e-12)).min(1.0), contrast]
        })
        .collect();
    shares.sort_by(|one, other| one[0].total_cmp(&other[0]));
    let half = 0.5 * shares.iter().map(|share| share[1]).sum::<f64>();
    let mut reached = 0.0;
    let middle = shares.iter().find(|share| {
        reached += share[1];
        reached >= half
    });
    middle.or(shares.last()).map_or(0.0, |share| share[0])
}

/// First places of `side` blocks over a length and its end; the first ones are longer by one where it does not divide.
fn edges(length: usize, side: usize) -> impl Iterator<Item = [usize; 2]> {
    let (size, more) = (length / side, length % side);
    let edge = move |k: usize| k * size + k.min(more);
    (0..side).map(move |k| [edge(k), edge(k + 1)])
}

vectorised! {
fn block_sums(reference: &Means, now: &Means, full: f64, side: usize) -> Vec<Block> {
    let columns = reference.columns;
    let middle = reference.rows / 2 * columns + columns / 2;
    let (level, other) = (reference.values[middle], now.values[middle]);
    let mut blocks = vec![Block::default(); side * side];
    for (strip, [top, bottom]) in blocks.chunks_exact_mut(side).zip(edges(reference.rows, side)) {
        for r in top..bottom {
            for (block, [left, right]) in strip.iter_mut().zip(edges(columns, side)) {
                let part = r * columns + left..r * columns + right;
                let rows = [&reference.values[part.clone()], &now.values[part]];
                let [count, own, its, own_square, product, its_square] = sums(rows, |[own, its]| {
                    let keep = own < full && its < full;
                    let (own, its) = if keep { (own - level, its - other) } else { (0.0, 0.0) };
                    [f64::from(u8::from(keep)), own, its, own * own, own * its, its * its]
                });
                block.count += count;
                block.own += own;
                block.its += its;
                block.own_square += own_square;
                block.product += product;
                block.its_square += its_square;
            }
        }
    }
    blocks
}
}

/// Whether an image is black: neither its mean nor its brightest pixels leave the bottom of the scale.
///
/// One in `step` rows and columns is looked at. Only whole numbers have a scale.
pub fn is_dark<T: Pixel>(image: &Image<'_, T>, step: usize) -> bool {
    let Some(scale) = T::FULL_SCALE else { return false };
    let image = image.thinned(step);
    let size = image.rows * image.columns.div_ceil(step);
    if size == 0 || adds_up(&image, step, (VIDEO_BLACK + DARK_SHARE) * scale * size as f64) {
        return false;
    }
    let thinned = image.thinned(DARK_STEP);
    let rows = (0..thinned.rows).flat_map(|r| thinned.row(r).iter().step_by(step * DARK_STEP));
    let mut values: Vec<f64> = rows.map(|value| value.level().number()).collect();
    values.sort_by(f64::total_cmp);
    let at_share = |share: f64| {
        let place = share * (values.len() - 1) as f64;
        let (below, part) = (place as usize, place.fract());
        values[below] + part * (values[(below + 1).min(values.len() - 1)] - values[below])
    };
    let black = if at_share(DARKEST) > NEAR_BLACK * VIDEO_BLACK * scale { VIDEO_BLACK * scale } else { 0.0 };
    at_share(BRIGHTEST) < black + 2.0 * DARK_SHARE * scale
        && !adds_up(&image, step, (black + DARK_SHARE * scale) * size as f64)
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;

    fn picture(rows: usize, columns: usize) -> Vec<u8> {
        (0..rows * columns)
            .map(|k| (120.0 + 60.0 * (k as f64 * 0.37).sin() + 40.0 * (k as f64 * 1.7).cos()) as u8)
            .collect()
    }

    #[test]
    fn means_are_those_of_the_interpolated_pixels_one_by_one() {
        let pixels = picture(26, 32);
        let image = Image::new(&pixels, 26, 32, 32).unwrap();
        let (region, shift) = (Region { x: 3, y: 2, width: 25, height: 19 }, [1.3, -0.6]);
        let found = on_both(|| means_at(&image, region, shift)).unwrap();
        assert_eq!((found.rows, found.columns), (6, 8));
        let at = |r: f64, c: f64| {
            let (row, column) = (r.floor() as usize, c.floor() as usize);
            let (down, across) = (r.fract(), c.fract());
            let pixel = |r: usize, c: usize| f64::from(pixels[r * 32 + c]);
            let line = |r: usize| (1.0 - across) * pixel(r, column) + across * pixel(r, column + 1);
            (1.0 - down) * line(row) + down * line(row + 1)
        };
        for (k, value) in found.values.iter().enumerate() {
            let (r, c) = (k / 8 * 3, k % 8 * 3);
            let sum: f64 = (0..9).map(|j| at(1.4 + (r + j / 3) as f64, 4.3 + (c + j % 3) as f64)).sum();
            // Nine values up to 255: rounding at 1e-13.
            assert!((value - sum / 9.0).abs() < 1e-11, "{k}");
        }
    }

    #[test]
    fn a_picture_under_other_light_is_unlike_by_its_share_and_a_brighter_one_is_not() {
        let pixels = picture(64, 64);
        let brighter: Vec<f64> = pixels.iter().map(|&v| 20.0 + 1.5 * f64::from(v)).collect();
        let [image, other] = [pixels.iter().map(|&v| f64::from(v)).collect(), brighter];
        let [image, other] = [&image, &other].map(|p: &Vec<f64>| Image::new(p, 64, 64, 64).unwrap());
        let reference = Reference::new(&image, Region { x: 2, y: 2, width: 60, height: 60 });
        assert!(on_both(|| reference.unlike(&other, [0.0; 2])).unwrap() < 1e-12);
        assert!(reference.unlike(&other, [1.5, 0.0]).unwrap() > 0.01);
        assert_eq!(reference.unlike(&other, [-2.5, 0.0]), None);
        assert_eq!(reference.unlike(&other, [f64::NAN, 0.0]), None);
    }

    #[test]
    fn blocks_are_as_even_as_they_can_be() {
        assert_eq!(edges(11, 4).collect::<Vec<_>>(), [[0, 3], [3, 6], [6, 9], [9, 11]]);
        assert_eq!(edges(2, 2).collect::<Vec<_>>(), [[0, 1], [1, 2]]);
    }

    #[test]
    fn black_is_dark_and_a_lamp_in_it_is_not() {
        let mut pixels = vec![17u8; 120 * 160];
        let dark = |pixels: &[u8]| {
            let image = Image::new(pixels, 120, 160, 160).unwrap();
            [1, 4].map(|step| on_both(|| is_dark(&image, step)))
        };
        assert_eq!(dark(&pixels), [true; 2]);
        pixels[60 * 160..80 * 160].fill(180);
        assert_eq!([dark(&pixels), dark(&[40; 120 * 160]), dark(&[3; 120 * 160])], [[false; 2], [false; 2], [true; 2]]);
    }
}
