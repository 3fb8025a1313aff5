//! A template with all that is computed from it once, and the peak of its ZNCC in a frame.
//!
//! After Ma, Liu, Choi and Sohn, equation 2: every whole-pixel position of a span is tried, and the spline peak next to
//! the best one is the translation.

use super::correlation::{smooth, zncc_map};
use super::grid::{Grid, Part};
use super::image::{Image, Pixel};
use super::patch::values;
use super::peak::{self, Precision, centred, maximum, spline_products};
use super::spline::translated;
use std::sync::OnceLock;

/// Polynomial terms an axis for the energy of the shifted template over ±1 px.
const ENERGY_TERMS: usize = 11;
/// How often a search moves on to a peak on its rim.
const MAX_MOVES: usize = 5;
/// A peak that lies farther than this from a whole pixel is looked for around the next one.
const NEXT_PIXEL_PX: f64 = 0.75;

/// A window of an image: its first pixel and its size, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Column of the first pixel.
    pub x: i64,
    /// Row of the first pixel.
    pub y: i64,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// A peak: translation (px), its variances (px²) and the correlation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fix {
    /// To the right.
    pub x: f64,
    /// Down.
    pub y: f64,
    /// Variances of both.
    pub variance: [f64; 2],
    /// Correlation, at most 1.
    pub quality: f64,
}

/// Whole-pixel positions of the window's top left corner, both ends included.
#[derive(Clone, Copy)]
struct Span {
    x: [i64; 2],
    y: [i64; 2],
}

impl Span {
    fn is_empty(&self) -> bool {
        self.x[0] > self.x[1] || self.y[0] > self.y[1]
    }

    /// The part of this span within the radii of (x, y).
    fn around(&self, x: i64, y: i64, radius: [i64; 2]) -> Self {
        let within = |span: [i64; 2], at: i64, radius: i64| [span[0].max(at - radius), span[1].min(at + radius)];
        Self { x: within(self.x, x, radius[0]), y: within(self.y, y, radius[1]) }
    }
}

/// A smoothed cut of an image, whose first pixel is the image's pixel (x, y).
struct Patch {
    pixels: Grid,
    x: i64,
    y: i64,
}

/// The reference window and all that is computed from it once.
pub struct Template {
    /// The part of the region that is matched.
    pub window: Window,
    /// Of the low-pass (2 m + 1,).
    pub taps: Vec<f32>,
    /// Spline coefficients (h + 6, w + 6).
    pub grid: Grid,
    /// Template, filtered and with zero mean, and its gradients along x and y (h, w).
    pub basis: [Grid; 3],
    /// For the variance of a peak.
    pub precision: Precision,
    /// Smallest correlation that is accepted.
    pub threshold: f64,
    norm: OnceLock<Grid<f64>>,
}

impl Template {
    /// See the fields.
    pub fn new(
        window: Window,
        taps: Vec<f32>,
        grid: Grid,
        basis: [Grid; 3],
        precision: Precision,
        threshold: f64,
    ) -> Self {
        Self { window, taps, grid, basis, precision, threshold, norm: OnceLock::new() }
    }

    /// Polynomial of ln √(energy) by the shift; most templates that seed another tracker never need it.
    fn norm(&self) -> &Grid<f64> {
        self.norm.get_or_init(|| log_norm(&self.grid))
    }

    /// All positions where the window with so much around it lies inside an image.
    fn span<T: Pixel>(&self, image: &Image<T>, margin: i64) -> Span {
        let along = |pixels: usize, size: usize| [margin, pixels as i64 - size as i64 - margin];
        Span { x: along(image.columns, self.window.width), y: along(image.rows, self.window.height) }
    }

    fn margin(&self) -> i64 {
        (self.taps.len() / 2) as i64
    }

    /// The smoothed cut for a whole-pixel search; None where too many pixels have no value.
    fn patch<T: Pixel>(&self, image: &Image<T>, span: &Span, level: f64) -> Option<Patch> {
        let margin = self.margin();
        let edges =
            |span: [i64; 2], size: usize| [span[0] - margin, span[1] + size as i64 + margin].map(|k| k as usize);
        let ([left, right], [top, bottom]) = (edges(span.x, self.window.width), edges(span.y, self.window.height));
        let raw = values(&image.part(Part { top, bottom, left, right }), level)?;
        Some(Patch { pixels: smooth(&raw, &self.taps), x: span.x[0], y: span.y[0] })
    }

