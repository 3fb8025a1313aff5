//! SURF: blobs by box filters on an integral image, and their descriptors of 64 values.
//!
//! Bay, Tuytelaars and Van Gool, "SURF: speeded up robust features", 2006, doi 10.1007/11744023_32. Derivatives of a
//! Gaussian are replaced by boxes of sizes 9, 15, 21, 27 … px, a filter of size L standing for the scale 1.2 L / 9 px.
//! A blob is a maximum of the Hessian's determinant over position and scale, refined by a quadratic in all three.

use super::image::Image;
use super::integral::Integral;
use super::surf_descriptor::{Descriptor, describe};
use super::vector::{dot_f64, sum_f64, vectorised};

/// Scale of a filter, px, by its size.
pub const SCALE_OF_SIZE: f64 = 1.2 / 9.0;
/// Filters in an octave; a blob is found in one of the two in the middle.
const LAYERS: usize = 4;
/// Balances the box form of the mixed derivative, 0.9 squared.
const CROSS_WEIGHT: f64 = 0.81;
/// A quadratic's peak farther from the largest sample than this is not trusted, in samples.
const LARGEST_STEP: f64 = 1.0;

/// Which blobs are kept.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Doublings of the filters' size.
    pub octaves: u32,
    /// Least determinant, in the image's variance or in `contrast` where that is less.
    pub threshold: f64,
    /// How many of the strongest are kept.
    pub most: usize,
    /// Without orientation.
    pub upright: bool,
    /// As the image's variance.
    pub contrast: f64,
    /// The same in squared values of the image; the greater counts.
    pub least: f64,
}

/// A blob of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blob {
    /// Column, px.
    pub x: f64,
    /// Row, px.
    pub y: f64,
    /// Filter size, px.
    pub size: f64,
    /// Determinant of the Hessian.
    pub strength: f64,
    /// Whether it is a dark blob on bright ground.
    pub dark: bool,
}

/// The blobs of an image, strongest first, with their descriptors.
pub fn detect(image: &Image<'_, f32>, settings: &Settings) -> Vec<(Blob, Descriptor)> {
    if image.rows == 0 || image.columns == 0 {
        return Vec::new();
    }
    let (mean, variance) = moments(image);
    // What lies outside the image counts as its mean, so that the level does not enter the descriptors at its edge.
    let integral = Integral::of(image, mean as f32);
    let blobs = find(&integral, settings, variance.min(settings.contrast));
    let descriptors = describe(&integral, &blobs, settings.upright);
    blobs.into_iter().zip(descriptors).collect()
}

/// Mean and variance.
fn moments(image: &Image<'_, f32>) -> (f64, f64) {
    let count = (image.rows * image.columns) as f64;
    let rows = || (0..image.rows).map(|r| image.row(r));
    let mean = rows().map(sum_f64).sum::<f64>() / count;
    let deviations = |row: &[f32]| row.iter().map(|value| value - mean as f32).collect::<Vec<f32>>();
    let variance = rows().map(deviations).map(|row| dot_f64(&row, &row)).sum::<f64>() / count;
    (mean, variance)
}

/// Box sizes in px of the octave 0, 1, …: 9, 15, 21, 27; 15, 27, 39, 51; 27, 51, 75, 99; …
pub fn filter_sizes(octave: u32) -> [usize; LAYERS] {
    std::array::from_fn(|k| 3 * ((2usize << octave) * (k + 1) + 1))
}

/// Blobs strongest first; `variance` scales the threshold.
pub fn find(integral: &Integral, settings: &Settings, variance: f64) -> Vec<Blob> {
    let mut blobs = Vec::new();
    for octave in 0..settings.octaves {
        let (sizes, step) = (filter_sizes(octave), 1usize << octave);
        if sizes[LAYERS - 1] + 2 * step > integral.rows.min(integral.columns) {
            break;
        }
        let octave = Octave { layers: sizes.map(|size| hessian(integral, size, step)), sizes, step };
        peaks(integral, &octave, (settings.threshold * variance).max(settings.least) as f32, &mut blobs);
    }
    blobs.sort_by(|one, other| other.strength.total_cmp(&one.strength));
    blobs.truncate(settings.most);
    blobs
}

/// Determinant of the Hessian at every `step`-th pixel (rows, columns), by the boxes' areas; 0 where one leaves the
/// image.
pub struct Hessian {
    rows: usize,
    columns: usize,
    /// Row by row.
    pub determinant: Vec<f32>,
}

/// The Hessians of filters of neighbouring sizes, px, at every `step`-th pixel.
struct Octave {
    layers: [Hessian; LAYERS],
    sizes: [usize; LAYERS],
    step: usize,
}

/// Differences of the integral image's rows that a line of the Hessian is made of, column by column.
struct Lines {
    across: Vec<f64>,
    along: Vec<f64>,
    mixed: Vec<f64>,
}

