//! The tables by which an undisturbed frame is fitted: what the sums over each block respond to, at one phase.
//!
//! See [`super::undisturbed`]. The tables of a phase are made when a frame first needs them.

use super::bank::{Division, Plane};
use super::fine_spline::{Curvatures, Slopes, bends, slopes};
use super::grid::{Grid, Part};
use super::kernels::phase_shift;
use super::matrix::{Matrix, inverse};
use super::vector::{WIDE_LANES as LANES, dot, vectorised};

/// Kernels are whole numbers of 8 bits, a quarter of the memory that they are read from in each frame. What they respond to
/// is computed from these: their rounding only costs precision, less than a thousandth of it.
const LARGEST: f32 = 127.0;
/// Of a block: with the slopes along x and y, and with the template.
pub const SUMS: usize = 3;
/// What the sums are linear in: x, y, roll, zoom; gain, its ramps across and down, the level's ramps across and down.
pub const UNKNOWNS: usize = 9;
/// x, y, roll, zoom.
pub const WANTED: usize = 4;
const OTHERS: usize = UNKNOWNS - WANTED;
/// Which unknown the gain is.
pub const GAIN: usize = 4;
/// The unknowns, the second order of a shift (dx²/2, dx dy, dy²/2), and the sums' covariance.
const RESPONSES: usize = UNKNOWNS + 3 + SUMS;
/// One row in this many is looked at first: nearly always that leads to the phase whose tables are exact.
pub const SPARSE: usize = 5;

/// What one sum of a block responds to.
#[derive(Clone, Copy, Debug, Default)]
pub struct Row {
    /// To each unknown.
    pub response: [f64; UNKNOWNS],
    /// Its weight in each unknown.
    pub weight: [f64; UNKNOWNS],
    /// To the second order of a shift: dx²/2, dx dy, dy²/2.
    pub second: [f64; 3],
    /// Its row of the block's inverse covariance.
    pub inverse: [f64; SUMS],
}

/// The tables of one phase.
#[derive(Clone)]
pub struct Tables {
    /// Of each 16 columns of the window, row after row, the three kernels that the blocks' sums are taken with.
    kernels: Vec<[[i8; LANES]; SUMS]>,
    height: usize,
    /// Three of each block.
    pub rows: Vec<Row>,
    /// Normal matrix of x, y, roll, zoom.
    pub normal: Matrix<WANTED>,
    /// How much of each of these goes into the other unknowns.
    pub share: [[f64; WANTED]; OTHERS],
    /// What turns the sums over one row in `SPARSE` into x and y times the gain, and the gain.
    pub sparse: Matrix<SUMS>,
}

impl Tables {
    /// The tables of a phase; `share` of each block's gradients that is texture, `centres` of the blocks from the window's
    /// middle.
    pub fn new(plane: &Plane, division: &Division, share: &[f64], centres: &[[f64; 2]], phase: usize) -> Self {
        let [x, y] = phase_shift(phase);
        let (height, width) = (plane.window.height, plane.window.width);
        let whole = Part { top: 0, bottom: height, left: 0, right: width };
        let (moved, curved) = bends(&plane.grids[0], whole, x, y);
        let seen = Seen { moved, curved, smooth: slopes(&plane.grids[1], whole, x, y) };
        let mut tables = Self {
            kernels: vec![[[0; LANES]; SUMS]; height * width.div_ceil(LANES)],
            height,
            rows: Vec::with_capacity(SUMS * share.len()),
            normal: Matrix::default(),
            share: Default::default(),
            sparse: Matrix::default(),
        };
        let mut scratch = Responding::new(&division.across);
        let mut kernels = Kernels { values: vec![0; height * SUMS * width], width };
        for (j, edges) in division.down.windows(2).enumerate() {
            let rows = edges[0]..edges[1];
            kernels.fill(&seen.smooth, &plane.weight, rows.clone(), &division.across);
            let responses = scratch.responses(&seen, &plane.weight, &kernels, rows);
            for (i, response) in responses.iter().enumerate() {
                let block = j * (division.across.len() - 1) + i;
                let size = [width as f64, height as f64];
                let mut rows = response.map(|one| row(&one, centres[block], size));
                let inverse = inverse_covariance(&rows, share[block]);
                rows.iter_mut().zip(inverse).for_each(|(row, inverse)| row.inverse = inverse);
                tables.rows.extend(rows);
            }
        }
        tables.weigh();
        tables.sparse = kernels.sparse_fit(&seen.moved);
        for (n, packed) in tables.kernels.iter_mut().enumerate() {
            let (first, r) = (n / height * LANES, n % height);
            for (k, packed) in packed.iter_mut().enumerate() {
                packed.iter_mut().zip(&kernels.line(r, k)[first..]).for_each(|(packed, value)| *packed = *value);
            }
        }
        tables
    }

