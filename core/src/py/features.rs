//! Features and their matches for Python.

use super::pixels::{Corners, Pixels, cut, region, view, with_image};
use crate::track::doubled::{doubled, doubled_side};
use crate::track::image::{Image, Pixel};
use crate::track::matching::{self, Features};
use crate::track::patch;
use crate::track::surf::{self, Blob, SCALE_OF_SIZE};
use crate::track::surf_descriptor::{Descriptor, VALUES};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Enlargements to two samples a pixel: features of less than a filter's smallest size are found as well.
const SAMPLES: f64 = 2.0;

/// Settings of SURF as Python has them.
#[derive(FromPyObject)]
struct SurfSettings {
    octaves: u32,
    threshold: f64,
    most: usize,
    upright: bool,
    contrast: f64,
    least: f64,
}

impl SurfSettings {
    fn checked(&self) -> PyResult<surf::Settings> {
        if !(1..=8).contains(&self.octaves) || self.threshold.is_nan() || self.contrast.is_nan() || self.least.is_nan()
        {
            return Err(PyValueError::new_err("settings: 1 to 8 octaves and numbers are needed"));
        }
        let Self { octaves, threshold, most, upright, contrast, least } = *self;
        Ok(surf::Settings { octaves, threshold, most, upright, contrast, least })
    }
}

/// Positions (n, 2), descriptors (n, 64) and kinds (n,).
type Keypoints<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f32>>, Bound<'py, PyArray1<i8>>);

/// SURF's blobs of an image as they are: x, y, scale (px) and determinant (n, 4), and as of [`Keypoints`].
#[pyfunction]
fn surf_blobs<'py>(
    py: Python<'py>,
    image: PyReadonlyArray2<'py, f32>,
    settings: SurfSettings,
) -> PyResult<Keypoints<'py>> {
    let (mut store, settings) = (Vec::new(), settings.checked()?);
    let image = view(&image, &mut store);
    let found = py.detach(|| surf::detect(&image, &settings));
    let rows: Vec<[f64; 4]> =
        found.iter().map(|(blob, _)| [blob.x, blob.y, blob.size * SCALE_OF_SIZE, blob.strength]).collect();
    let (descriptors, kinds) = columns(&found);
    Ok((
        rows.into_flattened().into_pyarray(py).reshape([found.len(), 4])?,
        descriptors.into_pyarray(py).reshape([found.len(), VALUES])?,
        kinds.into_pyarray(py),
    ))
}

/// Descriptors one after the other, and 1 for a dark blob on bright ground, -1 for the reverse.
fn columns(found: &[(Blob, Descriptor)]) -> (Vec<f32>, Vec<i8>) {
    let descriptors = found.iter().flat_map(|(_, descriptor)| *descriptor).collect();
    (descriptors, found.iter().map(|(blob, _)| if blob.dark { 1 } else { -1 }).collect())
}

/// Blobs of a part of an image, less an offset and doubled, in px of the whole image; None of too few values.
fn blobs_of<T: Pixel>(
    image: &Image<'_, T>,
    place: Corners,
    offset: f64,
    settings: &surf::Settings,
) -> PyResult<Option<Vec<(Blob, Descriptor)>>> {
    let part = cut("place", image, region("place", place)?)?;
    let Some(values) = patch::values(&part, offset) else { return Ok(None) };
    let pixels = doubled(&Image::from(&values));
    let (rows, columns) = (doubled_side(part.rows), doubled_side(part.columns));
    let mut found = surf::detect(&Image::new(&pixels, rows, columns, columns).unwrap(), settings);
    for (blob, _) in &mut found {
        blob.x = blob.x / SAMPLES + place.0 as f64;
        blob.y = blob.y / SAMPLES + place.1 as f64;
    }
    Ok(Some(found))
}

/// SURF's features of a part of an image that is less an offset and doubled; none of a part with too few values.
#[pyfunction]
fn surf_features<'py>(
    py: Python<'py>,
    pixels: &Bound<'py, PyAny>,
    place: Corners,
    offset: f64,
    settings: SurfSettings,
) -> PyResult<Keypoints<'py>> {
    let settings = settings.checked()?;
    let found =
        with_image!(Pixels::of(pixels)?, image => blobs_of(image, place, offset, &settings))?.unwrap_or_default();
    let positions: Vec<[f64; 2]> = found.iter().map(|(blob, _)| [blob.x, blob.y]).collect();
    let (descriptors, kinds) = columns(&found);
    Ok((
        positions.into_flattened().into_pyarray(py).reshape([found.len(), 2])?,
        descriptors.into_pyarray(py).reshape([found.len(), VALUES])?,
        kinds.into_pyarray(py),
    ))
}

