//! `adaptive-kalman` exactly as printed: the noise of the displacement is estimated from frame to frame.
//!
//! The adaptive multirate filter of Ma, Choi and Sohn, Computer-Aided Civil and Infrastructure Engineering 37 (2022)
//! 688-703, doi 10.1111/mice.12767, equations 7 to 26: displacement and velocity, the acceleration held over each
//! sample (or the mean of both ends), and the noise variance by equation 20, which can become negative and runs away under
//! a bias. Letters as there: G the covariance before a frame, K the gain, R the noise variance of a frame, beta the forgetting factor.

use serde::{Deserialize, Serialize};

/// A symmetric covariance of displacement and velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Covariance {
    /// Of the displacement, m².
    pub x: f64,
    /// Of both, m²/s.
    pub xv: f64,
    /// Of the velocity, m²/s².
    pub v: f64,
}

impl Covariance {
    /// Equation 8: A(dt) P A(dt)' + noise B(dt) B(dt)'.
    pub fn moved(self, dt: f64, noise: f64) -> Self {
        let half = 0.5 * dt * dt;
        let xv = self.xv + dt * self.v;
        Self {
            x: self.x + dt * (self.xv + xv) + noise * half * half,
            xv: xv + noise * half * dt,
            v: self.v + noise * dt * dt,
        }
    }
}

/// A frame: time (s), displacement (m), declared variance (m², not finite: ignored).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// When, s.
    pub at_s: f64,
    /// Displacement, m.
    pub value_m: f64,
    /// Declared variance, m².
    pub variance_m2: f64,
}

/// How R is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Learning {
    /// The forgetting factor.
    pub beta: f64,
    /// Frames in which R stays.
    pub first_frames: f64,
    /// What acts between two samples.
    pub input: Input,
}

/// The acceleration that acts from one sample to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// The first one's, as equation 7 is printed: half a sample late.
    Held,
    /// The mean of both, which is not late.
    Mean,
}

/// What the filter remembers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Printed {
    /// Displacement, m.
    pub x: f64,
    /// Velocity, m/s.
    pub v: f64,
    /// The bias that is taken off, m/s².
    pub bias: f64,
    /// Covariance.
    pub p: Covariance,
    /// Time, s.
    pub time_s: f64,
    /// The acceleration held, m/s².
    pub input: f64,
    /// The noise variance R of a frame, m².
    pub noise: f64,
    /// How many frames were used.
    pub count: f64,
    /// Variance of the acceleration of the last interval.
    pub input_noise: f64,
}

/// What R is of the first frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// As given, m²; None: the first declared variance and `held_noise`.
    pub noise: Option<f64>,
    /// What the held acceleration adds, m².
    pub held_noise: f64,
}

/// What is given of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrintedRow {
    /// Displacement, m.
    pub x: f64,
    /// Velocity, m/s.
    pub v: f64,
}

/// Effect of the state and of the acceleration's noise at the interval's start on the state now: W1 and W2.
struct Carried {
    w: [f64; 4],
    b: [f64; 2],
    /// What the frames' own noise has become.
    n: Covariance,
}

impl Printed {
    /// At the first sample, from which times count; until the first frame nothing is known of the position that the
    /// printed start puts to zero.
    pub fn new(bias: f64, velocity_std: f64) -> Self {
        Self {
            x: 0.0,
            v: 0.0,
            bias,
            p: Covariance { v: velocity_std * velocity_std, ..Covariance::default() },
            time_s: 0.0,
            input: 0.0,
            noise: 0.0,
            count: 0.0,
            input_noise: 0.0,
        }
    }

    /// Before the first frame: its noise.
    pub fn begin(&mut self, frames: &[Frame], start: Start) {
        let first = frames.iter().find(|one| one.at_s >= self.time_s);
        if let (true, Some(first)) = (self.count == 0.0, first) {
            self.noise = start.noise.unwrap_or(first.variance_m2 + start.held_noise);
        }
    }

    /// Equation 7: A(dt) x + B(dt) a.
    fn hold(&mut self, dt: f64, a: f64) {
        self.x += dt * self.v + 0.5 * dt * dt * a;
        self.v += dt * a;
    }

    /// Runs over samples (time in s, acceleration, noise density), with frames in time order; noises: R of each frame,
    /// None where it was not used. Returns how many frames are done.
    pub fn run(
        &mut self,
        samples: impl Iterator<Item = [f64; 3]>,
        frames: &[Frame],
        learning: Learning,
        rows: &mut Vec<PrintedRow>,
        noises: &mut [Option<f64>],
    ) -> usize {
        let mut j = 0;
        for [end_s, value, density] in samples {
            let dt = end_s - self.time_s;
            let q = if dt > 0.0 { density / dt } else { 0.0 };
            if learning.input == Input::Mean {
                self.input = 0.5 * (self.input + value - self.bias);
            }
            // Frames before the last sample, and those to be ignored, are no frames of this interval.
            while frames.get(j).is_some_and(|one| one.at_s < self.time_s || !one.variance_m2.is_finite()) {
                j += 1;
            }
            if frames.get(j).is_some_and(|one| one.at_s <= end_s) {
                j = self.take_frames(frames, j, noises, (end_s, q), learning);
            } else {
                self.hold(dt, self.input);
                self.p = self.p.moved(dt, q);
            }
            (self.time_s, self.input, self.input_noise) = (end_s, value - self.bias, q);
            rows.push(PrintedRow { x: self.x, v: self.v });
        }
        j
    }

