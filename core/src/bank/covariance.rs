//! The covariance of a point's six states, over any time and by one measurement.
//!
//! The states: displacement x, velocity v, bias b of the acceleration, slow error s of the displacement sensor, delay
//! τ of its stamps, relative error g of the accelerometer's gain. Between two measurements Φ is known in closed form,
//! so that P is moved once from measurement to measurement, and a row in between needs two of its elements alone.

use serde::{Deserialize, Serialize};

/// How many states there are.
pub const STATES: usize = 6;
/// Displacement, m.
pub const X: usize = 0;
/// Velocity, m/s.
pub const V: usize = 1;
/// Bias of the acceleration, m/s².
pub const B: usize = 2;
/// Slow error of the displacement sensor, m.
pub const S: usize = 3;
/// By how much the displacement sensor's stamps are late, s.
pub const T: usize = 4;
/// Relative error of the accelerometer's gain.
pub const G: usize = 5;
/// Elements of the first four states.
const FIRST: usize = 10;

/// One number a state.
pub type Vector = [f64; STATES];

/// What is added to the states' variances over time.
#[derive(Clone, Copy, Debug)]
pub struct Walks {
    /// Density of the acceleration's noise, (m/s²)²/Hz.
    pub density: f64,
    /// Density of the bias's walk, (m/s²)²/s.
    pub bias: f64,
    /// Density of the delay's, s²/s.
    pub delay: f64,
    /// Density of the gain's, 1/s.
    pub gain: f64,
    /// Stationary variance of the slow error, m².
    pub slow_m2: f64,
    /// Its correlation time, s.
    pub slow_time_s: f64,
}

/// A time without measurement: its length (s), and displacement (m) and velocity (m/s) that the acceleration without
/// its bias adds in it, which the gain's error is a share of.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    /// s.
    pub t: f64,
    /// m.
    pub displacement: f64,
    /// m/s.
    pub velocity: f64,
}

/// The covariance as it is kept: what concerns delay and gain as f32, to which their own size matters alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    first: [f64; FIRST],
    others: [f32; 11],
}

impl Kept {
    /// All elements.
    #[inline]
    pub fn whole(&self) -> Covariance {
        let mut p = [[0.0; STATES]; STATES];
        for (i, row) in p.iter_mut().enumerate() {
            for (j, element) in row.iter_mut().enumerate() {
                let k = place(i.max(j), i.min(j));
                *element = if k < FIRST { self.first[k] } else { f64::from(self.others[k - FIRST]) };
            }
        }
        Covariance(p)
    }

    /// Variances of displacement and velocity after a span; q, w: densities of the acceleration's noise and of its
    /// bias's walk.
    #[inline]
    pub fn row(&self, span: &Span, q: f64, w: f64) -> (f64, f64) {
        let [xx, xv, vv, xb, vb, bb, ..] = self.first;
        let [.., xg, vg, bg, _, _, gg] = self.others.map(f64::from);
        let (t, d, u) = (span.t, span.displacement, span.velocity);
        let half = 0.5 * t * t;
        let place = xx + t * (2.0 * xv + t * vv) - half * (2.0 * (xb + t * vb) - half * bb);
        let speed = vv - t * (2.0 * vb - t * bb);
        let place = place + d * (2.0 * (xg + t * vg - half * bg) + d * gg);
        let speed = speed + u * (2.0 * (vg - t * bg) + u * gg);
        (place + t * t * t * (q / 3.0 + 0.05 * w * t * t), speed + t * (q + w * t * t / 3.0))
    }
}

/// All elements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance(pub [[f64; STATES]; STATES]);

impl Covariance {
    /// As it is kept.
    #[inline]
    pub fn kept(&self) -> Kept {
        let mut kept = Kept::default();
        for (i, row) in self.0.iter().enumerate() {
            for (j, &element) in row.iter().enumerate().take(i + 1) {
                let k = place(i, j);
                if k < FIRST {
                    kept.first[k] = element;
                } else {
                    kept.others[k - FIRST] = element as f32;
                }
            }
        }
        kept
    }

    /// Φ P Φ' + Q after a span; decay: what is left of the slow error.
    #[inline]
    #[allow(clippy::needless_range_loop)]
    pub fn moved(mut self, span: &Span, decay: f64, walks: &Walks) -> Self {
        let p = &mut self.0;
        let (t, half) = (span.t, 0.5 * span.t * span.t);
        for j in 0..STATES {
            p[X][j] += t * p[V][j] - half * p[B][j] + span.displacement * p[G][j];
            p[V][j] += span.velocity * p[G][j] - t * p[B][j];
            p[S][j] *= decay;
        }
        for row in p.iter_mut() {
            row[X] += t * row[V] - half * row[B] + span.displacement * row[G];
            row[V] += span.velocity * row[G] - t * row[B];
            row[S] *= decay;
        }
        let (q, w) = (walks.density, walks.bias);
        p[X][X] += t * t * t / 3.0 * (q + 0.15 * w * t * t);
        p[V][V] += t * (q + w * t * t / 3.0);
        let (xv, xb, vb) = (half * (q + 0.25 * w * t * t), -w * t * t * t / 6.0, -w * half);
        for (i, j, more) in [(X, V, xv), (X, B, xb), (V, B, vb)] {
            p[i][j] += more;
            p[j][i] += more;
        }
        p[B][B] += w * t;
        p[S][S] += walks.slow_m2 * (1.0 - decay * decay);
        p[T][T] += walks.delay * t;
        p[G][G] += walks.gain * t;
        self
    }

    /// P h'.
    #[inline]
    pub fn times(&self, h: &Vector) -> Vector {
        self.0.map(|row| dot(&row, h))
    }

    /// P + c a a'.
    #[inline]
    pub fn with(mut self, c: f64, a: &Vector) -> Self {
        let by = a.map(|one| c * one);
        for (row, by) in self.0.iter_mut().zip(by) {
            for (element, other) in row.iter_mut().zip(a) {
                *element += by * other;
            }
        }
        self
    }
}

/// Where an element of the lower triangle is kept.
#[inline(always)]
const fn place(i: usize, j: usize) -> usize {
    i * (i + 1) / 2 + j
}

/// a' b.
#[inline]
pub fn dot(a: &Vector, b: &Vector) -> f64 {
    let mut sum = 0.0;
    for (a, b) in a.iter().zip(b) {
        sum += a * b;
    }
    sum
}
