//! `track` for Python: splines, correlation, the template.

use super::arrays::{array, grid};
use super::pixels::{Pixels, with_image};
use super::{elements, pairs, same_length};
use crate::track::fine_spline::{Fine, Taps};
use crate::track::grid::Grid;
use crate::track::patch::values;
use crate::track::peak::Precision;
use crate::track::spline::{self, TAPS};
use crate::track::template::{Fix, Template, Window};
use crate::track::{correlation, fine_spline, reference};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::Arc;

type Grid32<'py> = Bound<'py, PyArray2<f32>>;

/// ValueError unless the order of a derivative is 0, 1 or 2.
fn order(derivative: usize) -> PyResult<usize> {
    if derivative > 2 { Err(PyValueError::new_err("derivative: 0, 1 or 2 is needed")) } else { Ok(derivative) }
}

/// That number of weights; a ValueError with their name where there are others.
fn taps<const N: usize>(name: &str, weights: &PyReadonlyArray1<'_, f64>) -> PyResult<[f64; N]> {
    let weights = elements(name, weights)?;
    weights.try_into().map_err(|_| PyValueError::new_err(format!("{name}: {} weights, not {N}", weights.len())))
}

/// ValueError where a grid has fewer rows or columns than needed.
fn at_least<T>(name: &str, grid: &Grid<T>, rows: usize, columns: usize) -> PyResult<()> {
    if grid.rows >= rows && grid.columns >= columns {
        return Ok(());
    }
    let (r, c) = (grid.rows, grid.columns);
    Err(PyValueError::new_err(format!("{name}: {r} rows and {c} columns where {rows} and {columns} are needed")))
}

/// See [`spline::quintic`].
#[pyfunction]
fn quintic(x: f64, derivative: usize) -> PyResult<f64> {
    Ok(spline::quintic(x, order(derivative)?))
}

/// See [`spline::weights`].
#[pyfunction]
fn spline_weights<'py>(py: Python<'py>, shift: f64, derivative: usize) -> PyResult<Bound<'py, PyArray1<f64>>> {
    Ok(spline::weights(shift, order(derivative)?).to_vec().into_pyarray(py))
}

/// See [`spline::coefficients`].
#[pyfunction]
fn spline_coefficients<'py>(py: Python<'py>, image: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let image = grid(&image);
    array(py, py.detach(|| spline::coefficients(&image)))
}

/// See [`spline::combine`].
#[pyfunction]
fn combine<'py>(
    py: Python<'py>,
    coefficients: PyReadonlyArray2<'py, f32>,
    down: PyReadonlyArray1<'py, f64>,
    across: PyReadonlyArray1<'py, f64>,
) -> PyResult<Grid32<'py>> {
    let (coefficients, down, across) = (grid(&coefficients), taps("down", &down)?, taps("across", &across)?);
    at_least("coefficients", &coefficients, TAPS - 1, TAPS - 1)?;
    array(py, py.detach(|| spline::combine(&coefficients, &down, &across)))
}

/// See [`spline::translated`].
#[pyfunction]
fn translated<'py>(py: Python<'py>, coefficients: PyReadonlyArray2<'py, f32>, x: f64, y: f64) -> PyResult<Grid32<'py>> {
    let coefficients = grid(&coefficients);
    at_least("coefficients", &coefficients, TAPS - 1, TAPS - 1)?;
    array(py, py.detach(|| spline::translated(&coefficients, x, y)))
}

/// See [`fine_spline::fine_weights`].
#[pyfunction]
fn fine_weights<'py>(py: Python<'py>, shift: f64, derivative: usize) -> PyResult<Bound<'py, PyArray1<f64>>> {
    Ok(fine_spline::fine_weights(shift, order(derivative)?).to_vec().into_pyarray(py))
}

/// The fine spline moved by x and y (-0.5 to 0.5 px), or its derivative of some order down and across. See
/// [`fine_spline::read`].
#[pyfunction]
#[pyo3(signature = (coefficients, x, y, down = 0, across = 0))]
fn read_fine<'py>(
    py: Python<'py>,
    coefficients: PyReadonlyArray2<'py, f32>,
    x: f64,
    y: f64,
    down: usize,
    across: usize,
) -> PyResult<Grid32<'py>> {
    let (coefficients, down, across) =
        (grid(&coefficients), Taps::new(-y, order(down)?), Taps::new(-x, order(across)?));
    at_least("coefficients", &coefficients, fine_spline::FINE_TAPS, fine_spline::FINE_TAPS)?;
    array(py, py.detach(|| fine_spline::read(&Fine::of(&coefficients), &down, &across)))
}

/// See [`fine_spline::refined`].
#[pyfunction]
fn refined<'py>(py: Python<'py>, image: PyReadonlyArray2<'py, f64>) -> PyResult<Grid32<'py>> {
    let image = grid(&image);
    at_least("image", &image, 2, 2)?;
    array(py, py.detach(|| fine_spline::refined(&image)))
}

