//! What a codec did to the frames: how much of each picture is inherited from the one before.
//!
//! Most lossy codecs predict a picture from the one before, moved by quarters of a pixel, and leave out what differs
//! little. So a picture inherits a part of the one before: its noise, which in a raw recording is new in each frame,
//! and the rounding of its motion. The noise of the difference to the frame before, over the noise of the difference to
//! a frame long ago, is 1 in raw frames; what is missing from 1 is the inherited share. Codecs that code each picture
//! separately show steps at the edges of blocks.
//!
//! The constants that turn these into pixels were set on simulated frames through x264 and MJPEG (docs/validation.md).

use super::image::{Image, Pixel, Region};
use super::interpolate::REACH_PX;
use super::picture::{blockiness, share_at_ends, stair_share};
use super::picture_noise::{self, Noise, noise};
use super::running_median::RunningMedian;
use serde::{Deserialize, Serialize};

/// Frames from one comparison with earlier ones to the next.
const CHECK_FRAMES: u64 = 96;
/// The same until the first checks have shown something, and how many those are.
const FIRST_CHECKS: usize = 5;
const FIRST_FRAMES: u64 = 8;
/// Rounding to whole grey levels alone makes so much noise, 1/√12; a difference with less is of one picture with
/// itself.
const ROUNDING_NOISE: f64 = 0.29;
const MIN_CHECKS: usize = 2;
/// Checks that medians are taken over: a median of 64 is known to a sixth of one check's scatter.
const CHECKS_KEPT: usize = 64;
/// Side of the square that is compared, px.
const SAMPLE_PX: usize = 64;
const MIN_SAMPLE_PX: i64 = 16;
/// What chance makes of the inherited share in raw frames: over many checks, and more in a single one of a full square.
const CHANCE_SHARE: f64 = 0.03;
const CHANCE_SHARE_ONCE: f64 = 0.045;
/// Motion rounded to quarters of a pixel errs by 0.072 px where nothing is added to the prediction. Of two predictions
/// averaged, and of blocks predicted each on its own, this much is left for a picture whose noise is all inherited.
const INHERITED_STD_PX: f64 = 0.032;
const MAX_COLOUR: f64 = 3.5;
const CLEAR_SHARE: f64 = 0.25;
const CLEAR_COLOUR: f64 = 1.4;
/// Blockiness from which on pictures may be coded separately.
const CODED_ALONE: f64 = 0.1;
/// Where nothing but flat blocks is left, px, and the blockiness of that.
const STAIR_STD_PX: f64 = 0.4;
const ONLY_STAIRS: f64 = 3.0;
/// Share of the texture that is static, and what the encoder then withholds, px.
const STANDSTILL: f64 = 0.3;
const STANDSTILL_STD_PX: f64 = 0.06;

/// A square of a picture about the target, and where the target lies in it beyond whole pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Square {
    pixels: Vec<f32>,
    shift: [f64; 2],
}

impl Square {
    fn difference(&self, then: &Self, side: usize) -> Option<Noise> {
        let [now, then] = [self, then].map(|square| {
            let pixels = Image::new(&square.pixels, side, side, side);
            pixels.map(|pixels| picture_noise::Square { pixels, shift: square.shift })
        });
        noise(&now?, &then?)
    }
}

/// One frame compared with earlier ones, or the medians of several such comparisons.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Check {
    /// Share inherited from the frame before, 0 to 1, by a frame at least eight frames ago.
    by_earlier: f64,
    /// The same by the reference.
    by_reference: f64,
    /// Noise over all detail over that of the finest: 1 if it is white, more where a codec left the finest out.
    colour: f64,
    /// Of the finest detail, grey levels.
    pub noise: f64,
    /// Steps at the edges of blocks.
    blockiness: f64,
    /// Share of the picture that is flat blocks.
    stairs: f64,
    /// Share at the ends of the scale.
    pub ends: f64,
}

