//! A measurement as a hypothesis expects it: zero and clock at that instant, the innovation and its variance.

use super::acceptance::linearise;
use super::coast::Course;
use super::hypotheses::Hypotheses;
use super::hypothesis::Hypothesis;
use super::layout::motion_of;
use super::matrix::{Matrix, quadratic};
use super::model::{ChannelModel, Model};
use super::motion::{AxisMotion, Clock};
use super::predict::predict_covariance;
use super::row::Effect;
use super::steps::{scale_changed, turn_changed};
use super::update::{carry_slow, move_reference, project};
use super::waiting::Measurement;
use super::way_back::Scaled;

/// A zero of which nothing is known is taken to lie within this many times (in variance) what the first measurement is
/// off, where it is asked whether that is an outlier.
const UNKNOWN_ZERO: f64 = 1e6;
/// No device starts, and no clock that is set leaves out, less than this, s: what is shorter, lost frames, the
/// innovations show. A guess: six frames at 25 Hz.
const STARTS_S: f64 = 0.25;

/// A measurement at its instant.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    /// The model.
    pub model: &'a Model,
    /// The measurement.
    pub row: &'a Measurement,
    /// Its channel.
    pub channel: &'a ChannelModel,
    /// When, s.
    pub at_s: f64,
    /// The input along all axes.
    pub motion: &'a [AxisMotion],
    /// The acceleration along the channel's axis at the instant, m/s².
    pub acceleration: f64,
    /// Density of its noise, (m/s²)²/Hz.
    pub density: f64,
}

/// To work with, so that nothing is allocated in the loop.
#[derive(Clone, Debug)]
pub struct Work {
    /// P h of the last look, and K after the update (n,).
    pub gain: Vec<f64>,
    /// The innovation and its sensitivities (1 + k).
    pub e: Vec<f64>,
    /// For the parameters.
    pub parameters: Vec<f64>,
    /// Uncertain states of the best hypothesis, see `Layout::find_uncertain`.
    pub uncertain: Vec<usize>,
    /// Those of another.
    pub others: Vec<usize>,
    /// What the samples between two measurements leave.
    pub course: Course,
}

impl Work {
    /// For a model.
    pub fn new(model: &Model) -> Self {
        Self {
            gain: vec![0.0; model.size()],
            e: vec![0.0; model.columns()],
            parameters: Vec::new(),
            uncertain: Vec::new(),
            others: Vec::new(),
            course: Course::new(model),
        }
    }
}

/// An innovation with the parts of its variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation {
    /// Measured minus expected, with the parameters as estimated.
    pub error: f64,
    /// Variance of the prediction without the parameters' part.
    pub predicted: f64,
    /// Variance of the prediction with it.
    pub with_parameters: f64,
    /// Variance of the measurement's own noise.
    pub noise: f64,
}

impl Innovation {
    /// Its variance.
    #[inline]
    pub fn total(&self) -> f64 {
        self.with_parameters + self.noise
    }

    /// Whether it lies within this many standard deviations.
    #[inline]
    pub fn within(&self, deviations: f64) -> bool {
        self.error * self.error <= deviations * deviations * self.total()
    }
}

