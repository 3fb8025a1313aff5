//! A target's chain for Python: one call takes a frame from its pixels to the target's row.

use super::estimator::state_error;
use super::lens::LensModel;
use super::pixels::{Corners, Pixels, in_place, region, with_image};
use super::registration::{PyPrediction, PyRegistration};
use crate::Status;
use crate::estimator::state::{StateError, from_bytes, to_bytes};
use crate::track::chain::{Chain, Row, Seen, Shutter};
use crate::track::codec::Compression;
use crate::track::counts::AxisCounts;
use crate::track::motion::Prediction;
use crate::track::watch::{Translation, Unseen, Watch, WatchMemory, Watched};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// Changes with every change of what a chain remembers.
const VERSION: u16 = 1;

/// Stamp (ns), x, y (px), variances (px²), quality, code of the status, zoom and its variance, strength, variances of the
/// reference (px²), and why nothing was looked for: 0 it was, 1 dark, 2 frozen.
pub type PyRow = (i64, f64, f64, f64, f64, f64, u8, [f64; 2], f64, f64, f64, u8);
/// Frames in which the target was seen, and known coarsely; mean variance (px²), mean (px) and square sum (px²).
type PyAxisCounts = (u64, u64, f64, f64, f64);
/// Frames; those blurred, sharper, saturated; largest share of saturated pixels; along x and y.
type PyCounts = (u64, u64, u64, u64, f64, PyAxisCounts, PyAxisCounts);

/// A row for Python.
pub fn py_row(row: &Row) -> PyRow {
    let Translation { status, place: [x, y], variance, reference_variance, quality, strength, zoom } = row.translation;
    let unseen = match row.unseen {
        None => 0,
        Some(Unseen::Dark) => 1,
        Some(Unseen::Frozen) => 2,
    };
    let [[own_x, own_y], [more_x, more_y]] = [variance, reference_variance];
    (row.time_ns, x, y, own_x, own_y, quality, status as u8, zoom, strength, more_x, more_y, unseen)
}

/// A Python `PixelTranslation`.
#[derive(FromPyObject)]
struct PyTranslation {
    x_px: f64,
    y_px: f64,
    variance_x_px2: f64,
    variance_y_px2: f64,
    quality: f64,
    status: u8,
    strength: f64,
    reference_variance_x_px2: f64,
    reference_variance_y_px2: f64,
    zoom: f64,
    variance_zoom: f64,
}

impl TryFrom<PyTranslation> for Translation {
    type Error = PyErr;

    fn try_from(one: PyTranslation) -> PyResult<Self> {
        let status = match one.status {
            0 => Status::Tracking,
            1 => Status::Coasting,
            2 => Status::Lost,
            _ => return Err(PyValueError::new_err("status: 0, 1 or 2 is needed")),
        };
        if status != Status::Lost && !(one.x_px.is_finite() && one.y_px.is_finite()) {
            return Err(PyValueError::new_err("x_px, y_px: not finite though the target is not lost"));
        }
        Ok(Self {
            status,
            place: [one.x_px, one.y_px],
            variance: [one.variance_x_px2, one.variance_y_px2],
            reference_variance: [one.reference_variance_x_px2, one.reference_variance_y_px2],
            quality: one.quality,
            strength: one.strength,
            zoom: [one.zoom, one.variance_zoom],
        })
    }
}

/// A Python `Frame`.
#[derive(FromPyObject)]
struct PyFrame<'py> {
    pixels: Bound<'py, PyAny>,
    time_ns: i64,
}

/// Of a row that is packed.
const PACKED_BYTES: usize = 90;

/// A row's numbers one after another, as they lie in memory.
fn pack(row: PyRow, out: &mut Vec<u8>) {
    let (time_ns, x, y, own_x, own_y, quality, status, zoom, strength, more_x, more_y, unseen) = row;
    out.extend(time_ns.to_ne_bytes());
    [x, y, own_x, own_y, quality].iter().for_each(|value| out.extend(value.to_ne_bytes()));
    out.push(status);
    [zoom[0], zoom[1], strength, more_x, more_y].iter().for_each(|value| out.extend(value.to_ne_bytes()));
    out.push(unseen);
}

