//! When a clock is suspected to have stepped: a sensor is back or stamps went back, or its innovations are so large
//! that another instant may explain them.

use super::innovation::{Innovation, Scene};
use super::situation::GATE;
use super::update::moved_m2;
use serde::{Deserialize, Serialize};

/// What innovations tell is summed over this time, s: within it a step of the clock shows where the structure moves.
const MEMORY_S: f64 = 2.0;
/// A clock is suspected where the innovations' squares are this many standard deviations more than is expected, which
/// chance makes once in many days; it only begins the search ([`super::clock_bank`]), which decides.
const SUSPICIOUS: f64 = 5.0;
/// Fewer measurements than this count as this many, the others as expected: one that is wrong is not suspicious.
const MIN_COUNT: f64 = 8.0;
/// Or where an offset of the clock explains them by this much of a logarithm of the likelihood, at 3.5 standard
/// deviations: by chance twice an hour.
const EXPLAINED: f64 = 6.0;

/// A first gap between samples is a step of their clock as soon as not; the more gaps there were, the likelier are
/// samples lost.
const FEW: f64 = 1.0;

/// What is suspected.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Suspicion {
    /// The channel whose clock may have stepped.
    pub channel: usize,
    /// Whether its sensor is just back, or stamps went back.
    pub back: bool,
}

/// Sums over the last measurements of a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Sums {
    /// Of the innovations' squares over their variance, half of what they are more than expected.
    surplus: f64,
    /// How many there are.
    count: f64,
    /// Of the sensitivity to the clock times innovation over its variance, and of its square.
    matched: f64,
    known: f64,
    /// When the last one was, s.
    last_s: f64,
}

/// How well each channel's measurements agree with its clock.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Watch {
    sums: Vec<Sums>,
    /// Whether stamps went back since.
    doubted: Vec<bool>,
    /// What is suspected, until it is looked into.
    pub suspect: Option<Suspicion>,
    /// By how much (s) the accelerometer's clock may have stepped since the last measurement; 0: it has not.
    lapsed_s: f64,
    /// How often it may have.
    lapses: f64,
}

impl Watch {
    /// Of this many channels, none is suspected.
    pub fn new(channels: usize) -> Self {
        Self { sums: vec![Sums::default(); channels], doubted: vec![false; channels], ..Self::default() }
    }

    /// Whether it is of this many channels.
    pub fn fits(&self, channels: usize) -> bool {
        self.sums.len() == channels && self.doubted.len() == channels
    }

    /// Lets all clocks be in doubt at the next measurement: samples were lost, or the accelerometer's stepped by so much.
    pub fn doubt_all(&mut self, lapsed_s: f64) {
        self.doubted.fill(true);
        self.lapsed_s += lapsed_s;
        self.lapses += 1.0;
    }

    /// Variance (m²) of where the structure is, as the accelerometer's clock may have stepped; usual: standard deviation
    /// of the displacement (m) and its middle angular frequency (1/s).
    #[inline]
    pub fn variance_m2(&self, usual: &(f64, f64)) -> f64 {
        if self.lapsed_s == 0.0 { 0.0 } else { moved_m2(usual, self.lapsed_s) / (FEW + self.lapses) }
    }

    /// Nothing is suspected any more.
    pub fn calm(&mut self) {
        self.sums.fill(Sums::default());
        self.suspect = None;
    }

    /// A measurement tells where the structure is: until then its samples' clock may have stepped.
    #[inline]
    pub fn end_lapse(&mut self) {
        self.lapsed_s = 0.0;
    }

    /// Takes note of an innovation of the best hypothesis and its sensitivities `e` (1 + k); back: its sensor was away.
    #[inline]
    pub fn note(&mut self, scene: &Scene, innovation: &Innovation, e: &[f64], back: bool) {
        let (c, Some(q)) = (scene.row.channel, scene.channel.clock) else { return };
        let (sums, total, sensitivity) = (&mut self.sums[c], innovation.total(), e[1 + q]);
        let kept = (-(scene.at_s - sums.last_s) / MEMORY_S).exp();
        // One alone is an outlier, however far off it lies.
        let error = innovation.error.abs().min(GATE * total.sqrt()).copysign(innovation.error);
        *sums = Sums {
            surplus: (sums.surplus * kept + 0.5 * (error * error / total - 1.0)).max(0.0),
            count: sums.count * kept + 1.0,
            matched: sums.matched * kept + sensitivity * error / total,
            known: sums.known * kept + sensitivity * sensitivity / total,
            last_s: scene.at_s,
        };
        let many = sums.surplus > SUSPICIOUS * (0.5 * sums.count.max(MIN_COUNT)).sqrt();
        let fewer = (MIN_COUNT / sums.count).max(1.0);
        let explained = sums.matched * sums.matched > 2.0 * EXPLAINED * fewer * sums.known;
        let back = std::mem::take(&mut self.doubted[c]) || back;
        if back || many || explained {
            self.suspect = Some(Suspicion { channel: c, back });
        }
    }
}
