//! The pass back over what the filter left of a block: what was measured later corrects what was found before.
//!
//! It is the modified Bryson-Frazier smoother (G. J. Bierman, Fixed interval smoothing with discrete measurements, Int.
//! J. Control 18 (1973) 65-75): it carries an adjoint L and its information M, needs no inverse, and what only adds
//! variance to a state leaves it as it is. M is carried as a factor W, M = W W': what later measurements say of a
//! combination of states that was widely uncertain is a small difference of what they say of each. L and W are carried
//! from measurement to measurement; at a sample between, its covariances P with all states are moved on to the later
//! one, Φ P.

use super::decided::Decided;
use super::hypothesis::Hypothesis;
use super::innovation::Mixed;
use super::layout::{MOTION_STATES, motion_of};
#[cfg(test)]
use super::matrix::Matrix;
use super::matrix::{quadratic, squared};
use super::model::Model;
use super::predict::move_on;
use super::row::Entry;
use super::rows::zero_variance;
use super::slow::Turn;
use super::way_back::{Recorded, WayBack};
use std::ops::Range;

/// A smoothed variance is no smaller than this share of the filtered one: beyond it rounding speaks.
const MIN_VARIANCE_SHARE: f64 = 1e-12;

/// The processor takes this many elements of a row together.
const LANES: usize = 8;

/// What later measurements say: of each state its elements of L and W, side by side, (n, 1 + k + 2 n); of live states
/// those that are not used are 0.
#[derive(Clone, Debug)]
pub struct Adjoint {
    rows: Vec<[f64; LANES]>,
    /// How many lanes a row takes.
    width: usize,
    columns: usize,
    /// How many elements of each row are used.
    used: usize,
    /// States that are uncertain as they are counted.
    live: Vec<usize>,
    unknown: Vec<bool>,
    /// As of the block before.
    uncertain: Vec<bool>,
    /// Each channel's row, of live states alone.
    live_rows: Vec<Vec<Entry>>,
    /// To work with.
    moved: Vec<[f64; LANES]>,
    gain: Vec<f64>,
    pc: Vec<f64>,
    pv: Vec<f64>,
    met: Vec<[f64; LANES]>,
    sensitivity: Vec<f64>,
    /// Variance (axes,) of the datum at the record's end, which no row is more certain than.
    least: Vec<f64>,
    /// The parameters (k,), those of the record's end until one is begun anew.
    parameters: Vec<f64>,
    /// Whether no measurement of later agrees with the accelerometer's clock: none was accepted, or one stepped before it.
    doubts_clock: bool,
}

impl Adjoint {
    /// Nothing comes later.
    pub fn nothing(model: &Model) -> Self {
        let (n, columns) = (model.size(), model.columns());
        let width = (columns + 2 * n + 1).div_ceil(LANES);
        Self {
            rows: vec![[0.0; LANES]; n * width],
            width,
            columns,
            used: columns,
            live: Vec::new(),
            unknown: Vec::new(),
            uncertain: Vec::new(),
            live_rows: Vec::new(),
            moved: vec![[0.0; LANES]; n * width],
            gain: vec![0.0; n],
            pc: vec![0.0; n],
            pv: vec![0.0; n],
            met: vec![[0.0; LANES]; width],
            sensitivity: vec![0.0; columns],
            least: Vec::new(),
            parameters: Vec::new(),
            doubts_clock: true,
        }
    }

    /// Nothing comes later, in the memory that it has; recounted: the states are counted otherwise now.
    pub fn restart(&mut self, recounted: bool) {
        self.rows.fill([0.0; LANES]);
        self.used = self.columns;
        self.parameters.clear();
        self.doubts_clock = true;
        if recounted {
            self.live_rows.clear();
        }
    }

    /// L and W, a row for each state.
    #[cfg(test)]
    pub fn rows(&self) -> Matrix {
        let mut whole = Matrix::zeros(self.gain.len(), self.width * LANES);
        whole.elements_mut().copy_from_slice(self.rows.as_flattened());
        whole
    }