/// See [`Fine::cropped`].
#[pyfunction]
fn cropped<'py>(
    py: Python<'py>,
    coefficients: PyReadonlyArray2<'py, f32>,
    origin: (usize, usize),
    size: (usize, usize),
) -> PyResult<Grid32<'py>> {
    let coefficients = grid(&coefficients);
    let needed = |first: usize, size: usize| {
        first.checked_add(size).and_then(|end| end.checked_mul(fine_spline::PER_PX)?.checked_add(fine_spline::BEYOND))
    };
    let (Some(rows), Some(columns)) = (needed(origin.0, size.0), needed(origin.1, size.1)) else {
        return Err(PyValueError::new_err("size: too large"));
    };
    at_least("coefficients", &coefficients, rows, columns)?;
    array(py, Fine::of(&coefficients).cropped(origin, size).joined())
}

/// See [`correlation::window_energies`].
#[pyfunction]
fn window_energies<'py>(
    py: Python<'py>,
    patch: PyReadonlyArray2<'py, f64>,
    rows: usize,
    columns: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let patch = grid(&patch);
    at_least("patch", &patch, rows, columns)?;
    array(py, py.detach(|| correlation::window_energies(&patch, rows, columns)))
}

/// See [`correlation::zncc_map`].
#[pyfunction]
fn zncc_map<'py>(
    py: Python<'py>,
    patch: PyReadonlyArray2<'py, f32>,
    template: PyReadonlyArray2<'py, f32>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (patch, template) = (grid(&patch), grid(&template));
    at_least("patch", &patch, template.rows, template.columns)?;
    at_least("template", &template, 1, 1)?;
    array(py, py.detach(|| correlation::zncc_map(&patch, &template)))
}

/// See [`correlation::smooth`].
#[pyfunction]
fn smooth<'py>(
    py: Python<'py>,
    patch: PyReadonlyArray2<'py, f32>,
    taps: PyReadonlyArray1<'py, f32>,
) -> PyResult<Grid32<'py>> {
    let (patch, taps) = (grid(&patch), elements("taps", &taps)?);
    if taps.len() % 2 == 0 {
        return Err(PyValueError::new_err("taps: an odd number of weights is needed"));
    }
    array(py, py.detach(|| correlation::smooth(&patch, taps)))
}

/// See [`correlation::shrink`].
#[pyfunction]
fn shrink<'py>(py: Python<'py>, patch: PyReadonlyArray2<'py, f32>, factor: usize) -> PyResult<Grid32<'py>> {
    if factor == 0 {
        return Err(PyValueError::new_err("factor: 1 or more is needed"));
    }
    let patch = grid(&patch);
    array(py, py.detach(|| correlation::shrink(&patch, factor)))
}

/// The pixels of an image (rows, columns) less a level; None where more than 2 % of them are not numbers. See
/// [`crate::track::patch::values`].
#[pyfunction]
fn pixel_values<'py>(
    py: Python<'py>,
    pixels: &Bound<'py, PyAny>,
    level: f64,
) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
    let image = Pixels::of(pixels)?;
    let values = with_image!(image, pixels => {
        py.detach(|| values(pixels, level))
    });
    values.map(|grid| array(py, grid)).transpose()
}

/// See [`reference::agreement`].
#[pyfunction]
fn cell_agreement<'py>(
    py: Python<'py>,
    seen: PyReadonlyArray1<'py, f32>,
    left: PyReadonlyArray1<'py, f32>,
    cell: PyReadonlyArray1<'py, i64>,
    cells: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (seen, left, cell) = (elements("seen", &seen)?, elements("left", &left)?, elements("cell", &cell)?);
    same_length("seen, left", seen.len(), left.len())?;
    same_length("seen, cell", seen.len(), cell.len())?;
    let agreed = py.detach(|| reference::agreement(seen, left, cell, cells));
    agreed.map(|agreed| agreed.into_pyarray(py)).ok_or_else(|| PyValueError::new_err("cell: beyond the last one"))
}

/// See [`reference::least`].
#[pyfunction]
fn least_rank_moves<'py>(
    py: Python<'py>,
    products: PyReadonlyArray2<'py, f64>,
    moves: PyReadonlyArray2<'py, f64>,
    rounds: usize,
    trust: f64,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (products, moves) = (grid(&products), pairs("moves", &moves)?);
    let count = moves.len();
    let found = py.detach(|| reference::least(&products, &moves, rounds, trust));
    let found = found.ok_or_else(|| PyValueError::new_err("products: not of these moves, or singular"))?;
    found.into_flattened().into_pyarray(py).reshape([count, 2])
}

/// See [`Fix`].
#[pyclass(module = "midspan._core", name = "Fix", frozen)]
struct PyFix(Fix);

