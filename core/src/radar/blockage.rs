//! Whether a target is seen: its amplitude as a share of the calibrated one, averaged over the frames that tell a dip
//! of its noise from an obstruction.

/// The band of amplitudes in which a target is seen.
pub struct Band {
    /// Variance of a frame's complex noise over the calibrated power.
    pub noise_share: f64,
    /// Share of a new frame in the running mean of the power.
    pub gain: f64,
    /// Amplitudes below this share of the calibrated one are an obstruction.
    pub min_share: f64,
    /// Amplitudes above this share are something else.
    pub max_share: f64,
    /// Good frames in a row before the target counts as seen again.
    pub clear_frames: usize,
}

/// Whether each frame (n,) is blocked; `share` (n,): amplitude over the calibrated one, NaN where no frame came.
pub fn blocked(share: &[f64], band: &Band) -> Vec<bool> {
    // Calibrated means seen.
    let (mut run, mut power) = (band.clear_frames, 1.0);
    share
        .iter()
        .map(|&share| {
            if share.is_nan() {
                // A frame that never came says nothing of what stands before the target.
                return true;
            }
            power += band.gain * (share.min(band.max_share).powi(2) - band.noise_share - power);
            let good = power >= band.min_share * band.min_share && share <= band.max_share;
            run = if good { (run + 1).min(band.clear_frames) } else { 0 };
            run < band.clear_frames
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_is_seen_again_after_some_good_frames_and_a_missing_one_hides_only_itself() {
        let band = Band { noise_share: 0.0, gain: 1.0, min_share: 0.4, max_share: 2.5, clear_frames: 2 };
        let found = blocked(&[1.0, 0.1, 1.0, 1.0, f64::NAN, 1.0, 3.0], &band);
        assert_eq!(found, [false, true, true, false, true, false, true]);
    }
}
