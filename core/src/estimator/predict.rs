//! States and covariance moved over a piece of an interval: Φ x + Γ a and Φ P Φ' + Q.

use super::layout::{Layout, MOTION_STATES, motion_of};
use super::matrix::Matrix;
use super::motion::{Response, Way};

/// Moves the motion of all axes; the input moves the estimate, and the sensitivity to the gain of its accelerometer.
///
/// gain_of (k,): the axis whose accelerometer's gain error a parameter is.
#[inline]
pub fn predict_mean(x: &mut Matrix, axes: usize, way: &Way, gain_of: &[Option<usize>]) {
    let half = 0.5 * way.dt * way.dt;
    for (a, &moved) in way.moved.iter().enumerate().take(axes) {
        let i = motion_of(a);
        MotionMean::of(x, i).moved(way.dt, moved).put(x, i);
        for (q, &of) in gain_of.iter().enumerate() {
            let (v, b) = (x[(i + 1, 1 + q)], x[(i + 2, 1 + q)]);
            x[(i, 1 + q)] += way.dt * v - half * b;
            x[(i + 1, 1 + q)] -= way.dt * b;
            if of == Some(a) {
                x[(i, 1 + q)] -= moved.x;
                x[(i + 1, 1 + q)] -= moved.v;
            }
        }
    }
}

/// The estimate of one axis' motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionMean {
    /// Displacement, m.
    pub x: f64,
    /// Velocity state, m/s.
    pub v: f64,
    /// Bias, m/s².
    pub b: f64,
}

impl MotionMean {
    /// That of the axis whose first state is `i`.
    #[inline(always)]
    pub fn of(x: &Matrix, i: usize) -> Self {
        Self { x: x[(i, 0)], v: x[(i + 1, 0)], b: x[(i + 2, 0)] }
    }

    /// Puts it into its place.
    #[inline(always)]
    pub fn put(&self, x: &mut Matrix, i: usize) {
        (x[(i, 0)], x[(i + 1, 0)], x[(i + 2, 0)]) = (self.x, self.v, self.b);
    }

    /// Φ x + Γ a over `dt` seconds; moved: what the input adds.
    #[inline(always)]
    pub fn moved(self, dt: f64, moved: Response) -> Self {
        let Self { x, v, b } = self;
        Self { x: x + (dt * v - 0.5 * dt * dt * b) + moved.x, v: v - dt * b + moved.v, b }
    }
}

/// The covariance of one axis' motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionCovariance {
    /// Of the displacement, m².
    pub xx: f64,
    /// Of displacement and velocity.
    pub xv: f64,
    /// Of displacement and bias.
    pub xb: f64,
    /// Of the velocity.
    pub vv: f64,
    /// Of velocity and bias.
    pub vb: f64,
    /// Of the bias.
    pub bb: f64,
}

impl MotionCovariance {
    /// That of the axis whose first state is `i`.
    #[inline(always)]
    pub fn of(p: &Matrix, i: usize) -> Self {
        let n = p.width();
        let e = &p.elements()[i * n + i..i * n + i + 2 * n + MOTION_STATES];
        Self { xx: e[0], xv: e[1], xb: e[2], vv: e[n + 1], vb: e[n + 2], bb: e[2 * n + 2] }
    }

    /// Puts it into its place.
    #[inline(always)]
    pub fn put(&self, p: &mut Matrix, i: usize) {
        let n = p.width();
        let e = &mut p.elements_mut()[i * n + i..i * n + i + 2 * n + MOTION_STATES];
        (e[0], e[1], e[2]) = (self.xx, self.xv, self.xb);
        (e[n], e[n + 1], e[n + 2]) = (self.xv, self.vv, self.vb);
        (e[2 * n], e[2 * n + 1], e[2 * n + 2]) = (self.xb, self.vb, self.bb);
    }

    /// Φ P Φ' over `dt` seconds; walk: density of the bias's.
    #[inline(always)]
    pub fn moved(self, dt: f64, walk: f64) -> Self {
        let Self { xx, xv, xb, vv, vb, bb } = self;
        let half = 0.5 * dt * dt;
        let m_xv = xv + (dt * vv - half * vb);
        let m_xb = xb + (dt * vb - half * bb);
        let m_vb = vb - dt * bb;
        Self {
            xx: xx + ((dt * xv - half * xb) + (dt * m_xv - half * m_xb)),
            xv: m_xv - dt * m_xb,
            xb: m_xb,
            vv: (vv - dt * vb) - dt * m_vb,
            vb: m_vb,
            bb: bb + walk * dt,
        }
    }

