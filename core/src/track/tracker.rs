//! The registration tracker from frame to frame: where to look, whether the target was found there, what is usual.
//!
//! Where the expected place does not lead to the target it has to be searched for, which is the caller's.

use super::climb::Pose;
use super::grid::Grid;
use super::image::{Image, Pixel};
use super::motion::{Motion, Prediction};
use super::patch::values;
use super::registration::Registration;
use super::watch::{LOST, Translation};
use crate::Status;

/// A target that is found within this of its expected place is not taken for another, px.
const NEXT_PX: f64 = 1.0;
/// Times the usual noise.
pub const SUSPICIOUS: f64 = 4.0;
/// Of the target's information: less agrees by chance, or with what moves differently in the region.
pub const MAJORITY: f64 = 0.5;
/// Of the reference's noise: less is a picture without noise, whose blocks differ by aliasing.
const MIN_NOISE: f64 = 0.5;
/// Of the reference's noise: a frame that agrees better than this is the reference itself.
const SELF_SHARE: f64 = 0.05;
/// Noise up to this times the usual one, and shares of a frame's noise that become usual below and above: noise below
/// it counts quickly, noise above it slowly, so that a long disturbance does not become the usual.
const ALIKE: f64 = 1.2;
const QUICK_SHARE: f64 = 0.1;
const SLOW_SHARE: f64 = 0.005;
/// Of the target's information that must agree in a frame that is learned from.
const LEARN_SHARE: f64 = 0.7;
/// At the window's edge, px: more roll or zoom would blur what is learned.
const LEARN_TURN_PX: f64 = 0.03;
/// Strength of a quality of 1.
const FULL_QUALITY: f64 = 100.0;

/// What does not change while frames are tracked.
#[derive(Clone, Copy, Debug)]
pub struct Given {
    /// Rows and columns of a frame.
    pub shape: [usize; 2],
    /// Subtracted from frames.
    pub level: f64,
    /// Noise of a pixel of the reference frame, and of the difference of a frame and the template.
    pub reference_noise: f64,
    /// See `reference_noise`.
    pub difference_noise: f64,
    /// Variance added for what interpolation and aliasing get wrong, px².
    pub floor_px2: f64,
    /// Half the window's diagonal, px.
    pub far_px: f64,
}

/// Everything that changes from frame to frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Memory {
    /// Where the target was.
    pub motion: Motion,
    /// Its roll, rad.
    pub roll_rad: f64,
    /// Its zoom.
    pub zoom: f64,
    /// The noise of an undisturbed frame, 0 while none has shown it.
    pub usual_noise: f64,
    /// How many frames that rests on.
    pub judged_frames: u64,
}

/// A pose with the variances of its values.
#[derive(Clone, Copy, Debug)]
pub struct Fix {
    /// x, y (px), roll (rad), zoom.
    pub value: [f64; 4],
    /// Theirs.
    pub variance: [f64; 4],
    /// Share of the information that agrees.
    pub share: f64,
    /// Noise of a pixel as the blocks' scatter shows it.
    pub noise: f64,
}

impl From<Pose> for Fix {
    fn from(pose: Pose) -> Self {
        let Pose { value, covariance, share, noise } = pose;
        Self { value, variance: std::array::from_fn(|k| covariance[k][k]), share, noise }
    }
}

/// What a look at the expected place gives.
#[derive(Clone, Copy, Debug)]
pub enum Look {
    /// The target, or that it is lost.
    Known(Translation),
    /// The place does not lead to the target for sure, which must be searched for; what was found there, if anything.
    Search(Option<Fix>),
}

/// Follows a target.
pub struct Tracker {
    /// What frames are registered with.
    pub registration: Registration,
    given: Given,
    /// What changes.
    pub memory: Memory,
    /// Whether the last frame shows the target undisturbed, neither turned nor enlarged, to be learned from.
    pub learnable: bool,
}

impl Tracker {
    /// A tracker at the reference frame.
    pub fn new(registration: Registration, given: Given) -> Self {
        Self { registration, given, memory: Memory::default(), learnable: false }
    }

    /// What does not change.
    pub fn given(&self) -> &Given {
        &self.given
    }

    /// The noise to be expected of a frame; None while none has shown it.
    fn usual(&self) -> Option<f64> {
        let shown = self.memory.usual_noise;
        (shown > 0.0).then(|| shown.max(MIN_NOISE * self.given.reference_noise))
    }