fn leaves() -> PyErr {
    PyValueError::new_err("pixels: the region is not inside the image")
}

/// See [`Chain`].
#[pyclass(module = "midspan._core")]
struct TargetChain(Chain);

impl TargetChain {
    /// See [`Chain::track`]; None where the target must be searched for.
    fn tracked(
        &mut self,
        py: Python<'_>,
        tracker: &mut PyRegistration,
        pixels: &Bound<'_, PyAny>,
        time_ns: i64,
        prediction: Option<Prediction>,
    ) -> PyResult<Option<Row>> {
        let chain = &mut self.0;
        with_image!(Pixels::of(pixels)?, image => {
            tracker.check_size(image)?;
            let own = &mut tracker.own;
            let (row, candidate) = match py.detach(|| chain.track(own, image, time_ns, prediction)) {
                Seen::Row(row) => (Some(row), None),
                Seen::Search(candidate) => (None, candidate),
                Seen::Outside => return Err(leaves()),
            };
            tracker.candidate = candidate;
            Ok(row)
        })
    }

    /// Ask for the pixels of the next frame while this one is tracked, if they may lie in a file.
    fn ask_for(&self, tracker: &PyRegistration, next: Option<&PyFrame>) {
        match next.and_then(|next| Pixels::native(&next.pixels)) {
            Some(Pixels::U8(array)) => in_place(&array).iter().for_each(|image| self.0.ask_for(image, &tracker.own)),
            Some(Pixels::U16(array)) => in_place(&array).iter().for_each(|image| self.0.ask_for(image, &tracker.own)),
            _ => {}
        }
    }
}

#[pymethods]
impl TargetChain {
    /// `pixels`: of the reference frame; `place`: the target's region in it; `picture`, `light`, `lossless`: see
    /// [`Watched`]; `readout_s`, `quarter_turns`: see [`Shutter`]; `lens`: with the width and height of its frames.
    #[new]
    #[pyo3(signature = (pixels, place, *, picture, light, lossless, readout_s=0.0, quarter_turns=0, lens=None))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        pixels: &Bound<'_, PyAny>,
        place: Corners,
        picture: bool,
        light: bool,
        lossless: bool,
        readout_s: f64,
        quarter_turns: i64,
        lens: Option<(PyRef<'_, LensModel>, [usize; 2])>,
    ) -> PyResult<Self> {
        let (region, watched) = (region("place", place)?, Watched { picture, light, lossless });
        with_image!(Pixels::of(pixels)?, image => {
            let watch = Watch::new(image, region, watched).ok_or_else(leaves)?;
            let quarter_turns = quarter_turns.rem_euclid(4) as u8;
            let shutter = Shutter { readout_s, quarter_turns, shape: [image.rows, image.columns] };
            let lens = lens.map(|(model, size)| (model.0, size));
            let chain = Chain::new(watch, region, shutter, lens);
            chain.map(Self).ok_or_else(|| PyValueError::new_err("lens: does not reach the region"))
        })
    }

    /// Takes a frame through the registration tracker and the chain; None where the target must be searched for, and
    /// `push` is to be called with what was found.
    #[pyo3(signature = (tracker, pixels, time_ns, prediction=None))]
    fn track(
        &mut self,
        py: Python<'_>,
        mut tracker: PyRefMut<'_, PyRegistration>,
        pixels: &Bound<'_, PyAny>,
        time_ns: i64,
        prediction: Option<PyPrediction>,
    ) -> PyResult<Option<PyRow>> {
        let row = self.tracked(py, &mut tracker, pixels, time_ns, prediction.map(Prediction::from))?;
        Ok(row.as_ref().map(py_row))
    }

