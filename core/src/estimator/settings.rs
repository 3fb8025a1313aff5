//! What the estimator is given of its channels, its parameters and its rates.

use pyo3::FromPyObject;
use serde::{Deserialize, Serialize};

/// Nanoseconds in a second.
pub const NANOSECONDS: f64 = 1e9;

/// No more axes than a body has.
pub const MAX_AXES: usize = 3;

/// What a channel measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Quantity {
    /// The displacement along its axis.
    Displacement,
    /// The velocity along its axis.
    Velocity,
    /// The slow error that moves all of an image, as an angle: of an inclinometer.
    Tilt,
    /// The rate of that, which must be an oscillator: of a gyroscope.
    TiltRate,
}

/// One target of one sensor along one axis; its measurements are in the sensor's own unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Channel {
    /// Number of its sensor; all targets of a sensor have the same.
    pub sensor: usize,
    /// What it measures.
    pub measures: Quantity,
    /// Number of the sensor whose slow error a tilt or its rate is, or moves its image too; of others their own.
    pub tilt_of: usize,
    /// Measured units per metre of the slow error, of an image; None: as of the first channel that has it.
    pub slow_units_per_m: Option<f64>,
    /// Code of the kind of sensor that marks its rows.
    pub source: u8,
    /// Measured units per metre of displacement, signed; of a tilt per metre of the slow error.
    pub units_per_m: f64,
    /// Number of the axis that it measures along.
    pub axis: usize,
    /// Estimated variance over the one that comes with each measurement.
    pub variance_factor: f64,
    /// Time over which one measurement averages, s.
    pub exposure_s: f64,
    /// Standard deviation of its zero at its first measurement, m; infinite: unknown.
    pub zero_std_m: f64,
    /// Density of the random walk of its zero, m²/s.
    pub zero_walk_m2_s: f64,
    /// Time in which a shift of its zero may revert, s; 0: a zero that has shifted stays.
    pub reverting_s: f64,
    /// Age of its last accepted measurement from which on rows are coasting, s.
    pub coasting_s: f64,
    /// The same from which on they are lost, s.
    pub lost_s: f64,
    /// Standard deviation of its slow error, m.
    pub slow_std_m: f64,
    /// Correlation time of its slow error, s.
    pub slow_time_s: f64,
    /// Natural frequency of its slow error, Hz; 0: it is no oscillator.
    pub slow_hz: f64,
    /// Density of the random walk that its slow error has besides, m²/s.
    pub slow_walk_m2_s: f64,
}

impl Channel {
    /// Whether it tells where the structure is; other channels neither start the filter nor mark rows.
    pub fn places(&self) -> bool {
        self.measures == Quantity::Displacement
    }

    /// Whether something is known of its zero before its first measurement.
    pub fn zero_known(&self) -> bool {
        self.zero_std_m < f64::INFINITY
    }
}

/// What a parameter is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ParameterKind {
    /// Relative error of a scale.
    ScaleError,
    /// A clock's offset, s: measured late by so much.
    ClockOffset,
    /// Relative error of the accelerometer's gain along an axis: it measures too much by so much. The scales that were
    /// estimated from the accelerometer are too large by the same.
    GainError {
        /// The accelerometer's axis.
        axis: usize,
    },
}

/// What is unknown of a group of channels, before 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// What it is.
    pub kind: ParameterKind,
    /// Numbers of the channels that it concerns; of a gain, those whose scale was estimated from the accelerometer.
    pub channels: Vec<usize>,
    /// Its standard deviation before anything is measured.
    pub std: f64,
    /// From when on it is estimated; None: only the band holds it.
    pub estimated_from_ns: Option<i64>,
    /// Density of its random walk, unit²/s.
    pub walk: f64,
    /// A measurement tells it only where the square of the sensitivity is this many times the prediction's variance.
    pub clear: f64,
}

/// How often each cause is met, and what decides; see `cause`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, FromPyObject)]
pub struct Rates {
    /// Least share of measurements that are wrong by any amount; more is estimated.
    pub outlier: f64,
    /// Share of those whose next one is wrong too, of errors of the acceleration that last from one measurement to the
    /// next, and of a sensor's targets that shift with one.
    pub stays: f64,
    /// Shifts of a zero, 1/s.
    pub shift: f64,
    /// Of shifts of a sensor's zero that may revert the share that does.
    pub revert: f64,
    /// Returns of a shifted zero, 1/s.
    pub back: f64,
    /// Errors of the acceleration of any size, 1/s.
    pub wrong: f64,
    /// Sudden rises of a sensor's noise, 1/s.
    pub noise: f64,
    /// Motions led away, 1/s.
    pub lost: f64,
    /// Steps of a clock, 1/s.
    pub clock: f64,
    /// Logarithm by which a hypothesis falls behind the best one before it is dropped.
    pub odds: f64,
}