    /// Of the columns from `first`, a multiple of 16, on, row after row of the window, the three kernels.
    #[inline(always)]
    pub fn kernels(&self, first: usize) -> &[[[i8; LANES]; SUMS]] {
        let start = first / LANES * self.height;
        &self.kernels[start..start + self.height]
    }

    /// Fill in the weights by which the sums give the unknowns.
    ///
    /// x, y, roll and zoom come from their score, the sums times these weights, through the normal matrix; the others from
    /// the sums times theirs, less what x, y, roll and zoom put there.
    fn weigh(&mut self) {
        let mut whole = Matrix::<UNKNOWNS>::default();
        let mut weighted = Vec::with_capacity(self.rows.len());
        for block in self.rows.chunks_exact(SUMS) {
            for row in block {
                let mut line = [0.0; UNKNOWNS];
                for (inverse, other) in row.inverse.iter().zip(block) {
                    line.iter_mut().zip(other.response).for_each(|(sum, response)| *sum += inverse * response);
                }
                for (into, response) in whole.iter_mut().zip(row.response) {
                    into.iter_mut().zip(line).for_each(|(sum, value)| *sum += response * value);
                }
                weighted.push(line);
            }
        }
        for (k, row) in whole.iter_mut().enumerate() {
            row[k] = row[k] * (1.0 + 1e-9) + 1e-300;
        }
        let others =
            inverse::<OTHERS>(&std::array::from_fn(|i| std::array::from_fn(|j| whole[WANTED + i][WANTED + j])));
        let sum = |count: usize, term: &dyn Fn(usize) -> f64| (0..count).map(term).sum::<f64>();
        self.share =
            std::array::from_fn(|i| std::array::from_fn(|j| sum(OTHERS, &|k| others[i][k] * whole[WANTED + k][j])));
        let share = self.share;
        self.normal = std::array::from_fn(|i| {
            std::array::from_fn(|j| whole[i][j] - sum(OTHERS, &|k| whole[i][WANTED + k] * share[k][j]))
        });
        for (row, line) in self.rows.iter_mut().zip(&weighted) {
            row.weight = std::array::from_fn(|u| match u.checked_sub(WANTED) {
                None => line[u] - sum(OTHERS, &|k| line[WANTED + k] * share[k][u]),
                Some(u) => sum(OTHERS, &|k| line[WANTED + k] * others[k][u]),
            });
        }
    }
}

/// The three kernels of each row of the window, one after the other.
struct Kernels {
    values: Vec<i8>,
    width: usize,
}

impl Kernels {
    /// One of three kernels in a row.
    fn line(&self, row: usize, sum: usize) -> &[i8] {
        let first = (row * SUMS + sum) * self.width;
        &self.values[first..first + self.width]
    }

    /// Low-passed slopes along x and y (both negative) and values of a row of blocks, weighted, each without its block's
    /// mean, as whole numbers.
    fn fill(&mut self, smooth: &Slopes, weight: &Grid, rows: std::ops::Range<usize>, across: &[usize]) {
        let mut rest = Vec::new();
        for (sum, plane) in [&smooth.x, &smooth.y, &smooth.value].into_iter().enumerate() {
            let sign = if sum == 2 { 1.0 } else { -1.0 };
            for edges in across.windows(2) {
                let part = Part { top: rows.start, bottom: rows.end, left: edges[0], right: edges[1] };
                let largest = without_mean(plane, weight, part, &mut rest);
                let factor = if largest > 0.0 { sign * LARGEST / largest } else { 0.0 };
                for (r, line) in rows.clone().zip(rest.chunks_exact(part.columns())) {
                    let first = (r * SUMS + sum) * self.width;
                    rounded(line, factor, &mut self.values[first + edges[0]..first + edges[1]]);
                }
            }
        }
    }

    /// See [`Tables::sparse`]; zeros where one row in this many shows nothing.
    fn sparse_fit(&self, moved: &Slopes) -> Matrix<SUMS> {
        let mut response = Matrix::<SUMS>::default();
        for r in (SPARSE / 2..moved.value.rows).step_by(SPARSE) {
            for (k, response) in response.iter_mut().enumerate() {
                let kernel: Vec<f32> = self.line(r, k).iter().map(|&value| f32::from(value)).collect();
                for (m, (plane, sign)) in
                    [(&moved.x, -1.0), (&moved.y, -1.0), (&moved.value, 1.0)].into_iter().enumerate()
                {
                    response[m] += sign * f64::from(dot(&kernel[..plane.columns], plane.row(r)));
                }
            }
        }
        let [a, b, c] = response;
        let determinant = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0]);
        // An instrument's response to what it is made of is positive: elimination needs no pivots.
        let out = if determinant > 0.0 { inverse(&response) } else { Matrix::default() };
        if out.iter().flatten().all(|value| value.is_finite()) { out } else { Matrix::default() }
    }
}

