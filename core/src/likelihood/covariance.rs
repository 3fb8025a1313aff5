//! Covariances of the filter that whitens: of displacement, velocity and bias, and of a slow error of the sensor with
//! them.
//!
//! x' = v, v' = −b − w, b' = w_b, with white noise w of density S_a ((m/s²)²/Hz) and a random walk w_b of the bias; the
//! slow error g is a first-order Gauss-Markov process or a damped oscillator, with its velocity h over its angular
//! frequency ([`crate::estimator::slow`]).

use crate::estimator::slow::Turn;

/// What a measurement makes of the states: the variance of its innovation, and the gain on x, v, b, g and h.
pub struct Gain {
    /// Variance of the innovation.
    pub total: f64,
    /// Gain on displacement, velocity, bias, slow error and its velocity.
    pub gain: [f64; 5],
}

/// A covariance that is predicted and updated from measurement to measurement.
pub trait Covariance {
    /// Over `dt` seconds, with the density of the acceleration's noise and of the bias walk.
    fn predict(&mut self, dt: f64, density: f64, bias_walk: f64);
    /// What is left of the slow error after a time, and the variance that is new.
    fn decay(&mut self, turn: Turn, new: [f64; 3]);
    /// The gain of a measurement of this variance.
    fn gain(&self, variance: f64) -> Gain;
    /// A measurement of this variance with a gain that need not be its own (Joseph form).
    fn update(&mut self, gain: &[f64; 5], variance: f64);
    /// Variance of the displacement.
    fn displacement(&self) -> f64;
    /// Variance of the bias.
    fn bias(&self) -> f64;
}

/// Of displacement, velocity and bias, as the six numbers of a symmetric matrix.
#[derive(Clone, Copy, Default)]
pub struct Motion {
    xx: f64,
    xv: f64,
    xb: f64,
    vv: f64,
    vb: f64,
    bb: f64,
}

impl Motion {
    /// Independent states of these variances.
    pub fn of(variance: [f64; 3]) -> Self {
        Self { xx: variance[0], vv: variance[1], bb: variance[2], ..Self::default() }
    }
}

impl Covariance for Motion {
    fn predict(&mut self, dt: f64, density: f64, bias_walk: f64) {
        let Self { xx, xv, xb, vv, vb, bb } = *self;
        let half = 0.5 * dt * dt;
        let m00 = xx + dt * xv - half * xb;
        let m01 = xv + dt * vv - half * vb;
        let m02 = xb + dt * vb - half * bb;
        let m11 = vv - dt * vb;
        let m12 = vb - dt * bb;
        *self = Self {
            xx: m00 + dt * m01 - half * m02 + density * dt * dt * dt / 3.0,
            xv: m01 - dt * m02 + density * half,
            xb: m02,
            vv: m11 - dt * m12 + density * dt,
            vb: m12,
            bb: bb + bias_walk * dt,
        };
    }

    fn decay(&mut self, _turn: Turn, _new: [f64; 3]) {}

    fn gain(&self, variance: f64) -> Gain {
        let total = self.xx + variance;
        Gain { total, gain: [self.xx / total, self.xv / total, self.xb / total, 0.0, 0.0] }
    }

    fn update(&mut self, &[k0, k1, k2, ..]: &[f64; 5], variance: f64) {
        let Self { xx, xv, xb, .. } = *self;
        let (rest, total) = (1.0 - k0, xx + variance);
        self.xx = rest * rest * xx + k0 * k0 * variance;
        self.xv = rest * (xv - k1 * xx) + k0 * k1 * variance;
        self.xb = rest * (xb - k2 * xx) + k0 * k2 * variance;
        self.vv += k1 * k1 * total - 2.0 * k1 * xv;
        self.vb += k1 * k2 * total - k1 * xb - k2 * xv;
        self.bb += k2 * k2 * total - 2.0 * k2 * xb;
    }

    fn displacement(&self) -> f64 {
        self.xx
    }

    fn bias(&self) -> f64 {
        self.bb
    }
}

/// The same together with a slow error of the measurements and its velocity.
#[derive(Clone, Copy, Default)]
pub struct WithSlowError {
    motion: Motion,
    /// Covariances of x, v, b, g and h with the slow error, and of x, v and b with its velocity and that one's variance.
    slow: [f64; 5],
    other: [f64; 4],
}

impl WithSlowError {
    /// Independent states: the motion's, and the variance of the slow error and of its velocity.
    pub fn of(motion: Motion, slow_variance: f64) -> Self {
        Self { motion, slow: [0.0, 0.0, 0.0, slow_variance, 0.0], other: [0.0, 0.0, 0.0, slow_variance] }
    }

    /// P h for h = (1, 0, 0, 1, 0).
    fn along(&self) -> [f64; 5] {
        let (m, s, o) = (&self.motion, &self.slow, &self.other);
        [m.xx + s[0], m.xv + s[1], m.xb + s[2], s[0] + s[3], o[0] + s[4]]
    }
}

