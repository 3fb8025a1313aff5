//! The pass back over what the filter left of a block: what was measured later corrects what was found before.
//!
//! It is the modified Bryson-Frazier smoother (G. J. Bierman, Fixed interval smoothing with discrete measurements, Int. J.
//! Control 18 (1973) 65-75): it carries an adjoint L and its information M, needs no inverse, and what only adds variance
//! to a state leaves it as it is. M is carried as a factor W, M = W W': what later measurements say of a combination of
//! states that was widely uncertain is a small difference of what they say of each.

use super::counting::Counting;
use super::innovation::Mixed;
use super::layout::{MOTION_STATES, motion_of};
use super::matrix::{Matrix, quadratic};
use super::model::Model;
use super::row::Entry;
use super::way_back::{Recorded, WayBack};
use std::ops::Range;

/// A smoothed variance is no smaller than this share of the filtered one: beyond it rounding speaks.
const MIN_VARIANCE_SHARE: f64 = 1e-12;

/// What later measurements say: L and W as rows, (1 + k + 2 n, n).
#[derive(Clone, Debug)]
pub struct Adjoint {
    rows: Matrix,
    columns: usize,
    /// How many rows are used.
    used: usize,
    /// States that are uncertain as they are counted.
    live: Vec<usize>,
    /// Where these end: what is certain among the states before is 0 in every product.
    end: usize,
    unknown: Vec<bool>,
    /// Each channel's row, of live states alone.
    live_rows: Vec<Vec<Entry>>,
    /// To work with.
    moved: Vec<f64>,
    gain: Vec<f64>,
    pc: Vec<f64>,
    pv: Vec<f64>,
    sensitivity: Vec<f64>,
}

impl Adjoint {
    /// Nothing comes later.
    pub fn nothing(model: &Model) -> Self {
        let (n, columns) = (model.size(), model.columns());
        Self {
            rows: Matrix::zeros(columns + 2 * n + 1, n),
            columns,
            used: columns,
            live: Vec::new(),
            end: 0,
            unknown: Vec::new(),
            live_rows: Vec::new(),
            moved: Vec::new(),
            gain: vec![0.0; n],
            pc: vec![0.0; n],
            pv: vec![0.0; n],
            sensitivity: vec![0.0; columns],
        }
    }

    /// Nothing comes later, in the memory that it has.
    pub fn restart(&mut self) {
        self.rows.elements_mut().fill(0.0);
        self.used = self.columns;
        // The states may be counted otherwise now.
        self.live_rows.clear();
    }

    /// L and W as rows.
    #[cfg(test)]
    pub fn rows(&self) -> &Matrix {
        &self.rows
    }

    /// Runs back over a block; found: takes the smoothed rows (samples · axes) of the wanted samples.
    pub fn pass(&mut self, way: &WayBack, counting: &Counting, wanted: Range<usize>, found: &mut Vec<Mixed>) {
        self.find_live(way, counting);
        if self.used >= self.columns + 2 * self.live.len() {
            self.narrow();
        }
        let axes = way.axes;
        found.clear();
        found.resize(wanted.len() * axes, Mixed { value: 0.0, variance: 0.0, velocity: 0.0 });
        let mut next = way.records.len();
        let mut at_s = way.time_s.last().copied().unwrap_or(way.start_s);
        for k in wanted.clone().rev() {
            next = self.back_through_all(way, (next, k + 1), &mut at_s, counting);
            self.back_to(way.time_s[k], &mut at_s, axes);
            for a in 0..axes {
                found[(k - wanted.start) * axes + a] = self.smoothed(way, k, a, counting);
            }
        }
        self.back_through_all(way, (next, 0), &mut at_s, counting);
        self.back_to(way.start_s, &mut at_s, axes);
    }

    /// Carries the adjoint back through the items before item `next` in the intervals of samples from `first` on; returns
    /// the number of the first of them.
    fn back_through_all(
        &mut self,
        way: &WayBack,
        (mut next, first): (usize, usize),
        at_s: &mut f64,
        counting: &Counting,
    ) -> usize {
        while next > 0 && way.records[next - 1].sample >= first {
            next -= 1;
            self.back_to(way.records[next].at_s, at_s, way.axes);
            self.back_through(way, next, counting);
        }
        next
    }

