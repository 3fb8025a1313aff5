//! The registration tracker for Python.

use super::arrays::{array, grid};
use super::chain::{PyRow, py_row};
use super::elements;
use super::pixels::{Pixels, with_image};
use super::track::PyTemplate;
use crate::track::bank::Plane;
use crate::track::chain::Row;
use crate::track::correlation::smooth;
use crate::track::fine_spline::{BEYOND, PER_PX};
use crate::track::grid::Grid;
use crate::track::image::{Image, Pixel};
use crate::track::learning::{self, PAD_PX, Sample, Samples};
use crate::track::motion::{Motion, Prediction};
use crate::track::normal::Normal;
use crate::track::registration::{Registration, Settings};
use crate::track::tracker::{Fix, Given, Look, Memory, Tracker};
use crate::track::watch::Translation;
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

impl From<Fix> for PyPose {
    fn from(fix: Fix) -> Self {
        Self::new(fix.value, fix.variance, fix.share, fix.noise)
    }
}

impl PyPose {
    fn fix(&self) -> Fix {
        Fix {
            value: [self.x_px, self.y_px, self.roll_rad, self.zoom],
            variance: [self.variance_x_px2, self.variance_y_px2, self.variance_roll_rad2, self.variance_zoom],
            share: self.share,
            noise: self.noise,
        }
    }
}

/// A Python `Prediction`.
#[derive(FromPyObject)]
pub struct PyPrediction {
    x_px: f64,
    y_px: f64,
    std_x_px: f64,
    std_y_px: f64,
}

impl From<PyPrediction> for Prediction {
    fn from(one: PyPrediction) -> Self {
        Self { place: [one.x_px, one.y_px], std: [one.std_x_px, one.std_y_px] }
    }
}

/// Last translation (px), its stamp (ns), speed (px/s), frames lost since, whether for confusion; roll (rad), zoom, the
/// usual noise and how many frames it rests on.
type Memories = (f64, f64, Option<i64>, f64, f64, u64, bool, f64, f64, f64, u64);

/// See [`Tracker`].
#[pyclass(module = "midspan._core", name = "Registration")]
pub struct PyRegistration {
    /// The tracker.
    pub own: Tracker,
    /// What the last look that was not enough found.
    pub candidate: Option<Fix>,
}

impl PyRegistration {
    /// ValueError for a frame of another size than the reference's.
    pub fn check_size<T: Pixel>(&self, image: &Image<'_, T>) -> PyResult<()> {
        let fits = [image.rows, image.columns] == self.own.given().shape;
        if fits { Ok(()) } else { Err(PyValueError::new_err("pixels: not of the reference's size")) }
    }

    /// See [`Tracker::track`]; None where the target must be searched for. ValueError for a frame of another size.
    fn tracked<T: Pixel>(
        &mut self,
        py: Python<'_>,
        image: &Image<'_, T>,
        time_ns: i64,
        prediction: Option<Prediction>,
    ) -> PyResult<Option<Translation>> {
        self.check_size(image)?;
        let own = &mut self.own;
        let look = py.detach(|| own.track(*image, time_ns, prediction));
        let (found, candidate) = match look {
            Look::Known(found) => (Some(found), None),
            Look::Search(candidate) => (None, candidate),
        };
        self.candidate = candidate;
        Ok(found)
    }
}

