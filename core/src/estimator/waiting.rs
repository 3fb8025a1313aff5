//! Measurements and marks in time: they wait for the samples that cover their time.

use super::model::{instant, since};
use super::reports::{Report, What};
use super::stream::Estimator;
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
    /// A sensor's clock has stepped before the next measurement.
    ClockStep {
        /// The parameter that is its offset.
        parameter: usize,
        /// Variance of what its offset is then, s².
        variance: f64,
        /// By how much another instant the motion's state is of, s.
        moved_s: f64,
    },
    /// A sensor's clock has drifted: from the next measurement on its stamps take what its parameter has come to.
    Relinearised {
        /// The parameter that is its offset.
        parameter: usize,
        /// What is added to its stamps, s.
        by_s: f64,
    },
}

impl Item {
    /// What comes first at one instant; channels by their number.
    fn order(&self) -> usize {
        match self {
            Self::WentBack | Self::ClockStep { .. } | Self::Relinearised { .. } => 0,
            Self::Datum => 1,
            Self::Measured(one) => 2 + one.channel,
        }
    }

    /// The measurement.
    pub fn measured(&self) -> Option<&Measurement> {
        match self {
            Self::Measured(one) => Some(one),
            Self::Datum | Self::WentBack | Self::ClockStep { .. } | Self::Relinearised { .. } => None,
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
    put_each_in_order(items, |one| *one);
}

/// Puts what goes with items in the order of these.
pub fn put_each_in_order<T>(listed: &mut [T], item: impl Fn(&T) -> Timed) {
    if listed.windows(2).any(|two| item(&two[1]).at_s <= item(&two[0]).at_s) {
        listed.sort_by(|a, b| {
            let (a, b) = (item(a), item(b));
            a.at_s.total_cmp(&b.at_s).then(a.item.order().cmp(&b.item.order()))
        });
    }
}

/// Keeps at most this many measurements, the newest of those in time order; of the marks before them the last of each
/// kind stays, as they hold from their instant on. Returns the time of the oldest item where any was dropped.
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

impl Estimator {
    /// Takes a measurement of an existing channel; its reference's variance in the channel's unit.
    pub fn measure(&mut self, time_ns: &[i64], mut rows: impl Iterator<Item = Measurement>) {
        let usable = |row: &Measurement| row.value.is_finite() && row.variance > 0.0 && row.variance < f64::INFINITY;
        let before = self.memory.waiting.len();
        let done_s = self.memory.filter.as_ref().map_or(f64::NEG_INFINITY, |filter| filter.clock.time_s);
        let mut late: Vec<(usize, f64)> = Vec::new();
        let mut in_time = vec![false; self.settings.channels.len()];
        self.memory.waiting.reserve(time_ns.len());
        for &stamp_ns in time_ns {
            let Some(mut row) = rows.next() else { break };
            if !usable(&row) {
                continue;
            }
            let g = self.model.channels[row.channel].row.units_per_m;
            row.reference = if row.reference.is_finite() { row.reference / (g * g) } else { 0.0 };
            let Some(origin_ns) = self.memory.origin_ns else {
                self.wait_early(stamp_ns, row);
                continue;
            };
            let at_s = since(stamp_ns + self.memory.clocks.offsets_ns[row.channel], origin_ns);
            if at_s <= done_s {
                late.push((row.channel, at_s));
            } else {
                in_time[row.channel] = true;
                self.memory.waiting.push_back(Timed { at_s, item: Item::Measured(row) });
            }
        }
        self.note_late(&late, &in_time);
        if self.memory.waiting.len() > before {
            self.order_waiting();
        }
    }

    /// Reports channels whose measurements came too late, each once until one comes in time again.
    fn note_late(&mut self, late: &[(usize, f64)], in_time: &[bool]) {
        let mut channels: Vec<usize> = late.iter().map(|one| one.0).collect();
        channels.sort_unstable();
        channels.dedup();
        for c in channels {
            if !self.memory.late[c] {
                let first_s = late.iter().find(|one| one.0 == c).map_or(0.0, |one| one.1);
                self.memory.pending.push(Report::of(instant(first_s, self.origin_ns()), c, What::Late));
            }
            self.memory.late[c] = true;
        }
        for (is_late, &in_time) in self.memory.late.iter_mut().zip(in_time) {
            *is_late = *is_late && !in_time;
        }
    }

    fn wait_early(&mut self, stamp_ns: i64, row: Measurement) {
        self.memory.early.push_back((stamp_ns, row));
        if self.memory.early.len() > self.limits.waiting {
            if let Some((oldest_ns, _)) = self.memory.early.pop_front() {
                self.overflow(oldest_ns);
            }
        }
    }

    pub(super) fn order_waiting(&mut self) {
        put_in_order(self.memory.waiting.make_contiguous());
        if let Some(oldest_s) = keep_newest(&mut self.memory.waiting, self.limits.waiting) {
            self.overflow(instant(oldest_s, self.origin_ns()));
        }
    }

    /// Reports that measurements from an instant on are dropped: once, until half of what may wait is gone.
    fn overflow(&mut self, time_ns: i64) {
        if !self.memory.overflown {
            self.memory.pending.push(Report::of(time_ns, 0, What::Overflow));
        }
        self.memory.overflown = true;
    }

    /// Lets the clocks be in doubt from an instant on; before the filter has begun it knows of none.
    pub fn doubt(&mut self, time_ns: i64) {
        let at_s = since(time_ns, self.origin_ns());
        if let Some(filter) = &self.memory.filter {
            self.memory.waiting.push_back(Timed { at_s: at_s.max(filter.clock.time_s), item: Item::WentBack });
            put_in_order(self.memory.waiting.make_contiguous());
        }
    }
}
