//! A frame that shows the target undisturbed: one pose of the whole window, and the test that its blocks agree with it.
//!
//! Three sums over the pixels of each block of the window - with the template's slopes along x and y and with the
//! template, all low-passed, at the nearest phase - are all that is taken from a frame. What they must be is linear in
//! translation, roll, zoom, gain and the ramps of gain and level across the window; generalised least squares over all
//! blocks gives those. A block's level drops out of its sums. Kernels that leave each block a gain and ramps of its own
//! (see [`super::kernels`]) lose 4 % of the precision to them in 25 blocks, and more in smaller ones; here they cost 1
//! %. What disturbs a part of the target shows in the rest of its blocks: a frame in which one of them, or all
//! together, have more of it than noise makes is no such frame, and the blocks are asked one by one (see
//! [`super::climb`]).

use super::bank::{Division, Plane};
use super::blocks::{PoseValue, drawn};
use super::climb::{MAX_GAIN, MIN_GAIN, NEAR_PX, OWN_WEIGHT, Pose, View};
use super::image::{Image, Pixel};
use super::kernels::{PHASES, Quantised, phase_slot};
use super::matrix::{Matrix, inverse, inverse_with_pivots, scaled_sum, times};
use super::products::{Factor, PAIRS};
use super::vector::{WIDE_LANES as LANES, gathered, sum, vectorised};
use super::window_tables::{GAIN, SPARSE, SUMS, Tables, UNKNOWNS, WANTED};
use std::ops::Range;

/// Blocks along each axis, and the least size in px for which there are fewer of them: the unknowns of the whole window
/// are distinguished by many blocks, not by large ones.
const DIVISION: (usize, usize) = (5, 8);
/// Three normal components reach this sum of squares in one of 25 blocks once in 30 000 frames.
const WORST_SQUARE: f64 = 30.0;
/// Times the usual: 66 degrees of freedom about 1.1 of the usual exceed it once in 50 000 frames.
const MAX_NOISE: f64 = 1.5;
/// By roll and zoom at the window's corners: blocks that lie further apart need phases of their own.
const MAX_TURN_PX: f64 = 0.03;
/// A longer step is only roughly known.
const FAR_PX: f64 = 0.25;
const MAX_TURNS: usize = 6;
const MIN_BLOCKS: usize = 4;
/// What roll, zoom, gain and ramps may cost the translation's deviation. They cost 1 to 13 % where texture fills the
/// window, and the double where it is one row or column of blocks (a cable before the sky), which also draws it aside.
const MAX_COST: f64 = 1.2;
/// Share of its row below which a pivot of the unknowns' information says that they are not distinguished at all.
const SINGULAR: f64 = 1e-13;

/// What is known before a frame.
#[derive(Clone, Debug)]
pub struct Known {
    /// The usual noise of a pixel; None while no frame has shown it.
    pub usual: Option<f64>,
    /// The noise to be expected then.
    pub at_first: f64,
    /// Covariance of the zero.
    pub zero: Matrix<4>,
}

/// A template's tables, made phase by phase as frames need them.
pub struct Undisturbed {
    division: Division,
    centres: Vec<[f64; 2]>,
    share: Vec<f64>,
    slots: Vec<Option<(usize, Box<Tables>)>>,
    separable: Option<bool>,
    half_px: f64,
    /// The pose that poses count from.
    pub zero: PoseValue,
}

type BlockSums = Vec<[f64; SUMS]>;

impl Undisturbed {
    /// Tables for `held` phases at most.
    pub fn new(plane: &Plane, held: usize) -> Self {
        let division = Division::new(&plane.window, DIVISION.0, DIVISION.1).in_eights();
        let parts = division.parts();
        Self {
            centres: parts.iter().map(|part| division.centre(part)).collect(),
            share: plane.texture_share(&parts),
            division,
            slots: vec![None; held],
            separable: None,
            half_px: 0.5 * (plane.window.height as f64).hypot(plane.window.width as f64),
            zero: [0.0; 4],
        }
    }

    /// Covariance of x and y for noise of variance 1, px².
    pub fn covariance(&mut self, plane: &Plane) -> [[f64; 2]; 2] {
        let all = inverse(&self.at_rest(plane).normal);
        [[all[0][0], all[0][1]], [all[1][0], all[1][1]]]
    }

    /// The tables of the phase in which nothing has moved.
    fn at_rest(&mut self, plane: &Plane) -> &Tables {
        self.tables((PHASES * (PHASES / 2) + PHASES / 2) as usize, plane)
    }

