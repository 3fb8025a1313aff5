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
