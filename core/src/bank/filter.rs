//! The filter of one point: six states, moved by the acceleration and corrected by the displacement sensor.
//!
//! x'' = (1 + g) (a − b) with the measured acceleration a, and y(t) = x(t − τ) + s(t) + noise. Mean and covariance
//! stand at the instant of the last measurement; what the acceleration adds since is integrated sample by sample, as
//! in `estimator::motion`, so that a row is a polynomial in the time since (see `covariance`).

use super::covariance::{B, Covariance, G, Kept, S, STATES, Span, T, V, Vector, X, dot};
use super::events::{Code, Event};
use super::improbable::Improbable;
use super::noise::{self, Noise, Shown};
use super::queue::{Queue, Reading};
use super::repeats::Repeats;
use super::rows::Row;
use super::settings::Settings;
use crate::Status;
use crate::estimator::motion::{AxisMotion, GAP_STEPS, lead_of};
use serde::{Deserialize, Serialize};

/// No instant.
const NEVER: i64 = i64::MIN;
const SECOND: f64 = 1e9;
const NANOSECOND: f64 = 1e-9;
/// Intervals of the displacement sensor are kept in steps of 10 ms, up to eleven minutes.
const INTERVAL_STEP: i64 = 10_000_000;
/// Standard deviations of velocity (m/s) and bias (m/s²) before any measurement.
const VELOCITY_STD: f64 = 0.3;
const BIAS_STD: f64 = 0.3;
/// Rows begin with this many accepted measurements.
const FIRST_MEASUREMENTS: u8 = 8;
/// Rows end this long after a point was lost, s; what is begun anew after that long.
pub const ROWS_LOST_S: f64 = 30.0;
/// Where nothing was measured for longer, what the acceleration's gap hid can be anything: the filter begins anew, s.
const BRIDGED_S: f64 = 3.0;
/// Ages in intervals of the displacement sensor from which on rows are coasting and lost.
const COASTING_INTERVALS: f64 = 5.0;
const LOST_INTERVALS: f64 = 10.0;
/// The mean square of the acceleration is followed over this time, s.
const ENERGY_S: f64 = 10.0;
/// A sample this many standard deviations of the acceleration off waits for the next one to confirm it.
const SPIKE: f64 = 6.0;
/// Unknown acceleration is taken to be no slower than this, Hz.
const SLOWEST_HZ: f64 = 1.0;
/// Share of single samples far off that are true.
const TRUE_SPIKES: f64 = 0.01;
/// A measurement of an instant this many samples before the last one is late.
const LATE_STEPS: i64 = 2;

/// What a point remembers besides what waits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Filter {
    /// x, v, b and s at the anchor.
    mean: [f64; 4],
    covariance: Kept,
    /// Displacement and velocity that the acceleration has added since the anchor, up to the last sample.
    added: [f64; 2],
    /// The last sample, m/s².
    input: f64,
    #[serde(with = "postcard::fixint::le")]
    at_ns: i64,
    #[serde(with = "postcard::fixint::le")]
    anchor_ns: i64,
    #[serde(with = "postcard::fixint::le")]
    stamped_ns: i64,
    #[serde(with = "postcard::fixint::le")]
    step_ns: u32,
    #[serde(with = "postcard::fixint::le")]
    interval_steps: u16,
    /// τ and g.
    aside: [f32; 2],
    /// From the last accepted measurement to the anchor, s.
    age_s: f32,
    noise: Noise,
    /// Slope of the acceleration before the last sample, m/s³.
    slope: f32,
    improbable: Improbable,
    /// Mean square of the acceleration without its bias, (m/s²)².
    energy: f32,
    /// What a sample that waits to be confirmed was off by, m/s².
    unconfirmed: f32,
    repeats: Repeats,
    accepted: u8,
    lost: bool,
}

/// From one sample to the next.
struct Interval {
    motion: AxisMotion,
    end_ns: i64,
    /// Of the acceleration's noise, (m/s²)²/Hz.
    density: f64,
    is_gap: bool,
}

