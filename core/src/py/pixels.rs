//! Images of Python in any type of pixel, without a copy where their rows are contiguous.

use crate::track::image::{Image, Region};
use numpy::{Element, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// An image (rows, columns) of Python.
pub enum Pixels<'py> {
    U8(PyReadonlyArray2<'py, u8>),
    U16(PyReadonlyArray2<'py, u16>),
    I16(PyReadonlyArray2<'py, i16>),
    I32(PyReadonlyArray2<'py, i32>),
    I64(PyReadonlyArray2<'py, i64>),
    F32(PyReadonlyArray2<'py, f32>),
    F64(PyReadonlyArray2<'py, f64>),
}

impl<'py> Pixels<'py> {
    /// The image; ValueError where it is none. Other kinds of numbers become whole or floating point ones of 64 bits.
    pub fn of(any: &Bound<'py, PyAny>) -> PyResult<Self> {
        Self::native(any).map_or_else(|| Self::converted(any), Ok)
    }

    /// The image where its type of pixel is used as it is.
    pub fn native(any: &Bound<'py, PyAny>) -> Option<Self> {
        fn array<'py, T: Element>(any: &Bound<'py, PyAny>) -> Option<PyReadonlyArray2<'py, T>> {
            any.cast::<PyArray2<T>>().ok()?.try_readonly().ok()
        }
        None.or_else(|| array(any).map(Self::U8))
            .or_else(|| array(any).map(Self::U16))
            .or_else(|| array(any).map(Self::F32))
            .or_else(|| array(any).map(Self::F64))
            .or_else(|| array(any).map(Self::I16))
            .or_else(|| array(any).map(Self::I32))
            .or_else(|| array(any).map(Self::I64))
    }

    fn converted(any: &Bound<'py, PyAny>) -> PyResult<Self> {
        let refused = |_| PyValueError::new_err("pixels: an array of numbers of two axes is needed");
        let kind: String = any.getattr("dtype").and_then(|dtype| dtype.getattr("kind")?.extract()).map_err(refused)?;
        let wanted = if matches!(kind.as_str(), "i" | "u" | "b") { "int64" } else { "float64" };
        let other = any.call_method1("astype", (wanted,)).map_err(refused)?;
        Self::native(&other).ok_or_else(|| PyValueError::new_err("pixels: an array of numbers of two axes is needed"))
    }
}

/// An array as an image, whose rows are contiguous; else None.
pub fn in_place<'a, T: Element + Copy>(array: &'a PyReadonlyArray2<'_, T>) -> Option<Image<'a, T>> {
    let pixels = array.as_array();
    let (rows, columns) = pixels.dim();
    let (down, across) = (pixels.strides()[0], pixels.strides()[1]);
    if rows > 0 && columns > 0 && (across == 1 || columns == 1) && (rows == 1 || down >= columns as isize) {
        let stride = if rows == 1 { columns } else { down.unsigned_abs() };
        let length = (rows - 1) * stride + columns;
        // SAFETY: the first and the last element belong to the array, and what lies between them to the same buffer, as
        // all strides are positive; nothing writes there while the read-only borrow of `array` lives.
        let slice = unsafe { std::slice::from_raw_parts(pixels.as_ptr(), length) };
        return Image::new(slice, rows, columns, stride);
    }
    None
}

/// An array as an image: without a copy where its rows are contiguous, else copied into `store`.
pub fn view<'a, T: Element + Copy>(array: &'a PyReadonlyArray2<'_, T>, store: &'a mut Vec<T>) -> Image<'a, T> {
    if let Some(image) = in_place(array) {
        return image;
    }
    let pixels = array.as_array();
    let (rows, columns) = pixels.dim();
    store.extend(pixels.iter().copied());
    // As many as rows times columns have just been copied.
    Image::new(store, rows, columns, columns).unwrap()
}

/// A computation on an image, whatever its type of pixel: `with_image!(pixels, image => expression)`.
macro_rules! with_image {
    (@arm $array:ident, $image:ident => $body:expr) => {{
        let mut store = Vec::new();
        let $image = &$crate::py::pixels::view($array, &mut store);
        $body
    }};
    ($pixels:expr, $image:ident => $body:expr) => {
        match &$pixels {
            $crate::py::pixels::Pixels::U8(array) => with_image!(@arm array, $image => $body),
            $crate::py::pixels::Pixels::U16(array) => with_image!(@arm array, $image => $body),
            $crate::py::pixels::Pixels::I16(array) => with_image!(@arm array, $image => $body),
            $crate::py::pixels::Pixels::I32(array) => with_image!(@arm array, $image => $body),
            $crate::py::pixels::Pixels::I64(array) => with_image!(@arm array, $image => $body),
            $crate::py::pixels::Pixels::F32(array) => with_image!(@arm array, $image => $body),
            $crate::py::pixels::Pixels::F64(array) => with_image!(@arm array, $image => $body),
        }
    };
}
pub(crate) use with_image;

/// Column, row, width and height of a region.
pub type Corners = (i64, i64, i64, i64);

/// A region; ValueError where it holds no pixel.
pub fn region(name: &str, (x, y, width, height): Corners) -> PyResult<Region> {
    match (usize::try_from(width), usize::try_from(height)) {
        (Ok(width @ 1..=0x7fff_ffff), Ok(height @ 1..=0x7fff_ffff)) => Ok(Region { x, y, width, height }),
        _ => Err(PyValueError::new_err(format!("{name}: a width and height of at least 1 are needed"))),
    }
}

/// The part of an image in a region; ValueError where that leaves it.
pub fn cut<'a, T: Copy>(name: &str, image: &Image<'a, T>, region: Region) -> PyResult<Image<'a, T>> {
    image.cut(region).ok_or_else(|| PyValueError::new_err(format!("{name}: not inside the image")))
}