    /// Whether the texture distinguishes translation from roll, zoom, gain and ramps, see `MAX_COST`.
    fn separable(&mut self, plane: &Plane) -> bool {
        if let Some(separable) = self.separable {
            return separable;
        }
        let separable = is_separable(self.at_rest(plane));
        self.separable = Some(separable);
        separable
    }

    /// The tables of a phase, made where they are not there.
    fn tables(&mut self, phase: usize, plane: &Plane) -> &Tables {
        let slot = phase_slot(phase, self.slots.len());
        if self.slots[slot].as_ref().is_some_and(|(held, _)| *held != phase) {
            self.slots[slot] = None;
        }
        let Self { division, centres, share, slots, .. } = self;
        let (_, tables) =
            slots[slot].get_or_insert_with(|| (phase, Box::new(Tables::new(plane, division, share, centres, phase))));
        tables
    }

    /// The pose in a frame, looked for around `begin`.
    ///
    /// None where the frame is disturbed, turned or enlarged, or leaves no whole window.
    pub fn fit<T: Pixel>(&mut self, view: &View<T>, plane: &Plane, begin: &PoseValue, known: &Known) -> Option<Pose> {
        if self.half_px * (begin[2].abs() + begin[3].abs()) > MAX_TURN_PX || !self.separable(plane) {
            return None;
        }
        let (width, height, half_px, zero) = (plane.window.width, plane.window.height, self.half_px, self.zero);
        let (mut place, mut rough) = ([begin[0] + zero[0], begin[1] + zero[1]], true);
        for turn in 0..MAX_TURNS {
            let at = Quantised::new(place);
            let (top, left) = (at.whole[1] + view.origin[1], at.whole[0] + view.origin[0]);
            let inside = top >= 0 && left >= 0;
            if !(inside
                && top + height as i64 <= view.image.rows as i64
                && left + width as i64 <= view.image.columns as i64)
            {
                return None;
            }
            let window = Seen { image: view.image, level: view.level, top: top as usize, left: left as usize, width };
            self.tables(at.phase, plane);
            let tables = &self.slots[phase_slot(at.phase, self.slots.len())].as_ref()?.1;
            if rough {
                let [x, y] = window.sparse_shift(tables, height);
                place = [at.near[0] + x, at.near[1] + y];
                rough = x.abs() + y.abs() > FAR_PX;
                continue;
            }
            let sums = window.block_sums(tables, &self.division);
            let (_, found) = weighed(tables, &sums);
            if !(found[GAIN] > MIN_GAIN && found[GAIN] < MAX_GAIN) {
                return None;
            }
            let first = self.first_order(tables, &sums, &found);
            let (score, found) = weighed(tables, &first);
            let gain = found[GAIN];
            place = [0, 1].map(|k| at.near[k] + found[k] / gain);
            let off = (found[0] / gain).abs().max((found[1] / gain).abs());
            if off > NEAR_PX && turn + 1 < MAX_TURNS {
                continue;
            }
            let noise = noise(tables, &first, &found, known.usual.unwrap_or(known.at_first))?;
            let turned = half_px * (found[2].abs() + found[3].abs()) / gain;
            if !noise.is_finite() || off > 2.0 * NEAR_PX || turned > MAX_TURN_PX {
                return None;
            }
            let (value, covariance) = shrunk(&tables.normal, &score, gain, noise, known);
            let from = [at.near[0], at.near[1], 0.0, 0.0];
            let value = std::array::from_fn(|k| if k < 2 { value[k] + from[k] - zero[k] } else { value[k] });
            return Some(Pose { value, covariance, share: 1.0, noise });
        }
        None
    }

    /// The sums less what the second order of each block's shift puts there.
    fn first_order(&self, tables: &Tables, sums: &BlockSums, found: &[f64; UNKNOWNS]) -> BlockSums {
        let gain = found[GAIN];
        let blocks = sums.iter().zip(&self.centres).zip(tables.rows.chunks_exact(SUMS));
        blocks
            .map(|((sums, [across, down]), rows)| {
                let x = (found[0] - down * found[2] + across * found[3]) / gain;
                let y = (found[1] + across * found[2] + down * found[3]) / gain;
                let (xx, xy, yy) = (0.5 * gain * x * x, gain * x * y, 0.5 * gain * y * y);
                std::array::from_fn(|k| {
                    let second = &rows[k].second;
                    sums[k] - second[0] * xx - second[1] * xy - second[2] * yy
                })
            })
            .collect()
    }
}