impl Filter {
    /// Before the first sample.
    pub fn new(settings: &Settings) -> Self {
        Self {
            mean: [0.0; 4],
            covariance: Kept::default(),
            added: [0.0; 2],
            input: 0.0,
            slope: 0.0,
            improbable: Improbable::default(),
            at_ns: NEVER,
            anchor_ns: NEVER,
            stamped_ns: NEVER,
            step_ns: 0,
            interval_steps: 0,
            aside: [0.0; 2],
            age_s: 0.0,
            noise: Noise::new(settings),
            energy: (settings.acceleration_std_m_s2 * settings.acceleration_std_m_s2) as f32,
            unconfirmed: 0.0,
            repeats: Repeats::default(),
            accepted: 0,
            lost: false,
        }
    }

    /// The last sample's stamp.
    pub fn sampled_ns(&self) -> Option<i64> {
        Some(self.at_ns).filter(|&at| at != NEVER)
    }

    /// The last measurement's stamp.
    pub fn stamped_ns(&self) -> Option<i64> {
        Some(self.stamped_ns).filter(|&at| at != NEVER)
    }

    /// The stamp that the displacement sensor gives to an instant.
    #[inline]
    pub fn stamp_of(&self, time_ns: i64) -> i64 {
        time_ns.saturating_add((f64::from(self.aside[0]) * SECOND) as i64)
    }

    /// Goes on to a sample with the measurements up to it; its row, where there is one.
    #[inline]
    pub fn run(
        &mut self,
        sample: &Reading,
        waiting: &mut Queue,
        settings: &Settings,
        out: &mut Vec<Event>,
    ) -> Option<Row> {
        if self.at_ns == NEVER || self.is_apart(sample, waiting) {
            self.begin(sample);
            return None;
        }
        if 2 * (sample.time_ns - self.at_ns) < sample.step_ns {
            return None;
        }
        let until_ns = self.stamp_of(sample.time_ns);
        let interval = self.interval(sample, settings);
        while let Some(one) = waiting.take(until_ns) {
            self.measure(&one, &interval, settings, out);
        }
        self.end(&interval, settings);
        self.row(settings, out)
    }

    /// Whether a sample comes after a gap that nothing bridges.
    #[inline]
    fn is_apart(&self, sample: &Reading, waiting: &Queue) -> bool {
        let gap_ns = sample.time_ns - self.at_ns;
        if gap_ns <= (BRIDGED_S * SECOND) as i64 {
            return false;
        }
        let next_ns = waiting.first().map_or(i64::MAX, |one| one.time_ns);
        let unseen_ns = next_ns.saturating_sub(self.stamped_ns.max(self.stamp_of(self.at_ns)));
        gap_ns > (ROWS_LOST_S * SECOND) as i64 || unseen_ns > (BRIDGED_S * SECOND) as i64
    }

    /// Density of the acceleration's noise, (m/s²)²/Hz; step_s: from one sample to the next.
    #[inline]
    fn density(&self, step_s: f64, settings: &Settings) -> f64 {
        settings.acceleration_std_m_s2 * settings.acceleration_std_m_s2 * step_s * self.noise.colour()
    }

    /// Begins with a sample: where the structure is, the next measurement tells.
    fn begin(&mut self, sample: &Reading) {
        (self.at_ns, self.input, self.slope) = (sample.time_ns, sample.value, 0.0);
        self.step_ns = u32::try_from(sample.step_ns).unwrap_or(u32::MAX);
        (self.accepted, self.unconfirmed) = (0, 0.0);
        self.improbable.end();
        self.mean[B] = sample.value;
    }

    /// The interval up to a sample; what is unknown of the acceleration in it is noise.
    #[inline]
    fn interval(&mut self, sample: &Reading, settings: &Settings) -> Interval {
        let dt_ns = sample.time_ns - self.at_ns;
        let (dt, step) = (dt_ns as f64 * NANOSECOND, sample.step_ns as f64 * NANOSECOND);
        let white = self.density(step, settings);
        let is_gap = dt > GAP_STEPS * step;
        let density = if is_gap { white + f64::from(self.energy) / SLOWEST_HZ } else { white };
        if self.accepted > 0 && (is_gap || i64::from(self.step_ns) != sample.step_ns) {
            self.anchor(self.density(f64::from(self.step_ns) * NANOSECOND, settings), settings);
        }
        self.step_ns = u32::try_from(sample.step_ns).unwrap_or(u32::MAX);
        let value = self.confirmed(sample.value, dt, density, settings);
        let lead = |dt: f64| if is_gap { 0.0 } else { lead_of(dt) };
        let mut motion = AxisMotion { input: self.input, slope: f64::from(self.slope), lead: lead(step) };
        self.added[1] += motion.begin(value, dt, lead(dt));
        Interval { motion, end_ns: sample.time_ns, density, is_gap }
    }