    /// Runs back over a block; smoothed: takes the rows (samples · axes) of the wanted samples.
    pub fn pass(&mut self, way: &WayBack, view: &Counted, wanted: Range<usize>, smoothed: &mut Vec<Mixed>) {
        self.find_live(way, view.counting);
        if self.parameters.is_empty() {
            self.parameters.clone_from(&view.last.parameters);
        }
        self.least.clear();
        self.least.extend((0..way.axes).map(|a| zero_variance(view.last, a, view.model)));
        if self.used >= self.columns + 2 * self.live.len() {
            self.narrow();
        }
        let axes = way.axes;
        smoothed.clear();
        smoothed.resize(wanted.len() * axes, Mixed { value: 0.0, variance: 0.0, velocity: 0.0 });
        let mut next = way.records.len();
        let mut at_s = way.time_s.last().copied().unwrap_or(way.start_s);
        let mut span = usize::MAX;
        for k in wanted.clone().rev() {
            next = self.back_through_all(way, (next, k + 1), &mut at_s, view);
            span = way.span_of(k, span);
            for a in 0..axes {
                smoothed[(k - wanted.start) * axes + a] = self.smoothed(way, (span, k, a), at_s - way.time_s[k], view);
            }
        }
        self.back_through_all(way, (next, 0), &mut at_s, view);
        self.back_to(way.start_s, &mut at_s, axes);
    }

    /// Carries the adjoint back through the items before item `next` in the intervals of samples from `first` on;
    /// returns the number of the first of them.
    fn back_through_all(
        &mut self,
        way: &WayBack,
        (mut next, first): (usize, usize),
        at_s: &mut f64,
        view: &Counted,
    ) -> usize {
        while next > 0 && way.records[next - 1].sample >= first {
            next -= 1;
            self.back_to(way.records[next].at_s, at_s, way.axes);
            self.back_through(way, next, view);
        }
        next
    }

    /// Finds the states that are uncertain as the pass back counts them.
    ///
    /// A state that is certain in all of the block is so before it too, until a measurement whose record scales it by
    /// 0: its adjoint is of no weight.
    fn find_live(&mut self, way: &WayBack, counting: &Counting) {
        if self.live_rows.len() == counting.rows.len() && way.uncertain == self.uncertain {
            return;
        }
        self.uncertain.clone_from(&way.uncertain);
        self.unknown.clear();
        self.unknown.extend(way.uncertain.iter().zip(&counting.counted).map(|(&one, &counted)| one || counted));
        let unknown = &self.unknown;
        self.live.clear();
        self.live.extend((0..unknown.len()).filter(|&j| unknown[j]));
        let alive = |row: &Vec<Entry>| row.iter().copied().filter(|one| unknown[one.state]).collect();
        self.live_rows = counting.rows.iter().map(alive).collect();
    }

    /// Φ' times L and W, from one instant to an earlier one.
    #[inline]
    fn back_to(&mut self, to_s: f64, at_s: &mut f64, axes: usize) {
        let dt = *at_s - to_s;
        if dt <= 0.0 {
            return;
        }
        *at_s = to_s;
        let (half, width, taken) = (0.5 * dt * dt, self.width, self.used.div_ceil(LANES));
        for motion in self.rows.chunks_exact_mut(MOTION_STATES * width).take(axes) {
            let (places, rest) = motion.split_at_mut(width);
            let (speeds, biases) = rest.split_at_mut(width);
            for ((places, speeds), biases) in places[..taken].iter().zip(speeds).zip(biases) {
                for ((x, v), b) in places.iter().zip(speeds).zip(biases) {
                    *b -= half * x + dt * *v;
                    *v += dt * x;
                }
            }
        }
    }

