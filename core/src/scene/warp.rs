//! A scene read at any points, as where its plane is seen from a camera that turns.

use super::render::{SAMPLES, Scene};
use crate::track::interpolate::quintic;

/// Samples before and after a point that its spline reaches over.
const BEFORE: i64 = 2;
const TAPS: usize = 6;

impl Scene<'_> {
    /// The scene's values at points: rows and columns in pixels from the picture's first one. None where a point's
    /// spline reaches beyond the samples.
    pub fn at_points(&self, down: &[f64], across: &[f64]) -> Option<Vec<f32>> {
        down.iter().zip(across).map(|(&down, &across)| self.at_point(down, across)).collect()
    }

    fn at_point(&self, down: f64, across: f64) -> Option<f32> {
        let (first_down, down) = taps(down + self.margin as f64, self.samples)?;
        let (first_across, across) = taps(across + self.margin as f64, SAMPLES * self.wide)?;
        let mut sum = 0.0;
        for (j, own) in down.iter().enumerate() {
            let layer = &self.coefficients[(first_down + j) * SAMPLES * self.wide..];
            for (i, weight) in across.iter().enumerate() {
                let place = first_across + i;
                sum += own * weight * layer[place % SAMPLES * self.wide + place / SAMPLES];
            }
        }
        Some(sum)
    }
}

/// First sample and the weights of it and those after it, for reading at a pixel; samples: their number.
fn taps(pixel: f64, samples: usize) -> Option<(usize, [f32; TAPS])> {
    let place = SAMPLES as f64 * pixel;
    if !place.is_finite() || place.abs() > 1e9 {
        return None;
    }
    let start = place.floor() as i64 - BEFORE;
    let first = usize::try_from(start).ok().filter(|first| first + TAPS <= samples)?;
    Some((first, std::array::from_fn(|k| quintic(place - (start + k as i64) as f64) as f32)))
}

#[cfg(test)]
mod tests {
    use super::super::render::{Derivative, Moment};
    use super::*;

    /// Points on the pixels' grid, moved alike, are the rendered picture.
    #[test]
    fn points_moved_alike_are_the_translated_picture() {
        let (rows, columns, margin) = (4, 5, 3);
        let (samples, wide) = (SAMPLES * (rows + 2 * margin), columns + 2 * margin);
        let coefficients: Vec<f32> = (0..samples * SAMPLES * wide).map(|k| ((k * k) % 17) as f32 - 8.0).collect();
        let scene = Scene { coefficients: &coefficients, samples, wide, margin };
        let moment = [Moment { x: 0.37, y: -1.21 }];
        let picture = scene.render(rows, columns, &[&moment], Derivative::default()).unwrap();
        let pixels = (0..rows * columns).map(|k| ((k / columns) as f64 + 1.21, (k % columns) as f64 - 0.37));
        let (down, across): (Vec<f64>, Vec<f64>) = pixels.unzip();
        for (one, other) in scene.at_points(&down, &across).unwrap().iter().zip(&picture) {
            assert!((one - other).abs() < 1e-4);
        }
        assert!(scene.at_points(&[-9.0], &[0.0]).is_none());
        assert!(scene.at_points(&[0.0], &[f64::NAN]).is_none());
    }
}