vectorised! {
/// The Hessian by boxes of `size` px (9, 15, …).
pub fn hessian(integral: &Integral, size: usize, step: usize) -> Hessian {
    let (rows, columns) = (integral.rows.div_ceil(step), integral.columns.div_ceil(step));
    let mut found = Hessian { rows, columns, determinant: vec![0.0; rows * columns] };
    let (lobe, half) = (size / 3, size / 2);
    let third = lobe / 2;
    let area = 1.0 / (size * size) as f64;
    let first = half.div_ceil(step);
    let (Some(last_row), Some(last_column)) = (integral.rows.checked_sub(half + 1), integral.columns.checked_sub(half + 1))
    else {
        return found;
    };
    if last_column / step < first {
        return found;
    }
    // A line is worked on in contiguous parts, all columns at once, and every `step`-th of them is kept.
    let (begin, width) = (first * step, step * (last_column / step - first) + 1);
    let mut lines = Lines {
        across: vec![0.0; integral.columns + 1],
        along: vec![0.0; integral.columns + 1],
        mixed: vec![0.0; integral.columns + 1],
    };
    let mut line = vec![0f32; width];
    for i in (first..rows).take_while(|i| i * step <= last_row) {
        row_differences(integral, i * step, [lobe, half, third], &mut lines);
        line_of_hessian(&lines, begin, [lobe, half, third], area, &mut line);
        let place = i * columns + first..i * columns + last_column / step + 1;
        for (value, new) in found.determinant[place].iter_mut().zip(line.iter().step_by(step)) {
            *value = *new;
        }
    }
    found
}
}

#[inline(always)]
fn row_differences(integral: &Integral, r: usize, [lobe, half, third]: [usize; 3], lines: &mut Lines) {
    let (bottom, top) = (integral.row(r + lobe), integral.row(r + 1 - lobe));
    for ((out, bottom), top) in lines.across.iter_mut().zip(bottom).zip(top) {
        *out = bottom - top;
    }
    let (bottom, top) = (integral.row(r + half + 1), integral.row(r - half));
    let (below, above) = (integral.row(r + third + 1), integral.row(r - third));
    for ((((out, bottom), top), below), above) in lines.along.iter_mut().zip(bottom).zip(top).zip(below).zip(above) {
        *out = (bottom - top) - 3.0 * (below - above);
    }
    let (here, above) = (integral.row(r), integral.row(r - lobe));
    let (far, below) = (integral.row(r + lobe + 1), integral.row(r + 1));
    for ((((out, here), above), far), below) in lines.mixed.iter_mut().zip(here).zip(above).zip(far).zip(below) {
        *out = (here - above) - (far - below);
    }
}

#[inline(always)]
fn line_of_hessian(lines: &Lines, begin: usize, [lobe, half, third]: [usize; 3], area: f64, determinant: &mut [f32]) {
    let width = determinant.len();
    let across = |from: usize| &lines.across[from..from + width];
    let along = |from: usize| &lines.along[from..from + width];
    let mixed = |from: usize| &lines.mixed[from..from + width];
    let (outer_right, outer_left) = (across(begin + half + 1), across(begin - half));
    let (inner_right, inner_left) = (across(begin + third + 1), across(begin - third));
    let (right, left) = (along(begin + lobe), along(begin + 1 - lobe));
    let (far_right, near_right) = (mixed(begin + lobe + 1), mixed(begin + 1));
    let (near_left, far_left) = (mixed(begin), mixed(begin - lobe));
    for j in 0..width {
        let xx = outer_right[j] - outer_left[j] - 3.0 * (inner_right[j] - inner_left[j]);
        let yy = right[j] - left[j];
        let xy = far_right[j] - near_right[j] - near_left[j] + far_left[j];
        determinant[j] = ((xx * yy - CROSS_WEIGHT * xy * xy) * area * area) as f32;
    }
}

/// Sign of the Hessian's trace at a pixel where the box is inside the image: whether the blob is dark.
fn is_dark(integral: &Integral, size: usize, r: usize, c: usize) -> bool {
    let (lobe, half) = (size / 3, size / 2);
    let third = lobe / 2;
    let sum = |rows: [usize; 2], columns: [usize; 2]| {
        let (above, below) = (integral.row(rows[0]), integral.row(rows[1]));
        below[columns[1]] - below[columns[0]] - (above[columns[1]] - above[columns[0]])
    };
    let [wide, narrow] = [half, third].map(|reach| move |at: usize| [at - reach, at + reach + 1]);
    let band = |at: usize| [at + 1 - lobe, at + lobe];
    let xx = sum(band(r), wide(c)) - 3.0 * sum(band(r), narrow(c));
    let yy = sum(wide(r), band(c)) - 3.0 * sum(narrow(r), band(c));
    xx + yy >= 0.0
}

