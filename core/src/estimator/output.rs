//! What a stream gives out of a push: rows, innovations and events.

use super::reports::Report;
use super::rows::{Innovations, Rows};

/// What a push gave.
#[derive(Clone, Debug, Default)]
pub struct Output {
    /// Rows of all axes, where they are given out.
    pub rows: Option<Rows>,
    /// Innovations of each channel as the best hypothesis saw them; none at the end.
    pub innovations: Vec<Innovations>,
    /// Events.
    pub reports: Vec<Report>,
    /// Variance (axes,) of the datum at the last row, the part that all rows have in common, m².
    pub zero_variance: Vec<f64>,
}

impl Output {
    /// Adds an output to those before.
    pub fn add(whole: &mut Option<Output>, output: Self) {
        let Some(own) = whole else {
            *whole = Some(output);
            return;
        };
        match (&mut own.rows, output.rows) {
            (Some(rows), Some(more)) => rows.extend(&more),
            (None, Some(more)) => own.rows = Some(more),
            (_, None) => {}
        }
        if own.innovations.is_empty() {
            own.innovations = output.innovations;
        } else {
            for (before, more) in own.innovations.iter_mut().zip(&output.innovations) {
                before.extend(more);
            }
        }
        own.reports.extend(output.reports);
        if !output.zero_variance.is_empty() {
            own.zero_variance = output.zero_variance;
        }
    }
}