    /// Types II and III: the frames of an interval, then on to its end by equations 21 to 26.
    ///
    /// For one frame they are equations 23 to 25, and more frames in one interval go on from there. The position is
    /// known no better before the first frame than a frame's noise.
    fn take_frames(
        &mut self,
        frames: &[Frame],
        mut j: usize,
        noises: &mut [Option<f64>],
        (end_s, q): (f64, f64),
        learning: Learning,
    ) -> usize {
        if self.count == 0.0 {
            self.p.x += self.noise;
        }
        let (p, a, mut reached) = (self.p, self.input, self.time_s);
        let mut carried = Carried { w: [1.0, 0.0, 0.0, 1.0], b: [0.0; 2], n: Covariance::default() };
        loop {
            let frame = frames.get(j).filter(|one| one.at_s <= end_s);
            if frame.is_some_and(|one| one.at_s < reached || !one.variance_m2.is_finite()) {
                j += 1;
                continue;
            }
            let until = frame.map_or(end_s, |one| one.at_s);
            let dt = until - reached;
            self.hold(dt, a);
            carried.advance(dt);
            let g = carried.covariance(p, q);
            reached = until;
            let Some(frame) = frame else {
                self.p = g;
                return j;
            };
            if let Some(out) = noises.get_mut(j) {
                *out = Some(self.take(frame, g, &mut carried, learning));
            }
            j += 1;
        }
    }

    /// Takes a frame; g: the covariance before it. Returns R.
    fn take(&mut self, frame: &Frame, g: Covariance, carried: &mut Carried, learning: Learning) -> f64 {
        let eta = frame.value_m - self.x;
        self.count += 1.0;
        let mut r = self.noise;
        if self.count > learning.first_frames {
            r = learning.beta * r + (1.0 - learning.beta) * (eta * eta - g.x);
        }
        self.noise = r;
        let k = [g.x / (g.x + r), g.xv / (g.x + r)];
        self.x += k[0] * eta;
        self.v += k[1] * eta;
        carried.update(k, r);
        r
    }

    /// Displacement and variance at a time after the last sample, before a frame there: equations 7 and 8. Infinite
    /// variance before the first frame, which the zero belongs to.
    pub fn predict(&self, time_s: f64) -> (f64, f64) {
        let dt = time_s - self.time_s;
        let variance = if self.count > 0.0 { self.p.moved(dt, self.input_noise).x } else { f64::INFINITY };
        (self.x + dt * self.v + 0.5 * dt * dt * self.input, variance.max(0.0))
    }
}

impl Carried {
    fn advance(&mut self, dt: f64) {
        let [w00, w01, w10, w11] = self.w;
        self.w = [w00 + dt * w10, w01 + dt * w11, w10, w11];
        self.b = [self.b[0] + dt * self.b[1] + 0.5 * dt * dt, self.b[1] + dt];
        self.n = self.n.moved(dt, 0.0);
    }

    fn covariance(&self, p: Covariance, q: f64) -> Covariance {
        let ([w00, w01, w10, w11], [b0, b1], n) = (self.w, self.b, self.n);
        Covariance {
            x: w00 * w00 * p.x + 2.0 * w00 * w01 * p.xv + w01 * w01 * p.v + q * b0 * b0 + n.x,
            xv: w00 * w10 * p.x + (w00 * w11 + w01 * w10) * p.xv + w01 * w11 * p.v + q * b0 * b1 + n.xv,
            v: w10 * w10 * p.x + 2.0 * w10 * w11 * p.xv + w11 * w11 * p.v + q * b1 * b1 + n.v,
        }
    }

    fn update(&mut self, [k0, k1]: [f64; 2], r: f64) {
        let ([w00, w01, w10, w11], [b0, b1], n, rest) = (self.w, self.b, self.n, 1.0 - k0);
        self.w = [rest * w00, rest * w01, w10 - k1 * w00, w11 - k1 * w01];
        self.b = [rest * b0, b1 - k1 * b0];
        self.n = Covariance {
            x: rest * rest * n.x + r * k0 * k0,
            xv: rest * (n.xv - k1 * n.x) + r * k0 * k1,
            v: n.v - 2.0 * k1 * n.xv + k1 * k1 * n.x + r * k1 * k1,
        };
    }
}
