//! What happened to a point; Python words it.

use serde::{Deserialize, Serialize};

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Code {
    /// Readings came too late, and are left out.
    Late = 1,
    /// Too much waits; readings are left out.
    Overflow = 2,
    /// The displacement sensor's zero, or the displacement, has moved at once.
    Shifted = 3,
    /// The last measurement is too old.
    Lost = 4,
    /// The displacement is measured again.
    Tracking = 5,
    /// The displacement sensor repeats one value, which is left out.
    Frozen = 6,
}

/// What happened when.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// ns.
    pub time_ns: i64,
    /// What.
    pub code: Code,
}
