//! From a frame to a pose: steps of all blocks until each lies at its kernels' phase.

use super::bank::{Bank, Plane};
use super::blocks::{PoseValue, Shown, fuse, gains};
use super::grid::Part;
use super::image::{Image, Pixel};
use super::kernels::{PHASES, Quantised};
use super::matrix::{Matrix, median, scaled_sum};
use super::patch::less_offset;

const MAX_PASSES: usize = 8;
/// A block this near to its kernels' phase needs no other; the play stops circles.
pub const NEAR_PX: f64 = 0.5 / PHASES as f64 + 0.003;
/// One block in this many is looked at first, where that leaves not fewer than this many.
const SPARSE: usize = 5;
const MIN_SPARSE: usize = 4;
/// Share of the information that agrees in an undisturbed frame.
pub const UNDISTURBED_SHARE: f64 = 0.8;
/// Weight of a frame's own noise against the usual one.
pub const OWN_WEIGHT: f64 = 1.0;
/// Times the usual noise: up to here blocks agree.
pub const ALIKE: f64 = 2.0;
const MAX_ROLL_RAD: f64 = 0.1;
const MAX_ZOOM: f64 = 0.1;
/// Gains outside say that something else is seen.
pub const MIN_GAIN: f64 = 0.1;
/// See `MIN_GAIN`.
pub const MAX_GAIN: f64 = 10.0;
/// Share of the others' gain that a block itself must have.
const MIN_OWN_GAIN: f64 = 0.25;

/// What one frame gives.
#[derive(Clone, Debug)]
pub struct Pose {
    /// x, y (px), roll (rad), zoom.
    pub value: PoseValue,
    /// Their covariance.
    pub covariance: Matrix<4>,
    /// Share of the information that agrees.
    pub share: f64,
    /// Noise of a pixel as the blocks' scatter shows it.
    pub noise: f64,
}

impl Pose {
    /// This pose with its own covariance times a `factor`, and that of the zero.
    pub fn wider(self, factor: f64, zero: &Matrix<4>) -> Self {
        Self { covariance: scaled_sum(&self.covariance, factor, zero), ..self }
    }

    /// What makes the variance that of the noise averaged with the `usual`, as few blocks show it only roughly.
    pub fn averaged(&self, usual: Option<f64>) -> f64 {
        usual.map_or(1.0, |usual| (OWN_WEIGHT + (usual / self.noise.max(1e-300)).powi(2)) / (OWN_WEIGHT + 1.0))
    }

    /// What makes the variance that of no less than the usual noise, and the wider the less of the target agrees: those
    /// blocks may err together.
    pub fn disturbed(&self, usual: Option<f64>) -> f64 {
        let noise = (usual.unwrap_or(0.0) / self.noise.max(1e-300)).max(1.0);
        ((UNDISTURBED_SHARE / self.share).max(1.0) * noise).powi(2)
    }

    /// The sum of the variances of x and y, px².
    pub fn spread(&self) -> f64 {
        self.covariance[0][0] + self.covariance[1][1]
    }
}

/// Where a block under a pose lies: x, y in px.
fn place(pose: &PoseValue, centre: [f64; 2]) -> [f64; 2] {
    let [x, y] = centre;
    [pose[0] - pose[2] * y + pose[3] * x, pose[1] + pose[2] * x + pose[3] * y]
}

/// What a block's kernels give.
struct Products {
    /// Of a d along x and y and of a.
    sums: [f64; 3],
    /// See [`super::kernels::Exact`].
    warp: [[f64; 5]; 2],
}

/// A frame, less its level, compared with a template whose window begins at the pixel `origin` (x, y) of an image at
/// rest.
pub struct View<'a, T> {
    /// The frame.
    pub image: Image<'a, T>,
    /// Subtracted from it.
    pub level: f64,
    /// Column and row of the window.
    pub origin: [i64; 2],
}

impl<T: Pixel> View<'_, T> {
    /// The pixels of a part of the window, moved by whole pixels, put into `pixels`; false where it leaves the image.
    fn take(&self, part: &Part, whole: [i64; 2], pixels: &mut Vec<f32>) -> bool {
        let (top, left) = (whole[1] + self.origin[1] + part.top as i64, whole[0] + self.origin[0] + part.left as i64);
        let (bottom, right) = (top + part.rows() as i64, left + part.columns() as i64);
        if top < 0 || left < 0 || bottom > self.image.rows as i64 || right > self.image.columns as i64 {
            return false;
        }
        pixels.resize(part.size(), 0.0);
        for (row, pixels) in (top..bottom).zip(pixels.chunks_exact_mut(part.columns())) {
            less_offset(self.image.line(row as usize, left as usize, right as usize), self.level, pixels);
        }
        true
    }
}

/// Steps through a frame by the kernels of a bank.
struct Climber<'a, 'b, T> {
    view: &'a View<'b, T>,
    plane: &'a Plane,
    bank: &'a mut Bank,
    pixels: Vec<f32>,
}

impl<T: Pixel> Climber<'_, '_, T> {
    /// The kernels next to a block's place, and what they give; None outside the image.
    fn products(&mut self, block: usize, pose: &PoseValue) -> (Quantised, Option<Products>) {
        let block = &mut self.bank.blocks[block];
        let at = Quantised::new(place(pose, block.centre));
        if !self.view.take(&block.part, at.whole, &mut self.pixels) {
            return (at, None);
        }
        let kernels = block.kernels(at.phase, self.plane);
        let products = Products { sums: kernels.products(&self.pixels), warp: kernels.warp };
        (at, products.sums[0].is_finite().then_some(products))
    }