    /// Carries the adjoint back through an item.
    fn back_through(&mut self, way: &WayBack, place: usize, view: &Counted) {
        let (channel, total, scaled) = match way.records[place].what {
            Recorded::Doubt => return,
            Recorded::ClockStep { parameter, value } => return self.back_through_clock_step(parameter, value),
            Recorded::Relinearised { parameter, by } => return self.back_through_relinearised(parameter, by),
            Recorded::Datum => return self.back_through_datum(view),
            Recorded::Measured { channel, total, scaled } => (channel, total, scaled),
        };
        if let Some(total) = total {
            self.doubts_clock = false;
            let stride = way.columns + way.size;
            let (e, gain) = way.details[place * stride..(place + 1) * stride].split_at(way.columns);
            if view.counting.counts() {
                let mut counted = std::mem::take(&mut self.gain);
                counted.copy_from_slice(gain);
                view.counting.count(&mut counted);
                self.back_through_measurement(channel, &counted, e, total);
                self.gain = counted;
            } else {
                self.back_through_measurement(channel, gain, e, total);
            }
        }
        let (model, width) = (&view.model.channels[channel], self.width);
        let rows = &mut self.rows;
        let scale = |rows: &mut [[f64; LANES]], state: usize, factor: f64| {
            if factor != 1.0 {
                let row = rows[state * width..(state + 1) * width].as_flattened_mut();
                row.iter_mut().for_each(|value| *value *= factor);
            }
        };
        scale(rows, model.reference, scaled.reference);
        let shift = (model.shift, model.reverting.and_then(|one| one.velocity), scaled.shift);
        let slow = model.slow.map(|one| (one.place, one.velocity, scaled.slow));
        for (place, velocity, turn) in std::iter::once(shift).chain(slow).filter(|one| one.2 != Turn::NONE) {
            match velocity {
                None => scale(rows, place, turn.left()),
                Some(velocity) => turn_rows(rows, (place * width, velocity * width), turn.back(), width),
            }
        }
    }

    /// Before an accepted measurement: (I − K h')' [L, W] with − h e'/S in L and a new column h/√S in W.
    ///
    /// 1 − K h is taken first where a state is on both sides: behind a wide prior it is a small difference.
    fn back_through_measurement(&mut self, channel: usize, gain: &[f64], e: &[f64], total: f64) {
        let Self { rows, width, live, live_rows, moved, used, .. } = self;
        let (entries, width, taken) = (&live_rows[channel], *width, used.div_ceil(LANES));
        for (entry, out) in entries.iter().zip(moved.chunks_exact_mut(width)) {
            for (lanes, out) in out[..taken].iter_mut().enumerate() {
                // Summed without the state itself: never as a difference.
                let mut rest = [0.0; LANES];
                for &j in live.iter().filter(|&&j| j != entry.state) {
                    add_times(&mut rest, &rows[j * width + lanes], gain[j]);
                }
                *out = rest;
            }
        }
        for (entry, rest) in entries.iter().zip(moved.as_flattened().chunks_exact(width * LANES)) {
            let share = 1.0 - gain[entry.state] * entry.factor;
            let row = rows[entry.state * width..(entry.state + 1) * width].as_flattened_mut();
            for (value, rest) in row[..taken * LANES].iter_mut().zip(rest) {
                *value = share * *value - entry.factor * rest;
            }
        }
        let (rows, width, root) = (rows.as_flattened_mut(), width * LANES, total.sqrt());
        rows.iter_mut().skip(*used).step_by(width).for_each(|value| *value = 0.0);
        for entry in entries {
            let row = &mut rows[entry.state * width..(entry.state + 1) * width];
            for (value, &error) in row.iter_mut().zip(e) {
                *value -= entry.factor * error / total;
            }
            row[*used] = entry.factor / root;
        }
        *used += 1;
        if self.used >= self.columns + 2 * self.live.len() {
            self.narrow();
        }
    }

    /// Before a clock's offset was begun anew: what comes later says nothing of the one before.
    fn back_through_clock_step(&mut self, parameter: usize, value: f64) {
        (self.parameters[parameter], self.doubts_clock) = (value, true);
        let (rows, width) = (self.rows.as_flattened_mut(), self.width * LANES);
        rows.iter_mut().skip(1 + parameter).step_by(width).for_each(|value| *value = 0.0);
    }

