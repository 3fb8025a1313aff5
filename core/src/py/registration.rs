//! `track::registration` for Python.

use super::arrays::{Image, array, grid, with_pixels};
use super::elements;
use super::track::PyTemplate;
use crate::track::bank::Plane;
use crate::track::climb::Pose;
use crate::track::correlation::smooth;
use crate::track::fine_spline::{BEYOND, PER_PX};
use crate::track::grid::Grid;
use crate::track::learning::{self, PAD_PX, Sample, Samples};
use crate::track::registration::{Registration, Settings};
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Smaller windows cannot be divided into blocks.
const MIN_SIDE_PX: usize = 8;

/// See [`Pose`].
#[pyclass(module = "midspan._core", name = "Pose", frozen, get_all)]
struct PyPose {
    x_px: f64,
    y_px: f64,
    roll_rad: f64,
    zoom: f64,
    variance_x_px2: f64,
    variance_y_px2: f64,
    variance_roll_rad2: f64,
    variance_zoom: f64,
    share: f64,
    noise: f64,
}

#[pymethods]
impl PyPose {
    /// `value`: x, y, roll, zoom; `variance`: theirs.
    #[new]
    fn new(value: [f64; 4], variance: [f64; 4], share: f64, noise: f64) -> Self {
        let [x_px, y_px, roll_rad, zoom] = value;
        let [variance_x_px2, variance_y_px2, variance_roll_rad2, variance_zoom] = variance;
        Self {
            x_px,
            y_px,
            roll_rad,
            zoom,
            variance_x_px2,
            variance_y_px2,
            variance_roll_rad2,
            variance_zoom,
            share,
            noise,
        }
    }
}

impl From<Pose> for PyPose {
    fn from(pose: Pose) -> Self {
        Self::new(pose.value, std::array::from_fn(|k| pose.covariance[k][k]), pose.share, pose.noise)
    }
}

/// See [`Registration`].
#[pyclass(module = "midspan._core", name = "Registration")]
struct PyRegistration(Registration);

#[pymethods]
impl PyRegistration {
    /// `grid`: fine spline coefficients around the window, which begins at the pixel `origin` (row, column) of them; `taps`:
    /// of the low-pass on these; `weight` (h, w): one over the noise variance, about 1; `gradient_noise`: what noise adds to
    /// the mean square of the low-passed gradient.
    #[new]
    #[pyo3(signature = (template, *, grid, origin, weight, taps, gradient_noise, min_share, reference_noise, kernel_bytes))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        template: &PyTemplate,
        grid: PyReadonlyArray2<'_, f32>,
        origin: (usize, usize),
        weight: PyReadonlyArray2<'_, f32>,
        taps: PyReadonlyArray1<'_, f32>,
        gradient_noise: f64,
        min_share: f64,
        reference_noise: f64,
        kernel_bytes: usize,
    ) -> PyResult<Self> {
        let (grid, weight, taps) = (super::arrays::grid(&grid), super::arrays::grid(&weight), elements("taps", &taps)?);
        let (whole, window) = (template.0.clone(), template.0.window);
        if taps.len() % 2 == 0 || grid.rows.min(grid.columns) < 2 || window.width.min(window.height) < MIN_SIDE_PX {
            return Err(PyValueError::new_err("taps, grid, template: an odd number, two rows and 8 px are needed"));
        }
        let settings = Settings { min_share, reference_noise, kernel_bytes };
        py.detach(|| {
            let low = smooth(&grid.mirrored(taps.len() / 2), taps);
            let plane = Plane::new([&grid, &low], origin, weight, gradient_noise, window)?;
            Some(Self(Registration::new(plane, whole, settings)))
        })
        .ok_or_else(|| PyValueError::new_err("grid, weight: not of the window's size"))
    }

    /// See [`Registration::count_from`].
    fn count_from(&mut self, zero: [f64; 4], covariance: [[f64; 4]; 4]) {
        self.0.count_from(zero, covariance);
    }

    /// See [`Registration::covariance`].
    fn covariance(&mut self, of_window: bool) -> [[f64; 2]; 2] {
        self.0.covariance(of_window)
    }

    /// See [`Registration::most_kernel_bytes`].
    #[getter]
    fn most_kernel_bytes(&self) -> usize {
        self.0.most_kernel_bytes()
    }

    /// See [`Registration::all_finite`].
    fn all_finite(&self, pixels: &Bound<'_, PyAny>, x_px: f64, y_px: f64) -> PyResult<bool> {
        let image = Image::new(pixels)?;
        Ok(with_pixels!(&image, pixels => self.0.all_finite(&pixels, &[x_px, y_px, 0.0, 0.0])))
    }

    /// See [`Registration::look`]; `begin`: x, y, roll, zoom; `usual`: 0 where it is not known.
    fn look(
        &mut self,
        py: Python<'_>,
        pixels: &Bound<'_, PyAny>,
        level: f64,
        begin: [f64; 4],
        usual: f64,
    ) -> PyResult<Option<PyPose>> {
        let image = Image::new(pixels)?;
        let (registration, usual) = (&mut self.0, (usual > 0.0).then_some(usual));
        let pose = with_pixels!(&image, pixels => py.detach(|| registration.look(pixels, level, &begin, usual)));
        Ok(pose.map(PyPose::from))
    }

    /// See [`Registration::pose_in`].
    fn pose_in(
        &mut self,
        py: Python<'_>,
        picture: PyReadonlyArray2<'_, f32>,
        origin: [i64; 2],
        begin: [f64; 4],
        of_window: bool,
    ) -> Option<PyPose> {
        let (picture, registration) = (grid(&picture), &mut self.0);
        py.detach(|| registration.pose_in(&picture, origin, &begin, of_window)).map(PyPose::from)
    }
}

