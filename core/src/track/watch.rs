//! What a frame's translation becomes besides its tracker: fair variances, frozen and dark frames, light, codec, blur
//! and saturation. Everything rests on the frames up to it.

use super::codec::CodecMemory;
use super::fair_variance::FairVariance;
use super::image::{Image, Pixel, Region};
use super::kept::{Kept, Storable};
use super::light::is_dark;
use super::light_watch::{LightMemory, LightWatch};
use super::picture::{part_still, same};
use super::picture_watch::{PictureMemory, PictureWatch};
use super::running_median::RunningMedian;
use crate::Status;
use serde::{Deserialize, Serialize};

/// Share of the texture that is still from which on a frame is torn, and the most that usually is, over this many frames:
/// a camera's noise lets none be.
const TORN_SHARE: f64 = 0.05;
const MAX_USUAL_SHARE: f64 = 0.01;
const USUAL_FRAMES: usize = 9;
/// Step of the rows and columns that tell a black frame from a lit one, and the rows looked at where a frame has more.
const THINNED: usize = 4;
const DARK_ROWS: usize = 60;

/// The translation of a target since its reference frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Translation {
    /// What it rests on; where that is nothing the numbers are NaN.
    pub status: Status,
    /// x to the right, y down, px.
    pub place: [f64; 2],
    /// Of this frame alone, px².
    pub variance: [f64; 2],
    /// Of the reference's own place, px².
    pub reference_variance: [f64; 2],
    /// 0 to 1.
    pub quality: f64,
    /// Good matches, or the quality in percent.
    pub strength: f64,
    /// By how much the picture has grown about the target's middle, and the variance of that; NaN: not measured.
    pub zoom: [f64; 2],
}

/// Of a frame that does not show the target.
pub const LOST: Translation = Translation {
    status: Status::Lost,
    place: [f64::NAN; 2],
    variance: [f64::NAN; 2],
    reference_variance: [0.0; 2],
    quality: 0.0,
    strength: 0.0,
    zoom: [f64::NAN; 2],
};

/// Why a target is not looked for in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unseen {
    /// The frame is black, which the reference is not: what a tracker found in its noise would be wrong.
    Dark,
    /// The region's picture is bit for bit the one before: a frozen camera, or a codec that skipped it. Even the second
    /// equal picture says nothing of its own time, by which the target has moved on. Or a part of it is that of the
    /// last frame that was whole, while the rest has moved: a torn frame shows the target at two places.
    Frozen,
}

/// What a [`Watch`] is to look at.
#[derive(Clone, Copy, Debug)]
pub struct Watched {
    /// Whether compression, blur and saturation are; temperatures have no codec and no full scale.
    pub picture: bool,
    /// Whether changed light is; trackers whose reference changes know themselves what it makes.
    pub light: bool,
    /// Whether the frames come from a file which leaves nothing out.
    pub lossless: bool,
}

/// Everything that changes from frame to frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct WatchMemory {
    fair: FairVariance,
    before: Option<Kept>,
    still: Option<Still>,
    frozen_frames: u64,
    light: Option<LightMemory>,
    picture: Option<(CodecMemory, PictureMemory)>,
}

/// Share of the texture that is that of the frame before.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Still {
    /// In the newest frame.
    now: f64,
    /// In the last ones that were whole.
    usual: RunningMedian<USUAL_FRAMES>,
}

/// Takes a target's frames with what a tracker found in them.
pub struct Watch {
    /// Of the target in the reference frame.
    pub region: Region,
    /// Whether the reference is no dark frame.
    lit: bool,
    fair: FairVariance,
    /// The region's pixels in the last frame that was whole.
    before: Option<Kept>,
    /// Of frames that leave nothing out; a codec leaves out what hardly changes.
    still: Option<Still>,
    /// How many frames only repeated them.
    pub frozen_frames: u64,
    /// Where light is watched.
    pub light: Option<LightWatch>,
    /// Where the picture is watched.
    pub picture: Option<PictureWatch>,
}

impl Watch {
    /// `reference` and `region`: those of the tracker; None where the region leaves the image.
    pub fn new<T: Pixel>(reference: &Image<'_, T>, region: Region, watched: Watched) -> Option<Self> {
        reference.cut(region)?;
        Some(Self {
            region,
            lit: !is_dark(reference, 1),
            fair: FairVariance::default(),
            before: None,
            still: watched.lossless.then(Still::default),
            frozen_frames: 0,
            light: watched.light.then(|| LightWatch::new(reference, region)),
            picture: if watched.picture { PictureWatch::new(reference, region, watched.lossless) } else { None },
        })
    }

