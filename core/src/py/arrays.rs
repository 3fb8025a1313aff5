//! Images and grids of Python as the core takes them, and back.

use crate::track::grid::Grid;
use numpy::{Element, IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

/// A copy of an array (rows, columns).
pub fn grid<T: Element + Copy>(array: &PyReadonlyArray2<'_, T>) -> Grid<T> {
    let view = array.as_array();
    let (rows, columns) = view.dim();
    let values = view.as_slice().map_or_else(|| view.iter().copied().collect(), <[T]>::to_vec);
    Grid { values, rows, columns }
}

/// An array (rows, columns) of a grid.
pub fn array<'py, T: Element>(py: Python<'py>, grid: Grid<T>) -> PyResult<Bound<'py, PyArray2<T>>> {
    grid.values.into_pyarray(py).reshape([grid.rows, grid.columns])
}
