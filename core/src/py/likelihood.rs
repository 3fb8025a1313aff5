//! `likelihood` for Python.

use super::{elements, pairs, same_length};
use crate::likelihood::{play, response, whitening};
use numpy::ndarray::ArrayView2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Innovations (m, c), their variances (m,), what the acceleration's noise makes of them (m,), bias (c,), its variance.
type Whitened<'py> =
    (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, f64);

/// See [`whitening::whiten`]; `slow`: variance, rate and angular frequency, or None; `longer`: (m, c) or None.
#[pyfunction]
#[pyo3(signature = (pieces, rows, values, density, slow=None, longer=None))]
fn whiten<'py>(
    py: Python<'py>,
    pieces: PyReadonlyArray2<'py, f64>,
    rows: PyReadonlyArray2<'py, f64>,
    values: PyReadonlyArray2<'py, f64>,
    density: f64,
    slow: Option<[f64; 3]>,
    longer: Option<PyReadonlyArray2<'py, f64>>,
) -> PyResult<Whitened<'py>> {
    let [pieces, rows] = times(&pieces, &rows)?;
    let (values, longer) = (values.as_array(), longer.as_ref().map(PyReadonlyArray2::as_array));
    same_length("rows, values", rows.len(), values.nrows())?;
    if longer.is_some_and(|longer| longer.dim() != values.dim()) {
        return Err(PyValueError::new_err("longer: not of the shape of values"));
    }
    let (shape, values) = (values.raw_dim(), copied(&values));
    let longer: Vec<f64> = longer.map_or_else(Vec::new, |longer| copied(&longer));
    let noise = whitening::Noise { pieces: &pieces, density, slow };
    let found = py.detach(|| whitening::whiten(&noise, &rows, values, &longer));
    Ok((
        found.values.into_pyarray(py).reshape(shape)?,
        found.variance.into_pyarray(py),
        found.input_part.into_pyarray(py),
        found.bias.into_pyarray(py),
        found.bias_variance,
    ))
}

/// The squares of columns (c,), their products with the first one (c,), with later ones, variances (m,), input parts (m,).
type Summed<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
);

/// See [`whitening::products`].
#[pyfunction]
fn whitened_products<'py>(
    py: Python<'py>,
    pieces: PyReadonlyArray2<'py, f64>,
    rows: PyReadonlyArray2<'py, f64>,
    values: PyReadonlyArray2<'py, f64>,
    density: f64,
    apart: usize,
    first: usize,
) -> PyResult<Summed<'py>> {
    let [pieces, rows] = times(&pieces, &rows)?;
    same_length("rows, values", rows.len(), values.as_array().nrows())?;
    let values = values.as_slice().map_err(|_| PyValueError::new_err("values: not contiguous"))?;
    let noise = whitening::Noise { pieces: &pieces, density, slow: None };
    let sums = py.detach(|| whitening::products(&noise, &rows, values, apart, first));
    Ok((
        sums.squares.into_pyarray(py),
        sums.with_first.into_pyarray(py),
        sums.with_later.into_pyarray(py),
        sums.variance.into_pyarray(py),
        sums.input_part.into_pyarray(py),
    ))
}

/// Pieces and rows, whose times are records'.
fn times(pieces: &PyReadonlyArray2<f64>, rows: &PyReadonlyArray2<f64>) -> PyResult<[Vec<[f64; 2]>; 2]> {
    let (pieces, rows) = (pairs("pieces", pieces)?, pairs("rows", rows)?);
    // Times of records are 64-bit nanoseconds; what lies farther apart would be stepped through for ever.
    let longest_s = i64::MAX as f64 * 1e-9;
    if rows.iter().chain(&pieces).any(|[time, _]| !(-longest_s..=longest_s).contains(time)) {
        return Err(PyValueError::new_err("pieces, rows: a time that is not finite or beyond 64-bit nanoseconds"));
    }
    Ok([pieces, rows])
}

fn copied(array: &ArrayView2<'_, f64>) -> Vec<f64> {
    array.as_slice().map_or_else(|| array.iter().copied().collect(), <[f64]>::to_vec)
}

/// See [`response::integrate`].
#[pyfunction]
fn integrate<'py>(
    py: Python<'py>,
    time_s: PyReadonlyArray1<'py, f64>,
    value: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (time, value) = (elements("time_s", &time_s)?, elements("value", &value)?);
    same_length("time_s, value", time.len(), value.len())?;
    let cubics = py.detach(|| response::integrate(time, value));
    let count = cubics.len();
    cubics.into_flattened().into_pyarray(py).reshape([count, 4])
}

/// See [`response::derivative`].
#[pyfunction]
fn derivative<'py>(
    py: Python<'py>,
    edges_s: PyReadonlyArray1<'py, f64>,
    cubics: PyReadonlyArray2<'py, f64>,
    time_s: PyReadonlyArray1<'py, f64>,
    order: u8,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (edges, time) = (elements("edges_s", &edges_s)?, elements("time_s", &time_s)?);
    let cubics = cubics.as_slice().unwrap_or_default();
    if cubics.is_empty() || cubics.len() % 4 != 0 {
        return Err(PyValueError::new_err("cubics: contiguous rows of four coefficients are needed"));
    }
    same_length("edges_s, cubics and one", edges.len(), cubics.len() / 4 + 1)?;
    Ok(py.detach(|| response::derivative(edges, cubics, time, order)).into_pyarray(py))
}

/// See [`play::play`].
#[pyfunction]
fn follow_with_play<'py>(
    py: Python<'py>,
    path: PyReadonlyArray1<'py, f64>,
    width: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    Ok(play::play(elements("path", &path)?, width).into_pyarray(py))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("BIAS_WALK_RATIO", whitening::BIAS_WALK_RATIO)?;
    module.add_function(wrap_pyfunction!(follow_with_play, module)?)?;
    module.add_function(wrap_pyfunction!(whiten, module)?)?;
    module.add_function(wrap_pyfunction!(whitened_products, module)?)?;
    module.add_function(wrap_pyfunction!(integrate, module)?)?;
    module.add_function(wrap_pyfunction!(derivative, module)?)
}
