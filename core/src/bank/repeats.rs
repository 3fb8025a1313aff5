//! A value of the displacement sensor that comes again and again: the sensor is frozen, or its steps are coarse.

use serde::{Deserialize, Serialize};

/// A value that was measured again this many times, of a sensor that resolves its noise, is no measurement any more.
const FROZEN: u8 = 10;

/// The last value (m), how many times it came again, and the exponent of the smallest change from one value to the next
/// (255: there was none).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Repeats {
    last_m: f32,
    resolution: u8,
    count: u8,
}

impl Default for Repeats {
    fn default() -> Self {
        Self { last_m: 0.0, resolution: u8::MAX, count: 0 }
    }
}

impl Repeats {
    /// Whether the last value was that before it.
    pub fn is_repeated(&self) -> bool {
        self.count > 0
    }

    /// Whether the last value is the first one that a frozen sensor gives.
    pub fn has_begun(&self) -> bool {
        self.count == FROZEN
    }

    /// Takes a value (m); whether it is repeated although the sensor resolves its own noise (std_m). Of one that does
    /// not, as a coarse one on a structure that rests, a repeated value is a measurement, and improbable where the
    /// structure moves. A sensor that has never changed may not measure at all.
    pub fn is_frozen(&mut self, value_m: f64, is_first: bool, std_m: f64) -> bool {
        let value = value_m as f32;
        if value == self.last_m && !is_first {
            self.count = self.count.saturating_add(1);
        } else {
            if !is_first {
                self.resolution = self.resolution.min(exponent(value - self.last_m));
            }
            (self.last_m, self.count) = (value, 0);
        }
        let resolves = self.resolution == u8::MAX || self.resolution < exponent(std_m as f32);
        resolves && self.count >= FROZEN
    }
}

/// Exponent of a number, of powers of two.
fn exponent(value: f32) -> u8 {
    (value.abs().to_bits() >> 23) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At which of these values (m) a sensor of 1 mm of noise is frozen first.
    fn frozen_at(values: &[f64]) -> Option<usize> {
        let mut repeats = Repeats::default();
        values.iter().enumerate().position(|(place, &value)| repeats.is_frozen(value, place == 0, 1e-3))
    }

    #[test]
    fn a_fine_sensor_is_frozen_after_ten_repeats_and_a_coarse_one_is_not() {
        let same = [0.02; 30];
        assert_eq!(frozen_at(&[&[0.0200, 0.0201], &same[..]].concat()), Some(12));
        assert_eq!(frozen_at(&[&[0.020, 0.025], &same[..]].concat()), None);
    }

    #[test]
    fn one_that_never_changed_is_frozen_whatever_its_value() {
        assert_eq!(frozen_at(&[0.0; 30]), Some(10));
        assert_eq!(frozen_at(&[5.0; 30]), Some(10));
    }
}
