//! Rows of many points as runs: what a bank gives and a pack keeps.

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
    /// Displacement (m), its standard deviation (m) and velocity (m/s); the last one empty where it was not asked for.
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
