//! The pass back over what the filter left of a block: what was measured later corrects what was found before.
//!
//! It is the modified Bryson-Frazier smoother (G. J. Bierman, Fixed interval smoothing with discrete measurements, Int. J.
//! Control 18 (1973) 65-75): it carries an adjoint L and its information M, needs no inverse, and what only adds variance
//! to a state leaves it as it is. M is carried as a factor W, M = W W': what later measurements say of a combination of
//! states that was widely uncertain is a small difference of what they say of each.

use super::decided::Decided;
use super::hypothesis::Hypothesis;
use super::innovation::Mixed;
use super::layout::{MOTION_STATES, motion_of};
use super::matrix::{Matrix, quadratic};
use super::model::Model;
use super::row::Entry;
use super::rows::zero_variance;
use super::way_back::{Recorded, WayBack};

/// A smoothed variance is no smaller than this share of the filtered one: beyond it rounding speaks.
const MIN_VARIANCE_SHARE: f64 = 1e-12;

/// How the pass back counts the states, and by which parameters.
///
/// x becomes x + z of the channel that all of an axis count from, where its zero is unknown, and the zeros of the others of
/// which nothing is known become what they differ from it by. Until a known zero begins, x and those zeros are only known
/// relative to each other; so they are wide in one of the new states alone.
#[derive(Clone, Debug)]
pub struct Counting<'a> {
    model: &'a Model,
    last: &'a Hypothesis,
    /// Of each axis the zero that all count from, and the unknown zeros that are counted from it.
    common: Vec<Option<(usize, Vec<usize>)>>,
    /// Each channel's row as the states are counted.
    rows: Vec<Vec<Entry>>,
    /// States (n,) that are counted from another one or others from it: uncertain in any case.
    counted: Vec<bool>,
    /// Variance (axes,) of the datum at the end, which no row is more certain than.
    least: Vec<f64>,
}

impl<'a> Counting<'a> {
    /// Before: the filter at the beginning of what was decided; last: at the end.
    pub fn new(model: &'a Model, before: &Hypothesis, parts: &[&Decided], last: &'a Hypothesis) -> Self {
        let common: Vec<_> = (0..model.axes()).map(|a| common_zero(model, a, before, parts)).collect();
        let rows =
            model.channels.iter().map(|channel| counted_row(&channel.row.entries, channel.row.axis, &common)).collect();
        let least = (0..model.axes()).map(|a| zero_variance(last, a, model)).collect();
        let mut counted = vec![false; model.size()];
        for (zero, others) in common.iter().flatten() {
            counted[*zero] = true;
            for &other in others {
                counted[other] = true;
            }
        }
        Self { model, last, common, rows, counted, least }
    }

    /// A vector (n,) of covariances or gains as the states are counted.
    #[inline]
    fn count(&self, v: &mut [f64]) {
        for (a, common) in self.common.iter().enumerate() {
            if let Some((zero, others)) = common {
                let own = v[*zero];
                v[motion_of(a)] += own;
                for &other in others {
                    v[other] -= own;
                }
            }
        }
    }

    fn counts(&self) -> bool {
        self.common.iter().any(Option::is_some)
    }
}

/// The unknown zero that an axis counts from on the way back, its first channel's, and the other unknown ones.
fn common_zero(model: &Model, a: usize, before: &Hypothesis, parts: &[&Decided]) -> Option<(usize, Vec<usize>)> {
    let own = |c: usize| model.channels[c].row.axis == a;
    let begun = |c: &usize| own(*c) && before.marks[*c].begun;
    let known = |c: &usize| model.channels[*c].zero_variance.is_some();
    let all = || 0..model.channels.len();
    let met = || {
        let items = parts.iter().flat_map(|part| part.items.iter().zip(&part.decisions));
        items.filter(|(_, decision)| !decision.is_outlier()).filter_map(|(item, _)| item.channel()).find(|&c| own(c))
    };
    let first = all().filter(begun).find(known).or_else(|| all().find(begun)).or_else(met)?;
    if known(&first) {
        return None;
    }
    let others = all().filter(|&c| c != first && own(c) && !known(&c)).map(|c| model.channels[c].zero).collect();
    Some((model.channels[first].zero, others))
}