/// The table of channels, and what is known before the first measurement; arrays have one element an axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The channels; each is named by its number here.
    pub channels: Vec<Channel>,
    /// Number of axes.
    pub axes: usize,
    /// What is unknown of groups of channels.
    pub parameters: Vec<Parameter>,
    /// Expected bias of the acceleration, m/s².
    pub bias_m_s2: Vec<f64>,
    /// Its standard deviation, m/s².
    pub bias_std_m_s2: Vec<f64>,
    /// Density of its random walk, (m/s²)²/s.
    pub bias_walk: f64,
    /// How fast the structure may be, m/s; None: taken from the first measurements.
    pub velocity_std_m_s: Option<Vec<f64>>,
    /// How far it may be from the first measurement, m; None: taken from the first measurements.
    pub displacement_std_m: Option<f64>,
    /// How often each cause is met.
    pub rates: Rates,
    /// Measurements over which a channel's noise is followed.
    pub noise_memory: f64,
    /// How many measurements the channels' variance factors rest on.
    pub noise_weight: f64,
    /// Standard deviation (m) of the displacement and middle angular frequency (1/s); 0: clocks do not step.
    pub motion: Vec<(f64, f64)>,
    /// Instant that rows count from; None: from the sensors' own zero.
    pub zero_ns: Option<i64>,
    /// Variance (m²) that nothing measured tells of a row.
    pub unseen_m2: Vec<f64>,
    /// The part of it that all rows have in common, m².
    pub unseen_common_m2: Vec<f64>,
    /// Factor on the variance of the states in rows.
    pub misfit: Vec<f64>,
    /// Acceleration that leaning takes per metre of displacement, 1/s².
    pub lean: Vec<f64>,
}

impl Settings {
    /// Variance (m²) of the difference between two instants of a channel's motion that are far apart; 0: clocks do not
    /// step.
    pub fn apart_m2(&self, channel: &Channel) -> f64 {
        if !channel.places() {
            return 0.0;
        }
        let (std_m, _) = self.motion.get(channel.axis).copied().unwrap_or((0.0, 0.0));
        2.0 * std_m * std_m
    }

    /// The first channel of those that share the slow error of channel `c`: of one sensor along one axis, or of several
    /// on one box; None: it has none.
    pub fn slow_lead(&self, c: usize) -> Option<usize> {
        let own = &self.channels[c];
        let shares =
            |one: &Channel| one.places() && one.tilt_of == own.tilt_of && one.axis == own.axis && one.slow_std_m > 0.0;
        let has = match own.measures {
            Quantity::Displacement => shares(own),
            Quantity::Velocity => false,
            Quantity::Tilt | Quantity::TiltRate => true,
        };
        if has { self.channels.iter().position(shares) } else { None }
    }

    /// Whether the slow error that a channel measures exists, as an oscillator where it measures its rate.
    fn has_its_tilt(&self, c: usize) -> bool {
        match self.channels[c].measures {
            Quantity::Displacement | Quantity::Velocity => true,
            Quantity::Tilt => self.slow_lead(c).is_some(),
            Quantity::TiltRate => self.slow_lead(c).is_some_and(|lead| self.channels[lead].slow_hz > 0.0),
        }
    }

    /// Whether all arrays are as long as there are axes, and all channels and axes exist.
    pub fn consistent(&self) -> bool {
        let long = |values: &[f64]| values.len() >= self.axes;
        (1..=MAX_AXES).contains(&self.axes)
            && [&self.bias_m_s2, &self.bias_std_m_s2, &self.unseen_m2, &self.unseen_common_m2]
                .into_iter()
                .all(|one| long(one))
            && long(&self.misfit)
            && long(&self.lean)
            && self.motion.len() >= self.axes
            && self.velocity_std_m_s.as_deref().is_none_or(long)
            && self.channels.iter().all(|one| one.axis < self.axes)
            && (0..self.channels.len()).all(|c| self.has_its_tilt(c))
            && self.parameters.iter().all(|one| {
                one.channels.iter().all(|&c| c < self.channels.len())
                    && !matches!(one.kind, ParameterKind::GainError { axis } if axis >= self.axes)
            })
    }
}
