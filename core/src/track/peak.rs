//! The sub-pixel peak of the ZNCC surface and its covariance.
//!
//! Around the whole-pixel peak the template's quintic spline is moved over the frame's window: the numerator of ZNCC is
//! then itself a quintic spline of the shift, the template's energy a known function of it, and Newton's method climbs
//! the surface.

use super::correlation::products;
use super::grid::{Grid, Part};
use super::spline::{TAPS, translated, weights};
use super::vector::{dot, sum, vectorised};

/// Blocks a side that the residual is watched in.
pub const BLOCKS: usize = 4;
/// Products of 1, template and gradients in a block.
pub type Moments = [[f64; 4]; 4];
/// A matrix of x and y.
pub type Square = [[f64; 2]; 2];

const NEWTON_STEPS: usize = 25;
const MAX_STEP_PX: f64 = 0.5;
const SETTLED_PX: f64 = 1e-9;
/// Under white noise the scatter of 16 blocks exceeds three times its mean about once in 10 000 frames.
const CORRELATED: f64 = 3.0;

vectorised! {
    /// A part of a patch without its mean.
    pub fn centred(patch: &Grid, part: Part) -> Grid {
        let mut out = patch.part(part);
        let mut total = 0.0;
        for r in 0..out.rows {
            total += f64::from(sum(out.row(r)));
        }
        let mean = (total / out.values.len() as f64) as f32;
        for value in &mut out.values {
            *value -= mean;
        }
        out
    }
}

/// Numerator of the ZNCC surface as spline coefficients over shifts of -3 … 3 px (rows y, columns x).
///
/// `window` (h, w) is the frame's window without its mean, `grid` (h + 6, w + 6) the template's spline coefficients.
pub fn spline_products(window: &Grid, grid: &Grid) -> [[f64; TAPS]; TAPS] {
    let sums = products(grid, window);
    std::array::from_fn(|j| std::array::from_fn(|i| sums.row(TAPS - 1 - j)[TAPS - 1 - i]))
}

/// 1, x, x² …, or their first or second derivative by x.
fn powers(x: f64, count: usize, derivative: usize) -> Vec<f64> {
    (0..count)
        .map(|k| {
            if k < derivative {
                return 0.0;
            }
            let factor: f64 = (0..derivative).map(|step| (k - step) as f64).product();
            factor * x.powi((k - derivative) as i32)
        })
        .collect()
}

/// A function of x and y with its slopes and curvatures.
#[derive(Default)]
struct Surface {
    value: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Surface {
    /// Σ left[j] matrix[j][i] right[i], with the derivatives of both sides.
    fn bilinear<'a>(matrix: impl Iterator<Item = &'a [f64]>, left: [&[f64]; 3], right: [&[f64]; 3]) -> Self {
        let mut out = Self::default();
        for (j, row) in matrix.enumerate() {
            let [value, x, xx] = right.map(|right| row.iter().zip(right).map(|(a, b)| a * b).sum::<f64>());
            out.value += left[0][j] * value;
            out.x += left[0][j] * x;
            out.y += left[1][j] * value;
            out.xx += left[0][j] * xx;
            out.xy += left[1][j] * x;
            out.yy += left[2][j] * value;
        }
        out
    }
}

/// ln ZNCC (up to a constant) at the shift (x, y); None where ZNCC is not positive.
fn log_zncc(numerator: &[[f64; TAPS]; TAPS], norm: &Grid<f64>, x: f64, y: f64) -> Option<Surface> {
    let [wx, wy] = [x, y].map(|at| [0, 1, 2].map(|d| weights(at, d)));
    let [px, py] = [x, y].map(|at| [0, 1, 2].map(|d| powers(at, norm.rows, d)));
    let n = Surface::bilinear(
        numerator.iter().map(|row| &row[..]),
        wy.each_ref().map(|w| &w[..]),
        wx.each_ref().map(|w| &w[..]),
    );
    if n.value <= 0.0 {
        return None;
    }
    let norm = Surface::bilinear(
        (0..norm.rows).map(|r| norm.row(r)),
        py.each_ref().map(|p| &p[..]),
        px.each_ref().map(|p| &p[..]),
    );
    let (nx, ny) = (n.x / n.value, n.y / n.value);
    Some(Surface {
        value: n.value.ln() - norm.value,
        x: nx - norm.x,
        y: ny - norm.y,
        xx: n.xx / n.value - nx * nx - norm.xx,
        xy: n.xy / n.value - nx * ny - norm.xy,
        yy: n.yy / n.value - ny * ny - norm.yy,
    })
}

