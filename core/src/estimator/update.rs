//! The update of states and covariance by a measurement's row, and what changes single states.

use super::hypothesis::Hypothesis;
use super::layout::{Layout, State, motion_of};
use super::matrix::Matrix;
use super::row::Row;
use super::slow::{SlowError, Turn};

/// h' P h of a row; P h goes to `ph` (n,).
#[inline]
pub fn project(p: &Matrix, row: &Row, ph: &mut [f64]) -> f64 {
    let Some((first, others)) = row.entries.split_first() else {
        ph.fill(0.0);
        return 0.0;
    };
    // P is symmetric: its rows are its columns.
    for (out, &element) in ph.iter_mut().zip(p.row(first.state)) {
        *out = first.factor * element;
    }
    for entry in others {
        if p[(entry.state, entry.state)] != 0.0 {
            for (out, &element) in ph.iter_mut().zip(p.row(entry.state)) {
                *out += entry.factor * element;
            }
        }
    }
    row.of(ph)
}

/// Takes a measurement: X += K e', P − K S K'; `gain` (n,) holds P h before, K after.
#[inline]
pub fn update(x: &mut Matrix, p: &mut Matrix, gain: &mut [f64], e: &[f64], total: f64) {
    let n = gain.len();
    for (i, own) in gain.iter_mut().enumerate() {
        // Of a state that is known for certain nothing is estimated.
        if *own != 0.0 {
            *own /= total;
            for (value, &error) in x.row_mut(i).iter_mut().zip(e) {
                *value += *own * error;
            }
        }
    }
    for i in 0..n {
        if gain[i] != 0.0 {
            let scaled = gain[i] * total;
            for j in (i..n).filter(|&j| gain[j] != 0.0) {
                let value = p[(i, j)] - scaled * gain[j];
                p.set_both(i, j, value);
            }
        }
    }
}

/// Takes the first measurement of a channel of whose zero nothing is known: what it differs by is the zero.
///
/// It is the limit of [`update`] for an endless variance of that state, which would leave nothing of the others in
/// double precision; zero: the state's place; own: the measurement's variance. `gain` (n,) holds K after.
pub fn begin_zero(x: &mut Matrix, p: &mut Matrix, row: &Row, zero: usize, gain: &mut [f64], (e, own): (&[f64], f64)) {
    let g = row.units_per_m;
    p.scale_both(zero, 0.0);
    let known = project(p, row, gain);
    for (j, &element) in gain.iter().enumerate() {
        p.set_both(zero, j, -element / g);
    }
    p[(zero, zero)] = (known + own) / (g * g);
    gain.fill(0.0);
    gain[zero] = 1.0 / g;
    for (value, &error) in x.row_mut(zero).iter_mut().zip(e) {
        *value += error / g;
    }
}

/// The datum of each axis becomes a copy of its displacement.
pub fn set_datum(x: &mut Matrix, p: &mut Matrix, layout: &Layout) {
    for a in 0..layout.axes() {
        let i = motion_of(a);
        let Some(d) = layout.place(State::Datum(a)) else { continue };
        x.copy_row(i, d);
        p.copy_row(i, d);
        for j in 0..layout.size() {
            p[(j, d)] = p[(j, i)];
        }
        p[(d, d)] = p[(i, i)];
    }
}

/// A state times a factor: 0 makes it known to be 0.
pub fn scale_state(x: &mut Matrix, p: &mut Matrix, i: usize, factor: f64) {
    for value in x.row_mut(i) {
        *value *= factor;
    }
    p.scale_both(i, factor);
}

/// A slow error goes on for some time: what is left of it, and as much new variance as keeps it alike.
pub fn carry_slow(x: &mut Matrix, p: &mut Matrix, slow: &SlowError, lapse_s: f64) -> Turn {
    let (i, turn) = (slow.place, slow.after(lapse_s));
    let [new, both, other] = turn.added().map(|part| part * slow.variance_m2);
    p[(i, i)] = match slow.velocity {
        None => {
            scale_state(x, p, i, turn.left());
            p[(i, i)] + new
        }
        Some(q) => {
            for column in 0..x.width() {
                (x[(i, column)], x[(q, column)]) = turn.of(x[(i, column)], x[(q, column)]);
            }
            p.turn_both((i, q), turn);
            p[(q, q)] += other;
            p[(i, q)] += both;
            p[(q, i)] += both;
            p[(i, i)] + new
        }
    };
    turn
}

/// Brings the reference's state `i` from one variance (m²) to another; returns the factor that it is scaled by.
///
/// A farther reference adds an error of its own; a nearer one is without what was added since: of an error that is a
/// sum of independent steps, the part up to a variance `now` is now / was of it on the mean, and as uncertain as a
/// Brownian bridge there. So the first reference again is exact, and a variance that goes up and down tells nothing of
/// the error's size.
pub fn move_reference(x: &mut Matrix, p: &mut Matrix, i: usize, was: f64, now: f64) -> f64 {
    if now < was {
        let factor = now / was;
        scale_state(x, p, i, factor);
        p[(i, i)] += now * (1.0 - factor);
        return factor;
    }
    p[(i, i)] += now - was;
    1.0
}

/// Begins a parameter anew, of which only its variance is known: what the one before was estimated to be goes into the
/// states, and how uncertain that was into their covariance.
pub fn renew_parameter(hyp: &mut Hypothesis, q: usize, variance: f64) {
    let (n, before, value) = (hyp.p.width(), hyp.spread[(q, q)], hyp.parameters[q]);
    let moved: Vec<f64> = (0..n).map(|i| hyp.x[(i, 1 + q)]).collect();
    for i in 0..n {
        for j in 0..n {
            hyp.p[(i, j)] += before * moved[i] * moved[j];
        }
        hyp.x[(i, 0)] += value * moved[i];
        hyp.x[(i, 1 + q)] = 0.0;
    }
    hyp.spread.scale_both(q, 0.0);
    hyp.spread[(q, q)] = variance;
    hyp.parameters[q] = 0.0;
    hyp.clear_tests();
}

/// Lets a parameter count from what it has come to: the states and what is measured hold the rest (A. Gelb, Applied
/// optimal estimation, MIT Press 1974, section 6.1: relinearisation); nothing is forgotten.
pub fn relinearise(hyp: &mut Hypothesis, q: usize, by: f64) {
    for i in 0..hyp.p.width() {
        hyp.x[(i, 0)] += by * hyp.x[(i, 1 + q)];
    }
    hyp.parameters[q] -= by;
    hyp.clear_tests();
}

/// Lets an axis' motion from state `i` on be that of an instant some time later or earlier (s); usual: standard deviation
/// of its displacement (m) and middle angular frequency (1/s).
pub fn move_motion(p: &mut Matrix, i: usize, usual: &(f64, f64), moved_s: f64) {
    let variance = moved_m2(usual, moved_s);
    p[(i, i)] += variance;
    p[(i + 1, i + 1)] += usual.1 * usual.1 * variance;
}

/// Mean square (m²) of what a motion goes in some time (s).
pub fn moved_m2(&(std_m, rate_s): &(f64, f64), moved_s: f64) -> f64 {
    // The correlation of a smooth motion over so short a time.
    -2.0 * std_m * std_m * (-0.5 * (rate_s * moved_s).powi(2)).exp_m1()
}