#[pymethods]
impl PyRegistration {
    /// `grid`: fine spline coefficients around the window, which begins at the pixel `origin` (row, column) of them;
    /// `taps`: of the low-pass on these; `weight` (h, w): one over the noise variance, about 1; `gradient_noise`: what
    /// noise adds to the mean square of the low-passed gradient; `level`: subtracted from frames of `shape`;
    /// `difference_noise`: of a frame less the template.
    #[new]
    #[pyo3(signature = (
        template, *, grid, origin, weight, taps, gradient_noise, difference_noise, min_share, reference_noise, floor_px2,
        level, shape, kernel_bytes
    ))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        template: &PyTemplate,
        grid: PyReadonlyArray2<'_, f32>,
        origin: (usize, usize),
        weight: PyReadonlyArray2<'_, f32>,
        taps: PyReadonlyArray1<'_, f32>,
        gradient_noise: f64,
        difference_noise: f64,
        min_share: f64,
        reference_noise: f64,
        floor_px2: f64,
        level: f64,
        shape: [usize; 2],
        kernel_bytes: usize,
    ) -> PyResult<Self> {
        let (grid, weight, taps) = (super::arrays::grid(&grid), super::arrays::grid(&weight), elements("taps", &taps)?);
        let (whole, window) = (template.0.clone(), template.0.window);
        if taps.len() % 2 == 0 || grid.rows.min(grid.columns) < 2 || window.width.min(window.height) < MIN_SIDE_PX {
            return Err(PyValueError::new_err("taps, grid, template: an odd number, two rows and 8 px are needed"));
        }
        let settings = Settings { min_share, reference_noise, kernel_bytes };
        let far_px = 0.5 * (window.width as f64).hypot(window.height as f64);
        let given = Given { shape, level, reference_noise, difference_noise, floor_px2, far_px };
        py.detach(|| {
            let low = smooth(&grid.mirrored(taps.len() / 2), taps);
            let plane = Plane::new([&grid, &low], origin, weight, gradient_noise, window)?;
            Some(Tracker::new(Registration::new(plane, whole, settings), given))
        })
        .map(|own| Self { own, candidate: None })
        .ok_or_else(|| PyValueError::new_err("grid, weight: not of the window's size"))
    }

    /// See [`Registration::count_from`].
    fn count_from(&mut self, zero: [f64; 4], covariance: [[f64; 4]; 4]) {
        self.own.registration.count_from(zero, covariance);
    }

    /// See [`Registration::covariance`].
    fn covariance(&mut self, of_window: bool) -> [[f64; 2]; 2] {
        self.own.registration.covariance(of_window)
    }

    /// See [`Registration::most_kernel_bytes`].
    #[getter]
    fn most_kernel_bytes(&self) -> usize {
        self.own.registration.most_kernel_bytes()
    }

    /// See [`Tracker::track`]; a row as of a target's chain, None where the target must be searched for.
    #[pyo3(signature = (pixels, time_ns, prediction=None))]
    fn track(
        &mut self,
        py: Python<'_>,
        pixels: &Bound<'_, PyAny>,
        time_ns: i64,
        prediction: Option<PyPrediction>,
    ) -> PyResult<Option<PyRow>> {
        let prediction = prediction.map(Prediction::from);
        let found = with_image!(Pixels::of(pixels)?, image => self.tracked(py, image, time_ns, prediction)?);
        Ok(found.map(|translation| py_row(&Row { time_ns, translation, unseen: None })))
    }

    /// What the last frame that must be searched shows at the expected place; None: nothing.
    #[getter]
    fn candidate(&self) -> Option<PyPose> {
        self.candidate.map(PyPose::from)
    }

    /// See [`Tracker::look`].
    fn look(&mut self, py: Python<'_>, pixels: &Bound<'_, PyAny>, place: [f64; 2]) -> PyResult<Option<PyPose>> {
        let (image, own) = (Pixels::of(pixels)?, &mut self.own);
        let fix = with_image!(image, pixels => py.detach(|| own.look(*pixels, place)));
        Ok(fix.map(PyPose::from))
    }

    /// See [`Tracker::is_trusted`].
    fn is_trusted(&self, pose: &PyPose) -> bool {
        self.own.is_trusted(&pose.fix())
    }

    /// See [`Tracker::suspicious_noise`].
    #[getter]
    fn suspicious_noise(&self) -> f64 {
        self.own.suspicious_noise()
    }

    /// See [`Tracker::accept`].
    fn accept(&mut self, time_ns: i64, pose: &PyPose) -> PyRow {
        let translation = self.own.accept(time_ns, &pose.fix());
        py_row(&Row { time_ns, translation, unseen: None })
    }

    /// See [`Tracker::miss`].
    fn miss(&mut self, confused: bool) {
        self.own.miss(confused);
    }

    /// See [`Tracker::learnable`].
    #[getter]
    fn learnable(&self) -> bool {
        self.own.learnable
    }

    /// Everything that changes from frame to frame.
    #[getter]
    fn state(&self) -> Memories {
        let Memory { motion, roll_rad, zoom, usual_noise, judged_frames } = self.own.memory;
        let Motion { place: [x, y], time_ns, speed: [right, down], lost_frames, confused } = motion;
        (x, y, time_ns, right, down, lost_frames, confused, roll_rad, zoom, usual_noise, judged_frames)
    }

    /// Continues from a `state`.
    fn restore(&mut self, state: Memories) {
        let (x, y, time_ns, right, down, lost_frames, confused, roll_rad, zoom, usual_noise, judged_frames) = state;
        let motion = Motion { place: [x, y], time_ns, speed: [right, down], lost_frames, confused };
        self.own.memory = Memory { motion, roll_rad, zoom, usual_noise, judged_frames };
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
        let (picture, registration) = (grid(&picture), &mut self.own.registration);
        let pose = py.detach(|| registration.pose_in(&picture, origin, &begin, of_window));
        pose.map(|pose| PyPose::from(Fix::from(pose)))
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
    fn normal(&self, py: Python<'_>, penalty: f64) -> PyNormal {
        let (rows, columns) = self.shape();
        PyNormal(py.detach(|| self.0.normal(rows, columns, penalty)))
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

/// See [`Normal`].
#[pyclass(frozen, module = "midspan._core", name = "NormalEquations")]
struct PyNormal(Normal);

#[pymethods]
impl PyNormal {
    /// See [`Normal::times`].
    fn times<'py>(
        &self,
        py: Python<'py>,
        coefficients: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let coefficients = grid(&coefficients);
        let found = py.detach(|| self.0.times(&coefficients));
        array(py, found.ok_or_else(|| PyValueError::new_err("coefficients: not of the samples' size"))?)
    }
}

/// See [`learning::alike`].
#[pyfunction]
fn alike<'py>(
    py: Python<'py>,
    pixels: PyReadonlyArray2<'py, f32>,
    like: PyReadonlyArray2<'py, f32>,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    array(py, learning::alike(&grid(&pixels), &grid(&like)))
}

/// See [`learning::roughness`].
#[pyfunction]
fn roughness(coefficients: PyReadonlyArray2<'_, f32>) -> f64 {
    learning::roughness(&grid(&coefficients))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyPose>()?;
    module.add_class::<PyLearningSamples>()?;
    module.add_class::<PyNormal>()?;
    module.add_function(wrap_pyfunction!(alike, module)?)?;
    module.add_function(wrap_pyfunction!(roughness, module)?)?;
    module.add_class::<PyRegistration>()
}
