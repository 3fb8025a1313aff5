//! The tables by which an undisturbed frame is fitted: what the sums over each block respond to, at one phase.
//!
//! See [`super::undisturbed`]. The tables of a phase are made when a frame first needs them.

use super::bank::{Division, Plane};
use super::fine_spline::{Curvatures, Slopes, bends, slopes};
use super::grid::{Grid, Part};
use super::kernels::phase_shift;
use super::matrix::{Matrix, inverse};
use super::vector::{WIDE_LANES as LANES, dot, gathered, vectorised};

/// Kernels are whole numbers of 8 bits, a quarter of the memory that they are read from in each frame. What they
/// respond to is computed from these: their rounding only costs precision, less than a thousandth of it.
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
/// What changes with the template's place: slopes along x and y, values, curvatures.
const MODEL: usize = 6;
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
    /// The tables of a phase; `share` of each block's gradients that is texture, `centres` of the blocks from the
    /// window's middle.
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
        let mut kernels = Kernels { values: vec![0; height * SUMS * width], width };
        for (block, part) in division.parts().iter().enumerate() {
            kernels.fill(&seen.smooth, &plane.weight, *part);
            let responses = kernels.responses(&seen, &plane.weight, *part);
            let mut rows = responses.map(|sum| row(&sum, centres[block], [width as f64, height as f64]));
            let inverse = inverse_covariance(&rows, share[block]);
            rows.iter_mut().zip(inverse).for_each(|(row, inverse)| row.inverse = inverse);
            tables.rows.extend(rows);
        }
        tables.weigh();
        tables.sparse = kernels.sparse_fit(&seen.moved);
        for (n, packed) in tables.kernels.iter_mut().enumerate() {
            let (first, r) = (n / height * LANES, n % height);
            for (k, packed) in packed.iter_mut().enumerate() {
                let line = &kernels.line(r, k)[first..];
                let count = line.len().min(LANES);
                packed[..count].copy_from_slice(&line[..count]);
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
    /// x, y, roll and zoom come from their score, the sums times these weights, through the normal matrix; the others
    /// from the sums times theirs, less what x, y, roll and zoom put there.
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

    /// Low-passed slopes along x and y (both negative) and values of a block, weighted, without its mean, as whole
    /// numbers.
    fn fill(&mut self, smooth: &Slopes, weight: &Grid, part: Part) {
        let planes = [&smooth.x, &smooth.y, &smooth.value];
        let (mean, largest) = means_and_largest(&planes, weight, part);
        for (sum, plane) in planes.into_iter().enumerate() {
            let sign = if sum == 2 { 1.0 } else { -1.0 };
            let factor = if largest[sum] > 0.0 { sign * LARGEST / largest[sum] } else { 0.0 };
            for r in part.top..part.bottom {
                let first = (r * SUMS + sum) * self.width;
                let (line, w) = (inside(plane, r, part), inside(weight, r, part));
                rounded(line, w, mean[sum], factor, &mut self.values[first + part.left..first + part.right]);
            }
        }
    }

    /// Responses of a block's sums to the unknowns, the second order of a shift, and each other: covariance for noise
    /// of scale 1.
    fn responses(&self, seen: &Seen, weight: &Grid, part: Part) -> [[f64; RESPONSES]; SUMS] {
        responses_of(self, seen, weight, part).map(|sums| sums.map(f64::from))
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
    /// The weighted means of a part of planes, and the largest weighted distances from them.
    fn means_and_largest(planes: &[&Grid; SUMS], weight: &Grid, part: Part) -> ([f32; SUMS], [f32; SUMS]) {
        // Past the last column of no weight.
        let at = |plane: &Grid, r: usize, c: usize| eight(inside(plane, r, part), c, 0.0);
        let (mut total, mut all) = ([[0.0f32; EIGHT]; SUMS], [0.0f32; EIGHT]);
        for r in part.top..part.bottom {
            for c in (0..part.columns()).step_by(EIGHT) {
                let weights = at(weight, r, c);
                for k in 0..EIGHT {
                    all[k] += weights[k];
                }
                for (total, plane) in total.iter_mut().zip(planes) {
                    let values = at(plane, r, c);
                    for k in 0..EIGHT {
                        total[k] += weights[k] * values[k];
                    }
                }
            }
        }
        let all = gathered(all);
        let mean = total.map(|total| gathered(total) / all);
        let mut largest = [[0.0f32; EIGHT]; SUMS];
        for r in part.top..part.bottom {
            for c in (0..part.columns()).step_by(EIGHT) {
                let weights = at(weight, r, c);
                for (m, plane) in planes.iter().enumerate() {
                    let values = at(plane, r, c);
                    for k in 0..EIGHT {
                        let far = (weights[k] * (values[k] - mean[m])).abs();
                        largest[m][k] = if far > largest[m][k] { far } else { largest[m][k] };
                    }
                }
            }
        }
        (mean, largest.map(|lanes| lanes.into_iter().fold(0.0, f32::max)))
    }
}

vectorised! {
    /// Fill `out` with the weighted distances of a line from a mean, times a factor, as whole numbers.
    fn rounded(line: &[f32], weight: &[f32], mean: f32, factor: f32, out: &mut [i8]) {
        // Compared with this number those of single precision are the whole ones.
        const WHOLE: f32 = 12_582_912.0;
        for ((out, value), weight) in out.iter_mut().zip(line).zip(weight) {
            *out = ((factor * (weight * (value - mean)) + WHOLE).to_bits() as i32 - WHOLE.to_bits() as i32) as i8;
        }
    }
}

/// Numbers that are taken at once: the sums of a block stay in the processor's registers.
const EIGHT: usize = 8;

/// A row of a part of a plane.
#[inline(always)]
fn inside(plane: &Grid, r: usize, part: Part) -> &[f32] {
    &plane.row(r)[part.left..part.right]
}

/// Eight values of a line from a column on; past its end the `rest`.
#[inline(always)]
fn eight<T: Copy>(line: &[T], column: usize, rest: T) -> [T; EIGHT] {
    if let Some(whole) = line[column..].first_chunk::<EIGHT>() {
        return *whole;
    }
    let mut out = [rest; EIGHT];
    out.iter_mut().zip(&line[column..]).for_each(|(out, value)| *out = *value);
    out
}

/// The template at a phase.
struct Seen {
    moved: Slopes,
    curved: Curvatures,
    smooth: Slopes,
}

/// Eight pixels: the template's slopes, values and curvatures, the three kernels, and these over the weight.
#[derive(Clone, Default)]
struct Eight {
    model: [[f32; EIGHT]; MODEL],
    kernels: [[f32; EIGHT]; SUMS],
    over: [[f32; EIGHT]; SUMS],
}

vectorised! {
    /// Sums over a block of the products of each of its kernels with what changes with x, y, roll and zoom about its
    /// middle, gain, ramps of gain and of level about that, in px, and the second order of a shift; and with the three
    /// kernels over the weight.
    fn responses_of(kernels: &Kernels, seen: &Seen, weight: &Grid, part: Part) -> [[f32; RESPONSES]; SUMS] {
        let Seen { moved, curved, .. } = seen;
        let planes = [&moved.x, &moved.y, &moved.value, &curved.xx, &curved.xy, &curved.yy];
        let middle = |first: usize, end: usize| 0.5 * (first as f32 + end as f32 - 1.0);
        let [left, top] = [middle(part.left, part.right), middle(part.top, part.bottom)];
        let mut sums = [[[0.0f32; EIGHT]; RESPONSES]; SUMS];
        let mut lines = vec![Eight::default(); part.rows()];
        for c in (0..part.columns()).step_by(EIGHT) {
            for (r, line) in (part.top..part.bottom).zip(&mut lines) {
                let weight = eight(inside(weight, r, part), c, 1.0);
                for (model, plane) in line.model.iter_mut().zip(&planes) {
                    *model = eight(inside(plane, r, part), c, 0.0);
                }
                for k in 0..SUMS {
                    let kernel = eight(&kernels.line(r, k)[part.left..part.right], c, 0);
                    for i in 0..EIGHT {
                        line.kernels[k][i] = f32::from(kernel[i]);
                        line.over[k][i] = line.kernels[k][i] / weight[i];
                    }
                }
            }
            for k in 0..SUMS {
                let Down { plain, ramped, own } = down(&lines, k, part.top as f32 - top);
                for i in 0..EIGHT {
                    let x = (part.left + c + i) as f32 - left;
                    let [along, down, value, xx, xy, yy, one] = plain.map(|sums| sums[i]);
                    let [along_y, down_y, value_y, one_y] = ramped.map(|sums| sums[i]);
                    let terms = [
                        -along, -down, along_y - x * down, -x * along - down_y, value, x * value, value_y, x * one, one_y,
                        xx, xy, yy, own[0][i], own[1][i], own[2][i],
                    ];
                    for m in 0..RESPONSES {
                        sums[k][m][i] += terms[m];
                    }
                }
            }
        }
        let mut out = [[0.0; RESPONSES]; SUMS];
        for k in 0..SUMS {
            for m in 0..RESPONSES {
                out[k][m] = gathered(sums[k][m]);
            }
        }
        out
    }
}

/// Sums down lines of eight pixels of one kernel's products.
#[derive(Default)]
struct Down {
    /// With the model and 1.
    plain: [[f32; EIGHT]; MODEL + 1],
    /// With the model's first three and 1, times y.
    ramped: [[f32; EIGHT]; 4],
    /// With the kernels over the weight.
    own: [[f32; EIGHT]; SUMS],
}

/// The sums of kernel `k`; y is `first` in the first line.
#[inline(always)]
fn down(lines: &[Eight], k: usize, first: f32) -> Down {
    let (mut out, mut y) = (Down::default(), first);
    for line in lines {
        let (kernel, over) = (&line.kernels[k], &line.over[k]);
        for i in 0..EIGHT {
            for m in 0..MODEL {
                let product = kernel[i] * line.model[m][i];
                out.plain[m][i] += product;
                if m < 3 {
                    out.ramped[m][i] += y * product;
                }
            }
            out.plain[MODEL][i] += kernel[i];
            out.ramped[3][i] += y * kernel[i];
            for (own, other) in out.own.iter_mut().zip(&line.kernels) {
                own[i] += over[i] * other[i];
            }
        }
        y += 1.0;
    }
    out
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

/// Inverse covariance of a block's sums for noise of scale 1, times the share of them that is texture; zeros where
/// there is none. `rows`: with the covariance in place of the inverse.
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
