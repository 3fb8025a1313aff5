//! One hypothesis: a filter of its own, and what it remembers of each channel and of what happened.

use super::cause::Decision;
use super::matrix::Matrix;
use super::model::Model;
use super::settings::Settings;
use super::start::{Beginning, START_S};
use super::steps::StepTest;
use serde::{Deserialize, Serialize};

/// What a hypothesis remembers of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// Factor on the variance of its measurements.
    pub factor: f64,
    /// How many measurements that rests on.
    pub rests_on: f64,
    /// How many outliers in a row the last measurements were.
    pub outliers: f64,
    /// The value of the first of these.
    pub kept: f64,
    /// Whether its zero has shifted.
    pub shifted: bool,
    /// Variance of a shift that reverts, m²; 0: the zero stays as it has shifted.
    pub reverting_m2: f64,
    /// How many times as fast as the channel's it reverts.
    pub reverting_pace: f64,
    /// Up to when that shift is carried, s.
    pub reverting_s: f64,
    /// Whether its zero has begun with its first measurement.
    pub begun: bool,
    /// Variance of its reference, m².
    pub reference: f64,
    /// When it last measured, s.
    pub met_s: f64,
    /// Up to when its sensor's slow error is carried, s; of the first channel that has it.
    pub slow_s: f64,
    /// When a measurement was last accepted, s.
    pub accepted_s: f64,
    /// Variance of that, its reference's included, m².
    pub accepted_variance: f64,
    /// Share of its last measurements that were outliers.
    pub share: f64,
    /// Mean square of its last innovations over their variance.
    pub recent: f64,
}

/// An error of the acceleration that goes on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Burst {
    /// Its density, (m/s²)²/Hz.
    pub density: f64,
    /// Its axis.
    pub axis: usize,
}

/// The last shift of a zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LastShift {
    /// When, s.
    pub at_s: f64,
    /// Of which sensor.
    pub sensor: usize,
    /// By how much, m.
    pub size_m: f64,
}

/// The evidence of a measurement for its cause: an innovation and its variance in the channel's unit, or of a step that
/// began earlier its size (m), variance (m²) and how long ago it was.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Contradiction {
    /// Innovation, or size of the step.
    pub size: f64,
    /// Its variance.
    pub variance: f64,
    /// How long before the measurement the step was, s.
    pub ago_s: f64,
}

/// What a hypothesis remembers besides its filter and its channels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Memory {
    /// Logarithm of its weight.
    pub weight: f64,
    /// An error of the acceleration that goes on.
    pub burst: Option<Burst>,
    /// The number of the hypothesis before the last measurement that it came from.
    pub parent: usize,
    /// What the last measurement was taken for.
    pub decision: Decision,
    /// The evidence for it: the innovation with the parameters as estimated.
    pub met: Contradiction,
    /// The last shift of a zero.
    pub shift: Option<LastShift>,
    /// Time (s) and sensor of the last outlier.
    pub outlier: Option<(f64, usize)>,
    /// How many measurements were good since anything else was.
    pub age: f64,
    /// When the parameters were met last, s.
    pub last_s: f64,
    /// When the record began, s.
    pub began_s: f64,
    /// The step that the last measurement showed.
    pub step: Contradiction,
}

/// A filter with what it remembers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hypothesis {
    /// States (n, 1 + k): the estimate, and the sensitivities to the parameters.
    pub x: Matrix,
    /// Their covariance (n, n).
    pub p: Matrix,
    /// What is remembered of each channel.
    pub marks: Vec<Mark>,
    /// What is remembered besides.
    pub memory: Memory,
    /// The parameters (k,).
    pub parameters: Vec<f64>,
    /// Their covariance (k, k).
    pub spread: Matrix,
    /// Steps of zeros that may have been, of each group of channels.
    pub tests: Vec<StepTest>,
}