const NO_CHECK: Check =
    Check { by_earlier: 0.0, by_reference: 0.0, colour: 1.0, noise: 0.0, blockiness: 0.0, stairs: 0.0, ends: 0.0 };

impl Check {
    fn numbers(self) -> [f64; 7] {
        [self.by_earlier, self.by_reference, self.colour, self.noise, self.blockiness, self.stairs, self.ends]
    }

    /// The larger of the two shares.
    fn inherited(&self) -> f64 {
        self.by_earlier.max(self.by_reference)
    }
}

/// The medians over the last N checks.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Medians<const N: usize>([RunningMedian<N>; 7]);

impl<const N: usize> Medians<N> {
    fn push(&mut self, check: Check) {
        self.0.iter_mut().zip(check.numbers()).for_each(|(median, value)| median.push(value));
    }

    fn len(&self) -> usize {
        self.0[0].len()
    }

    fn check(&self) -> Check {
        if self.0[0].is_empty() {
            return NO_CHECK;
        }
        let [by_earlier, by_reference, colour, noise, blockiness, stairs, ends] =
            std::array::from_fn(|k| self.0[k].value());
        Check { by_earlier, by_reference, colour, noise, blockiness, stairs, ends }
    }
}

/// A check under way; one difference is taken in each of the next frames, so that none bears the cost of all three.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Comparison {
    sample: Square,
    /// What it is still to be compared with, the last one first: the reference, an earlier one, the frame before.
    partners: Vec<Square>,
    /// The differences so far, fine and broad.
    found: Vec<[f64; 2]>,
    blockiness: f64,
    stairs: f64,
    ends: f64,
}

impl Comparison {
    /// What it shows once all differences are taken; None where the picture is hardly another than it was.
    fn check(&self) -> Option<Check> {
        let &[before, earlier, reference] = self.found.as_slice() else { return None };
        let [fine, broad] = reference;
        if earlier[1].min(broad) < ROUNDING_NOISE {
            return None;
        }
        Some(Check {
            by_earlier: inherited(before, earlier),
            by_reference: inherited(before, reference),
            colour: if fine > 0.0 { broad / fine } else { MAX_COLOUR },
            noise: fine,
            blockiness: self.blockiness,
            stairs: self.stairs,
            ends: self.ends,
        })
    }
}

/// What is missing from 1 in the ratio of the noise, in the finest or in all detail, whichever is less.
fn inherited(before: [f64; 2], then: [f64; 2]) -> f64 {
    let [fine, broad] = [0, 1].map(|k| if then[k] > 0.0 { before[k] / then[k] } else { 1.0 });
    1.0 - fine.max(broad).min(1.0)
}

/// Standard deviation (px) for an inherited share, 0 to 1, of noise of such a colour in such blocks.
fn inherited_std_px(share: f64, usual: &Check) -> f64 {
    // Where little is inherited, the codec left out the finest detail, but not because it predicted.
    let coarse = usual.colour.max(1.0).min(1.0 + 5.0 * share).min(MAX_COLOUR);
    // Steps at the edges of blocks show pictures coded separately: what seems inherited there is only at rest.
    let alone = (2.0 * usual.blockiness / share - 0.5).clamp(0.0, 1.0);
    INHERITED_STD_PX * share * coarse / (1.0 + 3.0 * alone)
}

/// What a codec did to the frames; zeros for raw ones.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Compression {
    /// Share that a picture inherits from the one before.
    pub inherited_share: f64,
    /// Share of the texture that was static.
    pub frozen_share: f64,
    /// Standard deviation of what that does to a translation, px.
    pub std_px: f64,
}

/// What a watch remembers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct CodecMemory {
    frames: u64,
    /// The frame before a check, and the one of the last check.
    last: Option<Square>,
    earlier: Option<Square>,
    under_way: Option<Comparison>,
    checks: Medians<CHECKS_KEPT>,
    first: Medians<FIRST_CHECKS>,
}

