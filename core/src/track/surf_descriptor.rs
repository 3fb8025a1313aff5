//! SURF's descriptors: sums of Haar wavelets' responses about a blob, 64 values of unit length.
//!
//! Four sums (dx, dy, |dx|, |dy|) over 4 by 4 fields of 5 by 5 responses, in the blob's frame or upright. What lies
//! outside the image is left out.

use super::integral::Integral;
use super::surf::{Blob, SCALE_OF_SIZE};
use super::vector::vectorised;
use std::f64::consts::{PI, TAU};

/// Values of a descriptor.
pub const VALUES: usize = 64;
/// A descriptor.
pub type Descriptor = [f32; VALUES];
/// Responses along a side, and in a field's.
const SIDE: usize = 20;
const FIELD: usize = 5;
/// Of the Gaussian that responses are weighted by, in samples.
const WINDOW_STD: f64 = 3.3;
/// Directions that the responses are sorted into.
const SECTORS: usize = 72;

/// Descriptors of blobs.
pub fn describe(integral: &Integral, blobs: &[Blob], upright: bool) -> Vec<Descriptor> {
    let window = std::array::from_fn(|k| (-(k as f64 - 9.5).powi(2) / (2.0 * WINDOW_STD * WINDOW_STD)).exp());
    let of_blob =
        |blob: &Blob| if upright { along_axes(integral, blob, &window) } else { turned(integral, blob, &window) };
    blobs.iter().map(|blob| to_unit_length(&of_blob(blob))).collect()
}

/// Sums of one field: dx, dy, |dx|, |dy|.
type Fields = [[f64; 4]; VALUES / 4];

fn to_unit_length(fields: &Fields) -> Descriptor {
    let values = fields.as_flattened();
    let length = values.iter().map(|value| value * value).sum::<f64>().sqrt();
    let factor = if length > 0.0 { 1.0 / length } else { 1.0 };
    std::array::from_fn(|k| (factor * values[k]) as f32)
}

/// A place inside 0 … `end`.
#[inline(always)]
fn inside(place: i64, end: usize) -> usize {
    place.clamp(0, end as i64) as usize
}

/// Haar wavelets along x and y about the pixel nearest to (x, y): right less left half, lower less upper half.
///
/// Each is a square of 2 `reach` px.
fn haar(integral: &Integral, x: f64, y: f64, reach: i64) -> [f64; 2] {
    let (rows, columns) = (integral.rows, integral.columns);
    let (c, r) = (x.round_ties_even() as i64, y.round_ties_even() as i64);
    let (left, right) = (inside(c - reach, columns), inside(c + reach, columns));
    let (top, bottom) = (integral.row(inside(r - reach, rows)), integral.row(inside(r + reach, rows)));
    let (c, middle) = (inside(c, columns), integral.row(inside(r, rows)));
    let across = bottom[right] - top[right] + bottom[left] - top[left] - 2.0 * (bottom[c] - top[c]);
    let down = bottom[right] - bottom[left] + top[right] - top[left] - 2.0 * (middle[right] - middle[left]);
    [across, down]
}

/// Direction (rad, x towards y) of the largest sum of Haar responses in a sector of 60 degrees, within 6 s.
fn orientation(integral: &Integral, blob: &Blob, scale: f64) -> f64 {
    let reach = (2.0 * scale).round_ties_even().max(1.0) as i64;
    let mut sums = [[0.0; 2]; SECTORS];
    for i in -5i32..=5 {
        for j in -5i32..=5 {
            let square = i * i + j * j;
            if square < 36 {
                let weight = (-f64::from(square) / 12.5).exp();
                let (x, y) = (blob.x + f64::from(j) * scale, blob.y + f64::from(i) * scale);
                let [dx, dy] = haar(integral, x, y, reach);
                let sector = ((dy.atan2(dx) + PI) * (SECTORS as f64 / TAU)) as usize % SECTORS;
                sums[sector][0] += weight * dx;
                sums[sector][1] += weight * dy;
            }
        }
    }
    let (mut best, mut direction) = (-1.0, 0.0);
    for start in 0..SECTORS {
        let (mut x, mut y) = (0.0, 0.0);
        for k in start..start + SECTORS / 6 {
            x += sums[k % SECTORS][0];
            y += sums[k % SECTORS][1];
        }
        if x * x + y * y > best {
            best = x * x + y * y;
            direction = y.atan2(x);
        }
    }
    direction
}