/// A row as the states are counted: x = x' − z, and the other unknown zeros are z' + z.
fn counted_row(entries: &[Entry], axis: usize, common: &[Option<(usize, Vec<usize>)>]) -> Vec<Entry> {
    let mut counted = entries.to_vec();
    let Some(Some((zero, others))) = common.get(axis) else { return counted };
    let place = motion_of(axis);
    let mut factor = 0.0;
    for entry in entries {
        if entry.state == *zero || others.contains(&entry.state) {
            factor += entry.factor;
        } else if entry.state == place {
            factor -= entry.factor;
        }
    }
    counted.retain(|one| one.state != *zero);
    if factor != 0.0 {
        counted.push(Entry { state: *zero, factor });
    }
    counted
}

/// What later measurements say: L and W as rows, (1 + k + 2 n, n).
#[derive(Clone, Debug)]
pub struct Adjoint {
    rows: Matrix,
    columns: usize,
    /// How many rows are used.
    used: usize,
    /// States that are uncertain as they are counted.
    live: Vec<usize>,
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

    /// Runs back over a block; found: takes the smoothed rows (samples · axes), where they are wanted.
    pub fn pass(&mut self, way: &WayBack, counting: &Counting, mut found: Option<&mut Vec<Mixed>>) {
        self.find_live(way, counting);
        if self.used >= self.columns + 2 * self.live.len() {
            self.narrow();
        }
        let axes = way.axes;
        if let Some(found) = found.as_deref_mut() {
            found.clear();
            found.resize(way.len() * axes, Mixed { value: 0.0, variance: 0.0, velocity: 0.0 });
        }
        let mut next = way.records.len();
        let mut at_s = way.time_s.last().copied().unwrap_or(way.start_s);
        if let Some(found) = found {
            for k in (0..way.len()).rev() {
                for a in 0..axes {
                    found[k * axes + a] = self.smoothed(way, k, a, counting);
                }
                while next > 0 && way.records[next - 1].sample == k {
                    next -= 1;
                    self.back_to(way.records[next].at_s, &mut at_s, axes);
                    self.back_through(way, next, counting);
                }
                let before_s = if k > 0 { way.time_s[k - 1] } else { way.start_s };
                self.back_to(before_s, &mut at_s, axes);
            }
            return;
        }
        for place in (0..next).rev() {
            self.back_to(way.records[place].at_s, &mut at_s, axes);
            self.back_through(way, place, counting);
        }
        self.back_to(way.start_s, &mut at_s, axes);
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
            let mut own = std::mem::take(&mut self.gain);
            own.copy_from_slice(gain);
            counting.count(&mut own);
            self.back_through_measurement(channel, &own, e, total);
            self.gain = own;
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
        let Self { rows, live, live_rows, moved, used, .. } = self;
        let entries = &live_rows[channel];
        moved.resize(entries.len(), 0.0);
        for c in 0..*used {
            let v = rows.row_mut(c);
            let whole: f64 = live.iter().map(|&j| gain[j] * v[j]).sum();
            for (out, entry) in moved.iter_mut().zip(entries) {
                let s = entry.state;
                // Summed without the state itself where it counts: never as a difference.
                let rest = if gain[s] * v[s] == 0.0 {
                    whole
                } else {
                    live.iter().filter(|&&j| j != s).map(|&j| gain[j] * v[j]).sum()
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
        let live = &self.live;
        let on = |v: &[f64], row: &[f64]| -> f64 { live.iter().map(|&j| v[j] * row[j]).sum() };
        let (mut value, mut velocity, mut known) = (0.0, 0.0, 0.0);
        for c in 0..columns {
            let row = self.rows.row(c);
            let share = if c == 0 { 1.0 } else { counting.last.parameters[c - 1] };
            let place = places[c] - on(pc, row);
            self.sensitivity[c] = place;
            value += place * share;
            velocity += (speeds[c] - on(pv, row)) * share;
        }
        for c in columns..self.used {
            let met = on(pc, self.rows.row(c));
            known += met * met;
        }
        let uncertain = quadratic(&self.sensitivity[1..], &counting.last.spread);
        let variance = counting.model.misfit[a] * (filtered - known).max(MIN_VARIANCE_SHARE * filtered) + uncertain;
        Mixed { value, variance: variance.max(counting.least[a]) + counting.model.unseen_m2[a], velocity }
    }
}