vectorised! {
    /// Fill `out` with a part of a plane without its weighted mean, each times its weight; the largest of them.
    fn without_mean(plane: &Grid, weight: &Grid, part: Part, out: &mut Vec<f32>) -> f32 {
        let (mut total, mut weights) = (0.0f64, 0.0f64);
        for r in part.top..part.bottom {
            let (line, w) = (&plane.row(r)[part.left..part.right], &weight.row(r)[part.left..part.right]);
            total += f64::from(dot(line, w));
            weights += f64::from(super::vector::sum(w));
        }
        let mean = (total / weights) as f32;
        out.clear();
        out.resize(part.size(), 0.0);
        let mut largest = [0.0f32; LANES];
        for (r, out) in (part.top..part.bottom).zip(out.chunks_exact_mut(part.columns())) {
            let (line, w) = (&plane.row(r)[part.left..part.right], &weight.row(r)[part.left..part.right]);
            for ((out, value), w) in out.iter_mut().zip(line).zip(w) {
                *out = w * (value - mean);
            }
            let blocks = out.chunks_exact(LANES);
            let rest = blocks.remainder();
            for values in blocks {
                for c in 0..LANES {
                    largest[c] = if values[c].abs() > largest[c] { values[c].abs() } else { largest[c] };
                }
            }
            for (largest, value) in largest.iter_mut().zip(rest) {
                *largest = if value.abs() > *largest { value.abs() } else { *largest };
            }
        }
        largest.into_iter().fold(0.0, f32::max)
    }
}

vectorised! {
    /// Fill `out` with a line's values times a factor as whole numbers.
    fn rounded(line: &[f32], factor: f32, out: &mut [i8]) {
        // Compared with this number those of single precision are the whole ones.
        const WHOLE: f32 = 12_582_912.0;
        for (out, value) in out.iter_mut().zip(line) {
            *out = ((factor * value + WHOLE).to_bits() as i32 - WHOLE.to_bits() as i32) as i8;
        }
    }
}

/// The template at a phase.
struct Seen {
    moved: Slopes,
    curved: Curvatures,
    smooth: Slopes,
}

/// What the responses of a row of blocks are summed in.
struct Responding {
    across: Vec<usize>,
    /// Where each column lies from its block's middle, px.
    x: Vec<f32>,
    model: Grid,
    kernels: Grid,
    sums: Grid,
}

impl Responding {
    fn new(across: &[usize]) -> Self {
        let columns = across.last().copied().unwrap_or(0);
        let middle = |edges: &[usize]| 0.5 * (edges[0] as f64 + edges[1] as f64 - 1.0);
        let x = across.windows(2).flat_map(|edges| {
            let middle = middle(edges);
            (edges[0]..edges[1]).map(move |c| c as f32 - middle as f32)
        });
        Self {
            x: x.collect(),
            model: Grid::filled(RESPONSES, columns, 0.0),
            kernels: Grid::filled(SUMS, columns, 0.0),
            sums: Grid::filled(SUMS * RESPONSES, columns, 0.0),
            across: across.to_vec(),
        }
    }

    /// Responses of the sums of a row of blocks to the unknowns, the second order of a shift, and each other: covariance
    /// for noise of scale 1.
    fn responses(
        &mut self,
        seen: &Seen,
        weight: &Grid,
        kernels: &Kernels,
        rows: std::ops::Range<usize>,
    ) -> Vec<[[f64; RESPONSES]; SUMS]> {
        self.sums.values.fill(0.0);
        let middle = 0.5 * (rows.start as f64 + rows.end as f64 - 1.0);
        for r in rows {
            self.fill_model(seen, r, r as f32 - middle as f32);
            for k in 0..SUMS {
                let kernel = kernels.line(r, k);
                quotients(kernel, weight.row(r), self.kernels.row_mut(k), self.model.row_mut(UNKNOWNS + 3 + k));
            }
            accumulate(&self.kernels, &self.model, &mut self.sums);
        }
        let total = |edges: &[usize], k: usize, m: usize| {
            f64::from(super::vector::sum(&self.sums.row(m * SUMS + k)[edges[0]..edges[1]]))
        };
        let of_block = |edges: &[usize]| std::array::from_fn(|k| std::array::from_fn(|m| total(edges, k, m)));
        self.across.windows(2).map(of_block).collect()
    }