vectorised! {
/// Whether each sample of a row exceeds a threshold and none of its neighbours along each axis exceeds it.
fn candidates(layers: &[Hessian; 3], row: usize, threshold: f32, out: &mut [bool]) {
    let columns = layers[1].columns;
    let count = columns - 2;
    let [below, here, above] = [0, 1, 2].map(|k| &layers[k].determinant[row * columns + 1..][..count]);
    let line = &layers[1].determinant[(row - 1) * columns..(row + 2) * columns];
    let (left, right) = (&line[columns..][..count], &line[columns + 2..][..count]);
    let (up, down) = (&line[1..][..count], &line[2 * columns + 1..][..count]);
    for (c, out) in out[1..=count].iter_mut().enumerate() {
        let value = here[c];
        let in_row = (value > threshold) & (value >= left[c]) & (value >= right[c]);
        *out = in_row & (value >= up[c]) & (value >= down[c]) & (value >= below[c]) & (value >= above[c]);
    }
}
}

/// Blobs of an octave: samples that no neighbour in scale and position exceeds.
fn peaks(integral: &Integral, octave: &Octave, threshold: f32, blobs: &mut Vec<Blob>) {
    let Octave { layers, sizes, step } = octave;
    let (rows, columns) = (layers[0].rows, layers[0].columns);
    let mut candidate = vec![false; columns];
    for k in 1..LAYERS - 1 {
        let rim = (sizes[k + 1] / 2).div_ceil(*step) + 1;
        let Some(three) = layers[k - 1..].first_chunk() else { continue };
        for r in rim..rows.saturating_sub(rim) {
            candidates(three, r, threshold, &mut candidate);
            for c in (rim..columns.saturating_sub(rim)).filter(|&c| candidate[c]) {
                let near = |dk: usize, dr: usize, dc: usize| three[dk].determinant[(r + dr - 1) * columns + c + dc - 1];
                if !is_peak(near(1, 1, 1), near) {
                    continue;
                }
                let Some([scale, down, right]) = refine(near) else { continue };
                blobs.push(Blob {
                    x: (c as f64 + right) * *step as f64,
                    y: (r as f64 + down) * *step as f64,
                    size: sizes[k] as f64 + scale * (sizes[k + 1] - sizes[k]) as f64,
                    strength: f64::from(near(1, 1, 1)),
                    dark: is_dark(integral, sizes[k], r * step, c * step),
                });
            }
        }
    }
}

/// Whether no neighbour exceeds the middle of three samples along each axis; of equal ones the first in memory is
/// taken.
fn is_peak(value: f32, near: impl Fn(usize, usize, usize) -> f32) -> bool {
    (0..27).filter(|&place| place != 13).all(|place| {
        let other = near(place / 9, place / 3 % 3, place % 3);
        !(other > value || (place < 13 && other == value))
    })
}

