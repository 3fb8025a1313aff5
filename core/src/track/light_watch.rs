//! How far changed light may move the result of a tracker whose reference stays the first frame.
//!
//! A bump or a ledge is shaded anew when the light turns: part of that looks as if the target had moved. A tracker with
//! one reference frame does not see it; the picture does, as it is less and less the reference's. Under light from
//! another side a picture is a · reference + b · something else, and the shift that is taken for motion goes with b:
//! its variance with the share of the picture's contrast, squared, that is not the reference's (see [`super::light`]).

use super::image::{Image, Pixel, Region};
use super::light::Reference;
use serde::{Deserialize, Serialize};

/// From one look at the picture to the next, ns, and looks that the median is taken of: what passes by is no light.
const LOOK_NS: i64 = 1_000_000_000;
const LOOKS: usize = 5;
/// The best of the first looks after the reference tells what noise takes, as light may turn already; it scatters by
/// this share, and pictures without noise by this much.
const USUAL_LOOKS: usize = 6;
const SCATTER: f64 = 0.5;
const MIN_SCATTER: f64 = 1e-3;
/// Standard deviation (px) that a picture of which nothing is the reference's any more stands for.
pub const LIGHT_PX: f64 = 0.12;
/// A standard deviation beyond which changed light is reported, px.
const NOTABLE_PX: f64 = 0.05;

/// What a watch remembers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct LightMemory {
    first: Vec<f64>,
    last: Vec<f64>,
    due_ns: Option<i64>,
    variance_px2: f64,
    /// The largest variance so far, px².
    pub largest_px2: f64,
    /// The stamp of the first one that is worth reporting.
    pub notable_ns: Option<i64>,
}

impl LightMemory {
    /// A look has found this share of the picture not the reference's.
    fn look(&mut self, share: f64, time_ns: i64) {
        if self.last.len() == LOOKS {
            self.last.remove(0);
        }
        self.last.push(share);
        if self.first.len() < USUAL_LOOKS {
            self.first.push(share);
            return;
        }
        let usual = (1.0 + SCATTER) * self.first.iter().copied().fold(f64::INFINITY, f64::min) + MIN_SCATTER;
        let mut last = self.last.clone();
        last.sort_by(f64::total_cmp);
        self.variance_px2 = LIGHT_PX * LIGHT_PX * (last[last.len() / 2] - usual).max(0.0);
        self.largest_px2 = self.largest_px2.max(self.variance_px2);
        if self.variance_px2 > NOTABLE_PX * NOTABLE_PX {
            self.notable_ns.get_or_insert(time_ns);
        }
    }
}

/// Takes a target's frames and gives the variance that light adds to where it was found.
pub struct LightWatch {
    reference: Reference,
    /// What changes from frame to frame.
    pub memory: LightMemory,
}

impl LightWatch {
    /// `region` of the reference frame is what light is compared with.
    pub fn new<T: Pixel>(reference: &Image<'_, T>, region: Region) -> Self {
        Self { reference: Reference::new(reference, region), memory: LightMemory::default() }
    }

    /// The variance (px²) along either axis as the picture shows it; `place`: of the target that was found in the
    /// frame, None: in which it was not.
    pub fn push<T: Pixel>(&mut self, image: &Image<'_, T>, time_ns: i64, place: Option<[f64; 2]>) -> f64 {
        let due_ns = self.memory.due_ns;
        let place = place.filter(|_| due_ns.is_none_or(|due_ns| time_ns >= due_ns));
        if let Some(share) = place.and_then(|place| self.reference.unlike(image, place)) {
            // The first frame is the reference itself.
            if due_ns.is_some() {
                self.memory.look(share, time_ns);
            }
            self.memory.due_ns = Some(time_ns.saturating_add(LOOK_NS));
        }
        self.memory.variance_px2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changed_light_is_kept_with_when_it_began() {
        let mut memory = LightMemory::default();
        let shares = [(0.0, USUAL_LOOKS), (0.1, 4), (0.5, 4), (0.0, 5)];
        let shares = shares.iter().flat_map(|&(share, count)| std::iter::repeat_n(share, count));
        for (share, k) in shares.zip(0..) {
            memory.look(share, k);
        }
        // The third of five looks is the middle one; 0.12 px · √0.1 is not notable, 0.12 px · √0.5 = 0.085 px is.
        assert_eq!((memory.notable_ns, memory.variance_px2), (Some(USUAL_LOOKS as i64 + 4 + 2), 0.0));
        assert!((memory.largest_px2.sqrt() / (LIGHT_PX * 0.5f64.sqrt()) - 1.0).abs() < 0.01);
    }
}