/// Sums in the blob's frame.
fn turned(integral: &Integral, blob: &Blob, window: &[f64; SIDE]) -> Fields {
    let scale = blob.size * SCALE_OF_SIZE;
    let reach = scale.round_ties_even().max(1.0) as i64;
    let (sin, cos) = orientation(integral, blob, scale).sin_cos();
    let mut fields = [[0.0; 4]; VALUES / 4];
    for i in 0..SIDE {
        for j in 0..SIDE {
            let (u, v) = (j as f64 - 9.5, i as f64 - 9.5);
            let (x, y) = (blob.x + scale * (cos * u - sin * v), blob.y + scale * (sin * u + cos * v));
            let [right, down] = haar(integral, x, y, reach);
            let weight = window[i] * window[j];
            add(&mut fields, i, j, weight * (cos * right + sin * down), weight * (cos * down - sin * right));
        }
    }
    fields
}

#[inline(always)]
fn add(fields: &mut Fields, i: usize, j: usize, dx: f64, dy: f64) {
    let field = &mut fields[4 * (i / FIELD) + j / FIELD];
    field[0] += dx;
    field[1] += dy;
    field[2] += dx.abs();
    field[3] += dy.abs();
}

/// Places of 20 wavelets along an axis: where each begins, its middle and its end.
#[inline(always)]
fn places(centre: f64, scale: f64, reach: i64, end: usize) -> [[usize; 3]; SIDE] {
    let mut places = [[0; 3]; SIDE];
    for (k, wavelet) in places.iter_mut().enumerate() {
        let place = (centre + scale * (k as f64 - 9.5)).round_ties_even() as i64;
        *wavelet = [inside(place - reach, end), inside(place, end), inside(place + reach, end)];
    }
    places
}

vectorised! {
/// Sums without orientation: all wavelets lie on 20 rows and 20 columns.
///
/// Of each row of wavelets two lines are made first: lower less upper edge, and both less twice the middle.
fn along_axes(integral: &Integral, blob: &Blob, window: &[f64; SIDE]) -> Fields {
    let scale = blob.size * SCALE_OF_SIZE;
    let reach = scale.round_ties_even().max(1.0) as i64;
    let (rows, mut columns) = (places(blob.y, scale, reach, integral.rows), places(blob.x, scale, reach, integral.columns));
    let (begin, end) = (columns[0][0], columns[SIDE - 1][2] + 1);
    columns.iter_mut().flatten().for_each(|place| *place -= begin);
    let (mut across, mut down) = (vec![0.0; end - begin], vec![0.0; end - begin]);
    let mut fields = [[0.0; 4]; VALUES / 4];
    for (i, places) in rows.into_iter().enumerate() {
        let [top, middle, bottom] = places.map(|place| &integral.row(place)[begin..end]);
        for ((out, bottom), top) in across.iter_mut().zip(bottom).zip(top) {
            *out = bottom - top;
        }
        for (((out, bottom), top), middle) in down.iter_mut().zip(bottom).zip(top).zip(middle) {
            *out = (bottom + top) - 2.0 * middle;
        }
        let (across, down) = (&across[..end - begin], &down[..end - begin]);
        let (mut dx, mut dy) = ([0.0; SIDE], [0.0; SIDE]);
        for (j, [left, centre, right]) in columns.iter().copied().enumerate() {
            dx[j] = window[i] * window[j] * (across[right] + across[left] - 2.0 * across[centre]);
            dy[j] = window[i] * window[j] * (down[right] - down[left]);
        }
        let strip = fields[SIDE / FIELD * (i / FIELD)..].iter_mut();
        for ((field, dx), dy) in strip.zip(dx.chunks_exact(FIELD)).zip(dy.chunks_exact(FIELD)) {
            let sum = |values: &[f64]| ((values[0] + values[1]) + (values[2] + values[3])) + values[4];
            let size = |values: &[f64]| {
                ((values[0].abs() + values[1].abs()) + (values[2].abs() + values[3].abs())) + values[4].abs()
            };
            *field = [field[0] + sum(dx), field[1] + sum(dy), field[2] + size(dx), field[3] + size(dy)];
        }
    }
    fields
}
}

