//! Registration of a frame with a template: maximum-likelihood kernels, fused into translation, roll and zoom.
//!
//! The window is multiplied by kernels made for the template at the nearest eighth of a pixel. Where nothing disturbs
//! it that gives one pose of all (see [`super::undisturbed`]); else each block has kernels of its own, which give its
//! translation in one step (see [`super::kernels`]), and the blocks are fused so that what covers, shades, turns or
//! enlarges a part of the target does not move the result (see [`super::blocks`]). Nothing of the frame is
//! interpolated.

use super::bank::{Bank, Plane};
use super::blocks::PoseValue;
use super::climb::{ALIKE, Pose, UNDISTURBED_SHARE, View, climb};
use super::grid::{Grid, Part};
use super::image::{Image, Pixel};
use super::kernels::{MAX_PX, held_phases};
use super::matrix::Matrix;
use super::template::{Fix, Template};
use super::undisturbed::{Known, Undisturbed};
use std::sync::Arc;

/// Blocks along each axis, and the least size in px for which there are fewer of them: few large ones, the most exact,
/// and many small ones, the most robust.
const COARSE: (usize, usize) = (5, 20);
const FINE: (usize, usize) = (8, 10);
/// Times the usual noise: 30 degrees of freedom exceed it about once in 500 frames.
const DISTURBED: f64 = 1.35;
const SHARE_PLAY: f64 = 0.1;
/// 5 × 5 blocks of 20 px: in smaller windows the levels of the blocks hold more of what they tell.
const WHOLE_SIDE_PX: usize = 100;
/// Of the target's information: no block is left out.
const ALL_SHARE: f64 = 0.95;
/// Farther than this from where the template was found, blocks have locked on something else.
const SEED_PX: f64 = 1.5;
/// Around the window where a frame's pixels must have values.
const AROUND_PX: i64 = 4;

/// What does not change while a template is used.
#[derive(Clone, Copy)]
pub struct Settings {
    /// Share of the target's information below which it counts as lost.
    pub min_share: f64,
    /// Noise of a pixel of the reference frame.
    pub reference_noise: f64,
    /// Of kernels in one bank.
    pub kernel_bytes: usize,
}

/// A template that frames are registered with.
pub struct Registration {
    plane: Plane,
    whole: Arc<Template>,
    settings: Settings,
    undisturbed: Undisturbed,
    banks: Option<[Bank; 2]>,
    zero: PoseValue,
    zero_covariance: Matrix<4>,
}

impl Registration {
    /// `whole`: the same target as a template for ZNCC.
    pub fn new(plane: Plane, whole: Arc<Template>, settings: Settings) -> Self {
        let held = held_phases(settings.kernel_bytes, plane.window.width * plane.window.height);
        Self {
            undisturbed: Undisturbed::new(&plane, held),
            plane,
            whole,
            settings,
            banks: None,
            zero: [0.0; 4],
            zero_covariance: Matrix::default(),
        }
    }

    /// Count poses from this one of the template, which is uncertain by this covariance.
    pub fn count_from(&mut self, zero: PoseValue, covariance: Matrix<4>) {
        (self.zero, self.zero_covariance, self.undisturbed.zero) = (zero, covariance, zero);
        self.banks.iter_mut().flatten().for_each(|bank| bank.zero = zero);
    }

    /// Both banks and what they are made from.
    fn banks(&mut self) -> (&mut [Bank; 2], &Plane) {
        let Self { plane, settings, banks, zero, .. } = self;
        let held = held_phases(settings.kernel_bytes, plane.window.width * plane.window.height);
        let banks = banks.get_or_insert_with(|| {
            [COARSE, FINE].map(|division| Bank { zero: *zero, ..Bank::new(plane, division, held) })
        });
        (banks, plane)
    }

