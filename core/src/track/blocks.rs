//! Robust fusion of the translations of many blocks into one translation, roll and zoom.

use super::matrix::{Matrix, inverse, lower_median, median, times};

/// Tukey's weight is 0 beyond this many standard deviations.
const CUT: f64 = 6.0;
/// What Tukey's weights do to a mean square of two normal components (m exponential of mean 2, cut at 6), and to the
/// variance of the weighted mean: E[m] E[w] / E[w m], and E[w² m/2] E[w] / E[w - m (1 - m/36) 2/36]².
const SQUARE_FACTOR: f64 = 1.124;
const VARIANCE_FACTOR: f64 = 0.920;
/// Squared distance over its scale: two normal components reach it once in 20 000 blocks.
const PLAIN_SQUARE: f64 = 20.0;
/// Of the blocks about the medians: nothing covers the target, no vote is needed.
const AGREED: f64 = 0.9;
/// Of the noise over the usual one: more is not noise.
const MAX_SQUARE: f64 = 1.7;
/// Medians of the square of a normal variable, and of the sum of two such.
const MEDIAN_SQUARE: f64 = 0.455;
const MEDIAN_OF_TWO: f64 = 1.386;
const MAX_PASSES: usize = 12;
const SETTLED_PX: f64 = 1e-5;
const MIN_BLOCKS: usize = 4;
const MIN_WEIGHT: f64 = 2.5;

/// x, y in px, roll in rad, zoom.
pub type PoseValue = [f64; 4];

/// What one block shows.
#[derive(Clone, Copy, Debug, Default)]
pub struct Shown {
    /// Translation x, y, px.
    pub place: [f64; 2],
    /// Inverse covariance of x and y for noise of scale 1: xx, xy, yy; None where the block does not count.
    pub information: Option<[f64; 3]>,
    /// By how many px a roll of 1 rad and a zoom of 1 move the block along x and y.
    pub lever: [[f64; 2]; 2],
}

impl Shown {
    /// Squared Mahalanobis distance of the block's translation from the pose's.
    fn distance(&self, information: [f64; 3], pose: &PoseValue) -> f64 {
        let [x, y] =
            [0, 1].map(|k| self.place[k] - (pose[k] + self.lever[k][0] * pose[2] + self.lever[k][1] * pose[3]));
        information[0] * x * x + 2.0 * information[1] * x * y + information[2] * y * y
    }
}

/// What the blocks say together.
#[derive(Clone, Debug)]
pub struct Fused {
    /// The pose.
    pub pose: PoseValue,
    /// Its covariance.
    pub covariance: Matrix<4>,
    /// How much each block counts, 0 to 1.
    pub weight: Vec<f64>,
    /// Scale of the noise; infinite where the blocks do not agree at all.
    pub noise: f64,
}

/// Gain of every block, drawn to the median of all as far as its own is uncertain; None without one.
///
/// `gain`: of blocks, with their inverse variances for noise of scale 1; `usual`: the scale to be expected, None where
/// it is not known.
pub fn gains(gain: &[(f64, f64)], usual: Option<f64>) -> Vec<Option<f64>> {
    let usable = |&(gain, information): &(f64, f64)| gain.is_finite() && information > 0.0;
    let mut all: Vec<f64> = gain.iter().filter(|one| usable(one)).map(|one| one.0).collect();
    if all.is_empty() {
        return vec![None; gain.len()];
    }
    let middle = median(&mut all);
    let among =
        || gain.iter().filter(|one| usable(one)).map(|&(gain, information)| ((gain - middle).powi(2), information));
    // The scatter of equal gains gives the noise; what is more than that is their own difference.
    let mut scatter: Vec<f64> = among().map(|(square, information)| square * information).collect();
    let mut noise = median(&mut scatter) / MEDIAN_SQUARE;
    if let Some(usual) = usual {
        noise = noise.min(MAX_SQUARE * usual * usual);
    }
    let (mut squares, mut variances): (Vec<f64>, Vec<f64>) =
        among().map(|(square, information)| (square, noise / information)).unzip();
    let spread = (median(&mut squares) / MEDIAN_SQUARE - median(&mut variances)).max(0.0);
    gain.iter()
        .map(|one| {
            let (gain, information) = *one;
            usable(one).then(|| {
                let (square, variance) = ((gain - middle).powi(2), noise / information);
                // A block's own gain also counts as far as it lies outside the noise: covered blocks must not be
                // averaged away.
                let alone = (1.0 - 4.0 * variance / square.max(1e-300)).max(0.0);
                middle + (spread / (spread + variance).max(1e-300)).max(alone) * (gain - middle)
            })
        })
        .collect()
}

