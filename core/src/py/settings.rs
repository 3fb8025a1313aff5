//! The estimator's settings as Python holds them: read field by field.

use crate::estimator::settings::{self, ParameterKind, Quantity, Rates};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The settings as Python holds them.
#[derive(FromPyObject)]
pub struct PySettings {
    channels: Vec<PyChannel>,
    axes: usize,
    parameters: Vec<PyParameter>,
    bias_m_s2: Vec<f64>,
    bias_std_m_s2: Vec<f64>,
    bias_walk: f64,
    velocity_std_m_s: Option<Vec<f64>>,
    displacement_std_m: Option<f64>,
    rates: Rates,
    noise_memory: f64,
    noise_weight: f64,
    motion: Vec<(f64, f64)>,
    zero_ns: Option<i64>,
    unseen_std_m: Vec<f64>,
    unseen_zero_std_m: Vec<f64>,
    misfit: Vec<f64>,
    lean: Vec<f64>,
}

#[derive(FromPyObject)]
struct PyChannel {
    sensor: String,
    measures: i64,
    tilt_of: String,
    slow_units_per_m: Option<f64>,
    source: u8,
    units_per_m: f64,
    axis: usize,
    variance_factor: f64,
    exposure_s: f64,
    zero_std_m: f64,
    zero_walk_m2_s: f64,
    reverting_s: f64,
    coasting_s: f64,
    lost_s: f64,
    slow_std_m: f64,
    slow_time_s: f64,
    slow_hz: f64,
    slow_walk_m2_s: f64,
}

#[derive(FromPyObject)]
struct PyParameter {
    kind: i64,
    channels: Vec<usize>,
    std: f64,
    estimated_from_ns: Option<i64>,
    walk: f64,
    clear: f64,
    axis: usize,
}

impl PySettings {
    /// The same for the core.
    pub fn converted(self) -> PyResult<settings::Settings> {
        let mut sensors: Vec<String> = self.channels.iter().map(|one| one.sensor.clone()).collect();
        sensors.sort_unstable();
        sensors.dedup();
        let sensor = |name: &String| sensors.binary_search(name).unwrap_or(0);
        let channels = self.channels.iter().map(|one| {
            let tilt_of = if one.tilt_of.is_empty() { &one.sensor } else { &one.tilt_of };
            one.converted(sensor(&one.sensor), sensor(tilt_of))
        });
        let channels = channels.collect::<PyResult<_>>()?;
        let parameters = self.parameters.into_iter().map(PyParameter::converted).collect::<PyResult<_>>()?;
        let own = |std: &f64| if self.zero_ns.is_some() { std * std } else { 0.0 };
        let both = self.unseen_std_m.iter().zip(&self.unseen_zero_std_m);
        let settings = settings::Settings {
            channels,
            axes: self.axes,
            parameters,
            unseen_m2: both.clone().map(|(std, zero)| 2.0 * std * std + zero * zero).collect(),
            unseen_common_m2: both.map(|(std, zero)| own(std) + zero * zero).collect(),
            bias_m_s2: self.bias_m_s2,
            bias_std_m_s2: self.bias_std_m_s2,
            bias_walk: self.bias_walk,
            velocity_std_m_s: self.velocity_std_m_s,
            displacement_std_m: self.displacement_std_m,
            rates: self.rates,
            noise_memory: self.noise_memory,
            noise_weight: self.noise_weight,
            motion: self.motion,
            zero_ns: self.zero_ns,
            misfit: self.misfit,
            lean: self.lean,
        };
        if settings.consistent() { Ok(settings) } else { Err(PyValueError::new_err("settings: inconsistent")) }
    }
}

impl PyChannel {
    fn converted(&self, sensor: usize, tilt_of: usize) -> PyResult<settings::Channel> {
        let measures = match self.measures {
            0 => Quantity::Displacement,
            1 => Quantity::Velocity,
            2 => Quantity::Tilt,
            3 => Quantity::TiltRate,
            other => return Err(PyValueError::new_err(format!("what a channel measures: {other}"))),
        };
        Ok(settings::Channel {
            sensor,
            measures,
            tilt_of,
            slow_units_per_m: self.slow_units_per_m,
            source: self.source,
            units_per_m: self.units_per_m,
            axis: self.axis,
            variance_factor: self.variance_factor,
            exposure_s: self.exposure_s,
            zero_std_m: self.zero_std_m,
            zero_walk_m2_s: self.zero_walk_m2_s,
            reverting_s: self.reverting_s,
            coasting_s: self.coasting_s,
            lost_s: self.lost_s,
            slow_std_m: self.slow_std_m,
            slow_time_s: self.slow_time_s,
            slow_hz: self.slow_hz,
            slow_walk_m2_s: self.slow_walk_m2_s,
        })
    }
}

impl PyParameter {
    fn converted(self) -> PyResult<settings::Parameter> {
        let kind = match self.kind {
            1 => ParameterKind::ScaleError,
            2 => ParameterKind::ClockOffset,
            -1 => ParameterKind::GainError { axis: self.axis },
            other => return Err(PyValueError::new_err(format!("kind of a parameter: {other}"))),
        };
        Ok(settings::Parameter {
            kind,
            channels: self.channels,
            std: self.std,
            estimated_from_ns: self.estimated_from_ns,
            walk: self.walk,
            clear: self.clear,
        })
    }
}
