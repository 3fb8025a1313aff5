//! Images and grids of Python as the core takes them, and back.

use crate::track::grid::Grid;
use crate::track::pixels::Pixels;
use numpy::{Element, IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A copy of an array (rows, columns).
pub fn grid<T: Element + Copy>(array: &PyReadonlyArray2<'_, T>) -> Grid<T> {
    let view = array.as_array();
    let (rows, columns) = view.dim();
    let values = view.as_slice().map_or_else(|| view.iter().copied().collect(), <[T]>::to_vec);
    Grid { values, rows, columns }
}

/// An array (rows, columns) of a grid.
pub fn array<'py, T: Element>(py: Python<'py>, grid: Grid<T>) -> PyResult<Bound<'py, PyArray2<T>>> {
    grid.values.into_pyarray(py).reshape([grid.rows, grid.columns])
}

/// A frame's pixels, borrowed; what is neither of these kinds becomes floating-point numbers of 64 bits.
pub enum Image<'py> {
    Byte(PyReadonlyArray2<'py, u8>),
    Word(PyReadonlyArray2<'py, u16>),
    Single(PyReadonlyArray2<'py, f32>),
    Double(PyReadonlyArray2<'py, f64>),
}

impl<'py> Image<'py> {
    /// The image (rows, columns), whatever its numbers are; a ValueError where it is none.
    pub fn new(image: &Bound<'py, PyAny>) -> PyResult<Self> {
        if let Ok(pixels) = image.extract::<PyReadonlyArray2<'py, u8>>() {
            return Ok(match even(&pixels) {
                true => Self::Byte(pixels),
                false => Self::Byte(copied(image)?.extract()?),
            });
        }
        if let Ok(pixels) = image.extract::<PyReadonlyArray2<'py, u16>>() {
            return Ok(match even(&pixels) {
                true => Self::Word(pixels),
                false => Self::Word(copied(image)?.extract()?),
            });
        }
        if let Ok(pixels) = image.extract::<PyReadonlyArray2<'py, f32>>() {
            return Ok(match even(&pixels) {
                true => Self::Single(pixels),
                false => Self::Single(copied(image)?.extract()?),
            });
        }
        if let Ok(pixels) = image.extract::<PyReadonlyArray2<'py, f64>>() {
            return Ok(match even(&pixels) {
                true => Self::Double(pixels),
                false => Self::Double(copied(image)?.extract()?),
            });
        }
        let order = PyDict::new(image.py());
        order.set_item("order", "C")?;
        let wide = image.call_method("astype", ("float64",), Some(&order))?;
        let wide = wide.extract::<PyReadonlyArray2<'py, f64>>();
        Ok(Self::Double(wide.map_err(|_| PyValueError::new_err("pixels: not an array of rows and columns"))?))
    }
}

fn copied<'py>(image: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    image.call_method1("copy", ("C",))
}

/// Whether the columns of a row lie side by side and its rows do not run backwards.
fn even<T: Element>(pixels: &PyReadonlyArray2<'_, T>) -> bool {
    let (strides, size) = (pixels.strides(), size_of::<T>() as isize);
    let columns = pixels.shape()[1] as isize;
    strides[1] == size && strides[0] >= size * columns && strides[0] % size == 0
}

/// The pixels of an array whose rows are `even`.
pub fn pixels<'a, T: Element + crate::track::pixels::Pixel>(
    array: &'a PyReadonlyArray2<'_, T>,
) -> PyResult<Pixels<'a, T>> {
    let [rows, columns] = [array.shape()[0], array.shape()[1]];
    let stride = usize::try_from(array.strides()[0]).unwrap_or(0) / size_of::<T>();
    let length = if rows == 0 { 0 } else { (rows - 1) * stride + columns };
    let values = if rows == 0 || columns == 0 || !even(array) {
        &[]
    } else {
        // SAFETY: the rows run forwards, `stride` elements apart, so that first and last pixel, which are the array's, have
        // this many elements between them; those between two rows are of the array that this one is a view of. The array
        // is borrowed for as long as the slice.
        unsafe { std::slice::from_raw_parts(array.data().cast_const(), length) }
    };
    Pixels::new(values, rows, columns, stride)
        .ok_or_else(|| PyValueError::new_err("pixels: their rows do not lie in order"))
}

/// Runs `$work` with the pixels `$name` of an image, whatever kind they are.
macro_rules! with_pixels {
    ($image:expr, $name:ident => $work:expr) => {
        match $image {
            $crate::py::arrays::Image::Byte(array) => {
                let $name = $crate::py::arrays::pixels(array)?;
                $work
            }
            $crate::py::arrays::Image::Word(array) => {
                let $name = $crate::py::arrays::pixels(array)?;
                $work
            }
            $crate::py::arrays::Image::Single(array) => {
                let $name = $crate::py::arrays::pixels(array)?;
                $work
            }
            $crate::py::arrays::Image::Double(array) => {
                let $name = $crate::py::arrays::pixels(array)?;
                $work
            }
        }
    };
}
pub(crate) use with_pixels;
