//! What the acceleration alone tells of the displacement, before anything else is measured.
//!
//! It is off by a straight line, of the velocity that the motion had at the first sample: differences of phase that are
//! compared with it are constant, where the motion itself turns the phase by more than half a cycle from frame to frame.

use super::model::since;
use super::motion::GAP_STEPS;
use super::samples::View;
use serde::{Deserialize, Serialize};

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

    /// Whether it is of so many axes.
    pub fn fits(&self, axes: usize) -> bool {
        self.axes.len() == axes
    }
}
