//! A target's translation from what a tracker found in a frame: watched, dated by its row, and of the ideal camera.

use super::image::{Image, Region};
use super::kept::Storable;
use super::lens::Lens;
use super::motion::Prediction;
use super::tracker::{Fix, Look, Tracker};
use super::watch::{LOST, Translation, Unseen, Watch};
use crate::Status;

const NANOSECONDS: f64 = 1e9;
/// How much farther than the last region the next frame's pixels are asked for.
const AHEAD_PX: usize = 4;

/// How the sensor's rows are read out: with a rolling shutter one after another.
#[derive(Clone, Copy, Debug)]
pub struct Shutter {
    /// From the first row (which the stamps belong to) to the last, s.
    pub readout_s: f64,
    /// By which the sensor's picture was turned counterclockwise.
    pub quarter_turns: u8,
    /// Rows and columns of a frame.
    pub shape: [usize; 2],
}

impl Shutter {
    /// How long after a frame's stamp the row of a place was read out, ns.
    fn late_ns(&self, [x, y]: [f64; 2]) -> i64 {
        if self.readout_s == 0.0 {
            return 0;
        }
        let last = self.shape.map(|size| size as f64 - 1.0);
        let (row, rows) = match self.quarter_turns % 4 {
            0 => (y, last[0]),
            1 => (x, last[1]),
            2 => (last[0] - y, last[0]),
            _ => (last[1] - x, last[1]),
        };
        (self.readout_s * NANOSECONDS * row / rows.max(1.0)).round_ties_even() as i64
    }
}

/// A target's place under a lens: its translation is that of the ideal place of its region's middle.
#[derive(Clone, Copy, Debug)]
pub struct Refracted {
    lens: Lens,
    /// Width and height of the frames.
    size: [f64; 2],
    /// The region's middle, and its ideal place.
    middle: [f64; 2],
    ideal: [f64; 2],
}

impl Refracted {
    /// A lens for frames of a size (width, height); None where it does not reach the region's middle.
    pub fn new(lens: Lens, size: [usize; 2], middle: [f64; 2]) -> Option<Self> {
        let made = Self { lens, size: size.map(|side| side as f64), middle, ideal: [0.0; 2] };
        Some(Self { ideal: made.straight(middle)?.0, ..made })
    }

    /// The ideal place of a place inside the frame, and the derivatives.
    fn straight(&self, place: [f64; 2]) -> Option<([f64; 2], [[f64; 2]; 2])> {
        let inside = (0..2).all(|k| place[k] >= -0.5 && place[k] <= self.size[k] - 0.5);
        let found = self.lens.straight(place).filter(|_| inside)?;
        Some((found.place, found.slope))
    }

    /// A translation as the ideal camera shows it; lost where the model does not reach the target.
    ///
    /// Variances pass through the derivatives, the errors along x and y taken as independent.
    pub fn ideal(&self, found: Translation) -> Translation {
        let Some((place, slope)) = self.straight([0, 1].map(|k| self.middle[k] + found.place[k])) else { return LOST };
        let through = |variance: [f64; 2]| slope.map(|[x, y]| x * x * variance[0] + y * y * variance[1]);
        Translation {
            place: [0, 1].map(|k| place[k] - self.ideal[k]),
            variance: through(found.variance),
            reference_variance: through(found.reference_variance),
            ..found
        }
    }

    /// A prediction in px of the ideal camera as the frames show it; None where the model does not reach.
    pub fn shown(&self, prediction: Prediction) -> Option<Prediction> {
        let found = self.lens.shown([0, 1].map(|k| self.ideal[k] + prediction.place[k]))?;
        let [x, y] = prediction.std;
        Some(Prediction {
            place: [0, 1].map(|k| found.place[k] - self.middle[k]),
            std: found.slope.map(|[by_x, by_y]| (by_x * x).hypot(by_y * y)),
        })
    }
}

/// A target's row of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Of the sensor's row that its middle lies in.
    pub time_ns: i64,
    /// In px of the ideal camera.
    pub translation: Translation,
    /// Why nothing was looked for, if so.
    pub unseen: Option<Unseen>,
}

/// What a frame gives.
pub enum Seen {
    /// The target's row.
    Row(Row),
    /// The target must be searched for; the frame is not taken.
    Search(Option<Fix>),
    /// The region leaves the image.
    Outside,
}

/// All that happens to a target's translation besides its tracker.
pub struct Chain {
    /// What the picture says of it.
    pub watch: Watch,
    middle: [f64; 2],
    shutter: Shutter,
    refracted: Option<Refracted>,
}

impl Chain {
    /// `lens`: with the width and height of the frames that it is for. None where that does not reach the region.
    pub fn new(watch: Watch, region: Region, shutter: Shutter, lens: Option<(Lens, [usize; 2])>) -> Option<Self> {
        let middle = middle(region);
        let refracted = match lens {
            Some((lens, size)) => Some(Refracted::new(lens, size, middle)?),
            None => None,
        };
        Some(Self { watch, middle, shutter, refracted })
    }

