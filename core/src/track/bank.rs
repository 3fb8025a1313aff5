//! A template's kernels in blocks, for the phases that were needed, and how much each block of it tells.

use super::blocks::PoseValue;
use super::fine_spline::{BEYOND, Fine, PER_PX, slopes};
use super::grid::{Grid, Part};
use super::kernels::{Halves, build, edges, phase_shift, phase_slot};
use super::matrix::inverse;
use super::template::Window;

/// Of a block's gradients so much must be texture, not noise.
const MIN_SHARE: f64 = 0.3;

/// What kernels are made from.
#[derive(Clone)]
pub struct Plane {
    /// Fine spline coefficients (2 h + 7, 2 w + 7) of the template and of the low-passed one.
    pub grids: [Fine; 2],
    /// One over the noise variance of each of the window's pixels (h, w), about 1.
    pub weight: Grid,
    /// What noise adds to the mean of the low-passed gradient's square.
    pub gradient_noise: f64,
    /// Where the template lies in the reference frame.
    pub window: Window,
}

impl Plane {
    /// Both grids cut out of coefficients around the window, which begins at the pixel `origin` (row, column) of them.
    pub fn new(
        wide: [&Grid; 2],
        origin: (usize, usize),
        weight: Grid,
        gradient_noise: f64,
        window: Window,
    ) -> Option<Self> {
        let size = (window.height, window.width);
        let needed = [origin.0 + size.0, origin.1 + size.1].map(|pixels| PER_PX * pixels + BEYOND);
        let fits = wide.iter().all(|grid| grid.rows >= needed[0] && grid.columns >= needed[1]);
        (fits && weight.rows == size.0 && weight.columns == size.1).then(|| Self {
            grids: wide.map(|grid| Fine::of(grid).cropped(origin, size)),
            weight,
            gradient_noise,
            window,
        })
    }

    /// Share of the low-passed gradients of each block that is texture, not noise; 0 where it is too little.
    pub fn texture_share(&self, parts: &[Part]) -> Vec<f64> {
        let whole = Part { top: 0, bottom: self.window.height, left: 0, right: self.window.width };
        let planes = slopes(&self.grids[1], whole, 0.0, 0.0);
        parts
            .iter()
            .map(|part| {
                let square = variance(&planes.x, *part) + variance(&planes.y, *part);
                let share = (1.0 - self.gradient_noise / square.max(1e-30)).clamp(0.0, 1.0);
                if share > MIN_SHARE { share } else { 0.0 }
            })
            .collect()
    }
}

/// Variance of a part of a grid.
fn variance(grid: &Grid, part: Part) -> f64 {
    let values = || (part.top..part.bottom).flat_map(|r| &grid.row(r)[part.left..part.right]).map(|&v| f64::from(v));
    let mean = values().sum::<f64>() / part.size() as f64;
    values().map(|value| (value - mean).powi(2)).sum::<f64>() / part.size() as f64
}

/// How a window is divided into blocks.
#[derive(Clone)]
pub struct Division {
    /// Edges of the blocks down.
    pub down: Vec<usize>,
    /// Edges of the blocks across.
    pub across: Vec<usize>,
}

impl Division {
    /// At most that number of blocks along each axis, of at least `least` px.
    pub fn new(window: &Window, most: usize, least: usize) -> Self {
        Self { down: edges(window.height, most, least), across: edges(window.width, most, least) }
    }

    /// The same with inner edges across at multiples of 8, or fewer blocks: numbers are taken by eights.
    pub fn in_eights(mut self) -> Self {
        let last = self.across.len() - 1;
        self.across[..last].iter_mut().for_each(|edge| *edge = (*edge + 4) / 8 * 8);
        self.across.dedup();
        self
    }

    /// The blocks, row after row.
    pub fn parts(&self) -> Vec<Part> {
        let rows = self.down.windows(2);
        let part = |rows: &[usize], columns: &[usize]| Part {
            top: rows[0],
            bottom: rows[1],
            left: columns[0],
            right: columns[1],
        };
        rows.flat_map(|rows| self.across.windows(2).map(move |columns| part(rows, columns))).collect()
    }

