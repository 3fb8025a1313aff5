//! Angles and cosines of single precision without branches, so that several are taken at once; equal on all processors.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// tan(π/8).
const EIGHTH: f32 = 0.414_213_56;

/// The angle (rad) of the point (x, y), -π to π; of the origin 0.
///
/// An angle below an eighth of a turn's half by an odd polynomial (S. Moshier's atanf), others by their difference to
/// π/4.
#[inline(always)]
pub fn angle(y: f32, x: f32) -> f32 {
    let (wide, high) = (x.abs(), y.abs());
    let (least, most) = if high > wide { (wide, high) } else { (high, wide) };
    let steep = least > EIGHTH * most;
    let above = if steep { least - most } else { least };
    let below = if steep { least + most } else { most };
    let slope = above / if below > 0.0 { below } else { 1.0 };
    let z = slope * slope;
    let series = ((8.053_744_5e-2 * z - 1.387_768_6e-1) * z + 1.997_771_1e-1) * z - 3.333_295e-1;
    let small = series * z * slope + slope + if steep { FRAC_PI_4 } else { 0.0 };
    let right = if high > wide { FRAC_PI_2 - small } else { small };
    let upper = if x < 0.0 { PI - right } else { right };
    if y < 0.0 { -upper } else { upper }
}

/// The cosine of an angle of -π to π: 1 - 2 sin²(half).
#[inline(always)]
pub fn cosine(angle: f32) -> f32 {
    let half = 0.5 * angle;
    let z = half * half;
    let tail = 2.755_731_9e-6 + z * (-2.505_210_8e-8 + z * 1.605_904_4e-10);
    let series = -1.666_666_7e-1 + z * (8.333_333e-3 + z * (-1.984_127e-4 + z * tail));
    let sine = half + half * z * series;
    1.0 - 2.0 * sine * sine
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn angles_are_those_of_the_standard_library(x in -50.0..50.0f32, y in -50.0..50.0f32) {
            // Half a unit in the last place of π is 1.2e-7; the polynomial and its rounding make another one.
            prop_assert!((f64::from(angle(y, x)) - f64::from(y).atan2(f64::from(x))).abs() < 4e-7);
        }
    }

    #[test]
    fn cosines_are_those_of_the_standard_library() {
        // The series ends with the thirteenth power: 1.575¹⁵ / 15! = 7e-10. What is left is rounding: of the sine near
        // 1 two units of 6e-8, fourfold in the cosine, and half a unit of the result. Every second number from 0.6 up, as
        // the worst of them are few.
        for bits in (0_u32..=3.15_f32.to_bits()).rev().take(20_000_000).step_by(2) {
            for at in [f32::from_bits(bits), -f32::from_bits(bits)] {
                assert!((f64::from(cosine(at)) - f64::from(at).cos()).abs() < 6e-7, "{at}");
            }
        }
    }

    #[test]
    fn angles_on_the_axes_are_exact() {
        let corners = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 0.0), (1.0, 1.0)];
        let found = corners.map(|(y, x)| angle(y, x));
        assert_eq!(found, [0.0, FRAC_PI_2, PI, -FRAC_PI_2, 0.0, FRAC_PI_4]);
    }
}