    /// The sample, or the one before it where it is far off and the next one has still to confirm it.
    #[inline]
    fn confirmed(&mut self, value: f64, dt: f64, density: f64, settings: &Settings) -> f64 {
        let (off, energy) = (value - self.mean[B], f64::from(self.energy));
        let square = off * off;
        let before = f64::from(self.unconfirmed);
        let step = value - self.input;
        self.unconfirmed = 0.0;
        if before != 0.0 {
            if step * before > 0.5 * before * before {
                // Confirmed: what it was taken for too little is made up for.
                self.added[0] += before * dt * dt;
                self.added[1] += before * dt;
                self.follow_energy(square, dt);
                return value;
            }
            if self.accepted > 0 {
                let mut p = self.moved(self.at_ns, self.added, density, settings);
                p.0[V][V] += TRUE_SPIKES * before * before * dt * dt;
                self.covariance = p.kept();
            }
        }
        if square > SPIKE * SPIKE * energy && step * step > 0.25 * square {
            self.unconfirmed = step as f32;
            return self.input;
        }
        self.follow_energy(square, dt);
        value
    }

    /// Follows the mean square of the acceleration.
    #[inline]
    fn follow_energy(&mut self, square: f64, dt: f64) {
        let energy = f64::from(self.energy);
        self.energy += ((dt / ENERGY_S).min(1.0) * (square.min(1000.0 * energy) - energy)) as f32;
    }

    /// Displacement and velocity that the acceleration has added since the anchor up to an instant of an interval.
    #[inline]
    fn added_to(&self, to_ns: i64, interval: &Interval) -> [f64; 2] {
        let to_s = (to_ns - self.at_ns) as f64 * NANOSECOND;
        let after = interval.motion.response(to_s);
        let [place, speed] = self.added;
        if self.anchor_ns <= self.at_ns {
            return [place + to_s * speed + after.x, speed + after.v];
        }
        let from_s = (self.anchor_ns - self.at_ns) as f64 * NANOSECOND;
        let before = interval.motion.response(from_s);
        let dt = to_s - from_s;
        [place + dt * speed + (after.x - before.x - dt * before.v), speed + (after.v - before.v)]
    }

    /// Moves the mean to an instant, given what the acceleration has added up to it; the covariance there.
    #[inline]
    fn moved(&mut self, to_ns: i64, added: [f64; 2], density: f64, settings: &Settings) -> Covariance {
        let walks = settings.walks(density, self.noise.slow_m2(settings));
        let span = self.span(to_ns, added);
        let decay = (-span.t / walks.slow_time_s).exp();
        let gained = 1.0 + f64::from(self.aside[1]);
        self.mean[X] += span.t * self.mean[V] + gained * span.displacement;
        self.mean[V] += gained * span.velocity;
        self.mean[S] *= decay;
        self.age_s += span.t as f32;
        (self.anchor_ns, self.added) = (to_ns, [0.0; 2]);
        self.covariance.whole().moved(&span, decay, &walks)
    }

    /// Moves the anchor to the last sample.
    fn anchor(&mut self, density: f64, settings: &Settings) {
        self.covariance = self.moved(self.at_ns, self.added, density, settings).kept();
    }

    /// The time from the anchor to an instant, given what the acceleration has added in it.
    #[inline]
    fn span(&self, to_ns: i64, added: [f64; 2]) -> Span {
        let t = (to_ns - self.anchor_ns) as f64 * NANOSECOND;
        let b = self.mean[B];
        Span { t, displacement: added[0] - 0.5 * t * t * b, velocity: added[1] - t * b }
    }