/// Whether the joint fit costs translations little more than a fit of them alone.
fn is_separable(tables: &Tables) -> bool {
    let mut information = Matrix::<UNKNOWNS>::default();
    for block in tables.rows.chunks_exact(SUMS) {
        for row in block {
            for (weight, other) in row.inverse.iter().zip(block) {
                for (into, response) in information.iter_mut().zip(row.response) {
                    into.iter_mut().zip(other.response).for_each(|(sum, value)| *sum += response * weight * value);
                }
            }
        }
    }
    let root: [f64; UNKNOWNS] = std::array::from_fn(|k| information[k][k].sqrt());
    if !root.iter().all(|root| *root > 0.0) {
        return false;
    }
    let scaled = std::array::from_fn(|i| std::array::from_fn(|j| information[i][j] / (root[i] * root[j])));
    let Some(joint) = inverse_with_pivots::<UNKNOWNS>(&scaled, SINGULAR) else { return false };
    let alone = 1.0 - scaled[0][1] * scaled[0][1];
    // Both in units of what each alone would have.
    joint[0][0] * alone < MAX_COST * MAX_COST && joint[1][1] * alone < MAX_COST * MAX_COST
}

/// The window in a frame.
struct Seen<'a, T> {
    image: Image<'a, T>,
    level: f64,
    top: usize,
    left: usize,
    width: usize,
}

impl<T: Pixel> Seen<'_, T> {
    /// The sums of each block.
    fn block_sums(&self, tables: &Tables, division: &Division) -> BlockSums {
        let mut out = Vec::with_capacity((division.down.len() - 1) * (division.across.len() - 1));
        let mut lines = Lines::new(self.width);
        for rows in division.down.windows(2) {
            lines.sum(self, tables, rows[0]..rows[1], 1);
            parts_summed(&lines.sums, &division.across, &mut out);
        }
        out
    }

    /// Shift x, y in px, roughly, from one row in `SPARSE`; zeros where they show nothing.
    fn sparse_shift(&self, tables: &Tables, height: usize) -> [f64; 2] {
        let mut lines = Lines::new(self.width);
        lines.sum(self, tables, SPARSE / 2..height, SPARSE);
        let sums = lines.sums.each_ref().map(|line| f64::from(sum(line)));
        let found = times(&tables.sparse, &sums);
        if found[2] > MIN_GAIN { [found[0] / found[2], found[1] / found[2]] } else { [0.0; 2] }
    }
}

/// Lines of a window, and the sums of their products with the kernels.
struct Lines<F> {
    /// Of each 16 columns, line after line; past the window's last column 0.
    factors: Vec<[F; LANES]>,
    /// Of each pair of columns.
    sums: [Vec<f32>; SUMS],
}

impl<F: Factor> Lines<F> {
    fn new(width: usize) -> Self {
        let groups = width.div_ceil(LANES);
        Self { factors: Vec::new(), sums: std::array::from_fn(|_| vec![0.0; groups * PAIRS]) }
    }

    /// Sum the products of three kernels with each `step`th of some rows of a frame's window less its level.
    fn sum<T: Pixel<Factor = F>>(&mut self, seen: &Seen<T>, tables: &Tables, rows: Range<usize>, step: usize) {
        let count = rows.len().div_ceil(step);
        self.factors.resize(count * seen.width.div_ceil(LANES), [F::default(); LANES]);
        read(seen, rows.clone(), step, &mut self.factors);
        multiplied(&self.factors, count, tables, rows, step, &mut self.sums);
    }
}

vectorised! {
    /// Fill `out` with rows of a window; a frame's memory is gone through in its order, which is the quickest.
    fn read<T: Pixel>(seen: &Seen<T>, rows: Range<usize>, step: usize, out: &mut [[T::Factor; LANES]]) {
        let count = rows.len().div_ceil(step);
        for (n, r) in rows.step_by(step).enumerate() {
            let line = seen.image.line(seen.top + r, seen.left, seen.left + seen.width);
            for (group, pixels) in line.chunks(LANES).enumerate() {
                let out = &mut out[group * count + n];
                if let Some(pixels) = pixels.first_chunk::<LANES>() {
                    for c in 0..LANES {
                        out[c] = pixels[c].factor(seen.level);
                    }
                } else {
                    *out = [T::Factor::default(); LANES];
                    out.iter_mut().zip(pixels).for_each(|(out, pixel)| *out = pixel.factor(seen.level));
                }
            }
        }
    }
}