    /// Covariance of x and y for noise of variance 1, px², of the whole window or of its large blocks.
    pub fn covariance(&mut self, of_window: bool) -> [[f64; 2]; 2] {
        if of_window {
            self.undisturbed.covariance(&self.plane)
        } else {
            super::matrix::inverse(&self.banks().0[0].information())
        }
    }

    /// Most bytes of kernels in both banks.
    pub fn most_kernel_bytes(&self) -> usize {
        let pixels = self.plane.window.width * self.plane.window.height;
        2 * 6 * pixels * held_phases(self.settings.kernel_bytes, pixels)
    }

    /// Whether all pixels about where a pose puts the window have values.
    pub fn all_finite<T: Pixel>(&self, image: &Image<T>, begin: &PoseValue) -> bool {
        let window = &self.whole.window;
        let along = |first: i64, size: usize, moved: f64, pixels: usize| {
            let start = first + moved.clamp(-MAX_PX, MAX_PX).round() as i64;
            [start - AROUND_PX, start + size as i64 + AROUND_PX].map(|k| k.clamp(0, pixels as i64) as usize)
        };
        let [left, right] = along(window.x, window.width, begin[0], image.columns);
        let [top, bottom] = along(window.y, window.height, begin[1], image.rows);
        image.part(Part { top, bottom, left, right }).all_finite()
    }

    fn view<'a, T: Pixel>(&self, image: Image<'a, T>, level: f64) -> View<'a, T> {
        View { image, level, origin: [self.whole.window.x, self.whole.window.y] }
    }

    /// The pose in a frame less a level since the reference frame, around `begin`: of the whole window where nothing
    /// disturbs it, else from blocks or, where these disagree, from the window's correlation if that is the better
    /// known.
    ///
    /// Motion blur moves the two sides of a thing in opposite directions: single blocks contradict each other then, and
    /// the most consistent of them err, but the window as a whole does not.
    pub fn look<T: Pixel>(
        &mut self,
        image: Image<T>,
        level: f64,
        begin: &PoseValue,
        usual: Option<f64>,
    ) -> Option<Pose> {
        let at_first = std::f64::consts::SQRT_2 * self.settings.reference_noise;
        let view = self.view(image, level);
        if self.plane.window.width.min(self.plane.window.height) >= WHOLE_SIDE_PX {
            let known = Known { usual, at_first, zero: self.zero_covariance };
            if let Some(pose) = self.undisturbed.fit(&view, &self.plane, begin, &known) {
                return Some(pose);
            }
        }
        let pose = self.of_blocks(&view, begin, usual)?;
        // Blocks may also disagree in all frames, so that this is their usual noise.
        let usual = usual.unwrap_or(f64::INFINITY).min(at_first);
        if pose.share > ALL_SHARE && pose.noise < DISTURBED * usual {
            return Some(pose);
        }
        let Some(fix) = self.whole_at(&view, &pose) else { return Some(pose) };
        if fix.variance[0] + fix.variance[1] >= pose.spread() {
            return Some(pose);
        }
        let mut covariance = pose.covariance;
        (covariance[0][0], covariance[1][1]) = (fix.variance[0], fix.variance[1]);
        Some(Pose { value: [fix.x, fix.y, pose.value[2], pose.value[3]], covariance, ..pose })
    }

    /// The peak of the template as a whole next to a pose of the blocks.
    fn whole_at<T: Pixel>(&self, view: &View<T>, pose: &Pose) -> Option<Fix> {
        let place = [0, 1].map(|k| view.origin[k] + pose.value[k].clamp(-MAX_PX, MAX_PX).round_ties_even() as i64);
        let fix = self.whole.peak_at(&view.image, view.level, place)?;
        ((fix.x - pose.value[0]).hypot(fix.y - pose.value[1]) <= SEED_PX).then_some(fix)
    }

    /// The pose since the reference frame, from large blocks or, where they disagree, from small ones.
    fn of_blocks<T: Pixel>(&mut self, view: &View<T>, begin: &PoseValue, usual: Option<f64>) -> Option<Pose> {
        let (zero, min_share) = (self.zero_covariance, self.settings.min_share);
        let (banks, plane) = self.banks();
        let mut climbed =
            |which: usize| climb(view, plane, &mut banks[which], begin, usual).filter(|pose| pose.share >= min_share);
        let few = climbed(0);
        let agrees = |pose: &Pose, times: f64| usual.is_some_and(|usual| pose.noise < times * usual);
        if let Some(few) = few.as_ref().filter(|few| few.share > UNDISTURBED_SHARE && agrees(few, DISTURBED)) {
            return Some(few.clone().wider(few.averaged(usual), &zero));
        }
        let widened = |pose: Pose| {
            let factor = pose.disturbed(usual);
            pose.wider(factor, &zero)
        };
        let (few, many) = match (few.map(widened), climbed(1).map(widened)) {
            (Some(few), Some(many)) => (few, many),
            (few, many) => return few.or(many),
        };
        if usual.is_some() && agrees(&few, ALIKE) != agrees(&many, ALIKE) {
            return Some(if few.noise < many.noise { few } else { many });
        }
        // A part that covers the target's edge spoils all large blocks alike, and few of the small ones.
        if few.share > UNDISTURBED_SHARE.max(many.share) && few.spread() < many.spread() {
            return Some(few);
        }
        Some(if many.share > few.share - SHARE_PLAY { many } else { few })
    }

    /// The pose of the whole window, or of its large blocks, in a picture of no level whose window begins at the pixel
    /// `origin` (x, y), around `begin`.
    pub fn pose_in(&mut self, picture: &Grid, origin: [i64; 2], begin: &PoseValue, of_window: bool) -> Option<Pose> {
        let view = View { image: Image::from(picture), level: 0.0, origin };
        if of_window {
            let known = Known { usual: None, at_first: f64::INFINITY, zero: Matrix::default() };
            return self.undisturbed.fit(&view, &self.plane, begin, &known);
        }
        let (banks, plane) = self.banks();
        climb(&view, plane, &mut banks[0], begin, None)
    }
}

