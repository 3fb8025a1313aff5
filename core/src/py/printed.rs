//! `estimator::printed` for Python.

use super::{elements, same_length};
use crate::estimator::printed::{Frame, Input, Learning, Printed, PrintedRow, Start};
use crate::estimator::state::{from_bytes, to_bytes};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// The filter of [`crate::estimator::printed`] with the frames that wait.
#[pyclass(module = "midspan._core")]
struct PrintedFilter {
    filter: Printed,
    waiting: Vec<Frame>,
    learning: Learning,
    start: Start,
    most: usize,
}

#[pymethods]
impl PrintedFilter {
    /// bias, velocity_std: at the first sample; mean_input: whether the mean of two samples acts between
    /// them; start_noise: variance R of the first frames, or None for the first declared one and `held_noise`; waiting:
    /// this many frames may wait.
    #[new]
    #[pyo3(signature = (*, bias, velocity_std, beta, first_frames, mean_input, start_noise, held_noise, waiting))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        bias: f64,
        velocity_std: f64,
        beta: f64,
        first_frames: f64,
        mean_input: bool,
        start_noise: Option<f64>,
        held_noise: f64,
        waiting: usize,
    ) -> Self {
        Self {
            filter: Printed::new(bias, velocity_std),
            waiting: Vec::new(),
            learning: Learning { beta, first_frames, input: if mean_input { Input::Mean } else { Input::Held } },
            start: Start { noise: start_noise, held_noise },
            most: waiting,
        }
    }

    /// Takes frames: times (s), displacements and variances (m,).
    fn wait(
        &mut self,
        time_s: PyReadonlyArray1<'_, f64>,
        value_m: PyReadonlyArray1<'_, f64>,
        variance_m2: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<()> {
        let (at, value) = (elements("time_s", &time_s)?, elements("value_m", &value_m)?);
        let variance = elements("variance_m2", &variance_m2)?;
        same_length("time_s, value_m", at.len(), value.len())?;
        same_length("time_s, variance_m2", at.len(), variance.len())?;
        let frame = |i: usize| Frame { at_s: at[i], value_m: value[i], variance_m2: variance[i] };
        self.waiting.extend((0..at.len()).map(frame));
        let dropped = self.waiting.len().saturating_sub(self.most);
        self.waiting.drain(..dropped);
        Ok(())
    }

    /// Displacement and velocity at samples (times in s, accelerations and noise densities, each (n,)), and R of each
    /// frame that they cover (m,), NaN where it was not used.
    fn push<'py>(
        &mut self,
        py: Python<'py>,
        time_s: PyReadonlyArray1<'py, f64>,
        value: PyReadonlyArray1<'py, f64>,
        density: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<[Bound<'py, PyArray1<f64>>; 3]> {
        let (at, value) = (elements("time_s", &time_s)?, elements("value", &value)?);
        let density = elements("density", &density)?;
        same_length("time_s, value", at.len(), value.len())?;
        same_length("time_s, density", at.len(), density.len())?;
        let samples = at.iter().zip(value).zip(density).map(|((&at_s, &value), &density)| [at_s, value, density]);
        let (mut rows, mut noises) = (Vec::with_capacity(at.len()), vec![None; self.waiting.len()]);
        self.filter.begin(&self.waiting, self.start);
        let done = self.filter.run(samples, &self.waiting, self.learning, &mut rows, &mut noises);
        self.waiting.drain(..done);
        let column = |of: fn(&PrintedRow) -> f64| rows.iter().map(of).collect::<Vec<f64>>().into_pyarray(py);
        let noise: Vec<f64> = noises[..done].iter().map(|one| one.unwrap_or(f64::NAN)).collect();
        Ok([column(|one| one.x), column(|one| one.v), noise.into_pyarray(py)])
    }

    /// Displacement and variance at a time (s) after the last sample.
    fn predict(&self, time_s: f64) -> (f64, f64) {
        self.filter.predict(time_s)
    }

    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = to_bytes(&(self.filter, &self.waiting)).map_err(|_| PyValueError::new_err("state"))?;
        Ok(PyBytes::new(py, &bytes))
    }

    fn restore(&mut self, state: &[u8]) -> PyResult<()> {
        (self.filter, self.waiting) = from_bytes(state).map_err(super::estimator::state_error)?;
        Ok(())
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PrintedFilter>()
}