vectorised! {
    /// Fill `out` with the sums of products of `count` lines with the kernels of each `step`th row.
    fn multiplied<F: Factor>(
        factors: &[[F; LANES]], count: usize, tables: &Tables, rows: Range<usize>, step: usize, out: &mut [Vec<f32>; SUMS],
    ) {
        for (group, lines) in factors.chunks_exact(count).enumerate() {
            let kernels = &tables.kernels(group * LANES)[rows.clone()];
            let sums = F::products(lines, kernels, step);
            for (out, sums) in out.iter_mut().zip(&sums) {
                out[group * PAIRS..(group + 1) * PAIRS].copy_from_slice(sums);
            }
        }
    }
}

vectorised! {
    /// Put the sums of three lines of pairs of columns between the edges into `out`.
    fn parts_summed(lines: &[Vec<f32>; SUMS], edges: &[usize], out: &mut BlockSums) {
        for edges in edges.windows(2) {
            let mut sums = [0.0; SUMS];
            for (sum_of, line) in sums.iter_mut().zip(lines) {
                let fours = line[edges[0] / 2..edges[1].div_ceil(2)].chunks_exact(4);
                let (mut lanes, rest) = ([0.0f32; 4], fours.remainder());
                for four in fours {
                    for k in 0..4 {
                        lanes[k] += four[k];
                    }
                }
                lanes.iter_mut().zip(rest).for_each(|(lane, value)| *lane += value);
                *sum_of = f64::from(gathered(lanes));
            }
            out.push(sums);
        }
    }
}

vectorised! {
    /// Score of x, y, roll and zoom, and all unknowns, of which those four are times the gain.
    fn weighed(tables: &Tables, sums: &BlockSums) -> ([f64; WANTED], [f64; UNKNOWNS]) {
        let mut both = [0.0; UNKNOWNS];
        for (row, value) in tables.rows.iter().zip(sums.as_flattened()) {
            for (sum, weight) in both.iter_mut().zip(&row.weight) {
                *sum += weight * value;
            }
        }
        let score = std::array::from_fn(|k| both[k]);
        let wanted = times(&inverse(&tables.normal), &score);
        let found = std::array::from_fn(|u| match u.checked_sub(WANTED) {
            None => wanted[u],
            Some(other) => {
                both[u] - tables.share[other].iter().zip(wanted).map(|(share, value)| share * value).sum::<f64>()
            }
        });
        (score, found)
    }
}

/// Noise of a pixel as the blocks show it; None where so few count, or one or all lie further from what was found than
/// noise puts them.
fn noise(tables: &Tables, sums: &BlockSums, found: &[f64; UNKNOWNS], expected: f64) -> Option<f64> {
    let (mut total, mut worst, mut count) = (0.0, 0.0f64, 0usize);
    for (rows, sums) in tables.rows.chunks_exact(SUMS).zip(sums) {
        let rest: [f64; SUMS] = std::array::from_fn(|k| {
            rows[k].response.iter().zip(found).fold(sums[k], |rest, (response, value)| rest - response * value)
        });
        let mut square = 0.0;
        for k in 0..SUMS {
            square += rest[k] * rows[k].inverse.iter().zip(rest).map(|(weight, rest)| weight * rest).sum::<f64>();
        }
        total += square;
        worst = worst.max(square);
        count += usize::from(rows[0].inverse[0] > 0.0);
    }
    let noise = (total / (SUMS * count).saturating_sub(UNKNOWNS).max(1) as f64).sqrt();
    let likely = worst < WORST_SQUARE * expected * expected && noise < MAX_NOISE * expected;
    (count >= MIN_BLOCKS && likely).then_some(noise)
}

/// x, y, roll and zoom, the last two drawn to zero as far as they may be noise, and their covariance with that of the
/// zero; few blocks show the noise only roughly, so that its variance and the usual are averaged.
///
/// `normal`: for a gain of 1.
fn shrunk(
    normal: &Matrix<WANTED>,
    score: &[f64; WANTED],
    gain: f64,
    noise: f64,
    known: &Known,
) -> (PoseValue, Matrix<WANTED>) {
    let matrix = normal.map(|row| row.map(|value| value * gain * gain));
    let (pose, inverse) = drawn(matrix, &score.map(|value| value * gain), noise, noise * noise);
    let variance =
        known.usual.map_or(noise * noise, |usual| (OWN_WEIGHT * noise * noise + usual * usual) / (OWN_WEIGHT + 1.0));
    (pose, scaled_sum(&inverse, variance, &known.zero))
}