    /// Takes a measurement whose instant lies in an interval.
    fn measure(&mut self, one: &Reading, interval: &Interval, settings: &Settings, out: &mut Vec<Event>) {
        let is_frozen = self.repeats.is_frozen(one.value, self.stamped_ns == NEVER, settings.displacement_std_m);
        self.stamped_ns = one.time_ns;
        self.interval_steps = u16::try_from(one.step_ns / INTERVAL_STEP).unwrap_or(u16::MAX);
        if is_frozen {
            if self.repeats.has_begun() {
                out.push(Event { time_ns: one.time_ns, code: Code::Frozen });
            }
            return;
        }
        let instant_ns = one.time_ns.saturating_sub(self.stamp_of(0));
        let from_ns = if self.accepted > 0 { self.at_ns.max(self.anchor_ns) } else { self.at_ns };
        if instant_ns < self.at_ns.saturating_sub(LATE_STEPS * i64::from(self.step_ns)) {
            if self.accepted > 0 {
                out.push(Event { time_ns: one.time_ns, code: Code::Late });
            }
            return;
        }
        let at_ns = instant_ns.clamp(from_ns, interval.end_ns);
        if self.accepted == 0 {
            self.start(at_ns, one.value, settings);
        } else {
            self.correct(one, at_ns, interval, settings, out);
        }
    }

    /// The state at the first measurement.
    fn start(&mut self, at_ns: i64, value: f64, settings: &Settings) {
        let mut p = Covariance([[0.0; STATES]; STATES]);
        let slow = self.noise.slow_m2(settings);
        p.0[X][X] = self.noise.white_m2(settings) + slow;
        (p.0[X][S], p.0[S][X], p.0[S][S]) = (-slow, -slow, slow);
        p.0[V][V] = VELOCITY_STD * VELOCITY_STD;
        p.0[B][B] = BIAS_STD * BIAS_STD;
        p.0[T][T] = settings.delay_std_s * settings.delay_std_s;
        p.0[G][G] = settings.gain_std * settings.gain_std;
        self.mean = [value, 0.0, self.input, 0.0];
        (self.covariance, self.added) = (p.kept(), [0.0; 2]);
        (self.anchor_ns, self.accepted, self.age_s) = (at_ns, 1, 0.0);
    }

    /// Corrects the state by a measurement: a mixture of one of the stated noise and an outlier, matched in mean and
    /// covariance.
    fn correct(&mut self, one: &Reading, at_ns: i64, interval: &Interval, settings: &Settings, out: &mut Vec<Event>) {
        let added = self.added_to(at_ns, interval);
        let mut p = self.moved(at_ns, added, interval.density, settings);
        let since_s = (at_ns - self.at_ns) as f64 * NANOSECOND;
        let ahead_s = (one.time_ns - at_ns) as f64 * NANOSECOND - f64::from(self.aside[0]);
        let speed = self.mean[V] - interval.motion.ahead();
        let h: Vector = [1.0, ahead_s, 0.0, 1.0, -speed, 0.0];
        let pull = interval.motion.input + since_s * interval.motion.slope - self.mean[B];
        let bend = 0.5 * pull * p.0[T][T];
        let white = self.noise.white_m2(settings) + bend * bend;
        let innovation = one.value - self.mean[X] - self.mean[S] - ahead_s * speed;
        let mut ph = p.times(&h);
        let mut predicted = dot(&h, &ph);
        let mut variance = predicted + white;
        let mut share =
            if settings.as_stated { 1.0 } else { noise::sound_share(innovation, variance, self.improbable.is_begun()) };
        let mut shown = Shown {
            innovation,
            variance,
            left: None,
            share,
            interval_s: one.step_ns as f64 * NANOSECOND,
            count: self.accepted,
        };
        if share < 0.5 {
            // A value that comes again is no second measurement of a shifted zero.
            if self.repeats.is_repeated() || !self.improbable.is_shift(innovation, white) {
                self.covariance = p.kept();
                self.noise.follow(&shown, settings);
                return;
            }
            self.improbable.end();
            if self.accepted < FIRST_MEASUREMENTS {
                self.accepted = 0;
                return;
            }
            p = self.shifted(p, innovation, settings);
            ph = p.times(&h);
            predicted = dot(&h, &ph);
            variance = predicted + white;
            share = noise::sound_share(innovation, variance, false);
            out.push(Event { time_ns: one.time_ns, code: Code::Shifted });
        }
        let by = share * innovation / variance;
        for (state, change) in self.mean.iter_mut().zip(&ph) {
            *state += by * change;
        }
        self.aside[0] = (f64::from(self.aside[0]) + by * ph[T]).clamp(-1.0, 1.0) as f32;
        self.aside[1] = (f64::from(self.aside[1]) + by * ph[G]).clamp(-0.5, 0.5) as f32;
        let spread = (share * (1.0 - share) * innovation * innovation - share * variance) / (variance * variance);
        self.covariance = p.with(spread, &ph).kept();
        self.age_s = 0.0;
        self.improbable.end();
        self.accepted = self.accepted.saturating_add(1);
        if self.accepted >= FIRST_MEASUREMENTS && !settings.as_stated {
            let residual = innovation - by * predicted;
            shown.left = Some(residual * residual + predicted + spread * predicted * predicted - bend * bend);
            self.noise.follow(&Shown { variance, share, ..shown }, settings);
        }
    }