    /// Finds the states that are uncertain as the pass back counts them.
    ///
    /// A state that is certain in all of the block is so before it too, until a measurement whose record scales it by 0: its
    /// adjoint is of no weight.
    fn find_live(&mut self, way: &WayBack, counting: &Counting) {
        let now = way.uncertain.iter().zip(&counting.counted).map(|(&one, &counted)| one || counted);
        if self.live_rows.len() == counting.rows.len() && now.clone().eq(self.unknown.iter().copied()) {
            return;
        }
        self.unknown.clear();
        self.unknown.extend(now);
        let unknown = &self.unknown;
        self.live.clear();
        self.live.extend((0..unknown.len()).filter(|&j| unknown[j]));
        self.end = self.live.last().map_or(0, |&last| last + 1);
        let alive = |row: &Vec<Entry>| row.iter().copied().filter(|one| unknown[one.state]).collect();
        self.live_rows = counting.rows.iter().map(alive).collect();
    }

    /// Φ' times each row, from one instant to an earlier one.
    #[inline]
    fn back_to(&mut self, to_s: f64, at_s: &mut f64, axes: usize) {
        let dt = *at_s - to_s;
        if dt <= 0.0 {
            return;
        }
        *at_s = to_s;
        let (half, n, used) = (0.5 * dt * dt, self.rows.width(), self.used);
        for row in self.rows.elements_mut().chunks_exact_mut(n).take(used) {
            for motion in row[..MOTION_STATES * axes].chunks_exact_mut(MOTION_STATES) {
                let (x, v) = (motion[0], motion[1]);
                motion[2] -= half * x + dt * v;
                motion[1] = v + dt * x;
            }
        }
    }

    /// Carries the adjoint back through an item.
    fn back_through(&mut self, way: &WayBack, place: usize, counting: &Counting) {
        let (channel, total, shift_scaled, reference_scaled) = match way.records[place].what {
            Recorded::Doubt => return,
            Recorded::Datum => return self.back_through_datum(counting),
            Recorded::Measured { channel, total, shift_scaled, reference_scaled } => {
                (channel, total, shift_scaled, reference_scaled)
            }
        };
        if let Some(total) = total {
            let stride = way.columns + way.size;
            let details = &way.details[place * stride..(place + 1) * stride];
            let (e, gain) = details.split_at(way.columns);
            if counting.counts() {
                let mut own = std::mem::take(&mut self.gain);
                own.copy_from_slice(gain);
                counting.count(&mut own);
                self.back_through_measurement(channel, &own, e, total);
                self.gain = own;
            } else {
                self.back_through_measurement(channel, gain, e, total);
            }
        }
        let model = &counting.model.channels[channel];
        for (state, factor) in [(model.shift, shift_scaled), (model.reference, reference_scaled)] {
            if factor != 1.0 {
                for c in 0..self.used {
                    self.rows[(c, state)] *= factor;
                }
            }
        }
    }

    /// Before an accepted measurement: (I − K h')' [L, W] with − h e'/S in L and a new column h/√S in W.
    ///
    /// 1 − K h is taken first where a state is on both sides: behind a wide prior it is a small difference.
    fn back_through_measurement(&mut self, channel: usize, gain: &[f64], e: &[f64], total: f64) {
        let Self { rows, end, live_rows, moved, used, .. } = self;
        let (entries, n) = (&live_rows[channel], rows.width());
        let gain = &gain[..*end];
        moved.resize(entries.len(), 0.0);
        for v in rows.elements_mut().chunks_exact_mut(n).take(*used) {
            let whole = product(gain, v);
            for (out, entry) in moved.iter_mut().zip(entries) {
                let s = entry.state;
                // Summed without the state itself where it counts: never as a difference.
                let rest = if gain[s] * v[s] == 0.0 {
                    whole
                } else {
                    let before = product(&gain[..s], v);
                    gain[s + 1..].iter().zip(&v[s + 1..]).fold(before, |sum, (a, b)| sum + a * b)
                };
                *out = (1.0 - gain[s] * entry.factor) * v[s] - entry.factor * rest;
            }
            for (&value, entry) in moved.iter().zip(entries) {
                v[entry.state] = value;
            }
        }
        rows.row_mut(*used).fill(0.0);
        let root = total.sqrt();
        for entry in entries {
            for (c, &error) in e.iter().enumerate() {
                rows[(c, entry.state)] -= entry.factor * error / total;
            }
            rows[(*used, entry.state)] = entry.factor / root;
        }
        *used += 1;
        if self.used >= self.columns + 2 * self.live.len() {
            self.narrow();
        }
    }