    /// Why nothing is to be looked for in a frame, if so; such a frame is not pushed.
    pub fn unseen<T: Storable>(&mut self, image: &Image<'_, T>) -> Option<Unseen> {
        let why = if self.lit && is_dark(image, THINNED.max(image.rows / DARK_ROWS)) {
            Unseen::Dark
        } else if self.is_torn(image) {
            self.frozen_frames += 1;
            Unseen::Frozen
        } else {
            return None;
        };
        self.picture.iter_mut().for_each(PictureWatch::lost);
        Some(why)
    }

    /// Whether a part of a frame is still since the last one that was whole, and the rest is not, which noise would
    /// have changed alike.
    fn is_torn<T: Storable>(&mut self, image: &Image<'_, T>) -> bool {
        let Some(still) = &mut self.still else { return false };
        let before = self.before.as_ref().and_then(Kept::image);
        let Some((now, before)) = image.cut(self.region).zip(before) else { return false };
        let part = part_still(&now, &before, self.region.x as usize, self.region.y as usize);
        still.now = part.share;
        still.usual.value() < MAX_USUAL_SHARE && part.share > TORN_SHARE && part.rest_differs
    }

    /// What was found in a frame, with the variances that its picture allows, and why nothing is if so; None where the
    /// region leaves the image.
    pub fn push<T: Storable>(
        &mut self,
        image: &Image<'_, T>,
        time_ns: i64,
        found: Translation,
    ) -> Option<(Translation, Option<Unseen>)> {
        let mut found = Translation { variance: self.fair.push(found.variance), ..found };
        let frozen = self.is_frozen(image)?;
        if frozen {
            found = LOST;
        }
        if let Some(light) = &mut self.light {
            let tracked = found.status == Status::Tracking;
            let more = light.push(image, time_ns, tracked.then_some(found.place));
            if tracked {
                found.reference_variance = found.reference_variance.map(|variance| variance + more);
            }
        }
        if let Some(picture) = &mut self.picture {
            if found.status == Status::Lost {
                picture.lost();
            } else {
                found.variance = picture.push(image, found.place, found.variance)?;
            }
        }
        Some((found, frozen.then_some(Unseen::Frozen)))
    }

    /// See [`Unseen::Frozen`].
    fn is_frozen<T: Storable>(&mut self, image: &Image<'_, T>) -> Option<bool> {
        let now = image.cut(self.region)?;
        if self.before.as_ref().and_then(Kept::image).is_some_and(|before| same(&now, &before)) {
            self.frozen_frames += 1;
            return Some(true);
        }
        if let Some(still) = self.still.as_mut().filter(|_| self.before.is_some()) {
            still.usual.push(still.now);
        }
        Kept::replace(&mut self.before, &now, self.region);
        Some(false)
    }

    /// Everything that changes from frame to frame.
    pub fn memory(&self) -> WatchMemory {
        WatchMemory {
            fair: self.fair.clone(),
            before: self.before.clone(),
            still: self.still.clone(),
            frozen_frames: self.frozen_frames,
            light: self.light.as_ref().map(|light| light.memory.clone()),
            picture: self.picture.as_ref().map(|one| (one.codec.memory().clone(), one.memory.clone())),
        }
    }

    /// Continues from what another one of the same kind remembered; false where it was of another kind.
    #[must_use]
    pub fn restore(&mut self, memory: WatchMemory) -> bool {
        let same_kind =
            memory.light.is_some() == self.light.is_some() && memory.picture.is_some() == self.picture.is_some();
        let same_kind = same_kind && memory.still.is_some() == self.still.is_some();
        if !same_kind {
            return false;
        }
        (self.fair, self.before, self.frozen_frames) = (memory.fair, memory.before, memory.frozen_frames);
        self.still = memory.still;
        if let (Some(light), Some(memory)) = (&mut self.light, memory.light) {
            light.memory = memory;
        }
        if let (Some(picture), Some((codec, memory))) = (&mut self.picture, memory.picture) {
            picture.restore(codec, memory);
        }
        true
    }

