//! `scene` for Python.

use super::elements;
use crate::scene::paint::{self, Rectangle};
use crate::scene::render::{Derivative, Moment, SAMPLES, Scene};
use crate::scene::{beam, beam::Recurrence};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// See [`Scene::render`]; `coefficients` (samples down, 8, columns), `x_px`, `y_px` (1 or rows, moments), `shape`: rows
/// and columns, `order`: of the derivative along x and y, 0 or 1.
#[pyfunction]
fn render_scene<'py>(
    py: Python<'py>,
    coefficients: PyReadonlyArray3<'py, f32>,
    shape: (usize, usize),
    margin: usize,
    x_px: PyReadonlyArray2<'py, f64>,
    y_px: PyReadonlyArray2<'py, f64>,
    order: (u8, u8),
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let (array, x, y) = (coefficients.as_array(), x_px.as_array(), y_px.as_array());
    let (samples, phases, wide) = array.dim();
    let values = array.as_slice().filter(|_| phases == SAMPLES && margin < 1 << 20);
    let values = values.ok_or_else(|| PyValueError::new_err("coefficients: (samples, 8, columns), contiguous"))?;
    if x.dim() != y.dim() {
        return Err(PyValueError::new_err("x_px, y_px: not of one shape"));
    }
    let moments: Vec<Vec<Moment>> = x
        .rows()
        .into_iter()
        .zip(y.rows())
        .map(|(x, y)| x.iter().zip(y).map(|(&x, &y)| Moment { x, y }).collect())
        .collect();
    let moments: Vec<&[Moment]> = moments.iter().map(Vec::as_slice).collect();
    let scene = Scene { coefficients: values, samples, wide, margin };
    let derivative = Derivative { across: order.0 == 1, down: order.1 == 1 };
    let picture = py.detach(|| scene.render(shape.0, shape.1, &moments, derivative));
    let picture = picture.ok_or_else(|| PyValueError::new_err("x_px, y_px: beyond the scene's margin"))?;
    picture.into_pyarray(py).reshape([shape.0, shape.1])
}

/// See [`Scene::at_points`]: (n,); `down_px`, `across_px` (n,).
#[pyfunction]
fn warp_scene<'py>(
    py: Python<'py>,
    coefficients: PyReadonlyArray3<'py, f32>,
    margin: usize,
    down_px: PyReadonlyArray1<'py, f64>,
    across_px: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let (array, down, across) =
        (coefficients.as_array(), elements("down_px", &down_px)?, elements("across_px", &across_px)?);
    super::same_length("down_px, across_px", down.len(), across.len())?;
    let (samples, phases, wide) = array.dim();
    let values = array.as_slice().filter(|_| phases == SAMPLES && margin < 1 << 20);
    let values = values.ok_or_else(|| PyValueError::new_err("coefficients: (samples, 8, columns), contiguous"))?;
    let scene = Scene { coefficients: values, samples, wide, margin };
    let found = py.detach(|| scene.at_points(down, across));
    Ok(found.ok_or_else(|| PyValueError::new_err("points: beyond the scene's margin"))?.into_pyarray(py))
}

/// See [`paint::paint`]; `boxes` (n, 4): top, left, height, width; `tones` (n,).
#[pyfunction]
fn paint_boxes<'py>(
    py: Python<'py>,
    shape: (usize, usize),
    level: f64,
    boxes: PyReadonlyArray2<'py, i64>,
    tones: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (boxes, tones) = (boxes.as_array(), elements("tones", &tones)?);
    super::same_length("boxes, tones", boxes.nrows(), tones.len())?;
    if boxes.ncols() != 4 || boxes.iter().any(|&value| value < 0) {
        return Err(PyValueError::new_err("boxes: four numbers of at least 0 each"));
    }
    let rectangles = boxes.rows().into_iter().zip(tones).map(|(one, &tone)| {
        let [top, left, height, width] = [0, 1, 2, 3].map(|k| one[k] as usize);
        Rectangle { top, left, height, width, tone }
    });
    paint::paint(shape.0, shape.1, level, rectangles).into_pyarray(py).reshape([shape.0, shape.1])
}

/// See [`beam::respond`]: (n, 2).
#[pyfunction]
fn modal_response<'py>(
    py: Python<'py>,
    force: PyReadonlyArray1<'py, f64>,
    transition: [[f64; 2]; 2],
    load_now: [f64; 2],
    load_next: [f64; 2],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let force = elements("force", &force)?;
    let recurrence = Recurrence { transition, load_now, load_next };
    let states = py.detach(|| beam::respond(force, &recurrence));
    let count = states.len();
    states.into_flattened().into_pyarray(py).reshape([count, 2])
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(render_scene, module)?)?;
    module.add_function(wrap_pyfunction!(warp_scene, module)?)?;
    module.add_function(wrap_pyfunction!(paint_boxes, module)?)?;
    module.add_function(wrap_pyfunction!(modal_response, module)?)
}
