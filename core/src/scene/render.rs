//! A band-limited scene at any translation: its quintic spline, of eight samples a pixel, read at the pixels.
//!
//! With motion blur a pixel is the mean over moments of exposure, whose weights are added up first; with a rolling
//! shutter each row has its own moments.

use crate::track::interpolate::{quintic, quintic_slope};
use crate::track::vector::vectorised;

/// Samples a pixel, along each axis.
pub const SAMPLES: usize = 8;
/// Samples before and after a point that its spline reaches over.
const BEFORE: i64 = 2;
const AFTER: i64 = 3;

/// A scene's spline coefficients (samples down, SAMPLES, columns), parted by their place within the pixel.
pub struct Scene<'a> {
    /// One after the other.
    pub coefficients: &'a [f32],
    /// Samples down.
    pub samples: usize,
    /// Columns of coefficients, margins included.
    pub wide: usize,
    /// Whole pixels around the picture.
    pub margin: usize,
}

/// What is read: the scene or its derivative along either axis, by the samples.
#[derive(Clone, Copy, Debug, Default)]
pub struct Derivative {
    /// Along x.
    pub across: bool,
    /// Along y.
    pub down: bool,
}

/// A translation, px.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// To the right.
    pub x: f64,
    /// Down.
    pub y: f64,
}

/// Weights of samples about a pixel.
struct Taps {
    /// First sample down and across, about the pixel's first one.
    start: [usize; 2],
    wide: usize,
    /// Row by row.
    weights: Vec<f32>,
}

impl Scene<'_> {
    /// The picture of `rows` by `columns` pixels; `moments`: those of all rows, or of each row. None where a row has
    /// none or one lies beyond the margin.
    pub fn render(
        &self,
        rows: usize,
        columns: usize,
        moments: &[&[Moment]],
        derivative: Derivative,
    ) -> Option<Vec<f32>> {
        if moments.len() != 1 && moments.len() != rows {
            return None;
        }
        let taps: Vec<Taps> = moments.iter().map(|moments| self.taps(moments, derivative)).collect::<Option<_>>()?;
        let mut picture = vec![0.0; rows * columns];
        for (r, row) in picture.chunks_exact_mut(columns.max(1)).enumerate() {
            let taps = &taps[if taps.len() == 1 { 0 } else { r }];
            if SAMPLES * r + taps.start[0] + taps.weights.len() / taps.wide > self.samples
                || (taps.start[1] + taps.wide).div_ceil(SAMPLES) + columns > self.wide + 1
            {
                return None;
            }
            gather(self, r, taps, row);
        }
        Some(picture)
    }

    fn taps(&self, moments: &[Moment], derivative: Derivative) -> Option<Taps> {
        let place = |shift: f64| SAMPLES as f64 * (self.margin as f64 - shift);
        let down = axis_weights(moments.iter().map(|moment| place(moment.y)).collect(), derivative.down)?;
        let across = axis_weights(moments.iter().map(|moment| place(moment.x)).collect(), derivative.across)?;
        let (tall, wide) = (down.1[0].len(), across.1[0].len());
        let weight = |k: usize| {
            let (j, i) = (k / wide, k % wide);
            let products = down.1.iter().zip(&across.1).map(|(down, across)| down[j] * across[i]);
            (products.sum::<f64>() / moments.len() as f64) as f32
        };
        Some(Taps { start: [down.0, across.0], wide, weights: (0..tall * wide).map(weight).collect() })
    }
}

/// First sample, and the weights of it and those after it for reading at each of the places; None below the first
/// sample.
fn axis_weights(places: Vec<f64>, derivative: bool) -> Option<(usize, Vec<Vec<f64>>)> {
    let least = places.iter().copied().fold(f64::INFINITY, f64::min);
    let most = places.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if !(least.is_finite() && most.is_finite() && most.abs() < 1e9) {
        return None;
    }
    let (first, last) = (least.floor() as i64 - BEFORE, most.floor() as i64 + AFTER);
    let read = if derivative { quintic_slope } else { quintic };
    let weights = places.iter().map(|place| (first..=last).map(|k| read(place - k as f64)).collect()).collect();
    Some((usize::try_from(first).ok()?, weights))
}

vectorised! {
fn gather(scene: &Scene<'_>, r: usize, taps: &Taps, row: &mut [f32]) {
    let [down, across] = taps.start;
    for (j, weights) in taps.weights.chunks_exact(taps.wide).enumerate() {
        let layer = &scene.coefficients[(SAMPLES * r + down + j) * SAMPLES * scene.wide..];
        for (i, &weight) in weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
            let place = across + i;
            let line = &layer[place % SAMPLES * scene.wide + place / SAMPLES..][..row.len()];
            for (sum, value) in row.iter_mut().zip(line) {
                *sum += weight * value;
            }
        }
    }
}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::vector::on_both;

    /// A spline whose coefficients lie on a plane reads that plane.
    #[test]
    fn a_plane_is_read_exactly_and_its_slope_too() {
        let (rows, columns, margin) = (4, 5, 3);
        let (samples, wide) = (SAMPLES * (rows + 2 * margin), columns + 2 * margin);
        let coefficients: Vec<f32> = (0..samples * SAMPLES * wide)
            .map(|k| {
                let (down, phase, column) = (k / (SAMPLES * wide), k / wide % SAMPLES, k % wide);
                0.5 * down as f32 - 0.25 * (SAMPLES * column + phase) as f32
            })
            .collect();
        let scene = Scene { coefficients: &coefficients, samples, wide, margin };
        let moments = [Moment { x: 0.3, y: -1.2 }, Moment { x: 0.7, y: -0.8 }];
        let found = on_both(|| scene.render(rows, columns, &[&moments], Derivative::default())).unwrap();
        for (k, value) in found.iter().enumerate() {
            let (down, across) = ((k / columns + margin) as f64 + 1.0, (k % columns + margin) as f64 - 0.5);
            // Single precision of numbers up to 30.
            assert!((f64::from(*value) - 8.0 * (0.5 * down - 0.25 * across)).abs() < 3e-5, "{k}");
        }
        let slope = scene.render(rows, columns, &[&moments], Derivative { across: true, down: false }).unwrap();
        assert!(slope.iter().all(|value| (value + 0.25).abs() < 1e-5));
        let far = [Moment { x: 9.0, y: 0.0 }];
        assert!(scene.render(rows, columns, &[&far], Derivative::default()).is_none());
        let far = [Moment { x: 0.0, y: -9.0 }];
        assert!(scene.render(rows, columns, &[&far], Derivative::default()).is_none());
        assert!(scene.render(rows, columns, &[&moments[..]; 3], Derivative::default()).is_none());
        assert!(scene.render(rows, columns, &[&[]], Derivative::default()).is_none());
    }
}