    /// The best peak within `radius` (x, y) of the window's place (x, y); one on the rim moves the search there.
    pub fn near<T: Pixel>(&self, image: &Image<T>, level: f64, place: [i64; 2], radius: [i64; 2]) -> Option<Fix> {
        let whole = self.span(image, self.margin());
        let [mut x, mut y] = place;
        for _ in 0..MAX_MOVES {
            let span = whole.around(x, y, radius);
            if span.is_empty() {
                return None;
            }
            let patch = self.patch(image, &span, level)?;
            let surface = zncc_map(&patch.pixels, &self.basis[0]);
            let best = first_largest(&surface.values);
            (x, y) = (patch.x + (best % surface.columns) as i64, patch.y + (best / surface.columns) as i64);
            let on_rim =
                |at: i64, span: [i64; 2], whole: [i64; 2]| span.contains(&at) && whole[0] < at && at < whole[1];
            if !(on_rim(x, span.x, whole.x) || on_rim(y, span.y, whole.y)) {
                return self.locate(&patch, [x, y]).filter(|fix| fix.quality >= self.threshold);
            }
        }
        None
    }

    /// The peak within a pixel of the window's place (x, y), however poor.
    pub fn peak_at<T: Pixel>(&self, image: &Image<T>, level: f64, place: [i64; 2]) -> Option<Fix> {
        let span = self.span(image, self.margin() + 1).around(place[0], place[1], [1, 1]);
        if span.is_empty() {
            return None;
        }
        self.locate(&self.patch(image, &span, level)?, place)
    }

    /// The spline peak of ZNCC next to the whole-pixel position `place` (x, y) in `patch`.
    fn locate(&self, patch: &Patch, place: [i64; 2]) -> Option<Fix> {
        let [mut x, mut y] = place;
        for _ in 0..3 {
            let (top, left) = (usize::try_from(y - patch.y).ok()?, usize::try_from(x - patch.x).ok()?);
            let part = Part { top, bottom: top + self.window.height, left, right: left + self.window.width };
            if part.bottom > patch.pixels.rows || part.right > patch.pixels.columns {
                return None;
            }
            let mut window = centred(&patch.pixels, part);
            let shift = maximum(&spline_products(&window, &self.grid), self.norm())?;
            if shift[0].abs().max(shift[1].abs()) <= NEXT_PIXEL_PX {
                let residual = peak::residual(&mut window, &self.grid, &self.basis, shift)?;
                return Some(Fix {
                    x: (x - self.window.x) as f64 + shift[0],
                    y: (y - self.window.y) as f64 + shift[1],
                    variance: self.precision.variances(&residual.sums),
                    quality: residual.quality.min(1.0),
                });
            }
            (x, y) = (x + shift[0].round_ties_even() as i64, y + shift[1].round_ties_even() as i64);
        }
        None
    }
}

/// Number of the first of the largest values.
fn first_largest(values: &[f64]) -> usize {
    let mut best = 0;
    for (k, value) in values.iter().enumerate() {
        if *value > values[best] {
            best = k;
        }
    }
    best
}

/// Polynomial (powers of y by powers of x) of ln √(energy of the template shifted by -1 … 1 px), through Chebyshev's
/// nodes.
fn log_norm(grid: &Grid) -> Grid<f64> {
    let nodes: [f64; ENERGY_TERMS] =
        std::array::from_fn(|k| (std::f64::consts::PI * (k as f64 + 0.5) / ENERGY_TERMS as f64).cos());
    let mut table = Grid::filled(ENERGY_TERMS, ENERGY_TERMS, 0.0);
    for (j, &y) in nodes.iter().enumerate() {
        for (i, &x) in nodes.iter().enumerate() {
            table.row_mut(j)[i] = 0.5 * square_about_mean(&translated(grid, x, y)).max(1e-300).ln();
        }
    }
    // Along each axis in turn.
    along_rows(&along_rows(&table, &nodes).transposed(), &nodes).transposed()
}

/// Sum of the squares about the mean.
fn square_about_mean(grid: &Grid) -> f64 {
    let count = grid.values.len() as f64;
    let mean = grid.values.iter().map(|&value| f64::from(value)).sum::<f64>() / count;
    grid.values.iter().map(|&value| (f64::from(value) - mean).powi(2)).sum()
}

/// Each row's values at the nodes as coefficients of the powers: Newton's divided differences, expanded.
fn along_rows(table: &Grid<f64>, nodes: &[f64; ENERGY_TERMS]) -> Grid<f64> {
    let mut out = table.clone();
    for r in 0..table.rows {
        let divided = out.row_mut(r);
        for order in 1..ENERGY_TERMS {
            for k in (order..ENERGY_TERMS).rev() {
                divided[k] = (divided[k] - divided[k - 1]) / (nodes[k] - nodes[k - order]);
            }
        }
        for k in (0..ENERGY_TERMS - 1).rev() {
            for m in k..ENERGY_TERMS - 1 {
                divided[m] -= nodes[k] * divided[m + 1];
            }
        }
    }
    out
}