/// Compares single frames of a target with earlier ones; medians over the last checks show what a codec does.
pub struct CodecWatch {
    region: Region,
    /// Side of the square that is compared, px.
    size: i64,
    reference: Option<Square>,
    memory: CodecMemory,
    /// What is usual, and whether frames inherit in the first checks as well: light that turns parts only those long
    /// after each other, whatever a codec does. Both only change with a check.
    usual: Check,
    soon_too: bool,
}

impl CodecWatch {
    /// `reference` and `region`: those of the tracker.
    pub fn new<T: Pixel>(reference: &Image<'_, T>, region: Region) -> Self {
        let size = sample_size(reference, region);
        let mut watch =
            Self { region, size, reference: None, memory: CodecMemory::default(), usual: NO_CHECK, soon_too: true };
        watch.reference = watch.sample(reference, [0.0; 2]);
        (watch.memory.last, watch.memory.earlier) = (watch.reference.clone(), watch.reference.clone());
        watch
    }

    /// Looks at a frame with the target at `place`, in the region `seen`.
    pub fn push<T: Pixel>(&mut self, image: &Image<'_, T>, place: [f64; 2], seen: Region) {
        let index = self.memory.frames;
        self.memory.frames += 1;
        if self.is_due(index + 1) {
            self.memory.last = self.sample(image, place);
        } else if self.is_due(index) {
            let sample = self.sample(image, place);
            self.begin(image, sample, seen);
        } else {
            self.go_on();
        }
    }

    /// Takes note of a frame that does not show the target.
    pub fn lost(&mut self) {
        self.memory.frames += 1;
        self.memory.last = None;
    }

    /// What a codec did to the frames so far; `frozen_share`: of the texture that was static, 0 to 1; `refocused`:
    /// whether the usual frame has another sharpness than the reference.
    pub fn compression(&self, frozen_share: f64, refocused: bool) -> Compression {
        let (usual, checks, mut share, mut variance) = (&self.usual, self.memory.checks.len(), 0.0, 0.0);
        if checks >= MIN_CHECKS {
            variance = (STAIR_STD_PX * usual.stairs * (usual.blockiness / ONLY_STAIRS).clamp(0.0, 1.0)).powi(2);
            // Against the reference alone: a change of light parts frames from it too, but leaves their noise white;
            // blur does not.
            let clear = usual.by_reference > CLEAR_SHARE && usual.colour > CLEAR_COLOUR && !refocused;
            if (usual.by_earlier > self.chance(checks) || clear) && self.soon_too {
                share = usual.inherited();
                variance += inherited_std_px(share, usual).powi(2);
            }
        }
        if share == 0.0 && frozen_share > STANDSTILL && usual.blockiness < CODED_ALONE {
            variance += STANDSTILL_STD_PX * STANDSTILL_STD_PX;
        }
        Compression { inherited_share: share, frozen_share, std_px: variance.sqrt() }
    }

    /// What the usual check shows.
    pub fn usual(&self) -> &Check {
        &self.usual
    }

    /// How many frames it has taken note of.
    pub fn frames(&self) -> u64 {
        self.memory.frames
    }

    /// The next frame does not follow on the last one.
    pub fn interrupt(&mut self) {
        self.memory.last = None;
    }

    /// What it remembers.
    pub fn memory(&self) -> &CodecMemory {
        &self.memory
    }

    /// Continues from what another one remembered.
    pub fn restore(&mut self, memory: CodecMemory) {
        self.memory = memory;
        self.take_medians();
    }

    fn is_due(&self, index: u64) -> bool {
        let every = if self.memory.first.len() < FIRST_CHECKS { FIRST_FRAMES } else { CHECK_FRAMES };
        index > 0 && index % every == 0
    }

