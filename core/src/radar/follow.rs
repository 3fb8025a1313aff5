//! Unwrapping inside a filter: the wrapped phase corrects a prediction from the accelerometer.
//!
//! States: range change u (m), its rate v (m/s) and the bias b (m/s²) of the acceleration in the line of sight. Only
//! the innovation is wrapped, so no speed is too high while the prediction is within a quarter of a wavelength.
//! Innovations that are far outside get a larger variance (Huber, Ann. Math. Stat. 35, 1964); the acceleration's noise
//! is scaled until innovations are as large as predicted.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// The phase of a target whose noise reaches this (rad) says nothing about its cycle.
pub const BLIND_RAD: f64 = 0.77;
/// A prediction whose standard deviation exceeds this share of a cycle cannot name the cycle any more.
pub const UNSURE_CYCLES: f64 = 0.2;
/// Innovations beyond this many standard deviations get a larger variance instead of a full say.
const HUBER: f64 = 2.5;
/// The logarithm of the noise's factor follows the squares of the innovations over this many frames.
const MISFIT_FRAMES: f64 = 40.0;
/// Each square counts at most so much.
const MAX_MISFIT: f64 = 9.0;
/// Largest logarithm of the factor.
const MAX_INFLATED: f64 = 16.0;
/// At low signal-to-noise ratio the phase's errors have longer tails than the variance says: usual square.
const FAIR_MISFIT: f64 = 1.5;
/// The factor does not rise where it leaves the prediction wider than this, cycles.
const WIDEST_CYCLES: f64 = 0.12;
/// Memory of the comparison of accelerometer and phase, frames.
const WATCH_FRAMES: f64 = 100.0;
/// Frames before the comparison may call the accelerometer dead, and before a wide prediction is an outage.
const WATCHED_BEFORE_DEAD: f64 = 10.0;
const WATCHED_BEFORE_LOST: f64 = 3.0;
/// A dead accelerometer explains less than this share of the phase's second differences.
const DEAD_SHARE: f64 = 0.1;
/// These are then this many times what noise makes.
const DEAD_EXCESS: f64 = 3.0;

/// How far the accelerometer is trusted.
#[derive(Clone, Copy, Serialize, Deserialize)]
pub struct Trust {
    /// Density of the acceleration's noise in the line of sight, (m/s²)²/Hz.
    pub noise_density: f64,
    /// Relative error of the conversion factor.
    pub scale_error: f64,
    /// Error of the time offset, s.
    pub time_error_s: f64,
    /// Growth of the bias' variance, (m/s²)² a second.
    pub bias_walk: f64,
}

/// What happens from the frame before to a frame.
#[derive(Clone, Copy)]
pub struct Step {
    /// Time since the frame before, s.
    pub dt: f64,
    /// Wrapped phase, rad; not finite where there is none.
    pub phase: f64,
    /// Its variance, rad².
    pub variance: f64,
    /// Change of velocity by the acceleration, m/s.
    pub velocity: f64,
    /// Change of displacement less velocity times time, m.
    pub displacement: f64,
    /// Mean acceleration, m/s².
    pub acceleration: f64,
    /// Mean rate of change of the acceleration, m/s³.
    pub jerk: f64,
}

/// What a frame leaves.
#[derive(Clone, Copy)]
pub struct Followed {
    /// The unwrapped phase, rad; None where the frame was not used.
    pub phase: Option<f64>,
    /// Whether its cycle is a guess.
    pub cycle_lost: bool,
    /// Logarithm of the innovation's variance plus its square over that; None where there was none.
    pub surprise: Option<f64>,
    /// The filter's range change, m.
    pub range_m: f64,
    /// Its variance, m².
    pub range_variance: f64,
}

/// The accelerometer compared with the second differences of the phase.
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
struct Comparison {
    acceleration: f64,
    difference: f64,
    product: f64,
    frames: f64,
    last_acceleration: f64,
    /// The last two phases, rad, and how many in a row were used.
    last: f64,
    before: f64,
    run: u32,
}

impl Comparison {
    /// Variance (m/s²)² of the acceleration that a dead accelerometer misses; None where it is not dead.
    fn missed(&mut self, wrapped: f64, rad_per_m: f64, acceleration: f64, dt: f64, variance: f64) -> Option<f64> {
        if self.run < 2 {
            return None;
        }
        let acceleration = 0.5 * (acceleration + self.last_acceleration);
        self.frames += 1.0;
        let unit = rad_per_m * dt * dt;
        // Wrapped about what the accelerometer says, so that a strong motion does not look like another one.
        let expected = unit * acceleration;
        let second = (wrap(wrapped - 2.0 * self.last + self.before - expected) + expected) / unit;
        let new = 1.0 / WATCH_FRAMES.min(self.frames);
        let floor = 6.0 * variance / (unit * unit);
        self.acceleration += new * (acceleration * acceleration - self.acceleration);
        self.difference += new * (second * second - floor - self.difference);
        self.product += new * (second * acceleration - self.product);
        if self.frames <= WATCHED_BEFORE_DEAD || self.difference <= DEAD_EXCESS * floor {
            return None;
        }
        let share = self.product * self.product / (self.acceleration * self.difference).max(1e-300);
        (share < DEAD_SHARE || self.product < 0.0).then_some(self.difference)
    }
}