    /// The pose from `begin` on, moved by the median step of one block in each row and column.
    ///
    /// That is a fifth of the work, and nearly always leads to the phase whose kernels are exact. `begin` where so few
    /// blocks are not enough.
    fn approached(&mut self, begin: PoseValue) -> PoseValue {
        let mut steps = Vec::new();
        for b in 0..self.bank.blocks.len() {
            let sparse = (b % self.bank.columns + 2 * (b / self.bank.columns)) % SPARSE == 0;
            if !sparse || self.bank.blocks[b].gain_information <= 0.0 {
                continue;
            }
            let from = place(&begin, self.bank.blocks[b].centre);
            let (at, products) = self.products(b, &begin);
            if let Some(products) = products.filter(|products| products.sums[2] > MIN_OWN_GAIN) {
                steps.push(([0, 1].map(|k| at.near[k] - from[k]), products.sums));
            }
        }
        if steps.len() < MIN_SPARSE {
            return begin;
        }
        let gain = median(&mut steps.iter().map(|(_, sums)| sums[2]).collect::<Vec<f64>>());
        let mut pose = begin;
        for k in 0..2 {
            pose[k] += median(&mut steps.iter().map(|(off, sums)| off[k] + sums[k] / gain).collect::<Vec<f64>>());
        }
        pose
    }

    /// What each block shows next to a pose, and the farthest that one lies from its kernels' phase.
    fn shown(&mut self, pose: &PoseValue, usual: Option<f64>) -> (Vec<Shown>, Vec<[f64; 2]>) {
        let seen: Vec<_> = (0..self.bank.blocks.len()).map(|b| self.products(b, pose)).collect();
        let own: Vec<(f64, f64)> = seen
            .iter()
            .zip(&self.bank.blocks)
            .map(|((_, products), block)| {
                (products.as_ref().map_or(f64::NAN, |products| products.sums[2]), block.gain_information)
            })
            .collect();
        let gain = gains(&own, usual);
        let shown = seen.iter().zip(&self.bank.blocks).zip(gain).map(|(((at, products), block), gain)| {
            let Some(products) = products else { return Shown { place: at.near, ..Shown::default() } };
            let [x, y] = block.centre;
            let warp = &products.warp;
            let lever = [[warp[0][0] - y, warp[0][1] + x], [warp[1][0] + x, warp[1][1] + y]];
            // A covered block's own gain is none, whatever the others' say.
            let usable = |gain: &f64| products.sums[2] > MIN_OWN_GAIN * gain && *gain > MIN_GAIN && *gain < MAX_GAIN;
            let Some(gain) = gain.filter(usable) else { return Shown { place: at.near, information: None, lever } };
            Shown { place: moved(at, products, gain), information: block.information, lever }
        });
        (shown.collect(), seen.iter().map(|(at, _)| at.near).collect())
    }
}

/// Where a block lies, by what its kernels give and its gain.
fn moved(at: &Quantised, products: &Products, gain: f64) -> [f64; 2] {
    let [x, y] = [products.sums[0] / gain, products.sums[1] / gain];
    // Further away than the kernels are used for, the second order is not the rest of it.
    let near = (NEAR_PX / x.abs().max(y.abs()).max(NEAR_PX)).powi(2);
    [0, 1].map(|k| {
        let [.., xx, xy, yy] = products.warp[k];
        let rest = 0.5 * xx * x * x + xy * x * y + 0.5 * yy * y * y;
        at.near[k] + ([x, y][k] - near * rest)
    })
}

/// Steps from the pose `begin` in a frame; both count from the bank's zero. None where they lead to no place.
///
/// `usual`: the noise to be expected of a pixel, None where it is not known.
pub fn climb<T: Pixel>(
    view: &View<T>,
    plane: &Plane,
    bank: &mut Bank,
    begin: &PoseValue,
    usual: Option<f64>,
) -> Option<Pose> {
    let zero = bank.zero;
    let mut climber = Climber { view, plane, bank, pixels: Vec::new() };
    let mut value = climber.approached(std::array::from_fn(|k| begin[k] + zero[k]));
    let total: f64 = climber.bank.blocks.iter().map(super::bank::Block::total).sum();
    let mut found = None;
    for turn in 0..MAX_PASSES {
        let (shown, near) = climber.shown(&value, usual);
        // Far from the kernels' phase the steps are not exact: only then may the blocks differ by more than noise.
        let fused = fuse(&shown, &value, usual.filter(|_| turn > 1));
        value = fused.pose;
        if !fused.noise.is_finite() || value[2].abs() > MAX_ROLL_RAD || value[3].abs() > MAX_ZOOM {
            return None;
        }
        let agreeing = fused.weight.iter().zip(&climber.bank.blocks).map(|(weight, block)| weight * block.total());
        let share = agreeing.sum::<f64>() / total;
        let off = climber.bank.blocks.iter().zip(&near).fold(0.0f64, |most, (block, near)| {
            let at = place(&value, block.centre);
            most.max((at[0] - near[0]).abs()).max((at[1] - near[1]).abs())
        });
        let agreed = share > UNDISTURBED_SHARE && usual.is_none_or(|usual| fused.noise < ALIKE * usual);
        found = (off <= 2.0 * NEAR_PX).then_some(Pose {
            value: std::array::from_fn(|k| value[k] - zero[k]),
            covariance: fused.covariance,
            share,
            noise: fused.noise,
        });
        if off < NEAR_PX && (turn > 1 || agreed) {
            break;
        }
    }
    found
}