impl Hypothesis {
    /// The only hypothesis at the beginning.
    pub fn begun(begin: &Beginning, settings: &Settings, model: &Model) -> Self {
        let (n, columns) = (model.size(), model.columns());
        let (mut x, mut p) = (Matrix::zeros(n, columns), Matrix::zeros(n, n));
        for a in 0..model.axes() {
            let i = super::layout::motion_of(a);
            x[(i, 0)] = begin.displacement_m[a];
            x[(i + 2, 0)] = settings.bias_m_s2[a];
            let stds = [begin.displacement_std_m[a], begin.velocity_std_m_s[a], settings.bias_std_m_s2[a]];
            for (j, std) in stds.into_iter().enumerate() {
                p[(i + j, i + j)] = std * std;
            }
            for (q, &of) in model.gain_of.iter().enumerate() {
                if of == Some(a) {
                    // The accelerometer measures too much of what its bias is known by, too.
                    x[(i + 2, 1 + q)] = -settings.bias_m_s2[a];
                }
            }
        }
        for channel in &model.channels {
            if let Some(slow) = channel.slow {
                for place in [Some(slow.place), slow.velocity].into_iter().flatten() {
                    p[(place, place)] = slow.variance_m2;
                }
            }
        }
        let variances: Vec<f64> = settings.parameters.iter().map(|one| one.std * one.std).collect();
        Self {
            x,
            p,
            marks: settings.channels.iter().map(|one| Mark::begun(one.variance_factor, settings, begin)).collect(),
            memory: Memory::begun(begin),
            parameters: vec![0.0; variances.len()],
            spread: Matrix::diagonal(&variances),
            tests: (0..model.groups).map(|_| StepTest::new(n, columns)).collect(),
        }
    }

    /// Becomes a copy of another one of the same model, in the memory that it has.
    pub fn copy_from(&mut self, other: &Self) {
        self.x.copy_from(&other.x);
        self.p.copy_from(&other.p);
        self.marks.clone_from(&other.marks);
        self.memory = other.memory;
        self.parameters.clone_from(&other.parameters);
        self.spread.copy_from(&other.spread);
        for (own, test) in self.tests.iter_mut().zip(&other.tests) {
            own.copy_from(test);
        }
    }

    /// Whether it is where another one is, and goes on alike.
    pub fn is_at(&self, other: &Self) -> bool {
        let going_on = |one: &Self| (one.memory.burst, one.memory.shift, one.memory.last_s, one.memory.began_s);
        self.x == other.x
            && self.p == other.p
            && self.marks == other.marks
            && self.parameters == other.parameters
            && self.spread == other.spread
            && self.tests == other.tests
            && going_on(self) == going_on(other)
    }

    /// Forgets all steps that may have been.
    pub fn clear_tests(&mut self) {
        for test in &mut self.tests {
            test.clear();
        }
    }

    /// Whether it is of the model's shape.
    pub fn fits(&self, model: &Model) -> bool {
        let (n, columns) = (model.size(), model.columns());
        let shape =
            |one: &Matrix, rows: usize, width: usize| one.width() == width && one.elements().len() == rows * width;
        shape(&self.x, n, columns)
            && shape(&self.p, n, n)
            && shape(&self.spread, columns - 1, columns - 1)
            && self.parameters.len() == columns - 1
            && self.marks.len() == model.channels.len()
            && self.tests.len() == model.groups
            && self.tests.iter().all(|one| one.fits(n, columns))
            && self.memory.burst.is_none_or(|one| one.axis < model.axes())
    }
}

impl Mark {
    fn begun(factor: f64, settings: &Settings, begin: &Beginning) -> Self {
        Self {
            factor,
            rests_on: settings.noise_weight,
            outliers: 0.0,
            kept: 0.0,
            shifted: false,
            reverting_m2: 0.0,
            reverting_pace: 1.0,
            reverting_s: begin.time_s - START_S,
            begun: false,
            reference: 0.0,
            met_s: begin.time_s - START_S,
            slow_s: begin.time_s - START_S,
            accepted_s: f64::NEG_INFINITY,
            accepted_variance: 0.0,
            share: 0.0,
            recent: 1.0,
        }
    }
}

impl Memory {
    fn begun(begin: &Beginning) -> Self {
        Self {
            weight: 0.0,
            burst: None,
            parent: 0,
            decision: Decision::GOOD,
            met: Contradiction::default(),
            shift: None,
            outlier: None,
            age: 0.0,
            last_s: begin.time_s,
            began_s: begin.time_s,
            step: Contradiction::default(),
        }
    }
}