    /// Before a parameter counted from another value: innovations are counted from the value before.
    fn back_through_relinearised(&mut self, parameter: usize, by: f64) {
        self.parameters[parameter] += by;
        let (rows, width) = (self.rows.as_flattened_mut(), self.width * LANES);
        rows.chunks_exact_mut(width).for_each(|row| row[0] -= by * row[1 + parameter]);
    }

    /// Before the datum was copied from the displacement.
    fn back_through_datum(&mut self, view: &Counted) {
        let Some(datum) = &view.model.datum else { return };
        let (rows, width) = (self.rows.as_flattened_mut(), self.width * LANES);
        for (a, &d) in datum.iter().enumerate() {
            for c in 0..self.used {
                let own = std::mem::take(&mut rows[d * width + c]);
                rows[motion_of(a) * width + c] += own;
                if let Some((zero, _)) = &view.counting.common[a] {
                    rows[zero * width + c] -= own;
                }
            }
        }
    }

    /// Rotates the columns of W to as many as there are live states; W W' stays. By Householder's reflections, to a
    /// lower triangle.
    fn narrow(&mut self) {
        let Self { rows, width, live, columns, used, .. } = self;
        let (rows, width, first, end) = (rows.as_flattened_mut(), *width * LANES, *columns, *used);
        for begin in first..(first + live.len()).min(end) {
            let (j, later) = (live[begin - first] * width, &live[begin - first + 1..]);
            let square = squared(&rows[j + begin..j + end]);
            if square == 0.0 {
                continue;
            }
            let pivot = if rows[j + begin] > 0.0 { -square.sqrt() } else { square.sqrt() };
            rows[j + begin] -= pivot;
            let square = squared(&rows[j + begin..j + end]);
            for i in later.iter().map(|i| i * width) {
                let dot = 2.0 * (begin..end).map(|c| rows[j + c] * rows[i + c]).sum::<f64>() / square;
                for c in begin..end {
                    rows[i + c] -= dot * rows[j + c];
                }
            }
            rows[j + begin..j + end].fill(0.0);
            rows[j + begin] = pivot;
        }
        *used = (first + live.len()).min(end);
    }

    /// Smoothed displacement, its variance and the velocity of one axis at a sample of a span; ahead: how much later
    /// (s) than the sample the adjoint is.
    fn smoothed(&mut self, way: &WayBack, (span, k, a): (usize, usize, usize), ahead: f64, view: &Counted) -> Mixed {
        let Counted { model, counting, last } = view;
        let Self { rows, width, columns, used, live, pc, pv, met, sensitivity, parameters, .. } = self;
        let (columns, used, width, node) = (*columns, *used, *width, way.node(span, k, a));
        // The filtered variance: of the displacement relative to the datum.
        let d = model.datum.as_ref().and_then(|datum| node.live.iter().position(|&j| j == datum[a]));
        let filtered = node.pc[motion_of(a)] - d.map_or(0.0, |d| node.pc[d]);
        let states: &[usize] = if counting.counts() { live } else { node.live };
        for (all, covariances) in [(&mut *pc, node.pc), (&mut *pv, node.pv)] {
            if counting.counts() {
                all.fill(0.0);
                node.live.iter().zip(covariances).for_each(|(&j, &c)| all[j] = c);
                move_on(&mut all[..MOTION_STATES * way.axes], ahead);
                counting.count(all);
                // Live states come in their order: each moves to its place among them.
                live.iter().enumerate().for_each(|(place, &j)| all[place] = all[j]);
            } else {
                all[..covariances.len()].copy_from_slice(covariances);
                move_on(&mut all[..MOTION_STATES * way.axes], ahead);
            }
        }
        for (lanes, met) in met[..used.div_ceil(LANES)].iter_mut().enumerate() {
            let mut sum = [0.0; LANES];
            for (&j, &c) in states.iter().zip(pc.iter()) {
                add_times(&mut sum, &rows[j * width + lanes], c);
            }
            *met = sum;
        }
        let (rows, met) = (rows.as_flattened(), met.as_flattened());
        let (mut value, mut velocity) = (0.0, 0.0);
        for c in 0..columns {
            let share = if c == 0 { 1.0 } else { parameters[c - 1] };
            let place = node.places[c] - met[c];
            sensitivity[c] = place;
            value += place * share;
            let moved: f64 = states.iter().zip(pv.iter()).map(|(&j, v)| v * rows[j * width * LANES + c]).sum();
            velocity += (node.speeds[c] - moved) * share;
        }
        let known = squared(&met[columns..used]);
        let uncertain = quadratic(&sensitivity[1..], &last.spread);
        let variance = model.misfit[a] * (filtered - known).max(MIN_VARIANCE_SHARE * filtered) + uncertain;
        let doubt_m2 = if self.doubts_clock { way.doubt_m2(k, a) } else { 0.0 };
        Mixed { value, variance: variance.max(self.least[a]) + model.unseen_m2[a] + doubt_m2, velocity }
    }
}

