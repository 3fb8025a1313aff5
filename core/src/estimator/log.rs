//! Samples, measurements and final decisions as they were met, from the filter's beginning on: what a second pass needs.

use super::cause::Decision;
use super::decided::Decided;
use super::run::Filter;
use super::samples::Samples;
use super::start::Beginning;
use super::waiting::Item;
use std::collections::BTreeMap;

/// The filter with its best hypothesis alone, after so many decided measurements, and what that took those for that were
/// not decided yet.
#[derive(Clone, Debug)]
pub struct Logged {
    /// The filter.
    pub filter: Filter,
    /// How many items were decided.
    pub decided: usize,
    /// What the best hypothesis took the next ones for.
    pub open: Vec<Decision>,
}

/// The log of an estimator.
#[derive(Clone, Debug)]
pub struct Log {
    /// The state before the first sample.
    pub begin: Beginning,
    /// Time of the first measurement, from which on rows are given, s.
    pub first_s: f64,
    /// What times in s count from, ns.
    pub origin_ns: i64,
    /// The samples.
    pub samples: Samples,
    /// What was decided.
    pub decided: Decided,
    /// The filter after so many samples, multiples of a block.
    pub filters: BTreeMap<usize, Logged>,
}

impl Log {
    /// Nothing yet.
    pub fn new(begin: Beginning, first_s: f64, origin_ns: i64, axes: usize) -> Self {
        let (samples, decided) = (Samples::none(axes), Decided::default());
        Self { begin, first_s, origin_ns, samples, decided, filters: BTreeMap::new() }
    }

    /// Times (s) from which on clocks were in doubt, as stamps had gone back.
    pub fn went_back_s(&self) -> Vec<f64> {
        self.decided.items.iter().filter(|one| one.item == Item::WentBack).map(|one| one.at_s).collect()
    }
}