#[cfg(test)]
mod tests {
    use super::super::image::Image;
    use super::super::vector::on_both;
    use super::*;

    fn blob(x: f64, y: f64, size: f64) -> Blob {
        Blob { x, y, size, strength: 1.0, dark: true }
    }

    fn picture() -> Vec<f32> {
        (0..90 * 110).map(|k| ((k * 7919 % 257) as f32).sqrt() * 9.0 - 100.0).collect()
    }

    #[test]
    fn haar_responses_are_differences_of_halves() {
        let pixels = picture();
        let integral = Integral::of(&Image::new(&pixels, 90, 110, 110).unwrap(), 0.0);
        let sum = |rows: std::ops::Range<usize>, columns: std::ops::Range<usize>| -> f64 {
            rows.flat_map(|r| pixels[r * 110..][columns.clone()].iter()).map(|&v| f64::from(v)).sum()
        };
        let [across, down] = haar(&integral, 60.2, 39.8, 5);
        assert!((across - sum(35..45, 60..65) + sum(35..45, 55..60)).abs() < 1e-6);
        assert!((down - sum(40..45, 55..65) + sum(35..40, 55..65)).abs() < 1e-6);
    }

    #[test]
    fn upright_descriptors_are_those_of_the_wavelets_one_by_one_and_have_unit_length() {
        let pixels = picture();
        let integral = Integral::of(&Image::new(&pixels, 90, 110, 110).unwrap(), 0.0);
        let window = [0.5; SIDE];
        for at in [blob(55.3, 44.1, 9.4), blob(3.0, 88.0, 15.0), blob(100.0, 10.0, 40.0)] {
            let found = on_both(|| along_axes(&integral, &at, &window));
            let scale = at.size * SCALE_OF_SIZE;
            let mut fields = [[0.0; 4]; VALUES / 4];
            for i in 0..SIDE {
                for j in 0..SIDE {
                    let (x, y) = (at.x + scale * (j as f64 - 9.5), at.y + scale * (i as f64 - 9.5));
                    let [dx, dy] = haar(&integral, x, y, scale.round_ties_even() as i64);
                    add(&mut fields, i, j, 0.25 * dx, 0.25 * dy);
                }
            }
            for (one, other) in found.as_flattened().iter().zip(fields.as_flattened()) {
                assert!((one - other).abs() < 1e-6);
            }
            for upright in [true, false] {
                let descriptor = describe(&integral, &[at], upright)[0];
                let square: f32 = descriptor.iter().map(|value| value * value).sum();
                assert!((square - 1.0).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn descriptors_move_with_the_image() {
        let pixels = picture();
        let whole = Integral::of(&Image::new(&pixels, 90, 110, 110).unwrap(), 0.0);
        let moved = Integral::of(&Image::new(&pixels[5 * 110 + 7..], 85, 103, 110).unwrap(), 0.0);
        for upright in [true, false] {
            let [here, there] = [
                describe(&whole, &[blob(55.2, 45.4, 12.0)], upright)[0],
                describe(&moved, &[blob(48.2, 40.4, 12.0)], upright)[0],
            ];
            assert!(here.iter().zip(there).all(|(one, other)| (one - other).abs() < 1e-5));
        }
    }
}
