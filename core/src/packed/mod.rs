//! Rows of many points in few bytes, every bit of them kept: packs of a group's second, joined by point to blocks.
//!
//! A pack is an index by point, then for each point its parts, each with a check sum: to read a point touches its own
//! part alone, and packs are joined without decoding. Columns are whole multiples of a power of two, differenced (FLAC's
//! fixed predictors, RFC 9639) and Rice-coded (Rice & Plaunt 1971, doi:10.1109/TCOM.1971.1090789).

mod bits;
mod column;
mod pack;
mod part;
mod seconds;

pub use pack::{Block, blocks, decode, encode, index, join, only};
pub use part::Span;
pub use seconds::ENTRY_BYTES;

/// Why bytes are no pack, or rows cannot be packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Bytes are missing, or too many.
    Length,
    /// A check sum is wrong.
    Checksum,
    /// A number is out of its range.
    Number,
    /// Columns or runs that do not fit each other.
    Runs,
}

/// Runs of evenly timed rows: run j has count[j] rows of point[j] with status[j], at t0_ns[j] and every dt_ns[j] after;
/// the columns hold the rows of all runs, one after another.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// Number of the point in its group.
    pub point: Vec<u32>,
    /// Stamp of the first row, ns.
    pub t0_ns: Vec<i64>,
    /// Time between rows, ns.
    pub dt_ns: Vec<i64>,
    /// Number of rows.
    pub count: Vec<u32>,
    /// Code of the status of all rows.
    pub status: Vec<u8>,
    /// Displacement, standard deviation and velocity, SI; the last one empty where it was not asked for.
    pub columns: [Vec<f64>; 3],
}

/// [`Rows`] that belong to somebody else.
#[derive(Clone, Copy, Debug)]
pub struct RowsRef<'a> {
    /// As [`Rows::point`].
    pub point: &'a [u32],
    /// As [`Rows::t0_ns`].
    pub t0_ns: &'a [i64],
    /// As [`Rows::dt_ns`].
    pub dt_ns: &'a [i64],
    /// As [`Rows::count`].
    pub count: &'a [u32],
    /// As [`Rows::status`].
    pub status: &'a [u8],
    /// As [`Rows::columns`], all three.
    pub columns: [&'a [f64]; 3],
}
