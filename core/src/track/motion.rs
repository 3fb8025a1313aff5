//! What a tracker remembers of its target's motion, and where that leads it to look first.

const NANOSECONDS: f64 = 1e9;
/// Nothing is looked for farther away, px.
const LONGEST_DISTANCE_PX: f64 = 1e6;

/// Where the target should be, px since the reference frame, with standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// x and y.
    pub place: [f64; 2],
    /// Of both.
    pub std: [f64; 2],
}

/// The last translation and what followed it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// x and y, px.
    pub place: [f64; 2],
    /// Its stamp.
    pub time_ns: Option<i64>,
    /// px/s; 0 where it is not known.
    pub speed: [f64; 2],
    /// How many frames the target has been lost since.
    pub lost_frames: u64,
    /// Whether that was because it could not be distinguished from places that look like it: where it was then says
    /// nothing of where it is.
    pub confused: bool,
}

/// Seconds from one stamp to another.
fn elapsed_s(from_ns: i64, to_ns: i64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 / NANOSECONDS
}

impl Motion {
    /// Translation (px) to look at first: the predicted one, else as far as before at the last speed.
    pub fn expected(&self, time_ns: i64, prediction: Option<Prediction>) -> [f64; 2] {
        let predicted = prediction.map(|one| one.place).filter(|place| (place[0] + place[1]).is_finite());
        let elapsed_s = self.time_ns.map_or(0.0, |last| elapsed_s(last, time_ns));
        let place = predicted.unwrap_or_else(|| [0, 1].map(|k| self.place[k] + self.speed[k] * elapsed_s));
        place.map(|x| x.clamp(-LONGEST_DISTANCE_PX, LONGEST_DISTANCE_PX))
    }

    /// A frame that shows the target; the speed is only known between two frames that both do.
    pub fn seen(&mut self, time_ns: i64, place: [f64; 2]) {
        let elapsed_s = self.time_ns.filter(|_| self.lost_frames == 0).map_or(0.0, |last| elapsed_s(last, time_ns));
        let step = |k: usize| if elapsed_s > 0.0 { (place[k] - self.place[k]) / elapsed_s } else { 0.0 };
        *self = Self { place, time_ns: Some(time_ns), speed: [step(0), step(1)], lost_frames: 0, confused: false };
    }

    /// A frame that does not show the target, or in which it cannot be distinguished from places that look like it.
    pub fn missed(&mut self, confused: bool) {
        let confused = self.confused || confused;
        *self = Self { speed: [0.0; 2], lost_frames: self.lost_frames.saturating_add(1), confused, ..*self };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_is_expected_at_its_last_speed_or_where_it_is_predicted() {
        let mut motion = Motion::default();
        motion.seen(1_000_000_000, [1.0, -2.0]);
        assert_eq!(motion.expected(9_000_000_000, None), [1.0, -2.0]);
        motion.seen(1_500_000_000, [2.0, -2.0]);
        assert_eq!(motion.expected(2_000_000_000, None), [3.0, -2.0]);
        let at = |x| Some(Prediction { place: [x, 0.0], std: [1.0; 2] });
        assert_eq!(motion.expected(0, at(1e300)), [1e6, 0.0]);
        assert_eq!(motion.expected(1_500_000_000, at(f64::NAN)), [2.0, -2.0]);
        motion.missed(true);
        motion.missed(false);
        assert_eq!((motion.lost_frames, motion.confused, motion.expected(i64::MIN, None)), (2, true, [2.0, -2.0]));
        motion.seen(1_600_000_000, [2.5, -2.0]);
        assert_eq!(motion, Motion { place: [2.5, -2.0], time_ns: Some(1_600_000_000), ..Motion::default() });
    }
}
