//! The numeric core of midspan: what is called for each sample, pixel, frame or value of a likelihood.
//!
//! It knows no file, clock, thread or network and holds no text for people: it returns numbers and codes, and Python
//! words them. Each file opens with what it computes and from which equation. `py` converts arrays and errors and
//! computes nothing.

pub mod bank;
pub mod estimator;
pub mod likelihood;
pub mod packed;
pub mod radar;
pub mod rows;
pub mod scene;
pub mod signals;
pub mod track;

mod py;

use pyo3::prelude::*;

/// What a translation, or a row, rests on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Status {
    /// A measurement that is not too old: the frame shows the target.
    Tracking,
    /// The prediction, by the acceleration alone.
    Coasting,
    /// Nothing, or the acceleration alone for longer.
    #[default]
    Lost,
}

/// The extension module `midspan._core`.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    py::bank::register(module)?;
    py::likelihood::register(module)?;
    py::scene::register(module)?;
    py::signals::register(module)?;
    py::track::register(module)?;
    py::registration::register(module)?;
    py::chain::register(module)?;
    py::radar::register(module)?;
    py::features::register(module)?;
    py::lens::register(module)?;
    py::phase::register(module)?;
    py::picture::register(module)?;
    py::estimator::register(module)?;
    py::packed::register(module)?;
    py::printed::register(module)
}
