//! An acceleration integrated twice, as the filters integrate it: a cubic of the displacement in each interval.
//!
//! The acceleration runs linearly between samples; the velocity state is ahead of the true velocity by dt²/12 times the
//! slope (Numerov's rule: Fox-Goodwin, Newmark β = 1/12), fourth order in the displacement and without a phase error.

/// An interval this many times as long as the one before is a gap: its slope says nothing about the motion inside.
pub const GAP_STEPS: f64 = 2.0;

/// Coefficients of a cubic, the third power first.
pub type Cubic = [f64; 4];

/// The displacement's cubic in each interval (n − 1,) of the acceleration `value` (n,) at `time_s` (n,), from rest.
pub fn integrate(time_s: &[f64], value: &[f64]) -> Vec<Cubic> {
    let (mut displacement, mut velocity) = (0.0, 0.0);
    let (mut step, mut lead, mut slope) = (f64::INFINITY, 0.0, 0.0);
    time_s
        .windows(2)
        .zip(value.windows(2))
        .map(|(time, value)| {
            let dt = time[1] - time[0];
            let next_slope = (value[1] - value[0]) / dt;
            let next_lead = if dt <= GAP_STEPS * step { dt * dt / 12.0 } else { 0.0 };
            if next_lead != lead {
                velocity += (next_lead - lead) * 0.5 * (slope + next_slope);
            }
            (step, lead, slope) = (dt.min(GAP_STEPS * step), next_lead, next_slope);
            let cubic = [slope / 6.0, 0.5 * value[0], velocity - lead * slope, displacement];
            displacement += dt * velocity + dt * (dt * (0.5 * value[0] + slope * dt / 6.0) - lead * slope);
            velocity += dt * (value[0] + 0.5 * slope * dt);
            cubic
        })
        .collect()
}

/// The derivative of an order up to 3 of cubics (n,) between edges (n + 1,) at instants (m,); beyond the edges that of
/// the cubic there. Empty where there is no cubic. `cubics`: four coefficients each, as of [`Cubic`].
pub fn derivative(edges_s: &[f64], cubics: &[f64], time_s: &[f64], order: u8) -> Vec<f64> {
    let Some(last) = (cubics.len() / 4).checked_sub(1) else { return Vec::new() };
    let mut k = 0;
    time_s
        .iter()
        .map(|&at| {
            let inside = |k: usize| edges_s[k] <= at && (k == last || at < edges_s[k + 1]);
            if !inside(k) {
                k = if k < last && inside(k + 1) {
                    k + 1
                } else {
                    edges_s.partition_point(|&edge| edge <= at).saturating_sub(1).min(last)
                };
            }
            let s = at - edges_s[k];
            let (c3, c2, c1, c0) = (cubics[4 * k], cubics[4 * k + 1], cubics[4 * k + 2], cubics[4 * k + 3]);
            match order {
                0 => c0 + c1 * s + c2 * (s * s) + c3 * (s * s * s),
                1 => c1 + c2 * s * 2.0 + c3 * (s * s) * 3.0,
                2 => c2 * 2.0 + c3 * s * 6.0,
                _ => c3 * 6.0,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_integral_of_a_sine_is_its_negative_over_the_square_of_the_frequency() {
        let omega = std::f64::consts::TAU * 0.7;
        let time_s: Vec<f64> = (0..2000).map(|k| f64::from(k) * 0.01).collect();
        let value: Vec<f64> = time_s.iter().map(|t| -omega * omega * (omega * t).sin()).collect();
        let cubics = integrate(&time_s, &value);
        // From rest the sine's own speed ω is missing. What is open of an integral is a line; beyond that Numerov's
        // rule errs by (ω dt)⁴ / 240 = 1.6e-8 of the displacement, and the cubic between samples by (ω dt)⁴ / 384.
        let at: Vec<f64> = (0..1900).map(|k| f64::from(k) * 0.0103 + 1e-3).collect();
        let found = derivative(&time_s, cubics.as_flattened(), &at, 0);
        let errors: Vec<f64> = at.iter().zip(found).map(|(t, x)| x + omega * t - (omega * t).sin()).collect();
        let speed = (errors[1899] - errors[0]) / (at[1899] - at[0]);
        for (t, error) in at.iter().zip(&errors) {
            assert!((error - errors[0] - speed * (t - at[0])).abs() < 3e-7, "{t} {error}");
        }
    }

    #[test]
    fn beyond_the_edges_the_last_cubic_goes_on_and_without_one_there_is_nothing() {
        let edges = [0.0, 1.0, 2.0];
        let cubics = [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 2.0, 1.0]];
        assert_eq!(derivative(&edges, cubics.as_flattened(), &[3.0, -1.0, 0.5, 1.0], 0), [5.0, -1.0, 0.5, 1.0]);
        assert!(derivative(&[0.0], &[], &[0.5], 0).is_empty());
    }
}
