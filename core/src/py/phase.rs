//! The phase trackers' measurement for Python.

use super::pixels::{Corners, Pixels, region, view, with_image};
use crate::track::image::{Image, Pixel, Region};
use crate::track::patch;
use crate::track::phase;
use crate::track::phase_axis::{ActivePixel, AxisModel, BLOCKS};
use crate::track::steerable::{self, Axis, MARGIN_PX, Responses, Taps};
use numpy::{Complex32, IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A residual above this moves the region once more: half a pixel, and some play.
const MAX_RESIDUAL_PX: f64 = 0.6;
/// The region is moved so often.
const MOVES: usize = 4;

/// Nine taps of the even and odd filter, and of the Gaussian across.
#[derive(FromPyObject)]
struct AllTaps([f64; steerable::TAPS], [f64; steerable::TAPS], [f64; steerable::TAPS]);

impl AllTaps {
    fn halves(&self) -> Taps {
        let half = |taps: &[f64; steerable::TAPS]| std::array::from_fn(|k| taps[MARGIN_PX + k] as f32);
        Taps { even: half(&self.0), odd: half(&self.1), across: half(&self.2) }
    }
}

/// Two arrays of Python.
type Pair<'py, A> = (Bound<'py, A>, Bound<'py, A>);

/// See [`steerable::responses`]; `down`: along y instead of x.
#[pyfunction]
fn steerable_responses<'py>(
    py: Python<'py>,
    patch: PyReadonlyArray2<'py, f32>,
    down: bool,
    taps: AllTaps,
) -> PyResult<Pair<'py, PyArray2<f32>>> {
    let mut store = Vec::new();
    let patch = view(&patch, &mut store);
    let sides = [patch.rows, patch.columns].map(|side| side.checked_sub(2 * MARGIN_PX).filter(|&side| side > 0));
    let [Some(rows), Some(columns)] = sides else {
        return Err(PyValueError::new_err("patch: more than 8 px of rows and columns are needed"));
    };
    let found = steerable::responses(&patch, if down { Axis::Y } else { Axis::X }, &taps.halves());
    let shape = [rows, columns];
    Ok((found.even.into_pyarray(py).reshape(shape)?, found.odd.into_pyarray(py).reshape(shape)?))
}

/// The active pixels of one axis as Python keeps them.
#[derive(FromPyObject)]
struct PhaseAxis<'py> {
    index: PyReadonlyArray1<'py, i64>,
    reference: PyReadonlyArray1<'py, Complex32>,
    weight: PyReadonlyArray1<'py, f64>,
    slope: PyReadonlyArray2<'py, f64>,
    curve: PyReadonlyArray2<'py, f64>,
    unit: PyReadonlyArray1<'py, f64>,
    block: PyReadonlyArray1<'py, i64>,
    sensitivity: f64,
    gain_error: f64,
}

impl PhaseAxis<'_> {
    fn model(&self, pixels: usize) -> PyResult<AxisModel> {
        let (index, block) = (self.index.as_array(), self.block.as_array());
        let (reference, weight, unit) = (self.reference.as_array(), self.weight.as_array(), self.unit.as_array());
        let (slope, curve) = (self.slope.as_array(), self.curve.as_array());
        let count = index.len();
        let lengths = [reference.len(), weight.len(), unit.len(), block.len(), slope.nrows(), curve.nrows()];
        if lengths != [count; 6] || slope.ncols() != 2 || curve.ncols() != 3 {
            return Err(PyValueError::new_err(
                "axes: arrays of one length, slopes (n, 2) and curves (n, 3) are needed",
            ));
        }
        let inside = |value: i64, limit: usize| usize::try_from(value).ok().filter(|&value| value < limit);
        let active: Option<Vec<ActivePixel>> = (0..count)
            .map(|k| {
                Some(ActivePixel {
                    index: inside(index[k], pixels)?,
                    reference: [reference[k].re, reference[k].im],
                    weight: weight[k],
                    slope: [slope[[k, 0]], slope[[k, 1]]],
                    curve: [curve[[k, 0]], curve[[k, 1]], curve[[k, 2]]],
                    unit: unit[k],
                    block: inside(block[k], BLOCKS)?,
                })
            })
            .collect();
        let active = active.ok_or_else(|| PyValueError::new_err("axes: an index or a block out of range"))?;
        Ok(AxisModel::new(active, self.sensitivity, self.gain_error))
    }
}