    /// Takes a frame whose target lies where it is expected; else it must be searched for, and the frame is not taken.
    pub fn track<T: Pixel>(&mut self, image: Image<T>, time_ns: i64, prediction: Option<Prediction>) -> Look {
        self.learnable = false;
        let place = self.memory.motion.expected(time_ns, prediction);
        let Some(filled) = self.filled(&image, place) else { return Look::Known(self.miss(false)) };
        if self.memory.motion.lost_frames > 0 {
            return Look::Search(None);
        }
        let Some(fix) = self.registered(image, filled.as_ref(), place) else { return Look::Search(None) };
        let near = (fix.value[0] - place[0]).hypot(fix.value[1] - place[1]) <= NEXT_PX;
        if near && fix.share > MAJORITY && self.is_trusted(&fix) {
            Look::Known(self.accept(time_ns, &fix))
        } else {
            Look::Search(Some(fix))
        }
    }

    /// The pose about a place (px) since the reference frame.
    pub fn look<T: Pixel>(&mut self, image: Image<T>, place: [f64; 2]) -> Option<Fix> {
        let filled = self.filled(&image, place)?;
        self.registered(image, filled.as_ref(), place)
    }

    /// Whether the blocks agree as well as noise lets them: at a wrong place they do not.
    pub fn is_trusted(&self, fix: &Fix) -> bool {
        fix.noise < SUSPICIOUS * self.given.difference_noise.max(self.usual().unwrap_or(0.0))
    }

    /// The least noise of a pose that nothing is known of but its place.
    pub fn suspicious_noise(&self) -> f64 {
        SUSPICIOUS * self.given.reference_noise.max(self.usual().unwrap_or(0.0))
    }

    /// Takes a frame that shows the target at a pose.
    pub fn accept(&mut self, time_ns: i64, fix: &Fix) -> Translation {
        let [x, y, roll_rad, zoom] = fix.value;
        self.learnable = self.is_learnable(fix);
        self.memory.motion.seen(time_ns, [x, y]);
        (self.memory.roll_rad, self.memory.zoom) = (roll_rad, zoom);
        self.judge(fix.noise);
        Translation {
            status: Status::Tracking,
            place: [x, y],
            variance: [0, 1].map(|k| fix.variance[k] + self.given.floor_px2),
            quality: fix.share,
            strength: FULL_QUALITY * fix.share,
            zoom: [zoom, fix.variance[3]],
            ..LOST
        }
    }

    /// Takes a frame that does not show the target.
    pub fn miss(&mut self, confused: bool) -> Translation {
        self.learnable = false;
        self.memory.motion.missed(confused);
        LOST
    }

    /// Renews the usual noise from that of one frame.
    fn judge(&mut self, noise: f64) {
        let Memory { usual_noise: usual, judged_frames: judged, .. } = self.memory;
        if noise < SELF_SHARE * self.given.reference_noise {
            return;
        }
        let share = if noise < ALIKE * usual { QUICK_SHARE } else { SLOW_SHARE };
        let share = share.max(1.0 / (judged as f64 + 1.0));
        self.memory.usual_noise = usual + share * (noise - usual);
        self.memory.judged_frames = judged.saturating_add(1);
    }

    fn is_learnable(&self, fix: &Fix) -> bool {
        let far = self.given.far_px;
        let is_straight = |k: usize| far * fix.value[k].abs() <= LEARN_TURN_PX + 3.0 * far * fix.variance[k].sqrt();
        fix.share >= LEARN_SHARE && is_straight(2) && is_straight(3)
    }

    /// The image less its level with the holes filled, where there are any about a place; None: there are too many.
    fn filled<T: Pixel>(&self, image: &Image<T>, place: [f64; 2]) -> Option<Option<Grid>> {
        if self.registration.all_finite(image, &[place[0], place[1], 0.0, 0.0]) {
            return Some(None);
        }
        values(image, self.given.level).map(Some)
    }

    fn registered<T: Pixel>(&mut self, image: Image<T>, filled: Option<&Grid>, place: [f64; 2]) -> Option<Fix> {
        let (begin, usual) = ([place[0], place[1], self.memory.roll_rad, self.memory.zoom], self.usual());
        let pose = match filled {
            None => self.registration.look(image, self.given.level, &begin, usual),
            Some(filled) => self.registration.look(Image::from(filled), 0.0, &begin, usual),
        };
        pose.map(Fix::from)
    }
}
