//! An image sampled every half pixel, by six-point interpolation, mirrored at its edges.

use super::image::Image;
use super::vector::vectorised;

const HALFWAY: [f32; 6] = [3.0 / 256.0, -25.0 / 256.0, 150.0 / 256.0, 150.0 / 256.0, -25.0 / 256.0, 3.0 / 256.0];
/// Pixels before a half that its interpolation reaches over.
const BEFORE: usize = 2;

/// Number of samples every half pixel along a side.
pub fn doubled_side(side: usize) -> usize {
    (2 * side).saturating_sub(1)
}

vectorised! {
/// The image (2 rows - 1, 2 columns - 1), row by row.
pub fn doubled(image: &Image<'_, f32>) -> Vec<f32> {
    let (rows, columns) = (image.rows, image.columns);
    let width = doubled_side(columns);
    let mut out = vec![0f32; doubled_side(rows) * width];
    let (mut between, mut halves) = (vec![0f32; columns], vec![0f32; columns]);
    for (r, line) in out.chunks_exact_mut(width.max(1)).enumerate() {
        if r % 2 == 0 {
            fill_line(image.row(r / 2), &mut halves, line);
            continue;
        }
        between.fill(0.0);
        for (k, weight) in HALFWAY.iter().enumerate() {
            for (sum, value) in between.iter_mut().zip(image.row(mirrored(r / 2, k, rows))) {
                *sum += weight * value;
            }
        }
        fill_line(&between, &mut halves, line);
    }
    out
}
}

/// The place of the k-th of six samples about the half after `index`, mirrored at both ends.
#[inline(always)]
fn mirrored(index: usize, k: usize, size: usize) -> usize {
    if size == 1 {
        return 0;
    }
    let period = 2 * (size - 1);
    let place = (index + k + period * BEFORE - BEFORE) % period;
    if place < size { place } else { period - place }
}

/// A row and what lies halfway between its pixels, `halves`, one after the other.
#[inline(always)]
fn fill_line(row: &[f32], halves: &mut [f32], line: &mut [f32]) {
    let columns = row.len();
    let inside = columns.saturating_sub(5);
    for (half, near) in halves[BEFORE.min(columns)..].iter_mut().zip(row.windows(6)) {
        let pair = |k: usize| HALFWAY[k] * (near[k] + near[5 - k]);
        *half = pair(0) + pair(1) + pair(2);
    }
    for c in (0..BEFORE.min(columns)).chain(BEFORE + inside..columns) {
        halves[c] = (0..6).map(|k| HALFWAY[k] * row[mirrored(c, k, columns)]).sum();
    }
    for ((two, value), half) in line.chunks_mut(2).zip(row).zip(halves) {
        two[0] = *value;
        if let Some(place) = two.get_mut(1) {
            *place = *half;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;

    #[test]
    fn pixels_are_kept_and_a_smooth_wave_is_interpolated() {
        let wave = |c: f64, r: f64| 30.0 * (std::f64::consts::TAU * (0.08 * c + 0.05 * r)).sin();
        let pixels: Vec<f32> = (0..60 * 60).map(|k| wave(f64::from(k % 60), f64::from(k / 60)) as f32).collect();
        let out = on_both(|| doubled(&Image::new(&pixels, 60, 60, 60).unwrap()));
        assert_eq!(out.len(), 119 * 119);
        for r in 0..119usize {
            for c in 0..119usize {
                if r % 2 == 0 && c % 2 == 0 {
                    assert_eq!(out[r * 119 + c], pixels[r / 2 * 60 + c / 2]);
                } else if (8..111).contains(&r) && (8..111).contains(&c) {
                    // Six-point interpolation errs by (2π f)⁶ / 205 = 8e-5 of the amplitude at 0.08 cycles/px.
                    let exact = wave(c as f64 / 2.0, r as f64 / 2.0);
                    assert!((f64::from(out[r * 119 + c]) - exact).abs() < 30.0 * 2e-4);
                }
            }
        }
    }

    #[test]
    fn the_smallest_images_are_doubled_too() {
        for columns in 1..8usize {
            let pixels = vec![3.0; columns * 3];
            let out = doubled(&Image::new(&pixels, 3, columns, columns).unwrap());
            assert_eq!(out.len(), 5 * (2 * columns - 1));
            assert!(out.iter().all(|value| (value - 3.0).abs() < 1e-6));
        }
    }
}
