//! Rows rounded to what their standard deviation leaves of them, so that they pack well.
//!
//! A value is rounded to the nearest multiple of 2^k ≤ σ/256, σ upwards to seven significant bits (by 1/64 of itself
//! at most). The rounding adds σ²/(12 · 256²) to the variance at most, one millionth of it.

/// Bits of σ that are dropped.
const DROPPED: u64 = (1 << 46) - 1;
/// Added to a number and taken off again, this many units round it to one.
const WHOLE: f64 = 6_755_399_441_055_744.0;

/// Upwards to seven significant bits.
#[inline]
pub fn round_up(std: f64) -> f64 {
    f64::from_bits((std.to_bits() + DROPPED) & !DROPPED)
}

/// To the nearest multiple of the greatest power of two that is at most 1/256 of the standard deviation.
#[inline]
pub fn round_to(value: f64, variance: f64) -> f64 {
    // The exponent of a root is half of that of the number, downwards.
    let exponent = ((variance.to_bits() >> 52) + 1023) >> 1;
    let unit = f64::from_bits(exponent << 52) / 256.0;
    if value.abs() < 1e15 * unit { (value + WHOLE * unit) - WHOLE * unit } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn values_change_by_less_than_a_share_of_their_deviation(value in -10.0..10.0f64, std in 1e-6..1.0f64) {
            let (rounded, up) = (round_to(value, std * std), round_up(std));
            prop_assert!((rounded - value).abs() <= std / 512.0 * 1.000_001);
            prop_assert!(up >= std && up <= std * (1.0 + 1.0 / 64.0));
            prop_assert_eq!(round_to(rounded, std * std), rounded);
            prop_assert_eq!(round_up(up), up);
        }
    }
}
