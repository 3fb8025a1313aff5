//! The lens models for Python.

use crate::track::lens::{Lens, Mapped, Model};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

/// See [`Lens`].
#[pyclass(module = "midspan._core", frozen)]
pub struct LensModel(pub Lens);

/// Places (n, 2), and derivatives (n, 4) of x by x and y and of y by x and y; NaN where there is none.
type Places<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

fn mapped<'py>(
    py: Python<'py>,
    places: &PyReadonlyArray2<'py, f64>,
    map: impl Fn([f64; 2]) -> Option<Mapped>,
) -> PyResult<Places<'py>> {
    let none = Mapped { place: [f64::NAN; 2], slope: [[f64::NAN; 2]; 2] };
    let found: Vec<Mapped> =
        super::pairs("places", places)?.into_iter().map(|place| map(place).unwrap_or(none)).collect();
    let places: Vec<f64> = found.iter().flat_map(|one| one.place).collect();
    let slopes: Vec<f64> = found.iter().flat_map(|one| one.slope).flatten().collect();
    Ok((places.into_pyarray(py).reshape([found.len(), 2])?, slopes.into_pyarray(py).reshape([found.len(), 4])?))
}

#[pymethods]
impl LensModel {
    /// `matrix`: fx, fy, cx, cy in px; `coefficients`: of a pinhole, of which a fisheye has the first four.
    #[new]
    fn new(matrix: [f64; 4], fisheye: bool, coefficients: [f64; 12], limit: f64) -> Self {
        let [fx, fy, cx, cy] = matrix;
        let [k1, k2, k3, k4, ..] = coefficients;
        let model = if fisheye { Model::Fisheye([k1, k2, k3, k4]) } else { Model::Pinhole(coefficients) };
        Self(Lens { focal: [fx, fy], centre: [cx, cy], model, limit })
    }

    /// See [`Lens::straight`].
    fn straight<'py>(&self, py: Python<'py>, places: PyReadonlyArray2<'py, f64>) -> PyResult<Places<'py>> {
        mapped(py, &places, |place| self.0.straight(place))
    }

    /// See [`Lens::shown`].
    fn shown<'py>(&self, py: Python<'py>, places: PyReadonlyArray2<'py, f64>) -> PyResult<Places<'py>> {
        mapped(py, &places, |place| self.0.shown(place))
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<LensModel>()
}
