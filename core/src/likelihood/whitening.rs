//! Innovations of any number of columns of measurements through one filter.
//!
//! A filter with the states x, v, b and no input whitens what is left of a translation when the acceleration's response
//! is taken out; gains and covariance depend on no column, so one run whitens all of them. It steps from measurement to
//! measurement: nothing is resampled. Kailath, "An innovations approach to least-squares estimation", IEEE TAC 13
//! (1968).

use super::covariance::{Covariance, Motion, WithSlowError};
use crate::estimator::slow::Turn;

/// Before the first measurements everything is unknown: a variance far above any noise, in units of the noise variance.
pub const DIFFUSE: f64 = 1e9;
/// The bias walk that belongs to an acceleration noise, (rad/s)²: bias errors below 0.01 Hz are left to the
/// displacement.
pub const BIAS_WALK_RATIO: f64 = 0.003;
/// Longest step of the covariance, s: within it the walk of the bias reaches the displacement by 1 % of the noise's
/// part.
pub const MAX_STEP_S: f64 = 5.0;

/// The noises of a run.
pub struct Noise<'a> {
    /// Times (s) until which the acceleration's relative noise density is constant, and that density.
    pub pieces: &'a [[f64; 2]],
    /// Density of the acceleration's noise times s² in units of the noise variance, where the relative density is 1.
    pub density: f64,
    /// Variance of the measurements' slow error in units of the noise variance, the rate (1/s) at which it forgets and
    /// the angular frequency (rad/s) of an oscillator, else 0; None: there is none.
    pub slow: Option<[f64; 3]>,
}

/// What a run leaves.
pub struct Innovations {
    /// Innovations (m, c), row by row.
    pub values: Vec<f64>,
    /// Their variances (m,), in units of the noise variance.
    pub variance: Vec<f64>,
    /// What of each (m,) the acceleration's noise makes.
    pub input_part: Vec<f64>,
    /// The bias (c,) at the end of the pieces.
    pub bias: Vec<f64>,
    /// Its variance.
    pub bias_variance: f64,
}

/// What a run leaves of the sums over rows, each divided by the variance of its innovation.
pub struct Products {
    /// Of the squares of each column (c,).
    pub squares: Vec<f64>,
    /// Of each column's products with the first one (c,).
    pub with_first: Vec<f64>,
    /// Of each column's products with the one `apart` columns after it (c − apart,); without `apart` there are none.
    pub with_later: Vec<f64>,
    /// As of [`Innovations`].
    pub variance: Vec<f64>,
    /// As of [`Innovations`].
    pub input_part: Vec<f64>,
}

/// Whiten columns (m, c) of values, row by row, at `rows` (m,) of time (s) and relative variance.
///
/// `longer` (m, c) or empty: what is added to a column's step up to a row, s.
pub fn whiten(noise: &Noise, rows: &[[f64; 2]], mut values: Vec<f64>, longer: &[f64]) -> Innovations {
    let count = if rows.is_empty() { 0 } else { values.len() / rows.len() };
    let (mut variance, mut input_part) = (Vec::with_capacity(rows.len()), Vec::with_capacity(rows.len()));
    let end = run_any(noise, rows, count, longer, |j, gain, update| {
        update(&mut values[j * count..(j + 1) * count]);
        variance.push(gain.total);
        input_part.push(gain.input_part);
    });
    Innovations { values, variance, input_part, bias: end.bias, bias_variance: end.bias_variance }
}

/// Whiten columns as [`whiten`] does, and sum up their products from the row `first` on.
pub fn products(noise: &Noise, rows: &[[f64; 2]], values: &[f64], apart: usize, first: usize) -> Products {
    let count = if rows.is_empty() { 0 } else { values.len() / rows.len() };
    let mut row = vec![0.0; count];
    let (mut squares, mut with_first) = (vec![0.0; count], vec![0.0; count]);
    let mut with_later = vec![0.0; if apart == 0 { 0 } else { count.saturating_sub(apart) }];
    let (mut variance, mut input_part) = (Vec::with_capacity(rows.len()), Vec::with_capacity(rows.len()));
    run_any(noise, rows, count, &[], |j, gain, update| {
        row.copy_from_slice(&values[j * count..(j + 1) * count]);
        update(&mut row);
        variance.push(gain.total);
        input_part.push(gain.input_part);
        if j < first || count == 0 {
            return;
        }
        let scale = gain.total.sqrt().recip();
        row.iter_mut().for_each(|value| *value *= scale);
        let lead = row[0];
        for ((square, product), value) in squares.iter_mut().zip(&mut with_first).zip(&row) {
            *square += value * value;
            *product += lead * value;
        }
        for ((product, value), later) in with_later.iter_mut().zip(&row).zip(row.iter().skip(apart)) {
            *product += value * later;
        }
    });
    Products { squares, with_first, with_later, variance, input_part }
}

