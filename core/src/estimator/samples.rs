//! Blocks of samples of the acceleration, and what it alone tells of the displacement before anything else is measured.
//!
//! That is off by a straight line, of the velocity that the motion had at the first sample: differences of phase that
//! are compared with it are constant, where the motion itself turns the phase by more than half a cycle from frame to
//! frame.

use super::model::since;
use super::motion::GAP_STEPS;
use serde::{Deserialize, Serialize};

/// The kind of a sample that was bridged: its row is coasting at best.
pub const BRIDGED: u8 = 1;
/// The kind of a sample that was put into a long gap: it is no row.
pub const INSERTED: u8 = 2;

/// Samples along all axes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Samples {
    /// How many axes there are.
    pub axes: usize,
    /// Stamps (n,), ns, increasing.
    pub time_ns: Vec<i64>,
    /// Accelerations (n · axes), m/s².
    pub value: Vec<f64>,
    /// Densities (n · axes) of their noise for the interval that ends at the sample, (m/s²)²/Hz.
    pub density: Vec<f64>,
    /// Kinds (n,).
    pub kind: Vec<u8>,
}

impl Samples {
    /// None yet.
    pub fn none(axes: usize) -> Self {
        Self { axes, ..Self::default() }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.time_ns.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.time_ns.is_empty()
    }

    /// All of them as a view.
    pub fn view(&self) -> View<'_> {
        let Self { axes, time_ns, value, density, kind } = self;
        View { axes: *axes, time_ns, value, density, kind }
    }

    /// Adds others behind.
    pub fn extend(&mut self, other: View) {
        self.time_ns.extend_from_slice(other.time_ns);
        self.value.extend_from_slice(other.value);
        self.density.extend_from_slice(other.density);
        self.kind.extend_from_slice(other.kind);
    }

    /// Takes memory for more.
    pub fn reserve(&mut self, more: usize) {
        self.time_ns.reserve(more);
        self.value.reserve(more * self.axes);
        self.density.reserve(more * self.axes);
        self.kind.reserve(more);
    }

    /// Drops the first ones.
    pub fn drop_first(&mut self, count: usize) {
        self.time_ns.drain(..count);
        self.value.drain(..count * self.axes);
        self.density.drain(..count * self.axes);
        self.kind.drain(..count);
    }

    /// Whether all parts are as long as they must be.
    pub fn consistent(&self, axes: usize) -> bool {
        let n = self.len();
        self.axes == axes && self.value.len() == n * axes && self.density.len() == n * axes && self.kind.len() == n
    }
}

/// Samples that are held elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// See [`Samples`].
    pub axes: usize,
    /// See [`Samples`].
    pub time_ns: &'a [i64],
    /// See [`Samples`].
    pub value: &'a [f64],
    /// See [`Samples`].
    pub density: &'a [f64],
    /// See [`Samples`].
    pub kind: &'a [u8],
}

impl View<'_> {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.time_ns.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.time_ns.is_empty()
    }

    /// Those from one to before another.
    pub fn part(&self, first: usize, end: usize) -> Self {
        Self {
            axes: self.axes,
            time_ns: &self.time_ns[first..end],
            value: &self.value[first * self.axes..end * self.axes],
            density: &self.density[first * self.axes..end * self.axes],
            kind: &self.kind[first..end],
        }
    }

    /// A copy.
    pub fn owned(&self) -> Samples {
        let mut whole = Samples::none(self.axes);
        whole.extend(*self);
        whole
    }

    /// Times in s after an origin, to `time_s`.
    pub fn seconds(&self, origin_ns: i64, time_s: &mut Vec<f64>) {
        time_s.clear();
        time_s.extend(self.time_ns.iter().map(|&time_ns| since(time_ns, origin_ns)));
    }

    /// Whether a sample is a row, given the stamp of the first one.
    #[inline]
    pub fn is_row(&self, k: usize, first_ns: i64) -> bool {
        self.time_ns[k] >= first_ns && self.kind[k] != INSERTED
    }
}

/// One axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Along {
    acceleration: f64,
    velocity_m_s: f64,
    displacement_m: f64,
}

/// The acceleration integrated twice from rest at the first sample, up to the last one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Integrated {
    time_s: f64,
    step_s: f64,
    axes: Vec<Along>,
}

impl Integrated {
    /// Goes on over further samples; bias (axes,): what rest measures, m/s².
    pub fn after(before: Option<Self>, samples: View, origin_ns: i64, bias_m_s2: &[f64]) -> Option<Self> {
        let mut whole = before;
        for k in 0..samples.len() {
            let time_s = since(samples.time_ns[k], origin_ns);
            let value = |a: usize| samples.value[k * samples.axes + a] - bias_m_s2[a];
            let own = whole.get_or_insert_with(|| Self {
                time_s,
                step_s: 0.0,
                axes: (0..samples.axes).map(|a| Along { acceleration: value(a), ..Along::default() }).collect(),
            });
            let dt = time_s - own.time_s;
            for (a, axis) in own.axes.iter_mut().enumerate() {
                let (was, now) = (axis.acceleration, value(a));
                axis.displacement_m += dt * axis.velocity_m_s + dt * dt * (2.0 * was + now) / 6.0;
                axis.velocity_m_s += 0.5 * dt * (was + now);
                axis.acceleration = now;
            }
            own.step_s = if dt > 0.0 { dt } else { own.step_s };
            own.time_s = time_s;
        }
        whole
    }

    /// Displacement (m) at a time after the last sample, whose acceleration is held; None where no samples come.
    pub fn at(&self, time_s: f64, axis: usize) -> Option<f64> {
        let dt = time_s - self.time_s;
        let one = self.axes.get(axis).filter(|_| dt <= GAP_STEPS * self.step_s)?;
        Some(one.displacement_m + dt * one.velocity_m_s + 0.5 * dt * dt * one.acceleration)
    }

    /// Whether it is of this many axes.
    pub fn fits(&self, axes: usize) -> bool {
        self.axes.len() == axes
    }
}