    /// The share that chance makes of raw frames in as many checks.
    fn chance(&self, checks: usize) -> f64 {
        CHANCE_SHARE + CHANCE_SHARE_ONCE * SAMPLE_PX as f64 / self.size as f64 / (checks as f64).sqrt()
    }

    fn side(&self) -> usize {
        usize::try_from(self.size).unwrap_or(0) + 2 * REACH_PX
    }

    /// Begins to compare the square of a frame with those of the frame before, the last check and the reference.
    fn begin<T: Pixel>(&mut self, image: &Image<'_, T>, sample: Option<Square>, seen: Region) {
        let Some(sample) = sample else { return };
        if let (Some(last), Some(earlier), Some(reference)) = (&self.memory.last, &self.memory.earlier, &self.reference)
        {
            // A frozen picture shows nothing of the codec; it is reported as such.
            if sample.pixels == last.pixels {
                return;
            }
            if let Some(part) = image.cut(seen) {
                let (left, top) = (seen.x as usize, seen.y as usize);
                self.memory.under_way = Some(Comparison {
                    partners: vec![reference.clone(), earlier.clone(), last.clone()],
                    sample: sample.clone(),
                    found: Vec::with_capacity(3),
                    blockiness: blockiness(&part, left, top),
                    stairs: stair_share(&part, left, top),
                    ends: share_at_ends(&part),
                });
            }
        }
        self.memory.earlier = Some(sample);
    }

    /// Takes the next difference of a check, and counts it where it is the last one.
    fn go_on(&mut self) {
        let side = self.side();
        let Some(mut comparison) = self.memory.under_way.take() else { return };
        let noise = comparison.partners.pop().and_then(|then| comparison.sample.difference(&then, side));
        let Some(Noise { fine, broad }) = noise else { return };
        comparison.found.push([fine, broad]);
        if !comparison.partners.is_empty() {
            self.memory.under_way = Some(comparison);
            return;
        }
        let Some(check) = comparison.check() else { return };
        if self.memory.first.len() < FIRST_CHECKS {
            self.memory.first.push(check);
        }
        self.memory.checks.push(check);
        self.take_medians();
    }

    fn take_medians(&mut self) {
        let soon = self.memory.first.len();
        self.usual = self.memory.checks.check();
        self.soon_too = soon < MIN_CHECKS || self.memory.first.check().inherited() > self.chance(soon);
    }

    /// The square about the target's middle; None where it leaves the image or a pixel has no value.
    fn sample<T: Pixel>(&self, image: &Image<'_, T>, place: [f64; 2]) -> Option<Square> {
        if self.size < MIN_SAMPLE_PX {
            return None;
        }
        let (region, side) = (self.region, self.side());
        let whole = place.map(f64::round_ties_even);
        let about = |first: i64, length: usize, moved: f64| {
            first.saturating_add(moved as i64).saturating_add((length as i64 - side as i64).div_euclid(2))
        };
        let (x, y) = (about(region.x, region.width, whole[0]), about(region.y, region.height, whole[1]));
        let part = image.cut(Region { x, y, width: side, height: side })?;
        let mut pixels = Vec::with_capacity(side * side);
        for r in 0..side {
            pixels.extend(part.row(r).iter().map(|pixel| pixel.less(0.0)));
        }
        let finite = pixels.iter().all(|value| value.is_finite());
        finite.then_some(Square { pixels, shift: [place[0] - whole[0], place[1] - whole[1]] })
    }
}

/// Side (px) of the square that is compared: with what the spline reaches for it lies inside the image.
fn sample_size<T: Pixel>(image: &Image<'_, T>, region: Region) -> i64 {
    let (width, height) = (region.width as i64, region.height as i64);
    let (x, y) = (region.x + width / 2, region.y + height / 2);
    let room = x.min(y).min(image.columns as i64 - x).min(image.rows as i64 - y);
    (SAMPLE_PX as i64).min(width).min(height).min(2 * (room - REACH_PX as i64 - 2))
}