/// Of a row: the variance of its innovation, and what of it the acceleration's noise makes.
struct AtRow {
    total: f64,
    input_part: f64,
}

/// The bias (c,) at the end of the pieces, and its variance.
struct End {
    bias: Vec<f64>,
    bias_variance: f64,
}

/// `each` has a row's number and what makes the row's values its innovations.
fn run_any(
    noise: &Noise,
    rows: &[[f64; 2]],
    count: usize,
    longer: &[f64],
    each: impl FnMut(usize, AtRow, &mut dyn FnMut(&mut [f64])),
) -> End {
    let motion = Motion::of([DIFFUSE; 3]);
    match noise.slow {
        Some([variance, ..]) => {
            let state = (WithSlowError::of(motion, variance), WithSlowError::default());
            run(noise, rows, Columns::at_rest(count), longer, state, each)
        }
        None => run(noise, rows, Columns::at_rest(count), longer, (motion, Motion::default()), each),
    }
}

/// `state`: the covariance, and the part of it that the acceleration's noise alone makes.
fn run<C: Covariance>(
    noise: &Noise,
    rows: &[[f64; 2]],
    mut columns: Columns,
    longer: &[f64],
    state: (C, C),
    mut each: impl FnMut(usize, AtRow, &mut dyn FnMut(&mut [f64])),
) -> End {
    let (mut state, mut of_input) = state;
    let count = columns.x.len();
    let mut reached = rows.first().map_or(0.0, |row| row[0]);
    let mut steps = Steps { pieces: noise.pieces, piece: 0, reached };
    let mut advance = |until: f64, state: &mut C, of_input: &mut C| {
        while let Some((dt, density)) = steps.next(until) {
            let (density, walk) = (noise.density * density, noise.density * BIAS_WALK_RATIO);
            state.predict(dt, density, walk);
            of_input.predict(dt, density, walk);
        }
    };
    for (j, &[time_s, relative]) in rows.iter().enumerate() {
        let lapse = time_s - reached;
        reached = time_s;
        advance(time_s, &mut state, &mut of_input);
        columns.predict(lapse, longer.get(j * count..(j + 1) * count).filter(|longer| !longer.is_empty()));
        let turn = noise.slow.map(|[slow_variance, rate, omega]| {
            let turn = Turn::over(lapse, rate, omega);
            state.decay(turn, turn.added().map(|part| part * slow_variance));
            of_input.decay(turn, [0.0; 3]);
            turn
        });
        let measured = state.gain(relative);
        let at_row = AtRow { total: measured.total, input_part: of_input.displacement() };
        each(j, at_row, &mut |row| match turn {
            None => columns.update(&measured.gain, row),
            Some(turn) => columns.update_with_slow_error(&measured.gain, turn, row),
        });
        state.update(&measured.gain, relative);
        of_input.update(&measured.gain, 0.0);
    }
    let end = noise.pieces.last().map_or(reached, |piece| piece[0].max(reached));
    advance(end, &mut state, &mut of_input);
    // A bias is constant where nothing is measured.
    End { bias: columns.b, bias_variance: state.bias() }
}

/// The states of all columns, each state in a row of its own, so that the processor takes several columns at once.
struct Columns {
    x: Vec<f64>,
    v: Vec<f64>,
    b: Vec<f64>,
    slow: Vec<f64>,
    velocity: Vec<f64>,
}

impl Columns {
    fn at_rest(count: usize) -> Self {
        let [x, v, b, slow, velocity] = [0; 5].map(|_| vec![0.0; count]);
        Self { x, v, b, slow, velocity }
    }

    /// Over `lapse` seconds, and in each column over `longer` (c,) more where it is given.
    fn predict(&mut self, lapse: f64, longer: Option<&[f64]>) {
        let states = self.x.iter_mut().zip(&mut self.v).zip(&self.b);
        match longer {
            None => states.for_each(|((x, v), &b)| predict(x, v, b, lapse)),
            Some(longer) => states.zip(longer).for_each(|(((x, v), &b), more)| predict(x, v, b, lapse + more)),
        }
    }