    /// The rows of frames up to one in which the target must be searched for, each packed as `=qdddddBdddB`.
    fn track_all<'py>(
        &mut self,
        py: Python<'py>,
        mut tracker: PyRefMut<'py, PyRegistration>,
        frames: Vec<PyFrame<'py>>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let mut packed = Vec::with_capacity(frames.len() * PACKED_BYTES);
        for (k, PyFrame { pixels, time_ns }) in frames.iter().enumerate() {
            self.ask_for(&tracker, frames.get(k + 1));
            let Some(row) = self.tracked(py, &mut tracker, pixels, *time_ns, None)? else { break };
            pack(py_row(&row), &mut packed);
        }
        Ok(PyBytes::new(py, &packed))
    }

    /// The row of a frame with what a tracker found in it.
    fn push(
        &mut self,
        py: Python<'_>,
        pixels: &Bound<'_, PyAny>,
        time_ns: i64,
        found: PyTranslation,
    ) -> PyResult<PyRow> {
        let (chain, found) = (&mut self.0, Translation::try_from(found)?);
        with_image!(Pixels::of(pixels)?, image => {
            let row = py.detach(|| chain.push(image, time_ns, found));
            row.as_ref().map(py_row).ok_or_else(leaves)
        })
    }

    /// The row of a frame in which nothing is to be looked for, as it is dark or torn; None of others.
    fn unseen(&mut self, pixels: &Bound<'_, PyAny>, time_ns: i64) -> PyResult<Option<PyRow>> {
        let row = with_image!(Pixels::of(pixels)?, image => self.0.unseen(image, time_ns));
        Ok(row.as_ref().map(py_row))
    }

    /// See [`Chain::first_late_ns`].
    #[getter]
    fn first_late_ns(&self) -> i64 {
        self.0.first_late_ns()
    }

    /// How many frames only repeated the one before.
    #[getter]
    fn frozen_frames(&self) -> u64 {
        self.0.watch.frozen_frames
    }

    /// Largest variance that light made (px²), and the stamp of the first that is worth reporting; None: not watched.
    #[getter]
    fn light(&self) -> Option<(f64, Option<i64>)> {
        let memory = &self.0.watch.light.as_ref()?.memory;
        Some((memory.largest_px2, memory.notable_ns))
    }

    /// What a codec did: share inherited from the frame before, share of the texture that was static, standard
    /// deviation (px); None: not watched.
    #[getter]
    fn compression(&self) -> Option<(f64, f64, f64)> {
        let Compression { inherited_share, frozen_share, std_px } = self.0.watch.picture.as_ref()?.compression();
        Some((inherited_share, frozen_share, std_px))
    }

    /// Share of the region's pixels at the ends of the scale; None: not watched.
    #[getter]
    fn saturated_share(&self) -> Option<f64> {
        Some(self.0.watch.picture.as_ref()?.saturated_share())
    }

    /// What is worth reporting, counted; None: not watched.
    #[getter]
    fn counts(&self) -> Option<PyCounts> {
        let counts = self.0.watch.picture.as_ref()?.counts();
        let [x, y] = counts.axes.each_ref().map(|axis| {
            let AxisCounts { seen, coarse, variance_px2, mean_px, square_px2 } = *axis;
            (seen, coarse, variance_px2, mean_px, square_px2)
        });
        Some((counts.frames, counts.blurred, counts.sharper, counts.saturated, counts.most_saturated, x, y))
    }

    /// Everything that changes from frame to frame.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &to_bytes(&(VERSION, self.0.watch.memory())).map_err(state_error)?))
    }

    /// Continues from a `state`; ValueError where it is cut short, changed, of another version or of other settings.
    fn restore(&mut self, state: &[u8]) -> PyResult<()> {
        let (version, memory): (u16, WatchMemory) = from_bytes(state).map_err(state_error)?;
        if version != VERSION {
            return Err(state_error(StateError::OtherVersion(version)));
        }
        if self.0.watch.restore(memory) { Ok(()) } else { Err(state_error(StateError::OtherSettings)) }
    }

    /// See [`Watch::keep_usual`].
    fn keep_usual(&mut self) {
        self.0.watch.keep_usual();
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("TEMPLATE_NOISE", crate::track::fair_variance::TEMPLATE_NOISE)?;
    module.add("SATURATED_SHARE", crate::track::picture_watch::SATURATED_SHARE)?;
    module.add("MAJORITY", crate::track::tracker::MAJORITY)?;
    module.add("LIGHT_PX", crate::track::light_watch::LIGHT_PX)?;
    module.add_class::<TargetChain>()
}
