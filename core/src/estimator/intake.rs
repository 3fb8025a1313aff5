//! Measurements as they come to a stream: they wait for the samples that cover their time.

use super::model::{instant, since};
use super::reports::{Report, What};
use super::stream::Estimator;
use super::waiting::{Item, Measurement, Timed, keep_newest, put_in_order};

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
            let at_s = since(stamp_ns, origin_ns);
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
