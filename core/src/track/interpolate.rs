//! The quintic B-spline, and the weights of the pixels around a point for the spline through them (Unser, 1999,
//! doi 10.1109/79.799930).

/// The cardinal spline, which is 1 at one pixel and 0 at all others, has fallen below 1e-3 at this distance, px.
pub const REACH_PX: usize = 10;
/// Pixels that a point is interpolated from along one axis.
pub const CARDINAL_TAPS: usize = 2 * REACH_PX + 1;

/// The quintic B-spline at `x`.
#[inline(always)]
pub fn quintic(x: f64) -> f64 {
    let a = x.abs();
    if a < 1.0 {
        11.0 / 20.0 + a * a * (-0.5 + a * a * (0.25 - a / 12.0))
    } else if a < 2.0 {
        17.0 / 40.0 + a * (0.625 + a * (-1.75 + a * (1.25 + a * (-0.375 + a / 24.0))))
    } else if a < 3.0 {
        (3.0 - a).powi(5) / 120.0
    } else {
        0.0
    }
}

/// The derivative of the quintic B-spline at `x`.
#[inline(always)]
pub fn quintic_slope(x: f64) -> f64 {
    let a = x.abs();
    let slope = if a < 1.0 {
        a * (-1.0 + a * a * (1.0 - 5.0 * a / 12.0))
    } else if a < 2.0 {
        0.625 + a * (-3.5 + a * (3.75 + a * (-1.5 + 5.0 * a / 24.0)))
    } else if a < 3.0 {
        -(3.0 - a).powi(4) / 24.0
    } else {
        0.0
    };
    if x < 0.0 { -slope } else { slope }
}

/// Coefficients of the quintic spline through a single pixel of value 1, up to `REACH_PX` from it.
///
/// The samples 1, 26, 66, 26, 1 over 120 of the B-spline are inverted by their poles z: z + 1/z = -13 ± √105.
fn impulse_coefficients() -> [f64; CARDINAL_TAPS] {
    let [one, other] = [105f64.sqrt(), -105f64.sqrt()].map(|root| {
        let sum: f64 = -13.0 + root;
        0.5 * (sum + (sum * sum - 4.0).sqrt())
    });
    let part = |z: f64, y: f64| 120.0 * z / ((z - 1.0 / z) * (z - y) * (z - 1.0 / y));
    let (of_one, of_other) = (part(one, other), part(other, one));
    std::array::from_fn(|k| {
        let away = k.abs_diff(REACH_PX) as i32;
        of_one * one.powi(away) + of_other * other.powi(away)
    })
}

/// Weights of the pixels around a point at `shift_px` (-1 to 1) for the quintic spline's value there; their sum is 1.
pub fn cardinal_taps(shift_px: f64) -> [f64; CARDINAL_TAPS] {
    let coefficients = impulse_coefficients();
    let taps: [f64; CARDINAL_TAPS] = std::array::from_fn(|m| {
        (-3..=3i32)
            .map(|j| {
                let place = usize::try_from(m as i32 + j).ok().and_then(|k| coefficients.get(k));
                place.map_or(0.0, |c| c * quintic(f64::from(j) + shift_px))
            })
            .sum()
    });
    let total: f64 = taps.iter().sum();
    taps.map(|tap| tap / total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Splines of degree 5 keep polynomials of degree 5; the cardinal spline is cut off where it has fallen to
        /// 1e-4.
        #[test]
        fn a_line_and_a_slow_wave_are_kept(shift in -1.0..1.0f64) {
            let taps = cardinal_taps(shift);
            let at = |f: &dyn Fn(f64) -> f64| -> f64 {
                taps.iter().enumerate().map(|(m, tap)| tap * f(m as f64 - REACH_PX as f64)).sum()
            };
            prop_assert!((at(&|_| 1.0) - 1.0).abs() < 1e-12);
            prop_assert!((at(&|x| (0.5 * x).cos()) - (0.5 * shift).cos()).abs() < 1e-3);
        }

        #[test]
        fn shifted_splines_add_up_to_one_and_their_slopes_to_zero(shift in -1.0..1.0f64) {
            let total: f64 = (-4..=4).map(|k| quintic(f64::from(k) + shift)).sum();
            let slope: f64 = (-4..=4).map(|k| quintic_slope(f64::from(k) + shift)).sum();
            prop_assert!((total - 1.0).abs() < 1e-14 && slope.abs() < 1e-14);
            let difference = (quintic(shift + 1e-5) - quintic(shift - 1e-5)) / 2e-5;
            prop_assert!((quintic_slope(shift) - difference).abs() < 1e-9);
        }
    }

    #[test]
    fn at_a_pixel_its_own_value_counts_alone() {
        for (k, tap) in cardinal_taps(0.0).into_iter().enumerate() {
            // What is cut off at the reach leaves 2e-4 of the next ones.
            assert!((tap - f64::from(u8::from(k == REACH_PX))).abs() < 2e-4, "{k} {tap}");
        }
    }
}
