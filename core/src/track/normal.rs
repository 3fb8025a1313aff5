//! The normal equations of a fit to frames at several places, as a weighted sum of what lies around each coefficient.
//!
//! Reading coefficients where a sample lies and spreading that again is a band matrix along each axis, which repeats
//! from pixel to pixel but for the edges. So is the Laplacian of the penalty. Their products' sum over all samples
//! takes 121 products a coefficient, however many samples there are.

use super::fine_spline::{BEYOND, PER_PX, Taps};
use super::grid::Grid;
use super::vector::vectorised;
use std::array::from_fn;

/// Neighbours to either side, and of both with the coefficient itself: as far as two coefficients share a pixel.
const REACH: usize = 5;
const BAND: usize = 2 * REACH + 1;
/// Coefficients that are computed at once; this many at each edge have sums of their own, the others by pairs the same.
const LANES: usize = 8;
/// How often as many inner ones are taken at once: their sums stay in the processor's registers.
const TOGETHER: usize = 6;
/// The least axis that has all kinds of coefficients: those at both edges, an even and an odd one between them.
const PIXELS: usize = 6;
const KINDS: usize = PER_PX * PIXELS + BEYOND;
/// The first columns, those between, the last.
const GROUPS: usize = 3;
/// Of the Laplacian's power in the penalty.
const POWER: usize = 4;

/// One axis of a term: what each kind of coefficient takes from those around it.
type Axis = [[f64; BAND]; KINDS];
/// Factors of a group of columns, by how far the neighbour lies down and across.
type Kernel = [[[f32; LANES]; BAND]; BAND];

/// See the module.
pub struct Normal {
    rows: usize,
    columns: usize,
    /// By kind of row.
    kernels: Vec<[Kernel; GROUPS]>,
}

/// Which kind of coefficient this is of `count`.
fn kind(place: usize, count: usize) -> usize {
    let after = count - place;
    if place < LANES {
        place
    } else if after <= LANES {
        KINDS - after
    } else {
        LANES + place % PER_PX
    }
}

impl Normal {
    /// For coefficients (rows, columns), at least [`KINDS`] of each, of samples: weights down and across, and the
    /// number of frames. `penalty`: of the square of the Laplacian's square.
    pub fn new(rows: usize, columns: usize, samples: impl Iterator<Item = ([Taps; 2], f64)>, penalty: f64) -> Self {
        let mut terms: Vec<_> = samples.map(|(taps, count)| (taps.each_ref().map(shared), count)).collect();
        let mut powers = vec![[from_fn(|d| f64::from(u8::from(d == REACH))); KINDS]];
        (0..POWER).for_each(|k| powers.push(bent(&powers[k])));
        for (k, times) in [1.0, 4.0, 6.0, 4.0, 1.0].into_iter().enumerate() {
            terms.push(([powers[k], powers[POWER - k]], times * penalty));
        }
        let down = terms.iter().map(|([down, _], times)| down.map(|band| band.map(|value| (times * value) as f32)));
        let across = terms.iter().map(|([_, across], _)| grouped(across));
        Self { rows, columns, kernels: summed_terms(&down.collect::<Vec<_>>(), &across.collect::<Vec<_>>()) }
    }

    /// What the normal equations make of coefficients; None where these are of another size.
    pub fn times(&self, grid: &Grid) -> Option<Grid> {
        if (grid.rows, grid.columns) != (self.rows, self.columns) {
            return None;
        }
        // With zeros around, and as many more columns as are computed in vain.
        let more = TOGETHER * LANES;
        let mut wide = Grid::filled(self.rows + 2 * REACH, self.columns + 2 * REACH + more, 0.0);
        for r in 0..self.rows {
            wide.row_mut(r + REACH)[REACH..REACH + self.columns].copy_from_slice(grid.row(r));
        }
        let (mut out, mut line) = (Grid::filled(self.rows, self.columns, 0.0), vec![0.0; self.columns + more]);
        for r in 0..self.rows {
            summed(&wide, r, &self.kernels[kind(r, self.rows)], self.columns, &mut line);
            out.row_mut(r).copy_from_slice(&line[..self.columns]);
        }
        Some(out)
    }
}