    /// The covariance where the displacement is not what it was by `off` metres. Where the innovations do not grow, the
    /// sensor's zero has shifted, and may do so again; else the velocity is wrong.
    fn shifted(&mut self, mut p: Covariance, off: f64, settings: &Settings) -> Covariance {
        let square = off * off;
        p.0[X][X] += square;
        if self.improbable.growth_m(off).abs() < 0.5 * off.abs() {
            p.0[S][S] += square;
            self.noise.shifted(square, settings);
        } else {
            let age = f64::from(self.age_s).max(f64::from(self.step_ns) * NANOSECOND);
            p.0[V][V] += square / (age * age);
            self.noise.forget();
        }
        p
    }

    /// Goes on to the end of an interval.
    #[inline]
    fn end(&mut self, interval: &Interval, settings: &Settings) {
        if self.accepted > 0 {
            self.added = self.added_to(interval.end_ns, interval);
        }
        self.slope = interval.motion.slope as f32;
        self.input += interval.motion.slope * ((interval.end_ns - self.at_ns) as f64 * NANOSECOND);
        self.at_ns = interval.end_ns;
        if self.accepted > 0 && interval.is_gap {
            self.anchor(interval.density, settings);
        }
    }

    /// The row at the last sample.
    #[inline]
    fn row(&mut self, settings: &Settings, out: &mut Vec<Event>) -> Option<Row> {
        if self.accepted == 0 {
            return None;
        }
        let span = self.span(self.at_ns, self.added);
        let age = f64::from(self.age_s) + span.t;
        let interval = f64::from(self.interval_steps) * (INTERVAL_STEP as f64 * NANOSECOND);
        let lost_s = settings.lost_s.max(LOST_INTERVALS * interval);
        let status = if age <= settings.coasting_s.max(COASTING_INTERVALS * interval) {
            Status::Tracking
        } else if age <= lost_s {
            Status::Coasting
        } else {
            Status::Lost
        };
        let is_lost = status == Status::Lost;
        if is_lost != self.lost {
            out.push(Event { time_ns: self.at_ns, code: if is_lost { Code::Lost } else { Code::Tracking } });
            self.lost = is_lost;
        }
        if age > lost_s + ROWS_LOST_S {
            self.accepted = 0;
            return None;
        }
        if self.accepted < FIRST_MEASUREMENTS {
            return None;
        }
        let density = self.density(f64::from(self.step_ns) * NANOSECOND, settings);
        let gained = 1.0 + f64::from(self.aside[1]);
        let ahead = lead_of(f64::from(self.step_ns) * NANOSECOND) * f64::from(self.slope);
        let (variance, velocity_variance) = self.covariance.row(&span, density, settings.bias_walk);
        Some(Row {
            time_ns: self.at_ns,
            displacement: self.mean[X] + span.t * self.mean[V] + gained * span.displacement,
            variance,
            velocity: self.mean[V] + gained * span.velocity - ahead,
            velocity_variance,
            status,
        })
    }
}