#[cfg(test)]
mod tests {
    use super::super::correlation::smooth;
    use super::super::fine_spline::refined;
    use super::super::peak::Precision;
    use super::super::spline::{coefficients, combine, weights};
    use super::super::template::Window;
    use super::super::vector::on_both;
    use super::*;

    const SIDE: usize = 180;
    const WINDOW: Window = Window { x: 32, y: 30, width: 116, height: 108 };

    /// Waves of many directions, none of which repeats within the picture.
    fn scene(x: f64, y: f64) -> f64 {
        (1..12).fold(120.0, |sum, k| {
            let (k, angle) = (f64::from(k), 2.4 * f64::from(k));
            sum + 9.0 * ((0.15 + 0.06 * k) * (x * angle.cos() + y * angle.sin()) + k * k).sin()
        })
    }

    fn seen(moved: [f64; 2], change: impl Fn(usize, usize, f64) -> f64) -> Grid {
        let at = |k: usize| (k / SIDE, k % SIDE);
        let value = |(r, c): (usize, usize)| change(r, c, scene(c as f64 - moved[0], r as f64 - moved[1]));
        Grid { values: (0..SIDE * SIDE).map(|k| value(at(k)) as f32).collect(), rows: SIDE, columns: SIDE }
    }

    fn opened() -> Registration {
        let level = 120.0;
        let image = seen([0.0; 2], |_, _, value| value - level);
        let taps = [-1.0, 4.0, 10.0, 4.0, -1.0].map(|tap| tap / 16.0);
        let grid = coefficients(&smooth(&image, &taps).map(|&v| f64::from(v))).map(|&v| v as f32);
        let [top, left] = [WINDOW.y, WINDOW.x].map(|first| first as usize - 2 - 3);
        let part = Part { top, bottom: top + WINDOW.height + 6, left, right: left + WINDOW.width + 6 };
        let grid = grid.part(part);
        let [value, slope] = [0, 1].map(|d| weights(0.0, d));
        let basis =
            [(&value, &value), (&value, &slope), (&slope, &value)].map(|(down, across)| combine(&grid, down, across));
        let mean = basis[0].values.iter().sum::<f32>() / basis[0].values.len() as f32;
        let basis = [basis[0].map(|value| value - mean), basis[1].clone(), basis[2].clone()];
        let information = [[[1e6, 0.0], [0.0, 1e6]]; 2];
        let precision = Precision::new(&basis, information, 0.5, [1.0, 1.0]);
        let template = Template::new(WINDOW, taps.to_vec(), grid, basis, precision, 0.3);
        let fine = refined(&image.map(|&v| f64::from(v)));
        let weight = Grid::filled(WINDOW.height, WINDOW.width, 1.0);
        let plane = Plane::new([&fine, &fine], (WINDOW.y as usize, WINDOW.x as usize), weight, 0.01, WINDOW).unwrap();
        let settings = Settings { min_share: 0.2, reference_noise: 1.0, kernel_bytes: 1 << 22 };
        Registration::new(plane, Arc::new(template), settings)
    }