/// Normal matrix, its diagonal a little larger, and right side of the weighted fit of x, y, roll, zoom.
fn normal(blocks: &[Counted], weight: &[f64]) -> (Matrix<4>, PoseValue) {
    let (mut matrix, mut right) = (Matrix::<4>::default(), PoseValue::default());
    for (block, &weight) in blocks.iter().zip(weight).filter(|(_, weight)| **weight > 0.0) {
        let [xx, xy, yy] = block.information;
        let lever = &block.shown.lever;
        let a = [[1.0, 0.0, lever[0][0], lever[0][1]], [0.0, 1.0, lever[1][0], lever[1][1]]];
        for i in 0..4 {
            let pa = [weight * (xx * a[0][i] + xy * a[1][i]), weight * (xy * a[0][i] + yy * a[1][i])];
            right[i] += pa[0] * block.shown.place[0] + pa[1] * block.shown.place[1];
            for j in 0..=i {
                matrix[i][j] += pa[0] * a[0][j] + pa[1] * a[1][j];
            }
        }
    }
    let lower = matrix;
    for (i, row) in matrix.iter_mut().enumerate() {
        (i + 1..4).for_each(|j| row[j] = lower[j][i]);
        row[i] = row[i] * (1.0 + 1e-9) + 1e-12;
    }
    (matrix, right)
}

/// A block that counts.
struct Counted<'a> {
    number: usize,
    shown: &'a Shown,
    information: [f64; 3],
}

/// The pose, turned and enlarged as `begin`, that most of the blocks agree with, among those of the blocks.
fn voted(blocks: &[Counted], begin: &PoseValue, square: f64) -> PoseValue {
    let (mut best, mut most) = (*begin, -1.0);
    for block in blocks.iter().filter(|block| block.information[0] > 0.0) {
        let lever = &block.shown.lever;
        let at = [0, 1].map(|k| block.shown.place[k] - lever[k][0] * begin[2] - lever[k][1] * begin[3]);
        let pose = [at[0], at[1], begin[2], begin[3]];
        // A block's own error doubles the squared distances from it.
        let vote = |other: &Counted| {
            (1.0 - other.shown.distance(other.information, &pose) / (2.0 * CUT * CUT * square)).max(0.0).powi(2)
        };
        let votes = blocks.iter().filter(|other| other.information[0] > 0.0).map(vote).sum();
        if votes > most {
            (best, most) = (pose, votes);
        }
    }
    best
}

/// The pose of the blocks by Tukey's biweight from the pose that most blocks vote for.
///
/// Its scale is from the median distance of the blocks, at most 1.3 times the `usual` one (None: not known), so that
/// more than half of them may say anything. Roll and zoom are drawn to zero as far as they may be noise. `begin`: the
/// pose before.
pub fn fuse(blocks: &[Shown], begin: &PoseValue, usual: Option<f64>) -> Fused {
    let counted: Vec<Counted> = blocks
        .iter()
        .enumerate()
        .filter_map(|(number, shown)| {
            let information = shown.information.filter(|p| p[0] + p[2] > 0.0)?;
            Some(Counted { number, shown, information })
        })
        .collect();
    let none = Fused {
        pose: *begin,
        covariance: [[f64::INFINITY; 4]; 4],
        weight: vec![0.0; blocks.len()],
        noise: f64::INFINITY,
    };
    if counted.len() < MIN_BLOCKS {
        return none;
    }
    let most = usual.map_or(f64::INFINITY, |usual| MAX_SQUARE * usual * usual);
    let distances = |pose: &PoseValue| {
        counted.iter().map(|block| block.shown.distance(block.information, pose)).collect::<Vec<_>>()
    };
    let scale_of = |distance: &[f64]| (lower_median(&mut distance.to_vec()) / MEDIAN_OF_TWO).max(1e-12).min(most);
    let middle =
        [0, 1].map(|k| lower_median(&mut counted.iter().map(|block| block.shown.place[k]).collect::<Vec<f64>>()));
    let seed = [middle[0], middle[1], begin[2], begin[3]];
    let distance = distances(&seed);
    let square = scale_of(&distance);
    let near = distance.iter().filter(|distance| **distance < CUT * CUT * square).count() as f64 / counted.len() as f64;
    let mut pose = if near > AGREED { seed } else { voted(&counted, begin, square) };
    let mut fused = none;
    for pass in 0..MAX_PASSES {
        let distance = distances(&pose);
        let square = scale_of(&distance);
        let before = pose;
        // Where no block stands out none needs to count less: equal weights are the more exact.
        let plain = distance.iter().copied().fold(0.0, f64::max) < PLAIN_SQUARE * square;
        let (of_square, of_variance) = if plain { (1.0, 1.0) } else { (SQUARE_FACTOR, VARIANCE_FACTOR) };
        let tukey = |distance: &f64| if plain { 1.0 } else { (1.0 - distance / (CUT * CUT * square)).max(0.0).powi(2) };
        let weight: Vec<f64> = distance.iter().map(tukey).collect();
        let total: f64 = weight.iter().sum();
        fused.weight.fill(0.0);
        counted.iter().zip(&weight).for_each(|(block, weight)| fused.weight[block.number] = *weight);
        if total < MIN_WEIGHT {
            return Fused { pose, noise: f64::INFINITY, ..fused };
        }
        let weighted: f64 = weight.iter().zip(&distance).map(|(weight, distance)| weight * distance).sum();
        fused.noise = (of_square * weighted / (2.0 * total - 4.0).max(1.0)).sqrt();
        let ((matrix, right), noise) = (normal(&counted, &weight), fused.noise);
        (pose, fused.covariance) = drawn(matrix, &right, noise, of_variance * noise * noise);
        fused.covariance = fused.covariance.map(|row| row.map(|value| value * of_variance * noise * noise));
        if pass > 0 && (pose[0] - before[0]).abs().max((pose[1] - before[1]).abs()) < SETTLED_PX {
            break;
        }
    }
    Fused { pose, ..fused }
}

