//! The displacement sensor's noise as its innovations show it.
//!
//! The variances of its white noise and of its slow error are running means of what the filter says of them after each
//! measurement: E[(y − h x)²] and E[s²] (expectation maximisation with forgetting; Shumway and Stoffer 1982,
//! doi:10.1111/j.1467-9892.1982.tb00349.x). The white one is never less than what is stated.

use super::settings::Settings;
use serde::{Deserialize, Serialize};

/// The white noise is followed over this time, s, the slow error over the other one.
const WHITE_S: f64 = 60.0;
const SLOW_S: f64 = 300.0;
/// A measurement changes the white noise's variance by this share of its own at most.
const MAX_SHARE: f64 = 0.02;
/// Share of measurements that are wrong by any amount, and how many times as wide these scatter.
const OUTLIERS: f64 = 0.01;
const OUTLIER_WIDTH: f64 = 10.0;

/// Variances of a displacement sensor, m².
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    white: f32,
    slow: f32,
    least: f32,
}

impl Noise {
    /// As stated.
    pub fn new(settings: &Settings) -> Self {
        let white = (settings.displacement_std * settings.displacement_std) as f32;
        Self { white, slow: (settings.slow_std * settings.slow_std) as f32, least: white }
    }

    /// Of the white noise.
    #[inline]
    pub fn white_m2(&self) -> f64 {
        f64::from(self.white)
    }

    /// Of the slow error.
    #[inline]
    pub fn slow_m2(&self) -> f64 {
        f64::from(self.slow)
    }

    /// Follows what a measurement leaves: E[(y − h x)²] and E[s²]; share: of it that is sound; interval_s: to the next.
    #[inline]
    pub fn follow(&mut self, left: f64, slow: f64, share: f64, interval_s: f64) {
        let (white, gentle) = ((interval_s / WHITE_S).min(MAX_SHARE), (interval_s / SLOW_S).min(MAX_SHARE));
        self.white = (self.white_m2() + share * white * (left - self.white_m2())).max(f64::from(self.least)) as f32;
        self.slow = (self.slow_m2() + gentle * (slow - self.slow_m2())) as f32;
    }

    /// A slow error of this square may have come.
    pub fn shifted(&mut self, square: f64) {
        self.slow = self.slow.max(square as f32);
    }
}

/// Probability that an innovation of this variance is not an outlier's.
#[inline]
pub fn sound_share(innovation: f64, variance: f64) -> f64 {
    let wide = OUTLIER_WIDTH * OUTLIER_WIDTH;
    let exponent = 0.5 * innovation * innovation / variance * (1.0 - 1.0 / wide);
    1.0 / (1.0 + OUTLIERS / (1.0 - OUTLIERS) / OUTLIER_WIDTH * exponent.exp())
}