/// The shift x, y (px) within -1 to 1 px at which the ZNCC surface has its maximum, by Newton's method from the
/// whole-pixel peak; None where it has none inside.
///
/// `numerator` are spline coefficients, `norm` (p, p) the polynomial of ln √(energy of the shifted template).
pub fn maximum(numerator: &[[f64; TAPS]; TAPS], norm: &Grid<f64>) -> Option<[f64; 2]> {
    let (mut x, mut y) = (0.0f64, 0.0f64);
    for _ in 0..NEWTON_STEPS {
        let s = log_zncc(numerator, norm, x, y)?;
        let det = s.xx * s.yy - s.xy * s.xy;
        let (step_x, step_y) = if s.xx < 0.0 && det > 0.0 {
            ((s.xy * s.y - s.yy * s.x) / det, (s.xy * s.x - s.xx * s.y) / det)
        } else {
            // Not yet concave: a short step uphill.
            let length = (s.x * s.x + s.y * s.y).sqrt() + 1e-300;
            (0.1 * s.x / length, 0.1 * s.y / length)
        };
        let largest = step_x.abs().max(step_y.abs());
        if !(step_x + step_y).is_finite() {
            return None;
        }
        let ratio = (MAX_STEP_PX / largest.max(1e-300)).min(1.0);
        x = (x + ratio * step_x).clamp(-1.0, 1.0);
        y = (y + ratio * step_y).clamp(-1.0, 1.0);
        if largest < SETTLED_PX {
            return (x.abs().max(y.abs()) < 1.0).then_some([x, y]);
        }
    }
    None
}

/// What is left of a window when the shifted template is taken out, in the template's unit.
pub struct Residual {
    /// ZNCC.
    pub quality: f64,
    /// Sums of each block, see [`BlockSums`].
    pub sums: [BlockSums; BLOCKS * BLOCKS],
}

/// Sums over a block.
#[derive(Clone, Copy, Default)]
pub struct BlockSums {
    /// Of the residual, and of that times the template and its gradients along x and y.
    pub products: [f64; 4],
    /// Of the residual's square.
    pub square: f64,
}

vectorised! {
    /// Turn `window` (without its mean) into the residual of the `moved` template; ZNCC; None without a match.
    fn without_template(window: &mut Grid, moved: &mut Grid) -> Option<f64> {
        let mut total = 0.0;
        for r in 0..moved.rows {
            total += f64::from(sum(moved.row(r)));
        }
        let mean = (total / moved.values.len() as f64) as f32;
        let (mut product, mut energy, mut own) = (0.0, 0.0, 0.0);
        for r in 0..window.rows {
            for value in moved.row_mut(r) {
                *value -= mean;
            }
            product += f64::from(dot(window.row(r), moved.row(r)));
            energy += f64::from(dot(moved.row(r), moved.row(r)));
            own += f64::from(dot(window.row(r), window.row(r)));
        }
        if product <= 0.0 {
            return None;
        }
        let inverse = (energy / product) as f32;
        for (value, moved) in window.values.iter_mut().zip(&moved.values) {
            *value = *value * inverse - moved;
        }
        Some(product / (energy * own).sqrt())
    }
}

vectorised! {
    /// Sums of the residual over 4 by 4 blocks of the window; `basis`: template and its gradients along x and y.
    pub fn block_sums(residual: &Grid, basis: &[Grid; 3]) -> [BlockSums; BLOCKS * BLOCKS] {
        let mut out = [BlockSums::default(); BLOCKS * BLOCKS];
        for (b, out) in out.iter_mut().enumerate() {
            let (j, i) = (b / BLOCKS, b % BLOCKS);
            let (left, right) = (i * residual.columns / BLOCKS, (i + 1) * residual.columns / BLOCKS);
            for r in j * residual.rows / BLOCKS..(j + 1) * residual.rows / BLOCKS {
                // Sums of one row in single precision: the processor then takes twice as many pixels at once.
                let line = &residual.row(r)[left..right];
                out.products[0] += f64::from(sum(line));
                for (out, plane) in out.products[1..].iter_mut().zip(basis) {
                    *out += f64::from(dot(line, &plane.row(r)[left..right]));
                }
                out.square += f64::from(dot(line, line));
            }
        }
        out
    }
}

/// What is left of the frame's window when the template, shifted by `shift` (x, y px), is taken out; None without a
/// match.
///
/// `window` (h, w) without its mean (overwritten), `grid` the template's spline coefficients.
pub fn residual(window: &mut Grid, grid: &Grid, basis: &[Grid; 3], shift: [f64; 2]) -> Option<Residual> {
    let quality = without_template(window, &mut translated(grid, shift[0], shift[1]))?;
    Some(Residual { quality, sums: block_sums(window, basis) })
}

fn inverse(a: &Square) -> Square {
    let det = a[0][0] * a[1][1] - a[0][1] * a[1][0];
    [[a[1][1] / det, -a[0][1] / det], [-a[1][0] / det, a[0][0] / det]]
}