/// The filter; any cutting into blocks gives the same.
#[derive(Clone, Serialize, Deserialize)]
pub struct Follower {
    rad_per_m: f64,
    trust: Trust,
    /// Range change, rate, bias.
    mean: [f64; 3],
    covariance: [[f64; 3]; 3],
    /// Natural logarithm of the factor on the acceleration's noise.
    inflation: f64,
    /// The first phase used, from which the range change counts.
    origin: Option<f64>,
    comparison: Comparison,
}

impl Follower {
    /// `speed`, `speed_std`, `bias_std`: of the range at the first frame, m/s and m/s²; `inflation`: natural logarithm
    /// of the factor on the acceleration's noise there.
    pub fn new(rad_per_m: f64, trust: Trust, speed: f64, speed_std: f64, bias_std: f64, inflation: f64) -> Self {
        let mut covariance = [[0.0; 3]; 3];
        covariance[1][1] = speed_std * speed_std;
        covariance[2][2] = bias_std * bias_std;
        Self {
            rad_per_m,
            trust,
            mean: [0.0, speed, 0.0],
            covariance,
            inflation,
            origin: None,
            comparison: Comparison::default(),
        }
    }

    /// The phase, rad, from which the range change counts; 0 before the first one that was used.
    pub fn origin(&self) -> f64 {
        self.origin.unwrap_or(0.0)
    }

    /// One frame.
    pub fn push(&mut self, step: &Step) -> Followed {
        let usable = step.phase.is_finite() && step.variance < BLIND_RAD * BLIND_RAD;
        let Some(origin) = self.origin else { return self.begin(step, usable) };
        let acceleration = step.acceleration - self.mean[2];
        let dead = if usable {
            self.comparison.missed(step.phase, self.rad_per_m, acceleration, step.dt, step.variance)
        } else {
            None
        };
        let factor = if usable { self.inflation.exp() } else { 1.0 };
        self.predict(step, factor, dead);
        self.comparison.last_acceleration = step.acceleration - self.mean[2];
        if !usable {
            self.comparison.run = 0;
            return self.leave(None, false, None);
        }
        let cycle_m = TAU / self.rad_per_m;
        let predicted = self.rad_per_m * self.mean[0] + origin;
        let innovation = wrap(step.phase - predicted);
        // The first frames, whose speed is not known yet, are no return from an outage.
        let lost = self.comparison.frames > WATCHED_BEFORE_LOST && self.std() > UNSURE_CYCLES * cycle_m;
        let variance = step.variance / (self.rad_per_m * self.rad_per_m);
        let total = self.covariance[0][0] + variance;
        let misfit = self.correct(innovation / self.rad_per_m, variance);
        if misfit < 1.0 || self.std() < WIDEST_CYCLES * cycle_m {
            let rise = (misfit.min(MAX_MISFIT) - FAIR_MISFIT) / MISFIT_FRAMES;
            self.inflation = (self.inflation + rise).clamp(0.0, MAX_INFLATED);
        }
        let c = &mut self.comparison;
        (c.before, c.last, c.run) = (c.last, step.phase, c.run.saturating_add(1));
        self.leave(Some(predicted + innovation), lost, Some(total.ln() + misfit))
    }

    /// The first usable frame is the zero of the range change.
    fn begin(&mut self, step: &Step, usable: bool) -> Followed {
        if usable {
            self.origin = Some(step.phase);
            let c = &mut self.comparison;
            (c.before, c.last, c.run) = (step.phase, step.phase, 1);
            self.covariance[0][0] = step.variance / (self.rad_per_m * self.rad_per_m);
        }
        let found = self.leave(usable.then_some(step.phase), false, None);
        Followed { range_m: 0.0, ..found }
    }

    fn std(&self) -> f64 {
        self.covariance[0][0].sqrt()
    }

    fn leave(&self, phase: Option<f64>, cycle_lost: bool, surprise: Option<f64>) -> Followed {
        Followed { phase, cycle_lost, surprise, range_m: self.mean[0], range_variance: self.covariance[0][0] }
    }