/// Offsets in samples along scale, rows and columns of the quadratic's peak; None where it has none nearby.
fn refine(near: impl Fn(usize, usize, usize) -> f32) -> Option<[f64; 3]> {
    let s = |k, r, c| f64::from(near(k, r, c));
    let middle = s(1, 1, 1);
    let g = [s(2, 1, 1) - s(0, 1, 1), s(1, 2, 1) - s(1, 0, 1), s(1, 1, 2) - s(1, 1, 0)].map(|value| 0.5 * value);
    let a = s(2, 1, 1) + s(0, 1, 1) - 2.0 * middle;
    let b = s(1, 2, 1) + s(1, 0, 1) - 2.0 * middle;
    let d = s(1, 1, 2) + s(1, 1, 0) - 2.0 * middle;
    let ab = 0.25 * (s(2, 2, 1) - s(2, 0, 1) - s(0, 2, 1) + s(0, 0, 1));
    let ad = 0.25 * (s(2, 1, 2) - s(2, 1, 0) - s(0, 1, 2) + s(0, 1, 0));
    let bd = 0.25 * (s(1, 2, 2) - s(1, 2, 0) - s(1, 0, 2) + s(1, 0, 0));
    let minor = [b * d - bd * bd, ad * bd - ab * d, ab * bd - ad * b];
    let determinant = a * minor[0] + ab * minor[1] + ad * minor[2];
    // A maximum in three dimensions has three negative curvatures.
    if determinant >= 0.0 {
        return None;
    }
    let (across, mixed) = (a * d - ad * ad, ab * ad - a * bd);
    let step = [
        -(minor[0] * g[0] + minor[1] * g[1] + minor[2] * g[2]) / determinant,
        -(minor[1] * g[0] + across * g[1] + mixed * g[2]) / determinant,
        -(minor[2] * g[0] + mixed * g[1] + (a * b - ab * ab) * g[2]) / determinant,
    ];
    step.iter().all(|value| value.abs() <= LARGEST_STEP).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;

    fn noise(rows: usize, columns: usize) -> Vec<f32> {
        let mut seed = 5u64;
        (0..rows * columns)
            .map(|_| {
                seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                ((seed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 70.0
            })
            .collect()
    }

    /// The published filters as dense masks (size, size): xx, xy.
    fn masks(size: usize) -> [Vec<f64>; 2] {
        let (lobe, half) = (size / 3, size / 2);
        let (mut xx, mut xy) = (vec![0.0; size * size], vec![0.0; size * size]);
        for r in 0..size {
            for c in 0..size {
                if (half + 1 - lobe..half + lobe).contains(&r) {
                    xx[r * size + c] = if (lobe..2 * lobe).contains(&c) { -2.0 } else { 1.0 };
                }
                let part = |place: usize| match place {
                    _ if (half - lobe..half).contains(&place) => -1.0,
                    _ if (half + 1..half + 1 + lobe).contains(&place) => 1.0,
                    _ => 0.0,
                };
                xy[r * size + c] = -part(r) * part(c);
            }
        }
        [xx, xy]
    }

    #[test]
    fn the_box_hessian_equals_direct_sums_with_dense_masks() {
        let pixels = noise(90, 110);
        let integral = Integral::of(&Image::new(&pixels, 90, 110, 110).unwrap(), 0.0);
        for (size, step) in [(9, 1), (15, 1), (27, 2), (39, 4)] {
            let found = on_both(|| {
                let found = hessian(&integral, size, step);
                (found.columns, found.determinant)
            });
            let ([of_xx, of_xy], half) = (masks(size), size / 2);
            let corner = half.div_ceil(step) * step;
            for (r, c) in [(48, 52), (44, 60), (corner, corner)] {
                let sum = |weight: &dyn Fn(usize, usize) -> f64| -> f64 {
                    let at = |k: usize| {
                        weight(k / size, k % size)
                            * f64::from(pixels[(r + k / size - half) * 110 + c + k % size - half])
                    };
                    (0..size * size).map(at).sum::<f64>() / (size * size) as f64
                };
                let xx = sum(&|i, j| of_xx[i * size + j]);
                let yy = sum(&|i, j| of_xx[j * size + i]);
                let xy = sum(&|i, j| of_xy[i * size + j]);
                let place = r / step * found.0 + c / step;
                // Results are of single precision: seven digits.
                let determinant = xx * yy - 0.81 * xy * xy;
                assert!((f64::from(found.1[place]) - determinant).abs() < 1e-5 * determinant.abs() + 1e-6);
                assert_eq!(is_dark(&integral, size, r, c), xx + yy >= 0.0);
            }
            assert!(found.1[..half / step * found.0].iter().all(|&value| value == 0.0));
        }
    }

    #[test]
    fn filter_sizes_are_the_published_ones_and_small_images_have_no_blobs() {
        assert_eq!([0, 1, 2].map(filter_sizes), [[9, 15, 21, 27], [15, 27, 39, 51], [27, 51, 75, 99]]);
        let settings =
            Settings { octaves: 3, threshold: 0.002, most: 400, upright: true, contrast: f64::INFINITY, least: 0.0 };
        for (rows, columns) in [(0, 0), (1, 1), (20, 20), (3, 90)] {
            let pixels = noise(rows, columns);
            assert!(detect(&Image::new(&pixels, rows, columns, columns).unwrap(), &settings).is_empty());
        }
    }

    #[test]
    fn a_blob_of_either_sign_is_found_at_its_centre_strongest_first() {
        for sign in [1.0, -1.0] {
            let at = |r: usize, c: usize, x: f64, y: f64, size: f64| {
                sign * size * (-((c as f64 - x).powi(2) + (r as f64 - y).powi(2)) / 18.0).exp()
            };
            let pixel = |k: usize| at(k / 110, k % 110, 40.3, 45.7, 80.0) + at(k / 110, k % 110, 75.8, 50.2, 50.0);
            let pixels: Vec<f32> = (0..100 * 110).map(|k| pixel(k) as f32).collect();
            let settings =
                Settings { octaves: 2, threshold: 0.01, most: 400, upright: true, contrast: f64::INFINITY, least: 0.0 };
            let found = on_both(|| detect(&Image::new(&pixels, 100, 110, 110).unwrap(), &settings));
            for (blob, (x, y)) in found.iter().map(|one| one.0).zip([(40.3, 45.7), (75.8, 50.2)]) {
                assert!((blob.x - x).hypot(blob.y - y) < 0.1 && blob.dark == (sign < 0.0), "{blob:?}");
            }
        }
    }
}