/// What coefficients take from each other through the pixels that they share in a sample.
fn shared(taps: &Taps) -> Axis {
    let mut out = [[0.0; BAND]; KINDS];
    for first in (0..PIXELS).map(|pixel| PER_PX * pixel + taps.first) {
        for (i, one) in taps.weight.iter().enumerate() {
            for (j, other) in taps.weight.iter().enumerate() {
                out[first + i][REACH + j - i] += f64::from(*one) * f64::from(*other);
            }
        }
    }
    out
}

/// The second difference along the axis of what the coefficients give; beyond the edge it is that at the edge.
fn bent(axis: &Axis) -> Axis {
    // By place instead of by distance.
    let at =
        |i: usize, place: usize| (place + REACH).checked_sub(i).and_then(|d| axis[i].get(d)).copied().unwrap_or(0.0);
    from_fn(|i| {
        from_fn(|d| {
            let Some(place) = (i + d).checked_sub(REACH) else { return 0.0 };
            at(i.saturating_sub(1), place) + at((i + 1).min(KINDS - 1), place) - 2.0 * at(i, place)
        })
    })
}

/// The factors across of each group of columns, neighbour by neighbour.
fn grouped(across: &Axis) -> [[[f32; LANES]; BAND]; GROUPS] {
    let kind = |group: usize, lane: usize| match group {
        0 => lane,
        1 => LANES + lane % PER_PX,
        _ => KINDS - LANES + lane,
    };
    from_fn(|group| from_fn(|d| from_fn(|lane| across[kind(group, lane)][d] as f32)))
}

vectorised! {
    /// The products of the terms' axes, summed over the terms.
    fn summed_terms(down: &[[[f32; BAND]; KINDS]], across: &[[[[f32; LANES]; BAND]; GROUPS]]) -> Vec<[Kernel; GROUPS]> {
        let mut out = vec![[[[[0.0; LANES]; BAND]; BAND]; GROUPS]; KINDS];
        for (kind, kernels) in out.iter_mut().enumerate() {
            for (group, kernel) in kernels.iter_mut().enumerate() {
                for (d, sums) in kernel.iter_mut().enumerate() {
                    let mut total = [[0.0f32; LANES]; BAND];
                    for (down, across) in down.iter().zip(across) {
                        for n in 0..BAND {
                            for lane in 0..LANES {
                                total[n][lane] += down[kind][d] * across[group][n][lane];
                            }
                        }
                    }
                    *sums = total;
                }
            }
        }
        out
    }
}

vectorised! {
    /// Fill `out` with the sums of a row.
    fn summed(around: &Grid, row: usize, kernels: &[Kernel; GROUPS], columns: usize, out: &mut [f32]) {
        let ([first, inner, last], lines) = (kernels, from_fn(|d| around.row(row + d)));
        put::<1>(&lines, first, 0, out);
        for column in (LANES..columns - LANES).step_by(TOGETHER * LANES) {
            put::<TOGETHER>(&lines, inner, column, out);
        }
        put::<1>(&lines, last, columns - LANES, out);
    }
}

/// Put N times eight sums into `out` from a column on.
#[inline(always)]
fn put<const N: usize>(lines: &[&[f32]; BAND], kernel: &Kernel, column: usize, out: &mut [f32]) {
    let mut sums = [[0.0f32; LANES]; N];
    for (line, factors) in lines.iter().zip(kernel) {
        let line = &line[column..column + N * LANES + BAND - 1];
        for (d, factors) in factors.iter().enumerate() {
            for n in 0..N {
                for lane in 0..LANES {
                    sums[n][lane] += factors[lane] * line[d + n * LANES + lane];
                }
            }
        }
    }
    out[column..column + N * LANES].copy_from_slice(sums.as_flattened());
}