/// The solution of normal equations, roll and zoom drawn to zero as far as they may be noise, and the inverse of their
/// matrix then; `variance`: of the noise as they weigh it.
pub fn drawn(mut matrix: Matrix<4>, right: &PoseValue, noise: f64, variance: f64) -> (PoseValue, Matrix<4>) {
    let plain = inverse(&matrix);
    let pose = times(&plain, right);
    for k in 2..4 {
        let own = variance * plain[k][k];
        matrix[k][k] += noise.max(1e-9).powi(2) / ((pose[k] * pose[k] - own).max(1e-3 * own) + 1e-300);
    }
    let inverse = inverse(&matrix);
    (times(&inverse, right), inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall(covered: usize) -> Vec<Shown> {
        (0..25)
            .map(|b| {
                let (x, y) = ((b % 5) as f64 * 20.0 - 40.0, (b / 5) as f64 * 20.0 - 40.0);
                let noise = 0.001 * ((37 * b) % 11) as f64 - 0.005;
                let (roll, zoom) = (0.01, -0.002);
                let mut place = [0.3 - y * roll + x * zoom + noise, -0.2 + x * roll + y * zoom - noise];
                if b < covered {
                    place = [1.7 + 0.1 * b as f64, -2.0];
                }
                Shown { place, information: Some([1e4, 0.0, 1e4]), lever: [[-y, x], [x, y]] }
            })
            .collect()
    }

    #[test]
    fn what_covers_a_third_of_the_blocks_does_not_move_the_pose() {
        for covered in [0, 8] {
            let fused = fuse(&wall(covered), &[0.0; 4], None);
            for (value, (expected, tolerance)) in
                fused.pose.iter().zip([(0.3, 2e-3), (-0.2, 2e-3), (0.01, 1e-4), (-0.002, 1e-4)])
            {
                assert!((value - expected).abs() < tolerance, "{covered} {value} {expected}");
            }
            assert!(fused.weight[..covered].iter().all(|weight| *weight == 0.0));
            assert!(fused.noise.is_finite());
        }
        assert!(fuse(&wall(0)[..3], &[0.0; 4], None).noise.is_infinite());
    }

    #[test]
    fn equal_gains_are_averaged_and_one_that_stands_out_is_kept() {
        let mut shown: Vec<(f64, f64)> = (0..20).map(|k| (1.0 + 0.01 * f64::from(k % 5 - 2), 1e4)).collect();
        shown[3].0 = 0.2;
        shown[5].1 = 0.0;
        let found = gains(&shown, Some(1.0));
        assert!(found[5].is_none() && (found[3].unwrap() - 0.2).abs() < 0.05);
        assert!((found[4].unwrap() - 1.0).abs() < 0.01);
    }
}
