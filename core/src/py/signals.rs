//! `signals` for Python.

use super::{elements, same_length};
use crate::signals::resample::{self, Taps};
use crate::signals::{equal_runs, lively};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The spline (n,), 0 where nothing is bridged, and whether it is (n,).
type Bridged<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<bool>>);

/// See [`resample::spline`].
#[pyfunction]
fn local_spline<'py>(
    py: Python<'py>,
    at_s: PyReadonlyArray1<'py, f64>,
    knot_s: PyReadonlyArray1<'py, f64>,
    value: PyReadonlyArray1<'py, f64>,
    longest_s: f64,
    reach_s: f64,
) -> PyResult<Bridged<'py>> {
    let (at, knot) = (elements("at_s", &at_s)?, elements("knot_s", &knot_s)?);
    let value = elements("value", &value)?;
    same_length("knot_s, value", knot.len(), value.len())?;
    let found = py.detach(|| resample::spline(at, knot, value, longest_s, reach_s));
    let values: Vec<f64> = found.iter().map(|one| one.unwrap_or(0.0)).collect();
    let bridged: Vec<bool> = found.iter().map(Option::is_some).collect();
    Ok((values.into_pyarray(py), bridged.into_pyarray(py)))
}

/// See [`resample::filtered_at`].
#[pyfunction]
fn filtered_at<'py>(
    py: Python<'py>,
    series: PyReadonlyArray1<'py, f64>,
    index: PyReadonlyArray1<'py, i64>,
    fraction: PyReadonlyArray1<'py, f64>,
    wanted: PyReadonlyArray1<'py, f64>,
    bend: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (series, index) = (elements("series", &series)?, elements("index", &index)?);
    let fraction = elements("fraction", &fraction)?;
    let taps = Taps { wanted: elements("wanted", &wanted)?, bend: elements("bend", &bend)? };
    same_length("index, fraction", index.len(), fraction.len())?;
    same_length("wanted, bend", taps.wanted.len(), taps.bend.len())?;
    py.detach(|| resample::filtered_at(series, index, fraction, &taps))
        .map(|values| values.into_pyarray(py))
        .ok_or_else(|| PyValueError::new_err("index: too near an end of the series"))
}

/// Lengths (n,), lengths from which on runs are frozen (n,), shares (n,).
type Runs<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>);

/// See [`equal_runs::follow`].
#[pyfunction]
fn follow_equal_runs<'py>(
    py: Python<'py>,
    value: PyReadonlyArray1<'py, f64>,
    before: (f64, i64, f64),
    forget: f64,
    gentle: f64,
) -> PyResult<Runs<'py>> {
    let value = elements("value", &value)?;
    let runs = py.detach(|| equal_runs::follow(value, before, forget, gentle));
    let length: Vec<i64> = runs.iter().map(|run| run.length).collect();
    let frozen: Vec<i64> = runs.iter().map(|run| run.frozen).collect();
    let share: Vec<f64> = runs.iter().map(|run| run.share).collect();
    Ok((length.into_pyarray(py), frozen.into_pyarray(py), share.into_pyarray(py)))
}

/// See [`lively::mean_square`].
#[pyfunction]
fn mean_square<'py>(
    py: Python<'py>,
    value: PyReadonlyArray1<'py, f64>,
    mean: f64,
    before: f64,
    kept: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let value = elements("value", &value)?;
    Ok(py.detach(|| lively::mean_square(value, mean, before, kept)).into_pyarray(py))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(follow_equal_runs, module)?)?;
    module.add_function(wrap_pyfunction!(mean_square, module)?)?;
    module.add_function(wrap_pyfunction!(local_spline, module)?)?;
    module.add_function(wrap_pyfunction!(filtered_at, module)?)
}