/// Positions and features of the columns of Python's keypoints.
fn features(
    xy: &PyReadonlyArray2<'_, f64>,
    descriptor: &PyReadonlyArray2<'_, f32>,
    kind: &PyReadonlyArray1<'_, i8>,
) -> PyResult<(Vec<[f64; 2]>, Features)> {
    let (positions, values) = (super::pairs("xy", xy)?, descriptor.as_array());
    let features = Features::new(values.iter().copied().collect(), values.ncols().max(1), kind.as_array().to_vec())
        .ok_or_else(|| PyValueError::new_err("descriptor, kind: rows as many as kinds are needed"))?;
    super::same_length("xy, kind", positions.len(), features.len())?;
    Ok((positions, features))
}

/// Matches of features of a reference with those of a frame.
#[pyclass(module = "midspan._core", frozen)]
struct FeatureMatcher {
    positions: Vec<[f64; 2]>,
    features: Features,
    /// Of the nearest to the second nearest; None: mutual matches.
    ratio: Option<f64>,
}

/// Positions (n, 2) of matched features in the reference and in a frame.
type Matched<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

impl FeatureMatcher {
    fn matches(&self, now: &Features) -> Vec<[usize; 2]> {
        match self.ratio {
            None => matching::mutual(&self.features, now),
            Some(ratio) => matching::by_ratio(&self.features, now, ratio),
        }
    }

    fn matched<'py>(&self, py: Python<'py>, now: &Features, positions: &[[f64; 2]]) -> PyResult<Matched<'py>> {
        let matches = self.matches(now);
        let array = |points: Vec<[f64; 2]>| {
            let count = points.len();
            points.into_flattened().into_pyarray(py).reshape([count, 2])
        };
        let then = matches.iter().map(|pair| self.positions[pair[0]]).collect();
        Ok((array(then)?, array(matches.iter().map(|pair| positions[pair[1]]).collect())?))
    }
}

#[pymethods]
impl FeatureMatcher {
    #[new]
    #[pyo3(signature = (xy, descriptor, kind, ratio=None))]
    fn new(
        xy: PyReadonlyArray2<'_, f64>,
        descriptor: PyReadonlyArray2<'_, f32>,
        kind: PyReadonlyArray1<'_, i8>,
        ratio: Option<f64>,
    ) -> PyResult<Self> {
        let (positions, features) = features(&xy, &descriptor, &kind)?;
        Ok(Self { positions, features, ratio })
    }

    /// Matches with given features.
    fn among<'py>(
        &self,
        py: Python<'py>,
        xy: PyReadonlyArray2<'py, f64>,
        descriptor: PyReadonlyArray2<'py, f32>,
        kind: PyReadonlyArray1<'py, i8>,
    ) -> PyResult<Matched<'py>> {
        let (positions, now) = features(&xy, &descriptor, &kind)?;
        self.matched(py, &now, &positions)
    }

    /// Matches with SURF's features of a part of an image that is less an offset and doubled.
    fn in_image<'py>(
        &self,
        py: Python<'py>,
        pixels: &Bound<'py, PyAny>,
        place: Corners,
        offset: f64,
        settings: SurfSettings,
    ) -> PyResult<Matched<'py>> {
        let settings = settings.checked()?;
        let found = with_image!(Pixels::of(pixels)?, image => blobs_of(image, place, offset, &settings))?;
        let found = found.unwrap_or_default();
        let (descriptors, kinds) = columns(&found);
        let positions: Vec<[f64; 2]> = found.iter().map(|(blob, _)| [blob.x, blob.y]).collect();
        // As many descriptors of `VALUES` values as kinds.
        let now = Features::new(descriptors, VALUES, kinds).unwrap();
        self.matched(py, &now, &positions)
    }
}

/// See [`doubled`].
#[pyfunction]
fn doubled_image<'py>(py: Python<'py>, image: PyReadonlyArray2<'py, f32>) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let mut store = Vec::new();
    let image = view(&image, &mut store);
    doubled(&image).into_pyarray(py).reshape([doubled_side(image.rows), doubled_side(image.columns)])
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<FeatureMatcher>()?;
    module.add_function(wrap_pyfunction!(doubled_image, module)?)?;
    module.add_function(wrap_pyfunction!(surf_blobs, module)?)?;
    module.add_function(wrap_pyfunction!(surf_features, module)?)
}