/// Before a channel's measurement: its zero begins with the first and follows the reference, its sensor's slow error
/// goes on. Returns what was made of these states.
///
/// An unknown zero is wide for the hypotheses' weights alone: the first measurement that is accepted begins it, see
/// `update::begin_zero`.
pub fn meet_zero(hyp: &mut Hypothesis, scene: &Scene) -> Scaled {
    let (row, channel) = (scene.row, scene.channel);
    let (z, r) = (channel.zero, channel.reference);
    let mut made = Scaled::NONE;
    if let Some(slow) = &channel.slow {
        let lapse_s = scene.at_s - std::mem::replace(&mut hyp.marks[slow.lead].slow_s, scene.at_s);
        made.slow = carry_slow(&mut hyp.x, &mut hyp.p, slow, lapse_s);
        turn_changed(&mut hyp.tests, slow, made.slow);
    }
    if let Some(reverting) = channel.reverting.filter(|_| hyp.marks[row.channel].reverting_m2 > 0.0) {
        let mark = &mut hyp.marks[row.channel];
        let lapse_s = scene.at_s - std::mem::replace(&mut mark.reverting_s, scene.at_s);
        let reverting = reverting.of_variance(mark.reverting_m2).faster(mark.reverting_pace);
        made.shift = carry_slow(&mut hyp.x, &mut hyp.p, &reverting, lapse_s);
        turn_changed(&mut hyp.tests, &reverting, made.shift);
    }
    let mark = &mut hyp.marks[row.channel];
    if !mark.begun {
        match channel.zero_variance {
            Some(variance) => {
                mark.begun = true;
                hyp.p[(z, z)] = variance;
            }
            None => {
                let (g, i) = (channel.row.units_per_m, channel.row.motion());
                let (off, known) = if channel.places {
                    (row.value / g - hyp.x[(i, 0)], hyp.p[(i, i)])
                } else {
                    let mut ph = vec![0.0; hyp.p.width()];
                    let known = project(&hyp.p, &channel.row, &mut ph) / (g * g);
                    ((row.value - channel.row.of_column(hyp.x.elements(), hyp.x.width(), 0)) / g, known)
                };
                hyp.p[(z, z)] = UNKNOWN_ZERO * (off * off + row.variance / (g * g)) + known;
            }
        }
    }
    let was = std::mem::replace(&mut mark.reference, row.reference);
    if was != row.reference {
        made.reference = move_reference(&mut hyp.x, &mut hyp.p, r, was, row.reference);
        scale_changed(&mut hyp.tests, r, made.reference);
    }
    made
}

/// Whether a sensor is back that may have started anew: none of its channels has measured for longer than its rows
/// count as tracking, and than a device takes to start.
pub fn is_back(hyp: &Hypothesis, scene: &Scene) -> bool {
    let own = scene.channel;
    let sensor = hyp.marks.iter().zip(&scene.model.channels).filter(|(_, one)| one.sensor == own.sensor);
    scene.at_s - sensor.map(|(mark, _)| mark.met_s).fold(f64::NEG_INFINITY, f64::max) > own.coasting_s.max(STARTS_S)
}

/// The innovation of a measurement in one hypothesis; the sensitivities and P h stay in `work`.
#[inline]
pub fn look(hyp: &Hypothesis, scene: &Scene, work: &mut Work) -> Innovation {
    let (row, e) = (&scene.channel.row, &mut work.e);
    let motion = &scene.motion[row.axis];
    innovate(&hyp.x, scene.channel, motion, scene.acceleration, scene.row.value, e);
    let predicted = project(&hyp.p, row, &mut work.gain);
    let (mut error, mut with_parameters) = (e[0], predicted);
    if !hyp.parameters.is_empty() {
        linearise(hyp.x.row(row.motion()), &hyp.parameters, row, e);
        error = e[0] + hyp.parameters.iter().zip(&e[1..]).map(|(value, sensitivity)| value * sensitivity).sum::<f64>();
        with_parameters += quadratic(&e[1..], &hyp.spread);
    }
    Innovation { error, predicted, with_parameters, noise: scene.row.variance * hyp.marks[scene.row.channel].factor }
}

/// Innovation of a `value` and its sensitivities, to `e` (1 + k).
#[inline]
fn innovate(x: &Matrix, channel: &ChannelModel, motion: &AxisMotion, acceleration: f64, value: f64, e: &mut [f64]) {
    let (row, width) = (&channel.row, x.width());
    for (q, out) in e.iter_mut().enumerate() {
        *out = -row.of_column(x.elements(), width, q);
    }
    e[0] += value - row.known(motion, acceleration);
    let (i, g) = (row.motion(), row.units_per_m);
    for (out, effect) in e[1..].iter_mut().zip(&row.effects) {
        match effect {
            Effect::Nothing => {}
            Effect::Scale => *out += g * x[(i, 0)],
            Effect::Gain => *out -= g * x[(i, 0)],
            Effect::Clock => *out -= g * (x[(i + 1, 0)] - motion.ahead()),
        }
    }
}

