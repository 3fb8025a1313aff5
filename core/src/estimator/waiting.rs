//! Measurements and marks in time, and those that wait for the samples that cover them.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// A measurement in its channel's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// Number of its channel.
    pub channel: usize,
    /// What was measured.
    pub value: f64,
    /// Its variance as declared.
    pub variance: f64,
    /// Variance of its reference, m².
    pub reference: f64,
}

/// What comes at an instant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Item {
    /// A measurement.
    Measured(Measurement),
    /// The datum of all axes is set here.
    Datum,
    /// A stream's stamps have gone back here.
    WentBack,
}

impl Item {
    /// What comes first at one instant; channels by their number.
    fn order(&self) -> usize {
        match self {
            Self::WentBack => 0,
            Self::Datum => 1,
            Self::Measured(one) => 2 + one.channel,
        }
    }

    /// The measurement.
    pub fn measured(&self) -> Option<&Measurement> {
        match self {
            Self::Measured(one) => Some(one),
            Self::Datum | Self::WentBack => None,
        }
    }
}

/// Something with its time, s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timed {
    /// When, s.
    pub at_s: f64,
    /// What.
    pub item: Item,
}

impl Timed {
    /// The channel of a measurement.
    pub fn channel(&self) -> Option<usize> {
        self.item.measured().map(|one| one.channel)
    }
}

/// Puts items in time order; of one instant by channel.
pub fn put_in_order(items: &mut [Timed]) {
    if items.windows(2).any(|two| two[1].at_s <= two[0].at_s) {
        items.sort_by(|a, b| a.at_s.total_cmp(&b.at_s).then(a.item.order().cmp(&b.item.order())));
    }
}

/// Keeps at most so many measurements, the newest of those in time order; of the marks before them the last of each kind
/// stays, as they hold from their instant on. Returns the time of the oldest item where any was dropped.
pub fn keep_newest(items: &mut VecDeque<Timed>, most: usize) -> Option<f64> {
    if items.len() <= most {
        return None;
    }
    let measured = items.iter().filter(|one| one.channel().is_some()).count();
    if measured <= most {
        return None;
    }
    let first = items.iter().enumerate().filter(|(_, one)| one.channel().is_some()).nth(measured - most)?.0;
    let oldest_s = items[0].at_s;
    let last_of = |mark: Item| (0..first).rev().find(|&j| items[j].item == mark);
    let marks = [last_of(Item::Datum), last_of(Item::WentBack)];
    let mut place = 0;
    items.retain(|_| {
        place += 1;
        place > first || marks.contains(&Some(place - 1))
    });
    Some(oldest_s)
}

/// How many of items in time order are no later than an instant.
pub fn count_until(items: &[Timed], until_s: f64) -> usize {
    items.partition_point(|one| one.at_s <= until_s)
}
