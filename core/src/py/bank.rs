//! `bank` for Python.

use super::{elements, same_length};
use crate::bank::rows::Rows;
use crate::bank::settings::Settings;
use crate::bank::{Bank, Block, Sensor, Values};
use crate::estimator::state::{StateError, from_bytes, to_bytes};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// Point, stamp of the first row, step, number and status of runs (k,); displacement, standard deviation, velocity.
type RunArrays<'py> = (
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
);

/// The settings as Python holds them.
#[derive(FromPyObject)]
struct PyBankSettings {
    acceleration_std_m_s2: f64,
    displacement_std_m: f64,
    slow_std_m: f64,
    slow_time_s: f64,
    delay_std_s: f64,
    gain_std: f64,
    bias_walk: f64,
    wait_s: f64,
    coasting_s: f64,
    lost_s: f64,
    as_stated: bool,
    rounded: bool,
}

impl PyBankSettings {
    fn settings(&self) -> Settings {
        Settings {
            acceleration_std_m_s2: self.acceleration_std_m_s2,
            displacement_std_m: self.displacement_std_m,
            slow_std_m: self.slow_std_m,
            slow_time_s: self.slow_time_s,
            delay_std_s: self.delay_std_s,
            gain_std: self.gain_std,
            bias_walk: self.bias_walk,
            wait_s: self.wait_s,
            coasting_s: self.coasting_s,
            lost_s: self.lost_s,
            as_stated: self.as_stated,
            rounded: self.rounded,
        }
    }
}

/// Values of four or of eight bytes.
#[derive(FromPyObject)]
enum Array<'py> {
    Single(PyReadonlyArray1<'py, f32>),
    Double(PyReadonlyArray1<'py, f64>),
}

/// See [`Bank`].
#[pyclass(module = "midspan._core", name = "Bank")]
struct PyBank(Bank);

#[pymethods]
impl PyBank {
    #[new]
    fn new(points: usize, settings: PyBankSettings) -> Self {
        Self(Bank::new(points, settings.settings()))
    }

    /// How many points there are.
    fn __len__(&self) -> usize {
        self.0.len()
    }

    /// Takes blocks of one sensor: point, stamp of the first value and step (ns), number of values (m,), and the values
    /// of all.
    #[allow(clippy::too_many_arguments)]
    fn push(
        &mut self,
        py: Python<'_>,
        displacement: bool,
        point: PyReadonlyArray1<'_, u32>,
        t0_ns: PyReadonlyArray1<'_, i64>,
        dt_ns: PyReadonlyArray1<'_, i64>,
        count: PyReadonlyArray1<'_, u32>,
        values: Array<'_>,
    ) -> PyResult<()> {
        let sensor = if displacement { Sensor::Displacement } else { Sensor::Acceleration };
        let (point, t0, dt) = (elements("point", &point)?, elements("t0_ns", &t0_ns)?, elements("dt_ns", &dt_ns)?);
        let count = elements("count", &count)?;
        for (name, length) in [("t0_ns", t0.len()), ("dt_ns", dt.len()), ("count", count.len())] {
            same_length(&format!("point, {name}"), point.len(), length)?;
        }
        let values = match &values {
            Array::Single(array) => Values::Single(elements("values", array)?),
            Array::Double(array) => Values::Double(elements("values", array)?),
        };
        let whole: usize = count.iter().map(|&one| one as usize).sum();
        same_length("values, sum of count", values.len(), whole)?;
        if let Some(one) = point.iter().find(|&&one| one as usize >= self.0.len()) {
            return Err(PyValueError::new_err(format!("point: {one} of {}", self.0.len())));
        }
        if let Some(one) = dt.iter().find(|&&one| one <= 0) {
            return Err(PyValueError::new_err(format!("dt_ns: {one} where it must be positive")));
        }
        let bank = &mut self.0;
        py.detach(|| {
            let mut first = 0;
            for k in 0..point.len() {
                let end = first + count[k] as usize;
                let values = values.part(first, end);
                bank.push(sensor, &Block { point: point[k], t0_ns: t0[k], dt_ns: dt[k], values });
                first = end;
            }
        });
        Ok(())
    }

    /// The rows that are complete when it is `until_ns`.
    fn rows<'py>(&mut self, py: Python<'py>, until_ns: i64) -> RunArrays<'py> {
        let Rows { point, t0_ns, dt_ns, count, status, displacement, std, velocity } =
            py.detach(|| self.0.rows(until_ns));
        (
            point.into_pyarray(py),
            t0_ns.into_pyarray(py),
            dt_ns.into_pyarray(py),
            count.into_pyarray(py),
            status.into_pyarray(py),
            displacement.into_pyarray(py),
            std.into_pyarray(py),
            velocity.into_pyarray(py),
        )
    }

    /// Point, stamp and code of what happened since the last call.
    fn events(&mut self) -> Vec<(u32, i64, u8)> {
        self.0.events().into_iter().map(|(point, one)| (point, one.time_ns, one.code as u8)).collect()
    }

    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = py.detach(|| to_bytes(&self.0)).map_err(super::estimator::state_error)?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// The bank that bytes are the state of.
    #[staticmethod]
    fn restored(py: Python<'_>, state: &[u8], settings: PyBankSettings) -> PyResult<Self> {
        let bank: Bank = py.detach(|| from_bytes(state)).map_err(super::estimator::state_error)?;
        if *bank.settings() != settings.settings() {
            return Err(super::estimator::state_error(StateError::OtherSettings));
        }
        Ok(Self(bank))
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyBank>()
}