    /// Before the datum was copied from the displacement.
    fn back_through_datum(&mut self, counting: &Counting) {
        let Some(datum) = &counting.model.datum else { return };
        for (a, &d) in datum.iter().enumerate() {
            for c in 0..self.used {
                let own = self.rows[(c, d)];
                self.rows[(c, motion_of(a))] += own;
                if let Some((zero, _)) = &counting.common[a] {
                    self.rows[(c, *zero)] -= own;
                }
                self.rows[(c, d)] = 0.0;
            }
        }
    }

    /// Rotates the columns of W to as many as there are live states; W W' stays. By Householder's reflections, to a lower
    /// triangle.
    fn narrow(&mut self) {
        let Self { rows, live, columns, used, .. } = self;
        let (first, end) = (*columns, *used);
        for begin in first..(first + live.len()).min(end) {
            let j = live[begin - first];
            let mut square: f64 = (begin..end).map(|c| rows[(c, j)] * rows[(c, j)]).sum();
            if square == 0.0 {
                continue;
            }
            let pivot = if rows[(begin, j)] > 0.0 { -square.sqrt() } else { square.sqrt() };
            rows[(begin, j)] -= pivot;
            square = (begin..end).map(|c| rows[(c, j)] * rows[(c, j)]).sum();
            for &i in &live[begin - first + 1..] {
                let dot: f64 = (begin..end).map(|c| rows[(c, j)] * rows[(c, i)]).sum::<f64>() * 2.0 / square;
                for c in begin..end {
                    let own = rows[(c, j)];
                    rows[(c, i)] -= dot * own;
                }
            }
            rows[(begin, j)] = pivot;
            for c in begin + 1..end {
                rows[(c, j)] = 0.0;
            }
        }
        *used = (first + live.len()).min(end);
    }

    /// Smoothed displacement, its variance and the velocity of one axis at a sample.
    fn smoothed(&mut self, way: &WayBack, k: usize, a: usize, counting: &Counting) -> Mixed {
        let (columns, n) = (way.columns, way.size);
        let stride = 2 * (columns + n);
        let node = &way.nodes[(k * way.axes + a) * stride..(k * way.axes + a + 1) * stride];
        let (places, rest) = node.split_at(columns);
        let (speeds, covariances) = rest.split_at(columns);
        let (mut pc, mut pv) = covariances.split_at(n);
        let datum = counting.model.datum.as_ref().map(|datum| datum[a]);
        let filtered = pc[motion_of(a)] - datum.map_or(0.0, |d| pc[d]);
        if counting.counts() {
            for (out, own) in [(&mut self.pc, pc), (&mut self.pv, pv)] {
                out.copy_from_slice(own);
                counting.count(out);
            }
            (pc, pv) = (&self.pc, &self.pv);
        }
        (pc, pv) = (&pc[..self.end], &pv[..self.end]);
        let (mut value, mut velocity, mut known) = (0.0, 0.0, 0.0);
        for c in 0..columns {
            let row = self.rows.row(c);
            let share = if c == 0 { 1.0 } else { counting.last.parameters[c - 1] };
            let place = places[c] - product(pc, row);
            self.sensitivity[c] = place;
            value += place * share;
            velocity += (speeds[c] - product(pv, row)) * share;
        }
        for row in self.rows.elements().chunks_exact(n).take(self.used).skip(columns) {
            let met = product(pc, row);
            known += met * met;
        }
        let uncertain = quadratic(&self.sensitivity[1..], &counting.last.spread);
        let variance = counting.model.misfit[a] * (filtered - known).max(MIN_VARIANCE_SHARE * filtered) + uncertain;
        Mixed { value, variance: variance.max(counting.least[a]) + counting.model.unseen_m2[a], velocity }
    }
}

/// Σ of the products of elements, as far as the first vector goes.
#[inline(always)]
fn product(v: &[f64], row: &[f64]) -> f64 {
    v.iter().zip(row).map(|(a, b)| a * b).sum()
}