    #[test]
    fn a_frame_gives_its_translation_and_the_same_bits_on_every_processor() {
        let covered = |r: usize, c: usize, value: f64| if r > 40 && r < 90 && c < 80 { 220.0 } else { value };
        for (moved, tolerance) in [([0.31, -0.42], 2e-4), ([-1.2, 0.77], 2e-4), ([0.06, 0.0], 2e-4)] {
            let frames = [seen(moved, |_, _, value| value), seen(moved, covered)];
            let usual = on_both(|| {
                let mut registration = opened();
                frames.each_ref().map(|frame| {
                    let bytes = frame.map(|&value| value.round() as u8);
                    let image = Image::new(&bytes.values, SIDE, SIDE, SIDE).unwrap();
                    let pose = registration.look(image, 120.0, &[0.0; 4], None).unwrap();
                    let exact = registration.look(Image::from(frame), 120.0, &[0.0; 4], None).unwrap();
                    (pose.value, pose.covariance, exact.value, exact.share)
                })
            });
            for (whole, exact, share) in usual.map(|(whole, _, exact, share)| (whole, exact, share)) {
                for k in 0..2 {
                    // Rounding to whole numbers is noise of 0.3 on a contrast of 20.
                    assert!((whole[k] - moved[k]).abs() < 2e-3, "{whole:?} {moved:?}");
                    assert!(
                        (exact[k] - moved[k]).abs() < if share < 1.0 { 1e-3 } else { tolerance },
                        "{exact:?} {moved:?}"
                    );
                }
            }
            assert!(usual[0].3 == 1.0 && usual[1].3 < 1.0);
        }
    }

    #[test]
    fn nothing_is_found_outside_the_image_or_where_no_picture_is() {
        let mut registration = opened();
        let frame = seen([0.0; 2], |_, _, value| value);
        assert!(registration.look(Image::from(&frame), 120.0, &[400.0, 0.0, 0.0, 0.0], None).is_none());
        assert!(registration.look(Image::from(&Grid::filled(SIDE, SIDE, 9.0)), 120.0, &[0.0; 4], None).is_none());
        let mut holes = frame;
        holes.row_mut(50)[60] = f32::NAN;
        assert!(!registration.all_finite(&Image::from(&holes), &[0.0; 4]));
        // Where nothing of the window is inside, nothing is missing.
        for place in [[200.0, 0.0], [0.0, 200.0], [200.0, 200.0], [-200.0, 200.0]] {
            assert!(registration.all_finite(&Image::from(&holes), &[place[0], place[1], 0.0, 0.0]));
        }
    }
}
