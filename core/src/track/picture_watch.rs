//! Knowing when not to trust the picture: compression, blur and saturation, from the frames alone.
//!
//! What a frame's variance becomes rests on the frames up to it: on medians over the last checks (see [`super::codec`])
//! and frames, and on the frame itself.

use super::codec::{CodecMemory, CodecWatch, Compression};
use super::counts::Counts;
use super::fair_variance::USUAL_FRAMES;
use super::image::{Image, Pixel, Region};
use super::kept::{Kept, Storable};
use super::picture::{Detail, detail, frozen_texture, share_at_ends, sharpness};
use super::running_median::RunningMedian;
use serde::{Deserialize, Serialize};

/// Rows that the detail of a frame is taken from, and its share at the ends of the scale: light that drives pixels
/// there covers more than one row.
const DETAIL_ROWS: usize = 32;
const ENDS_ROWS: usize = 64;
/// Frames that the usual share of static texture is a mean of, about.
const FROZEN_MEAN_FRAMES: u64 = 96;
/// Frames whose steps are taken for the target's speed.
const FROZEN_FRAMES: usize = 9;
const MAX_FROZEN: f64 = 0.9;
/// Of the reference's detail (square): below it a variance is widened.
const BLURRED: f64 = 0.6;
/// A smaller ratio of details says no more.
const MIN_SHARP: f64 = 1e-3;
/// Share of the pixels at the ends of the scale from which on they count.
pub const SATURATED_SHARE: f64 = 0.015;
/// Standard deviation (px) times the square root of the saturated over the other pixels.
const SATURATED_STD_PX: f64 = 0.025;
const MIN_UNSATURATED: f64 = 0.02;

/// By how much a picture of which a part is static lags along one axis.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Lag {
    /// The last translation, px.
    value_px: Option<f64>,
    /// The squares of the last steps, px².
    squares_px2: Vec<f64>,
    lag_px: f64,
}

impl Lag {
    /// The next frame, in which a share (0 to 1) of the texture is static.
    ///
    /// Static texture lags by its share of the step, and of the lag that it had: e = share · (e + step), with the rms
    /// of the last steps.
    fn push(&mut self, value_px: f64, share: f64) {
        let step = self.value_px.map_or(0.0, |last| value_px - last);
        if self.squares_px2.len() == FROZEN_FRAMES {
            self.squares_px2.remove(0);
        }
        self.squares_px2.push(step * step);
        let usual = (self.squares_px2.iter().sum::<f64>() / self.squares_px2.len() as f64).sqrt();
        self.value_px = Some(value_px);
        self.lag_px = share.min(MAX_FROZEN) * (self.lag_px + usual);
    }
}

/// What a watch remembers besides its codec's.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct PictureMemory {
    /// The target in the frame before.
    before: Option<Kept>,
    /// The last frames' sharpness along x and y.
    sharp: [RunningMedian<USUAL_FRAMES>; 2],
    lags: [Lag; 2],
    /// The usual share of the texture that was static.
    frozen_share: f64,
    counts: Counts,
}

impl PictureMemory {
    /// With what is known of the usual frame, before the frames that it was made from are taken again.
    pub fn at_the_start(&mut self) {
        let (sharp, frozen_share) = (std::mem::take(&mut self.sharp), self.frozen_share);
        *self = Self { sharp, frozen_share, ..Self::default() };
    }
}

/// Looks at every frame that a tracker has measured, and says how far to widen its variances.
pub struct PictureWatch {
    region: Region,
    /// Whether the frames come from a file which leaves nothing out; what they share with each other is then the
    /// scene's, not a codec's.
    lossless: bool,
    detail: Detail,
    ends: f64,
    /// What a codec did.
    pub codec: CodecWatch,
    /// All else that changes from frame to frame.
    pub memory: PictureMemory,
}

/// Detail, and the share at the ends of the scale.
fn numbers<T: Pixel>(target: &Image<'_, T>) -> (Detail, f64) {
    let found = detail(target, (target.rows / DETAIL_ROWS).max(1));
    (found, share_at_ends(&target.thinned((target.rows / ENDS_ROWS).max(1))))
}

/// A ratio of sharpness as a number up to 1, whichever of the two is the sharper; NaN where it is not known.
fn change(sharp: f64) -> f64 {
    if sharp.is_nan() { sharp } else { sharp.min(1.0 / sharp.max(MIN_SHARP)) }
}

