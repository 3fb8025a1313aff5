//! `packed` for Python.

use super::{RunArrays, elements, run_arrays};
use crate::packed::{self, Block, Fault};
use crate::rows::RowsRef;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

fn error(fault: Fault) -> PyErr {
    PyValueError::new_err(match fault {
        Fault::Length => "bytes are missing or too many",
        Fault::Checksum => "a check sum is wrong",
        Fault::Number => "a number is out of its range",
        Fault::Runs => "runs and columns do not fit each other",
    })
}

/// Runs (k,) and their rows (n,) as a pack.
#[pyfunction]
#[pyo3(signature = (point, t0_ns, dt_ns, count, status, displacement, std, velocity))]
#[allow(clippy::too_many_arguments)]
fn pack_rows<'py>(
    py: Python<'py>,
    point: PyReadonlyArray1<'py, u32>,
    t0_ns: PyReadonlyArray1<'py, i64>,
    dt_ns: PyReadonlyArray1<'py, i64>,
    count: PyReadonlyArray1<'py, u32>,
    status: PyReadonlyArray1<'py, u8>,
    displacement: PyReadonlyArray1<'py, f64>,
    std: PyReadonlyArray1<'py, f64>,
    velocity: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyBytes>> {
    let rows = RowsRef {
        point: elements("point", &point)?,
        t0_ns: elements("t0_ns", &t0_ns)?,
        dt_ns: elements("dt_ns", &dt_ns)?,
        count: elements("count", &count)?,
        status: elements("status", &status)?,
        columns: [elements("displacement", &displacement)?, elements("std", &std)?, elements("velocity", &velocity)?],
    };
    let pack = py.detach(|| packed::encode(rows)).map_err(error)?;
    Ok(PyBytes::new(py, &pack))
}

/// See [`packed::decode`].
#[pyfunction]
fn unpack_rows<'py>(py: Python<'py>, pack: &[u8], velocity: bool) -> PyResult<RunArrays<'py>> {
    let rows = py.detach(|| packed::decode(pack, velocity)).map_err(error)?;
    Ok(run_arrays(py, rows))
}

/// Points, first and last stamps, numbers of rows (m,).
type Index<'py> =
    (Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i64>>);

/// See [`packed::index`].
#[pyfunction]
fn pack_index<'py>(py: Python<'py>, pack: &[u8]) -> PyResult<Index<'py>> {
    let found = py.detach(|| packed::index(pack)).map_err(error)?;
    Ok((
        found.iter().map(|one| one.0).collect::<Vec<_>>().into_pyarray(py),
        found.iter().map(|one| one.1.first_ns).collect::<Vec<_>>().into_pyarray(py),
        found.iter().map(|one| one.1.last_ns).collect::<Vec<_>>().into_pyarray(py),
        found.iter().map(|one| one.1.rows as i64).collect::<Vec<_>>().into_pyarray(py),
    ))
}

/// See [`packed::only`].
#[pyfunction]
fn pack_of<'py>(py: Python<'py>, pack: &[u8], point: u32) -> PyResult<Option<Bound<'py, PyBytes>>> {
    let found = packed::only(pack, point).map_err(error)?;
    Ok(found.map(|own| PyBytes::new(py, &own)))
}

/// See [`packed::join`]; after_ns: by the number of the point, for those beyond its end all parts are kept.
#[pyfunction]
fn join_packs<'py>(
    py: Python<'py>,
    packs: Vec<Bound<'py, PyBytes>>,
    after_ns: PyReadonlyArray1<'py, i64>,
) -> PyResult<Bound<'py, PyBytes>> {
    let after_ns = elements("after_ns", &after_ns)?;
    let views: Vec<&[u8]> = packs.iter().map(|pack| pack.as_bytes()).collect();
    let after = |point: u32| after_ns.get(point as usize).copied().unwrap_or(i64::MIN);
    let pack = py.detach(|| packed::join(&views, after)).map_err(error)?;
    Ok(PyBytes::new(py, &pack))
}

/// Point, first and last stamp, number of rows, least and largest displacement, seconds and pack.
type BlockTuple<'py> = (u32, i64, i64, usize, Option<f64>, Option<f64>, Bound<'py, PyBytes>, Bound<'py, PyBytes>);

/// See [`packed::blocks`].
#[pyfunction]
fn pack_blocks<'py>(py: Python<'py>, pack: &[u8]) -> PyResult<Vec<BlockTuple<'py>>> {
    let blocks = py.detach(|| packed::blocks(pack)).map_err(error)?;
    let limit = |value: f64| Some(value).filter(|value| value.is_finite());
    let tuple = |one: Block| {
        let (seconds, pack) = (PyBytes::new(py, &one.seconds), PyBytes::new(py, &one.pack));
        let span = one.span;
        (one.point, span.first_ns, span.last_ns, span.rows, limit(one.low), limit(one.high), seconds, pack)
    };
    Ok(blocks.into_iter().map(tuple).collect())
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(pack_rows, module)?)?;
    module.add_function(wrap_pyfunction!(unpack_rows, module)?)?;
    module.add_function(wrap_pyfunction!(pack_index, module)?)?;
    module.add_function(wrap_pyfunction!(pack_of, module)?)?;
    module.add_function(wrap_pyfunction!(join_packs, module)?)?;
    module.add_function(wrap_pyfunction!(pack_blocks, module)?)
}