fn times(a: &Square, b: &Square) -> Square {
    std::array::from_fn(|i| std::array::from_fn(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j]))
}

/// A matrix of gradients without the noise's own, of which at least a tenth of each axis is left.
fn without_noise(observed: &Square, noise: f64) -> Square {
    let ratio = [0, 1].map(|k| (1.0 - noise / observed[k][k]).max(0.1));
    let cross = observed[0][1] * ratio[0].min(ratio[1]);
    [[observed[0][0] * ratio[0], cross], [cross, observed[1][1] * ratio[1]]]
}

/// The solution of a positive definite system by elimination.
fn solved(mut matrix: Moments, mut right: [f64; 4]) -> [f64; 4] {
    let at_least = |pivot: f64| if pivot > 0.0 { pivot } else { 1e-300 };
    for k in 0..4 {
        for i in k + 1..4 {
            let ratio = matrix[i][k] / at_least(matrix[k][k]);
            right[i] -= ratio * right[k];
            let pivot = matrix[k];
            matrix[i].iter_mut().zip(pivot).skip(k).for_each(|(value, of)| *value -= ratio * of);
        }
    }
    for k in (0..4).rev() {
        for j in k + 1..4 {
            right[k] -= matrix[k][j] * right[j];
        }
        right[k] /= at_least(matrix[k][k]);
    }
    right
}

/// Variances x and y (px²) from how the shift changes when one block after the other is left out; level and gain are
/// fitted anew each time.
fn jackknife(sums: &[BlockSums], moments: &[Moments]) -> [f64; 2] {
    let (mut matrix, mut right) = (Moments::default(), [0.0; 4]);
    for (sums, moments) in sums.iter().zip(moments) {
        for i in 0..4 {
            right[i] += sums.products[i];
            for j in 0..4 {
                matrix[i][j] += moments[i][j];
            }
        }
    }
    let shifts: Vec<[f64; 4]> = sums
        .iter()
        .zip(moments)
        .map(|(sums, moments)| {
            let rest = std::array::from_fn(|i| std::array::from_fn(|j| matrix[i][j] - moments[i][j]));
            solved(rest, std::array::from_fn(|i| right[i] - sums.products[i]))
        })
        .collect();
    let count = shifts.len() as f64;
    [2, 3].map(|k| {
        let mean = shifts.iter().map(|shift| shift[k]).sum::<f64>() / count;
        (count - 1.0) / count * shifts.iter().map(|shift| (shift[k] - mean).powi(2)).sum::<f64>()
    })
}

/// What a template says of the variance of its peak.
#[derive(Clone)]
pub struct Precision {
    /// Each block's products of 1, template, gradients along x and y.
    pub moments: Vec<Moments>,
    /// Sum of g gᵀ over the filtered template, and the same of the gradients filtered once more.
    pub information: [Square; 2],
    /// Pixels in the window.
    pub pixels: f64,
    /// What white noise of variance 1 in the raw image adds to a filtered pixel's variance, and to both of
    /// `information`.
    pub noise_gain: f64,
    /// See `noise_gain`.
    pub gradient_gains: [f64; 2],
}

impl Precision {
    /// `basis`: template and its gradients along x and y; the others: see the fields.
    pub fn new(basis: &[Grid; 3], information: [Square; 2], noise_gain: f64, gradient_gains: [f64; 2]) -> Self {
        let ones = Grid::filled(basis[0].rows, basis[0].columns, 1.0);
        let columns = [&ones, &basis[0], &basis[1], &basis[2]].map(|plane| block_sums(plane, basis));
        let moments =
            (0..BLOCKS * BLOCKS).map(|b| [0, 1, 2, 3].map(|i| columns.each_ref().map(|sums| sums[b].products[i])));
        let pixels = basis[0].values.len() as f64;
        Self { moments: moments.collect(), information, pixels, noise_gain, gradient_gains }
    }

    /// Variances x and y (px²) of the peak by linear theory.
    ///
    /// The residual holds the noise of frame and template alike, so both are counted. Where it is correlated (an object
    /// in front, a shadow, rotation), the jackknife over blocks replaces the white-noise theory.
    pub fn variances(&self, sums: &[BlockSums]) -> [f64; 2] {
        let white = sums.iter().map(|sums| sums.square).sum::<f64>() / (self.pixels - 4.0) / self.noise_gain;
        let [bread, meat] = [0, 1].map(|k| without_noise(&self.information[k], 0.5 * white * self.gradient_gains[k]));
        let bread = inverse(&bread);
        let model = times(&times(&bread, &meat.map(|row| row.map(|value| white * value))), &bread);
        let scatter = jackknife(sums, &self.moments);
        [0, 1].map(|k| if scatter[k] > CORRELATED * model[k][k] { scatter[k] } else { model[k][k] })
    }
}