    /// A row of values becomes its innovations.
    fn update(&mut self, gain: &[f64; 5], row: &mut [f64]) {
        for (((value, x), v), b) in row.iter_mut().zip(&mut self.x).zip(&mut self.v).zip(&mut self.b) {
            *value -= *x;
            *x += gain[0] * *value;
            *v += gain[1] * *value;
            *b += gain[2] * *value;
        }
    }

    /// The same with a slow error that has turned.
    fn update_with_slow_error(&mut self, gain: &[f64; 5], turn: Turn, row: &mut [f64]) {
        for ((value, slow), velocity) in row.iter_mut().zip(&mut self.slow).zip(&mut self.velocity) {
            (*slow, *velocity) = turn.of(*slow, *velocity);
            *value -= *slow;
        }
        self.update(gain, row);
        for ((value, slow), velocity) in row.iter().zip(&mut self.slow).zip(&mut self.velocity) {
            *slow += gain[3] * value;
            *velocity += gain[4] * value;
        }
    }
}

fn predict(x: &mut f64, v: &mut f64, b: f64, dt: f64) {
    *x += dt * (*v - 0.5 * dt * b);
    *v -= dt * b;
}

/// The steps of the covariance: none longer than [`MAX_STEP_S`], none across an end of a piece.
struct Steps<'a> {
    pieces: &'a [[f64; 2]],
    piece: usize,
    reached: f64,
}

impl Steps<'_> {
    /// The next step on the way to an instant, s, and the relative density over it; None where it is reached.
    fn next(&mut self, until: f64) -> Option<(f64, f64)> {
        if self.reached >= until || self.pieces.is_empty() {
            self.reached = self.reached.max(until);
            return None;
        }
        let last = self.pieces.len() - 1;
        while self.piece < last && self.pieces[self.piece][0] <= self.reached {
            self.piece += 1;
        }
        let mut ahead = until.min(self.reached + MAX_STEP_S);
        if self.piece < last {
            ahead = ahead.min(self.pieces[self.piece][0]);
        }
        let dt = ahead - self.reached;
        self.reached = ahead;
        Some((dt, self.pieces[self.piece][1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The innovations are linear in the values, and a measurement's own noise is in each variance.
        #[test]
        fn a_column_that_is_a_sum_of_two_has_the_sum_of_their_innovations(
            steps in prop::collection::vec(0.05..0.5f64, 5..40), density in 1e-3..10.0f64, slow in any::<bool>()
        ) {
            let mut time = 0.0;
            let rows: Vec<[f64; 2]> = steps.iter().map(|step| { time += step; [time, 1.0] }).collect();
            let values: Vec<f64> = rows
                .iter()
                .flat_map(|[t, _]| { let (a, b) = ((2.0 * t).sin(), (0.7 * t).cos()); [a, b, a + b] })
                .collect();
            let pieces = [[0.5 * time, 1.0], [time, 3.0]];
            let noise = Noise { pieces: &pieces, density, slow: slow.then_some([2.0, 0.3, 1.7]) };
            let found = whiten(&noise, &rows, values.clone(), &[]);
            for row in found.values.chunks_exact(3) {
                // The first innovations are as large as the values; rounding is that of sums of order one.
                prop_assert!((row[0] + row[1] - row[2]).abs() < 1e-8);
            }
            prop_assert!(found.variance.iter().all(|&one| one >= 1.0));
            let sums = products(&noise, &rows, &values, 1, 3);
            let summed = |a: usize, b: usize| -> f64 {
                let rows = found.values.chunks_exact(3).zip(&found.variance).skip(3);
                rows.map(|(row, variance)| row[a] * row[b] / variance).sum()
            };
            for (sum, a, b) in [
                (sums.squares[1], 1, 1), (sums.with_first[2], 0, 2), (sums.with_later[0], 0, 1), (sums.with_later[1], 1, 2)
            ] {
                // Rounding of some forty summands.
                let size = (summed(a, a) * summed(b, b)).sqrt();
                prop_assert!((sum - summed(a, b)).abs() <= 1e-13 * size, "{a} {b}");
            }
            prop_assert!(sums.variance == found.variance && sums.input_part == found.input_part);
        }
    }

    #[test]
    fn without_rows_there_is_nothing() {
        let found = whiten(&Noise { pieces: &[], density: 1.0, slow: None }, &[], Vec::new(), &[]);
        assert!(found.values.is_empty() && found.variance.is_empty() && found.bias.is_empty());
    }
}