    /// Where the middle (x, y) of a block lies from that of the window, px.
    pub fn centre(&self, part: &Part) -> [f64; 2] {
        let from_middle = |first: usize, end: usize, edges: &[usize]| {
            0.5 * (end as f64 + first as f64 - edges.last().copied().unwrap_or(0) as f64)
        };
        [from_middle(part.left, part.right, &self.across), from_middle(part.top, part.bottom, &self.down)]
    }
}

/// One block of a template.
pub struct Block {
    /// Its pixels in the window.
    pub part: Part,
    /// Its middle (x, y) from the window's, px.
    pub centre: [f64; 2],
    /// Inverse covariance of x and y for noise of scale 1: xx, xy, yy; None without texture.
    pub information: Option<[f64; 3]>,
    /// Inverse variance of the gain, 0 without texture.
    pub gain_information: f64,
    slots: Vec<Option<(usize, Halves)>>,
}

impl Block {
    fn new(plane: &Plane, part: Part, centre: [f64; 2], share: f64, held: usize) -> Self {
        let covariance =
            build(&plane.grids, &plane.weight, part, [0.0; 2]).map(|one| one.covariance(&plane.weight, part));
        let finite = covariance.filter(|c| share > 0.0 && c.iter().flatten().all(|value| value.is_finite()));
        let information = finite.map(|c| {
            let p = inverse(&[[c[0][0], c[0][1]], [c[1][0], c[1][1]]]);
            [share * p[0][0], share * p[0][1], share * p[1][1]]
        });
        let gain_information = match (information, finite) {
            (Some(p), Some(c)) if p[0] > 0.0 => 1.0 / c[2][2].max(1e-300),
            _ => 0.0,
        };
        Self { part, centre, information, gain_information, slots: vec![None; held] }
    }

    /// How much the block tells of x and y.
    pub fn total(&self) -> f64 {
        self.information.map_or(0.0, |p| p[0] + p[2])
    }

    /// The kernels for a phase, made in place of those of another where they are not there.
    pub fn kernels(&mut self, phase: usize, plane: &Plane) -> &Halves {
        let slot = phase_slot(phase, self.slots.len());
        let part = self.part;
        if self.slots[slot].as_ref().is_some_and(|(held, _)| *held != phase) {
            self.slots[slot] = None;
        }
        let (_, kernels) = self.slots[slot].get_or_insert_with(|| {
            let exact = build(&plane.grids, &plane.weight, part, phase_shift(phase));
            (phase, Halves::new(exact.as_ref(), part.size()))
        });
        kernels
    }
}

/// A template in blocks.
pub struct Bank {
    /// Row after row.
    pub blocks: Vec<Block>,
    /// Of the blocks.
    pub columns: usize,
    /// The pose that poses count from.
    pub zero: PoseValue,
}

impl Bank {
    /// At most that number of blocks along each axis, of at least `least` px, each with kernels for `held` phases.
    pub fn new(plane: &Plane, (most, least): (usize, usize), held: usize) -> Self {
        let division = Division::new(&plane.window, most, least);
        let parts = division.parts();
        let shares = plane.texture_share(&parts);
        let block = |(part, share): (&Part, f64)| Block::new(plane, *part, division.centre(part), share, held);
        let blocks = parts.iter().zip(shares).map(block).collect();
        Self { blocks, columns: division.across.len() - 1, zero: [0.0; 4] }
    }

    /// Inverse covariance of x and y of all blocks together, for noise of scale 1.
    pub fn information(&self) -> [[f64; 2]; 2] {
        let mut out = [[0.0; 2]; 2];
        for p in self.blocks.iter().filter_map(|block| block.information) {
            out[0][0] += p[0];
            out[0][1] += p[1];
            out[1][0] += p[1];
            out[1][1] += p[2];
        }
        out
    }
}
