//! `radar` for Python.

use super::{elements, same_length};
use crate::radar::{blockage, follow, unwrap};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// See [`unwrap::unwrap_aided`].
#[pyfunction]
fn unwrap_aided<'py>(
    py: Python<'py>,
    phase_rad: PyReadonlyArray1<'py, f64>,
    acceleration_step_m: PyReadonlyArray1<'py, f64>,
    rad_per_m: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (phase, step) = (elements("phase_rad", &phase_rad)?, elements("acceleration_step_m", &acceleration_step_m)?);
    same_length("phase_rad, acceleration_step_m", phase.len(), step.len())?;
    Ok(py.detach(|| unwrap::unwrap_aided(phase, step, rad_per_m)).into_pyarray(py))
}

/// See [`blockage::blocked`].
#[pyfunction]
fn blocked<'py>(
    py: Python<'py>,
    share: PyReadonlyArray1<'py, f64>,
    noise_share: f64,
    gain: f64,
    limits: (f64, f64),
    clear_frames: usize,
) -> PyResult<Bound<'py, PyArray1<bool>>> {
    let (min_share, max_share) = limits;
    let band = blockage::Band { noise_share, gain, min_share, max_share, clear_frames };
    let share = elements("share", &share)?;
    Ok(py.detach(|| blockage::blocked(share, &band)).into_pyarray(py))
}

/// See [`follow::Follower`].
#[pyclass(module = "midspan._core")]
struct PhaseFollower(follow::Follower);

#[pymethods]
impl PhaseFollower {
    /// `trust`: density of the acceleration's noise, errors of scale and time, bias walk; `start`: speed, its standard
    /// deviation, that of the bias, logarithm of the noise's factor.
    #[new]
    fn new(rad_per_m: f64, trust: [f64; 4], start: [f64; 4]) -> Self {
        let [noise_density, scale_error, time_error_s, bias_walk] = trust;
        let trust = follow::Trust { noise_density, scale_error, time_error_s, bias_walk };
        Self(follow::Follower::new(rad_per_m, trust, start[0], start[1], start[2], start[3]))
    }

    /// The phase, rad, from which the range change counts.
    #[getter]
    fn origin(&self) -> f64 {
        self.0.origin()
    }

    /// Rows (n, 7) of a `follow::Step` to rows (n, 5): phase (NaN: not used), range change, its variance, 1 where the
    /// cycle is a guess, surprise (NaN: none).
    fn push<'py>(&mut self, py: Python<'py>, steps: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let steps = steps.as_array();
        if steps.ncols() != 7 {
            return Err(PyValueError::new_err(format!("steps: {} columns where 7 are needed", steps.ncols())));
        }
        let found: Vec<[f64; 5]> = steps
            .rows()
            .into_iter()
            .map(|row| {
                let found = self.0.push(&follow::Step {
                    dt: row[0],
                    phase: row[1],
                    variance: row[2],
                    velocity: row[3],
                    displacement: row[4],
                    acceleration: row[5],
                    jerk: row[6],
                });
                let [phase, surprise] = [found.phase, found.surprise].map(|one| one.unwrap_or(f64::NAN));
                [phase, found.range_m, found.range_variance, f64::from(u8::from(found.cycle_lost)), surprise]
            })
            .collect();
        let count = found.len();
        found.into_flattened().into_pyarray(py).reshape([count, 5])
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PhaseFollower>()?;
    module.add_function(wrap_pyfunction!(blocked, module)?)?;
    module.add_function(wrap_pyfunction!(unwrap_aided, module)?)
}
