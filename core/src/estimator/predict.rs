//! States and covariance moved over a piece of an interval: Φ x + Γ a and Φ P Φ' + Q.

use super::layout::{Layout, MOTION_STATES, motion_of};
use super::matrix::Matrix;
use super::motion::Way;

/// Moves the motion of all axes; the input moves the estimate, and the sensitivity to the gain of its accelerometer.
///
/// gain_of (k,): the axis whose accelerometer's gain error a parameter is.
#[inline]
pub fn predict_mean(x: &mut Matrix, axes: usize, way: &Way, gain_of: &[Option<usize>]) {
    let (dt, half) = (way.dt, 0.5 * way.dt * way.dt);
    let width = x.width();
    for (a, moved) in way.moved.iter().enumerate().take(axes) {
        let first = motion_of(a) * width;
        let rows = &mut x.elements_mut()[first..first + MOTION_STATES * width];
        let (places, rest) = rows.split_at_mut(width);
        let (speeds, biases) = rest.split_at_mut(width);
        for ((place, speed), &bias) in places.iter_mut().zip(speeds.iter_mut()).zip(biases.iter()) {
            *place += dt * *speed - half * bias;
            *speed -= dt * bias;
        }
        places[0] += moved.x;
        speeds[0] += moved.v;
        for (q, &of) in gain_of.iter().enumerate() {
            if of == Some(a) {
                places[1 + q] -= moved.x;
                speeds[1 + q] -= moved.v;
            }
        }
    }
}

/// Φ P Φ' over `dt` seconds, and the walks of all states; the acceleration's noise is [`add_noise`].
///
/// uncertain: as of [`Layout::find_uncertain`]; nothing is to be done for the other constants.
#[inline]
pub fn predict_covariance(p: &mut Matrix, layout: &Layout, dt: f64, uncertain: &[usize]) {
    let (moving, half, walks) = (layout.moving(), 0.5 * dt * dt, layout.walks());
    for i in (0..moving).step_by(MOTION_STATES) {
        predict_axis(p, i, dt, walks[i + 2]);
        for k in (i + MOTION_STATES..moving).step_by(MOTION_STATES) {
            predict_across(p, i, k, dt);
        }
        for &j in uncertain {
            let (v, b) = (p[(i + 1, j)], p[(i + 2, j)]);
            let x = p[(i, j)] + (dt * v - half * b);
            p.set_both(i, j, x);
            p.set_both(i + 1, j, v - dt * b);
        }
    }
    for &j in uncertain {
        p[(j, j)] += walks[j] * dt;
    }
}

/// The covariance of one axis' motion, whose first state is `i`.
#[inline]
fn predict_axis(p: &mut Matrix, i: usize, dt: f64, walk: f64) {
    let n = p.width();
    let half = 0.5 * dt * dt;
    let first = i * n + i;
    let e = &mut p.elements_mut()[first..first + 2 * n + MOTION_STATES];
    let (p01, p02, p11, p12, p22) = (e[1], e[2], e[n + 1], e[n + 2], e[2 * n + 2]);
    let m01 = p01 + (dt * p11 - half * p12);
    let m02 = p02 + (dt * p12 - half * p22);
    let m12 = p12 - dt * p22;
    e[0] += (dt * p01 - half * p02) + (dt * m01 - half * m02);
    let q01 = m01 - dt * m02;
    e[1] = q01;
    e[n] = q01;
    e[2] = m02;
    e[2 * n] = m02;
    e[n + 1] = (p11 - dt * p12) - dt * m12;
    e[n + 2] = m12;
    e[2 * n + 1] = m12;
    e[2 * n + 2] = p22 + walk * dt;
}

/// The covariances between the motions of two axes, whose first states are `i` and `k`.
fn predict_across(p: &mut Matrix, i: usize, k: usize, dt: f64) {
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
    let half = 0.5 * density * dt * dt;
    p[(i, i)] += density * dt * dt * dt / 3.0;
    p[(i, i + 1)] += half;
    p[(i + 1, i)] += half;
    p[(i + 1, i + 1)] += density * dt;
}