impl Covariance for WithSlowError {
    fn predict(&mut self, dt: f64, density: f64, bias_walk: f64) {
        self.motion.predict(dt, density, bias_walk);
        for of in [&mut self.slow[..3], &mut self.other[..3]] {
            of[0] += dt * of[1] - 0.5 * dt * dt * of[2];
            of[1] -= dt * of[2];
        }
    }

    fn decay(&mut self, turn: Turn, new: [f64; 3]) {
        for k in 0..3 {
            (self.slow[k], self.other[k]) = turn.of(self.slow[k], self.other[k]);
        }
        let (gg, gh, hh) = (self.slow[3], self.slow[4], self.other[3]);
        let (first, second) = (turn.of(gg, gh), turn.of(gh, hh));
        (self.slow[3], self.slow[4]) = turn.of(first.0, second.0);
        self.other[3] = turn.of(first.1, second.1).1;
        self.slow[3] += new[0];
        self.slow[4] += new[1];
        self.other[3] += new[2];
    }

    fn gain(&self, variance: f64) -> Gain {
        let along = self.along();
        let total = along[0] + along[3] + variance;
        Gain { total, gain: along.map(|one| one / total) }
    }

    fn update(&mut self, k: &[f64; 5], variance: f64) {
        // P − K (P h)' − (P h) K' + K (h' P h + R) K'.
        let along = self.along();
        let total = along[0] + along[3] + variance;
        let taken = |i: usize, j: usize| k[i] * along[j] + along[i] * k[j] - k[i] * k[j] * total;
        let m = &mut self.motion;
        m.xx -= taken(0, 0);
        m.xv -= taken(0, 1);
        m.xb -= taken(0, 2);
        m.vv -= taken(1, 1);
        m.vb -= taken(1, 2);
        m.bb -= taken(2, 2);
        for (i, covariance) in self.slow.iter_mut().enumerate() {
            *covariance -= taken(i, 3);
        }
        for (covariance, i) in self.other.iter_mut().zip([0, 1, 2, 4]) {
            *covariance -= taken(i, 4);
        }
    }

    fn displacement(&self) -> f64 {
        self.motion.xx
    }

    fn bias(&self) -> f64 {
        self.motion.bb
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The prediction is Φ P Φ' + Q of the discretised motion, with the walk of the bias at the step's end.
        #[test]
        fn a_prediction_is_that_of_the_dense_matrices(root in prop::array::uniform9(-1.0..1.0f64), dt in 1e-4..1.0f64) {
            let dense = |i: usize, j: usize| (0..3).map(|k| root[3 * i + k] * root[3 * j + k]).sum::<f64>();
            let before = Motion {
                xx: dense(0, 0), xv: dense(0, 1), xb: dense(0, 2), vv: dense(1, 1), vb: dense(1, 2), bb: dense(2, 2),
            };
            let (density, walk) = (3.0, 0.2);
            let mut after = before;
            after.predict(dt, density, walk);
            let transition = [[1.0, dt, -0.5 * dt * dt], [0.0, 1.0, -dt], [0.0, 0.0, 1.0]];
            let noise = [
                [density * dt.powi(3) / 3.0, density * dt.powi(2) / 2.0, 0.0],
                [density * dt.powi(2) / 2.0, density * dt, 0.0],
                [0.0, 0.0, walk * dt],
            ];
            let expected = |i: usize, j: usize| {
                let moved = |a: usize, b: usize| transition[i][a] * dense(a, b) * transition[j][b];
                noise[i][j] + (0..9).map(|k| moved(k / 3, k % 3)).sum::<f64>()
            };
            let found = [(after.xx, 0, 0), (after.xv, 0, 1), (after.xb, 0, 2), (after.vv, 1, 1), (after.vb, 1, 2), (after.bb, 2, 2)];
            for (value, i, j) in found {
                // Sums of nine products of order one.
                prop_assert!((value - expected(i, j)).abs() < 1e-13);
            }
        }

        /// Without a slow error both forms are the same filter.
        #[test]
        fn a_slow_error_of_no_variance_changes_nothing(
            steps in prop::collection::vec((0.01..1.0f64, 0.1..10.0f64), 1..30), density in 1e-3..10.0f64
        ) {
            let mut plain = Motion::of([3.0, 2.0, 1.0]);
            let mut slow = WithSlowError::of(plain, 0.0);
            for (dt, variance) in steps {
                plain.predict(dt, density, 1e-3);
                slow.predict(dt, density, 1e-3);
                slow.decay(Turn::over(0.3, 0.4, 2.0), [0.0; 3]);
                let (one, other) = (plain.gain(variance), slow.gain(variance));
                plain.update(&one.gain, variance);
                slow.update(&other.gain, variance);
                // Both update forms round differently, at most some 1e-13 of the start's variances.
                prop_assert!((plain.displacement() - slow.displacement()).abs() < 1e-11);
                prop_assert!((plain.bias() - slow.bias()).abs() < 1e-11);
            }
        }
    }
}