    /// How the pixels of a row change with x, y, roll and zoom about their block's middle, gain, ramps of gain and of level
    /// about that, in px, and with the second order of a shift.
    fn fill_model(&mut self, seen: &Seen, r: usize, y: f32) {
        let Seen { moved, curved, .. } = seen;
        let planes = [&moved.value, &moved.x, &moved.y, &curved.xx, &curved.xy, &curved.yy].map(|grid| grid.row(r));
        model_rows(planes, &self.x, y, &mut self.model);
    }
}

vectorised! {
    /// See [`Responding::fill_model`]; `planes`: value, slopes along x and y, curvatures.
    fn model_rows(planes: [&[f32]; 6], x: &[f32], y: f32, out: &mut Grid) {
        let [value, along, down, xx, xy, yy] = planes;
        let columns = out.columns;
        let mut rows = out.values.chunks_exact_mut(columns);
        let mut fill = |of: &dyn Fn(usize) -> f32| {
            if let Some(row) = rows.next() {
                row.iter_mut().enumerate().for_each(|(c, out)| *out = of(c));
            }
        };
        fill(&|c| -along[c]);
        fill(&|c| -down[c]);
        fill(&|c| y * along[c] - x[c] * down[c]);
        fill(&|c| -x[c] * along[c] - y * down[c]);
        fill(&|c| value[c]);
        fill(&|c| x[c] * value[c]);
        fill(&|c| y * value[c]);
        fill(&|c| x[c]);
        fill(&|_| y);
        fill(&|c| xx[c]);
        fill(&|c| xy[c]);
        fill(&|c| yy[c]);
    }
}

vectorised! {
    /// Fill `line` with a kernel, and `over` with that over the weight.
    fn quotients(kernel: &[i8], weight: &[f32], line: &mut [f32], over: &mut [f32]) {
        for (((kernel, weight), line), over) in kernel.iter().zip(weight).zip(line).zip(over) {
            *line = f32::from(*kernel);
            *over = *line / weight;
        }
    }
}

vectorised! {
    /// Add to each column of `sums` (3 m, n) the products of each of m rows of the model with each of 3 kernels.
    fn accumulate(kernels: &Grid, model: &Grid, sums: &mut Grid) {
        let n = kernels.columns;
        let [k0, k1, k2] = [0, 1, 2].map(|k| &kernels.row(k)[..n]);
        for (m, into) in sums.values.chunks_exact_mut(SUMS * n).enumerate() {
            let line = &model.row(m)[..n];
            let (s0, rest) = into.split_at_mut(n);
            let (s1, s2) = rest.split_at_mut(n);
            for c in 0..n {
                s0[c] += k0[c] * line[c];
                s1[c] += k1[c] * line[c];
                s2[c] += k2[c] * line[c];
            }
        }
    }
}

/// The row of one sum: its `responses` are about the block's middle, which moves as the window turns and grows and lies
/// somewhere on the ramps. `size`: of the window.
fn row(responses: &[f64; RESPONSES], [x, y]: [f64; 2], size: [f64; 2]) -> Row {
    let mut response: [f64; UNKNOWNS] = std::array::from_fn(|u| responses[u]);
    response[2] += x * responses[1] - y * responses[0];
    response[3] += x * responses[0] + y * responses[1];
    response[5] += x * responses[GAIN];
    response[6] += y * responses[GAIN];
    // Ramps are 1 across the window, not 1 a pixel.
    for (k, value) in response[5..].iter_mut().enumerate() {
        *value /= size[k % 2];
    }
    let [second, inverse] = [UNKNOWNS, UNKNOWNS + 3].map(|first| std::array::from_fn(|k| responses[first + k]));
    Row { response, weight: [0.0; UNKNOWNS], second, inverse }
}

/// Inverse covariance of a block's sums for noise of scale 1, times the share of them that is texture; zeros where there is
/// none. `rows`: with the covariance in place of the inverse.
fn inverse_covariance(rows: &[Row; SUMS], share: f64) -> Matrix<SUMS> {
    let mut covariance = rows.map(|row| row.inverse);
    let slopes = covariance[0][0] * covariance[1][1] - covariance[0][1] * covariance[0][1];
    if !(share > 0.0 && slopes > 1e-6 * covariance[0][0] * covariance[1][1]) {
        return Matrix::default();
    }
    for (k, row) in covariance.iter_mut().enumerate() {
        row[k] *= 1.0 + 1e-9;
    }
    inverse(&covariance).map(|row| row.map(|value| share * value))
}