/// Expected measurement of channel `c` at a time some steps about the last sample and its variance, over all hypotheses.
pub fn predict_value(
    time_s: f64,
    c: usize,
    motion: &[AxisMotion],
    clock: &Clock,
    all: &Hypotheses,
    model: &Model,
) -> (f64, f64) {
    let dt = time_s - clock.time_s;
    let channel = &model.channels[c];
    let (mut gain, mut e, mut uncertain) = (vec![0.0; model.size()], vec![0.0; model.columns()], Vec::new());
    let mut mixture = Mixture::default();
    for hyp in all.all() {
        // A hypothesis in which a zero of which nothing is known has not begun says nothing; in the first it has.
        let zero_variance = if hyp.marks[c].begun { Some(0.0) } else { channel.zero_variance };
        let Some(zero_variance) = zero_variance else { continue };
        let (mut x, mut p) = (hyp.x.clone(), hyp.p.clone());
        hold(&mut x, motion, dt);
        model.layout.find_uncertain(&p, &mut uncertain);
        predict_covariance(&mut p, &model.layout, dt.max(0.0), &uncertain, &[]);
        let input = motion[channel.row.axis].input;
        innovate(&x, channel, &AxisMotion::default(), input, 0.0, &mut e);
        let reported: f64 = hyp.parameters.iter().zip(&e[1..]).map(|(value, sensitivity)| value * sensitivity).sum();
        let variance = project(&p, &channel.row, &mut gain) + quadratic(&e[1..], &hyp.spread);
        let variance = variance + channel.row.units_per_m * channel.row.units_per_m * zero_variance;
        mixture.add(hyp.memory.weight.exp(), Mixed { value: -e[0] - reported, variance, velocity: 0.0 });
    }
    let mixed = mixture.mixed();
    (mixed.value, mixed.variance)
}

/// Moves the motion by `dt` with the last acceleration held.
fn hold(x: &mut Matrix, motion: &[AxisMotion], dt: f64) {
    for (a, axis) in motion.iter().enumerate() {
        let i = motion_of(a);
        x[(i + 1, 0)] -= axis.ahead();
        for q in 0..x.width() {
            let (v, held) = (x[(i + 1, q)], if q == 0 { axis.input } else { 0.0 });
            let driven = held - x[(i + 2, q)];
            x[(i, q)] += dt * v + 0.5 * dt * dt * driven;
            x[(i + 1, q)] += dt * driven;
        }
    }
}

/// Mean and variance over hypotheses, by their weights.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mixture {
    first: Option<f64>,
    whole: f64,
    mean: f64,
    square: f64,
    velocity: f64,
}

/// What a mixture comes to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mixed {
    /// Mean.
    pub value: f64,
    /// Variance.
    pub variance: f64,
    /// Mean velocity.
    pub velocity: f64,
}

impl Mixture {
    /// Adds what one hypothesis says.
    pub fn add(&mut self, weight: f64, Mixed { value, variance, velocity }: Mixed) {
        let off = value - *self.first.get_or_insert(value);
        self.whole += weight;
        self.mean += weight * off;
        self.square += weight * (variance + off * off);
        self.velocity += weight * velocity;
    }

    /// What all of them say.
    pub fn mixed(&self) -> Mixed {
        let mean = self.mean / self.whole;
        Mixed {
            value: self.first.unwrap_or(0.0) + mean,
            variance: self.square / self.whole - mean * mean,
            velocity: self.velocity / self.whole,
        }
    }
}