/// Factor of the variance for detail of `sharp` times the reference's; 1 where that is not known.
fn blur_factor(sharp: f64) -> f64 {
    let change = change(sharp);
    if change < BLURRED { BLURRED / change.max(MIN_SHARP) } else { 1.0 }
}

impl PictureWatch {
    /// `reference` and `region`: those of the tracker; None where the region leaves the image.
    pub fn new<T: Pixel>(reference: &Image<'_, T>, region: Region, lossless: bool) -> Option<Self> {
        let (detail, ends) = numbers(&reference.cut(region)?);
        let codec = CodecWatch::new(reference, region);
        Some(Self { region, lossless, detail, ends, codec, memory: PictureMemory::default() })
    }

    /// Takes note of a frame that does not show the target.
    pub fn lost(&mut self) {
        self.codec.lost();
        self.memory.counts.frames += 1;
        self.memory.before = None;
        self.memory.lags = [Lag::default(), Lag::default()];
    }

    /// Looks at a frame with the target at `place`, known to `variance`, and returns that as wide as the picture asks
    /// for; the first frame pushed is the reference. None where the region is larger than the image.
    pub fn push<T: Storable>(&mut self, image: &Image<'_, T>, place: [f64; 2], variance: [f64; 2]) -> Option<[f64; 2]> {
        let region = self.region.followed(place, image.rows, image.columns);
        let target = image.cut(region)?;
        self.codec.push(image, place, region);
        let (now, ends) = numbers(&target);
        let sharp = sharpness(now, self.detail, self.codec.usual().noise.powi(2));
        if !self.lossless {
            let frozen = self.frozen_share(image);
            Kept::replace(&mut self.memory.before, &target, region);
            self.follow(frozen, place, sharp);
        }
        let share = ends.max(self.ends);
        let saturated = if share > SATURATED_SHARE { share / (1.0 - share).max(MIN_UNSATURATED) } else { 0.0 };
        self.memory.counts.add(place, variance, sharp, saturated);
        let added = self.compression().std_px.powi(2) + SATURATED_STD_PX * SATURATED_STD_PX * saturated;
        Some(std::array::from_fn(|k| {
            let (factor, lag) = (blur_factor(sharp[k]), self.memory.lags[k].lag_px);
            factor * variance[k] + (factor * (lag * lag) + added)
        }))
    }

    /// What a codec did to the frames so far.
    pub fn compression(&self) -> Compression {
        if self.lossless {
            return Compression::default();
        }
        // Whether the usual frame has another sharpness than the reference.
        let refocused = self.memory.sharp.iter().any(|median| change(median.value()) <= BLURRED);
        self.codec.compression(self.memory.frozen_share, refocused)
    }

    /// Share of the region's pixels at the end of the scale, 0 to 1: the usual frame's or the reference's.
    pub fn saturated_share(&self) -> f64 {
        self.codec.usual().ends.max(self.ends)
    }

    /// What is worth reporting, counted.
    pub fn counts(&self) -> &Counts {
        &self.memory.counts
    }

    /// Continues from what another one remembered.
    pub fn restore(&mut self, codec: CodecMemory, memory: PictureMemory) {
        self.codec.restore(codec);
        self.memory = memory;
    }

    /// Share of the texture that was static since the frame before.
    fn frozen_share<T: Storable>(&self, image: &Image<'_, T>) -> f64 {
        let Some(before) = &self.memory.before else { return 0.0 };
        let [x, y] = before.corner;
        let Some((then, before)) = image.cut(Region { x, y, ..self.region }).zip(before.image::<T>()) else {
            return 0.0;
        };
        let texture = frozen_texture(&then, &before, x as usize, y as usize);
        if texture.whole > 0.0 { texture.frozen / texture.whole } else { 0.0 }
    }

    /// Follows what a codec left static, and the detail over the reference's, square and without noise, for the
    /// usual frame: they show what a codec did.
    fn follow(&mut self, frozen: f64, place: [f64; 2], sharp: [f64; 2]) {
        let memory = &mut self.memory;
        memory.frozen_share += (frozen - memory.frozen_share) / self.codec.frames().clamp(1, FROZEN_MEAN_FRAMES) as f64;
        for (k, lag) in memory.lags.iter_mut().enumerate() {
            lag.push(place[k], frozen);
        }
        if (sharp[0] + sharp[1]).is_finite() {
            memory.sharp.iter_mut().zip(sharp).for_each(|(median, value)| median.push(value));
        }
    }
}