/// Turns the rows of the adjoint that begin at two places.
fn turn_rows(rows: &mut [[f64; LANES]], (first, second): (usize, usize), turn: Turn, width: usize) {
    for k in 0..width {
        let (mut one, mut other) = (rows[first + k], rows[second + k]);
        for (one, other) in one.iter_mut().zip(&mut other) {
            (*one, *other) = turn.of(*one, *other);
        }
        (rows[first + k], rows[second + k]) = (one, other);
    }
}

/// Adds elements times a factor.
#[inline(always)]
fn add_times(to: &mut [f64; LANES], elements: &[f64; LANES], factor: f64) {
    for (sum, one) in to.iter_mut().zip(elements) {
        *sum += factor * one;
    }
}

/// How the pass back counts the states, and by which parameters.
///
/// x becomes x + z of the channel that all of an axis count from, where its zero is unknown, and the zeros of the
/// others of which nothing is known become what they differ from it by. Until a known zero begins, x and those zeros
/// are only known relative to each other; so they are wide in one of the new states alone.
#[derive(Clone, Debug)]
pub struct Counting {
    /// Of each axis the zero that all count from, and the unknown zeros that are counted from it.
    pub(super) common: Vec<Option<(usize, Vec<usize>)>>,
    /// Each channel's row as the states are counted.
    pub(super) rows: Vec<Vec<Entry>>,
    /// States (n,) that are counted from another one or others from it: uncertain in any case.
    pub(super) counted: Vec<bool>,
}

/// What a pass back goes by.
#[derive(Clone, Copy, Debug)]
pub struct Counted<'a> {
    /// The model.
    pub model: &'a Model,
    /// How the states are counted.
    pub counting: &'a Counting,
    /// The filter at the record's end.
    pub last: &'a Hypothesis,
}

impl Counting {
    /// Before: the filter at the beginning of what was decided.
    pub fn new(model: &Model, before: &Hypothesis, parts: &[&Decided]) -> Self {
        let common: Vec<_> = (0..model.axes()).map(|a| common_zero(model, a, before, parts)).collect();
        let rows =
            model.channels.iter().map(|channel| counted_row(&channel.row.entries, channel.row.axis, &common)).collect();
        let mut counted = vec![false; model.size()];
        for (zero, others) in common.iter().flatten() {
            counted[*zero] = true;
            for &other in others {
                counted[other] = true;
            }
        }
        Self { common, rows, counted }
    }

    /// A vector (n,) of covariances or gains as the states are counted.
    #[inline]
    pub fn count(&self, v: &mut [f64]) {
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

    /// Whether it counts as it would after what was decided.
    pub fn holds(&self, model: &Model, before: &Hypothesis, parts: &[&Decided]) -> bool {
        self.common.iter().enumerate().all(|(a, common)| *common == common_zero(model, a, before, parts))
    }

    /// Whether any state is counted otherwise.
    pub fn counts(&self) -> bool {
        self.common.iter().any(Option::is_some)
    }
}

/// The unknown zero that an axis counts from on the way back, its first channel's, and the other unknown ones.
fn common_zero(model: &Model, a: usize, before: &Hypothesis, parts: &[&Decided]) -> Option<(usize, Vec<usize>)> {
    let own = |c: usize| model.channels[c].places && model.channels[c].row.axis == a;
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
