//! `track`'s numbers of a picture for Python.

use super::pixels::{Corners, Pixels, cut, region, view, with_image};
use crate::track::{light, picture, picture_noise};
use numpy::PyReadonlyArray2;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

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
    module.add_function(wrap_pyfunction!(is_dark, module)?)?;
    module.add_function(wrap_pyfunction!(codec_traces, module)?)?;
    module.add_function(wrap_pyfunction!(picture_noise_of, module)?)
}
