//! What of a run's pictures is worth reporting, counted frame by frame: blur, saturation, texture, motion.

use serde::{Deserialize, Serialize};

/// Of the first frame's detail (square) a frame is counted as blurred; over it, as sharper.
const BLURRED: f64 = 0.5;
/// A frame known no better is counted, px.
const COARSE_STD_PX: f64 = 0.06;

/// Along one image axis.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AxisCounts {
    /// Frames in which the target was seen.
    pub seen: u64,
    /// In how many its own standard deviation is coarse.
    pub coarse: u64,
    /// The mean of their variances, px².
    pub variance_px2: f64,
    /// The mean of the translation, px.
    pub mean_px: f64,
    /// The sum of the squared distances from it, px².
    pub square_px2: f64,
}

impl AxisCounts {
    /// Counts one more frame (Welford's recursion).
    fn add(&mut self, value_px: f64, variance_px2: f64) {
        let off = value_px - self.mean_px;
        self.seen += 1;
        self.coarse += u64::from(variance_px2 > COARSE_STD_PX * COARSE_STD_PX);
        self.variance_px2 += (variance_px2 - self.variance_px2) / self.seen as f64;
        self.mean_px += off / self.seen as f64;
        self.square_px2 += off * (value_px - self.mean_px);
    }
}

/// Of all frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counts {
    /// Frames so far.
    pub frames: u64,
    /// How many of them are blurred compared with the reference.
    pub blurred: u64,
    /// How many are sharper.
    pub sharper: u64,
    /// How many are saturated.
    pub saturated: u64,
    /// The largest share of saturated pixels over the others.
    pub most_saturated: f64,
    /// Along x and y.
    pub axes: [AxisCounts; 2],
}

impl Counts {
    /// Counts a frame with the target at `place`: of such detail (square) along x and y over the reference's, NaN where
    /// it is not known, and of this ratio of saturated pixels to the others.
    pub fn add(&mut self, place: [f64; 2], variance: [f64; 2], sharp: [f64; 2], saturated: f64) {
        self.frames += 1;
        self.blurred += u64::from(sharp[0].min(sharp[1]) < BLURRED);
        self.sharper += u64::from(sharp[0].max(sharp[1]) > 1.0 / BLURRED);
        self.saturated += u64::from(saturated > 0.0);
        self.most_saturated = self.most_saturated.max(saturated);
        for (k, axis) in self.axes.iter_mut().enumerate() {
            axis.add(place[k], variance[k]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_those_of_the_whole_run() {
        let mut counts = Counts::default();
        let places: Vec<f64> = (0..50).map(|k| (f64::from(k) * 1.7).sin()).collect();
        for (k, &x) in places.iter().enumerate() {
            let coarse = if k < 20 { 0.01 } else { 1e-4 };
            counts.add([x, 0.0], [coarse, 1e-4], [if k < 7 { 0.4 } else { 1.0 }, 1.0], if k < 3 { 0.1 } else { 0.0 });
        }
        let mean = places.iter().sum::<f64>() / 50.0;
        let square: f64 = places.iter().map(|x| (x - mean).powi(2)).sum();
        let [x, y] = &counts.axes;
        // Rounding of 50 sums.
        assert!((x.mean_px - mean).abs() < 1e-14 && (x.square_px2 / square - 1.0).abs() < 1e-13);
        assert!((x.variance_px2 / (0.4 * 0.01 + 0.6 * 1e-4) - 1.0).abs() < 1e-13);
        assert_eq!((counts.frames, counts.blurred, counts.sharper, counts.saturated), (50, 7, 0, 3));
        assert_eq!((x.seen, x.coarse, y.coarse, counts.most_saturated), (50, 20, 0, 0.1));
        counts.add([0.0; 2], [1e-4; 2], [f64::NAN; 2], 0.0);
        assert_eq!((counts.blurred, counts.sharper), (7, 0));
    }
}
