//! What is given of a group, SI.

use super::covariance::Walks;
use serde::{Deserialize, Serialize};

/// What is given of a group; the same for all of its points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Standard deviation of the acceleration's noise, a sample, m/s².
    pub acceleration_std_m_s2: f64,
    /// Standard deviation of the displacement's noise, a measurement, m.
    pub displacement_std_m: f64,
    /// Standard deviation of the displacement's slow error, m; more shows in its innovations.
    pub slow_std_m: f64,
    /// Its correlation time, s.
    pub slow_time_s: f64,
    /// Standard deviation of the delay of the displacement's stamps before it is measured, s.
    pub delay_std_s: f64,
    /// Standard deviation of the accelerometer's relative gain error before it is measured.
    pub gain_std: f64,
    /// Density of the bias's walk, (m/s²)²/s.
    pub bias_walk: f64,
    /// A sensor is waited for so long, s.
    pub wait_s: f64,
    /// Rows are coasting when the last measurement is older than this, s.
    pub coasting_s: f64,
    /// Rows are lost when the last measurement is older than this, s.
    pub lost_s: f64,
    /// Whether the displacement sensor is as stated: no measurement is an outlier, and its noise is not followed.
    pub as_stated: bool,
    /// Whether rows are rounded.
    pub rounded: bool,
}

/// The delay's walk: 3 ms in an hour and a half, s²/s.
const DELAY_WALK: f64 = 1e-9;
/// The gain's walk: 0.1 % in a day, 1/s.
const GAIN_WALK: f64 = 1e-11;

impl Settings {
    /// Stated variance of the displacement's noise, m².
    #[inline]
    pub fn stated_m2(&self) -> f64 {
        self.displacement_std_m * self.displacement_std_m
    }

    /// What is added to the states' variances over time; density: of the acceleration's noise, (m/s²)²/Hz.
    #[inline]
    pub fn walks(&self, density: f64, slow_m2: f64) -> Walks {
        Walks {
            density,
            bias: self.bias_walk,
            delay: if self.delay_std_s > 0.0 { DELAY_WALK } else { 0.0 },
            gain: if self.gain_std > 0.0 { GAIN_WALK } else { 0.0 },
            slow_m2,
            slow_time_s: self.slow_time_s,
        }
    }
}