    /// A prediction in px of the ideal camera as the frames show it; None where the lens does not reach.
    pub fn shown(&self, prediction: Option<Prediction>) -> Option<Prediction> {
        self.refracted.map_or(prediction, |lens| lens.shown(prediction?))
    }

    /// How long after the reference frame's stamp the row of the target's middle was read out, ns.
    pub fn first_late_ns(&self) -> i64 {
        self.shutter.late_ns(self.middle)
    }

    /// The row of a frame that goes through the tracker as well. `prediction`: in px of the ideal camera.
    pub fn track<T: Storable>(
        &mut self,
        tracker: &mut Tracker,
        image: &Image<'_, T>,
        time_ns: i64,
        prediction: Option<Prediction>,
    ) -> Seen {
        if let Some(row) = self.unseen(image, time_ns) {
            tracker.learnable = false;
            return Seen::Row(row);
        }
        match tracker.track(*image, time_ns, self.shown(prediction)) {
            Look::Known(found) => self.push(image, time_ns, found).map_or(Seen::Outside, Seen::Row),
            Look::Search(candidate) => Seen::Search(candidate),
        }
    }

    /// Ask for the pixels of the next frame about the place where the target was last.
    pub fn ask_for<T: Storable>(&self, image: &Image<'_, T>, tracker: &Tracker) {
        let [x, y] = tracker.memory.motion.place.map(|moved| moved.round_ties_even() as i64);
        image.ask_for(self.watch.region.moved(x, y, AHEAD_PX));
    }

    /// The row of a frame with what a tracker found in it; None where the region leaves the image.
    pub fn push<T: Storable>(&mut self, image: &Image<'_, T>, time_ns: i64, found: Translation) -> Option<Row> {
        let (found, unseen) = self.watch.push(image, time_ns, found)?;
        Some(self.row(time_ns, found, unseen))
    }

    /// The row of a frame in which nothing is to be looked for, dark or torn; None of others.
    pub fn unseen<T: Storable>(&mut self, image: &Image<'_, T>, time_ns: i64) -> Option<Row> {
        let why = self.watch.unseen(image)?;
        Some(self.row(time_ns, LOST, Some(why)))
    }

    fn row(&self, time_ns: i64, found: Translation, unseen: Option<Unseen>) -> Row {
        let moved = if found.place.iter().all(|value| value.is_finite()) { found.place } else { [0.0; 2] };
        let late_ns = self.shutter.late_ns([0, 1].map(|k| self.middle[k] + moved[k]));
        let translation = match self.refracted {
            Some(lens) if found.status != Status::Lost => lens.ideal(found),
            _ => found,
        };
        Row { time_ns: time_ns.saturating_add(late_ns), translation, unseen }
    }
}

/// The middle of a region, px.
pub fn middle(region: Region) -> [f64; 2] {
    [region.x as f64 + 0.5 * (region.width as f64 - 1.0), region.y as f64 + 0.5 * (region.height as f64 - 1.0)]
}

#[cfg(test)]
mod tests {
    use super::super::lens::Model;
    use super::*;

    #[test]
    fn rows_are_read_out_one_after_another_whichever_way_the_picture_was_turned() {
        let late = |quarter_turns| Shutter { readout_s: 0.02, quarter_turns, shape: [101, 201] }.late_ns([50.0, 25.0]);
        assert_eq!([0, 1, 2, 3].map(late), [5_000_000, 5_000_000, 15_000_000, 15_000_000]);
        assert_eq!(Shutter { readout_s: 0.0, quarter_turns: 0, shape: [9, 9] }.late_ns([f64::NAN; 2]), 0);
    }

    #[test]
    fn a_translation_and_its_prediction_go_through_the_lens_and_back() {
        let model = Model::Pinhole([-0.2, 0.05, 0.001, -0.001, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let lens = Lens { focal: [170.0, 171.0], centre: [88.0, 87.0], model, limit: 1.5 };
        let one = Refracted::new(lens, [176, 176], [40.0, 60.0]).unwrap();
        let found = Translation { status: Status::Tracking, place: [3.0, -2.0], variance: [1e-4, 4e-4], ..LOST };
        let ideal = one.ideal(found);
        let back = one.shown(Prediction { place: ideal.place, std: ideal.variance.map(f64::sqrt) }).unwrap();
        for k in 0..2 {
            assert!((back.place[k] - found.place[k]).abs() < 1e-9);
            // The derivatives there and back are inverse; errors along x and y become correlated, which is left out.
            assert!((back.std[k] / found.variance[k].sqrt() - 1.0).abs() < 0.05);
        }
        assert_eq!(one.ideal(Translation { place: [500.0, 0.0], ..found }).status, Status::Lost);
        assert!(Refracted::new(lens, [176, 176], [200.0, 60.0]).is_none());
    }
}