    /// Keeps what is usual of the first frames, before these are taken once more.
    pub fn keep_usual(&mut self) {
        (self.before, self.frozen_frames) = (None, 0);
        self.still = self.still.as_ref().map(|_| Still::default());
        if let Some(light) = &mut self.light {
            light.memory = LightMemory::default();
        }
        if let Some(picture) = &mut self.picture {
            picture.codec.interrupt();
            picture.memory.at_the_start();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;
    use crate::estimator::state::{from_bytes, to_bytes};

    const SIDE: usize = 96;
    const REGION: Region = Region { x: 12, y: 14, width: 70, height: 68 };
    const ALL: Watched = Watched { picture: true, light: true, lossless: false };

    /// Waves with noise of two grey levels, of which a part is static from frame to frame.
    fn film(frames: usize) -> Vec<Vec<u8>> {
        let mut seed = 9u64;
        let mut noise = move || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64 / f64::from(1 << 22) - 2.0
        };
        (0..frames)
            .map(|k| {
                let turned = k as f64 / frames as f64;
                let value = |(r, c): (f64, f64)| {
                    let [one, other] = [(0.35 * c).sin() * (0.4 * r).cos(), (0.3 * c + 0.5 * r).sin()];
                    120.0 + 60.0 * (turned.cos() * one + turned.sin() * other)
                };
                (0..SIDE * SIDE)
                    .map(|j| (value(((j / SIDE) as f64, (j % SIDE) as f64)) + noise()).round() as u8)
                    .collect()
            })
            .collect()
    }

    fn found(k: usize) -> Translation {
        let variance = if k == 0 { 1e-9 } else { 2e-5 };
        Translation {
            status: Status::Tracking,
            place: [0.3 * (k as f64).sin(), 0.0],
            variance: [variance; 2],
            quality: 0.9,
            strength: 90.0,
            ..LOST
        }
    }

    fn image(pixels: &[u8]) -> Image<'_, u8> {
        Image::new(pixels, SIDE, SIDE, SIDE).unwrap()
    }

    #[test]
    fn it_goes_on_from_bytes_to_the_last_bit_and_gives_the_same_bits_on_every_processor() {
        let pictures = film(70);
        let row = |watch: &mut Watch, k: usize| {
            let picture = &pictures[if k == 40 { 39 } else { k }];
            let (row, unseen) = watch.push(&image(picture), 500_000_000 * k as i64, found(k)).unwrap();
            (row.variance.map(f64::to_bits), row.reference_variance, unseen)
        };
        let opened = || Watch::new(&image(&pictures[0]), REGION, ALL).unwrap();
        let whole = on_both(|| {
            let mut watch = opened();
            (0..70).map(|k| row(&mut watch, k)).collect::<Vec<_>>()
        });
        assert!(whole[69].1[0] > 0.0 && whole[40].2 == Some(Unseen::Frozen) && whole[41].2.is_none());
        for cut in [1, 9, 18, 40, 41, 60] {
            let (mut first, mut second) = (opened(), opened());
            for k in 0..cut {
                row(&mut first, k);
            }
            let bytes = to_bytes(&first.memory()).unwrap();
            assert!(second.restore(from_bytes(&bytes).unwrap()));
            assert_eq!((cut..70).map(|k| row(&mut second, k)).collect::<Vec<_>>(), whole[cut..]);
        }
        let plain = Watched { picture: false, light: false, lossless: false };
        assert!(!opened().restore(Watch::new(&image(&pictures[0]), REGION, plain).unwrap().memory()));
    }

    #[test]
    fn a_torn_frame_is_not_taken_until_it_is_whole_again() {
        let whole = film(12);
        let torn = |k: usize, before: usize| {
            let cut = SIDE * SIDE / 2;
            [&whole[k][..cut], &whole[before][cut..]].concat()
        };
        let mut watch = Watch::new(&image(&whole[0]), REGION, Watched { lossless: true, ..ALL }).unwrap();
        let unseen = |watch: &mut Watch, k: usize, picture: &[u8]| {
            let why = watch.unseen(&image(picture));
            why.or_else(|| watch.push(&image(picture), k as i64, found(k)).unwrap().1)
        };
        for (k, picture) in whole.iter().enumerate() {
            let is_torn = (4..9).contains(&k);
            let why = if is_torn { unseen(&mut watch, k, &torn(k, 3)) } else { unseen(&mut watch, k, picture) };
            assert_eq!(why, is_torn.then_some(Unseen::Frozen), "{k}");
        }
        // A part that is always still is the scene's.
        let mut watch = Watch::new(&image(&whole[0]), REGION, Watched { lossless: true, ..ALL }).unwrap();
        assert!((0..12).all(|k| unseen(&mut watch, k, &torn(k, 0)).is_none()));
    }

    #[test]
    fn dark_frames_are_seen_by_a_lit_reference_only_and_smaller_ones_are_refused() {
        let [picture, black] = [film(1).remove(0), vec![2u8; SIDE * SIDE]];
        let mut lit = Watch::new(&image(&picture), REGION, ALL).unwrap();
        assert_eq!([&black, &picture].map(|one| lit.unseen(&image(one))), [Some(Unseen::Dark), None]);
        let mut night = Watch::new(&image(&black), REGION, ALL).unwrap();
        assert!(night.unseen(&image(&black)).is_none());
        let small = Image::new(&picture, 60, 60, SIDE).unwrap();
        assert!(lit.push(&small, 0, found(1)).is_none());
        assert!(Watch::new(&small, REGION, ALL).is_none());
    }
}