#[pymethods]
impl PyFix {
    #[new]
    fn new(x_px: f64, y_px: f64, variance_x_px2: f64, variance_y_px2: f64, quality: f64) -> Self {
        Self(Fix { x: x_px, y: y_px, variance: [variance_x_px2, variance_y_px2], quality })
    }

    #[getter]
    fn x_px(&self) -> f64 {
        self.0.x
    }

    #[getter]
    fn y_px(&self) -> f64 {
        self.0.y
    }

    #[getter]
    fn variance_x_px2(&self) -> f64 {
        self.0.variance[0]
    }

    #[getter]
    fn variance_y_px2(&self) -> f64 {
        self.0.variance[1]
    }

    #[getter]
    fn quality(&self) -> f64 {
        self.0.quality
    }
}

/// See [`Template`].
#[pyclass(module = "midspan._core", name = "Template", frozen)]
pub struct PyTemplate(pub Arc<Template>);

#[pymethods]
impl PyTemplate {
    /// `window`: x, y, width, height; `gains`: what white noise of variance 1 in the raw image gives a filtered pixel,
    /// its gradients and these once more filtered.
    #[new]
    #[pyo3(signature = (*, window, taps, grid, basis, information, gains, threshold))]
    fn new(
        window: (i64, i64, usize, usize),
        taps: PyReadonlyArray1<'_, f32>,
        grid: PyReadonlyArray2<'_, f32>,
        basis: PyReadonlyArray3<'_, f32>,
        information: PyReadonlyArray3<'_, f64>,
        gains: (f64, f64, f64),
        threshold: f64,
    ) -> PyResult<Self> {
        let (x, y, width, height) = window;
        let (window, grid) = (Window { x, y, width, height }, super::arrays::grid(&grid));
        let (planes, matrices) = (basis.as_array(), information.as_array());
        let fits = grid.rows == height + TAPS - 1 && grid.columns == width + TAPS - 1;
        if !fits || planes.dim() != (3, height, width) || matrices.dim() != (2, 2, 2) || width.min(height) < 1 {
            return Err(PyValueError::new_err("grid, basis, information: not of the window's size"));
        }
        let basis = [0, 1, 2].map(|k| {
            let values = planes.index_axis(numpy::ndarray::Axis(0), k).iter().copied().collect();
            Grid { values, rows: height, columns: width }
        });
        let information = [0, 1].map(|k| [0, 1].map(|i| [0, 1].map(|j| matrices[[k, i, j]])));
        let taps = elements("taps", &taps)?.to_vec();
        let precision = Precision::new(&basis, information, gains.0, [gains.1, gains.2]);
        Ok(Self(Arc::new(Template::new(window, taps, grid, basis, precision, threshold))))
    }

    /// See [`Template::near`].
    fn near(
        &self,
        py: Python<'_>,
        pixels: &Bound<'_, PyAny>,
        level: f64,
        place: [i64; 2],
        radius: [i64; 2],
    ) -> PyResult<Option<PyFix>> {
        let image = Pixels::of(pixels)?;
        let template = &self.0;
        let fix = with_image!(image, pixels => py.detach(|| template.near(pixels, level, place, radius)));
        Ok(fix.map(PyFix))
    }

    /// See [`Template::peak_at`].
    fn peak_at(
        &self,
        py: Python<'_>,
        pixels: &Bound<'_, PyAny>,
        level: f64,
        place: [i64; 2],
    ) -> PyResult<Option<PyFix>> {
        let (image, template) = (Pixels::of(pixels)?, &self.0);
        let fix = with_image!(image, pixels => py.detach(|| template.peak_at(pixels, level, place)));
        Ok(fix.map(PyFix))
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyFix>()?;
    module.add_class::<PyTemplate>()?;
    module.add_function(wrap_pyfunction!(quintic, module)?)?;
    module.add_function(wrap_pyfunction!(spline_weights, module)?)?;
    module.add_function(wrap_pyfunction!(spline_coefficients, module)?)?;
    module.add_function(wrap_pyfunction!(combine, module)?)?;
    module.add_function(wrap_pyfunction!(translated, module)?)?;
    module.add_function(wrap_pyfunction!(fine_weights, module)?)?;
    module.add_function(wrap_pyfunction!(read_fine, module)?)?;
    module.add_function(wrap_pyfunction!(refined, module)?)?;
    module.add_function(wrap_pyfunction!(cropped, module)?)?;
    module.add_function(wrap_pyfunction!(window_energies, module)?)?;
    module.add_function(wrap_pyfunction!(zncc_map, module)?)?;
    module.add_function(wrap_pyfunction!(smooth, module)?)?;
    module.add_function(wrap_pyfunction!(shrink, module)?)?;
    module.add_function(wrap_pyfunction!(cell_agreement, module)?)?;
    module.add_function(wrap_pyfunction!(least_rank_moves, module)?)?;
    module.add_function(wrap_pyfunction!(pixel_values, module)?)
}
