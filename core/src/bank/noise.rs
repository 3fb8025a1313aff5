//! The displacement sensor's noise as its innovations show it.
//!
//! The innovations of the right model are white and of the predicted variance. The variance of the white noise is a
//! running mean of E[(y − h x)²] after each measurement (expectation maximisation with forgetting; Shumway and Stoffer
//! 1982, doi:10.1111/j.1467-9892.1982.tb00349.x), and never less than what is stated. Where innovations go with those
//! of the last second, the sensor has more slow error than the model says, where they go against them, less: its
//! variance follows their product (the score of the likelihood has this form: Mehra 1970, doi:10.1109/TAC.1970.1099422),
//! and is never less than stated: an error that lasts longer than the accelerometer remembers shows in no innovation.

use super::settings::Settings;
use serde::{Deserialize, Serialize};

/// The white noise is followed over this time, s.
const WHITE_S: f64 = 60.0;
/// A measurement changes the white noise's variance by this share of its own at most, once a hundred have been.
const MAX_SHARE: f64 = 0.02;
const FIRST: u8 = 100;
/// Innovations are compared with those of this time before, s, and of at least this many intervals.
const COLOUR_S: f64 = 1.0;
const COLOUR_INTERVALS: f64 = 5.0;
/// By what the logarithm of the slow error's variance follows the product, 1/s, and at most a measurement; twice that
/// at first.
const COLOUR_GAIN: f64 = 0.1;
const MAX_COLOUR_GAIN: f64 = 0.02;
/// Weight of their size: it shows a slow error that is so large that no colour is left.
const SIZE_WEIGHT: f64 = 2.0;
/// An innovation counts as no more than this many standard deviations.
const MAX_SCORE: f64 = 3.0;
/// Largest variance of the slow error, in that of the stated noise.
const MAX_SLOW: f64 = 1e6;
/// Share of measurements that are wrong by any amount, of those after one that was, and how many times as wide they
/// scatter.
const OUTLIERS: f64 = 0.02;
const OUTLIERS_STAY: f64 = 0.6;
const OUTLIER_WIDTH: f64 = 10.0;

/// Variances of a displacement sensor, in that of its stated noise, and the sum of its last innovations in their
/// standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    white: f32,
    slow: f32,
    recent: f32,
}

/// What a measurement has shown.
#[derive(Clone, Copy, Debug)]
pub struct Shown {
    /// The innovation, m.
    pub innovation: f64,
    /// Its variance, m².
    pub variance: f64,
    /// E[(y − h x)²] (m²) where it is no outlier; None: it is one.
    pub left: Option<f64>,
    /// Probability that it is none.
    pub share: f64,
    /// To the next one, s.
    pub interval_s: f64,
    /// How many there have been.
    pub count: u8,
}

impl Noise {
    /// As stated.
    pub fn new(settings: &Settings) -> Self {
        Self { white: 1.0, slow: stated_slow(settings) as f32, recent: 0.0 }
    }

    /// Of the white noise, m².
    #[inline]
    pub fn white_m2(&self, settings: &Settings) -> f64 {
        f64::from(self.white) * settings.stated_m2()
    }

    /// Of the slow error, m².
    #[inline]
    pub fn slow_m2(&self, settings: &Settings) -> f64 {
        f64::from(self.slow) * settings.stated_m2()
    }

    /// Factor on the density of the acceleration's noise: innovations are coloured by that as well.
    #[inline]
    pub fn colour(&self) -> f64 {
        (0.25 * f64::from(self.slow)).max(1.0)
    }

    /// Forgets the last innovations, which had another cause.
    pub fn forget(&mut self) {
        self.recent = 0.0;
    }

    /// Follows what a measurement has shown. An outlier may be noise that is larger than it was: its square counts as
    /// far as an innovation does.
    #[inline]
    pub fn follow(&mut self, shown: &Shown, settings: &Settings) {
        let first = if shown.count < FIRST { 1.0 / (f64::from(shown.count) + 1.0) } else { 0.0 };
        let gain = (shown.interval_s / WHITE_S).min(MAX_SHARE).max(first);
        let score = (shown.innovation / shown.variance.sqrt()).clamp(-MAX_SCORE, MAX_SCORE);
        let more = match shown.left {
            Some(left) => shown.share * (left - self.white_m2(settings)),
            None => (score * score - 1.0) * shown.variance,
        };
        self.white = (f64::from(self.white) + gain * more / settings.stated_m2()).max(1.0) as f32;
        if self.slow > 0.0 && shown.left.is_some() {
            let recent = f64::from(self.recent);
            let added = self.slow_m2(settings) * (2.0 * shown.interval_s / settings.slow_time_s).min(1.0);
            let size = SIZE_WEIGHT * (score * score - 1.0) * (added / shown.variance).powi(2);
            let early = if shown.count < u8::MAX { 2.0 } else { 1.0 };
            let gain = early * (COLOUR_GAIN * shown.interval_s).min(MAX_COLOUR_GAIN);
            let by = gain * (shown.share * score * recent + size);
            let slow = f64::from(self.slow) * (1.0 + by.clamp(-0.5, 1.0));
            self.slow = slow.clamp(stated_slow(settings), MAX_SLOW) as f32;
            let kept = 1.0 - (shown.interval_s / COLOUR_S).min(1.0 / COLOUR_INTERVALS);
            self.recent = (kept * (recent + shown.share * score)) as f32;
        }
    }

    /// The zero has shifted by the root of this, and may move as far again.
    pub fn shifted(&mut self, square: f64, settings: &Settings) {
        if self.slow > 0.0 {
            self.slow = self.slow.max((2.0 * square / settings.stated_m2()) as f32).min(MAX_SLOW as f32);
        }
        self.forget();
    }
}

/// Stated variance of the slow error, in that of the noise.
#[inline]
fn stated_slow(settings: &Settings) -> f64 {
    (settings.slow_std_m / settings.displacement_std_m).powi(2).min(MAX_SLOW)
}

/// Probability that an innovation of this variance is not an outlier's; doubtful: the one before was.
#[inline]
pub fn sound_share(innovation: f64, variance: f64, doubtful: bool) -> f64 {
    let (prior, wide) = (if doubtful { OUTLIERS_STAY } else { OUTLIERS }, OUTLIER_WIDTH * OUTLIER_WIDTH);
    let exponent = 0.5 * innovation * innovation / variance * (1.0 - 1.0 / wide);
    1.0 / (1.0 + prior / (1.0 - prior) / OUTLIER_WIDTH * exponent.exp())
}