/// See [`Samples`].
#[pyclass(module = "midspan._core", name = "LearningSamples")]
struct PyLearningSamples(Samples);

#[pymethods]
impl PyLearningSamples {
    /// Samples (pixels, shift x and y, number of frames) of one size.
    #[new]
    fn new(items: Vec<(PyReadonlyArray2<'_, f32>, [f64; 2], f64)>) -> PyResult<Self> {
        let items =
            items.iter().map(|(pixels, shift, count)| Sample { pixels: grid(pixels), shift: *shift, count: *count });
        let items: Vec<Sample> = items.collect();
        let size = |item: &Sample| (item.pixels.rows, item.pixels.columns);
        let fits =
            |item: &Sample| size(item) == size(&items[0]) && item.pixels.rows.min(item.pixels.columns) > 2 * PAD_PX;
        if items.is_empty() || !items.iter().all(fits) {
            return Err(PyValueError::new_err("items: pictures of one size, wider than their padding, are needed"));
        }
        Ok(Self(Samples { items }))
    }

    /// See [`Samples::spread`].
    fn spread<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (rows, columns) = self.shape();
        array(py, py.detach(|| self.0.spread(rows, columns)))
    }

    /// See [`Samples::normal`].
    fn normal<'py>(
        &self,
        py: Python<'py>,
        coefficients: PyReadonlyArray2<'py, f32>,
        penalty: f64,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let coefficients = self.fitting(&coefficients)?;
        array(py, py.detach(|| self.0.normal(&coefficients, penalty)))
    }

    /// See [`Samples::residual_square`].
    fn residual_square<'py>(
        &self,
        py: Python<'py>,
        coefficients: PyReadonlyArray2<'py, f32>,
        most: usize,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let coefficients = self.fitting(&coefficients)?;
        array(py, py.detach(|| self.0.residual_square(&coefficients, most)))
    }

    /// See [`Samples::place`].
    fn place(&mut self, py: Python<'_>, coefficients: PyReadonlyArray2<'_, f32>) -> PyResult<()> {
        let coefficients = self.fitting(&coefficients)?;
        py.detach(|| self.0.place(&coefficients));
        Ok(())
    }

    /// Shifts x, y of the samples, px.
    #[getter]
    fn shifts(&self) -> Vec<[f64; 2]> {
        self.0.items.iter().map(|item| item.shift).collect()
    }
}

impl PyLearningSamples {
    /// Rows and columns of the coefficients.
    fn shape(&self) -> (usize, usize) {
        let pixels = &self.0.items[0].pixels;
        (PER_PX * pixels.rows + BEYOND, PER_PX * pixels.columns + BEYOND)
    }

    fn fitting(&self, coefficients: &PyReadonlyArray2<'_, f32>) -> PyResult<Grid> {
        let coefficients = grid(coefficients);
        if (coefficients.rows, coefficients.columns) == self.shape() {
            return Ok(coefficients);
        }
        Err(PyValueError::new_err("coefficients: not of the samples' size"))
    }
}

/// See [`learning::roughness`].
#[pyfunction]
fn roughness(coefficients: PyReadonlyArray2<'_, f32>) -> f64 {
    learning::roughness(&grid(&coefficients))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyPose>()?;
    module.add_class::<PyLearningSamples>()?;
    module.add_function(wrap_pyfunction!(roughness, module)?)?;
    module.add_class::<PyRegistration>()
}