    /// Over a step; `factor` on the acceleration's noise; `dead`: what a dead accelerometer misses, (m/s²)².
    fn predict(&mut self, step: &Step, factor: f64, dead: Option<f64>) {
        let (dt, half) = (step.dt, 0.5 * step.dt * step.dt);
        let (velocity, displacement, bias) = match dead {
            Some(_) => (0.0, 0.0, 0.0),
            None => (step.velocity, step.displacement, self.mean[2]),
        };
        self.mean[0] += dt * self.mean[1] + displacement - half * bias;
        self.mean[1] += velocity - dt * bias;
        let density = self.trust.noise_density * factor;
        let missed =
            (self.trust.scale_error * step.acceleration).powi(2) + (self.trust.time_error_s * step.jerk).powi(2);
        let held = missed * factor + dead.unwrap_or(0.0);
        let [[p00, p01, p02], [_, p11, p12], [_, _, p22]] = self.covariance;
        let (m00, m01, m02) = (p00 + dt * p01 - half * p02, p01 + dt * p11 - half * p12, p02 + dt * p12 - half * p22);
        let (m11, m12) = (p11 - dt * p12, p12 - dt * p22);
        self.set_covariance([
            m00 + dt * m01 - half * m02 + density * dt * dt * dt / 3.0 + held * half * half,
            m01 - dt * m02 + density * half + held * half * dt,
            m02,
            m11 - dt * m12 + density * dt + held * dt * dt,
            m12,
            p22 + self.trust.bias_walk * dt,
        ]);
    }

    /// By an innovation (m) of given variance (m²); returns its square over the predicted variance.
    fn correct(&mut self, innovation: f64, mut variance: f64) -> f64 {
        let [[p00, p01, p02], [_, p11, p12], [_, _, p22]] = self.covariance;
        let mut total = p00 + variance;
        let misfit = innovation * innovation / total;
        if misfit > HUBER * HUBER {
            variance += innovation.abs() / HUBER * total.sqrt() - total;
            total = p00 + variance;
        }
        let (k0, k1, k2) = (p00 / total, p01 / total, p02 / total);
        self.mean[0] += k0 * innovation;
        self.mean[1] += k1 * innovation;
        self.mean[2] += k2 * innovation;
        let rest = 1.0 - k0;
        self.set_covariance([
            rest * rest * p00 + k0 * k0 * variance,
            rest * (p01 - k1 * p00) + k0 * k1 * variance,
            rest * (p02 - k2 * p00) + k0 * k2 * variance,
            p11 + k1 * k1 * total - 2.0 * k1 * p01,
            p12 + k1 * k2 * total - k1 * p02 - k2 * p01,
            p22 + k2 * k2 * total - 2.0 * k2 * p02,
        ]);
        misfit
    }

    fn set_covariance(&mut self, [p00, p01, p02, p11, p12, p22]: [f64; 6]) {
        self.covariance = [[p00, p01, p02], [p01, p11, p12], [p02, p12, p22]];
    }
}

fn wrap(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round_ties_even()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trust() -> Trust {
        Trust { noise_density: 1e-6, scale_error: 0.02, time_error_s: 1e-3, bias_walk: 1e-8 }
    }

    /// A range that moves by many cycles between frames is followed as long as the accelerometer predicts it.
    #[test]
    fn a_motion_of_many_cycles_is_unwrapped_by_the_accelerometer() {
        let (rad_per_m, omega, size, dt) = (3225.0, TAU * 2.0, 0.02, 0.01);
        let mut follower = Follower::new(rad_per_m, trust(), size * omega, 0.01, 0.01, 0.0);
        for k in 0..1000 {
            let (before, t) = (f64::from(k - 1) * dt, f64::from(k) * dt);
            let (u, v) = (size * (omega * t).sin(), size * omega * (omega * t).cos());
            let (u0, v0) = (size * (omega * before).sin(), size * omega * (omega * before).cos());
            let step = Step {
                dt: if k == 0 { 0.0 } else { dt },
                phase: wrap(rad_per_m * u),
                variance: 1e-4,
                velocity: v - v0,
                displacement: u - u0 - v0 * dt,
                acceleration: (v - v0) / dt,
                jerk: -omega * omega * v,
            };
            let found = follower.push(&step);
            let phase = found.phase.unwrap() - follower.origin();
            assert!((phase - rad_per_m * u).abs() < 1e-9 * rad_per_m && !found.cycle_lost, "{k}");
        }
    }

    #[test]
    fn a_frame_without_a_phase_goes_on_by_the_accelerometer() {
        let mut follower = Follower::new(100.0, trust(), 1.0, 0.01, 0.01, 0.0);
        let still = Step {
            dt: 0.1,
            phase: 0.0,
            variance: 1e-4,
            velocity: 0.0,
            displacement: 0.0,
            acceleration: 0.0,
            jerk: 0.0,
        };
        follower.push(&still);
        let found = follower.push(&Step { phase: f64::NAN, ..still });
        assert!(found.phase.is_none() && (found.range_m - 0.1).abs() < 1e-12);
    }
}
