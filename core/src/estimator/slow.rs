//! The slow error of a sensor: noise that is correlated over seconds, or the sway of what it stands on.
//!
//! A first-order Gauss-Markov process, e' = −rate e + white noise, or a damped oscillator under a white force, e'' =
//! −2 rate e' − ω² e + white noise, with the states e and e' / ω; at rate = ω it is a second-order Gauss-Markov process
//! (A. Gelb, Applied Optimal Estimation, 1974, section 4.5).

/// What becomes of a state over some time, or of two: a matrix, by rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn([[f64; 2]; 2]);

impl Turn {
    /// Nothing changes.
    pub const NONE: Self = Self([[1.0, 0.0], [0.0, 1.0]]);

    /// Over a lapse (s) of an error that forgets at a rate (1/s), an oscillator where ω (rad/s) is not 0.
    pub fn over(lapse: f64, rate: f64, omega: f64) -> Self {
        if omega == 0.0 {
            let left = (-rate * lapse).exp();
            return Self([[left, 0.0], [0.0, left]]);
        }
        let (apart, left) = ((omega * omega - rate * rate).abs().sqrt(), (-rate * lapse).exp());
        // cos and sin over the frequency; of an overdamped one both exponentials, which do not overflow.
        let (cos, sin) = if apart * lapse < 1e-6 {
            (left, left * lapse)
        } else if omega > rate {
            (left * (apart * lapse).cos(), left * (apart * lapse).sin() / apart)
        } else {
            let (slow, fast) = (((apart - rate) * lapse).exp(), ((-apart - rate) * lapse).exp());
            (0.5 * (slow + fast), 0.5 * (slow - fast) / apart)
        };
        Self([[cos + rate * sin, omega * sin], [-omega * sin, cos - rate * sin]])
    }

    /// Both states are known to be 0.
    pub const GONE: Self = Self([[0.0, 0.0], [0.0, 0.0]]);

    /// What is left of the first state alone.
    pub fn left(&self) -> f64 {
        self.0[0][0]
    }

    /// Two states after it.
    #[inline]
    pub fn of(&self, first: f64, second: f64) -> (f64, f64) {
        let [[a, b], [c, d]] = self.0;
        (a * first + b * second, c * first + d * second)
    }

    /// The transposed one, by which the adjoint goes back.
    pub fn back(&self) -> Self {
        let [[a, b], [c, d]] = self.0;
        Self([[a, c], [b, d]])
    }

    /// What is new where both states' variance stays 1: of the first, of both together, of the second.
    pub fn added(&self) -> [f64; 3] {
        let [[a, b], [c, d]] = self.0;
        [(1.0 - a * a - b * b).max(0.0), -(a * c + b * d), (1.0 - c * c - d * d).max(0.0)]
    }
}

/// A slow error of a sensor along an axis.
#[derive(Clone, Copy, Debug)]
pub struct SlowError {
    /// The channel whose mark has its time: the first of its sensor along the axis.
    pub lead: usize,
    /// Place of its state.
    pub place: usize,
    /// Place of its velocity over ω; None: it is no oscillator.
    pub velocity: Option<usize>,
    /// Its variance, m².
    pub variance_m2: f64,
    /// The rate at which it forgets, 1/s.
    pub rate_s: f64,
    /// Of the oscillator without damping, rad/s.
    pub omega: f64,
}

impl SlowError {
    /// The same one of another variance, m².
    pub fn of_variance(&self, variance_m2: f64) -> Self {
        Self { variance_m2, ..*self }
    }

    /// The same one, faster by a factor.
    pub fn faster(&self, factor: f64) -> Self {
        Self { rate_s: factor * self.rate_s, omega: factor * self.omega, ..*self }
    }

    /// What becomes of it over some time, s.
    pub fn after(&self, lapse_s: f64) -> Turn {
        Turn::over(lapse_s, self.rate_s, self.omega)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Two lapses are one of both, and the oscillator solves its equation.
        #[test]
        fn an_oscillator_moves_by_its_equation(
            (first, second) in (1e-4..2.0, 1e-4..2.0),
            rate in 0.01..5.0,
            omega in 0.1..20.0,
        ) {
            let whole = Turn::over(first + second, rate, omega);
            let ([[a, c], [b, d]], two) = (whole.back().0, Turn::over(second, rate, omega));
            let (one, other) = (Turn::over(first, rate, omega).of(1.0, 0.0), Turn::over(first, rate, omega).of(0.0, 1.0));
            let (one, other) = (two.of(one.0, one.1), two.of(other.0, other.1));
            for (left, right) in [(a, one.0), (c, one.1), (b, other.0), (d, other.1)] {
                prop_assert!((left - right).abs() < 1e-9);
            }
            // By a step of 1e-6 s: x' = ω y, y' = −ω x − 2 rate y.
            let ((x, y), (x1, y1)) = ((0.3, -0.8), Turn::over(1e-6, rate, omega).of(0.3, -0.8));
            prop_assert!(((x1 - x) / 1e-6 - omega * y).abs() < 1e-2 * omega);
            prop_assert!(((y1 - y) / 1e-6 + omega * x + 2.0 * rate * y).abs() < 1e-2 * (omega + rate));
        }
    }
}
