//! `radar` for Python.

use super::{elements, same_length};
use crate::radar::unwrap;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
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

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(unwrap_aided, module)?)
}