/// What the phase trackers compare a frame with; see [`phase`].
#[pyclass(module = "midspan._core", frozen)]
struct PhaseTarget {
    region: Region,
    /// Level that is taken off the pixels.
    offset: f64,
    taps: Taps,
    axes: [AxisModel; 2],
    ratios: Option<[f64; 2]>,
}

/// Whole-pixel place x, y; translation beyond it x, y; variances x, y; coherence.
type Found = (i64, i64, f64, f64, f64, f64, f64);

impl PhaseTarget {
    fn responses<T: Pixel>(&self, image: &Image<'_, T>, x: i64, y: i64) -> Option<[Responses; 2]> {
        let part = image.cut(self.region.moved(x, y, MARGIN_PX))?;
        let values = patch::values(&part, self.offset)?;
        Some([Axis::X, Axis::Y].map(|axis| steerable::responses(&Image::from(&values), axis, &self.taps)))
    }

    /// About a whole-pixel place that is moved once more while the residual is large: the gain holds for small ones
    /// only.
    fn near<T: Pixel>(&self, image: &Image<'_, T>, mut x: i64, mut y: i64) -> Option<Found> {
        let axes = [&self.axes[0], &self.axes[1]];
        for _ in 0..MOVES {
            let [of_x, of_y] = self.responses(image, x, y)?;
            let fix = match self.ratios {
                None => phase::measure(axes, [&of_x, &of_y]),
                Some(ratios) => phase::measure_printed(axes, ratios, [&of_x, &of_y]),
            }?;
            let ([right, down], [variance_x, variance_y]) = (fix.shift, fix.variance);
            if !(right + down).is_finite() {
                return None;
            }
            if self.ratios.is_some() || right.abs().max(down.abs()) <= MAX_RESIDUAL_PX {
                return Some((x, y, right, down, variance_x, variance_y, fix.coherence));
            }
            let [right, down] = [right, down].map(|value| value.round_ties_even() as i64);
            (x, y) = (x.saturating_add(right), y.saturating_add(down));
        }
        None
    }
}

#[pymethods]
impl PhaseTarget {
    /// `place`: of the region in the reference frame; `axes`: the model's; `ratios`: translation by mean phase along
    /// each axis alone, as printed, or None: both axes together.
    #[new]
    fn new(
        place: Corners,
        offset: f64,
        taps: AllTaps,
        axes: (PhaseAxis<'_>, PhaseAxis<'_>),
        ratios: Option<[f64; 2]>,
    ) -> PyResult<Self> {
        let region = region("place", place)?;
        let pixels = region.width.saturating_mul(region.height);
        let axes = [axes.0.model(pixels)?, axes.1.model(pixels)?];
        Ok(Self { region, offset, taps: taps.halves(), axes, ratios })
    }

    /// The translation about a whole-pixel place; None outside the image, without values or where it cannot be
    /// determined.
    fn near_to(&self, pixels: &Bound<'_, PyAny>, x: i64, y: i64) -> PyResult<Option<Found>> {
        Ok(with_image!(Pixels::of(pixels)?, image => self.near(image, x, y)))
    }

    /// Phases of the active pixels (rows · columns,) along x and y about a whole-pixel place, 0 elsewhere; None as
    /// above.
    fn changes<'py>(
        &self,
        py: Python<'py>,
        pixels: &Bound<'py, PyAny>,
        x: i64,
        y: i64,
    ) -> PyResult<Option<Pair<'py, PyArray1<f32>>>> {
        let responses = with_image!(Pixels::of(pixels)?, image => self.responses(image, x, y));
        Ok(responses.map(|responses| {
            let [of_x, of_y] = [0, 1].map(|k: usize| {
                let mut all = vec![0.0; self.region.width * self.region.height];
                self.axes[k].changes(&responses[k]).for_each(|(index, change)| all[index] = change);
                all.into_pyarray(py)
            });
            (of_x, of_y)
        }))
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PhaseTarget>()?;
    module.add_function(wrap_pyfunction!(steerable_responses, module)?)
}
