//! The rows of all points as runs: evenly timed rows of one point with one status.

use super::rounding::{round_to, round_up};
use crate::Status;
use crate::rows::Rows;

/// A row of a point, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Its stamp, ns.
    pub time_ns: i64,
    /// m.
    pub displacement: f64,
    /// Variance of the displacement, m².
    pub variance: f64,
    /// m/s.
    pub velocity: f64,
    /// Variance of the velocity, (m/s)².
    pub velocity_variance: f64,
    /// What it rests on.
    pub status: Status,
}

impl Rows {
    /// Takes memory for this many rows.
    pub fn reserve(&mut self, rows: usize) {
        for column in &mut self.columns {
            column.reserve(rows);
        }
    }

    /// Adds a row of a point; step_ns: from one sample to the next, where it is the only row of a run.
    #[inline]
    pub fn add(&mut self, point: u32, row: &Row, step_ns: i64, rounded: bool) {
        self.place(point, row, step_ns);
        let std = row.variance.sqrt();
        let values = if rounded {
            [round_to(row.displacement, row.variance), round_up(std), round_to(row.velocity, row.velocity_variance)]
        } else {
            [row.displacement, std, row.velocity]
        };
        for (column, value) in self.columns.iter_mut().zip(values) {
            column.push(value);
        }
    }

    #[inline]
    fn place(&mut self, point: u32, row: &Row, step_ns: i64) {
        let status = row.status as u8;
        if let Some(last) = self.point.len().checked_sub(1)
            && self.point[last] == point
            && self.status[last] == status
        {
            let count = self.count[last];
            let after = row.time_ns - self.t0_ns[last];
            if count == 1 && after <= step_ns + step_ns / 2 {
                self.dt_ns[last] = after;
            }
            if after == i64::from(count) * self.dt_ns[last] {
                self.count[last] = count + 1;
                return;
            }
        }
        self.point.push(point);
        self.t0_ns.push(row.time_ns);
        self.dt_ns.push(step_ns);
        self.count.push(1);
        self.status.push(status);
    }
}