    /// Noise of the acceleration over `dt` seconds; density: (m/s²)²/Hz.
    #[inline(always)]
    pub fn with_noise(self, dt: f64, density: f64) -> Self {
        let half = 0.5 * density * dt * dt;
        Self { xx: self.xx + density * dt * dt * dt / 3.0, xv: self.xv + half, vv: self.vv + density * dt, ..self }
    }
}

/// Φ P Φ' over `dt` seconds, the walks of all states, and noise of the acceleration with these densities (axes,) or
/// none.
///
/// uncertain: as of [`Layout::find_uncertain`]; nothing is to be done for the other constants.
#[inline]
pub fn predict_covariance(p: &mut Matrix, layout: &Layout, dt: f64, uncertain: &[usize], density: &[f64]) {
    let (moving, walks) = (layout.moving(), layout.walks());
    for i in (0..moving).step_by(MOTION_STATES) {
        let mut own = MotionCovariance::of(p, i).moved(dt, walks[i + 2]);
        if let Some(&density) = density.get(i / MOTION_STATES) {
            own = own.with_noise(dt, density);
        }
        own.put(p, i);
        for k in (i + MOTION_STATES..moving).step_by(MOTION_STATES) {
            predict_across(p, i, k, dt);
        }
        predict_others(p, i, dt, uncertain);
        mirror_others(p, i, uncertain);
    }
    predict_walks(p, walks, dt, uncertain);
}

/// The covariances of the motion whose first state is `i` with other states, in its rows alone.
#[inline(always)]
pub fn predict_others(p: &mut Matrix, i: usize, dt: f64, others: &[usize]) {
    let (half, n) = (0.5 * dt * dt, p.width());
    let rows = &mut p.elements_mut()[i * n..(i + MOTION_STATES) * n];
    let (places, rest) = rows.split_at_mut(n);
    let (speeds, biases) = rest.split_at_mut(n);
    for &j in others {
        let (v, b) = (speeds[j], biases[j]);
        places[j] += dt * v - half * b;
        speeds[j] = v - dt * b;
    }
}

/// Copies these covariances to the other states' rows.
#[inline(always)]
pub fn mirror_others(p: &mut Matrix, i: usize, others: &[usize]) {
    for &j in others {
        for k in i..i + MOTION_STATES {
            p[(j, k)] = p[(k, j)];
        }
    }
}

/// The walks of other states.
#[inline(always)]
pub fn predict_walks(p: &mut Matrix, walks: &[f64], dt: f64, others: &[usize]) {
    for &j in others {
        p[(j, j)] += walks[j] * dt;
    }
}

/// The covariances between the motions of two axes, whose first states are `i` and `k`.
pub fn predict_across(p: &mut Matrix, i: usize, k: usize, dt: f64) {
    let half = 0.5 * dt * dt;
    for j in k..k + MOTION_STATES {
        let (v, b) = (p[(i + 1, j)], p[(i + 2, j)]);
        p[(i, j)] += dt * v - half * b;
        p[(i + 1, j)] -= dt * b;
    }
    for j in i..i + MOTION_STATES {
        let (v, b) = (p[(j, k + 1)], p[(j, k + 2)]);
        p[(j, k)] += dt * v - half * b;
        p[(j, k + 1)] -= dt * b;
        for c in k..k + MOTION_STATES {
            p[(c, j)] = p[(j, c)];
        }
    }
}

/// Noise of the acceleration along an axis over `dt` seconds; density: (m/s²)²/Hz.
#[inline]
pub fn add_noise(p: &mut Matrix, axis: usize, dt: f64, density: f64) {
    let i = motion_of(axis);
    MotionCovariance::of(p, i).with_noise(dt, density).put(p, i);
}

/// Φ times covariances with the motion of all axes, `dt` seconds on.
#[inline]
pub fn move_on(covariances: &mut [f64], dt: f64) {
    let half = 0.5 * dt * dt;
    for motion in covariances.chunks_exact_mut(MOTION_STATES) {
        let (v, b) = (motion[1], motion[2]);
        motion[0] += dt * v - half * b;
        motion[1] = v - dt * b;
    }
}
