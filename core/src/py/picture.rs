//! `track`'s numbers of a picture for Python.

use super::pixels::{Corners, Pixels, cut, region, view, with_image};
use crate::track::image::{Image, Pixel, Region};
use crate::track::{light, picture, picture_noise};
use numpy::{Element, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Rows that the detail of a frame is taken from, and its share at the ends of the scale: light that drives pixels there
/// covers more than one row.
const DETAIL_ROWS: usize = 32;
const ENDS_ROWS: usize = 64;

/// See [`light::is_dark`].
#[pyfunction]
fn is_dark(pixels: &Bound<'_, PyAny>, step: usize) -> PyResult<bool> {
    if step == 0 {
        return Err(PyValueError::new_err("step: at least 1 is needed"));
    }
    Ok(with_image!(Pixels::of(pixels)?, image => light::is_dark(image, step)))
}

/// See [`light::Reference`].
#[pyclass(module = "midspan._core", frozen)]
struct LightReference(light::Reference);

#[pymethods]
impl LightReference {
    #[new]
    fn new(pixels: &Bound<'_, PyAny>, place: Corners) -> PyResult<Self> {
        let region = region("place", place)?;
        Ok(Self(with_image!(Pixels::of(pixels)?, image => light::Reference::new(image, region))))
    }

    /// See [`light::Reference::unlike`].
    fn unlike(&self, pixels: &Bound<'_, PyAny>, x_px: f64, y_px: f64) -> PyResult<Option<f64>> {
        Ok(with_image!(Pixels::of(pixels)?, image => self.0.unlike(image, [x_px, y_px])))
    }
}

/// The pixels of a region, or None where they are bit for bit those of `before`.
#[pyfunction]
#[pyo3(signature = (pixels, place, before=None))]
fn changed<'py>(
    pixels: &Bound<'py, PyAny>,
    place: Corners,
    before: Option<&Bound<'py, PyAny>>,
) -> PyResult<Option<Bound<'py, PyAny>>> {
    let region = region("place", place)?;
    with_image!(Pixels::of(pixels)?, image => {
        let now = cut("place", image, region)?;
        let equal = before.and_then(|before| with_other(before, |before| picture::same(&now, before)));
        Ok(if equal == Some(true) { None } else { Some(copied(pixels.py(), &now)) })
    })
}

/// What a function makes of an array of the given type of pixel; None where it has another.
fn with_other<T: Pixel + Element, R>(other: &Bound<'_, PyAny>, work: impl FnOnce(&Image<'_, T>) -> R) -> Option<R> {
    let array = other.cast::<PyArray2<T>>().ok()?.try_readonly().ok()?;
    Some(work(&view(&array, &mut Vec::new())))
}

fn copied<'py, T: Pixel + Element>(py: Python<'py>, image: &Image<'_, T>) -> Bound<'py, PyAny> {
    // SAFETY: no other reference to the new array exists, and every element is written below before it is read.
    let array = unsafe { PyArray2::<T>::new(py, [image.rows, image.columns], false) };
    // SAFETY: as above; the array is contiguous in C order.
    let pixels = unsafe { array.as_slice_mut() };
    for (r, row) in pixels.into_iter().flat_map(|pixels| pixels.chunks_exact_mut(image.columns).enumerate()) {
        row.copy_from_slice(image.row(r));
    }
    array.into_any()
}

/// What the picture of a target is compared with from frame to frame.
#[pyclass(module = "midspan._core", frozen)]
struct TargetPicture {
    region: Region,
    detail: picture::Detail,
    ends: f64,
}

/// Detail along x and y over the reference's, share at the ends of the scale, share of the texture that stood still.
type Look = (f64, f64, f64, f64);

impl TargetPicture {
    fn numbers<T: Pixel>(target: &Image<'_, T>) -> (picture::Detail, f64) {
        let detail = picture::detail(target, (target.rows / DETAIL_ROWS).max(1));
        (detail, picture::share_at_ends(&target.thinned((target.rows / ENDS_ROWS).max(1))))
    }
}

#[pymethods]
impl TargetPicture {
    #[new]
    fn new(pixels: &Bound<'_, PyAny>, place: Corners) -> PyResult<Self> {
        let region = region("place", place)?;
        let (detail, ends) = with_image!(Pixels::of(pixels)?, image => Self::numbers(&cut("place", image, region)?));
        Ok(Self { region, detail, ends })
    }

    /// Share of the reference's pixels at the ends of the scale.
    #[getter]
    fn ends(&self) -> f64 {
        self.ends
    }

    /// Looks at the target whose first pixel is at `x`, `y`. `before`: the pixels of the frame before, and where its first
    /// one was; None: none are compared.
    #[pyo3(signature = (pixels, x, y, noise, before=None))]
    fn look<'py>(
        &self,
        pixels: &Bound<'py, PyAny>,
        x: i64,
        y: i64,
        noise: f64,
        before: Option<(Bound<'py, PyAny>, i64, i64)>,
    ) -> PyResult<Look> {
        with_image!(Pixels::of(pixels)?, image => {
            let (detail, ends) = Self::numbers(&cut("x, y", image, Region { x, y, ..self.region })?);
            let [along_x, along_y] = picture::sharpness(detail, self.detail, noise);
            let Some((before, left, top)) = before else { return Ok((along_x, along_y, ends, 0.0)) };
            let then = cut("before", image, Region { x: left, y: top, ..self.region })?;
            let texture = with_other(&before, |before| {
                picture::frozen_texture(&then, before, left as usize, top as usize)
            });
            let frozen = texture.filter(|texture| texture.whole > 0.0).map_or(0.0, |it| it.frozen / it.whole);
            Ok((along_x, along_y, ends, frozen))
        })
    }
}

/// Blockiness, share of flat blocks and share at the ends of the scale of a region.
#[pyfunction]
fn codec_traces(pixels: &Bound<'_, PyAny>, place: Corners) -> PyResult<(f64, f64, f64)> {
    let region = region("place", place)?;
    with_image!(Pixels::of(pixels)?, image => {
        let part = cut("place", image, region)?;
        let (left, top) = (region.x as usize, region.y as usize);
        let steps = picture::blockiness(&part, left, top);
        Ok((steps, picture::stair_share(&part, left, top), picture::share_at_ends(&part)))
    })
}

/// See [`picture_noise::noise`]: fine, broad.
#[pyfunction]
fn picture_noise_of(
    now: PyReadonlyArray2<'_, f32>,
    now_shift: [f64; 2],
    then: PyReadonlyArray2<'_, f32>,
    then_shift: [f64; 2],
) -> PyResult<(f64, f64)> {
    let (mut one, mut other) = (Vec::new(), Vec::new());
    let now = picture_noise::Square { pixels: view(&now, &mut one), shift: now_shift };
    let then = picture_noise::Square { pixels: view(&then, &mut other), shift: then_shift };
    let noise = picture_noise::noise(&now, &then);
    let noise = noise.ok_or_else(|| PyValueError::new_err("now, then: squares of one size, of 24 px or more"))?;
    Ok((noise.fine, noise.broad))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("CARDINAL_REACH_PX", crate::track::interpolate::REACH_PX)?;
    module.add_class::<LightReference>()?;
    module.add_class::<TargetPicture>()?;
    module.add_function(wrap_pyfunction!(is_dark, module)?)?;
    module.add_function(wrap_pyfunction!(changed, module)?)?;
    module.add_function(wrap_pyfunction!(codec_traces, module)?)?;
    module.add_function(wrap_pyfunction!(picture_noise_of, module)?)
}
