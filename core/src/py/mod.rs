//! What Python sees: arrays become slices and results become arrays; nothing is computed here.

pub mod arrays;
pub mod bank;
pub mod chain;
pub mod estimator;
pub mod features;
pub mod lens;
pub mod likelihood;
pub mod packed;
pub mod phase;
pub mod picture;
pub mod pixels;
pub mod printed;
pub mod radar;
pub mod registration;
pub mod scene;
pub mod settings;
pub mod signals;
pub mod track;

use crate::rows::Rows;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// An argument's elements; a ValueError with its name where the array is not contiguous.
pub fn elements<'a, T: numpy::Element>(name: &str, array: &'a PyReadonlyArray1<'_, T>) -> PyResult<&'a [T]> {
    array.as_slice().map_err(|_| PyValueError::new_err(format!("{name}: not contiguous")))
}

/// The rows of an argument of two columns; a ValueError with its name where it has others.
pub fn pairs(name: &str, array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; 2]>> {
    let rows = array.as_array();
    if rows.ncols() != 2 {
        return Err(PyValueError::new_err(format!("{name}: {} columns where 2 are needed", rows.ncols())));
    }
    Ok(rows.rows().into_iter().map(|row| [row[0], row[1]]).collect())
}

/// ValueError where two arguments that must be as long as each other are not.
pub fn same_length(names: &str, one: usize, other: usize) -> PyResult<()> {
    if one == other { Ok(()) } else { Err(PyValueError::new_err(format!("{names}: {one} and {other} elements"))) }
}

/// Point, stamp of the first row, step, number and status of runs (k,); displacement, standard deviation, velocity (n,).
pub type RunArrays<'py> = (
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<u32>>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
);

/// Rows of many points as arrays.
pub fn run_arrays(py: Python<'_>, rows: Rows) -> RunArrays<'_> {
    let [displacement, std, velocity] = rows.columns;
    (
        rows.point.into_pyarray(py),
        rows.t0_ns.into_pyarray(py),
        rows.dt_ns.into_pyarray(py),
        rows.count.into_pyarray(py),
        rows.status.into_pyarray(py),
        displacement.into_pyarray(py),
        std.into_pyarray(py),
        velocity.into_pyarray(py),
    )
}
